"""What every bound shares: an oriented box in world space to clip corners, screen rectangle and nearest depth.

Conservative for what the pipeline computes in float32 (u = 2^-24), all of it evaluated in float64 and widened outwards:

- a clip component ((m0 x + m1 y) + m2 z) + m3 has at most 4 roundings, each of at most u times the sum of the terms'
  magnitudes; vertices made by the clipper are rounded once more: `slack` is 6 u times that sum;
- x/w, + 1, * width, + left: each rounds once; 5 u (|x_win| + width) covers it, and the snap moves by 1/512 pixel;
- z/w rounds once, its scaling to the depth range twice, the interpolated depth is clamped to its triangle's range.

Division only where w is surely positive: a box that reaches behind the near plane z = 0 is first cut by it (12 edges;
box of the corners in front and the crossing points). Where no positive w is certain the whole viewport is returned.

Boxes are worked off in blocks, a lane each (`lanes`). Those that lie in front of the near plane with all corners take the
lanes' results, the others the scalar `_project_one`; corners, slack and flags are the same bits either way, and the
rectangle and z_min too but for quotients taken as products with reciprocals: 2^-50 relative, of 2^-24 that is left.
"""

from typing import NamedTuple

import numpy as np

from pipeline.bounds.lanes import LANES, least4, most4, scratch
from pipeline.bounds.spread import load3, load9, store4, store32
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F32, F64, PatchBounds, Viewport
from pipeline.vector_width import prefer_wide

U = 2.0**-24
SLACK = 6.0 * U
SNAP = 1.0 / 512.0


class Boxes(NamedTuple):
    """The fields of `PatchBounds` that an algorithm makes itself."""

    center: F64
    axes: F64
    cone_axis: F64
    cone_cos: F64


def allocate_boxes(n: int) -> Boxes:
    """Arrays for n patches, to be filled; cone_axis is zero."""
    return Boxes(np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros((n, 3)), np.empty(n))


def unprojected(boxes: Boxes) -> PatchBounds:
    """Those boxes, with arrays that `project_boxes` fills in."""
    n = len(boxes.center)
    return PatchBounds(
        center=boxes.center,
        axes=boxes.axes,
        corners=np.empty((n, 8, 4)),
        slack=np.empty((n, 4)),
        rect=np.empty((n, 4), np.int32),
        z_min=np.empty(n, np.float32),
        inside=np.empty(n, np.uint8),
        cone_axis=boxes.cone_axis,
        cone_cos=boxes.cone_cos,
    )


def allocate(n: int) -> PatchBounds:
    """Arrays for n patches, to be filled."""
    return unprojected(allocate_boxes(n))


@helper
def _all_inside(p, bounds):
    """Whether every point of the box is inside all six planes by more than the slack."""
    sx, sy, sz, sw = bounds.slack[p]
    for k in range(8):
        x, y, z, w = bounds.corners[p, k]
        if not (w + x > sw + sx and w - x > sw + sx and w + y > sw + sy and w - y > sw + sy):
            return False
        if not (z > sz and w - z > sw + sz):
            return False
    return True


@helper
def _ratio_range(a, w, slack_a, slack_w):
    """Range of (a +- slack_a) / (w +- slack_w) for w > slack_w."""
    lo, hi = a - slack_a, a + slack_a
    near, far = w - slack_w, w + slack_w
    return min(lo / near, lo / far), max(hi / near, hi / far)


