"""Oriented boxes of control points, in blocks: frame, extents along its axes, and what float32 may be off by.

Munkberg et al. 2010, section 3.1.1. Along each axis of the frame the surface lies between the least and the greatest
projection of the control points over the domain, widened by `cbox.position_errors`, seen along the axis, and for float64
by FLOAT64 of the largest coordinate. A Gregory patch's inner points lie between two given ones each: their distances from
the mean that `control_points` holds, seen along the axis, times the largest sum of the inner Bernstein weights on the
domain, are added.

The control points are turned into the frame once, for the extents and for the tangents (`normals`).

Frames of patches whose corner sums are null, nearly parallel, or of extreme length come from `obb_frame.make_frame`.
"""

import math

import numpy as np

from pipeline.bounds.cbox import widen_errors
from pipeline.bounds.gregory import most_inner_weight, reach_of_inner, widest_inner
from pipeline.bounds.lanes import (
    LANES,
    columns,
    least4,
    load_domains,
    load_points,
    load_weights,
    most4,
    restrict_rows,
    scratch,
)
from pipeline.bounds.obb_frame import make_frame
from pipeline.bounds.rows import store_rows
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, HullInput

FLOAT64 = 2.0**-46  # above the rounding of projections on the axes, relative to the largest coordinate
LEAST_SQUARE, MOST_SQUARE = 2.0**-200, 2.0**200  # of a corner sum, for the lanes
LEAST_SINE_SQUARE = 2.0**-40  # z is perpendicular to x to 2^-52 / sine; taking the rest out leaves its length to 2^-64

# Rows of a block's scratch, those up to KEPT also of the result.
AXES, COSINE, SINE, LO, HI, SIZE = 0, 9, 10, 11, 14, 17
KEPT = 18
POINTS, TURNED, WEIGHTS, DOMAIN = 18, 66, 114, 130  # of the points 16 rows each for x, y, z
ERRORS, TOTAL, LEAST_W, TWICE, FINE = 134, 137, 138, 139, 140
ROWS = 141


@inlined
def _sum16(s, i):
    a, b = (s[i] + s[i + LANES]) + (s[i + 2 * LANES] + s[i + 3 * LANES]), s[i + 4 * LANES] + s[i + 5 * LANES]
    c, d = s[i + 6 * LANES] + s[i + 7 * LANES], (s[i + 8 * LANES] + s[i + 9 * LANES])
    e, f = s[i + 10 * LANES] + s[i + 11 * LANES], (s[i + 12 * LANES] + s[i + 13 * LANES])
    return ((a + b) + (c + d)) + ((e + f) + (s[i + 14 * LANES] + s[i + 15 * LANES]))


@inlined
def _most_of(s, i):
    return most4(
        most4(abs(s[i]), abs(s[i + LANES]), abs(s[i + 2 * LANES]), abs(s[i + 3 * LANES])),
        most4(abs(s[i + 4 * LANES]), abs(s[i + 5 * LANES]), abs(s[i + 6 * LANES]), abs(s[i + 7 * LANES])),
        most4(abs(s[i + 8 * LANES]), abs(s[i + 9 * LANES]), abs(s[i + 10 * LANES]), abs(s[i + 11 * LANES])),
        most4(abs(s[i + 12 * LANES]), abs(s[i + 13 * LANES]), abs(s[i + 14 * LANES]), abs(s[i + 15 * LANES])),
    )


@helper
def _measure(s):
    """Rows ERRORS: largest magnitude of x, y, z; TOTAL: zero, to which comes what shall be finite."""
    for c in range(3):
        for lane in range(LANES):
            s[(ERRORS + c) * LANES + lane] = _most_of(s, (POINTS + 16 * c) * LANES + lane)
    for lane in range(LANES):
        s[TOTAL * LANES + lane], s[LEAST_W * LANES + lane] = 0.0, 1.0


@helper
def _measure_projected(w, s):
    """Rows ERRORS of projected points; LEAST_W; the weights' sum to TOTAL (rows w ..): a block with rational patches."""
    for lane in range(LANES):
        a = least4(s[w * LANES + lane], s[(w + 1) * LANES + lane], s[(w + 2) * LANES + lane], s[(w + 3) * LANES + lane])
        for k in range(4, 16):
            a = min(a, s[(w + k) * LANES + lane])
        s[LEAST_W * LANES + lane] = a
        s[TOTAL * LANES + lane] += _sum16(s, w * LANES + lane)
    for c in range(3):
        for lane in range(LANES):
            most = 0.0
            for k in range(16):
                most = max(most, abs(s[(POINTS + 16 * c + k) * LANES + lane] / s[(w + k) * LANES + lane]))
            s[(ERRORS + c) * LANES + lane] = most


@helper
def _divide(s):
    """Project the restricted points."""
    for c in range(3):
        for k in range(16):
            for lane in range(LANES):
                i = (POINTS + 16 * c + k) * LANES + lane
                s[i] = s[i] / s[(WEIGHTS + k) * LANES + lane]


