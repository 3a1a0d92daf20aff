"""Bounds of the unit normals of whole Bezier patches in float32, in blocks: TPATCH, its tight form, and NPATCH.

As `normals`, on what `single` has turned: differences of points in the frame, over |t|. Patches with a control vector that
is zero, or at 90 degrees to where it should point as far as float32 can tell, are left to `normals` (row FINE); so are
patches whose normals' cone hangs on the error below.

Why it is conservative (u = 2^-24; D the largest magnitude of a turned coordinate; `cones` has the mathematics, T = TANGENT):

- a turned coordinate is off by 12.3 u D (`single`), so the difference of two, rounded, by 27 u D, and a vector by
  VECTOR_T = 47 u D. About b it is turned once more: 3 roundings a component of at most |v| <= 3.5 D, 15 u D: VECTOR_B =
  62 u D. That direction is any one with a positive sine, as both cones are valid about their own axes; its length is off
  by 5 u, which scales dot and side alike, and z by as much the less;
- a tangent is a positive combination of control vectors with weights that add up to 1. So that of the shader is off from
  that of the computed vectors by T u S + VECTOR u D, and the latter is at least as long as the least dot of a vector with
  the cone's axis. The error of `cones.combine_tangent_cones` becomes
  (T (1 / cos(alpha_t) + 1 / cos(alpha_b)) + VECTOR_T D / dot_t + VECTOR_B D / dot_b + 3) u / sin(beta - alpha_t - alpha_b);
- the dots that count are beyond STEEP: there float32 has their sign right, and products of two errors are less than 2^-6
  of their sum, inside MORE;
- sums of squares have only positive terms, so with division and root a sine and a cosine of a cone are off by less than
  16 u of themselves, the choice of the steepest quotient by products included: ROUND; the sine of the remaining angle by
  less than 16 u as such. Of the cone of normals the sine is found so, and the cosine from it, in float64;
- a control vector of the normal patch, its binomials divided out, is an average of cross products a x b with |a| <= A,
  |b| <= B. Binomials round twice, a product once, the difference once, up to 9 of them are added: 13 u sqrt(3) A B, and
  47 u D (A + B) from the vectors. With h the least n.z the shader's normal is off by at most asin of
  ((2 T + 3 + 23) A B + VECTOR_T D (A + B)) u / h. What is not the shader's in that is at most 1 / CLEAR, or the patch is
  left to `normals`; where h is as far below zero there is no cone.
"""

import math

import numpy as np

from pipeline.bounds import normals, single
from pipeline.bounds.cones import FLOAT64, TANGENT, U
from pipeline.bounds.cones import ROUND as ROUND64
from pipeline.bounds.fit import KEPT
from pipeline.bounds.lanes import LANES, most4
from pipeline.bounds.normals import multiply_nets
from pipeline.bounds.single import FINE, LARGEST, ONE, TURNED, ZERO
from pipeline.jit import inlined
from pipeline.vector_width import prefer_wide

VECTOR_T, VECTOR_B = np.float32(47.0 * U), np.float32(62.0 * U)
TANGENTS = np.float32(TANGENT * U)
CROSS = np.float32(3.0 * U)
NORMAL = np.float32((2.0 * TANGENT + 26.0) * U)
MORE = np.float32(1.0 + 2.0**-5)
ROUND = np.float32(2.0**-20)
STEEP = np.float32(2.0**-8)  # dots, in units of |t|
LEAST_SINE = np.float32(2.0**-9)
FAR = np.float32(np.inf)
LEAST_NORMAL = np.float32(2.0**-14)
OWN = np.float32(23.0 * U)
CLEAR = np.float32(2.0**8)
TWO = np.float32(2.0)
FIFTH, TENTH = np.float32(1.0 / 5.0), np.float32(1.0 / 10.0)
LIMIT = np.float32(0.5)
TINY = np.float32(U)

# Rows of float32, after those of `single`. Nets of x, y and z: along u 3 x 4, along v 4 x 3, after each the square of its
# longest vector; the normal patch.
ALONG_U, LONGEST_U, ALONG_V, LONGEST_V = single.ROWS, single.ROWS + 36, single.ROWS + 37, single.ROWS + 73
NORMALS = single.ROWS + 74  # 36 each of x, y, z
CONE_T, CONE_B, CONE_N = (single.ROWS + 182 + 3 * k for k in range(3))  # over, under, least dot
LEAST_Z = single.ROWS + 191
WIDEST, ERROR, ACROSS_X, ACROSS_Y = (single.ROWS + 192 + k for k in range(4))  # sines, of what `_combine` finds
TURN_COSINE, TURN_SINE = single.ROWS + 196, single.ROWS + 197  # of the axis of the cone along v, in the frame
ROWS = single.ROWS + 198

