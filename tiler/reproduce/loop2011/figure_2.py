"""Figure 2: the time of a frame over tessellation factors, without back-patch culling and with each test."""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.bench.limits import best_seconds
from tiler.bench.scenes import with_factor
from tiler.bench.stages import hull_stage
from tiler.config import Machine
from tiler.cost_model import crossing
from tiler.costs import count_cull_operations
from tiler.reproduce import style
from tiler.reproduce.frame_times import COST_MODEL, cycles, middle, time_frames
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.loop2011.figure_1 import TO_EYE, unit
from tiler.reproduce.loop2011.models import TESTS, Subject, subjects
from tiler.reproduce.plain import view_from
from tiler.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MACHINES = {
    "none": Machine(binning="triangle", cull=()),
    **{test: Machine(binning="triangle", cull=(f"backface:{test}",)) for test in TESTS},
}
FACTORS, QUICK_FACTORS = (1, 2, 4, 8, 16, 32), (2, 16)
ROUNDS, QUICK_ROUNDS = 7, 2
KILLEROO = {"tcone": 0.36, "ncone": 0.86, "tangent_plane": 0.76}  # ms for 11,532 patches
KILLEROO_PATCHES = 11532

# Stated before measuring. Fixed factors shade as many points in each patch, so the points saved are the patches culled,
# exactly. A test costs what ten to twenty shaded points cost and saves some 35 to 45 % of them: it has to pay at factor 16,
# of 289 points. Frame times of a shared computer: only that the frame is not slower at the largest factor.
SAME = Tolerance(at_least=-1e-6, at_most=1e-6)
PAYS = Tolerance(at_most=1.0)
PAYS_FROM = Tolerance(at_most=16.0)

UNITS = {
    "model": "model",
    "factor": "tessellation factor, all six",
    "test": "back-patch test; none: no culling",
    "culled_percent": "patches culled, % of all",
    "ds_invocations": "domain-shader invocations",
    "cycles": f"cycles of the slowest stage by the cost model `{COST_MODEL}`, the test's operations included",
    "bottleneck": "that stage",
    "processor_ms": "processor time of a frame of this renderer, all threads, median, ms",
    "processor_ms_low": "lower quartile",
    "processor_ms_high": "upper quartile",
    "passed_ms": "time that passed, median, ms",
}


def _scene(subject: Subject, context: Context) -> Scene:
    axis = "y" if subject.up[1] else "z"
    eye = subject.ball.center + 4.0 * subject.ball.radius * unit(TO_EYE[axis])
    size = (320, 180) if context.quick else (960, 540)
    return view_from(subject.scene, eye, subject.ball.center, subject.up, size)


def _test_nanoseconds(scene: Scene, repeats: int) -> dict[str, float]:
    """Nanoseconds a patch of each test in the hull stage, one thread, fastest run."""
    stage = hull_stage(scene)
    bounds = BOUNDS["cbox"](stage)
    found = {}
    for test in TESTS:
        flags = np.zeros(scene.num_patches, np.uint8)

        def clear_and_cull(cull: Any, flags: Any) -> None:
            flags[:] = 0
            cull(stage, bounds, flags)

        seconds = best_seconds(partial(clear_and_cull, CULL_TESTS[f"backface:{test}"], flags), repeats)
        found[test] = seconds / scene.num_patches * 1e9
    return found


def _measure(subject: Subject, scene: Scene, operations: dict[str, float], context: Context) -> dict[str, list[Any]]:
    factors = QUICK_FACTORS if context.quick else FACTORS
    lines = []
    for k, factor in enumerate(factors):

        def update(part: float, k: int = k) -> None:
            context.update((k + part) / len(factors))

        rounds = QUICK_ROUNDS if context.quick else ROUNDS
        timed = time_frames(with_factor(scene, factor), MACHINES, rounds, context.threads, done=update)
        for test, machine in MACHINES.items():
            counters = timed[test].frame.counters
            cost = cycles(counters, machine, operations)
            spent, passed = middle(timed[test].processor), middle(timed[test].passed)
            gone = 100.0 * counters["hs_culled_backface"] / scene.num_patches
            lines.append(
                (
                    subject.name, factor, test, gone, int(counters["ds_invocations"]), cost.frame, cost.bottleneck,
                    spent.median, spent.low, spent.high, passed.median,
                )
            )  # fmt: skip
    return {name: list(column) for name, column in zip(UNITS, zip(*lines, strict=True), strict=True)}


def curve(table: dict[str, list[Any]], test: str, column: str) -> list[Any]:
    """A test's values over the factors."""
    return [value for name, value in zip(table["test"], table[column], strict=True) if name == test]


