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

import numpy as np

from pipeline.jit import helper, inlined

U = 2.0**-24
TANGENT = 16.0
RATIONAL_TANGENT = 58.0
FLOAT64 = 2.0**-40  # above every float64 rounding here, as an angle
ROUND = 2.0**-48  # above those of a single cosine or sine


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


@inlined
def widen(sine, cosine, error):
    """(cos, sin) of an angle plus asin(error); (-1, 1) from 90 degrees on."""
    error += FLOAT64
    keep = math.sqrt(max((1.0 - error) * (1.0 + error), 0.0))
    wider = cosine * keep - sine * error - ROUND
    known = (error < 1.0) & (wider > 0.0)
    return (wider if known else -1.0), (min(sine * keep + cosine * error + ROUND, 1.0) if known else 1.0)


@inlined
def combine_tangent_cones(cone_t, cone_b, cos_beta, sin_beta, tangent_error):
    """TPATCH: (cos, sin, x, y, error), theta the half angle of the normals' cone about z and |n.x|, |n.y| <= x, y in the frame.

    cone_t, cone_b : of `cone_about` for the units of t (the frame's x) and of b = cos_beta x + sin_beta y. Equation 14,
    valid iff alpha_t + alpha_b <= beta, with beta folded to at most 90 degrees; (-1, 1, 1, 1) where not. sin(theta) is
    the largest there is (the paper's "sin(theta) <= 1" is not enough: obtuse cones pass it).
    x, y: from |n.t| <= sin(alpha_t) and |n.b| <= sin(alpha_b), which with |n| = 1 hold for every normal.
    error: sine of the angle by which the shader's normal may be off. Without branches: a loop over lanes vectorizes.
    """
    (steep_t, spread_t), (steep_b, spread_b) = cone_t, cone_b
    ct, cb = 1.0 / math.sqrt(1.0 + steep_t), 1.0 / math.sqrt(1.0 + steep_b)
    st, sb = math.sqrt(steep_t) * ct + ROUND, math.sqrt(steep_b) * cb + ROUND
    ct, cb = ct - ROUND, cb - ROUND
    cos_beta, sin_beta = abs(cos_beta) + ROUND, sin_beta - ROUND
    known = (steep_t < np.inf) & (steep_b < np.inf) & (ct > 0.0) & (cb > 0.0) & (sin_beta > 2.0**-30)
    apart = sin_beta * (ct * cb - st * sb) - cos_beta * (st * cb + ct * sb)  # sin(beta - alpha_t - alpha_b)
    sine = math.sqrt(st * st + 2.0 * st * sb * cos_beta + sb * sb) / sin_beta * (1.0 + ROUND)
    known = known & (ct * cb - st * sb >= cos_beta) & (apart > 0.0) & (sine < 1.0)
    error = (tangent_error * (spread_t + spread_b) + 3.0) * U / apart + U
    cosine, wide = widen(sine, math.sqrt(max((1.0 - sine) * (1.0 + sine), 0.0)), error)
    known = known & (cosine > 0.0)
    x, y = st + (error + FLOAT64), (sb + st * cos_beta) / sin_beta + (error + FLOAT64)
    return (
        cosine if known else -1.0,
        wide if known else 1.0,
        min(x, wide) if known else 1.0,
        min(y, wide) if known else 1.0,
        error,
    )
