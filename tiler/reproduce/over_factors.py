"""Frames of several machines over tessellation factors: by the cost model, and timed; and the figure of it."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tiler.bench.scenes import with_factor
from tiler.config import Machine
from tiler.reproduce import style
from tiler.reproduce.frame_times import COST_MODEL, cycles, middle, time_frames
from tiler.reproduce.item import Context
from tiler.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNITS = {
    "model": "model",
    "factor": "tessellation factor, all six",
    "test": "what culls patches; none: nothing does",
    "culled_percent": "patches culled by the hull stage's tests, % of all",
    "ds_invocations": "domain-shader invocations",
    "cycles": f"cycles of the slowest stage by the cost model `{COST_MODEL}`, the tests' operations included",
    "bottleneck": "that stage",
    "processor_ms": "processor time of a frame of this renderer, all threads, median, ms",
    "processor_ms_low": "lower quartile",
    "processor_ms_high": "upper quartile",
    "passed_ms": "time that passed, median, ms",
}
BASELINE = "none"

Table = dict[str, list[Any]]


def measure(
    name: str,
    scene: Scene,
    machines: Mapping[str, Machine],
    operations: Mapping[str, float],
    factors: Sequence[float],
    rounds: int,
    context: Context,
) -> Table:
    """The table of UNITS: each machine at each factor. operations : a patch of each cull test, for the cost model."""
    lines = []
    for k, factor in enumerate(factors):

        def update(part: float, k: int = k) -> None:
            context.update((k + part) / len(factors))

        timed = time_frames(with_factor(scene, factor), machines, rounds, context.threads, done=update)
        for test, machine in machines.items():
            counters = timed[test].frame.counters
            cost = cycles(counters, machine, operations)
            spent, passed = middle(timed[test].processor), middle(timed[test].passed)
            gone = counters["hs_culled_backface"] + counters["hs_culled_frustum"]
            lines.append(
                (
                    name, factor, test, 100.0 * gone / scene.num_patches, int(counters["ds_invocations"]), cost.frame,
                    cost.bottleneck, spent.median, spent.low, spent.high, passed.median,
                )
            )  # fmt: skip
    return {column: list(values) for column, values in zip(UNITS, zip(*lines, strict=True), strict=True)}


def curve(table: Table, test: str, column: str) -> list[Any]:
    """A machine's values over the factors."""
    return [value for name, value in zip(table["test"], table[column], strict=True) if name == test]


def relative(table: Table, test: str, column: str) -> list[float]:
    """A machine's values over those of the baseline, over the factors."""
    return [a / b for a, b in zip(curve(table, test, column), curve(table, BASELINE, column), strict=True)]


def draw(table: Table, figure: "Figure", ends: tuple[float, float]) -> None:
    """Above the time of a frame, below that relative to the baseline: by the cost model, and of this renderer.

    ends : of the lower axes.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    figure.set_size_inches(7.4, 5.6)
    panels = figure.subplots(2, 2, sharex=True, height_ratios=(1.0, 1.1))
    names = list(dict.fromkeys(table["test"]))
    factors = curve(table, BASELINE, "factor")
    titles = (f"cost model “{COST_MODEL}”: million cycles", "this renderer: processor time, ms")
    for column, (value, title) in enumerate(zip(("cycles", "processor_ms"), titles, strict=True)):
        above, below = panels[0, column], panels[1, column]
        unit = 1e-6 if value == "cycles" else 1.0
        none = np.array(curve(table, BASELINE, value))
        for test in names:
            above.plot(factors, unit * np.array(curve(table, test, value)), **style.line_style(test))
            below.plot(factors, relative(table, test, value), **style.line_style(test))
            if value == "processor_ms":
                band = [np.array(curve(table, test, f"{value}_{end}")) / none for end in ("low", "high")]
                below.fill_between(factors, *band, color=style.color_of(test), alpha=0.15, linewidth=0)
        above.set_xscale("log", base=2)
        above.set_yscale("log")
        above.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        above.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        above.yaxis.set_minor_locator(NullLocator())
        above.set_title(title, loc="left")
        below.set_xticks(factors, [f"{f:g}" for f in factors])
        below.set_xticks([], minor=True)
        below.set_ylim(*ends)
        below.set_xlabel("tessellation factor")
        style.grid(above, "both")
        style.grid(below, "both")
    panels[0, 0].set_ylabel("a frame")
    panels[1, 0].set_ylabel("relative to no culling")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
