"""The back end: one tile's queue to pixels, for all binning modes.

`triangle`: the queue holds triangles that the front end has shaded and set up; they are rasterized in order.
`patch`, `subpatch`: the queue holds units, which are patches or sub-domains of them; the modelled machine tessellates and
shades each again in every tile (or takes its points from the domain cache), clips and sets up its triangles, and rasterizes
those that fall in the tile. The simulator has shaded, set up and binned each unit's triangles once, because the result is
the same bits; it *counts* what the machine does: every event of a unit is added to the tile that causes it. A triangle in a
tile whose queue lacks its unit is not drawn, as the machine would not draw it: a bound that is too tight shows.

Coarse Z: before a queue entry is worked on, its rectangle in the tile is tested against the pyramid; then, if the machine
does so, each of its triangles, and each block that a triangle's box touches. With feedback `tile` the pyramid of the tile is
brought up to date after each entry.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from pipeline.inside import UNKNOWN, box_bits
from pipeline.jit import helper, inlined, kernel
from pipeline.pixel import Shade
from pipeline.primitives import NUM_OUTCOMES
from pipeline.types import F32, F64, I32, I64, U8
from tiler.coarse_z import hidden_at, hides, propagate, recompute_block
from tiler.near_planes import nearest_in
from tiler.occlusion import hidden_hull
from tiler.rasterizer import IN_LOOP, depth_limits, fill_covered, fill_small, rasterize
from tiler.shading import shade_tile


class TileCount(IntEnum):
    """Columns of the per-tile counters. The first NUM_OUTCOMES are those of `primitives.Outcome` (not in `triangle` mode)."""

    QUEUE_ENTRIES = NUM_OUTCOMES
    DS_INVOCATIONS = NUM_OUTCOMES + 1
    TRIANGLES = NUM_OUTCOMES + 2  # set-up triangles that the rasterizer walks in the tile
    OUTSIDE = (
        NUM_OUTCOMES + 3
    )  # not in `triangle` mode: set-up triangles of the queue's units that do not touch the tile
    SAMPLES_COVERED = NUM_OUTCOMES + 4  # each is one depth test
    SAMPLES_PASSED = NUM_OUTCOMES + 5
    PS_INVOCATIONS = NUM_OUTCOMES + 6
    PS_HELPERS = NUM_OUTCOMES + 7
    PAIRS_TESTED = NUM_OUTCOMES + 8
    PAIRS_OCCLUDED = NUM_OUTCOMES + 9
    TRIANGLES_TESTED = NUM_OUTCOMES + 10
    TRIANGLES_OCCLUDED = NUM_OUTCOMES + 11
    BLOCKS_TESTED = NUM_OUTCOMES + 12
    BLOCKS_OCCLUDED = NUM_OUTCOMES + 13
    BLOCKS_ACCEPTED = NUM_OUTCOMES + 14
    CELLS_READ = NUM_OUTCOMES + 15
    HITS_0 = NUM_OUTCOMES + 16  # pairs and triangles found hidden at level 0, 1, 2, 3 or above
    HITS_1 = NUM_OUTCOMES + 17
    HITS_2 = NUM_OUTCOMES + 18
    HITS_3 = NUM_OUTCOMES + 19
    UPDATES = NUM_OUTCOMES + 20
    CACHE_LOOKUPS = NUM_OUTCOMES + 21
    CACHE_HITS = NUM_OUTCOMES + 22
    OUTLINES_TESTED = NUM_OUTCOMES + 23
    OUTLINES_MISSED = NUM_OUTCOMES + 24


NUM_TILE_COUNTS = NUM_OUTCOMES + len(TileCount)
(
    _ENTRIES, _DS, _TRIANGLES, _OUTSIDE, _COVERED, _PASSED, _PS, _HELPERS, _PAIRS, _PAIRS_HIDDEN, _TESTED, _HIDDEN, _BLOCKS,
    _BLOCKS_HIDDEN, _BLOCKS_ACCEPTED, _CELLS, _HITS, _, _, _, _UPDATES, _, _, _OUTLINES,
    _MISSES,
) = (int(c) for c in TileCount)  # fmt: skip
TILE_GRID = int(Shade.TILE_GRID)


class Target(NamedTuple):
    """The render target. `visible` holds, within a batch, the triangle that is seen at each sample, -1 for none.

    Between batches a tile whose first sample says -1 shows nothing of the batch before; where it shows something, but not at
    its first sample, that says STALE, which is none too.

    `order`: the submit number (`tiler/order.py`) of what is seen at each sample at the end of a batch, -1 for none; of shape
    (0, 0, 0) where nobody asks for it.
    """

    depth: F32  # (H, W, S)
    visible: I32  # (H, W, S)
    color: U8  # (H, W, S, 4) RGBA
    resolved: U8  # (H, W, 4); with one sample a view of `color`
    order: I64  # (H, W, S) or (0, 0, 0)


class Rules(NamedTuple):
    """How a phase of the frame works off its queues."""

    by_unit: bool  # queues hold patches or sub-domains, not triangles
    ties: bool  # triangles may come out of submit order: the depth test compares submit numbers, coarse Z is strict
    pairs: bool  # the tests against coarse Z: queue entries,
    triangles: bool  # triangles of units,
    blocks: bool  # blocks of a triangle's box
    hulls: bool  # a unit is tested by its hull, not by its rectangle (`tiler/occlusion.py`)
    update: int  # one of KEEP, RECOMPUTE, FEED_FORWARD


KEEP, RECOMPUTE, FEED_FORWARD = 0, 1, 2
STALE = -2


class Work(NamedTuple):
    """What a tile must know of each unit of the batch; of no rows in `triangle` binning."""

    rect: I32  # (live, 4) pixels x0 y0 x1 y1, ends exclusive
    z_min: F32  # (live,)
    planes: F64  # (live, near_planes.MOST, 3) planes under its bound
    corners: F64  # (live, 8, 4) of its bound in clip space, and
    slack: F64  # (live, 4) what these may be off; of no rows where units are not tested by their hulls
    outcomes: I64  # (live, NUM_OUTCOMES) what its clipping and set-up gives, for replay in every tile that works on it


class Touched(NamedTuple):
    """Scratch: blocks of a tile in which the queue entry at hand wrote depths. One for each thread."""

    stamp: I64  # (blocks,) the last entry that wrote there
    block: I32  # (blocks + 1,) how many, and their places in the tile
    bits: I32  # (2,) for `recompute_block`


@inlined
def _set(values, begin, end, value):
    """A run of a flat array: the loop becomes a fill, as no index into a part of it is from the end."""
    part = values[begin:end]
    for k in range(len(part)):
        part[k] = value


@helper
def clear_rect(rect, background, target):
    """Clear pixels rect = (x0, y0, x1, y1), inclusive. background : uint8[4]."""
    width, samples = target.depth.shape[1:]
    depth, visible, order = target.depth.ravel(), target.visible.ravel(), target.order.ravel()
    color, value = target.color.view(np.uint32).ravel(), background.view(np.uint32)[0]
    for y in range(rect[1], rect[3] + 1):
        begin, end = (y * width + rect[0]) * samples, (y * width + rect[2] + 1) * samples
        _set(depth, begin, end, np.float32(1.0))
        _set(visible, begin, end, np.int32(-1))
        _set(color, begin, end, value)
        if order.size:
            _set(order, begin, end, np.int64(-1))


@kernel
def clear_samples(depth, color, value):
    """Clear depths, float32, and colours, uint32, both flat."""
    _set(depth, 0, len(depth), np.float32(1.0))
    _set(color, 0, len(color), value)


@inlined
def _count_near(depth):
    far, seen = np.float32(1.0), 0
    for k in range(len(depth)):
        seen += depth[k] < far
    return seen


@kernel
def count_seen(depth):
    """How many samples of depth, float32, flat, hold a triangle."""
    return _count_near(depth)


@helper
def count_seen_in(rect, target):
    """How many samples of pixels rect = (x0, y0, x1, y1), inclusive, hold a triangle."""
    width, samples = target.depth.shape[1:]
    depth, seen = target.depth.ravel(), 0
    for y in range(rect[1], rect[3] + 1):
        seen += _count_near(depth[(y * width + rect[0]) * samples : (y * width + rect[2] + 1) * samples])
    return seen


@helper
def forget_rect(rect, target):
    """Forget which triangles are seen in these pixels."""
    width, samples = target.depth.shape[1:]
    visible = target.visible.ravel()
    for y in range(rect[1], rect[3] + 1):
        _set(visible, (y * width + rect[0]) * samples, (y * width + rect[2] + 1) * samples, np.int32(-1))


@helper
def _forget_visible(rect, target):
    """Forget what the batch before showed, if the tile's first sample says that it may have shown something."""
    if target.visible[rect[1], rect[0], 0] != -1:
        forget_rect(rect, target)