@helper
def _project(p, near_offset, bounds):
    """Ranges of x/w and y/w and the least z/w over the part of box p with z >= -near_offset.

    Returns (state, x_lo, x_hi, y_lo, y_hi, z_lo); state 0: nothing lies in front; 1: ranges are valid; -1: unknown.
    """
    sx, sy, sz, sw = bounds.slack[p]
    corners = bounds.corners[p]
    x_lo, x_hi, y_lo, y_hi, z_lo = np.inf, -np.inf, np.inf, -np.inf, np.inf
    state = 0
    for k in range(8):
        if not (corners[k, 2] > -np.inf and corners[k, 2] < np.inf):
            return -1, 0.0, 0.0, 0.0, 0.0, 0.0
        for bit in range(-1, 3):
            x, y, z, w = corners[k]
            if bit < 0:  # the corner itself
                if z < -near_offset:
                    continue
            else:  # the edge along axis `bit`, seen once, from its lower corner
                if k & (1 << bit):
                    continue
                other = corners[k | (1 << bit)]
                d, e = z + near_offset, other[2] + near_offset
                if (d < 0.0) == (e < 0.0):
                    continue
                t = d / (d - e)
                x, y, w = x + t * (other[0] - x), y + t * (other[1] - y), w + t * (other[3] - w)
                z = -near_offset
            if not (w > 2.0 * sw):
                return -1, 0.0, 0.0, 0.0, 0.0, 0.0
            state = 1
            a, b = _ratio_range(x, w, sx, sw)
            x_lo, x_hi = min(x_lo, a), max(x_hi, b)
            a, b = _ratio_range(y, w, sy, sw)
            y_lo, y_hi = min(y_lo, a), max(y_hi, b)
            a, b = _ratio_range(z, w, sz, sw)
            z_lo = min(z_lo, a)
    if not (x_lo <= x_hi and y_lo <= y_hi) and state == 1:
        return -1, 0.0, 0.0, 0.0, 0.0, 0.0
    return state, x_lo, x_hi, y_lo, y_hi, z_lo


@inlined
def _pixels(lo, hi, size, offset):
    """Pixels [first, last + 1) that samples of window range lo .. hi (NDC, growing with the pixel) may lie in; floats."""
    a, b = (lo + 1.0) * 0.5 * size + offset, (hi + 1.0) * 0.5 * size + offset
    pad = 5.0 * U * (max(abs(a), abs(b)) + size + abs(offset)) + SNAP
    first = min(max(np.floor(a - pad), offset), offset + size)
    last = min(max(np.ceil(b + pad), offset), offset + size)
    return first, max(first, last)


@inlined
def _least_depth(z_lo, viewport):
    """z_min, float32, of a box whose least z/w is z_lo."""
    return np.float32(_depth_of(z_lo, viewport))


@inlined
def _depth_of(z_lo, viewport):
    """The same before its rounding to float32, which leaves it below the depth."""
    depth = viewport.min_depth + z_lo * (viewport.max_depth - viewport.min_depth)
    depth -= 4.0 * U * (abs(z_lo) + viewport.min_depth)
    return _below(min(max(depth, viewport.min_depth), viewport.max_depth))


@inlined
def _set_rect(rect, x0, y0, x1, y1):
    """Rectangle, all of it empty where one side is."""
    rect[0], rect[1], rect[2], rect[3] = np.int32(x0), np.int32(y0), np.int32(x1), np.int32(y1)
    if rect[0] == rect[2] or rect[1] == rect[3]:
        rect[2], rect[3] = rect[0], rect[1]


@helper
def _project_one(p, viewport, bounds):
    """Fill rect, z_min and inside of box p, wherever it lies, from its corners and slack."""
    bounds.inside[p] = 1 if _all_inside(p, bounds) else 0
    state, x_lo, x_hi, y_lo, y_hi, z_lo = _project(p, 2.0 * bounds.slack[p, 2], bounds)
    rect = bounds.rect[p]
    rect[0], rect[1] = viewport.left, viewport.top
    rect[2], rect[3] = viewport.left + viewport.width, viewport.top + viewport.height
    bounds.z_min[p] = viewport.min_depth
    if state == 0:
        rect[2], rect[3] = rect[0], rect[1]
        bounds.z_min[p] = viewport.max_depth
    elif state == 1:
        width, height = np.float64(viewport.width), np.float64(viewport.height)
        x0, x1 = _pixels(x_lo, x_hi, width, np.float64(viewport.left))
        y0, y1 = _pixels(-y_hi, -y_lo, height, np.float64(viewport.top))
        _set_rect(rect, x0, y0, x1, y1)
        bounds.z_min[p] = _least_depth(z_lo, viewport)


