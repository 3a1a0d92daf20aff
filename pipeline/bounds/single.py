"""Oriented boxes of whole Bezier patches in float32, in blocks (`lanes`): twice as many of them to a vector of the machine.

The box that `fit` makes in float64, of the patches that most scenes are made of: polynomial, Bezier, all of their domain,
neither tiny nor huge. Others are left to `fit`, one by one (`FINE` 0). What a block keeps in float32 are the control points
relative to the first one, turned into the frame and scaled by 1 / |t|, t the frame's sum of legs along u (`obb_frame`).

Why that is conservative (u = 2^-24; D the largest magnitude of a turned and scaled coordinate):

- the frame is made in float64 of float32's t and b: any orthonormal frame holds a valid box, and nothing else is asked of
  it. Its axes have length 1 and are perpendicular to 2^-44, so that coordinates along them are those of a point to 2^-42 of
  its largest: AXIS. They are rounded to float32 for turning only;
- a relative point is rounded once (not at all where it is near the first), the axis once, the scale and its product once
  each, products once, two sums: a turned coordinate is off by at most 7.1 u sum |axis| |point| <= 7.1 u |point|, and
  |point| <= sqrt(3) D: 13 u D. Widening it rounds once more, by at most 2 u D: TURN;
- what the shader's float32 may be off by is that of `fit`, from the exact largest magnitudes: maxima do not round. SHADER
  has 2^-8 more for its own roundings and those of the turned axes.

Denormal numbers lose 2^-149 a time: next to nothing, as |t| > 2^-50 and so D |t| > 2^-53.

The extents are the exact first point's coordinate plus turned ones, in float64; they are looser than those of `fit` at each
end by at most 16 u D |t|, 2^-8 of the shader's error and 2^-42 of the largest coordinate, and no looser for being far from
the origin.
"""

import math

import numpy as np

from pipeline.bounds.cbox import error_factor
from pipeline.bounds.fit import AXES, HI, LO, SIZE
from pipeline.bounds.lanes import LANES, least4, most4
from pipeline.bounds.transpose import prefer_wide
from pipeline.jit import inlined

U = 2.0**-24
POLYNOMIAL = getattr(error_factor, "py_func", error_factor)(
    False
)  # as Python: to compile it takes every process a while
SHADER = np.float32(POLYNOMIAL * (1.0 + 2.0**-8))
TURN = np.float32(16.0 * U)  # of D
AXIS = np.float32(2.0**-42)  # of the largest coordinate
HALF = np.float32(0.5)
ONE = np.float32(1.0)
ZERO = np.float32(0.0)
MOST = np.float32(2.0**60)  # coordinates
LEAST_SQUARE, MOST_SQUARE = np.float32(2.0**-100), np.float32(2.0**100)  # of t and b
MOST_RATIO = np.float32(32.0)  # D
LEAST_SINE_SQUARE = np.float32(2.0**-20)  # of the angle between t and b

# Rows of float32. Of the points 16 rows each for x, y, z.
POINTS, TURNED = 0, 48
TURN_AXES, TURN_COSINE, TURN_SINE = 96, 105, 106  # as AXES, COSINE, SINE of `fit`, axes over |t|
LOW, HIGH, LARGEST, FINE = 107, 110, 113, 114  # LARGEST: D
FIRST, MAGNITUDE, SCALE, SIZE32 = 115, 118, 121, 122  # the first point; largest magnitudes of x, y, z; 1 / |t|
ROWS = 123

UNIT = 39  # |t|, in float64, after the rows of `oriented`
ROWS64 = 40


@inlined
def _most_of(s, i):
    return most4(
        most4(abs(s[i]), abs(s[i + LANES]), abs(s[i + 2 * LANES]), abs(s[i + 3 * LANES])),
        most4(abs(s[i + 4 * LANES]), abs(s[i + 5 * LANES]), abs(s[i + 6 * LANES]), abs(s[i + 7 * LANES])),
        most4(abs(s[i + 8 * LANES]), abs(s[i + 9 * LANES]), abs(s[i + 10 * LANES]), abs(s[i + 11 * LANES])),
        most4(abs(s[i + 12 * LANES]), abs(s[i + 13 * LANES]), abs(s[i + 14 * LANES]), abs(s[i + 15 * LANES])),
    )


@inlined
def _measure(s):
    """Rows FIRST and MAGNITUDE."""
    prefer_wide()
    for c in range(3):
        for lane in range(LANES):
            i = (POINTS + 16 * c) * LANES + lane
            s[(FIRST + c) * LANES + lane] = s[i]
            s[(MAGNITUDE + c) * LANES + lane] = _most_of(s, i)


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
        ib = ONE / math.sqrt(bb32)
        s[i + 9 * LANES] = np.float32(bx * tx + by * ty + bz * tz) * ib
        s[i + 10 * LANES] = np.float32(nn * inverse) * ib
        s[SCALE * LANES + lane] = scale
        s[FINE * LANES + lane] = ONE if known else ZERO


