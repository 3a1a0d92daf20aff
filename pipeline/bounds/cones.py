"""Bounds of a patch's unit normals: cones about its tangents (TPATCH) and over its normal patch (NPATCH).

Munkberg et al. 2010, sections 3.1.3 and 3.2. Normals and tangents are positive combinations of control vectors, and a cone
{x : x.z >= cos(theta) |x|} is convex for theta <= 90 degrees (only): if it holds the control vectors it holds their sums.
Equation 13 of the paper is therefore used up to 90 degrees, and beyond it nothing is known.

Control vectors are differences of control points (exactly zero where points coincide; those add nothing and are skipped).
A net is float64[rows along u, columns along v, 4]: the vector (x, y, z) and `size`, the Bernstein coefficient of a
polynomial that bounds the float32 error of the shader there. Constant positive factors are left out: only directions count.

Polynomial patch: a[i,j] = c[i+1,j] - c[i,j], size |a[i,j]|. Rational patch (all w > 0), with L the sub-net without its last
row along u and d its differences: w X_u - w_u X = 3 (w_L dX - dw X_L), bi-degree (4, 6), as products of two nets of
bi-degree (2, 3); size W |dX| + R |dw|, with W and R the largest weight and |X|. Along v likewise.

What float32 does to a normal (u = 2^-24; for any float32 u, v in [0, 1], so 1-t may be rounded):

- tangent: difference 1; quadratic basis 3, product 1, sum 2; cubic basis 5, product 1, sum 2: 15 roundings, each at most
  u of its term, so the error vector is at most 16 u S, S the polynomial with coefficients `size`;
- rational tangent (dX - dw x) / w: 16 u and a subtraction on dX; on dw x 16 + 37 for x = X/w (two sums of 18, a
  division), a product and a subtraction: at most 58 u S, all times w;
- n = A x B: at most (TANGENT (S_A |B| + |A| S_B) + 3 |A| |B|) u, as rounding of the cross product itself is 2 sqrt(2) u;
  making it unit adds u to its direction (division of each component; the length is common to all).

A tangent in a valid cone is at least as long as its part along the axis. If `size` <= lambda (vector . axis) for all control
vectors, then S <= lambda |A| everywhere, whatever the domain. So the direction of n is off by at most asin of

- TPATCH: (TANGENT (lambda_t + lambda_b) + 3) u / sin(beta - alpha_t - alpha_b), as |A x B| >= |A| |B| times that sine;
- NPATCH: (2 TANGENT + 3) u lambda_n, with sizes S_A S_B and n . z.

The cone is widened by that, and by 2^-40 for float64. The shader computes tiny and huge normals in float64 from float32
differences, which is more exact; those in float32 have 2^-50 < |A x B| < 2^50, and with |A|, |B| < LIMIT neither is so
short that what denormals lose (2^-143) counts. Rational weights must lie in [2^-12, 2^12] for that.

Where the normal is exactly zero, the shader takes that of a point moved 2^-9 of the way to the patch's middle. With a
valid cone over a domain that can only be where a tangent is zero, all control vectors that count there are zero, hence one
at a corner of the domain is. Then the domain is extended to hold the moved points as well, and their tangents are not zero.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.bounds.restrict import restrict_net
from pipeline.jit import helper
from pipeline.types import F64

U = 2.0**-24
TANGENT = 16.0
RATIONAL_TANGENT = 58.0
LIMIT, RATIONAL_LIMIT = 2.0**60, 2.0**26
LEAST_WEIGHT, MOST_WEIGHT = 2.0**-12, 2.0**12
FLOAT64 = 2.0**-40  # above every float64 rounding here, as an angle
ROUND = 2.0**-48  # above those of a single cosine or sine
NUDGE = 2.0**-9  # of domain.py

BINOMIALS = np.array([[math.comb(n, k) for k in range(7)] for n in range(7)], np.float64)


class Work(NamedTuple):
    """Scratch of one thread."""

    points: F64  # (4, 4, 4) control points over the domain, projected: x, y, z, w
    axes: F64  # (3, 3) frame, rows x, y, z
    along_u: F64  # (3, 4, 4) tangent net
    along_v: F64  # (4, 3, 4)
    rational_u: F64  # (5, 7, 4) of a rational patch
    rational_v: F64  # (7, 5, 4)
    factors_u: F64  # (3, 4, 9) nets that the rational ones are products of
    factors_v: F64  # (4, 3, 9)
    normals: F64  # (6, 6, 4) normal patch
    rational_normals: F64  # (11, 11, 4)


def make_work() -> Work:
    """Scratch, not initialized."""
    shapes = [(4, 4, 4), (3, 3), (3, 4, 4), (4, 3, 4), (5, 7, 4), (7, 5, 4)]
    shapes += [(3, 4, 9), (4, 3, 9), (6, 6, 4), (11, 11, 4)]
    return Work(*(np.empty(shape) for shape in shapes))


# Control vectors of tangents


@helper
def _length(x, y, z):
    return math.sqrt(x * x + y * y + z * z)


@helper
def _fill_differences(cp, along_u, along_v):
    """Tangent nets of a polynomial patch cp float32[4, 4, 4]."""
    for i in range(3):
        for j in range(4):
            for c in range(3):
                along_u[i, j, c] = np.float64(cp[i + 1, j, c]) - cp[i, j, c]
            along_u[i, j, 3] = _length(along_u[i, j, 0], along_u[i, j, 1], along_u[i, j, 2])
    for i in range(4):
        for j in range(3):
            for c in range(3):
                along_v[i, j, c] = np.float64(cp[i, j + 1, c]) - cp[i, j, c]
            along_v[i, j, 3] = _length(along_v[i, j, 0], along_v[i, j, 1], along_v[i, j, 2])


@helper
def _zero_corner(net, size):
    """Whether a corner of the net (its component `size`) is exactly zero."""
    i, j = net.shape[0] - 1, net.shape[1] - 1
    return net[0, 0, size] == 0.0 or net[i, 0, size] == 0.0 or net[0, j, size] == 0.0 or net[i, j, size] == 0.0


@helper
def _extend(a, b):
    """[a, b] with the points that the shader moves to from there."""
    return min(a, a + (0.5 - a) * NUDGE), max(b, b + (0.5 - b) * NUDGE)


@helper
def _polynomial_nets(cp, u0, u1, v0, v1, work):
    """Fill work.along_u and along_v over the domain."""
    _fill_differences(cp, work.along_u, work.along_v)
    if u0 == 0.0 and u1 == 1.0 and v0 == 0.0 and v1 == 1.0:
        return
    restrict_net(work.along_u, u0, u1, v0, v1)
    restrict_net(work.along_v, u0, u1, v0, v1)
    if _zero_corner(work.along_u, 3) or _zero_corner(work.along_v, 3):
        (u0, u1), (v0, v1) = _extend(u0, u1), _extend(v0, v1)
        _fill_differences(cp, work.along_u, work.along_v)
        restrict_net(work.along_u, u0, u1, v0, v1)
        restrict_net(work.along_v, u0, u1, v0, v1)


@helper
def _fill_factors(cp, weight, radius, factors):
    """Factors float64[3, 4, 9] (along u) or [4, 3, 9] of a rational tangent: X_L and w_L, dX and dw, size."""
    rows, columns = factors.shape[0], factors.shape[1]
    step_u, step_v = 4 - rows, 4 - columns
    for i in range(rows):
        for j in range(columns):
            for c in range(4):
                left = np.float64(cp[i, j, c])
                factors[i, j, c] = left
                factors[i, j, 4 + c] = cp[i + step_u, j + step_v, c] - left
            d = factors[i, j]
            d[8] = weight * _length(d[4], d[5], d[6]) + radius * abs(d[7])


@helper
def _multiply_factors(factors, out):
    """out = w_L dX - dw X_L and its size, scaled: without the divisors of the product's basis."""
    rows, columns = factors.shape[0], factors.shape[1]
    m, n = rows - 1, columns - 1
    out[:] = 0.0
    for i in range(rows):
        for j in range(columns):
            left = factors[i, j]
            outer = BINOMIALS[m, i] * BINOMIALS[n, j]
            for k in range(rows):
                for h in range(columns):
                    right = factors[k, h]
                    scale = outer * BINOMIALS[m, k] * BINOMIALS[n, h]
                    target = out[i + k, j + h]
                    for c in range(3):
                        target[c] += scale * (left[3] * right[4 + c] - right[7] * left[c])
                    target[3] += scale * right[8]