def _rows(table: dict[str, list[Any]], times: dict[str, float], operations: dict[str, float]) -> list[Row]:
    factors = curve(table, "none", "factor")
    of = {test: {column: curve(table, test, column) for column in UNITS} for test in MACHINES}
    last, at_16 = factors[-1], factors.index(16)
    rows = []
    for test in TESTS:
        mine, none = of[test], of["none"]
        saved = 100.0 * (1.0 - mine["ds_invocations"][-1] / none["ds_invocations"][-1])
        off = saved - mine["culled_percent"][-1]
        rows.append(Row(f"{test}: patches culled", None, mine["culled_percent"][-1], "%", None))
        rows.append(Row(f"{test}: shaded points saved less patches culled", None, off, "points", SAME))
        ratio = mine["cycles"][at_16] / none["cycles"][at_16]
        rows.append(Row(f"{test}: cycles at factor 16, of those without culling", None, ratio, "", PAYS))
        pays = crossing(factors, none["cycles"], mine["cycles"])
        rows.append(
            Row(f"{test}: pays from factor (cycles)", None, float("nan") if pays is None else pays, "", PAYS_FROM)
        )
        ratio = mine["processor_ms"][-1] / none["processor_ms"][-1]
        what = f"{test}: processor time at factor {last}, of that without culling"
        rows.append(Row(what, None, ratio, "", PAYS))
    for test in TESTS:
        published = 1e6 * KILLEROO[test] / KILLEROO_PATCHES
        rows.append(
            Row(f"{test}: time of the test", published, times[test], "ns a patch", None, "a GPU; one thread of a CPU")
        )
        what = f"{test}: operations of the test"
        rows.append(Row(what, None, operations[f"backface:{test}"], "a patch", None))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    """Above the time of a frame, below that relative to none: by the cost model, and of this renderer."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    figure.set_size_inches(7.4, 5.6)
    panels = figure.subplots(2, 2, sharex=True, height_ratios=(1.0, 1.1))
    factors = curve(table, "none", "factor")
    titles = (f"cost model “{COST_MODEL}”: million cycles", "this renderer: processor time, ms")
    for column, (value, title) in enumerate(zip(("cycles", "processor_ms"), titles, strict=True)):
        above, below = panels[0, column], panels[1, column]
        none, unit_of = np.array(curve(table, "none", value)), 1e-6 if value == "cycles" else 1.0
        for test in MACHINES:
            mine = np.array(curve(table, test, value))
            above.plot(factors, unit_of * mine, **style.line_style(test))
            below.plot(factors, mine / none, **style.line_style(test))
            if value == "processor_ms":
                ends = [np.array(curve(table, test, f"{value}_{end}")) / none for end in ("low", "high")]
                below.fill_between(factors, *ends, color=style.color_of(test), alpha=0.15, linewidth=0)
        above.set_xscale("log", base=2)
        above.set_yscale("log")
        above.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        above.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        above.yaxis.set_minor_locator(NullLocator())
        above.set_title(title, loc="left")
        below.set_xticks(factors, [str(f) for f in factors])
        below.set_xlabel("tessellation factor")
        style.grid(above, "both")
        style.grid(below, "both")
    for axes in panels[1]:
        axes.set_ylim(0.4, 2.2)
    panels[0, 0].set_ylabel("a frame")
    panels[1, 0].set_ylabel("relative to no culling")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))


TEXT = """
{told}

The whole model in a picture of {width} x {height}, seen from four bounding radii, three quarters to the front, on a
machine that bins triangles; the tests run in the hull stage. *Cycles* are those of the slowest stage by the cost
model `{model}`, with the tests' own float operations, counted by running their sources, added to the shaders at a
lane's cycle each. *Processor time* is of this renderer, which draws the picture in software: the median of {rounds}
rounds in which the machines take turns; the band is the middle half. It works at other costs than the modelled
machine: rasterization weighs more, and the tests are compiled for vectors.

The paper's curves are printed without numbers; its text gives the time of each test alone for one view of Killeroo,
which stands beside ours without a verdict (a GPU with hundreds of lanes; smallest cones take more operations than
mean axes). Allowed, stated beforehand: the shaded points saved are the patches culled, as fixed factors shade as many
in each; by cycles each test pays at factor 16; no frame of this renderer is slower at the largest factor. Tighter
verdicts on times of a shared computer would say nothing.
"""


def run(context: Context) -> Result:
    """Draw and time frames."""
    (subject,) = subjects(context, 1)
    scene = _scene(subject, context)
    operations = count_cull_operations([f"backface:{test}" for test in TESTS])
    times = _test_nanoseconds(scene, 3 if context.quick else 20)
    table = _measure(subject, scene, operations, context)
    picture = scene.picture
    text = TEXT.format(
        told=subject.told, width=picture.width, height=picture.height, model=COST_MODEL,
        rounds=QUICK_ROUNDS if context.quick else ROUNDS,
    )  # fmt: skip
    return Result(tuple(_rows(table, times, operations)), table, UNITS, lambda figure: _draw(table, figure), text)


ITEM = Item("loop2011", "figure-2", "Time of a frame over tessellation factors", run)