@helper
def _store_order(rect, order, target):
    """Keep the submit numbers of what this batch shows."""
    for y in range(rect[1], rect[3] + 1):
        for x in range(rect[0], rect[2] + 1):
            for s in range(target.depth.shape[2]):
                if target.visible[y, x, s] >= 0:
                    target.order[y, x, s] = order[target.visible[y, x, s]]


@helper
def resolve_rect(rect, target):
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
def draw_grid(rect, target):
    """Tint the tile's first row and column."""
    for y in range(rect[1], rect[3] + 1):
        for x in range(rect[0], rect[2] + 1):
            if y == rect[1] or x == rect[0]:
                target.resolved[y, x, 0] = (np.int64(target.resolved[y, x, 0]) + 255) >> 1
                target.resolved[y, x, 1] = (np.int64(target.resolved[y, x, 1]) + 150) >> 1
                target.resolved[y, x, 2] = (np.int64(target.resolved[y, x, 2]) + 40) >> 1


@helper
def _hidden(box, z, rules, coarse, counts):
    """Test pixels `box`, inclusive, against the tile's pyramid."""
    level, cells = hidden_at(coarse, box[0], box[1], box[2], box[3], z, rules.ties, coarse.tile_level)
    counts[_CELLS] += cells
    if level >= 0:
        counts[_HITS + min(level, 3)] += 1
    return level >= 0


