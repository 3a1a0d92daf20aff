"""Oriented boxes of whole Bezier patches in float32, in blocks (`lanes`): twice as many of them to a vector of the machine.

The box that `fit` makes in float64, of the patches that most scenes are made of: polynomial, Bezier, all of their domain,
neither tiny nor huge. Others are left to `fit`, one by one (`FINE` 0). What a block keeps in float32 are the control points
relative to the first one, turned into the frame and scaled by 1 / |t|, t the frame's sum of legs along u (`obb_frame`), and
of these the middle and half of the extent along each axis. The box itself is made in float64 (`oriented`), about the first
point plus axes times middles.

Why that is conservative (u = 2^-24; D the largest magnitude of a turned and scaled coordinate, R of a relative one):

- the frame is made in float64 of float32's t and b: any orthonormal frame holds a valid box, and nothing else is asked of
  it. Products of two float32 are exact there, so t x b has three roundings whatever the angle; the axes have length 1 and
  are perpendicular to 2^-44. A point is at most 2 sqrt(3) R from the box's middle, and that at most sqrt(3) R from the first
  point, so what they have along one axis is off by 2^-40 of R. The axes are rounded to float32 for turning only;
- a relative point is rounded once (not at all where it is near the first), the axis once, the scale and its product once
  each, products once, two sums: a turned coordinate is off by at most 7.1 u sum |axis| R: TURN. (That is 7.1 u |point| <=
  12.3 u D.) An extent holds zero, the first point, so its middle is no larger than its half h: each rounds by u h, and
  widening h by as much again, with that itself 4.1 u h: HALVES;
- R is not found, which would take as many operations as the extents, but follows from the turned points: a relative
  coordinate is the sum over the axes of axis times turned coordinate, so R <= |t|^2 sum |axis / |t|| M, with M the largest
  turned ones. In this R roundings are next to nothing: 10 u of it, of the 0.9 u that TURN has to spare. What M is off by
  makes R too small by at most 12.3 u |point|. An extent takes (SHADER + TURN) R along its axis: 2^-37 of the largest
  coordinate, as |point| <= 2 sqrt(3) of it. With the 2^-40 above and what float64 rounds that is AXIS. SIZE, which is |first
  point| + R, is as little below the largest magnitude, 43 u of it: who takes a multiple has more to spare;
- what the shader's float32 may be off by is that of `fit`, from largest magnitudes, which are at most those of the first
  point plus R. SHADER has 2^-8 more for its own roundings and those of the turned axes.

Denormal numbers lose 2^-149 a time: next to nothing, as |t| > 2^-25 and so D |t| > 2^-28. A coordinate that is not finite
makes each turned one so (a zero times infinity is NaN), hence the sum of those along one axis, and of the first point all
others. Coordinates of 2^60 or more are left, so with 1 / |t| < 2^25 nothing else overflows; squares of t x b lie between
2^-120 and 2^100, where float32 has all its digits.

The extents are looser than those of `fit` at each end by at most 68 u of the size of the patch, 2^-8 of the shader's error
and 2^-36 of the largest coordinate. (R is at most 3 sizes along an axis. It is taken 13 times, as what |first point| + R is
above the largest magnitude, and 8 times for TURN; 4 come from HALVES.) A patch that is flat along an axis of space is not
widened across it by how large it is: there its frame is exactly that axis.
"""

import math

import numpy as np

from pipeline.bounds.cbox import error_factor
from pipeline.bounds.fit import AXES
from pipeline.bounds.lanes import LANES, least4, most4
from pipeline.bounds.rows import narrow_lanes
from pipeline.jit import inlined
from pipeline.vector_width import prefer_wide

U = 2.0**-24
# As Python: a helper that is compiled while a module is imported is compiled by every process.
POLYNOMIAL = getattr(error_factor, "py_func", error_factor)(False)
SHADER = np.float32(POLYNOMIAL * (1.0 + 2.0**-8))
TURN = np.float32(8.0 * U)  # of R
HALVES = np.float32(8.0 * U)
AXIS = np.float32(2.0**-36)  # of the largest coordinate
HALF = np.float32(0.5)
ONE = np.float32(1.0)
ZERO = np.float32(0.0)
MOST = np.float32(2.0**60)  # coordinates
LEAST_SQUARE, MOST_SQUARE = np.float32(2.0**-50), np.float32(2.0**50)  # of t and b
MOST_RATIO = np.float32(32.0)  # D
LEAST_SINE_SQUARE = np.float32(2.0**-20)  # of the angle between t and b

