"""Oriented boxes of whole Bezier patches in float32, in blocks (`lanes`): twice as many of them to a vector of the machine.

The box that `fit` makes in float64, of the patches that most scenes are made of: polynomial, Bezier, all of their domain,
neither tiny nor huge. Others are left to `fit`, one by one (`FINE` 0). What a block keeps in float32 are the control points
relative to the first one, turned into the frame and scaled by 1 / |t|, t the frame's sum of legs along u (`obb_frame`), and
of these the middle and half of the extent along each axis. The box itself is made in float64 (`oriented`), about the first
point plus axes times middles.

Why that is conservative (u = 2^-24; D the largest magnitude of a turned and scaled coordinate):

- the frame is made in float64 of float32's t and b: any orthonormal frame holds a valid box, and nothing else is asked of
  it. Its axes have length 1 and are perpendicular to 2^-44; a point is at most 2 sqrt(3) R from the box's middle, and that
  at most sqrt(3) R from the first point, so what they have along one axis is off by 2^-40 of R: AXIS, of the largest
  coordinate, which covers float64 too. The axes are rounded to float32 for turning only;
- a relative point is rounded once (not at all where it is near the first), the axis once, the scale and its product once
  each, products once, two sums: with R the largest magnitudes of relative coordinates, a turned coordinate is off by at
  most 7.1 u sum |axis| R: TURN. (That is 7.1 u |point| <= 12.3 u D.) An extent holds zero, the first point, so its middle
  is no larger than its half h: each rounds by u h, and widening h by as much again, with that itself 4.1 u h: HALVES;
- what the shader's float32 may be off by is that of `fit`, from largest magnitudes, which are at most those of the first
  point plus R. SHADER has 2^-8 more for its own roundings and those of the turned axes.

Denormal numbers lose 2^-149 a time: next to nothing, as |t| > 2^-50 and so D |t| > 2^-53. A coordinate that is not finite
makes each turned one so (a zero times infinity is NaN), hence the sum of those along one axis; coordinates of 2^60 or more
are left, so with 1 / |t| < 2^50 nothing else overflows.

The extents are looser than those of `fit` at each end by at most 26 u of the size of the patch (13 as |first point| + R is
at most that much above the largest magnitude, 8 of TURN, and 8 of half of it), 2^-8 of the shader's error and 2^-40 of the
largest coordinate. A patch that is flat along an axis of space is not widened across it by how large it is.
"""

import math

import numpy as np

from pipeline.bounds.cbox import error_factor
from pipeline.bounds.fit import AXES, SIZE
from pipeline.bounds.lanes import LANES, least4, most4
from pipeline.jit import inlined
from pipeline.vector_width import prefer_wide

U = 2.0**-24
# As Python: a helper that is compiled while a module is imported is compiled by every process.
POLYNOMIAL = getattr(error_factor, "py_func", error_factor)(False)
SHADER = np.float32(POLYNOMIAL * (1.0 + 2.0**-8))
TURN = np.float32(8.0 * U)  # of R
HALVES = np.float32(8.0 * U)
AXIS = np.float32(2.0**-40)  # of the largest coordinate
HALF = np.float32(0.5)
ONE = np.float32(1.0)
ZERO = np.float32(0.0)
MOST = np.float32(2.0**60)  # coordinates
LEAST_SQUARE, MOST_SQUARE = np.float32(2.0**-100), np.float32(2.0**100)  # of t and b
MOST_RATIO = np.float32(32.0)  # D
LEAST_SINE_SQUARE = np.float32(2.0**-20)  # of the angle between t and b

# Rows of float32. Of the points 16 rows each for x, y, z.
POINTS, TURNED = 0, 48
TURN_AXES = 96  # as AXES of `fit`, over |t|
MIDDLE, REACH, LARGEST, FINE = 105, 108, 111, 112  # middles and halves of the extents; D
FIRST, WIDEST, SCALE, SIZE32 = 113, 116, 119, 120  # the first point; R; 1 / |t|; above the largest magnitude
ROWS = 121

UNIT = 39  # |t|, in float64, after the rows of `oriented`
ROWS64 = 40


@inlined
def _note_first(s):
    """Rows FIRST."""
    for i in range(LANES):
        s[FIRST * LANES + i], s[(FIRST + 1) * LANES + i] = s[POINTS * LANES + i], s[(POINTS + 16) * LANES + i]
        s[(FIRST + 2) * LANES + i] = s[(POINTS + 32) * LANES + i]


