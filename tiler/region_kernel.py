"""Patches drawn one after the other in one part of the picture: shaded, set up and rasterized while they are in the cache.

For machines that make no test in their tiles and take triangles in submit order: what a tile draws is then decided by that
order alone, so nothing need wait in a queue. What a machine queues is counted all the same, triangle by triangle and tile by
tile. A region is a rectangle of whole tiles, and is given all patches whose bounds touch it.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from pipeline import domain, pixel, primitives
from pipeline.inside import UNKNOWN, Lanes, box_bits, make_lanes
from pipeline.jit import helper, inlined, kernel
from pipeline.prefetch import prefetch
from pipeline.primitives import NUM_OUTCOMES
from pipeline.types import F32, F64, I32, I64, U8, DomainPoints, Triangles, Window
from tiler.front_end import allocate_window
from tiler.rasterizer import IN_LOOP, depth_limits, fill_covered, fill_small, rasterize
from tiler.shading import shade_tile
from tiler.tile import TILE_GRID, TileCount, count_seen_in, draw_grid, forget_rect, resolve_rect

POINTS = 1 << 15  # domain points shaded together: they and their triangles stay in the second-level cache
TRIANGLES = 2 * POINTS
_NOT_BOUND = -(1 << 31)
LINE = 16  # pixels of 4 bytes in a line of the cache
SMALL_RECT = 1 << 12  # pixels of a patch that are worth asking for
ADDED = 1 << 15  # vertices, and triangles, that the clipper may add to them


class Ended(IntEnum):
    """How a region ended."""

    DRAWN = 0
    ESCAPED = 1  # a patch reaches out of its bounds
    FULL = 2  # the clipper made more than there is room for


_DRAWN, _ESCAPED, _FULL = (int(e) for e in Ended)
_ENTRIES, _TRIANGLES, _COVERED, _PASSED, _PS, _HELPERS = (
    int(c)
    for c in (
        TileCount.QUEUE_ENTRIES,
        TileCount.TRIANGLES,
        TileCount.SAMPLES_COVERED,
        TileCount.SAMPLES_PASSED,
        TileCount.PS_INVOCATIONS,
        TileCount.PS_HELPERS,
    )
)


class Picked(NamedTuple):
    """A region's patches; what is told of each, in places of its own, as others draw some of them, too."""

    place: I64  # (patches,) of each in the batch
    live: I32  # (patches,)
    rect: I32  # (patches, 4)
    outcomes: I64  # (patches, NUM_OUTCOMES)
    num_used: I64  # (patches,)


class Space(NamedTuple):
    """Scratch of one thread."""

    first_spare: I64  # (patches + 1,)
    cuts: I64  # (patches,)
    extents: I64  # (patches, 4)
    used: U8  # (vertices,)
    queued: I64  # (tiles,) entries of the patch at hand; 0 between patches
    shader: F32
    clipper: F64
    lanes_corner: I64
    lanes_rows: I64
    pixels: F32


class Room(NamedTuple):
    """What one thread needs for the patches of a region, and for the points and triangles of a group of them."""

    picked: Picked
    points: DomainPoints
    window: Window
    triangles: Triangles
    space: Space


def make_room(patches: int, most_points: int, most_triangles: int, num_tiles: int) -> Room:
    """Room for so many patches, of patterns of at most so many points and triangles, and for what the clipper adds to them."""
    points, lanes = max(POINTS, most_points), make_lanes(most_points)
    vertices, triangles = points + ADDED, max(TRIANGLES, most_triangles) + ADDED
    return Room(
        Picked(
            np.empty(patches, np.int64),
            np.empty(patches, np.int32),
            np.empty((patches, 4), np.int32),
            np.empty((patches, NUM_OUTCOMES), np.int64),
            np.empty(patches, np.int64),
        ),
        DomainPoints(
            np.empty(patches + 1, np.int64), np.empty((4, points), np.float32), np.empty((3, vertices), np.float32)
        ),
        allocate_window(vertices),
        Triangles(
            first=np.empty(patches + 1, np.int64),
            used=np.empty(patches, np.int32),
            vertex=np.empty((triangles, 3), np.int32),
            box=np.empty((triangles, 4), np.int16),
            cover=np.empty(triangles, np.uint16),
            edges=np.empty(triangles, np.uint8),
            patch=np.empty(triangles, np.int32),
            source=np.empty(triangles, np.int32),
        ),
        Space(
            np.empty(patches + 1, np.int64),
            np.empty(patches, np.int64),
            np.empty((patches, 4), np.int64),
            np.empty(vertices, np.uint8),
            np.zeros(num_tiles, np.int64),
            np.empty(domain.SCRATCH, np.float32),
            np.empty((2 * primitives.MAX_CORNERS, primitives.POLYGON)),
            lanes.corner,
            lanes.rows,
            np.empty(pixel.SCRATCH, np.float32),
        ),
    )