# Rows of float64: |n.x|, |n.y| <= the first two, n.z >= the third, cosine of the cone or -1.
X_MOST, Y_MOST, Z_LEAST, CONE = (KEPT + 2 + k for k in range(4))

# Binomials of the places in the nets: with them in the vectors the normal patch is a plain convolution.
FACTORS_U = tuple(np.float32(f) for f in normals.FACTORS_U)
FACTORS_V = tuple(np.float32(f) for f in normals.FACTORS_V)


# Control vectors


@inlined
def _vector(s, along_v, k, lane):
    """Control vector k of 12: along u of points k and k + 4, along v of neighbours in a row of four.

    Made where it is needed: to keep it would take longer than the difference.
    """
    i = (TURNED + (k + k // 3 if along_v else k)) * LANES + lane
    j = i + (LANES if along_v else 4 * LANES)
    return s[j] - s[i], s[j + 16 * LANES] - s[i + 16 * LANES], s[j + 32 * LANES] - s[i + 32 * LANES]


# Cones of tangents


@inlined
def _find_angles(s):
    """Rows TURN_COSINE and TURN_SINE: direction of b, the sum of legs along v, without what is left of it along z."""
    prefer_wide()
    for lane in range(LANES):
        i = TURNED * LANES + lane
        x = s[i + 3 * LANES] + (s[i + 15 * LANES] - s[i + 12 * LANES])  # the first point is zero
        y = s[i + 19 * LANES] + (s[i + 31 * LANES] - s[i + 28 * LANES])
        inverse = ONE / math.sqrt(x * x + y * y)
        s[TURN_COSINE * LANES + lane], s[TURN_SINE * LANES + lane] = x * inverse, y * inverse


@inlined
def _slope(s, along_v, k, lane):
    """Of a control vector tan^2 of its angle about the cone's axis, as numerator and denominator, and its dot with the axis."""
    x, y, z = _vector(s, along_v, k, lane)
    c, d = s[TURN_COSINE * LANES + lane], s[TURN_SINE * LANES + lane]
    dot, side = (c * x + d * y, c * y - d * x) if along_v else (x, y)
    return side * side + z * z, dot * dot, dot


@inlined
def _steeper(a, b):
    """The greater quotient of two, and the lesser dot."""
    second = b[0] * a[1] > a[0] * b[1]
    return (b[0] if second else a[0]), (b[1] if second else a[1]), min(a[2], b[2])


@inlined
def _slopes(s, along_v, k, lane):
    """The steepest of six."""
    a, b = _slope(s, along_v, k, lane), _slope(s, along_v, k + 1, lane)
    c, d = _slope(s, along_v, k + 2, lane), _slope(s, along_v, k + 3, lane)
    e, f = _slope(s, along_v, k + 4, lane), _slope(s, along_v, k + 5, lane)
    return _steeper(_steeper(_steeper(a, b), _steeper(c, d)), _steeper(e, f))


@inlined
def _cone(s, along_v, out):
    """Rows out ..: tan^2 of a cone's half angle as a quotient, infinite where a vector is beyond STEEP; the least dot.

    Dots that are no numbers may get lost among the others. They come of an axis that is none, of which `_combine` knows
    nothing, or of points that are none (FINE).
    """
    prefer_wide()
    for lane in range(LANES):
        i = out * LANES + lane
        over, under, least = _steeper(_slopes(s, along_v, 0, lane), _slopes(s, along_v, 6, lane))
        known = least > STEEP
        s[i], s[i + LANES], s[i + 2 * LANES] = (over if known else FAR), (under if known else ONE), least


@inlined
def _cone_t(s):
    _cone(s, False, CONE_T)


@inlined
def _cone_b(s):
    _cone(s, True, CONE_B)


@inlined
def _sine_and_cosine(over, under):
    """Of a cone's half angle, the sine not too small, the cosine not too great; NaN where there is no cone."""
    inverse = ONE / (over + under)
    return math.sqrt(over * inverse) * (ONE + ROUND), math.sqrt(under * inverse) * (ONE - ROUND)


@inlined
def _widen(sine, error):
    """(cos, sin) in float64 of the angle of a sine plus asin(error), as `cones.widen`; of the root 1 - error^2 is left."""
    e = error + FLOAT64
    cosine = math.sqrt(max((1.0 - sine) * (1.0 + sine), 0.0))
    return cosine * (1.0 - e * e) - sine * e - ROUND64, min(sine + cosine * e + ROUND64, 1.0)


@inlined
def _combine(s):
    """Rows WIDEST, ERROR, ACROSS_X, ACROSS_Y of TPATCH; FINE: 0 where the sign of a dot is not sure and decides."""
    prefer_wide()
    for lane in range(LANES):
        i, j = CONE_T * LANES + lane, CONE_B * LANES + lane
        st, ct = _sine_and_cosine(s[i], s[i + LANES])
        sb, cb = _sine_and_cosine(s[j], s[j + LANES])
        dot_t, dot_b, size = s[i + 2 * LANES], s[j + 2 * LANES], s[LARGEST * LANES + lane]
        cos_beta, sin_beta = abs(s[TURN_COSINE * LANES + lane]) + ROUND, s[TURN_SINE * LANES + lane] * (ONE - ROUND)
        apart = sin_beta * (ct * cb - st * sb) - cos_beta * (st * cb + ct * sb) - ROUND
        inverse = (ONE + ROUND) / sin_beta
        sine = math.sqrt(st * st + TWO * st * sb * cos_beta + sb * sb) * inverse * (ONE + ROUND)
        spread = TANGENTS * (ct + cb) / (ct * cb) + size * (VECTOR_T * dot_b + VECTOR_B * dot_t) / (dot_t * dot_b)
        error = (spread + CROSS) * MORE / apart + TINY
        known = (apart > LEAST_SINE) & (sin_beta > ZERO) & (sine < ONE) & (error < LIMIT)
        s[WIDEST * LANES + lane], s[ERROR * LANES + lane] = (sine if known else ONE), (error if known else ONE)
        s[ACROSS_X * LANES + lane] = st + error
        s[ACROSS_Y * LANES + lane] = (sb + st * cos_beta) * inverse * (ONE + ROUND) + error
        least = min(dot_t, dot_b)
        clear = (least > STEEP) | (least < -STEEP)
        s[FINE * LANES + lane] = s[FINE * LANES + lane] if clear else ZERO


@inlined
def _finish_tpatch(s, d, tight):
    """Rows X_MOST .. CONE."""
    prefer_wide()
    for lane in range(LANES):
        i, j = WIDEST * LANES + lane, X_MOST * LANES + lane
        error = np.float64(s[i + LANES])
        cosine, wide = _widen(np.float64(s[i]), error)
        known = (cosine > 0.0) & (error < 1.0)
        wide = wide if known else 1.0
        if tight:
            x, y = np.float64(s[i + 2 * LANES]) + FLOAT64, np.float64(s[i + 3 * LANES]) + FLOAT64
            d[j], d[j + LANES] = (min(x, wide) if known else 1.0), (min(y, wide) if known else 1.0)
        else:
            d[j] = d[j + LANES] = wide
        d[j + 2 * LANES] = d[j + 3 * LANES] = cosine if known else -1.0


# The normal patch


@inlined
def _scale(s, along_v, k, net, factor, lane):
    """Control vector k of a tangent, times its binomial, to a net; the square of its length without."""
    i = (net + k) * LANES + lane
    x, y, z = _vector(s, along_v, k, lane)
    s[i], s[i + 12 * LANES], s[i + 24 * LANES] = x * factor, y * factor, z * factor
    return (y * y + z * z) + x * x


@inlined
def _scale4(s, along_v, k, net, factors, lane):
    """Four of them; the greatest square."""
    return most4(
        _scale(s, along_v, k, net, factors[k], lane),
        _scale(s, along_v, k + 1, net, factors[k + 1], lane),
        _scale(s, along_v, k + 2, net, factors[k + 2], lane),
        _scale(s, along_v, k + 3, net, factors[k + 3], lane),
    )


@inlined
def _scale_net(s, along_v, net, factors, longest):
    """Control vectors of a tangent, times their binomials; row `longest`: the greatest square of a length without."""
    prefer_wide()
    for lane in range(LANES):
        a, b = _scale4(s, along_v, 0, net, factors, lane), _scale4(s, along_v, 4, net, factors, lane)
        s[longest * LANES + lane] = max(max(a, b), _scale4(s, along_v, 8, net, factors, lane))


@inlined
def _scale_nets(s):
    _scale_net(s, False, ALONG_U, FACTORS_U, LONGEST_U)
    _scale_net(s, True, ALONG_V, FACTORS_V, LONGEST_V)


@inlined
def _slope_n(s, k, lane):
    i = (NORMALS + k) * LANES + lane
    x, y, z = s[i], s[i + 36 * LANES], s[i + 72 * LANES]
    known = z > LEAST_NORMAL
    return (x * x + y * y if known else FAR), (z * z if known else ONE), ZERO


@inlined
def _slopes_n(s, k, lane):
    """The steepest of six."""
    a = _steeper(_steeper(_slope_n(s, k, lane), _slope_n(s, k + 1, lane)), _slope_n(s, k + 2, lane))
    b = _steeper(_steeper(_slope_n(s, k + 3, lane), _slope_n(s, k + 4, lane)), _slope_n(s, k + 5, lane))
    return _steeper(a, b)


@inlined
def _least_z(s, k, lane):
    """Least z of six, without their binomials along v."""
    i = (NORMALS + 72 + k) * LANES + lane
    outer = min(s[i], s[i + 5 * LANES])
    middle = min(s[i + LANES], s[i + 4 * LANES]) * FIFTH
    inner = min(s[i + 2 * LANES], s[i + 3 * LANES]) * TENTH
    return min(outer, min(middle, inner))


@inlined
def _cone_n(s):
    """Rows CONE_N of the normals' cone about z; LEAST_Z: least n.z, without binomials."""
    prefer_wide()
    for lane in range(LANES):
        a = _steeper(_slopes_n(s, 0, lane), _slopes_n(s, 6, lane))
        b = _steeper(_slopes_n(s, 12, lane), _slopes_n(s, 18, lane))
        c = _steeper(_slopes_n(s, 24, lane), _slopes_n(s, 30, lane))
        s[CONE_N * LANES + lane], s[(CONE_N + 1) * LANES + lane], _ = _steeper(_steeper(a, b), c)
        outer = min(_least_z(s, 0, lane), _least_z(s, 30, lane))
        middle = min(_least_z(s, 6, lane), _least_z(s, 24, lane)) * FIFTH
        inner = min(_least_z(s, 12, lane), _least_z(s, 18, lane)) * TENTH
        s[LEAST_Z * LANES + lane] = min(outer, min(middle, inner))


@inlined
def _measure_npatch(s):
    """Rows WIDEST and ERROR of the normals' cone; FINE: 0 where float32 can tell too little."""
    prefer_wide()
    for lane in range(LANES):
        i, h = CONE_N * LANES + lane, s[LEAST_Z * LANES + lane]
        sine, _ = _sine_and_cosine(s[i], s[i + LANES])
        a, b = math.sqrt(s[LONGEST_U * LANES + lane]), math.sqrt(s[LONGEST_V * LANES + lane])
        vectors = VECTOR_T * s[LARGEST * LANES + lane] * (a + b)
        own = (vectors + OWN * a * b) * CLEAR
        error = (vectors + NORMAL * a * b) * MORE / h + TINY
        known = (h > own) & (sine < ONE) & (error < LIMIT)
        s[WIDEST * LANES + lane], s[ERROR * LANES + lane] = (sine if known else ONE), (error if known else ONE)
        clear = (h > own) | (h < -own)
        s[FINE * LANES + lane] = s[FINE * LANES + lane] if clear else ZERO


@inlined
def _finish_npatch(s, d):
    """Rows X_MOST .. CONE: of the normals' cone, or of the tangents' where that is narrower."""
    prefer_wide()
    for lane in range(LANES):
        i, j = WIDEST * LANES + lane, X_MOST * LANES + lane
        error = np.float64(s[i + LANES])
        cosine, wide = _widen(np.float64(s[i]), error)
        known = (cosine > 0.0) & (error < 1.0)
        d[j] = min(d[j], wide) if known else d[j]
        d[j + LANES] = d[j]
        d[j + 2 * LANES] = d[j + 3 * LANES] = max(d[j + 2 * LANES], cosine) if known else d[j + 2 * LANES]


@inlined
def bound_single(kind, s, d):
    """Rows X_MOST .. CONE of d from rows TURNED of s."""
    _find_angles(s)
    _cone_t(s)
    _cone_b(s)
    _combine(s)
    if kind == normals.TPATCH_TIGHT:
        _finish_tpatch(s, d, True)
    else:
        _finish_tpatch(s, d, False)
    if kind == normals.NPATCH:
        _scale_nets(s)
        multiply_nets(s, ALONG_U, ALONG_V, NORMALS)
        _cone_n(s)
        _measure_npatch(s)
        _finish_npatch(s, d)
