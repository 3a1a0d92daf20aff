"""Exact tile overlap: an item goes to those tiles of its pixel box that its outline reaches.

A triangle and a rectangle overlap if neither the rectangle's axes nor the triangle's edges separate them. The rectangle is
that of the samples which lie both in the tile and in the triangle's box, so the box is tested, too (integers, 1/256 pixel).

For a patch or a sub-domain the outline is that of its bound on the screen (`tiler/outline.py`). A bound that has none keeps
its rectangle.
"""

import numpy as np

from pipeline.jit import kernel
from pipeline.types import I32, PatchBounds, Triangles, Viewport, Window
from tiler.binning import TileQueues, queue_items
from tiler.grid import Grid
from tiler.host import Host
from tiler.outline import NUM_LINES, make_lines, reached
from tiler.rasterizer import reaches_all, triangle_edges


@kernel
def _bin_triangles(begin, end, triangles, window, margin, tile_log2, tiles_x, fill, place, item):
    """Count the pairs of triangles of units begin .. end-1 in `place`, or fill `item` from there."""
    for k in range(begin, end):
        for t in range(triangles.first[k], triangles.first[k] + triangles.used[k]):
            x0, y0, x1, y1 = triangles.box[t]
            edges, _ = triangle_edges(window, triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2])
            one = (x0 >> tile_log2) == (x1 >> tile_log2) and (y0 >> tile_log2) == (y1 >> tile_log2)
            for ty in range(y0 >> tile_log2, (y1 >> tile_log2) + 1):
                for tx in range(x0 >> tile_log2, (x1 >> tile_log2) + 1):
                    px0, py0 = max(np.int64(x0), tx << tile_log2), max(np.int64(y0), ty << tile_log2)
                    px1 = min(np.int64(x1), ((tx + 1) << tile_log2) - 1)
                    py1 = min(np.int64(y1), ((ty + 1) << tile_log2) - 1)
                    if one or reaches_all(edges, px0, py0, px1, py1, margin):
                        tile = ty * tiles_x + tx
                        if fill:
                            item[place[tile]] = t
                        place[tile] += 1


def bin_triangles(triangles: Triangles, window: Window, grid: Grid, margin: int, host: Host) -> TileQueues:
    """Bin all set-up triangles by exact overlap. margin : reach of the sample pattern, 1/256 pixel.

    A triangle whose box lies in one tile goes there without a test.
    """

    def walk(begin: int, end: int, fill: bool, place: np.ndarray, item: I32) -> None:
        _bin_triangles(begin, end, triangles, window, margin, grid.tile_log2, grid.tiles_x, fill, place, item)

    return queue_items(len(triangles.used), walk, grid, host)


@kernel
def _bin_hulls(begin, end, live, bounds, viewport, tile_log2, tiles_x, fill, place, item):
    box, lines = np.empty((8, 4)), np.empty((NUM_LINES, 3))
    for k in range(begin, end):
        x0, y0, x1, y1 = bounds.rect[live[k]]
        if x0 == x1:
            continue
        x1, y1 = x1 - 1, y1 - 1
        one = (x0 >> tile_log2) == (x1 >> tile_log2) and (y0 >> tile_log2) == (y1 >> tile_log2)
        has_lines = not one and make_lines(bounds.corners[live[k]], bounds.slack[live[k]], viewport, box, lines)
        for ty in range(y0 >> tile_log2, (y1 >> tile_log2) + 1):
            for tx in range(x0 >> tile_log2, (x1 >> tile_log2) + 1):
                px0, py0 = max(np.int64(x0), tx << tile_log2), max(np.int64(y0), ty << tile_log2)
                px1 = min(np.int64(x1), ((tx + 1) << tile_log2) - 1)
                py1 = min(np.int64(y1), ((ty + 1) << tile_log2) - 1)
                if not has_lines or reached(lines, px0, py0, px1, py1):
                    tile = ty * tiles_x + tx
                    if fill:
                        item[place[tile]] = k
                    place[tile] += 1


def bin_hulls(live: I32, bounds: PatchBounds, grid: Grid, host: Host) -> TileQueues:
    """Bin the units `live` by the projected hull of their bounds; items are places in `live`."""
    viewport = Viewport(0, 0, grid.width, grid.height, 0.0, 1.0)

    def walk(begin: int, end: int, fill: bool, place: np.ndarray, item: I32) -> None:
        _bin_hulls(begin, end, live, bounds, viewport, grid.tile_log2, grid.tiles_x, fill, place, item)

    return queue_items(len(live), walk, grid, host)