@inlined
def _turn(s):
    """Rows TURNED."""
    prefer_wide()
    for k in range(16):
        for lane in range(LANES):
            i, j, f = (POINTS + k) * LANES + lane, (TURNED + k) * LANES + lane, TURN_AXES * LANES + lane
            g = FIRST * LANES + lane
            x, y, z = s[i] - s[g], s[i + 16 * LANES] - s[g + LANES], s[i + 32 * LANES] - s[g + 2 * LANES]
            a = s[f] * x + s[f + LANES] * y + s[f + 2 * LANES] * z
            b = s[f + 3 * LANES] * x + s[f + 4 * LANES] * y + s[f + 5 * LANES] * z
            c = s[f + 6 * LANES] * x + s[f + 7 * LANES] * y + s[f + 8 * LANES] * z
            s[j], s[j + 16 * LANES], s[j + 32 * LANES] = a, b, c


@inlined
def _range4(s, k, lane):
    i = (TURNED + k) * LANES + lane
    a, b, c, d = s[i], s[i + LANES], s[i + 2 * LANES], s[i + 3 * LANES]
    return least4(a, b, c, d), most4(a, b, c, d)


@inlined
def _sum4(s, k, lane):
    i = (TURNED + k) * LANES + lane
    return (s[i] + s[i + LANES]) + (s[i + 2 * LANES] + s[i + 3 * LANES])


@inlined
def _extents(s):
    """Rows LOW and HIGH; LARGEST; FINE also says whether all is finite and D of common size."""
    prefer_wide()
    for r in range(3):
        for lane in range(LANES):
            k = 16 * r
            (a, b), (c, d) = _range4(s, k, lane), _range4(s, k + 4, lane)
            (e, f), (g, h) = _range4(s, k + 8, lane), _range4(s, k + 12, lane)
            s[(LOW + r) * LANES + lane], s[(HIGH + r) * LANES + lane] = least4(a, c, e, g), most4(b, d, f, h)
    for lane in range(LANES):
        total = (_sum4(s, 0, lane) + _sum4(s, 4, lane)) + (_sum4(s, 8, lane) + _sum4(s, 12, lane))
        i, j = LOW * LANES + lane, HIGH * LANES + lane
        least = min(min(s[i], s[i + LANES]), s[i + 2 * LANES])
        most = max(max(s[j], s[j + LANES]), s[j + 2 * LANES])
        most = max(most, -least)
        s[LARGEST * LANES + lane] = most
        fine = (total - total == ZERO) & (most < MOST_RATIO)
        s[FINE * LANES + lane] = s[FINE * LANES + lane] if fine else ZERO


@inlined
def _widen(s):
    """Rows LOW and HIGH, widened; SIZE32: the largest coordinate."""
    prefer_wide()
    for lane in range(LANES):
        i = MAGNITUDE * LANES + lane
        s[SIZE32 * LANES + lane] = max(max(s[i], s[i + LANES]), s[i + 2 * LANES])
    for r in range(3):
        for lane in range(LANES):
            j, f = MAGNITUDE * LANES + lane, (TURN_AXES + 3 * r) * LANES + lane
            low, high = s[(LOW + r) * LANES + lane], s[(HIGH + r) * LANES + lane]
            pad = SHADER * (
                abs(s[f]) * s[j] + abs(s[f + LANES]) * s[j + LANES] + abs(s[f + 2 * LANES]) * s[j + 2 * LANES]
            )
            pad += AXIS * s[SCALE * LANES + lane] * s[SIZE32 * LANES + lane] + TURN * s[LARGEST * LANES + lane]
            s[(LOW + r) * LANES + lane], s[(HIGH + r) * LANES + lane] = low - pad, high + pad


@inlined
def _place(s, d):
    """Rows LO and HI: extents in world space; SIZE."""
    prefer_wide()
    for lane in range(LANES):
        d[SIZE * LANES + lane] = np.float64(s[SIZE32 * LANES + lane])
    for r in range(3):
        for lane in range(LANES):
            i, j = (AXES + 3 * r) * LANES + lane, FIRST * LANES + lane
            unit = d[UNIT * LANES + lane]
            base = d[i] * np.float64(s[j]) + d[i + LANES] * np.float64(s[j + LANES])
            base += d[i + 2 * LANES] * np.float64(s[j + 2 * LANES])
            d[(LO + r) * LANES + lane] = base + unit * np.float64(s[(LOW + r) * LANES + lane])
            d[(HI + r) * LANES + lane] = base + unit * np.float64(s[(HIGH + r) * LANES + lane])


@inlined
def fit_single(s, d):
    """Rows AXES .. SIZE of d, those of `fit.fit_boxes`, from rows POINTS of s; rows TURNED, LARGEST, FINE and so on of s."""
    _measure(s)
    _frames(s, d)
    _turn(s)
    _extents(s)
    _widen(s)
    _place(s, d)