@inlined
def _touches(rect, k, region):
    """Whether rectangle k, ends exclusive, has pixels of the region, inclusive; one without pixels has none."""
    x0, y0 = max(rect[k, 0], region[0]), max(rect[k, 1], region[1])
    x1, y1 = min(rect[k, 2], region[2] + 1), min(rect[k, 3], region[3] + 1)
    return x0 < x1 and y0 < y1


@helper
def _pick(live, rect, region, takes_hidden, picked):
    """The patches that touch the region, and those without pixels if it takes them; how many."""
    n = 0
    for k in range(len(live)):
        hidden = rect[k, 0] >= rect[k, 2] or rect[k, 1] >= rect[k, 3]
        if takes_hidden if hidden else _touches(rect, k, region):
            picked.place[n], picked.live[n], picked.num_used[n] = k, live[k], 0
            for c in range(4):
                picked.rect[n, c] = rect[k, c]
            for c in range(NUM_OUTCOMES):
                picked.outcomes[n, c] = 0
            n += 1
    return n


@helper
def _tell(n, picked, outcomes, num_used):
    """What the n patches did, into the places of the batch: the same from each region that has a patch."""
    for i in range(n):
        k = picked.place[i]
        num_used[k] = picked.num_used[i]
        for c in range(NUM_OUTCOMES):
            outcomes[k, c] = picked.outcomes[i, c]


@helper
def _end_of_group(begin, end, live, patterns):
    """Patches begin .. the result - 1 have at most POINTS domain points together, or are one."""
    total = 0
    for k in range(begin, end):
        pattern = patterns.of_patch[live[k]]
        total += patterns.first_point[pattern + 1] - patterns.first_point[pattern]
        if total > POINTS and k > begin:
            return k
    return end


@helper
def _set_up(
    begin, end, picked, patches, patterns, maps, matrix, viewport, guard, bounds, margin, face_cull, points, window, triangles,
    space,
):  # fmt: skip
    """Domain shader and primitives of patches begin .. end-1, their triangles one after the other; how it ended."""
    live, first_spare, cuts = picked.live, space.first_spare, space.cuts
    points.first[begin] = 0
    for k in range(begin, end):
        pattern = patterns.of_patch[live[k]]
        points.first[k + 1] = points.first[k] + patterns.first_point[pattern + 1] - patterns.first_point[pattern]
    total = points.first[end]
    domain.shade_patches(begin, end, live, patches, patterns, maps, matrix, points, space.shader)
    primitives.project_points(points.first[begin], total, points.clip, viewport, guard, window)
    primitives.count_cuts(begin, end, live, patterns, points.first, window.code, cuts)
    spare = total
    for k in range(begin, end):
        first_spare[k] = spare
        spare += cuts[k] * primitives.MAX_CORNERS
    first_spare[end] = spare
    if spare - total > ADDED:
        return _FULL
    for v in range(spare):
        space.used[v] = 0
    t = 0
    lanes = Lanes(space.lanes_corner, space.lanes_rows)
    for k in range(begin, end):
        triangles.first[k] = t
        primitives.assemble(
            k, k + 1, live, patterns, points, first_spare, viewport, guard, bounds, margin, face_cull, window, triangles,
            picked.outcomes, space.used, picked.num_used, space.clipper, lanes,
        )  # fmt: skip
        t += triangles.used[k]
    triangles.first[end] = t
    return _DRAWN


