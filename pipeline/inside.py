"""Set-up of the triangles of patches that lie inside the frustum, which are most of all: in runs, lane by lane.

What becomes of a small triangle is decided by chance: it may face away, or lie between samples, so branches for each are
branches missed. A run of triangles goes through three loops instead: one fetches the corners, one decides for all at once, in
vectors, and one keeps those that go on (compact.py). Only these are written.
"""

from typing import NamedTuple

import numpy as np

from pipeline.compact import compact
from pipeline.jit import helper, inlined
from pipeline.types import I64, FaceCull
from pipeline.vector_width import prefer_wide

CULL_FRONT, CULL_BACK = int(FaceCull.FRONT), int(FaceCull.BACK)
BACK_FACE = 8  # bit of Triangles.edges beside the three edge bits

RUN = 256  # triangles: their rows stay in the first-level cache
A, B, C, X0, Y0, X1, Y1, TURNED, NUMBER, COVER, ALIVE = (k * RUN for k in range(11))
SCRATCH = 11 * RUN
KEPT = (A, B, C, X0, Y0, X1, Y1, TURNED, NUMBER)  # rows of what goes on

ONE, TWO = np.uint32(1), np.uint32(2)
SIDE = 4  # pixels a side of the boxes of which Triangles.cover says what is covered
UNKNOWN = 0xFFFF  # it is not known; no triangle covers the centres of 4x4 pixels and has a box as small as that


NARROW = 1 << 15  # 1/256 pixel: the lanes of a smaller patch are half as wide


class Lanes(NamedTuple):
    """Scratch of one thread."""

    corner: I64  # (points of the largest pattern,) of the patch at hand, 16.8 fixed point
    rows: I64  # (SCRATCH,)


def make_lanes(most_points: int) -> Lanes:
    """Scratch for patterns of at most so many points."""
    return Lanes(np.empty(most_points, np.int64), np.empty(SCRATCH, np.int64))


@inlined
def _extent(values):
    """Least and greatest of int32 values."""
    least, greatest = values[0], values[0]
    for k in range(len(values)):
        least, greatest = min(least, values[k]), max(greatest, values[k])
    return least, greatest


@inlined
def _pack(xs, ys, x, y, half, corner):
    """Both window coordinates of each point, relative to (x, y), in one word of `corner`: a triangle fetches three words.

    half : bits of a word's half, which holds x in its lower part.
    """
    lane = corner.dtype.type
    for i in range(len(corner)):
        corner[i] = (lane(ys[i] - y) << half) | (lane(xs[i] - x) & ((lane(1) << half) - 1))


@inlined
def _x(word, half, lane):
    """x of a word of `_pack`."""
    return lane(lane(word << half) >> half)


@inlined
def _y(word, half, lane):
    return lane(word >> half)


@inlined
def _fetch(first, n, indices, corner, rows):
    """Rows A, B, C: the corners of triangles first .. first+n-1."""
    numbers = indices[3 * first : 3 * (first + n)]
    for i in range(n):
        k = np.uint32(3 * i)  # an index that may be negative costs a test
        rows[A + i], rows[B + i], rows[C + i] = corner[numbers[k]], corner[numbers[k + ONE]], corner[numbers[k + TWO]]


