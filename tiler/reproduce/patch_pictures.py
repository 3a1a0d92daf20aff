"""Which patch is seen at each pixel, as text that a table can hold, and pictures that paint patches by what became of them.

The machine draws depth alone: the scene once with all patches, and once for each bit of a patch's number with those that
have the bit. Where a depth of the second kind equals that of the first, the patch that is seen has the bit.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.types import F64, I32, U8
from tiler.config import Machine
from tiler.scene.model import Scene
from tiler.simulation import simulate

DRAWN = Machine(binning="triangle", cull=())
FACTOR = 6.0  # of the pictures: facets of a pixel or two
AMBIENT = 0.45


def seen_patches(scene: Scene, threads: int | None) -> I32:
    """Number of the patch seen at each pixel of a plain scene's picture, -1 where there is none: int32[H, W]."""
    scene = replace(scene, tessellation=replace(scene.tessellation, factor=(FACTOR,) * 6, edge_pixels=None))
    _, numbers = np.unique(scene.control_points.reshape(scene.num_patches, -1), axis=0, return_index=True)
    numbers = np.sort(numbers)  # the first of patches that are the same: the depth cannot tell them apart
    scene = _some(scene, numbers)
    depth = simulate(scene, DRAWN, threads=threads).depth
    rank = np.zeros(depth.shape, np.int64)
    for bit in range(int(len(numbers) - 1).bit_length()):
        having = np.flatnonzero((np.arange(len(numbers)) >> bit) & 1)
        rank[simulate(_some(scene, having), DRAWN, threads=threads).depth == depth] |= 1 << bit
    drawn = (depth < 1.0) & (rank < len(numbers))  # two patches at the same depth may name one that is not
    return np.where(drawn, numbers[np.minimum(rank, len(numbers) - 1)], -1).astype(np.int32)


def _some(scene: Scene, numbers: np.ndarray) -> Scene:
    """A plain scene's patches of these numbers."""
    return replace(
        scene,
        control_points=np.ascontiguousarray(scene.control_points[numbers]),
        texcoords=np.ascontiguousarray(scene.texcoords[numbers]),
        map_id=scene.map_id[numbers],
        object_id=scene.object_id[numbers],
    )


def spans_of(seen: I32, patches: int) -> list[str]:
    """For each patch the pixels in which it is seen, as `row:first-last` with blanks between; empty where in none."""
    spans: list[list[str]] = [[] for _ in range(patches)]
    for y, row in enumerate(seen):
        starts = np.flatnonzero(np.diff(row, prepend=-2))
        for first, end in zip(starts, [*starts[1:], len(row)], strict=True):
            if row[first] >= 0:
                spans[row[first]].append(f"{y}:{first}-{end - 1}")
    return [" ".join(of_patch) for of_patch in spans]


def paint(spans: Sequence[str], colors: F64, light: Sequence[float], size: tuple[int, int] | None = None) -> U8:
    """Picture uint8[H, W, 4] of patches in their colours, clear elsewhere; cut to what is seen without a size (W, H).

    colors : float64[P, 3], 0 to 1. light : 0 to 1, of each patch.
    """
    parts = [
        (int(y), *map(int, run.split("-")), p)
        for p, text in enumerate(spans)
        for y, run in (span.split(":") for span in text.split())
    ]
    if size is not None:
        x0, y0, x1, y1 = 0, 0, size[0] - 1, size[1] - 1
    elif parts:
        y0, x0 = min(part[0] for part in parts), min(part[1] for part in parts)
        y1, x1 = max(part[0] for part in parts), max(part[2] for part in parts)
    else:
        x0 = y0 = x1 = y1 = 0
    picture = np.zeros((y1 - y0 + 1, x1 - x0 + 1, 4), np.uint8)
    lit = np.asarray(colors) * (AMBIENT + (1.0 - AMBIENT) * np.asarray(light, np.float64)[:, None])
    for y, first, last, p in parts:
        picture[y - y0, first - x0 : last - x0 + 1, :3] = np.rint(255.0 * lit[p])
        picture[y - y0, first - x0 : last - x0 + 1, 3] = 255
    return picture


def show(axes: Any, picture: U8) -> None:
    """A picture without axes about it."""
    axes.imshow(picture, interpolation="antialiased")
    axes.set_axis_off()
