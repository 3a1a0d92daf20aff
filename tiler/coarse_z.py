"""The coarse Z pyramid: for each block of pixels the farthest and the nearest depth in it, and the same for 2x2 blocks, ...

Level 0 has a cell for each block of `2**block_log2` pixels a side, every level above halves their number, rounded up, until
one cell is left. So sizes that are no powers of two need no special case: a cell stands for the samples of the picture that
lie in it, and every cell has some. A tile is 2**tile_level blocks a side: up to that level each cell belongs to one tile,
which keeps it up to date by itself; the levels above are built between passes over the whole picture.

What is at least as far as `z` is hidden in every cell whose farthest depth is nearer (rasterization spec: Greene, Kass and
Miller 1993; Akenine-Moller, Haines and Hoffman, Real-Time Rendering, hierarchical Z). With LESS a primitive that comes later
in submit order also loses at equal depth; one that may come earlier does not: then the comparison must be strict.
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F32, I32, I64
from tiler.grid import Grid

CLEAR = np.float32(1.0)


class CoarseZ(NamedTuple):
    """The pyramid, packed: level k has width[k] x height[k] cells, row by row from first[k]."""

    farthest: F32  # (cells,)
    nearest: F32  # (cells,)
    first: I64  # (levels,)
    width: I64  # (levels,)
    height: I64  # (levels,)
    block_log2: int
    tile_level: int  # level at which a cell is a tile


def make_pyramid(grid: Grid, block: int) -> CoarseZ:
    """A pyramid over a cleared depth buffer. block : side in pixels, a power of two, at most a tile's."""
    width, height = -(-grid.width // block), -(-grid.height // block)
    sizes = [(width, height)]
    while sizes[-1] != (1, 1):
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    block_log2 = block.bit_length() - 1
    tile_level = grid.tile_log2 - block_log2
    sizes += [(1, 1)] * (tile_level + 1 - len(sizes))
    widths, heights = np.array(sizes, np.int64).T.copy()
    first = np.cumsum(widths * heights) - widths * heights
    cells = int((widths * heights).sum())
    return CoarseZ(
        np.full(cells, CLEAR), np.full(cells, CLEAR), first, widths, heights, block_log2, grid.tile_log2 - block_log2
    )


def depth_rows(depth: F32) -> I32:
    """The depths' bits, int32[H, W * S], a view: depths are not negative, so integers order them, and loops vectorize."""
    return depth.reshape(depth.shape[0], -1).view(np.int32)


@helper
def _block_range(rows, samples, x0, y0, x1, y1):
    """Bits of the farthest and nearest depth of pixels x0..x1, y0..y1."""
    far, near = np.int32(-(2**31)), np.int32(2**31 - 1)
    for y in range(y0, y1 + 1):
        row = rows[y, x0 * samples : (x1 + 1) * samples]
        for k in range(len(row)):
            far = max(far, row[k])
            near = min(near, row[k])
    return far, near


@helper
def recompute_block(coarse, rows, samples, bx, by, scratch):
    """Read all depths of block (bx, by), and set its cell anew; whether it changed. scratch : int32[2]."""
    side = np.int64(1) << coarse.block_log2
    x0, y0 = bx * side, by * side
    x1, y1 = min(x0 + side, rows.shape[1] // samples) - 1, min(y0 + side, rows.shape[0]) - 1
    scratch[0], scratch[1] = _block_range(rows, samples, x0, y0, x1, y1)
    depths = scratch.view(np.float32)
    cell = by * coarse.width[0] + bx
    changed = coarse.farthest[cell] != depths[0] or coarse.nearest[cell] != depths[1]
    coarse.farthest[cell], coarse.nearest[cell] = depths[0], depths[1]
    return changed


@helper
def _combine(coarse, level, cx, cy):
    """Farthest and nearest of the children of cell (cx, cy) of a level above 0; children beyond the border do not count."""
    below = level - 1
    far, near = np.float32(-np.inf), np.float32(np.inf)
    for y in range(2 * cy, min(2 * cy + 2, coarse.height[below])):
        for x in range(2 * cx, min(2 * cx + 2, coarse.width[below])):
            cell = coarse.first[below] + y * coarse.width[below] + x
            far, near = max(far, coarse.farthest[cell]), min(near, coarse.nearest[cell])
    return far, near


@helper
def propagate(coarse, bx, by, top):
    """Bring the cells above block (bx, by) up to level `top` up to date, as far as something changes."""
    for level in range(1, top + 1):
        cx, cy = bx >> level, by >> level
        far, near = _combine(coarse, level, cx, cy)
        cell = coarse.first[level] + cy * coarse.width[level] + cx
        if coarse.farthest[cell] == far and coarse.nearest[cell] == near:
            return
        coarse.farthest[cell], coarse.nearest[cell] = far, near


@kernel
def _build(coarse, rows, samples):
    scratch = np.empty(2, np.int32)
    for by in range(coarse.height[0]):
        for bx in range(coarse.width[0]):
            recompute_block(coarse, rows, samples, bx, by, scratch)
    for level in range(1, len(coarse.first)):
        for cy in range(coarse.height[level]):
            for cx in range(coarse.width[level]):
                cell = coarse.first[level] + cy * coarse.width[level] + cx
                coarse.farthest[cell], coarse.nearest[cell] = _combine(coarse, level, cx, cy)


def build(coarse: CoarseZ, depth: F32) -> None:
    """Set every cell of every level from the depths, float32[H, W, S]; `coarse` is modified in place."""
    _build(coarse, depth_rows(depth), depth.shape[2])


@helper
def hides(farthest, z, strict):
    """Whether something no nearer than z fails the depth test wherever depths are no farther than `farthest`."""
    return z > farthest or (z == farthest and not strict)


@helper
def _all_hide(coarse, level, cx0, cy0, cx1, cy1, z, strict):
    """Whether all these cells hide z, and how many were read until that was known."""
    cells = 0
    for cy in range(cy0, cy1 + 1):
        for cx in range(cx0, cx1 + 1):
            cells += 1
            if not hides(coarse.farthest[coarse.first[level] + cy * coarse.width[level] + cx], z, strict):
                return False, cells
    return True, cells


@helper
def first_level(coarse, x0, y0, x1, y1, top):
    """The lowest level, not above `top`, at which pixels x0..x1, y0..y1 span at most 2x2 cells."""
    log2 = coarse.block_log2
    level = 0
    while level < top and (
        (x1 >> (log2 + level)) - (x0 >> (log2 + level)) > 1 or (y1 >> (log2 + level)) - (y0 >> (log2 + level)) > 1
    ):
        level += 1
    return level


@helper
def hidden_at(coarse, x0, y0, x1, y1, z, strict, top):
    """Level at which pixels x0..x1, y0..y1 (inclusive, in the picture) are seen to hide z, -1 for none; cells read.

    Starts at `first_level`, and goes down to the blocks.
    """
    level = first_level(coarse, x0, y0, x1, y1, top)
    cells = 0
    while level >= 0:
        shift = coarse.block_log2 + level
        hidden, read = _all_hide(
            coarse, level, x0 >> shift, y0 >> shift, x1 >> shift, y1 >> shift, z, strict
        )  # fmt: skip
        cells += read
        if hidden:
            return level, cells
        level -= 1
    return -1, cells