@inlined
def _decide(n, half, origin, rows, bounds, margin, face_cull):
    """Rows X0 .. Y1: boxes; ALIVE: whether a triangle goes on; TURNED: whether it is counter-clockwise; NUMBER: in the run.

    Returns how many have no area, face the wrong way, hold no sample, lie off the screen: each in the first of these.
    """
    lane = rows.dtype.type
    left, top, right, bottom = lane(bounds[0]), lane(bounds[1]), lane(bounds[2]), lane(bounds[3])
    pa, pb, pc = rows[A : A + n], rows[B : B + n], rows[C : C + n]
    out_x0, out_y0, out_x1, out_y1 = rows[X0 : X0 + n], rows[Y0 : Y0 + n], rows[X1 : X1 + n], rows[Y1 : Y1 + n]
    alive, turned, number = rows[ALIVE : ALIVE + n], rows[TURNED : TURNED + n], rows[NUMBER : NUMBER + n]
    drop_back, drop_front = lane(face_cull == CULL_BACK), lane(face_cull == CULL_FRONT)
    first_x, first_y = lane(origin[0] + 127 - margin), lane(origin[1] + 127 - margin)
    last_x, last_y = lane(origin[0] - 128 + margin), lane(origin[1] - 128 + margin)
    one, nil = lane(1), lane(0)  # truth values are numbers of this width: else the loop would work in wider ones
    zero_area, culled, no_sample, offscreen = nil, nil, nil, nil
    for i in range(n):
        xa, ya = _x(pa[i], half, lane), _y(pa[i], half, lane)
        xb, yb = _x(pb[i], half, lane), _y(pb[i], half, lane)
        xc, yc = _x(pc[i], half, lane), _y(pc[i], half, lane)
        area = lane(lane(xb - xa) * lane(yc - ya)) - lane(lane(yb - ya) * lane(xc - xa))
        area = lane(area)
        zero, back = one if area == nil else nil, one if area < nil else nil
        wrong = lane(((back & drop_back) | ((one - back) & drop_front)) & (one - zero))
        x0, y0 = lane(lane(min(xa, xb, xc) + first_x) >> 8), lane(lane(min(ya, yb, yc) + first_y) >> 8)
        x1, y1 = lane(lane(max(xa, xb, xc) + last_x) >> 8), lane(lane(max(ya, yb, yc) + last_y) >> 8)
        faces = lane((one - zero) & (one - wrong))
        empty = (one if x0 > x1 else nil) | (one if y0 > y1 else nil)
        x0, y0, x1, y1 = max(x0, left), max(y0, top), min(x1, right), min(y1, bottom)
        out = (one if x0 > x1 else nil) | (one if y0 > y1 else nil)
        out_x0[i], out_y0[i], out_x1[i], out_y1[i] = x0, y0, x1, y1
        turned[i], number[i] = back, i
        alive[i] = faces & (one - (empty | out))
        zero_area = lane(zero_area + zero)
        culled = lane(culled + wrong)
        no_sample = lane(no_sample + lane(faces & empty))
        offscreen = lane(offscreen + lane(faces & out & (one - empty)))
    return np.int64(zero_area), np.int64(culled), np.int64(no_sample), np.int64(offscreen)


@inlined
def _turn(n, rows):
    """Corners of n triangles clockwise from here on; the first one stays."""
    turned, b, c = rows[TURNED : TURNED + n], rows[B : B + n], rows[C : C + n]
    for k in range(n):
        back = turned[k] != 0
        b[k], c[k] = c[k] if back else b[k], b[k] if back else c[k]


@inlined
def _bias(dx, dy):
    """0 where a sample exactly on the edge is inside (a top or a left edge), else -1."""
    return -np.int64((dy > 0) | ((dy == 0) & (dx <= 0)))


@inlined
def _edges(k, half, origin, pa, pb, pc, x0, y0):
    """Of a clockwise triangle dx, dy of three edges and their values, biased, at the centre of pixel (x0, y0).

    As in `tiler.rasterizer`, top-left rule. In 32 bits, which hold them for boxes of SIDE x SIDE pixels; of others they are
    nonsense, and not used.
    """
    lane = pa.dtype.type
    x, y = (x0[k] << 8) + 128 - origin[0], (y0[k] << 8) + 128 - origin[1]
    px, py = np.int32(_x(pa[k], half, lane) - x), np.int32(_y(pa[k], half, lane) - y)  # corners from that centre
    qx, qy = np.int32(_x(pb[k], half, lane) - x), np.int32(_y(pb[k], half, lane) - y)
    rx, ry = np.int32(_x(pc[k], half, lane) - x), np.int32(_y(pc[k], half, lane) - y)
    dx0, dy0, dx1, dy1 = np.int32(rx - qx), np.int32(ry - qy), np.int32(px - rx), np.int32(py - ry)
    dx2, dy2 = np.int32(qx - px), np.int32(qy - py)
    e0 = np.int32(dy0 * qx - dx0 * qy + _bias(dx0, dy0))
    e1 = np.int32(dy1 * rx - dx1 * ry + _bias(dx1, dy1))
    e2 = np.int32(dy2 * px - dx2 * py + _bias(dx2, dy2))
    return (dx0, dx1, dx2), (dy0, dy1, dy2), (e0, e1, e2)


