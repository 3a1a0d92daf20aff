"""The back end: one tile's queue to pixels, for both binning modes.

`triangle`: the queue holds triangles that the front end has shaded and set up; they are rasterized in order.
`patch`: the queue holds patches; the modelled machine tessellates and shades each again in every tile (or takes its
points from the domain cache), clips and sets up its triangles, and rasterizes those that fall in the tile. The
simulator has shaded, set up and binned each patch's triangles once, because the result is the same bits; it *counts*
what the machine does: every event of a patch is added to the tile that causes it. A triangle in a tile whose queue lacks
its patch is not drawn, as the machine would not draw it: a bound that is too tight shows.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.pixel import Shade
from pipeline.primitives import NUM_OUTCOMES, Outcome
from pipeline.types import F32, I32, I64, U8
from tiler.rasterizer import rasterize
from tiler.shading import shade_tile


class TileCount(IntEnum):
    """Columns of the per-tile counters. The first NUM_OUTCOMES are those of `primitives.Outcome` (`patch` mode)."""

    QUEUE_ENTRIES = NUM_OUTCOMES
    DS_INVOCATIONS = NUM_OUTCOMES + 1
    TRIANGLES = NUM_OUTCOMES + 2  # set-up triangles whose box touches the tile
    OUTSIDE = NUM_OUTCOMES + 3  # `patch` mode: set-up triangles of the queue's patches that do not touch the tile
    SAMPLES_COVERED = NUM_OUTCOMES + 4  # each is one depth test
    SAMPLES_PASSED = NUM_OUTCOMES + 5
    PS_INVOCATIONS = NUM_OUTCOMES + 6
    PS_HELPERS = NUM_OUTCOMES + 7


NUM_TILE_COUNTS = NUM_OUTCOMES + len(TileCount)
_ENTRIES, _DS, _TRIANGLES, _OUTSIDE, _COVERED, _PASSED, _PS, _HELPERS = (int(c) for c in TileCount)
_SETUP = int(Outcome.SETUP)
TILE_GRID = int(Shade.TILE_GRID)


class Target(NamedTuple):
    """The render target. `visible` holds, within a batch, the triangle that is seen at each sample, -1 for none."""

    depth: F32  # (H, W, S)
    visible: I32  # (H, W, S)
    color: U8  # (H, W, S, 4) RGBA
    resolved: U8  # (H, W, 4); with one sample a view of `color`


class PatchWork(NamedTuple):
    """`patch` mode: what processing live patch k costs the machine, for replay in every tile that has it queued."""

    domain_points: I64  # (live,)
    shading_tile: I64  # (live,) the tile whose core shades it; -1: every tile does
    outcomes: I64  # (live, NUM_OUTCOMES)


@helper
def _clear(rect, background, target):
    for y in range(rect[1], rect[3] + 1):
        for x in range(rect[0], rect[2] + 1):
            for s in range(target.depth.shape[2]):
                target.depth[y, x, s] = 1.0
                for c in range(4):
                    target.color[y, x, s, c] = background[c]


@helper
def _forget_visible(rect, target):
    for y in range(rect[1], rect[3] + 1):
        for x in range(rect[0], rect[2] + 1):
            for s in range(target.depth.shape[2]):
                target.visible[y, x, s] = -1


@helper
def _replay_patch(k, tile, work, counts):
    """Count what the machine does for patch k in this tile before rasterization."""
    if work.shading_tile[k] < 0 or work.shading_tile[k] == tile:
        counts[_DS] += work.domain_points[k]
    for c in range(NUM_OUTCOMES):
        counts[c] += work.outcomes[k, c]


@helper
def _resolve(rect, target):
    """Average of a pixel's samples, rounded half up (19.2.4: the standard patterns weigh all samples alike)."""
    samples = target.depth.shape[2]
    for y in range(rect[1], rect[3] + 1):
        for x in range(rect[0], rect[2] + 1):
            for c in range(4):
                total = samples >> 1
                for s in range(samples):
                    total += np.int64(target.color[y, x, s, c])
                target.resolved[y, x, c] = total // samples