@helper
def _touch(box, rect, entry, coarse, touched):
    """Note the blocks of `box` for the end of the queue entry."""
    log2 = coarse.block_log2
    left, top = rect[0] >> log2, rect[1] >> log2
    for by in range(box[1] >> log2, (box[3] >> log2) + 1):
        for bx in range(box[0] >> log2, (box[2] >> log2) + 1):
            place = ((by - top) << coarse.tile_level) + bx - left
            if touched.stamp[place] != entry:
                touched.stamp[place] = entry
                touched.block[0] += 1
                touched.block[touched.block[0]] = place


@helper
def _refresh(rect, coarse, rows, samples, touched, counts):
    """Recompute the blocks that were written, and what stands above them in the tile."""
    log2 = coarse.block_log2
    left, top = rect[0] >> log2, rect[1] >> log2
    for i in range(1, touched.block[0] + 1):
        place = np.int64(touched.block[i])
        bx, by = left + (place & ((1 << coarse.tile_level) - 1)), top + (place >> coarse.tile_level)
        if recompute_block(coarse, rows, samples, bx, by, touched.bits):
            propagate(coarse, bx, by, coarse.tile_level)
        counts[_UPDATES] += 1
    touched.block[0] = 0


@helper
def _merge(bx, by, lo, hi, covers, rules, coarse, counts):
    """After a triangle of depths lo..hi wrote to a block: the nearest depth at once, as it must not be too high."""
    cell = by * coarse.width[0] + bx
    changed = lo < coarse.nearest[cell]
    if changed:
        coarse.nearest[cell] = lo
    if rules.update == FEED_FORWARD and covers and hi < coarse.farthest[cell]:
        coarse.farthest[cell] = hi
        counts[_UPDATES] += 1
        changed = True
    if changed:
        propagate(coarse, bx, by, coarse.tile_level)