@helper
def _draw_patch(
    first, last, extent, region, grid, triangles, window, pattern, depth_range, order, target, queued, counts
):  # fmt: skip
    """Rasterize triangles first .. last-1, a patch's, in the region; what they do is counted in the tiles.

    extent : the pixels x0, y0, x1, y1 of all boxes, inclusive. Returns the pairs of these triangles and tiles, in all regions.
    """
    sample_x, sample_y, margin = pattern
    left, top, right, bottom = region
    log2, tiles_x = grid.tile_log2, grid.tiles_x
    box, cover, vertex = triangles.box, triangles.cover, triangles.vertex
    xs, ys, zs = window.x, window.y, window.z
    width, depth, visible, stored = (
        target.depth.shape[1], target.depth.ravel(), target.visible.ravel(), target.order.ravel(),
    )  # fmt: skip
    one_sample = len(sample_x) == 1
    reaches_out = extent[0] < left or extent[1] < top or extent[2] > right or extent[3] > bottom
    pairs = 0
    for number in range(first, last):
        t = np.uint32(number)  # an index that may be negative costs a test
        x0, y0, x1, y1 = np.int64(box[t, 0]), np.int64(box[t, 1]), np.int64(box[t, 2]), np.int64(box[t, 3])
        bits, left0, top0 = np.int64(cover[t]), x0, y0
        known = one_sample and bits != UNKNOWN
        in_one = ((x0 ^ x1) | (y0 ^ y1)) >> log2 == 0
        pairs += 1 if in_one else ((x1 >> log2) - (x0 >> log2) + 1) * ((y1 >> log2) - (y0 >> log2) + 1)
        if reaches_out:
            x0, y0, x1, y1 = max(x0, left), max(y0, top), min(x1, right), min(y1, bottom)
            if x0 > x1 or y0 > y1:
                continue
            in_one = ((x0 ^ x1) | (y0 ^ y1)) >> log2 == 0
            if known:
                bits &= box_bits(x0 - left0, y0 - top0, x1 - left0, y1 - top0)
        tile = np.uint32((y0 >> log2) * tiles_x + (x0 >> log2))
        if bits == 0 and in_one:  # a queue entry, and no more
            queued[tile] += 1
            continue
        a, b, c = np.uint32(vertex[t, 0]), np.uint32(vertex[t, 1]), np.uint32(vertex[t, 2])
        lo, hi = depth_limits(zs[a], zs[b], zs[c], depth_range)
        if known and in_one:
            covered, passed, quads = fill_covered(
                bits, t, left0, top0, xs[a], ys[a], xs[b], ys[b], xs[c], ys[c], zs[a], zs[b], zs[c], lo, hi, width, depth,
                visible, False, order, stored,
            )  # fmt: skip
            queued[tile] += 1
            counts[tile, _COVERED] += covered
            counts[tile, _PASSED] += passed
            counts[tile, _PS] += passed
            counts[tile, _HELPERS] += 4 * quads - passed
            continue
        small = one_sample and x1 - x0 < IN_LOOP and y1 - y0 < IN_LOOP
        for ty in range(y0 >> log2, (y1 >> log2) + 1):
            for tx in range(x0 >> log2, (x1 >> log2) + 1):
                tile = np.uint32(ty * tiles_x + tx)
                tx0, ty0 = max(x0, tx << log2), max(y0, ty << log2)
                tx1, ty1 = min(x1, ((tx + 1) << log2) - 1), min(y1, ((ty + 1) << log2) - 1)
                if known:
                    covered, passed, quads = fill_covered(
                        bits & box_bits(tx0 - left0, ty0 - top0, tx1 - left0, ty1 - top0), t, left0, top0, xs[a], ys[a], xs[b],
                        ys[b], xs[c], ys[c], zs[a], zs[b], zs[c], lo, hi, width, depth, visible, False, order, stored,
                    )  # fmt: skip
                    pixels = passed
                elif small:
                    covered, passed, quads = fill_small(
                        t, tx0, ty0, tx1, ty1, xs[a], ys[a], xs[b], ys[b], xs[c], ys[c], zs[a], zs[b], zs[c], lo, hi, width,
                        depth, visible, False, order, stored,
                    )  # fmt: skip
                    pixels = passed
                else:
                    covered, passed, pixels, quads = rasterize(
                        t, tx0, ty0, tx1, ty1, triangles, window, sample_x, sample_y, margin, depth_range, target.depth,
                        target.visible, False, order, target.order,
                    )  # fmt: skip
                queued[tile] += 1
                counts[tile, _COVERED] += covered
                counts[tile, _PASSED] += passed
                counts[tile, _PS] += pixels
                counts[tile, _HELPERS] += 4 * quads - pixels
    return pairs


