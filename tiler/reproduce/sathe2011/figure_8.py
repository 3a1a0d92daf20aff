"""Figure 8: what frustum culling gains over how much of the model is outside, at a few edge factors."""

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from tiler.bench.scenes import with_factor
from tiler.costs import count_cull_operations
from tiler.reproduce import style
from tiler.reproduce.frame_times import COST_MODEL, cycles, middle, time_frames
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.sathe2011.figure_7 import AS_PRINTED, PUBLISHED_RATES
from tiler.reproduce.sathe2011.views import BOUND, MACHINES, QUICK_SIZE, SIZE, moved_view, open_subject, shift_for

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHARES, QUICK_SHARES = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875), (0.0, 0.5)
FACTORS, QUICK_FACTORS = (3, 8, 32), (3, 16)
ROUNDS, QUICK_ROUNDS = 5, 2
COMPARED = {name: MACHINES[name] for name in ("none", BOUND)}
COLORS, MARKERS = (style.VERMILION, style.BLUE, style.GREEN), "sDo"  # of the factors in turn

# Stated before measuring: the gain rises with what is outside; where nothing is, the cull loses, and by what it costs alone.
RISES = Tolerance(at_least=0.0)
LOSES = Tolerance(at_most=1.0, at_least=0.8)

UNITS = {
    "model": "model",
    "outside_percent": "patches outside the view by the paper's test, %",
    "factor": "edge factor, all six",
    "gain_cycles": f"frame rate with the cull over that without, by cycles of the cost model `{COST_MODEL}`",
    "gain_processor": "the same by processor time of this renderer, medians",
    "gain_processor_low": "the upper quartile with the cull, lower one without",
    "gain_processor_high": "the lower quartile with the cull, upper one without",
}


def _measure(context: Context) -> tuple[dict[str, list[Any]], str]:
    subject = open_subject(context)
    shares, factors, rounds, size = (
        (QUICK_SHARES, QUICK_FACTORS, QUICK_ROUNDS, QUICK_SIZE) if context.quick else (SHARES, FACTORS, ROUNDS, SIZE)
    )
    operations = count_cull_operations(["frustum"])
    lines = []
    for k, share in enumerate(shares):
        scene = moved_view(subject, shift_for(subject, share, size), size)
        for f, factor in enumerate(factors):
            timed = time_frames(with_factor(scene, factor), COMPARED, rounds, context.threads)
            cost = {name: cycles(timed[name].frame.counters, machine, operations) for name, machine in COMPARED.items()}
            spent = {name: middle(timed[name].processor) for name in COMPARED}
            gone = 100.0 * timed[BOUND].frame.counters["hs_culled_frustum"] / scene.num_patches
            gains = (
                cost["none"].frame / cost[BOUND].frame,
                spent["none"].median / spent[BOUND].median,
                spent["none"].low / spent[BOUND].high,
                spent["none"].high / spent[BOUND].low,
            )
            lines.append((subject.name, gone, factor, *gains))
            context.update((k + (f + 1) / len(factors)) / len(shares))
    return {name: list(column) for name, column in zip(UNITS, zip(*lines, strict=True), strict=True)}, subject.told


def _curve(table: dict[str, list[Any]], factor: int, column: str) -> list[float]:
    return [value for f, value in zip(table["factor"], table[column], strict=True) if f == factor]


def _rows(table: dict[str, list[Any]]) -> list[Row]:
    factors = list(dict.fromkeys(table["factor"]))
    rows = []
    for factor in factors:
        gains = _curve(table, factor, "gain_cycles")
        step = min(b - a for a, b in pairwise(gains))
        rows.append(Row(f"factor {factor}: gain with nothing outside", None, gains[0], "times", LOSES))
        rows.append(Row(f"factor {factor}: least step of the gain as more is outside", None, step, "times", RISES))
    published = PUBLISHED_RATES[1] / PUBLISHED_RATES[0]
    half = min(
        range(len(table["factor"])), key=lambda k: (abs(table["outside_percent"][k] - 50.0), -table["factor"][k])
    )
    gain = table["gain_cycles"][half]
    rows.append(Row(f"factor {table['factor'][half]}: gain with half outside", published, gain, "times", AS_PRINTED))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    """Gain over the part outside: by the cost model, and of this renderer."""
    figure.set_size_inches(7.4, 3.7)
    panels = figure.subplots(1, 2, sharey=True)
    factors = list(dict.fromkeys(table["factor"]))
    titles = (f"cost model “{COST_MODEL}”, cycles", "this renderer, processor time")
    for axes, column, title in zip(panels, ("gain_cycles", "gain_processor"), titles, strict=True):
        for factor, color, marker in zip(factors, COLORS, MARKERS, strict=False):
            outside = _curve(table, factor, "outside_percent")
            axes.plot(outside, _curve(table, factor, column), color=color, marker=marker,
                      label=f"factor {factor}")  # fmt: skip
            if column == "gain_processor":
                ends = _curve(table, factor, f"{column}_low"), _curve(table, factor, f"{column}_high")
                axes.fill_between(outside, *ends, color=color, alpha=0.15, linewidth=0)
        axes.axhline(1.0, color=style.GREY, linewidth=0.8, zorder=1)
        axes.plot(
            50.0, PUBLISHED_RATES[1] / PUBLISHED_RATES[0], "*", color=style.BLACK, markersize=10, label="published"
        )
        axes.set_yscale("log", base=2)
        axes.set_yticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
        axes.set_ylim(0.8, 9.0)
        axes.set_xlabel("patches outside the view (%)")
        axes.set_title(title, loc="left")
        style.grid(axes, "both")
    panels[0].set_ylabel("frame rate, times that without culling")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))


TEXT = """
{told}

The camera of Figures 6 and 7 moved sideways, step by step, by bisection on the paper's own test; the machine bins
triangles, and the cull is by the box grown by the patch's largest displacement. The gain is the frame rate with the
cull over that without it: by cycles of the slowest stage of the cost model `{model}`, and by the processor time of
this renderer. The band is what the quartiles of {rounds} rounds leave. The star is what the paper prints for half of
the model outside (8.9 and 15.1 frames a second).

Allowed, stated beforehand: the gain rises with what is outside; with nothing outside it is between 0.8 and 1, the
cost of the cull; with half outside 1.70 +- 0.35, as in Figure 7.
"""


def run(context: Context) -> Result:
    """Draw and time frames with more and more of the model outside."""
    table, told = _measure(context)
    text = TEXT.format(told=told, model=COST_MODEL, rounds=QUICK_ROUNDS if context.quick else ROUNDS)
    return Result(tuple(_rows(table)), table, UNITS, lambda figure: _draw(table, figure), text)


ITEM = Item("sathe2011", "figure-8", "Gain over how much of the model is outside", run)
