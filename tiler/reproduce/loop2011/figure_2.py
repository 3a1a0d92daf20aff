"""Figure 2: the time of a frame over tessellation factors, without back-patch culling and with each test."""

import time
from typing import TYPE_CHECKING

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.bench.stages import hull_stage
from tiler.config import Machine
from tiler.cost_model import crossing
from tiler.costs import count_cull_operations
from tiler.reproduce.frame_times import COST_MODEL
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.loop2011.figure_1 import TO_EYE, unit
from tiler.reproduce.loop2011.models import TESTS, Subject, subjects
from tiler.reproduce.over_factors import UNITS, Table, curve, draw, measure, relative
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


def _scene(subject: Subject, context: Context) -> Scene:
    axis = "y" if subject.up[1] else "z"
    eye = subject.ball.center + 4.0 * subject.ball.radius * unit(TO_EYE[axis])
    size = (320, 180) if context.quick else (960, 540)
    return view_from(subject.scene, eye, subject.ball.center, subject.up, size)


def _test_nanoseconds(scene: Scene, repeats: int) -> dict[str, float]:
    """Nanoseconds a patch of each test in the hull stage: processor time of one thread, fastest run."""
    stage = hull_stage(scene)
    bounds = BOUNDS["cbox"](stage)
    found = {}
    for test in TESTS:
        cull = CULL_TESTS[f"backface:{test}"]
        runs = []
        for _ in range(repeats + 1):  # the first may compile
            flags = np.zeros(scene.num_patches, np.uint8)
            begin = time.thread_time()
            cull(stage, bounds, flags)
            runs.append(time.thread_time() - begin)
        found[test] = min(runs[1:]) / scene.num_patches * 1e9
    return found


def _rows(table: Table, times: dict[str, float], operations: dict[str, float], quick: bool) -> list[Row]:
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
        ratio = relative(table, test, "cycles")[at_16]
        rows.append(Row(f"{test}: cycles at factor 16, of those without culling", None, ratio, "", PAYS))
        pays = crossing(factors, none["cycles"], mine["cycles"])
        rows.append(
            Row(f"{test}: pays from factor (cycles)", None, float("nan") if pays is None else pays, "", PAYS_FROM)
        )
        ratio = relative(table, test, "processor_ms")[-1]
        what = f"{test}: processor time at factor {last}, of that without culling"
        rows.append(Row(what, None, ratio, "", None if quick else PAYS))
    for test in TESTS:
        note = f"printed: {1e6 * KILLEROO[test] / KILLEROO_PATCHES:.0f} ns, on a GPU; here one thread"
        rows.append(Row(f"{test}: time of the test", None, times[test], "ns a patch", None, note))
        what = f"{test}: operations of the test"
        rows.append(Row(what, None, operations[f"backface:{test}"], "a patch", None))
    for test in TESTS[1:]:
        ratio = operations[f"backface:{test}"] / operations["backface:tcone"]
        note = "printed: times on a GPU; here operations, smallest cones"
        rows.append(Row(f"{test} / tcone: cost of the test", KILLEROO[test] / KILLEROO["tcone"], ratio, "", None, note))
    return rows


def _draw(table: Table, figure: "Figure") -> None:
    draw(table, figure, (0.4, 2.2))


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
in each; by cycles each test pays at factor 16; no frame of this renderer is slower at the largest factor (no verdict
with `--quick`, of few frames). Tighter verdicts on times of a shared computer would say nothing.
"""


def run(context: Context) -> Result:
    """Draw and time frames."""
    (subject,) = subjects(context, 1)
    scene = _scene(subject, context)
    operations = count_cull_operations([f"backface:{test}" for test in TESTS])
    times = _test_nanoseconds(scene, 3 if context.quick else 20)
    factors, rounds = (QUICK_FACTORS, QUICK_ROUNDS) if context.quick else (FACTORS, ROUNDS)
    table = measure(subject.name, scene, MACHINES, operations, factors, rounds, context)
    picture = scene.picture
    text = TEXT.format(
        told=subject.told, width=picture.width, height=picture.height, model=COST_MODEL,
        rounds=rounds,
    )  # fmt: skip
    return Result(
        tuple(_rows(table, times, operations, context.quick)), table, UNITS, lambda figure: _draw(table, figure), text
    )


ITEM = Item("loop2011", "figure-2", "Time of a frame over tessellation factors", run)
