"""Figure 9: two views, all of the model inside and half of it outside, and what the cull leaves of each."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.types import F64
from tiler.bench.scenes import with_factor
from tiler.comparison import compare
from tiler.config import Machine
from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.loop2011.figure_1 import patch_light
from tiler.reproduce.patch_pictures import paint, seen_patches, show, spans_of
from tiler.reproduce.plain import view_from
from tiler.reproduce.sathe2011.views import (
    BOUND,
    DISTANCE,
    MACHINES,
    QUICK_SIZE,
    SIZE,
    TOWARDS,
    Subject,
    moved_view,
    open_subject,
    outside,
    shift_for,
)  # fmt: skip
from tiler.reproduce.surface_samples import sample_surfaces
from tiler.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VIEWS = {"all inside": 0.0, "half outside": 0.5}
WIDTH, HEIGHT = 800, 450  # of the pictures
FACTOR, QUICK_FACTOR = 8, 3
INSIDE, CULLED = "kept", "culled: its box is outside"
COLORS = {INSIDE: "#f0c987", CULLED: "#8fb8d8"}

# Stated before measuring: a cull changes no picture and drops nothing that is seen; fixed factors shade as much in each patch.
NONE = Tolerance(at_most=0)
SAME = Tolerance(at_least=-1e-6, at_most=1e-6)
HALF = Tolerance(absolute=1.0)
ALL = Tolerance(at_most=0.0)

UNITS = {
    "model": "model",
    "view": "view",
    "patch": "number of the patch",
    "culled": "the paper's cull drops it",
    "light": "brightness in the pictures, 0 to 1",
    "pixels_camera": f"where it is seen in the view, {WIDTH} x {HEIGHT}: row:first-last of each run of pixels; no displacement",
    "pixels_whole": f"where it is seen from the same side with all of the model in the picture, {WIDTH} x {HEIGHT}",
}


def _drawn(scene: Scene, context: Context) -> list[str]:
    return spans_of(seen_patches(scene, context.threads), scene.num_patches)


def _light(subject: Subject) -> F64:
    samples = sample_surfaces(subject.plain.control_points, 4)
    return patch_light(samples, np.array(TOWARDS["y" if subject.up[1] else "z"]) + 0.5 * np.array(subject.up))


def _measure(subject: Subject, context: Context) -> tuple[dict[str, list[Any]], list[Row]]:
    size = QUICK_SIZE if context.quick else SIZE
    factor = QUICK_FACTOR if context.quick else FACTOR
    light = _light(subject).tolist()
    n = subject.plain.num_patches
    table: dict[str, list[Any]] = {name: [] for name in UNITS}
    towards = np.array(TOWARDS["y" if subject.up[1] else "z"])
    towards /= np.sqrt((towards**2).sum())
    eye = subject.ball.center + DISTANCE * subject.ball.radius * towards
    whole = _drawn(view_from(subject.plain, eye, subject.ball.center, subject.up, (WIDTH, HEIGHT)), context)
    rows = []
    for k, (name, share) in enumerate(VIEWS.items()):
        shift = shift_for(subject, share, size)
        scene = moved_view(subject, shift, size)
        columns = (
            [subject.name] * n, [name] * n, list(range(n)), outside(scene).tolist(), light,
            _drawn(moved_view(subject, shift, (WIDTH, HEIGHT), plain=True), context), whole,
        )  # fmt: skip
        for column, values in zip(table.values(), columns, strict=True):
            column += values
        rows += _check(name, scene, factor, context)
        context.update((k + 1) / len(VIEWS))
    return table, rows


def _check(name: str, scene: Scene, factor: int, context: Context) -> list[Row]:
    """What the machine counts in a view with the cull and without, and whether it draws the same."""
    checking = Machine(binning="triangle", bounds=BOUND, cull=("frustum",), verify=True)
    machines = {"none": MACHINES["none"], BOUND: checking}
    found = compare(with_factor(scene, factor), machines, threads=context.threads)
    none, culled = found.frames["none"], found.frames[BOUND]
    gone = 100.0 * culled.counters["hs_culled_frustum"] / scene.num_patches
    saved = 100.0 * (1.0 - culled.counters["ds_invocations"] / none.counters["ds_invocations"])
    different = int((culled.color != none.color).any(axis=2).sum())
    wanted, allowed = (0.0, ALL) if name == "all inside" else (50.0, HALF)
    return [
        Row(f"{name}: patches culled", wanted, gone, "%", allowed),
        Row(f"{name}: shaded points saved less patches culled", None, saved - gone, "points", SAME),
        Row(f"{name}: pixels that differ from those without the cull", None, different, "pixels", NONE),
        Row(f"{name}: bounds and culls found wrong", None, len(culled.violations), "", NONE),
    ]


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    """Above what the camera sees, below all of the model with what is culled."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    figure.set_size_inches(7.4, 4.9)
    panels = figure.subplots(2, 2)
    lines = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
    for column, view in enumerate(dict.fromkeys(table["view"])):
        mine = [line for line in lines if line["view"] == view]
        colors = np.array([to_rgb(COLORS[CULLED if line["culled"] else INSIDE]) for line in mine])
        light = [line["light"] for line in mine]
        above, below = panels[:, column]
        above.imshow(paint([line["pixels_camera"] for line in mine], colors, light, (WIDTH, HEIGHT)))
        above.set_xticks([])
        above.set_yticks([])
        for spine in above.spines.values():
            spine.set(visible=True, color=style.GREY, linewidth=0.8)
        above.set_title(f"{view}: what the camera sees", fontsize=9.5)
        show(below, paint([line["pixels_whole"] for line in mine], colors, light))
        share = 100.0 * sum(line["culled"] for line in mine) / len(mine)
        below.set_title(f"all of the model: {share:.0f} % of the patches culled", fontsize=9.5)
    handles = [Patch(facecolor=color, edgecolor="#999999", linewidth=0.5, label=name) for name, color in COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


TEXT = """
{told}

The two views of Figures 6 and 7: all of the model inside, and the camera moved sideways until half of the patches are
outside by the paper's test. Above is what the camera sees, below the same model whole, with the patches that are
culled; the pictures are drawn without displacement, the culls are of the displaced patches at factor {factor}.
Patches whose box reaches into the view are kept.

Each view is drawn with the cull and without it, and all bounds and culls are checked against the shaded vertices.
Allowed, stated beforehand: no pixel that differs, no bound and no cull found wrong, and exactly as large a part of
the shaded points saved as of the patches culled. The paper's own test divides by w first, which is wrong for boxes
that reach behind the eye (`docs/backface.md`, frustum variants); here the box's corners are tested in clip space.
"""


def run(context: Context) -> Result:
    """Draw both views."""
    subject = open_subject(context)
    table, rows = _measure(subject, context)
    text = TEXT.format(told=subject.told, factor=QUICK_FACTOR if context.quick else FACTOR)
    return Result(tuple(rows), table, UNITS, lambda figure: _draw(table, figure), text)


ITEM = Item("sathe2011", "figure-9", "Two views: all inside, half outside", run)
