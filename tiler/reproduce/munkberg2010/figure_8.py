"""Figure 8: how many patches' bounds lie over each pixel, in false colour, by bounding algorithm."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipeline.types import I32
from tiler.config import Machine
from tiler.frame import RAMP
from tiler.heatmaps import depth_complexity_map, overlap_map
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.models import open_model
from tiler.scene import load_scene
from tiler.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SURFACE = "surface"
BOUNDS = ("taylor", "npatch", "tpatch", "obbtex", "cbox")  # from tight to loose
SIZE, QUICK_SIZE = (960, 540), (240, 135)
SHOWN = 240  # pixels of the figure's maps from left to right
FACTOR = 16

# Stated before measuring. The figure carries no numbers; its order is what it shows, and the project's rule for sound bounds:
# none may have less than the surface itself, pixel for pixel.
LOOSER = Tolerance(at_least=1.0)
COVERED = Tolerance(at_most=0.0)

TEXT = """
Patches in the view whose projected box has the pixel's centre; black: none. Nothing is culled but by the frustum, so
both sides of the models count. *{surface}* is what the boxes are around: the triangles of the patches, front and back,
at factor {factor}. One scale a scene.

{told}

The scene `spikelog` ran in place of Spikelog: 96 patches, spikes longer than a patch is wide. The maps were made at
{size}; the figure shows every {step}th pixel, the numbers behind it those pixels with any box; the rows are of all
pixels.

NPATCH and TAYLOR are beyond the paper's figure. A box in the frame of its patch is not always smaller on the screen
than one along the axes: where displacement is large against the patch, its turned corners stick out further.
"""


class Maps(NamedTuple):
    """Maps of a scene by name, each int32[H, W]."""

    name: str
    values: dict[str, I32]


def overlap_maps(scene: Scene, name: str, frame: float) -> Maps:
    """The surface's depth complexity, and the overlap of each bound."""
    values = {SURFACE: depth_complexity_map(scene, Machine(), frame)}
    for bounds in BOUNDS:
        values[bounds] = overlap_map(scene, Machine(bounds=bounds, cull=("frustum",)), frame, exact=True)
    return Maps(name, values)


def _rows(maps: Maps) -> list[Row]:
    covered = maps.values[SURFACE] > 0
    mean = {name: float(values[covered].mean()) for name, values in maps.values.items()}
    rows = []
    for name in BOUNDS:
        ratio = mean[name] / mean[SURFACE]
        rows.append(Row(f"{maps.name}, {name} / surface: overlap where there is surface", None, ratio, "times", LOOSER))
    for name in BOUNDS:
        bare = int(np.count_nonzero(covered & (maps.values[name] == 0)))
        rows.append(Row(f"{maps.name}, {name}: pixels with surface and without a box", None, bare, "pixels", COVERED))
    area = {name: float(values.sum()) for name, values in maps.values.items()}
    for loose, tight in (("cbox", "obbtex"), ("obbtex", "tpatch"), ("tpatch", "npatch"), ("npatch", "taylor")):
        limit = None if tight == "taylor" else LOOSER  # at large displacement TAYLOR is as loose as OBBTEX
        rows.append(Row(f"{maps.name}, {loose} / {tight}: overlap", None, area[loose] / area[tight], "times", limit))
    return rows