@helper
def _rational_net(cp, weight, radius, u0, u1, v0, v1, factors, out):
    """Fill one tangent net over the domain; whether a corner of it is zero."""
    _fill_factors(cp, weight, radius, factors)
    restrict_net(factors, u0, u1, v0, v1)
    _multiply_factors(factors, out)
    return _zero_corner(factors, 8)


@helper
def _rational_nets(cp, u0, u1, v0, v1, work):
    """Fill work.rational_u and rational_v over the domain; False where float32 weights lose too much."""
    weight, least, radius = 0.0, np.inf, 2.0**-60
    for i in range(4):
        for j in range(4):
            w = np.float64(cp[i, j, 3])
            weight, least = max(weight, w), min(least, w)
            radius = max(radius, _length(np.float64(cp[i, j, 0]), np.float64(cp[i, j, 1]), np.float64(cp[i, j, 2])))
    if not (least >= LEAST_WEIGHT and weight <= MOST_WEIGHT):
        return False
    zero = _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_u, work.rational_u)
    zero |= _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_v, work.rational_v)
    if zero and not (u0 == 0.0 and u1 == 1.0 and v0 == 0.0 and v1 == 1.0):
        (u0, u1), (v0, v1) = _extend(u0, u1), _extend(v0, v1)
        _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_u, work.rational_u)
        _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_v, work.rational_v)
    return True