@inlined
def _coordinate(s, row, lane, a, b, c, d):
    """(point a - b) + (point c - d), one coordinate."""
    i = row * LANES + lane
    return (s[i + a * LANES] - s[i + b * LANES]) + (s[i + c * LANES] - s[i + d * LANES])


@helper
def _frames(s):
    """Rows AXES, COSINE, SINE as `obb_frame.make_frame` has them; FINE: 1, or 0 for patches that are its to do."""
    for lane in range(LANES):
        tx = _coordinate(s, POINTS, lane, 12, 0, 15, 3)
        ty = _coordinate(s, POINTS + 16, lane, 12, 0, 15, 3)
        tz = _coordinate(s, POINTS + 32, lane, 12, 0, 15, 3)
        bx = _coordinate(s, POINTS, lane, 3, 0, 15, 12)
        by = _coordinate(s, POINTS + 16, lane, 3, 0, 15, 12)
        bz = _coordinate(s, POINTS + 32, lane, 3, 0, 15, 12)
        tt, bb = tx * tx + ty * ty + tz * tz, bx * bx + by * by + bz * bz
        it, ib = 1.0 / math.sqrt(tt), 1.0 / math.sqrt(bb)
        tx, ty, tz = tx * it, ty * it, tz * it
        bx, by, bz = bx * ib, by * ib, bz * ib
        nx, ny, nz = ty * bz - tz * by, tz * bx - tx * bz, tx * by - ty * bx
        nn = nx * nx + ny * ny + nz * nz
        inverse = 1.0 / math.sqrt(nn)
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        lean = nx * tx + ny * ty + nz * tz
        nx, ny, nz = nx - lean * tx, ny - lean * ty, nz - lean * tz
        yx, yy, yz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        s[AXES * LANES + lane], s[(AXES + 1) * LANES + lane], s[(AXES + 2) * LANES + lane] = tx, ty, tz
        s[(AXES + 3) * LANES + lane], s[(AXES + 4) * LANES + lane], s[(AXES + 5) * LANES + lane] = yx, yy, yz
        s[(AXES + 6) * LANES + lane], s[(AXES + 7) * LANES + lane], s[(AXES + 8) * LANES + lane] = nx, ny, nz
        s[COSINE * LANES + lane] = bx * tx + by * ty + bz * tz
        s[SINE * LANES + lane] = bx * yx + by * yy + bz * yz
        known = (tt > LEAST_SQUARE) & (tt < MOST_SQUARE) & (bb > LEAST_SQUARE) & (bb < MOST_SQUARE)
        s[FINE * LANES + lane] = 1.0 if known & (nn > LEAST_SINE_SQUARE) else 0.0


@helper
def _mend_frames(s, points, axes):
    """Frames that `_frames` left; points float64[4, 4, 3] and axes float64[3, 3] are scratch."""
    for lane in range(LANES):
        if s[FINE * LANES + lane] == 0.0:
            for k in range(16):
                for c in range(3):
                    points[k >> 2, k & 3, c] = s[(POINTS + 16 * c + k) * LANES + lane]
            s[COSINE * LANES + lane], s[SINE * LANES + lane] = make_frame(points, axes)
            for r in range(3):
                for c in range(3):
                    s[(AXES + 3 * r + c) * LANES + lane] = axes[r, c]


@helper
def turn_points(s, source):
    """Rows TURNED: the points of rows source .. in the frame."""
    for k in range(16):
        for lane in range(LANES):
            i, j, f = (source + k) * LANES + lane, (TURNED + k) * LANES + lane, AXES * LANES + lane
            x, y, z = s[i], s[i + 16 * LANES], s[i + 32 * LANES]
            a = s[f] * x + s[f + LANES] * y + s[f + 2 * LANES] * z
            b = s[f + 3 * LANES] * x + s[f + 4 * LANES] * y + s[f + 5 * LANES] * z
            c = s[f + 6 * LANES] * x + s[f + 7 * LANES] * y + s[f + 8 * LANES] * z
            s[j], s[j + 16 * LANES], s[j + 32 * LANES] = a, b, c


@inlined
def _range4(s, k, lane):
    i = (TURNED + k) * LANES + lane
    a, b, c, d = s[i], s[i + LANES], s[i + 2 * LANES], s[i + 3 * LANES]
    return least4(a, b, c, d), most4(a, b, c, d)


@helper
def _add_total(s):
    """Row TOTAL += the turned x: an axis is no zero vector, so their sum is finite only if each point is."""
    for lane in range(LANES):
        s[TOTAL * LANES + lane] += _sum16(s, TURNED * LANES + lane)