@inlined
def inverse_root(square):
    """1 / sqrt of a float64 of float32's normal range, to 2^-45: float32's, off by 2^-23, and one of Newton's steps."""
    a = np.float64(ONE / math.sqrt(np.float32(square)))
    return a * (1.5 - 0.5 * square * (a * a))


@inlined
def _leg(s, row, lane, a, b, c):
    """(point a - the first) + (point b - point c), one coordinate."""
    i = row * LANES + lane
    return (s[i + a * LANES] - s[i]) + (s[i + b * LANES] - s[i + c * LANES])


@inlined
def _frames(s, d):
    """Rows AXES and UNIT, their copies for turning, SCALE; FINE: 1, or 0 for patches that are left to `fit`."""
    prefer_wide()
    for lane in range(LANES):
        tx32, ty32 = _leg(s, POINTS, lane, 12, 15, 3), _leg(s, POINTS + 16, lane, 12, 15, 3)
        tz32 = _leg(s, POINTS + 32, lane, 12, 15, 3)
        bx32, by32 = _leg(s, POINTS, lane, 3, 15, 12), _leg(s, POINTS + 16, lane, 3, 15, 12)
        bz32 = _leg(s, POINTS + 32, lane, 3, 15, 12)
        tt32, bb32 = tx32 * tx32 + ty32 * ty32 + tz32 * tz32, bx32 * bx32 + by32 * by32 + bz32 * bz32
        known = (tt32 > LEAST_SQUARE) & (tt32 < MOST_SQUARE) & (bb32 > LEAST_SQUARE) & (bb32 < MOST_SQUARE)
        tx, ty, tz = np.float64(tx32), np.float64(ty32), np.float64(tz32)
        bx, by, bz = np.float64(bx32), np.float64(by32), np.float64(bz32)
        tt = tx * tx + ty * ty + tz * tz
        it = inverse_root(tt)
        tx, ty, tz = tx * it, ty * it, tz * it
        nx, ny, nz = ty * bz - tz * by, tz * bx - tx * bz, tx * by - ty * bx
        nn = nx * nx + ny * ny + nz * nz
        known = known & (np.float32(nn) > LEAST_SINE_SQUARE * bb32)
        inverse = inverse_root(nn)
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        yx, yy, yz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        i = AXES * LANES + lane
        d[i], d[i + LANES], d[i + 2 * LANES] = tx, ty, tz
        d[i + 3 * LANES], d[i + 4 * LANES], d[i + 5 * LANES] = yx, yy, yz
        d[i + 6 * LANES], d[i + 7 * LANES], d[i + 8 * LANES] = nx, ny, nz
        d[UNIT * LANES + lane] = tt * it
        scale = np.float32(it)
        i = TURN_AXES * LANES + lane
        s[i], s[i + LANES], s[i + 2 * LANES] = np.float32(tx) * scale, np.float32(ty) * scale, np.float32(tz) * scale
        s[i + 3 * LANES], s[i + 4 * LANES] = np.float32(yx) * scale, np.float32(yy) * scale
        s[i + 5 * LANES], s[i + 6 * LANES] = np.float32(yz) * scale, np.float32(nx) * scale
        s[i + 7 * LANES], s[i + 8 * LANES] = np.float32(ny) * scale, np.float32(nz) * scale
        s[SCALE * LANES + lane] = scale
        s[FINE * LANES + lane] = ONE if known else ZERO


@inlined
def _turn_point(s, k, lane):
    """Row TURNED + k of a lane: the coordinates, and the magnitudes of those that were turned."""
    i, j, f, g = (
        (POINTS + k) * LANES + lane,
        (TURNED + k) * LANES + lane,
        TURN_AXES * LANES + lane,
        POINTS * LANES + lane,
    )
    x, y, z = s[i] - s[g], s[i + 16 * LANES] - s[g + 16 * LANES], s[i + 32 * LANES] - s[g + 32 * LANES]
    a = s[f] * x + s[f + LANES] * y + s[f + 2 * LANES] * z
    b = s[f + 3 * LANES] * x + s[f + 4 * LANES] * y + s[f + 5 * LANES] * z
    c = s[f + 6 * LANES] * x + s[f + 7 * LANES] * y + s[f + 8 * LANES] * z
    s[j], s[j + 16 * LANES], s[j + 32 * LANES] = a, b, c
    return a, b, c, abs(x), abs(y), abs(z)