@helper
def _test_block(bx, by, lo, hi, rules, coarse, counts):
    """Whether a triangle of depths lo..hi is hidden in block (bx, by)."""
    cell = by * coarse.width[0] + bx
    counts[_BLOCKS] += 1
    hidden = hides(coarse.farthest[cell], lo, rules.ties)
    counts[_BLOCKS_HIDDEN] += hidden
    counts[_BLOCKS_ACCEPTED] += not hidden and hi < coarse.nearest[cell]
    return hidden


@helper
def _triangle_hidden(box, lo, rules, coarse, counts):
    """Test a triangle, or a queue entry that is one."""
    hidden = _hidden(box, lo, rules, coarse, counts)
    counts[_TESTED if rules.by_unit else _PAIRS] += 1
    counts[_HIDDEN if rules.by_unit else _PAIRS_HIDDEN] += hidden
    return hidden


@helper
def _unit_hidden(k, box, rules, work, viewport, coarse, sketch, counts):
    """Test unit k, pixels `box` of it, against the tile's pyramid."""
    if not rules.hulls:
        nearest = nearest_in(work.planes[k], work.z_min[k], box[0], box[1], box[2], box[3])
        return _hidden(box, nearest, rules, coarse, counts)
    level, cells, asked, missed = hidden_hull(
        coarse, box, work.z_min[k], work.planes[k], work.corners[k], work.slack[k], viewport, rules.ties,
        coarse.tile_level, sketch,
    )  # fmt: skip
    counts[_CELLS] += cells
    counts[_OUTLINES] += asked
    counts[_MISSES] += missed
    if level >= 0:
        counts[_HITS + min(level, 3)] += 1
    return level >= 0


@helper
def _begin_unit(k, q, rect, rules, work, viewport, triangles, coarse, sketch, outcome, counts):
    """Test unit k against coarse Z; whether it is hidden. If it is not, count what the tile does for it."""
    if rules.pairs:
        r = work.rect[k]
        box = (max(r[0], rect[0]), max(r[1], rect[1]), min(r[2] - 1, rect[2]), min(r[3] - 1, rect[3]))
        counts[_PAIRS] += 1
        if _unit_hidden(k, box, rules, work, viewport, coarse, sketch, counts):
            counts[_PAIRS_HIDDEN] += 1
            outcome[q] = 1
            return True
    for c in range(NUM_OUTCOMES):
        counts[c] += work.outcomes[k, c]
    counts[_OUTSIDE] += triangles.used[k]
    return False


@helper
def _draw_blocks(
    t, rect, x0, y0, x1, y1, lo, hi, rules, triangles, window, order, pattern, depth_range, target, coarse, counts
):  # fmt: skip
    """Rasterize triangle t block by block of the pyramid, which is tested and brought up to date; what `rasterize` says."""
    sample_x, sample_y, margin = pattern
    log2 = coarse.block_log2
    covered, passed, pixels, quads = 0, 0, 0, 0
    for by in range(y0 >> log2, (y1 >> log2) + 1):
        for bx in range(x0 >> log2, (x1 >> log2) + 1):
            if rules.blocks and _test_block(bx, by, lo, hi, rules, coarse, counts):
                continue
            left, top = bx << log2, by << log2
            right, bottom = min(left + (1 << log2) - 1, rect[2]), min(top + (1 << log2) - 1, rect[3])
            n, m, p, q = rasterize(
                t, max(x0, left), max(y0, top), min(x1, right), min(y1, bottom), triangles, window, sample_x, sample_y,
                margin, depth_range, target.depth, target.visible, rules.ties, order, target.order,
            )  # fmt: skip
            if m > 0:
                whole = n == (right - left + 1) * (bottom - top + 1) * len(sample_x)
                _merge(bx, by, lo, hi, whole, rules, coarse, counts)
            covered += n
            passed += m
            pixels += p
            quads += q
    return covered, passed, pixels, quads