@helper
def _extent(s, r):
    """Rows LO and HI of axis r: range of the points, widened."""
    axis = AXES + 3 * r
    for lane in range(LANES):
        k = 16 * r
        (a, b), (c, d) = _range4(s, k, lane), _range4(s, k + 4, lane)
        (e, f), (g, h) = _range4(s, k + 8, lane), _range4(s, k + 12, lane)
        total = s[TOTAL * LANES + lane]
        pad = FLOAT64 * s[SIZE * LANES + lane] + (total - total)  # NaN where a coordinate is not finite
        i, j = axis * LANES + lane, ERRORS * LANES + lane
        pad += abs(s[i]) * s[j] + abs(s[i + LANES]) * s[j + LANES] + abs(s[i + 2 * LANES]) * s[j + 2 * LANES]
        s[(LO + r) * LANES + lane] = least4(a, c, e, g) - pad
        s[(HI + r) * LANES + lane] = most4(b, d, f, h) + pad


@helper
def _widen_gregory(control_points, domain, gregory_id, inner, first, n, s):
    for lane in range(LANES):
        p = min(first + lane, n - 1)
        row = gregory_id[p]
        if row >= 0:
            weight = most_inner_weight(domain[p, 0], domain[p, 1], domain[p, 2], domain[p, 3])
            for r in range(3):
                i = (AXES + 3 * r) * LANES + lane
                reach = reach_of_inner(control_points[p], inner[row], s[i], s[i + LANES], s[i + 2 * LANES])
                s[(LO + r) * LANES + lane] -= weight * reach
                s[(HI + r) * LANES + lane] += weight * reach


@helper
def _set_errors(rational, gregory_id, inner, first, n, s):
    """Rows ERRORS from the largest magnitudes: what float32 may be off by; row SIZE."""
    for lane in range(LANES):
        p = min(first + lane, n - 1)
        if gregory_id[p] >= 0:
            for c in range(3):
                i = (ERRORS + c) * LANES + lane
                s[i] = max(s[i], widest_inner(inner[gregory_id[p]], c))
        s[TWICE * LANES + lane] = 1.0 if rational[p] != 0 or gregory_id[p] >= 0 else 0.0
    for lane in range(LANES):
        x, y, z = s[ERRORS * LANES + lane], s[(ERRORS + 1) * LANES + lane], s[(ERRORS + 2) * LANES + lane]
        s[SIZE * LANES + lane] = max(max(x, y), z)
        s[ERRORS * LANES + lane], s[(ERRORS + 1) * LANES + lane], s[(ERRORS + 2) * LANES + lane] = widen_errors(
            x, y, z, min(s[LEAST_W * LANES + lane], 1.0), s[TWICE * LANES + lane] > 0.0
        )


@helper
def fit_block(control_points, rational, gregory_id, inner, domain, first, copy, s, points, axes):
    """Fit the boxes of one block; rows TURNED of its points. Returns whether each domain is the whole patch.

    copy : where one is not, the points of the whole patches are left in rows copy .. (-1: nowhere).
    """
    n = len(control_points)
    load_points(control_points, first, n, POINTS, s)
    whole = load_domains(domain, first, n, DOMAIN, s)
    some_rational = some_gregory = False
    for p in range(first, min(first + LANES, n)):
        some_rational |= rational[p] != 0
        some_gregory |= gregory_id[p] >= 0
    _measure(s)
    if some_rational:
        load_weights(control_points, first, n, WEIGHTS, s)
        _measure_projected(WEIGHTS, s)
    _set_errors(rational, gregory_id, inner, first, n, s)
    if not whole:
        if copy >= 0:
            s[copy * LANES : (copy + 48) * LANES] = s[POINTS * LANES : (POINTS + 48) * LANES]
        restrict_rows(s, POINTS, 3, 4, 4, DOMAIN)
        if some_rational:
            restrict_rows(s, WEIGHTS, 1, 4, 4, DOMAIN)
    if some_rational:
        _divide(s)
    _frames(s)
    _mend_frames(s, points, axes)
    turn_points(s, POINTS)
    _add_total(s)
    _extent(s, 0)
    _extent(s, 1)
    _extent(s, 2)
    if some_gregory:
        _widen_gregory(control_points, domain, gregory_id, inner, first, n, s)
    return whole


@kernel
def _fit_boxes(control_points, rational, gregory_id, inner, domain, s, points, axes, boxes):
    for first in range(0, len(control_points), LANES):
        fit_block(control_points, rational, gregory_id, inner, domain, first, -1, s, points, axes)
        store_rows(s, 0, KEPT, boxes, first)


def fit_boxes(stage: HullInput) -> F64:
    """Rows AXES .. SIZE of all patches over their domains: float64[KEPT, `lanes.columns`(P)].

    Row AXES + 3 r + c: component c of axis r; COSINE, SINE: of the angle between t and b (`obb_frame`); LO + r, HI + r: range
    of the float32 shader's undisplaced positions along axis r, NaN where a coordinate is not finite or a weight is not
    positive; SIZE: largest magnitude of a coordinate of the whole patch.
    """
    patches = stage.patches
    n = len(patches.control_points)
    boxes = np.empty((KEPT, columns(n)))
    _fit_boxes(
        patches.control_points.reshape(n, 64), patches.rational, patches.gregory_id, patches.inner, stage.domain,
        scratch(ROWS), np.empty((4, 4, 3)), np.empty((3, 3)), boxes,
    )  # fmt: skip
    return boxes