@inlined
def _extent_of(first, last, box):
    """Pixels x0, y0, x1, y1, inclusive, that hold the boxes of triangles first .. last-1; x0 > x1 if there are none."""
    x0, y0, x1, y1 = np.int16(32767), np.int16(32767), np.int16(-1), np.int16(-1)
    boxes = box[first:last]
    for k in range(len(boxes)):
        x0, y0, x1, y1 = min(x0, boxes[k, 0]), min(y0, boxes[k, 1]), max(x1, boxes[k, 2]), max(y1, boxes[k, 3])
    return np.int64(x0), np.int64(y0), np.int64(x1), np.int64(y1)


@inlined
def _holds(rect, k, extent):
    """Whether rectangle k, ends exclusive, holds all of an extent."""
    return extent[0] >= rect[k, 0] and extent[1] >= rect[k, 1] and extent[2] < rect[k, 2] and extent[3] < rect[k, 3]


@inlined
def _intersect(a, b):
    return max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])


@inlined
def _pixels(rects, k):
    """Row k: x0, y0, x1, y1."""
    return rects[k, 0], rects[k, 1], rects[k, 2], rects[k, 3]


@inlined
def _bound_group(begin, end, rect, region, triangles, extents):
    """The pixels of the region, inclusive, that hold the triangles of patches begin .. end-1; those of each in `extents`.

    x0 > x1 if there are none; x0 is _NOT_BOUND if a patch reaches out of its rectangle.
    """
    x0, y0, x1, y1 = region[2] + 1, region[3] + 1, region[0] - 1, region[1] - 1
    for k in range(begin, end):
        extent = _extent_of(triangles.first[k], triangles.first[k + 1], triangles.box)
        extents[k, 0], extents[k, 1], extents[k, 2], extents[k, 3] = extent
        if extent[0] > extent[2]:
            continue
        if not _holds(rect, k, extent):
            x0 = _NOT_BOUND
            break
        part = _intersect(extent, region)
        if part[0] <= part[2] and part[1] <= part[3]:
            x0, y0, x1, y1 = min(x0, part[0]), min(y0, part[1]), max(x1, part[2]), max(y1, part[3])
    return x0, y0, x1, y1


@inlined
def _fetch_ahead(extent, region, target):
    """Ask for the pixels of a small patch, which the processor cannot foresee, while the patch before it is drawn."""
    x0, y0, x1, y1 = _intersect(extent, region)
    x1, y1 = x1 + 1, y1 + 1
    if (x1 - x0) * (y1 - y0) > SMALL_RECT:
        return
    width, depth, visible = target.depth.shape[1], target.depth.ravel(), target.visible.ravel()
    for y in range(y0, y1):
        for x in range(x0 & -LINE, x1, LINE):
            prefetch(depth, y * width + x)
            prefetch(visible, y * width + x)


@helper
def _count_queues(patch, part, pairs, grid, queued, counts, most):
    """Add a patch's entries in each tile of pixels `part`, and remember the patch that fills a tile's queue most."""
    log2 = grid.tile_log2
    x0, y0, x1, y1 = part
    for ty in range(y0 >> log2, (y1 >> log2) + 1):
        for tx in range(x0 >> log2, (x1 >> log2) + 1):
            tile = ty * grid.tiles_x + tx
            n = queued[tile]
            if n > 0:
                queued[tile] = 0
                counts[tile, _ENTRIES] += n
                counts[tile, _TRIANGLES] += n
                if n > most[tile, 0] or (n == most[tile, 0] and pairs > most[tile, 1]):
                    most[tile, 0], most[tile, 1], most[tile, 2] = n, pairs, patch