# Cones


@helper
def cone_about(net, x, y, z, limit):
    """Cone of the vectors of a net about the unit vector (x, y, z): (tangent^2 of its half angle, largest size / dot).

    Infinite where a vector is not within 90 degrees, or has a size of `limit` or more, or where all are zero.
    """
    steepest, spread = -1.0, 0.0
    for i in range(net.shape[0]):
        for j in range(net.shape[1]):
            a, b, c, size = net[i, j, 0], net[i, j, 1], net[i, j, 2], net[i, j, 3]
            if size == 0.0:
                continue
            dot = a * x + b * y + c * z
            if not (dot > 0.0 and size < limit):
                return np.inf, np.inf
            p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
            steepest = max(steepest, (p * p + q * q + r * r) / (dot * dot))
            spread = max(spread, size / dot)
    return (steepest, spread) if steepest >= 0.0 else (np.inf, np.inf)


@helper
def _widen(sine, cosine, error):
    """(cos, sin) of an angle plus asin(error); (-1, 1) from 90 degrees on."""
    error += FLOAT64
    if not error < 1.0:
        return -1.0, 1.0
    keep = math.sqrt((1.0 - error) * (1.0 + error))
    wider = cosine * keep - sine * error - ROUND
    if not wider > 0.0:
        return -1.0, 1.0
    return wider, min(sine * keep + cosine * error + ROUND, 1.0)


@helper
def combine_tangent_cones(cone_t, cone_b, cos_beta, sin_beta, tangent_error):
    """TPATCH: (cos, sin, x, y), theta the half angle of the normals' cone about z and |n.x|, |n.y| <= x, y in the frame.

    cone_t, cone_b : of `cone_about` for the units of t (the frame's x) and of b = cos_beta x + sin_beta y. Equation 14,
    valid iff alpha_t + alpha_b <= beta, with beta folded to at most 90 degrees; (-1, 1, 1, 1) where not. sin(theta) is
    the largest there is (the paper's "sin(theta) <= 1" is not enough: obtuse cones pass it).
    x, y: from |n.t| <= sin(alpha_t) and |n.b| <= sin(alpha_b), which with |n| = 1 hold for every normal.
    """
    (steep_t, spread_t), (steep_b, spread_b) = cone_t, cone_b
    ct, cb = 1.0 / math.sqrt(1.0 + steep_t), 1.0 / math.sqrt(1.0 + steep_b)
    st, sb = math.sqrt(steep_t) * ct + ROUND, math.sqrt(steep_b) * cb + ROUND
    ct, cb = ct - ROUND, cb - ROUND
    cos_beta, sin_beta = abs(cos_beta) + ROUND, sin_beta - ROUND
    if not (steep_t < np.inf and steep_b < np.inf and ct > 0.0 and cb > 0.0 and sin_beta > 2.0**-30):
        return -1.0, 1.0, 1.0, 1.0
    apart = sin_beta * (ct * cb - st * sb) - cos_beta * (st * cb + ct * sb)  # sin(beta - alpha_t - alpha_b)
    if not (ct * cb - st * sb >= cos_beta and apart > 0.0):
        return -1.0, 1.0, 1.0, 1.0
    sine = math.sqrt(st * st + 2.0 * st * sb * cos_beta + sb * sb) / sin_beta * (1.0 + ROUND)
    if not sine < 1.0:
        return -1.0, 1.0, 1.0, 1.0
    error = (tangent_error * (spread_t + spread_b) + 3.0) * U / apart + U
    cosine, wide = _widen(sine, math.sqrt((1.0 - sine) * (1.0 + sine)), error)
    if cosine < 0.0:
        return -1.0, 1.0, 1.0, 1.0
    error += FLOAT64
    return cosine, wide, min(st + error, wide), min((sb + st * cos_beta) / sin_beta + error, wide)