@inlined
def _move(values, steps, pixels):
    """Edge values so many pixels on, to the left (steps: dy) or down (dx)."""
    return (
        np.int32(values[0] + (steps[0] << 8) * pixels),
        np.int32(values[1] + (steps[1] << 8) * pixels),
        np.int32(values[2] + (steps[2] << 8) * pixels),
    )


@inlined
def _covered(values):
    """1 where no edge value is negative, else 0."""
    return np.int32((np.int32(values[0] | values[1] | values[2]) >> 31) + 1)


@inlined
def _two(values, dy):
    """Bits of a pixel and the next to the right."""
    return np.int32(_covered(values) | (_covered(_move(values, dy, -1)) << 1))


@inlined
def _four(values, dy):
    """Bits of a pixel and the next three to the right."""
    return np.int32(_two(values, dy) | (_two(_move(values, dy, -2), dy) << 2))


@inlined
def box_bits(first_column, first_row, last_column, last_row):
    """Bits of `types.Triangles.cover` that belong to pixels of a rectangle within the box, columns and rows 0 .. SIDE - 1."""
    columns = ((2 << (last_column - first_column)) - 1) << first_column
    rows = ((16 << (4 * (last_row - first_row))) - 1) << (4 * first_row)
    return columns * 0x1111 & rows


@inlined
def _cover_at_most_two(n, half, origin, pa, pb, pc, x0, y0, x1, y1, cover):
    """As `_cover_at_most_four`, where no box has more than 2x2 pixels."""
    for k in range(n):
        dx, dy, values = _edges(k, half, origin, pa, pb, pc, x0, y0)
        bits = _two(values, dy) | (_two(_move(values, dx, 1), dy) << 4)
        cover[k] = bits & box_bits(0, 0, x1[k] - x0[k], y1[k] - y0[k])


@inlined
def _cover_at_most_four(n, half, origin, pa, pb, pc, x0, y0, x1, y1, cover):
    for k in range(n):
        dx, dy, values = _edges(k, half, origin, pa, pb, pc, x0, y0)
        wide, high = x1[k] - x0[k], y1[k] - y0[k]
        bits = _four(values, dy) | (_four(_move(values, dx, 1), dy) << 4)
        bits |= (_four(_move(values, dx, 2), dy) << 8) | (_four(_move(values, dx, 3), dy) << 12)
        bits &= box_bits(0, 0, min(wide, SIDE - 1), min(high, SIDE - 1))
        cover[k] = bits if (wide | high) < SIDE else UNKNOWN


@inlined
def _cover(n, half, origin, rows):
    """Row COVER, as `types.Triangles.cover` has it, of n clockwise triangles."""
    pa, pb, pc = rows[A : A + n], rows[B : B + n], rows[C : C + n]
    x0, y0, x1, y1 = rows[X0 : X0 + n], rows[Y0 : Y0 + n], rows[X1 : X1 + n], rows[Y1 : Y1 + n]
    cover = rows[COVER : COVER + n]
    sizes = np.int64(0)
    for k in range(n):
        sizes |= (x1[k] - x0[k]) | (y1[k] - y0[k])
    if sizes < 2:
        _cover_at_most_two(n, half, origin, pa, pb, pc, x0, y0, x1, y1, cover)
    else:
        _cover_at_most_four(n, half, origin, pa, pb, pc, x0, y0, x1, y1, cover)