@helper
def _work_off(
    tile, rect, rules, queue, triangle_queue, work, viewport, triangles, order, window, pattern, depth_range, target,
    coarse, rows, touched, sketch, outcome, counts,
):  # fmt: skip
    """Work off the tile's queue in order; the rows in which something passed. Of a unit those triangles are drawn that are
    binned to the tile.

    All that a small triangle needs stands in this function, as scalars and flat arrays with names of their own: a call for
    each triangle would count references to the arrays up and down, which takes as long as the triangle.
    """
    sample_x, sample_y, margin = pattern
    left, top, right, bottom = rect
    by_unit, ties = rules.by_unit, rules.ties
    by_blocks = rules.blocks or rules.update == FEED_FORWARD
    test_triangles = rules.triangles or (rules.pairs and not by_unit)
    at_once = len(sample_x) == 1 and not by_blocks
    item, box, cover, vertex = triangle_queue.item, triangles.box, triangles.cover, triangles.vertex
    xs, ys, zs = window.x, window.y, window.z
    width, depth, visible, stored = (
        target.depth.shape[1],
        target.depth.ravel(),
        target.visible.ravel(),
        target.order.ravel(),
    )
    first_row, last_row = bottom + 1, top - 1
    taken, drawn, sum_covered, sum_passed, sum_pixels, sum_quads = 0, 0, 0, 0, 0, 0
    place, end = triangle_queue.first[tile], triangle_queue.first[tile + 1]
    for q in range(queue.first[tile], queue.first[tile + 1]):
        first, last = np.int64(queue.item[q]), np.int64(queue.item[q]) + 1
        if by_unit:
            k = queue.item[q]
            first, last = triangles.first[k], triangles.first[k + 1]
            while place < end and item[place] < first:
                place += 1
            if _begin_unit(k, q, rect, rules, work, viewport, triangles, coarse, sketch, outcome, counts):
                continue
        while place < end and item[place] < last:
            t = item[place]
            place += 1
            taken += 1
            x0, y0 = max(np.int64(box[t, 0]), left), max(np.int64(box[t, 1]), top)
            x1, y1 = min(np.int64(box[t, 2]), right), min(np.int64(box[t, 3]), bottom)
            a, b, c = vertex[t, 0], vertex[t, 1], vertex[t, 2]
            z_a, z_b, z_c = zs[a], zs[b], zs[c]
            lo, hi = depth_limits(z_a, z_b, z_c, depth_range)
            if test_triangles and _triangle_hidden((x0, y0, x1, y1), lo, rules, coarse, counts):
                continue
            drawn += 1
            bits = np.int64(cover[t])
            known = at_once and bits != UNKNOWN
            if known:
                left0, top0 = np.int64(box[t, 0]), np.int64(box[t, 1])
                if x0 > left0 or y0 > top0 or x1 < box[t, 2] or y1 < box[t, 3]:
                    bits &= box_bits(x0 - left0, y0 - top0, x1 - left0, y1 - top0)
                if bits == 0:
                    continue
                covered, passed, quads = fill_covered(
                    bits, t, left0, top0, xs[a], ys[a], xs[b], ys[b], xs[c], ys[c], z_a, z_b, z_c, lo, hi, width, depth,
                    visible, ties, order, stored,
                )  # fmt: skip
                pixels = passed
            elif at_once and x1 - x0 < IN_LOOP and y1 - y0 < IN_LOOP:
                covered, passed, quads = fill_small(
                    t, x0, y0, x1, y1, xs[a], ys[a], xs[b], ys[b], xs[c], ys[c], z_a, z_b, z_c, lo, hi, width, depth,
                    visible, ties, order, stored,
                )  # fmt: skip
                pixels = passed
            elif by_blocks:
                covered, passed, pixels, quads = _draw_blocks(
                    t, rect, x0, y0, x1, y1, lo, hi, rules, triangles, window, order, pattern, depth_range, target, coarse,
                    counts,
                )  # fmt: skip
            else:
                covered, passed, pixels, quads = rasterize(
                    t, x0, y0, x1, y1, triangles, window, sample_x, sample_y, margin, depth_range, target.depth,
                    target.visible, ties, order, target.order,
                )  # fmt: skip
            sum_covered += covered
            if passed > 0:
                sum_passed += passed
                sum_pixels += pixels
                sum_quads += quads
                first_row, last_row = min(first_row, y0), max(last_row, y1)
                if rules.update == RECOMPUTE:
                    _touch((x0, y0, x1, y1), rect, q, coarse, touched)
        if rules.update == RECOMPUTE:
            _refresh(rect, coarse, rows, target.depth.shape[2], touched, counts)
    counts[_ENTRIES] += queue.first[tile + 1] - queue.first[tile]
    counts[_TRIANGLES] += drawn
    if by_unit:
        counts[_OUTSIDE] -= taken
    counts[_COVERED] += sum_covered
    counts[_PASSED] += sum_passed
    counts[_PS] += sum_pixels
    counts[_HELPERS] += 4 * sum_quads - sum_pixels
    return first_row, last_row


