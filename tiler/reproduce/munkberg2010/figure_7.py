"""Figure 7: the volumes themselves, around one displaced patch."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.types import F64, HullInput
from tiler.quality import box_volumes, reference_boxes, rows_of_stage, shaded_grid, stage_of
from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.munkberg2010.subjects import ALGORITHMS
from tiler.scene import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure
SCENE = "spikelog"
GRID = 32  # points along a side of the surface that is drawn
SURFACE, REFERENCE = "surface", "reference"
SIGNS = np.array([[1 if k >> r & 1 else -1 for r in range(3)] for k in range(8)])
EDGES = [(k, k | 1 << bit) for k in range(8) for bit in range(3) if not k & 1 << bit]
ZOOM = (1.05, 1.2)  # of boxes along the frame, and of the one that is turned and fills less of its extent
FACES = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]

UNITS = {
    "shape": f"{SURFACE}: a point of the displaced surface; else a corner of the box of that name",
    "number": f"{SURFACE}: 32 * row along u + column along v; a box: bit r is 1 at the far side of its axis r",
    "x": "world units along the oriented frame's first axis, from the middle of the reference box",
    "y": "along its second axis",
    "z": "along its third axis, the patch's own normal",
}

TEXT = f"""
One patch of `{SCENE}` and what each algorithm bounds it with, all seen from the same side, each box as large as its panel
lets it: the smaller the surface in it, the looser the box. The surface is what the domain shader gives; the thin box is that
of 32 x 32 of its points in the patch's oriented frame. The patch is the one whose TPATCH box stands in the middle when all
patches are sorted by how much larger that box is than the reference.

The paper shows its volumes on a model; here a single patch is drawn, so that the boxes can be told apart. Checked is the order
of the volumes, of which those of the same frame are nested.
"""


def typical_patch(stage: HullInput) -> int:
    """The patch with the median ratio of TPATCH's volume to the reference's."""
    _, axes = reference_boxes(stage, shaded_grid(stage))
    ratio = box_volumes(BOUNDS["tpatch"](stage).axes) / box_volumes(axes)
    return int(np.argsort(ratio, kind="stable")[len(ratio) // 2])


def _corners(center: F64, axes: F64) -> F64:
    return center + SIGNS @ axes


def _table() -> tuple[dict[str, list[Any]], list[Row]]:
    stage = stage_of(load_scene(SCENE))
    one = rows_of_stage(stage, np.array([typical_patch(stage)]))
    points = shaded_grid(one, GRID)
    center, axes = reference_boxes(one, shaded_grid(one))
    frame = BOUNDS["obbtex"](one).axes[0]
    frame = frame / np.linalg.norm(frame, axis=1, keepdims=True)
    bounds = {name: BOUNDS[name](one) for name in ALGORITHMS}
    shapes = {SURFACE: points[0].astype(np.float64), REFERENCE: _corners(center[0], axes[0])}
    shapes |= {name: _corners(found.center[0], found.axes[0]) for name, found in bounds.items()}
    table: dict[str, list[Any]] = {name: [] for name in UNITS}
    for shape, vertices in shapes.items():
        local = (vertices - center[0]) @ frame.T
        table["shape"] += [shape] * len(local)
        table["number"] += list(range(len(local)))
        for k, axis in enumerate("xyz"):
            table[axis] += [round(float(value), 9) for value in local[:, k]]
    reference = box_volumes(axes)[0]
    volume = {name: float(box_volumes(found.axes)[0] / reference) for name, found in bounds.items()}
    tighter = {"cbox": "obbtex", "obbtex": "tpatch", "tpatch": "npatch"}
    rows = [
        Row(
            f"{name}: volume", None, volume[name], "of the reference",
            Tolerance(at_least=volume[tighter[name]] if name in tighter else 1.0),
            f"not below {tighter.get(name, REFERENCE)}",
        )
        for name in ALGORITHMS
    ]  # fmt: skip
    return table, rows


def _points(table: dict[str, list[Any]], shape: str) -> F64:
    rows = [k for k, name in enumerate(table["shape"]) if name == shape]
    return np.array([[table[axis][k] for axis in "xyz"] for k in rows])


def _box(axes: Any, corners: F64, color: str, width: float, filled: bool) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    if filled:
        axes.add_collection3d(Poly3DCollection([corners[list(face)] for face in FACES], facecolor=color, alpha=0.07))
    lines = [corners[list(edge)] for edge in EDGES]
    axes.add_collection3d(Line3DCollection(lines, colors=color, linewidths=width))


def _surface(axes: Any, points: F64) -> None:
    """The surface, shaded by a light from the upper left."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    grid = points.reshape(GRID, GRID, 3)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    normal = np.cross(c - a, d - b)
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    light = np.array([-0.4, -0.5, 0.77])
    shade = 0.45 + 0.5 * np.abs((normal / np.where(length > 0, length, 1)) @ light)
    quads = np.stack([a, b, c, d], axis=2).reshape(-1, 4, 3)
    color = np.clip(shade.reshape(-1, 1), 0, 1) * np.array([[0.86, 0.82, 0.76]])
    axes.add_collection3d(Poly3DCollection(list(quads), facecolors=color, edgecolors=color, linewidths=0.3))


def _draw(table: dict[str, list[Any]], rows: list[Row], figure: "Figure") -> None:
    figure.set_layout_engine("none")
    figure.set_size_inches(9.6, 2.5)
    surface, reference = _points(table, SURFACE), _points(table, REFERENCE)
    for k, name in enumerate(ALGORITHMS):
        width = 1 / len(ALGORITHMS)
        axes: Any = figure.add_axes((k * width, -0.06, width, 0.92), projection="3d")
        box = _points(table, name)
        _surface(axes, surface)
        _box(axes, reference, style.GREY, 0.7, False)
        _box(axes, box, style.color_of(name), 1.4, True)
        lo, hi = box.min(axis=0), box.max(axis=0)
        axes.set(xlim=(lo[0], hi[0]), ylim=(lo[1], hi[1]), zlim=(lo[2], hi[2]))
        axes.set_box_aspect(hi - lo, zoom=ZOOM[name == "cbox"])
        axes.view_init(elev=20, azim=-56)
        axes.set_axis_off()
        figure.text((k + 0.5) * width, 0.9, name, color=style.color_of(name), ha="center", weight="bold")
        figure.text((k + 0.5) * width, 0.82, f"{rows[k].measured:.1f} x the reference", ha="center", fontsize=8)


def run(context: Context) -> Result:
    """Bound one patch."""
    table, rows = _table()
    return Result(tuple(rows), table, UNITS, lambda figure: _draw(table, rows, figure), TEXT)


ITEM = Item("munkberg2010", "figure-7", "The volumes around a displaced patch", run)