@helper
def _count_seen(region, grid, counts, target):
    """How many samples of the region hold a triangle; in tiles where none was covered there is nothing to look for."""
    log2, seen = grid.tile_log2, 0
    for ty in range(region[1] >> log2, (region[3] >> log2) + 1):
        for tx in range(region[0] >> log2, (region[2] >> log2) + 1):
            if counts[ty * grid.tiles_x + tx, _COVERED] > 0:
                x0, y0 = tx << log2, ty << log2
                x1, y1 = min(x0 + (1 << log2) - 1, region[2]), min(y0 + (1 << log2) - 1, region[3])
                seen += count_seen_in((x0, y0, x1, y1), target)
    return seen


@kernel
def draw_region(
    live, rect, region, takes_hidden, patches, patterns, maps, matrix, viewport, guard, bounds, margin, face_cull, grid,
    pattern, depth_range, shading, light, last_batch, order, room, target, outcomes, num_used, counts, most, seen,
):  # fmt: skip
    """Draw those of the patches `live`, int32[n], that touch pixels region = (x0, y0, x1, y1), inclusive; how it `Ended`.

    They are drawn in submit order. rect : int32[n, 4], the pixels that hold each, ends exclusive. takes_hidden : whether
    patches without pixels are counted here. order : of no rows. room : a thread's own. target : depths and colours are
    clear before the first batch. outcomes : int64[n, NUM_OUTCOMES] and num_used : int64[n], as `primitives.assemble` counts
    them, of the patches drawn. counts : int64[tiles, NUM_TILE_COUNTS] and most : int64[tiles, 3], as in `tile.process_tiles`
    and `queue_lists.rank_owners`, changed for the region's tiles alone. seen : int64[1], after the last batch the samples of
    the region that hold a triangle. The others as in `primitives.assemble` and `process_tiles`; all are modified in place.
    """
    picked, points, window, triangles, space = room
    n, begin = _pick(live, rect, region, takes_hidden, picked), 0
    while begin < n:
        end = _end_of_group(begin, n, picked.live, patterns)
        ended = _set_up(
            begin, end, picked, patches, patterns, maps, matrix, viewport, guard, bounds, margin, face_cull, points, window,
            triangles, space,
        )  # fmt: skip
        if ended != _DRAWN:
            return ended
        drawn = _bound_group(begin, end, picked.rect, region, triangles, space.extents)
        if drawn[0] == _NOT_BOUND:
            return _ESCAPED
        if drawn[0] <= drawn[2]:
            forget_rect(drawn, target)
            for k in range(begin, end):
                if k + 1 < end and target.depth.shape[2] == 1:
                    _fetch_ahead(_pixels(space.extents, k + 1), region, target)
                first, last, extent = triangles.first[k], triangles.first[k + 1], _pixels(space.extents, k)
                part = _intersect(extent, region)
                if first == last or part[0] > part[2] or part[1] > part[3]:
                    continue
                pairs = _draw_patch(
                    first, last, extent, region, grid, triangles, window, pattern, depth_range, order, target, space.queued,
                    counts,
                )  # fmt: skip
                _count_queues(picked.live[k], part, pairs, grid, space.queued, counts, most)
            shade_tile(drawn, triangles, window, points.normal, shading, light, target, space.pixels)
        begin = end
    _tell(n, picked, outcomes, num_used)
    if last_batch:
        seen[0] = _count_seen(region, grid, counts, target)
        if target.depth.shape[2] > 1:
            resolve_rect(region, target)
        if shading == TILE_GRID:
            side = 1 << grid.tile_log2
            for y in range(region[1], region[3] + 1, side):
                for x in range(region[0], region[2] + 1, side):
                    draw_grid((x, y, min(x + side - 1, region[2]), min(y + side - 1, region[3])), target)
    return _DRAWN
