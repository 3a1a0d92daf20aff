"""A second drawing of the frame beside the first, for blame: what each queue entry covered, and what hid it when it came.

The tile loop counts what the machine does; why a tile's work was for nothing it need not know. Where blame is asked for, each
pass is drawn once more here, into depths and submit numbers of its own, entry by entry and sample by sample: an entry that
coarse Z hid is drawn too, which changes nothing. Of an entry that passes no sample it is asked what a better test would have
said at that moment, of depths that are no older than the moment.
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F32, I32, I64, U8, Viewport
from tiler.back_end import Bins
from tiler.coarse_z import hides
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.host import Host
from tiler.near_planes import nearest_in, planes_under
from tiler.occlusion import make_sketch
from tiler.outline import make_lines, reached
from tiler.rasterizer import SAMPLE_X, SAMPLE_Y
from tiler.units import Units

# Bits of what is noted of an entry.
COVERED = 1  # it covers a sample of the tile
PASSED = 2  # a sample of it passed the depth test
FRESH = 4  # none did, and its own bound is behind all depths of the blocks that its rectangle, or hull, touches
TRUE = 8  # none did, and so are the box and the nearest vertex of its triangles in the tile
TESTED = 16  # the machine tested it, or its unit, against a pyramid


class Film(NamedTuple):
    """What the second drawing shows."""

    depth: F32  # (H, W, S)
    order: I64  # (H, W, S) submit number of what is seen, -1 for none


@helper
def _edge(window, a, b):
    """dx, dy, and the value of the edge function at (0, 0), lowered by 1 where samples on the edge are outside."""
    x0, y0 = np.int64(window.x[a]), np.int64(window.y[a])
    dx, dy = np.int64(window.x[b]) - x0, np.int64(window.y[b]) - y0
    top_left = dy < 0 or (dy == 0 and dx > 0)
    return dx, dy, dy * x0 - dx * y0, 0 if top_left else -1


@helper
def _draw(t, box, triangles, window, order, sample_x, sample_y, film):
    """Draw triangle t into pixels `box`, inclusive; bits COVERED and PASSED."""
    a, b, c = triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2]
    dx0, dy0, c0, b0 = _edge(window, b, c)
    dx1, dy1, c1, b1 = _edge(window, c, a)
    dx2, dy2, c2, b2 = _edge(window, a, b)
    area = np.float64(c0 + dx0 * window.y[a] - dy0 * window.x[a])
    z0, z1, z2 = window.z[a], window.z[b], window.z[c]
    base = np.float64(z0)
    along1, along2 = (np.float64(z1) - base) / area, (np.float64(z2) - base) / area
    lo, hi = min(z0, z1, z2), max(z0, z1, z2)
    one, zero = np.float32(1.0), np.float32(0.0)
    bits = 0
    for y in range(box[1], box[3] + 1):
        for x in range(box[0], box[2] + 1):
            for s in range(len(sample_x)):
                px, py = (x << 8) + 128 + sample_x[s], (y << 8) + 128 + sample_y[s]
                e0 = c0 + dx0 * py - dy0 * px
                e1 = c1 + dx1 * py - dy1 * px
                e2 = c2 + dx2 * py - dy2 * px
                if ((e0 + b0) | (e1 + b1) | (e2 + b2)) < 0:
                    continue
                bits |= COVERED
                z = np.float32(base + (np.float64(e1) * along1 + np.float64(e2) * along2))
                z = min(max(min(max(z, lo), hi), zero), one)
                d = film.depth[y, x, s]
                if z < d or (z == d and order[t] < film.order[y, x, s]):
                    film.depth[y, x, s], film.order[y, x, s] = z, order[t]
                    bits |= PASSED
    return bits


@helper
def _farthest(bx, by, rect, block_log2, film):
    """The farthest depth, as it is now, in a block of the tile."""
    far = np.float32(0.0)
    for y in range(by << block_log2, min(((by + 1) << block_log2) - 1, rect[3]) + 1):
        for x in range(bx << block_log2, min(((bx + 1) << block_log2) - 1, rect[2]) + 1):
            for s in range(film.depth.shape[2]):
                far = max(far, film.depth[y, x, s])
    return far


@helper
def _behind(box, rect, z, strict, block_log2, film):
    """Whether z is hidden by the farthest depth, as it is now, of each block of the tile that `box` touches."""
    for by in range(box[1] >> block_log2, (box[3] >> block_log2) + 1):
        for bx in range(box[0] >> block_log2, (box[2] >> block_log2) + 1):
            if not hides(_farthest(bx, by, rect, block_log2, film), z, strict):
                return False
    return True


@helper
def _hull_behind(box, rect, z_min, planes, corners, slack, viewport, strict, block_log2, sketch, film):
    """Whether each block of the tile that `box` touches is not reached by the outline of a bound, or hides its depth there."""
    has_lines = make_lines(corners, slack, viewport, sketch.corner, sketch.line)
    for by in range(box[1] >> block_log2, (box[3] >> block_log2) + 1):
        for bx in range(box[0] >> block_log2, (box[2] >> block_log2) + 1):
            part = _clip(box, (
                bx << block_log2, by << block_log2, ((bx + 1) << block_log2) - 1, ((by + 1) << block_log2) - 1
            ))  # fmt: skip
            if has_lines and not reached(sketch.line, part[0], part[1], part[2], part[3]):
                continue
            nearest = nearest_in(planes, z_min, part[0], part[1], part[2], part[3])
            if not hides(_farthest(bx, by, rect, block_log2, film), nearest, strict):
                return False
    return True


@helper
def _clip(box, rect):
    return (
        max(np.int64(box[0]), rect[0]), max(np.int64(box[1]), rect[1]),
        min(np.int64(box[2]), rect[2]), min(np.int64(box[3]), rect[3]),
    )  # fmt: skip


@kernel
def _watch(
    begin, end, grid, by_unit, by_hull, strict, block_log2, queue, triangle_queue, units, bounds, planes, viewport, triangles,
    order, window, sample_x, sample_y, film, sketch, bits,
):  # fmt: skip
    for tile in range(begin, end):
        x0, y0 = (tile % grid.tiles_x) << grid.tile_log2, (tile // grid.tiles_x) << grid.tile_log2
        side = 1 << grid.tile_log2
        rect = (x0, y0, min(x0 + side, grid.width) - 1, min(y0 + side, grid.height) - 1)
        place, last = triangle_queue.first[tile], triangle_queue.first[tile + 1]
        for q in range(queue.first[tile], queue.first[tile + 1]):
            if not by_unit:
                t = queue.item[q]
                bits[q] = _draw(t, _clip(triangles.box[t], rect), triangles, window, order, sample_x, sample_y, film)
                continue
            k = queue.item[q]
            while place < last and triangle_queue.item[place] < triangles.first[k]:
                place += 1
            found, nearest = 0, np.float32(1.0)
            left, top, right, bottom = rect[2], rect[3], rect[0], rect[1]
            while place < last and triangle_queue.item[place] < triangles.first[k + 1]:
                t = triangle_queue.item[place]
                place += 1
                box = _clip(triangles.box[t], rect)
                found |= _draw(t, box, triangles, window, order, sample_x, sample_y, film)
                left, top, right, bottom = min(left, box[0]), min(top, box[1]), max(right, box[2]), max(bottom, box[3])
                for c in range(3):
                    nearest = min(nearest, max(window.z[triangles.vertex[t, c]], np.float32(0.0)))
            if found == COVERED:  # nothing was written, so the depths are those from before
                u = units[k]
                r, z_min = bounds.rect[u], bounds.z_min[u]
                box = _clip((r[0], r[1], r[2] - 1, r[3] - 1), rect)
                if by_hull:
                    corners, slack = bounds.corners[u], bounds.slack[u]
                    fresh = _hull_behind(
                        box, rect, z_min, planes[k], corners, slack, viewport, strict, block_log2, sketch, film
                    )
                else:
                    bound = nearest_in(planes[k], z_min, box[0], box[1], box[2], box[3])
                    fresh = _behind(box, rect, bound, strict, block_log2, film)
                if fresh:
                    found |= FRESH
                if _behind((left, top, right, bottom), rect, nearest, strict, block_log2, film):
                    found |= TRUE
            bits[q] = found


class Watched(NamedTuple):
    """A pass of a batch. `unit`: number of the unit, or the patch of the triangle, of each entry; `bits`: as above."""

    number: int
    first: I64  # (tiles+1,)
    unit: I64  # (entries,)
    bits: U8  # (entries,)


class Watch:
    """The second drawing, pass by pass."""

    def __init__(self, grid: Grid, samples: int, block: int, by_unit: bool, strict: bool, by_hull: bool) -> None:
        """block : side of coarse Z's blocks, pixels. strict : coarse Z hides only what is strictly farther. by_hull : the
        machine tests units by their hulls."""
        shape = (grid.height, grid.width, samples)
        self.film = Film(np.ones(shape, np.float32), np.full(shape, -1, np.int64))
        self.grid, self.samples, self.block_log2 = grid, samples, block.bit_length() - 1
        self.by_unit, self.strict, self.by_hull = by_unit, strict, by_hull
        self.passes: list[Watched] = []

    def draw(
        self,
        number: int,
        bins: Bins,
        batch: I32,
        units: Units,
        geometry: Geometry,
        order: I64,
        tested: bool,
        host: Host,
    ) -> None:
        """Draw pass `number` of a batch of units. order : int64[T]. tested : its units were tested against coarse Z."""
        bits = np.zeros(len(bins.queue.item), np.uint8)
        chunks = host.chunks(self.grid.num_tiles)
        sample_x, sample_y = SAMPLE_X[self.samples], SAMPLE_Y[self.samples]

        viewport = Viewport(0, 0, self.grid.width, self.grid.height, 0.0, 1.0)
        planes = planes_under(batch if self.by_unit else batch[:0], units.bounds, viewport)

        def work(c: int) -> None:
            _watch(
                *chunks[c], self.grid, self.by_unit, self.by_hull, self.strict, self.block_log2, bins.queue,
                bins.triangles, batch, units.bounds, planes, viewport, geometry.triangles, order, geometry.window,
                sample_x, sample_y, self.film, make_sketch(), bits,
            )  # fmt: skip

        host.run(work, len(chunks))
        item = bins.queue.item
        unit = batch[item] if self.by_unit else geometry.triangles.patch[item]
        if tested:
            bits |= TESTED
        self.passes.append(Watched(number, bins.queue.first, unit.astype(np.int64), bits))