def _table(found: list[Maps], step: int) -> dict[str, list[Any]]:
    """Every `step`th pixel over which anything lies."""
    table: dict[str, list[Any]] = {name: [] for name in ("scene", "x", "y", SURFACE, *BOUNDS)}
    for maps in found:
        parts = {name: values[step // 2 :: step, step // 2 :: step] for name, values in maps.values.items()}
        y, x = np.nonzero(np.max(list(parts.values()), axis=0))
        table["scene"] += [maps.name] * len(x)
        table["x"] += x.tolist()
        table["y"] += y.tolist()
        for name, values in parts.items():
            table[name] += values[y, x].tolist()
    return table


def _draw(table: dict[str, list[Any]], shape: tuple[int, int], figure: "Figure") -> None:
    scenes = list(dict.fromkeys(table["scene"]))
    names = (SURFACE, *BOUNDS)
    figure.set_size_inches(10.5, 4.25 * len(scenes))
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(h_pad=0.08)  # type: ignore[call-arg]
    for scene, part in zip(scenes, figure.subfigures(len(scenes), 1, squeeze=False)[:, 0], strict=True):
        panels = part.subplots(2, 3)
        rows = [k for k, name in enumerate(table["scene"]) if name == scene]
        x, y = (np.array([table[axis][k] for k in rows]) for axis in ("x", "y"))
        top = max(max(table[name][k] for k in rows) for name in names)
        view = _view(x, y, shape)
        for name, axes in zip(names, panels.flat, strict=True):
            values = np.zeros(shape, np.int64)
            values[y, x] = [table[name][k] for k in rows]
            image = _map(axes, values, top)
            axes.set_xlim(view[0], view[1])
            axes.set_ylim(view[3], view[2])
            axes.set_title(f"{scene}: the {name} itself" if name == SURFACE else name, loc="left", fontweight="bold")
            axes.text(
                0.985, 0.03, f"mean {values[values > 0].mean():.3g}, most {values.max()}", transform=axes.transAxes,
                ha="right", va="bottom", color="white", fontsize=7.5,
            )  # fmt: skip
        bar = part.colorbar(image, ax=panels, pad=0.01, aspect=30, shrink=0.96)
        bar.set_label("patches over a pixel")
        bar.outline.set_visible(False)


def _view(x: I32, y: I32, shape: tuple[int, int]) -> tuple[float, float, float, float]:
    """What of the picture to show, left right top bottom: all that has a box, and the picture's shape."""
    height, width = shape
    middle = (int(x.min()) + int(x.max())) / 2, (int(y.min()) + int(y.max())) / 2
    half = 0.53 * max(float(np.ptp(x)) + 1, (float(np.ptp(y)) + 1) * width / height)
    part = min(1.0, 2 * half / width)
    left = min(max(-0.5, middle[0] - part * width / 2), width - 0.5 - part * width)
    top = min(max(-0.5, middle[1] - part * height / 2), height - 0.5 - part * height)
    return left, left + part * width, top, top + part * height


def _map(axes: "Axes", values: np.ndarray, top: int) -> Any:
    """A map in false colour, the square root of the count; black where it is 0."""
    from matplotlib.colors import LinearSegmentedColormap, PowerNorm

    colors = LinearSegmentedColormap.from_list("counts", RAMP / 255).with_extremes(under="black")
    image = axes.imshow(values, cmap=colors, norm=PowerNorm(0.5, vmin=0.5, vmax=top), interpolation="nearest")
    axes.set_axis_off()
    return image


def run(context: Context) -> Result:
    """Maps of the frog, or of our creature, and of spikelog."""
    size = QUICK_SIZE if context.quick else SIZE
    step = max(1, size[0] // SHOWN)
    opened = open_model(context, "monsterfrog", size=size, factor=FACTOR)
    found = [overlap_maps(opened.scene, opened.name, 24 if not opened.original else 0)]
    context.update(0.6)
    found.append(overlap_maps(load_scene("spikelog", size=size, factor=FACTOR), "spikelog", 0))
    table = _table(found, step)
    units = {
        "scene": "model, or the built-in scene in its place",
        "x": f"pixel, in units of {step}",
        "y": f"pixel from above, in units of {step}",
        SURFACE: "triangles over the pixel, front and back faces",
        **dict.fromkeys(BOUNDS, "patches whose projected box has the pixel's centre"),
    }
    shape = found[0].values[SURFACE][step // 2 :: step, step // 2 :: step].shape
    rows = [row for maps in found for row in _rows(maps)]
    text = TEXT.format(told=opened.told, size="x".join(map(str, size)), step=step, surface=SURFACE, factor=FACTOR)
    return Result(tuple(rows), table, units, lambda figure: _draw(table, shape, figure), text)


ITEM = Item("munkberg2010", "figure-8", "Overlap of bounds in false colour", run)