# Blocks. Rows of the scratch array: center (3) and axes (9, row 3 r + c of axis r), corners (x, y, z, w of each of 8), slack
# (4), what bounds the corners, 1 / (w - slack) and 1 / (w + slack) (8 each), ranges of the quotients (3 each), pixels, flags.

CENTER, AXES, CORNERS, SLACKS, BOUND, NEAR, FAR, LOW, HIGH = 0, 3, 12, 44, 48, 49, 57, 65, 68
X0, X1, Y0, Y1, FRONT, INSIDE, DEPTH = 71, 72, 73, 74, 75, 76, 77
ROWS = 78
ROW, CORNER = LANES, 4 * LANES  # from a row to the next, from a corner's to the next one's


@inlined
def _transform(matrix, row, s):
    """Clip-space coordinate `row` of all corners, and its slack. Corner k: bit r of k gives the sign of axis r.

    Row BOUND: sum of what bounds them, which is finite if they all are.
    """
    prefer_wide()
    m0, m1, m2 = np.float64(matrix[row, 0]), np.float64(matrix[row, 1]), np.float64(matrix[row, 2])
    m3 = np.float64(matrix[row, 3])
    size0, size1, size2, size3 = abs(m0), abs(m1), abs(m2), abs(m3)
    for lane in range(LANES):
        i, out = CENTER * LANES + lane, (CORNERS + row) * LANES + lane
        cx, cy, cz, px, py, pz = s[i], s[i + ROW], s[i + 2 * ROW], s[i + 3 * ROW], s[i + 4 * ROW], s[i + 5 * ROW]
        qx, qy, qz, rx, ry, rz = (
            s[i + 6 * ROW], s[i + 7 * ROW], s[i + 8 * ROW], s[i + 9 * ROW], s[i + 10 * ROW], s[i + 11 * ROW]
        )  # fmt: skip
        middle = m0 * cx + m1 * cy + m2 * cz + m3
        reach0, reach1 = m0 * px + m1 * py + m2 * pz, m0 * qx + m1 * qy + m2 * qz
        reach2 = m0 * rx + m1 * ry + m2 * rz
        a, b = middle - reach0, middle + reach0
        c, d, e, f = a - reach1, b - reach1, a + reach1, b + reach1
        s[out], s[out + CORNER] = c - reach2, d - reach2
        s[out + 2 * CORNER], s[out + 3 * CORNER] = e - reach2, f - reach2
        s[out + 4 * CORNER], s[out + 5 * CORNER] = c + reach2, d + reach2
        s[out + 6 * CORNER], s[out + 7 * CORNER] = e + reach2, f + reach2
        x, y, z = abs(cx) + abs(px) + abs(qx) + abs(rx), abs(cy) + abs(py) + abs(qy) + abs(ry), abs(cz) + abs(pz)
        terms = size0 * x + size1 * y + size2 * (z + abs(qz) + abs(rz))
        s[(SLACKS + row) * LANES + lane] = SLACK * (terms + size3)
        bound = abs(middle) + abs(reach0) + abs(reach1) + abs(reach2)
        s[BOUND * LANES + lane] = bound + (s[BOUND * LANES + lane] if row > 0 else 0.0)


@inlined
def _function(s, i, row, sign):
    """w + sign times coordinate `row` of the corner whose rows begin at i; the coordinate alone for a sign of 0."""
    if sign == 0:
        return s[i + row * ROW]
    return s[i + 3 * ROW] + s[i + row * ROW] if sign > 0 else s[i + 3 * ROW] - s[i + row * ROW]


