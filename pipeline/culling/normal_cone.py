"""The cone about the normal control vectors of one patch, all weights 1, and how long its control polygons' legs are.

`chords` does the same for a block of patches, where the patches displaced by a map are many; those displaced by a constant,
which this is for, are few.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.culling.cones import MAX_VECTORS, normal_vectors
from pipeline.jit import helper
from pipeline.types import F64

C5 = np.array([1.0, 5.0, 10.0, 10.0, 5.0, 1.0])


class Work(NamedTuple):
    """Scratch of one call of a kernel."""

    normals: F64  # (MAX_VECTORS, 3) control vectors of N, 6 p + q
    units: F64  # (36, 3) of them


@helper
def make_work():
    """Scratch, not initialized."""
    return Work(np.empty((MAX_VECTORS, 3)), np.empty((36, 3)))


@helper
def _length(v):
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@helper
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper
def longest_differences(points):
    """Longest difference of neighbouring control points along u and along v, and the largest distance from the first."""
    a = b = size = 0.0
    for k in range(16):
        p = points[k]
        x, y, z = p[0] - points[0, 0], p[1] - points[0, 1], p[2] - points[0, 2]
        size = max(size, math.sqrt(x * x + y * y + z * z))
        if k < 12:
            q = points[k + 4]
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            a = max(a, math.sqrt(x * x + y * y + z * z))
        if k & 3 < 3:
            q = points[k + 1]
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            b = max(b, math.sqrt(x * x + y * y + z * z))
    return a, b, size


@helper
def normal_cone(cp, points, work):
    """Control vectors of (p_u x p_v) / 9 of the points, true Bernstein coefficients, and their units.

    Returns (axis, cosine of the half angle, least height, greatest length); cosine -1 where there is no cone, or some
    vector is zero.
    """
    normal_vectors(cp, points, False, work.normals)
    none = (0.0, 0.0, 0.0)
    x = y = z = 0.0
    for k in range(36):
        n = work.normals[k]
        divisor = C5[k // 6] * C5[k % 6]
        n[0], n[1], n[2] = n[0] / divisor, n[1] / divisor, n[2] / divisor
        length = _length(n)
        if not (length > 0.0 and length < np.inf):
            return none, -1.0, 0.0, 0.0
        unit = work.units[k]
        unit[0], unit[1], unit[2] = n[0] / length, n[1] / length, n[2] / length
        x, y, z = x + unit[0], y + unit[1], z + unit[2]
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1.0:
        return none, -1.0, 0.0, 0.0
    axis = (x / length, y / length, z / length)
    cosine, least, greatest = 1.0, np.inf, 0.0
    for k in range(36):
        cosine = min(cosine, _dot(work.units[k], axis))
        least = min(least, _dot(work.normals[k], axis))
        greatest = max(greatest, _length(work.normals[k]))
    return axis, cosine, least, greatest