@kernel
def process_tiles(
    begin, end, grid, rules, queue, triangle_queue, work, viewport, triangles, order, window, normal, pattern, depth_range,
    background, shading, light, first_batch, last_batch, target, coarse, rows, touched, sketch, outcome, counts, scratch,
):  # fmt: skip
    """Work off the queues of tiles begin .. end-1, and shade what is seen at the end.

    queue : the modelled machine's queues. triangle_queue : the batch's triangles by tile; in `triangle` binning the same.
    order : int64[T], submit numbers of the triangles; of no rows where neither ties nor `target.order` need them.
    pattern : sample offsets x, y (int64[S], 1/256 pixel) and their reach. depth_range : float32 viewport depth range.
    rows : `coarse_z.depth_rows` of the target. outcome : uint8[entries], set to 1 where coarse Z hid a queued unit.
    counts : int64[tiles, NUM_TILE_COUNTS], added to. scratch : float32[pixel.SCRATCH]. `target`, `coarse` modified in place.
    """
    tile_log2, tiles_x = grid.tile_log2, grid.tiles_x
    for tile in range(begin, end):
        x0, y0 = (tile % tiles_x) << tile_log2, (tile // tiles_x) << tile_log2
        rect = (x0, y0, min(x0 + (1 << tile_log2), grid.width) - 1, min(y0 + (1 << tile_log2), grid.height) - 1)
        if not first_batch:
            _forget_visible(rect, target)
        elif tile == begin or x0 == 0:  # all tiles of this row of tiles at once: long runs, which stay in the cache
            in_row = min(end - tile, tiles_x - tile % tiles_x)
            clear_rect((x0, y0, min(x0 + (in_row << tile_log2), grid.width) - 1, rect[3]), background, target)
        if queue.first[tile] < queue.first[tile + 1]:
            first_row, last_row = _work_off(
                tile, rect, rules, queue, triangle_queue, work, viewport, triangles, order, window, pattern, depth_range,
                target, coarse, rows, touched, sketch, outcome, counts[tile],
            )  # fmt: skip
            if first_row <= last_row:
                drawn = (x0, first_row, rect[2], last_row)
                shade_tile(drawn, triangles, window, normal, shading, light, target, scratch)
                if target.order.size:
                    _store_order(drawn, order, target)
                if not last_batch and target.visible[y0, x0, 0] == -1:
                    target.visible[y0, x0, 0] = STALE
        if last_batch:
            if target.depth.shape[2] > 1:
                resolve_rect(rect, target)
            if shading == TILE_GRID:
                draw_grid(rect, target)