@inlined
def _least_of(s, lane, row, sign):
    """Least of `_function` over the corners."""
    i = CORNERS * LANES + lane
    a, b = _function(s, i, row, sign), _function(s, i + CORNER, row, sign)
    c, d = _function(s, i + 2 * CORNER, row, sign), _function(s, i + 3 * CORNER, row, sign)
    e, f = _function(s, i + 4 * CORNER, row, sign), _function(s, i + 5 * CORNER, row, sign)
    g, h = _function(s, i + 6 * CORNER, row, sign), _function(s, i + 7 * CORNER, row, sign)
    return min(least4(a, b, c, d), least4(e, f, g, h))


@inlined
def _classify(s):
    """Row FRONT: 1 where all corners are finite, before the near plane, with a w that is surely positive. Row INSIDE."""
    prefer_wide()
    for lane in range(LANES):
        j = SLACKS * LANES + lane
        sx, sy, sz, sw = s[j], s[j + ROW], s[j + 2 * ROW], s[j + 3 * ROW]
        near, w = _least_of(s, lane, 2, 0), _least_of(s, lane, 3, 0)
        front = (s[BOUND * LANES + lane] < np.inf) & (near >= -(2.0 * sz)) & (w > 2.0 * sw)
        inside = (_least_of(s, lane, 0, 1) > sw + sx) & (_least_of(s, lane, 0, -1) > sw + sx)
        inside = inside & (_least_of(s, lane, 1, 1) > sw + sy) & (_least_of(s, lane, 1, -1) > sw + sy)
        inside = inside & (near > sz) & (_least_of(s, lane, 2, -1) > sw + sz)
        s[FRONT * LANES + lane] = 1.0 if front else 0.0
        s[INSIDE * LANES + lane] = 1.0 if inside else 0.0


@inlined
def _invert(s, k, lane):
    """Rows NEAR and FAR of a corner."""
    w, slack = s[(CORNERS + 4 * k + 3) * LANES + lane], s[(SLACKS + 3) * LANES + lane]
    near, far = w - slack, w + slack
    inverse = 1.0 / (near * far)
    s[(NEAR + k) * LANES + lane], s[(FAR + k) * LANES + lane] = far * inverse, near * inverse


@inlined
def _invert_all(s):
    prefer_wide()
    for lane in range(LANES):
        _invert(s, 0, lane)
        _invert(s, 1, lane)
        _invert(s, 2, lane)
        _invert(s, 3, lane)
        _invert(s, 4, lane)
        _invert(s, 5, lane)
        _invert(s, 6, lane)
        _invert(s, 7, lane)


@inlined
def _quotient(s, row, k, lane):
    """Range of coordinate `row` over w of a corner."""
    a, slack = s[(CORNERS + 4 * k + row) * LANES + lane], s[(SLACKS + row) * LANES + lane]
    near, far = s[(NEAR + k) * LANES + lane], s[(FAR + k) * LANES + lane]
    lo, hi = a - slack, a + slack
    return min(lo * near, lo * far), max(hi * near, hi * far)


@inlined
def _find_range(s, row):
    """Rows LOW and HIGH of a coordinate: range of its quotients over the corners, slack included."""
    prefer_wide()
    for lane in range(LANES):
        (a, b), (c, d) = _quotient(s, row, 0, lane), _quotient(s, row, 1, lane)
        (e, f), (g, h) = _quotient(s, row, 2, lane), _quotient(s, row, 3, lane)
        low, high = least4(a, c, e, g), most4(b, d, f, h)
        (a, b), (c, d) = _quotient(s, row, 4, lane), _quotient(s, row, 5, lane)
        (e, f), (g, h) = _quotient(s, row, 6, lane), _quotient(s, row, 7, lane)
        s[(LOW + row) * LANES + lane] = min(low, least4(a, c, e, g))
        s[(HIGH + row) * LANES + lane] = max(high, most4(b, d, f, h))


