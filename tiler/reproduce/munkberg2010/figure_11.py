"""Figure 11: frame time over the frames of an animation, for each tessellation factor and bound."""

from typing import TYPE_CHECKING, Any

from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.munkberg2010.animation import DISPLACEMENT, MACHINES, MODEL, UNITS, measure, settings
from tiler.reproduce.munkberg2010.table_2 import BOUNDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Stated before measuring: the figure's curves carry no numbers; this is what they show.
FALLS = Tolerance(at_most=0.8)  # the end of the zoom over its beginning, with culling, at the largest factor
FLAT = Tolerance(at_least=0.9)  # without culling the domain shader has all of its work in every frame
NO_LOSS = Tolerance(at_most=1.05)  # with all in view a bound costs little at a large factor

TEXT = """
The animation of table-2: the built-in `creature` in place of SubD11, constant displacement ({displacement:g}), {size};
the walk in full view up to frame 48, then the zoom. Above the frame time (processor time of this renderer, one thread),
below the work of the domain shader with the bounds' cost (`{model}`), relative to no culling.

In full view CBOX and OBBTEX find nothing to cull and cost what they cost; TPATCH already drops the third of the patches
that face away. In the zoom all follow what is left in the view. That frame time falls less than the work is what a
frame costs beside its domain shader.
"""


def _rows(table: dict[str, list[Any]]) -> list[Row]:
    factor, frames = max(table["factor"]), sorted(set(table["frame"]))
    rows = zip(table["factor"], table["frame"], table["machine"], table["frame_ms"], table["equivalents"], strict=True)
    work = {(frame, machine): value for f, frame, machine, _, value in rows if f == factor}
    rows = zip(table["factor"], table["frame"], table["machine"], table["frame_ms"], table["equivalents"], strict=True)
    time = {(frame, machine): value for f, frame, machine, value, _ in rows if f == factor}
    first, last = frames[0], frames[-1]
    found = [
        Row(
            f"factor {factor}, none: work, frame {last} / {first}",
            None,
            work[last, "none"] / work[first, "none"],
            "",
            FLAT,
        )
    ]
    for name in BOUNDS:
        what = f"factor {factor}, {name}: work, frame {last} / {first}"
        found.append(Row(what, None, work[last, name] / work[first, name], "", FALLS))
    for name in BOUNDS:
        what = f"factor {factor}, {name} / none: work, all in view (frame {first})"
        found.append(Row(what, None, work[first, name] / work[first, "none"], "", NO_LOSS))
    for name in BOUNDS:
        what = f"factor {factor}, {name} / none: frame time, zoomed in (frame {last})"
        found.append(Row(what, None, time[last, name] / time[last, "none"], "", Tolerance(at_most=1.0)))
    return found


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    factors = sorted(set(table["factor"]))
    figure.set_size_inches(11.0, 5.4)
    panels = figure.subplots(2, len(factors), sharex=True, squeeze=False, height_ratios=(3, 2))
    for k, factor in enumerate(factors):
        time, work = panels[:, k]
        time.set_title(f"factor {factor}", loc="left", fontweight="bold")
        _panel(table, time, factor, "frame_ms", False)
        _panel(table, work, factor, "equivalents", True)
        time.set_ylim(bottom=0.0)
        work.set_ylim(0.0, 1.3)
        work.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
        work.set_xlabel("frame")
        time.axvspan(48, max(table["frame"]), color="#f3f3f3", zorder=0, linewidth=0)
        work.axvspan(48, max(table["frame"]), color="#f3f3f3", zorder=0, linewidth=0)
    panels[0, 0].set_ylabel("frame time, ms")
    panels[1, 0].set_ylabel("shading and bounds,\nof no culling")
    panels[0, 0].text(50, 0.0, "zoom", fontsize=8, color=style.GREY, va="bottom")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(MACHINES))


def _panel(table: dict[str, list[Any]], axes: "Axes", factor: int, column: str, relative: bool) -> None:
    rows = zip(table["factor"], table["frame"], table["machine"], table[column], strict=True)
    value = {(frame, machine): v for f, frame, machine, v in rows if f == factor}
    frames = sorted({frame for frame, _ in value})
    for name in MACHINES:
        line = [value[f, name] / (value[f, "none"] if relative else 1.0) for f in frames]
        axes.plot(frames, line, **{**style.line_style(name), "markersize": 3.5, "label": _label(name)})
    axes.set_xticks([0, 24, 48, 72, 96])
    style.grid(axes)


def _label(name: str) -> str:
    return "no culling" if name == "none" else name


def run(context: Context) -> Result:
    """Every frame of the animation."""
    size, _, _ = settings(context)
    table = measure(context)
    text = TEXT.format(displacement=DISPLACEMENT, size="x".join(map(str, size)), model=MODEL)
    return Result(tuple(_rows(table)), table, UNITS, lambda figure: _draw(table, figure), text)


ITEM = Item("munkberg2010", "figure-11", "Frame time over an animation with each bound", run)
