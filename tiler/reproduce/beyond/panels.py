"""Panels that the figures share: one a measure, lines of the machines with their names at their ends, the ideal in black."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tiler.reproduce import style
from tiler.reproduce.beyond.machines import FLOOR, IDEAL, METRICS, MODES
from tiler.reproduce.page import say_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINE_HEIGHT = 0.05  # of a line of a name, part of the height of a panel
LABELS = {IDEAL: "ideal:\nvisible patches", FLOOR: "visible triangles"}
TICKS = (1, 2, 3, 5, 10, 20, 30, 50, 100)  # where the places of the data are no round numbers


def draw_panels(
    table: dict[str, list[Any]], figure: "Figure", axis: str, label: str, ticks: Sequence[float] | None = None
) -> None:
    """Three panels over the column `axis`: domain-shader invocations, queue bytes, coarse-Z tests; both axes logarithmic.

    ticks : of the axis; None: the places of the data.
    """
    figure.set_size_inches(10.5, 3.9)
    values = sorted(set(table[axis]))
    ticks = values if ticks is None else [tick for tick in ticks if values[0] <= tick <= values[-1]]
    panels = figure.subplots(1, len(METRICS))
    for axes, (metric, title) in zip(panels, METRICS.items(), strict=True):
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        axes.set_title(title, loc="left", fontweight="bold")
        axes.set_xlabel(label)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        style.grid(axes)
        draw_lines(table, axes, axis, metric)
        count_ticks(axes)


def draw_lines(table: dict[str, list[Any]], axes: "Axes", axis: str, metric: str) -> None:
    """Lines of the machines and of the ideal, each named at its right end."""
    ends: list[tuple[float, str, str]] = []
    _, baseline = _series(table, axis, metric, "triangle")
    for name in (*MODES, IDEAL, FLOOR):
        x, y = _series(table, axis, metric, name)
        if not y:
            continue
        if name in MODES:
            axes.plot(x, y, **style.line_style(name), zorder=3)
            fewer = f"\n{say_number(baseline[-1] / y[-1])}x fewer" if baseline and name != "triangle" else ""
            ends.append((y[-1], name + fewer, style.color_of(name)))
        else:
            dashes = "--" if name == IDEAL else ":"
            axes.plot(x, y, dashes, color=style.BLACK, linewidth=1.3, zorder=4)
            ends.append((y[-1], LABELS[name], style.BLACK))
    low, high = axes.get_ylim()
    axes.set_ylim(min(0.6 * low, high / 12), high)  # a decade at least: small differences look small
    name_ends(axes, ends)


def count_ticks(axes: "Axes") -> None:
    """A logarithmic y axis of counts: 20 k, 1 M; with marks between the decades where there are few of these."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_ylim()
    between = (1.0, 2.0, 5.0) if high / low < 120 else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=between, numticks=20))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: short_count(value)))
    axes.yaxis.set_minor_formatter(NullFormatter())


def short_count(value: float) -> str:
    """A count with k, M or G."""
    for unit, name in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= unit:
            return f"{value / unit:g}{name}"
    return f"{value:g}"


def _series(table: dict[str, list[Any]], axis: str, metric: str, name: str) -> tuple[list[float], list[float]]:
    """x and y of a machine, in rising x; without the places where it has no value."""
    rows = zip(table[axis], table["machine"], table[metric], strict=True)
    points = sorted((x, y) for x, machine, y in rows if machine == name and y)
    return [x for x, _ in points], [y for _, y in points]


def name_ends(axes: "Axes", ends: Sequence[tuple[float, str, str]], line: float = LINE_HEIGHT) -> None:
    """Names right of the axes at their heights (value, name, colour), moved apart where they would meet."""
    heights = axes.transData.transform([(1.0, value) for value, _, _ in ends])[:, 1]
    bottom, top = axes.bbox.y0, axes.bbox.y1
    places = [(y - bottom) / (top - bottom) for y in heights]
    order = sorted(range(len(ends)), key=lambda k: places[k])
    sizes = [line * (1.3 + ends[k][1].count("\n")) for k in order]
    spread = spread_apart([places[k] for k in order], sizes)
    for k, place in zip(order, spread, strict=True):
        _, name, color = ends[k]
        axes.annotate(
            name, (1.0, place), (5, 0), xycoords="axes fraction", textcoords="offset points", color=color,
            fontsize=8, va="center", linespacing=1.15, annotation_clip=False,
        )  # fmt: skip


def spread_apart(places: Sequence[float], sizes: Sequence[float]) -> list[float]:
    """Rising places moved as little as is needed so that intervals of these sizes around them do not meet."""
    groups: list[tuple[float, float, int]] = []  # (middle, size, members)
    for place, size in zip(places, sizes, strict=True):
        middle, total, members = place, size, 1
        while groups and groups[-1][0] + groups[-1][1] / 2 > middle - total / 2:
            before, extent, count = groups.pop()
            middle = (before * count + middle * members) / (count + members)
            total, members = total + extent, members + count
        groups.append((middle, total, members))
    spread: list[float] = []
    for middle, total, members in groups:
        begin = middle - total / 2
        for size in sizes[len(spread) : len(spread) + members]:
            spread.append(begin + size / 2)
            begin += size
    return spread