@inlined
def _write(n, patch, before, margin, rows, box, cover, edges, patches, source):
    """What vectors can write of n triangles. before : numbers of the pattern's triangles before this run."""
    for k in range(n):
        box[k, 0], box[k, 1], box[k, 2], box[k, 3] = rows[X0 + k], rows[Y0 + k], rows[X1 + k], rows[Y1 + k]
    if margin == 0:
        for k in range(n):
            cover[k] = rows[COVER + k]
    else:
        for k in range(n):
            cover[k] = UNKNOWN
    for k in range(n):
        edges[k] = 7 + BACK_FACE * rows[TURNED + k]
    for k in range(n):
        patches[k] = patch
    for k in range(n):
        source[k] = before + rows[NUMBER + k]


@inlined
def _set_up_runs(
    half, origin, corner, rows, patch, first, last, base, indices, bounds, margin, face_cull, vertex, box, cover, edges,
    patches, source, t, used,
):  # fmt: skip
    """`set_up_inside` for corners that are packed, in lanes as wide as a word of `corner` and `rows`."""
    zero_area, culled, no_sample, offscreen = 0, 0, 0, 0
    for begin in range(first, last, RUN):
        n = min(RUN, last - begin)
        _fetch(begin, n, indices, corner, rows)
        zero, wrong, empty, out = _decide(n, half, origin, rows, bounds, margin, face_cull)
        zero_area += zero
        culled += wrong
        no_sample += empty
        offscreen += out
        if zero + wrong + empty + out == n:
            continue
        found = compact(rows, ALIVE, 0, n, 0, KEPT)
        _turn(found, rows)
        if margin == 0:  # samples lie at the pixels' centres
            _cover(found, half, origin, rows)
        for k in range(found):
            s, at = begin + np.int64(rows[NUMBER + k]), np.uint32(t + k)
            number = np.uint32(3 * s)
            a, b, c = indices[number], indices[number + ONE], indices[number + TWO]
            a, b, c = np.uint32(a + base), np.uint32(b + base), np.uint32(c + base)
            used[a], used[b], used[c] = 1, 1, 1
            back = rows[TURNED + k] != 0
            vertex[at, 0], vertex[at, 1], vertex[at, 2] = a, c if back else b, b if back else c
        _write(found, patch, begin - first, margin, rows, box[t:], cover[t:], edges[t:], patches[t:], source[t:])
        t += found
    return t, zero_area, culled, no_sample, offscreen


@helper
def set_up_inside(
    patch, first, last, base, num_points, indices, xs, ys, bounds, margin, face_cull, vertex, box, cover, edges, patches,
    source, t, used, lanes,
):  # fmt: skip
    """Set up triangles first .. last-1 of a pattern for a patch whose points, from `base` on, are all inside the frustum.

    Those that go on are written from place t on, in their order. Returns the place after the last of them, and how many of
    the others have no area, face the wrong way, hold no sample, and lie off the screen. used : uint8[V], set to 1 for the
    vertices of what goes on. lanes : scratch; `vertex` .. `source`, as in `types.Triangles`, are modified in place.
    """
    prefer_wide()
    x, y = xs[base : base + num_points], ys[base : base + num_points]
    (x0, x1), (y0, y1) = _extent(x), _extent(y)
    if max(np.int64(x1) - x0, np.int64(y1) - y0) < NARROW:  # then twice a triangle's area has 31 bits
        corner, rows = lanes.corner.view(np.int32)[:num_points], lanes.rows.view(np.int32)
        _pack(x, y, x0, y0, 16, corner)
        return _set_up_runs(
            16, (x0, y0), corner, rows, patch, first, last, base, indices, bounds, margin, face_cull, vertex, box, cover,
            edges, patches, source, t, used,
        )  # fmt: skip
    zero = np.int32(0)
    _pack(x, y, zero, zero, 32, lanes.corner[:num_points])
    return _set_up_runs(
        32, (zero, zero), lanes.corner, lanes.rows, patch, first, last, base, indices, bounds, margin, face_cull, vertex, box,
        cover, edges, patches, source, t, used,
    )  # fmt: skip
