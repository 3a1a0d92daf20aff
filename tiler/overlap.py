"""Exact tile overlap: an item goes to those tiles of its pixel box that its outline reaches.

A triangle and a rectangle overlap if neither the rectangle's axes nor the triangle's edges separate them. The rectangle is
that of the samples which lie both in the tile and in the triangle's box, so the box is tested, too (integers, 1/256 pixel).

For a patch or a sub-domain the outline is the hull of its bound's clip corners on the screen. Every straight line through
two of the box's neighbouring corners gives two directions n; all of the hull lies in n . p <= c, c the largest value over
the corners. A tile wholly beyond one of these lines is left out. This is right for any n, so no hull need be built; the lines
that belong to edges of the hull make it exact. A corner counts as the rectangle of the window positions that its clip
coordinates may be off to (`slack`), widened by the rounding of the viewport transform and the snap (`pipeline.bounds.project`).
A box that is not surely in front of the eye, all of it, keeps its rectangle.
"""

import numpy as np

from pipeline.bounds.project import SNAP, U
from pipeline.jit import helper, kernel
from pipeline.types import I32, PatchBounds, Triangles, Viewport, Window
from tiler.binning import TileQueues, queue_items
from tiler.grid import Grid
from tiler.host import Host
from tiler.rasterizer import reaches_all, triangle_edges

NUM_LINES = 24  # 12 edges of a box, both sides


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


@helper
def _corner_ranges(corners, slack, viewport, box):
    """Window rectangle of each corner into box float64[8, 4] (x0, x1, y0, y1); False where one is not surely in front."""
    sx, sy, sz, sw = slack
    for k in range(8):
        x, y, z, w = corners[k]
        if not (z > 2.0 * sz and w > 2.0 * sw and abs(x) < np.inf and abs(y) < np.inf and w < np.inf):
            return False
        near, far = w - sw, w + sw
        lo_x, hi_x = min((x - sx) / near, (x - sx) / far), max((x + sx) / near, (x + sx) / far)
        lo_y, hi_y = min((-y - sy) / near, (-y - sy) / far), max((-y + sy) / near, (-y + sy) / far)
        box[k, 0], box[k, 1] = _widen(lo_x, hi_x, viewport.width, viewport.left)
        box[k, 2], box[k, 3] = _widen(lo_y, hi_y, viewport.height, viewport.top)
    return True


@helper
def _widen(lo, hi, size, offset):
    """Pixels of a range of normalized device coordinates, widened by rounding and snap as in `pipeline.bounds.project`."""
    a, b = (lo + 1.0) * 0.5 * size + offset, (hi + 1.0) * 0.5 * size + offset
    pad = 5.0 * U * (max(abs(a), abs(b)) + size + abs(offset)) + SNAP
    return a - pad, b + pad


@helper
def _make_lines(corners, slack, viewport, box, lines):
    """Lines (n_x, n_y, c) about the projected hull into lines float64[24, 3]; False where there are none to trust."""
    if not _corner_ranges(corners, slack, viewport, box):
        return False
    n = 0
    for k in range(8):
        for bit in range(3):
            if k & (1 << bit):
                continue
            other = k | (1 << bit)
            dx = (box[other, 0] + box[other, 1]) - (box[k, 0] + box[k, 1])
            dy = (box[other, 2] + box[other, 3]) - (box[k, 2] + box[k, 3])
            for side in range(2):
                nx, ny = (dy, -dx) if side == 0 else (-dy, dx)
                c, size = -np.inf, 0.0
                for j in range(8):
                    x, y = box[j, 1] if nx > 0.0 else box[j, 0], box[j, 3] if ny > 0.0 else box[j, 2]
                    c = max(c, nx * x + ny * y)
                    size = max(size, abs(nx * x) + abs(ny * y))
                lines[n, 0], lines[n, 1], lines[n, 2] = nx, ny, c + 1e-12 * size
                n += 1
    return True


@helper
def _reached(lines, x0, y0, x1, y1):
    """Whether pixels x0..x1, y0..y1 (inclusive) are beyond none of the lines."""
    left, top, right, bottom = np.float64(x0), np.float64(y0), np.float64(x1 + 1), np.float64(y1 + 1)
    for n in range(NUM_LINES):
        nx, ny = lines[n, 0], lines[n, 1]
        least = (nx * left if nx > 0.0 else nx * right) + (ny * top if ny > 0.0 else ny * bottom)
        if least - 1e-12 * (abs(nx) * right + abs(ny) * bottom) > lines[n, 2]:
            return False
    return True


@kernel
def _bin_hulls(begin, end, live, bounds, viewport, tile_log2, tiles_x, fill, place, item):
    box, lines = np.empty((8, 4)), np.empty((NUM_LINES, 3))
    for k in range(begin, end):
        x0, y0, x1, y1 = bounds.rect[live[k]]
        if x0 == x1:
            continue
        x1, y1 = x1 - 1, y1 - 1
        one = (x0 >> tile_log2) == (x1 >> tile_log2) and (y0 >> tile_log2) == (y1 >> tile_log2)
        has_lines = not one and _make_lines(bounds.corners[live[k]], bounds.slack[live[k]], viewport, box, lines)
        for ty in range(y0 >> tile_log2, (y1 >> tile_log2) + 1):
            for tx in range(x0 >> tile_log2, (x1 >> tile_log2) + 1):
                px0, py0 = max(np.int64(x0), tx << tile_log2), max(np.int64(y0), ty << tile_log2)
                px1 = min(np.int64(x1), ((tx + 1) << tile_log2) - 1)
                py1 = min(np.int64(y1), ((ty + 1) << tile_log2) - 1)
                if not has_lines or _reached(lines, px0, py0, px1, py1):
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