# Rows of float32. Of the points 16 rows each for x, y, z.
POINTS, TURNED = 0, 48
TURN_AXES = 96  # as AXES of `fit`, over |t|
MIDDLE, REACH, LARGEST, FINE = 105, 108, 111, 112  # middles and halves of the extents; D
MOST_TURNED, SCALE, SQUARE, SIZE = 113, 116, 117, 118  # largest turned magnitudes; 1 / |t|, |t|^2; of a coordinate
ROWS = 119

UNIT, INVERSE = 39, 40  # |t| and 1 / |t|, in float64, after the rows of `oriented`
ROWS64 = 41


@inlined
def inverse_root(square):
    """1 / sqrt of a float64 of float32's normal range, to 2^-44.7: float32's, off by 2.5 u, and one of Newton's steps."""
    a = np.float64(ONE / math.sqrt(np.float32(square)))
    return a * (1.5 - 0.5 * square * (a * a))


@inlined
def _leg(s, row, lane, a, b, c):
    """(point a - the first) + (point b - point c), one coordinate."""
    i = row * LANES + lane
    return (s[i + a * LANES] - s[i]) + (s[i + b * LANES] - s[i + c * LANES])


@inlined
def _frames(s, d):
    """Rows AXES, UNIT and INVERSE; TURN_AXES, not yet scaled, SCALE, SQUARE; FINE: 1, or 0 for patches left to `fit`."""
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
        nx, ny, nz = ty * bz - tz * by, tz * bx - tx * bz, tx * by - ty * bx
        tt, nn = tx * tx + ty * ty + tz * tz, nx * nx + ny * ny + nz * nz
        known = known & (np.float32(nn) > LEAST_SINE_SQUARE * (tt32 * bb32))
        it, inverse = inverse_root(tt), inverse_root(nn)  # neither waits for the other
        tx, ty, tz = tx * it, ty * it, tz * it
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        yx, yy, yz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        i = AXES * LANES + lane
        d[i], d[i + LANES], d[i + 2 * LANES] = tx, ty, tz
        d[i + 3 * LANES], d[i + 4 * LANES], d[i + 5 * LANES] = yx, yy, yz
        d[i + 6 * LANES], d[i + 7 * LANES], d[i + 8 * LANES] = nx, ny, nz
        d[UNIT * LANES + lane], d[INVERSE * LANES + lane] = tt * it, it
        s[SQUARE * LANES + lane] = tt32
        s[FINE * LANES + lane] = ONE if known else ZERO
    for k in range(9):
        narrow_lanes(d, (AXES + k) * LANES, s, (TURN_AXES + k) * LANES)
    narrow_lanes(d, INVERSE * LANES, s, SCALE * LANES)


@inlined
def clear_first(s):
    """Rows TURNED of the first point, which is zero in every block."""
    for c in range(3):
        for lane in range(LANES):
            s[(TURNED + 16 * c) * LANES + lane] = ZERO


@inlined
def _turn_point(s, k, lane, keep):
    """A point of a lane turned, to row TURNED + k if `keep`."""
    if k == 0:
        return ZERO, ZERO, ZERO
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
    if keep:
        s[j], s[j + 16 * LANES], s[j + 32 * LANES] = a, b, c
    return a, b, c


@inlined
def _scale_axis(s, r, lane):
    i, scale = (TURN_AXES + 3 * r) * LANES + lane, s[SCALE * LANES + lane]
    s[i], s[i + LANES], s[i + 2 * LANES] = s[i] * scale, s[i + LANES] * scale, s[i + 2 * LANES] * scale


@inlined
def _turn4(s, k, lane, keep):
    """Four points turned: least and greatest of each coordinate, and the sum of the first."""
    a, b = _turn_point(s, k, lane, keep), _turn_point(s, k + 1, lane, keep)
    c, d = _turn_point(s, k + 2, lane, keep), _turn_point(s, k + 3, lane, keep)
    return (
        (least4(a[0], b[0], c[0], d[0]), least4(a[1], b[1], c[1], d[1]), least4(a[2], b[2], c[2], d[2])),
        (most4(a[0], b[0], c[0], d[0]), most4(a[1], b[1], c[1], d[1]), most4(a[2], b[2], c[2], d[2])),
        (a[0] + b[0]) + (c[0] + d[0]),
    )