@inlined
def _find_rectangles(viewport, s):
    """Rows X0, X1, Y0, Y1 and DEPTH from LOW and HIGH; FRONT also says whether the pixels are known. Whether all are FRONT."""
    prefer_wide()
    width, height = np.float64(viewport.width), np.float64(viewport.height)
    left, top = np.float64(viewport.left), np.float64(viewport.top)
    behind = np.uint8(0)
    for lane in range(LANES):
        i, lo, hi = X0 * LANES + lane, LOW * LANES + lane, HIGH * LANES + lane
        x0, x1 = _pixels(s[lo], s[hi], width, left)
        y0, y1 = _pixels(-s[hi + ROW], -s[lo + ROW], height, top)
        front = (s[FRONT * LANES + lane] == 1.0) & (x0 <= x1) & (y0 <= y1)
        empty = (x0 == x1) | (y0 == y1)
        s[i], s[i + ROW] = x0, (x0 if empty else x1)
        s[i + 2 * ROW], s[i + 3 * ROW] = y0, (y0 if empty else y1)
        s[FRONT * LANES + lane] = 1.0 if front else 0.0
        s[DEPTH * LANES + lane] = _depth_of(s[lo + 2 * ROW], viewport)
        behind |= np.uint8(not front)
    return behind == 0


@helper
def _store(first, count, viewport, all_front, s, bounds):
    """Results of the first `count` lanes to bounds; those that are not FRONT by `_project_one`."""
    store32(s, CORNERS, first, bounds.corners)
    store4(s, SLACKS, first, bounds.slack)
    rect, z_min, inside = bounds.rect[first:], bounds.z_min[first:], bounds.inside[first:]
    for lane in range(count):
        inside[lane] = np.uint8(s[INSIDE * LANES + lane])
        i = X0 * LANES + lane
        rect[lane, 0], rect[lane, 1] = np.int32(s[i]), np.int32(s[i + 2 * ROW])
        rect[lane, 2], rect[lane, 3] = np.int32(s[i + ROW]), np.int32(s[i + 3 * ROW])
        z_min[lane] = np.float32(s[DEPTH * LANES + lane])
    if not all_front:
        for lane in range(count):
            if s[FRONT * LANES + lane] == 0.0:
                _project_one(first + lane, viewport, bounds)


@kernel
def _project_boxes(
    matrix, left, top, width, height, min_depth, max_depth, s, center, axes, corners, slack, rect, z_min, inside
):  # fmt: skip
    """Field by field: Numba takes microseconds to look at a named tuple."""
    prefer_wide()
    n, viewport = len(center), Viewport(left, top, width, height, min_depth, max_depth)
    bounds = PatchBounds(center, axes, corners, slack, rect, z_min, inside, center, z_min)  # cones are not looked at
    for first in range(0, n, LANES):
        load3(s, CENTER, first, bounds.center)
        load9(s, AXES, first, bounds.axes)
        _transform(matrix, 0, s)
        _transform(matrix, 1, s)
        _transform(matrix, 2, s)
        _transform(matrix, 3, s)
        _classify(s)
        _invert_all(s)
        _find_range(s, 0)
        _find_range(s, 1)
        _find_range(s, 2)
        _store(first, min(LANES, n - first), viewport, _find_rectangles(viewport, s), s, bounds)


def project_boxes(matrix: F32, viewport: Viewport, bounds: PatchBounds) -> None:
    """Fill corners, slack, rect, z_min and inside of all boxes from their centers and axes. matrix : float32[4, 4]."""
    b = bounds
    _project_boxes(
        matrix, *viewport, scratch(ROWS), b.center, b.axes, b.corners, b.slack, b.rect, b.z_min, b.inside
    )  # fmt: skip


@inlined
def _below(a):
    """Rounded to float32 this is not above `a`, for a in [0, 1]."""
    return max(a * (1.0 - 2.0 * U) - 2.0**-149, 0.0)
