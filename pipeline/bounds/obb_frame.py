"""The frame of a patch's oriented box: Munkberg et al. 2010, section 3.1.1.

With the corner points c00, c30, c03, c33: t = c30 - c00 + c33 - c03 along u, b = c03 - c00 + c33 - c30 along v;
x = unit of t, z = unit of t x b, y = z x x. Any orthonormal frame gives a valid box, so where t and b are null or parallel
(closed and degenerate patches) another one is taken.

The axes are orthonormal to a few 2^-53 however close t and b are to parallel: z is made perpendicular to x once more.
"""

import math

import numpy as np

from pipeline.jit import helper, inlined

LEAST_SINE = 1e-12  # of the angle between t and b


@helper
def unit(x, y, z):
    """Unit vector of (x, y, z), however long or short; zero for the zero vector and for non-finite ones."""
    m = max(abs(x), abs(y), abs(z))
    if not (m > 0.0 and m < np.inf):
        return 0.0, 0.0, 0.0
    x, y, z = x / m, y / m, z / m
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@inlined
def cross(a, b):
    """Cross product of two vectors (tuples)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@helper
def _corner_sum(points, i0, j0, i1, j1):
    """Unit of points[i0,j0] - points[0,0] + points[3,3] - points[i1,j1]."""
    a, b, c, d = points[i0, j0], points[0, 0], points[3, 3], points[i1, j1]
    return unit((a[0] - b[0]) + (c[0] - d[0]), (a[1] - b[1]) + (c[1] - d[1]), (a[2] - b[2]) + (c[2] - d[2]))


@helper
def _longest_leg(points):
    """Unit vector of the longest leg of the control polygons; zero if all points coincide."""
    longest, x, y, z = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        for j in range(4):
            for k, m in ((min(i + 1, 3), j), (i, min(j + 1, 3))):
                a, b = points[i, j], points[k, m]
                dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
                length = max(abs(dx), abs(dy), abs(dz))
                if length > longest:
                    longest, x, y, z = length, dx, dy, dz
    return unit(x, y, z)


@helper
def _any_perpendicular(x):
    """A unit vector perpendicular to the unit vector x."""
    if abs(x[0]) <= abs(x[1]) and abs(x[0]) <= abs(x[2]):
        return unit(0.0, -x[2], x[1])
    if abs(x[1]) <= abs(x[2]):
        return unit(x[2], 0.0, -x[0])
    return unit(-x[1], x[0], 0.0)


@helper
def make_frame(points, axes):
    """Fill axes float64[3, 3] (rows x, y, z, orthonormal) from projected points float64[4, 4, >= 3].

    Returns (cos, sin) of the angle between t and b, so that unit of b = cos x + sin y; sin = 0: t or b is null, or they
    are parallel, and nothing is said of b.
    """
    t = _corner_sum(points, 3, 0, 0, 3)
    b = _corner_sum(points, 0, 3, 3, 0)
    n = cross(t, b)
    cosine, sine = 0.0, 0.0
    if n[0] * n[0] + n[1] * n[1] + n[2] * n[2] >= LEAST_SINE * LEAST_SINE:
        x = t
        z = unit(n[0], n[1], n[2])
        lean = z[0] * x[0] + z[1] * x[1] + z[2] * x[2]
        z = unit(z[0] - lean * x[0], z[1] - lean * x[1], z[2] - lean * x[2])
        y = cross(z, x)
        cosine = b[0] * x[0] + b[1] * x[1] + b[2] * x[2]
        sine = b[0] * y[0] + b[1] * y[1] + b[2] * y[2]
    else:
        x = t
        if x[0] == 0.0 and x[1] == 0.0 and x[2] == 0.0:
            x = b
        if x[0] == 0.0 and x[1] == 0.0 and x[2] == 0.0:
            x = _longest_leg(points)
        if x[0] == 0.0 and x[1] == 0.0 and x[2] == 0.0:
            x = (1.0, 0.0, 0.0)
        z = _any_perpendicular(x)
        y = cross(z, x)
    for c in range(3):
        axes[0, c], axes[1, c], axes[2, c] = x[c], y[c], z[c]
    return cosine, sine