@inlined
def _turn(s, keep):
    """Rows TURN_AXES, scaled; MIDDLE, REACH, MOST_TURNED, LARGEST; TURNED if `keep`; FINE also says whether all is finite."""
    prefer_wide()
    for lane in range(LANES):
        _scale_axis(s, 0, lane)
        _scale_axis(s, 1, lane)
        _scale_axis(s, 2, lane)
        (la, ha, ta), (lb, hb, tb) = _turn4(s, 0, lane, keep), _turn4(s, 4, lane, keep)
        (lc, hc, tc), (ld, hd, td) = _turn4(s, 8, lane, keep), _turn4(s, 12, lane, keep)
        x0, x1 = least4(la[0], lb[0], lc[0], ld[0]), most4(ha[0], hb[0], hc[0], hd[0])
        y0, y1 = least4(la[1], lb[1], lc[1], ld[1]), most4(ha[1], hb[1], hc[1], hd[1])
        z0, z1 = least4(la[2], lb[2], lc[2], ld[2]), most4(ha[2], hb[2], hc[2], hd[2])
        i, j, k = MIDDLE * LANES + lane, REACH * LANES + lane, MOST_TURNED * LANES + lane
        s[i], s[i + LANES], s[i + 2 * LANES] = HALF * (x0 + x1), HALF * (y0 + y1), HALF * (z0 + z1)
        s[j], s[j + LANES], s[j + 2 * LANES] = HALF * (x1 - x0), HALF * (y1 - y0), HALF * (z1 - z0)
        x, y, z = max(x1, -x0), max(y1, -y0), max(z1, -z0)
        s[k], s[k + LANES], s[k + 2 * LANES] = x, y, z
        total, most = (ta + tb) + (tc + td), max(max(x, y), z)
        s[LARGEST * LANES + lane] = most
        fine = (total - total == ZERO) & (most < MOST_RATIO)
        s[FINE * LANES + lane] = s[FINE * LANES + lane] if fine else ZERO


@inlined
def _widest(s, c, lane):
    """R of a coordinate; with c literal, as the rows have to be."""
    i, j = (TURN_AXES + c) * LANES + lane, MOST_TURNED * LANES + lane
    turned = abs(s[i]) * s[j] + abs(s[i + 3 * LANES]) * s[j + LANES] + abs(s[i + 6 * LANES]) * s[j + 2 * LANES]
    return s[SQUARE * LANES + lane] * turned


@inlined
def _widen_along(s, r, lane, x, y, z, pad):
    """REACH along axis r, widened by what x, y, z may be off by, and by `pad`. With r literal, as the rows have to be."""
    i, f = (REACH + r) * LANES + lane, (TURN_AXES + 3 * r) * LANES + lane
    pad = pad + (abs(s[f]) * x + abs(s[f + LANES]) * y + abs(s[f + 2 * LANES]) * z)
    s[i] = s[i] + (HALVES * s[i] + pad)


@inlined
def _widen(s):
    """Rows REACH, widened; SIZE; FINE also says whether that is not too large."""
    prefer_wide()
    for lane in range(LANES):
        i, j = POINTS * LANES + lane, SIZE * LANES + lane
        x, y, z = abs(s[i]), abs(s[i + 16 * LANES]), abs(s[i + 32 * LANES])
        rx, ry, rz = _widest(s, 0, lane), _widest(s, 1, lane), _widest(s, 2, lane)
        s[j] = max(max(x + rx, y + ry), z + rz)
        pad = AXIS * s[SCALE * LANES + lane] * s[j]
        x, y, z = (
            SHADER * x + (SHADER + TURN) * rx,
            SHADER * y + (SHADER + TURN) * ry,
            SHADER * z + (SHADER + TURN) * rz,
        )
        _widen_along(s, 0, lane, x, y, z, pad)
        _widen_along(s, 1, lane, x, y, z, pad)
        _widen_along(s, 2, lane, x, y, z, pad)
        s[FINE * LANES + lane] = s[FINE * LANES + lane] if s[j] < MOST else ZERO


@inlined
def fit_single(s, d, keep):
    """Rows AXES and UNIT of d from rows POINTS of s; rows MIDDLE, REACH, LARGEST, FINE and so on of s.

    keep : whether rows TURNED are wanted, but those of the first point (`clear_first`).
    """
    _frames(s, d)
    _turn(s, keep)
    _widen(s)