@helper
def _scale(net):
    """Multiply each vector by the binomials of its place, in place: a product of nets is then a plain convolution."""
    m, n = net.shape[0] - 1, net.shape[1] - 1
    for i in range(m + 1):
        for j in range(n + 1):
            scale = BINOMIALS[m, i] * BINOMIALS[n, j]
            for c in range(4):
                net[i, j, c] *= scale


@helper
def multiply_tangents(along_u, along_v, normals):
    """Control vectors of the normal patch, without the divisors of its basis: cross products of scaled tangent nets.

    Of bi-degree (2m-1, 2n-1) for a polynomial patch of bi-degree (m, n): degrees add along each axis. (Munkberg et al.
    print m+n-1 for both.) Sizes are multiplied and added.
    """
    normals[:] = 0.0
    for i in range(along_u.shape[0]):
        for j in range(along_u.shape[1]):
            ax, ay, az, size = along_u[i, j]
            for k in range(along_v.shape[0]):
                for h in range(along_v.shape[1]):
                    b, n = along_v[k, h], normals[i + k, j + h]
                    n[0] += ay * b[2] - az * b[1]
                    n[1] += az * b[0] - ax * b[2]
                    n[2] += ax * b[1] - ay * b[0]
                    n[3] += size * b[3]


@helper
def _cone_of_normals(along_u, along_v, normals, z, limit, tangent_error):
    """NPATCH: (cos, sin) of the cone about z of the normal patch; (-1, 1) where there is none. The nets are scaled."""
    for net in (along_u, along_v):
        for i in range(net.shape[0]):
            for j in range(net.shape[1]):
                if not net[i, j, 3] < limit:
                    return -1.0, 1.0
    multiply_tangents(along_u, along_v, normals)
    steep, spread = cone_about(normals, z[0], z[1], z[2], np.inf)
    if not steep < np.inf:
        return -1.0, 1.0
    cosine = 1.0 / math.sqrt(1.0 + steep)
    return _widen(math.sqrt(steep) * cosine, cosine, (2.0 * tangent_error + 3.0) * U * spread + U)


@helper
def _tangent_cones(along_u, along_v, axes, cos_beta, sin_beta, limit, tangent_error):
    if not sin_beta > 0.0:
        return -1.0, 1.0, 1.0, 1.0
    x, y = axes[0], axes[1]
    cone_t = cone_about(along_u, x[0], x[1], x[2], limit)
    b = (cos_beta * x[0] + sin_beta * y[0], cos_beta * x[1] + sin_beta * y[1], cos_beta * x[2] + sin_beta * y[2])
    cone_b = cone_about(along_v, b[0], b[1], b[2], limit)
    return combine_tangent_cones(cone_t, cone_b, cos_beta, sin_beta, tangent_error)


@helper
def tangent_normal_bound(cp, rational, u0, u1, v0, v1, cos_beta, sin_beta, work):
    """TPATCH of patch cp float32[4, 4, 4] over the domain, in frame work.axes: see `combine_tangent_cones`."""
    if rational:
        if not _rational_nets(cp, u0, u1, v0, v1, work):
            return -1.0, 1.0, 1.0, 1.0
        return _tangent_cones(
            work.rational_u, work.rational_v, work.axes, cos_beta, sin_beta, RATIONAL_LIMIT, RATIONAL_TANGENT
        )  # fmt: skip
    _polynomial_nets(cp, u0, u1, v0, v1, work)
    return _tangent_cones(work.along_u, work.along_v, work.axes, cos_beta, sin_beta, LIMIT, TANGENT)


@helper
def normal_patch_bound(cp, rational, u0, u1, v0, v1, cos_beta, sin_beta, work):
    """NPATCH over the domain, in frame work.axes: (cos, sin) of the cone about z, (-1, 1) where there is none.

    Its cone lies within TPATCH's but for what rounding adds to either; the narrower one counts.
    """
    cosine, sine, _, _ = tangent_normal_bound(cp, rational, u0, u1, v0, v1, cos_beta, sin_beta, work)
    if not rational:
        _scale(work.along_u)
        _scale(work.along_v)
        c, s = _cone_of_normals(work.along_u, work.along_v, work.normals, work.axes[2], LIMIT, TANGENT)
    elif cosine > 0.0 or _rational_nets(cp, u0, u1, v0, v1, work):
        c, s = _cone_of_normals(
            work.rational_u, work.rational_v, work.rational_normals, work.axes[2], RATIONAL_LIMIT, RATIONAL_TANGENT
        )  # fmt: skip
    else:
        c, s = -1.0, 1.0
    return max(c, cosine), min(s, sine)
