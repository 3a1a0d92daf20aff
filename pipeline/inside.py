"""Set-up of the triangles of patches that lie inside the frustum, which are most of all: in runs, lane by lane.

What becomes of a small triangle is decided by chance: it may face away, or lie between samples, so branches for each are
branches missed. A run of triangles goes through three loops instead: one fetches the corners, one decides for all at once, in
vectors, and one lists the numbers of those that go on without asking. Only these are written.
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, inlined
from pipeline.types import I64, FaceCull

CULL_FRONT, CULL_BACK = int(FaceCull.FRONT), int(FaceCull.BACK)
BACK_FACE = 8  # bit of Triangles.edges beside the three edge bits

RUN = 256  # triangles: their rows stay in the first-level cache
A, B, C, X0, Y0, X1, Y1, ALIVE, TURNED, LIST, COVER = (k * RUN for k in range(11))
SCRATCH = 11 * RUN

ONE, TWO = np.uint32(1), np.uint32(2)
UNKNOWN = 255  # of Triangles.cover: not asked for, or the box is larger than it has bits for


class Lanes(NamedTuple):
    """Scratch of one thread."""

    corner: I64  # (points of the largest pattern,) of the patch at hand: y << 32 | x, 16.8 fixed point
    rows: I64  # (SCRATCH,)


def make_lanes(most_points: int) -> Lanes:
    """Scratch for patterns of at most so many points."""
    return Lanes(np.empty(most_points, np.int64), np.empty(SCRATCH, np.int64))


@helper
def _pack(base, n, xs, ys, corner):
    """Both window coordinates of a point in one word, so that a triangle fetches three words."""
    x, y = xs[base : base + n], ys[base : base + n]
    for i in range(n):
        corner[i] = (np.int64(y[i]) << 32) | (np.int64(x[i]) & 0xFFFFFFFF)


@helper
def _fetch(first, n, indices, corner, rows):
    """Rows A, B, C: the corners of triangles first .. first+n-1."""
    for i in range(n):
        rows[A + i] = corner[indices[3 * (first + i)]]
        rows[B + i] = corner[indices[3 * (first + i) + 1]]
        rows[C + i] = corner[indices[3 * (first + i) + 2]]


@inlined
def _decide(n, rows, bounds, margin, face_cull):
    """Rows X0 .. Y1: boxes; ALIVE: whether a triangle goes on; TURNED: whether it is counter-clockwise.

    Returns how many have no area, face the wrong way, hold no sample, lie off the screen: each in the first of these.
    """
    left, top, right, bottom = bounds
    pa, pb, pc = rows[A : A + n], rows[B : B + n], rows[C : C + n]
    out_x0, out_y0, out_x1, out_y1 = rows[X0 : X0 + n], rows[Y0 : Y0 + n], rows[X1 : X1 + n], rows[Y1 : Y1 + n]
    alive, turned = rows[ALIVE : ALIVE + n], rows[TURNED : TURNED + n]
    drop_back, drop_front = np.int64(face_cull == CULL_BACK), np.int64(face_cull == CULL_FRONT)
    zero_area, culled, no_sample, offscreen = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    for i in range(n):
        xa, ya = (pa[i] << 32) >> 32, pa[i] >> 32
        xb, yb = (pb[i] << 32) >> 32, pb[i] >> 32
        xc, yc = (pc[i] << 32) >> 32, pc[i] >> 32
        area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
        zero, back = np.int64(area == 0), np.int64(area < 0)
        wrong = ((back & drop_back) | ((1 - back) & drop_front)) & (1 - zero)
        x0, y0 = (min(xa, xb, xc) + 127 - margin) >> 8, (min(ya, yb, yc) + 127 - margin) >> 8
        x1, y1 = (max(xa, xb, xc) - 128 + margin) >> 8, (max(ya, yb, yc) - 128 + margin) >> 8
        faces = (1 - zero) & (1 - wrong)
        empty = np.int64(x0 > x1) | np.int64(y0 > y1)
        x0, y0, x1, y1 = max(x0, left), max(y0, top), min(x1, right), min(y1, bottom)
        out = np.int64(x0 > x1) | np.int64(y0 > y1)
        out_x0[i], out_y0[i], out_x1[i], out_y1[i] = x0, y0, x1, y1
        turned[i] = back
        alive[i] = faces & (1 - (empty | out))
        zero_area += zero
        culled += wrong
        no_sample += faces & empty
        offscreen += faces & out & (1 - empty)
    return zero_area, culled, no_sample, offscreen


@helper
def _list(n, rows):
    """Row LIST: the numbers in the run of the triangles that go on; how many."""
    found = 0
    for i in range(n):
        rows[LIST + found] = i
        found += rows[ALIVE + i]
    return found


@helper
def _gather(n, rows):
    """Rows A .. Y1 and TURNED: those of the n triangles in row LIST, corners clockwise from here on; the first corner stays."""
    for k in range(n):
        i = np.uint32(rows[LIST + k])  # never less than k; unsigned, as an index that may be negative costs a test
        back = rows[TURNED + i] != 0
        b, c = rows[B + i], rows[C + i]
        rows[A + k], rows[B + k], rows[C + k] = rows[A + i], c if back else b, b if back else c
        rows[X0 + k], rows[Y0 + k], rows[X1 + k], rows[Y1 + k] = rows[X0 + i], rows[Y0 + i], rows[X1 + i], rows[Y1 + i]
        rows[TURNED + k] = rows[TURNED + i]


@inlined
def _bias(dx, dy):
    """0 where a sample exactly on the edge is inside (a top or a left edge), else -1."""
    return -np.int64((dy > 0) | ((dy == 0) & (dx <= 0)))


@inlined
def _covered(e0, e1, e2):
    """1 where no edge function is negative, else 0."""
    return ((e0 | e1 | e2) >> 63) + 1


@inlined
def _cover(n, rows):
    """Row COVER, as `types.Triangles.cover` has it, of n clockwise triangles: top-left rule, as in `tiler.rasterizer`."""
    pa, pb, pc = rows[A : A + n], rows[B : B + n], rows[C : C + n]
    x0s, y0s, x1s, y1s = rows[X0 : X0 + n], rows[Y0 : Y0 + n], rows[X1 : X1 + n], rows[Y1 : Y1 + n]
    cover = rows[COVER : COVER + n]
    for k in range(n):
        x, y = (x0s[k] << 8) + 128, (y0s[k] << 8) + 128
        wide, high = x1s[k] - x0s[k], y1s[k] - y0s[k]
        px, py = ((pa[k] << 32) >> 32) - x, (pa[k] >> 32) - y  # corners from the first pixel's centre
        qx, qy = ((pb[k] << 32) >> 32) - x, (pb[k] >> 32) - y
        rx, ry = ((pc[k] << 32) >> 32) - x, (pc[k] >> 32) - y
        dx0, dy0, dx1, dy1, dx2, dy2 = rx - qx, ry - qy, px - rx, py - ry, qx - px, qy - py
        e0 = dy0 * qx - dx0 * qy + _bias(dx0, dy0)
        e1 = dy1 * rx - dx1 * ry + _bias(dx1, dy1)
        e2 = dy2 * px - dx2 * py + _bias(dx2, dy2)
        r0, r1, r2 = e0 - (dy0 << 8), e1 - (dy1 << 8), e2 - (dy2 << 8)  # one pixel to the right
        d0, d1, d2 = dx0 << 8, dx1 << 8, dx2 << 8  # one pixel down
        bits = _covered(e0, e1, e2)
        bits |= (_covered(r0, r1, r2) & wide) << 1
        bits |= (_covered(e0 + d0, e1 + d1, e2 + d2) & high) << 2
        bits |= (_covered(r0 + d0, r1 + d1, r2 + d2) & wide & high) << 3
        cover[k] = bits if (wide | high) < 2 else UNKNOWN


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
    rows = lanes.rows
    zero_area, culled, no_sample, offscreen = 0, 0, 0, 0
    _pack(base, num_points, xs, ys, lanes.corner)
    for begin in range(first, last, RUN):
        n = min(RUN, last - begin)
        _fetch(begin, n, indices, lanes.corner, rows)
        zero, wrong, empty, out = _decide(n, rows, bounds, margin, face_cull)
        zero_area += zero
        culled += wrong
        no_sample += empty
        offscreen += out
        if zero + wrong + empty + out == n:
            continue
        found = _list(n, rows)
        _gather(found, rows)
        if margin == 0:  # samples lie at the pixels' centres
            _cover(found, rows)
        for k in range(found):
            s, at = begin + rows[LIST + k], np.uint32(t + k)
            corner = np.uint32(3 * s)
            a, b, c = indices[corner], indices[corner + ONE], indices[corner + TWO]
            a, b, c = np.uint32(a + base), np.uint32(b + base), np.uint32(c + base)
            used[a], used[b], used[c] = 1, 1, 1
            back = rows[TURNED + k] != 0
            vertex[at, 0], vertex[at, 1], vertex[at, 2] = a, c if back else b, b if back else c
            box[at, 0], box[at, 1], box[at, 2], box[at, 3] = rows[X0 + k], rows[Y0 + k], rows[X1 + k], rows[Y1 + k]
            cover[at] = rows[COVER + k] if margin == 0 else UNKNOWN
            edges[at] = 7 | BACK_FACE if back else 7
            patches[at] = patch
            source[at] = s - first
        t += found
    return t, zero_area, culled, no_sample, offscreen
