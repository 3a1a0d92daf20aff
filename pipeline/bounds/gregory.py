"""Gregory patches: bicubic patches whose four inner control points depend on (u, v).

Each inner point is (a f+ + b f-) / (a + b), a, b >= 0: it lies between two given points. `Patches.control_points` holds
some point c of its own there (their mean), so along any axis the inner point is at most max(|f+ - c|, |f- - c|) away from
c, and the surface at most that, the largest of the four, times the sum of the four inner Bernstein weights away from the
bicubic patch of `control_points`. That sum is g(u) g(v) with g(t) = 3 t (1 - t), at most 9/16.

What float32 may be off by: 1 - u, two products, their sum, the sum of the weights (of 1 - u and 1 - v, each rounded) and
the quotient: at most 7 roundings (u = 2^-24) of max|f| more than for a point that is given. With 13 u of a Bezier patch
below the 26 u of a rational one, whose factor is used.

Nothing is known of the normals: the tangents hold the derivatives of the quotients.
"""

import numpy as np

from pipeline.jit import helper


@helper
def _most_weight(a, b):
    """Largest 3 t (1 - t) for a <= t <= b."""
    t = min(max(a, 0.5), b)
    return 3.0 * t * (1.0 - t)


@helper
def most_inner_weight(u0, u1, v0, v1):
    """Largest sum of the inner Bernstein weights on the domain, not rounded down."""
    return _most_weight(u0, u1) * _most_weight(v0, v1) * (1.0 + 2.0**-48) + 2.0**-60


@helper
def _place(corner):
    """Number 4 i + j of the inner control point of corner (u, v) = (0,0) (1,0) (1,1) (0,1)."""
    return (5, 9, 10, 6)[corner]


@helper
def reach_of_inner(cp, inner, x, y, z):
    """How far inner points float32[4, 2, 3] are from those of cp float32[64] along (x, y, z); NaN if one is not finite."""
    reach = poison = 0.0
    for corner in range(4):
        k = 4 * _place(corner)
        for side in range(2):
            f = inner[corner, side]
            dx, dy, dz = np.float64(f[0]) - cp[k], np.float64(f[1]) - cp[k + 1], np.float64(f[2]) - cp[k + 2]
            along = abs(dx * x + dy * y + dz * z)
            reach = max(reach, along)
            poison += along * 0.0
    return reach + poison


@helper
def widest_inner(inner, c):
    """Largest |coordinate c| of the given inner points float32[4, 2, 3]; of finite ones."""
    most = 0.0
    for corner in range(4):
        for side in range(2):
            most = max(most, abs(np.float64(inner[corner, side, c])))
    return most