@inlined
def _turn4(s, k, lane):
    """Four points turned: least and greatest of each coordinate, the sum of the first, largest magnitudes before."""
    a, b = _turn_point(s, k, lane), _turn_point(s, k + 1, lane)
    c, d = _turn_point(s, k + 2, lane), _turn_point(s, k + 3, lane)
    return (
        (least4(a[0], b[0], c[0], d[0]), least4(a[1], b[1], c[1], d[1]), least4(a[2], b[2], c[2], d[2])),
        (most4(a[0], b[0], c[0], d[0]), most4(a[1], b[1], c[1], d[1]), most4(a[2], b[2], c[2], d[2])),
        (a[0] + b[0]) + (c[0] + d[0]),
        (most4(a[3], b[3], c[3], d[3]), most4(a[4], b[4], c[4], d[4]), most4(a[5], b[5], c[5], d[5])),
    )


@inlined
def _turn(s):
    """Rows TURNED, MIDDLE, REACH, WIDEST, LARGEST, SIZE32; FINE also says whether all is finite and of common size."""
    prefer_wide()
    for lane in range(LANES):
        (la, ha, ta, ra), (lb, hb, tb, rb) = _turn4(s, 0, lane), _turn4(s, 4, lane)
        (lc, hc, tc, rc), (ld, hd, td, rd) = _turn4(s, 8, lane), _turn4(s, 12, lane)
        x0, x1 = least4(la[0], lb[0], lc[0], ld[0]), most4(ha[0], hb[0], hc[0], hd[0])
        y0, y1 = least4(la[1], lb[1], lc[1], ld[1]), most4(ha[1], hb[1], hc[1], hd[1])
        z0, z1 = least4(la[2], lb[2], lc[2], ld[2]), most4(ha[2], hb[2], hc[2], hd[2])
        rx, ry, rz = (
            most4(ra[0], rb[0], rc[0], rd[0]),
            most4(ra[1], rb[1], rc[1], rd[1]),
            most4(ra[2], rb[2], rc[2], rd[2]),
        )
        i, j, k, f = MIDDLE * LANES + lane, REACH * LANES + lane, WIDEST * LANES + lane, POINTS * LANES + lane
        s[i], s[i + LANES], s[i + 2 * LANES] = HALF * (x0 + x1), HALF * (y0 + y1), HALF * (z0 + z1)
        s[j], s[j + LANES], s[j + 2 * LANES] = HALF * (x1 - x0), HALF * (y1 - y0), HALF * (z1 - z0)
        most = max(max(max(x1, y1), z1), -min(min(x0, y0), z0))
        size = max(max(abs(s[f]) + rx, abs(s[f + 16 * LANES]) + ry), abs(s[f + 32 * LANES]) + rz)
        s[k], s[k + LANES], s[k + 2 * LANES] = rx, ry, rz
        total = (ta + tb) + (tc + td)
        s[LARGEST * LANES + lane], s[SIZE32 * LANES + lane] = most, size
        fine = (total - total == ZERO) & (most < MOST_RATIO) & (size < MOST)
        s[FINE * LANES + lane] = s[FINE * LANES + lane] if fine else ZERO


@inlined
def _widen_along(s, r, lane, x, y, z, pad):
    """REACH along axis r, widened by what x, y, z may be off by, and by `pad`. With r literal, as the rows have to be."""
    i, f = (REACH + r) * LANES + lane, (TURN_AXES + 3 * r) * LANES + lane
    pad = pad + (abs(s[f]) * x + abs(s[f + LANES]) * y + abs(s[f + 2 * LANES]) * z)
    s[i] = s[i] + (HALVES * s[i] + pad)


@inlined
def _widen(s, d):
    """Rows REACH, widened; SIZE."""
    prefer_wide()
    for lane in range(LANES):
        d[SIZE * LANES + lane] = np.float64(s[SIZE32 * LANES + lane])
    for lane in range(LANES):
        i, j = FIRST * LANES + lane, WIDEST * LANES + lane
        x = SHADER * abs(s[i]) + (SHADER + TURN) * s[j]
        y = SHADER * abs(s[i + LANES]) + (SHADER + TURN) * s[j + LANES]
        z = SHADER * abs(s[i + 2 * LANES]) + (SHADER + TURN) * s[j + 2 * LANES]
        pad = AXIS * s[SCALE * LANES + lane] * s[SIZE32 * LANES + lane]
        _widen_along(s, 0, lane, x, y, z, pad)
        _widen_along(s, 1, lane, x, y, z, pad)
        _widen_along(s, 2, lane, x, y, z, pad)


@inlined
def fit_single(s, d):
    """Rows AXES, SIZE and UNIT of d from rows POINTS of s; rows TURNED, MIDDLE, REACH, LARGEST, FINE and so on of s."""
    _note_first(s)
    _frames(s, d)
    _turn(s)
    _widen(s, d)