@helper
def _draw_grid(rect, target):
    """Tint the tile's first row and column."""
    for y in range(rect[1], rect[3] + 1):
        for x in range(rect[0], rect[2] + 1):
            if y == rect[1] or x == rect[0]:
                target.resolved[y, x, 0] = (np.int64(target.resolved[y, x, 0]) + 255) >> 1
                target.resolved[y, x, 1] = (np.int64(target.resolved[y, x, 1]) + 150) >> 1
                target.resolved[y, x, 2] = (np.int64(target.resolved[y, x, 2]) + 40) >> 1


@helper
def _rasterize_queue(
    tile, rect, by_patch, queue, triangle_queue, live, triangles, window, pattern, depth_range, target, counts
):  # fmt: skip
    """Rasterize the tile's triangles in submit order; in `patch` binning only those whose patch is queued here."""
    sample_x, sample_y, margin = pattern
    next_patch, end_patch = queue.first[tile], queue.first[tile + 1]
    for q in range(triangle_queue.first[tile], triangle_queue.first[tile + 1]):
        t = triangle_queue.item[q]
        if by_patch:
            patch = triangles.patch[t]
            while next_patch < end_patch and live[queue.item[next_patch]] < patch:
                next_patch += 1
            if next_patch == end_patch or live[queue.item[next_patch]] != patch:
                continue
        covered, passed, pixels, quads = rasterize(
            t, rect, triangles, window, sample_x, sample_y, margin, depth_range, target.depth, target.visible
        )
        counts[_TRIANGLES] += 1
        counts[_COVERED] += covered
        counts[_PASSED] += passed
        counts[_PS] += pixels
        counts[_HELPERS] += 4 * quads - pixels


@kernel
def process_tiles(
    begin, end, grid, by_patch, queue, triangle_queue, live, work, triangles, window, normal, pattern, depth_range,
    background, shading, light, first_batch, last_batch, target, counts,
    scratch,
):  # fmt: skip
    """Work off the queues of tiles begin .. end-1, and shade what is seen at the end.

    queue : the modelled machine's queues. triangle_queue : the batch's triangles by tile; in `triangle` binning the same.
    pattern : sample offsets x, y (int64[S], 1/256 pixel) and their reach. depth_range : float32 viewport depth range.
    counts : int64[tiles, NUM_TILE_COUNTS], added to. scratch : float32[pixel.SCRATCH]. `target` is modified in place.
    """
    tile_log2, tiles_x = grid.tile_log2, grid.tiles_x
    for tile in range(begin, end):
        x0, y0 = (tile % tiles_x) << tile_log2, (tile // tiles_x) << tile_log2
        rect = (x0, y0, min(x0 + (1 << tile_log2), grid.width) - 1, min(y0 + (1 << tile_log2), grid.height) - 1)
        if first_batch:
            _clear(rect, background, target)
        _forget_visible(rect, target)
        first, end_of_queue = queue.first[tile], queue.first[tile + 1]
        row, before = counts[tile], counts[tile, _TRIANGLES]
        row[_ENTRIES] += end_of_queue - first
        _rasterize_queue(
            tile, rect, by_patch, queue, triangle_queue, live, triangles, window, pattern, depth_range, target, row
        )
        if by_patch:
            for q in range(first, end_of_queue):
                _replay_patch(queue.item[q], tile, work, row)
                row[_OUTSIDE] += triangles.used[queue.item[q]]
            row[_OUTSIDE] -= row[_TRIANGLES] - before
        shade_tile(rect, triangles, window, normal, shading, light, target, scratch)
        if last_batch:
            if target.depth.shape[2] > 1:
                _resolve(rect, target)
            if shading == TILE_GRID:
                _draw_grid(rect, target)
