"""Steps of tessellation patterns: how far apart, in u and v, the corners of a pattern's triangles lie.

Every triangle of a quad pattern has an edge along u or along v (or is a degenerate one with two equal corners). With that
edge from a to b on the line v0, and the third corner at c on the line v1, a triangle has

    h = |b - a|    k = |v1 - v0|    g = |c - a|, a being the end nearer to c    r = |c - a| |c - b| / k

and its mirror image under u <-> v the same with an edge along v. Triangles with a right angle have g = r = 0 and count as
having their edge along u. A hull stage that is not told how its factors will be rounded takes the worst of all partitionings.
"""

from enum import IntEnum

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.tessellator import make_patterns
from pipeline.types import F64, I64, Partitioning, TessFactors

PARTITIONINGS = {  # `pow2` makes the patterns of `integer`
    Partitioning.ANY: ("integer", "fractional_odd", "fractional_even"),
    Partitioning.INTEGER: ("integer",),
    Partitioning.POW2: ("integer",),
    Partitioning.FRACTIONAL_ODD: ("fractional_odd",),
    Partitioning.FRACTIONAL_EVEN: ("fractional_even",),
}
WINDING = "triangle_ccw"  # counter-clockwise with v downwards: (u, v) area below 0


class Step(IntEnum):
    """Columns: the largest of each over the triangles with an edge along u; those with an edge along v 8 further on."""

    H = 0
    K = 1
    G = 2
    R = 3
    INV_H = 4  # largest 1 / h
    INV_K = 5
    SKEW = 6  # largest g / (h k)
    INV_HK = 7


NUM_STEPS = 16


@helper
def _widen(row, side, a, b, c, k):
    """Count a triangle with an edge a to b along one parameter and its third corner at c, k away along the other."""
    h = abs(b - a)
    g, far = abs(c - a), abs(c - b)
    if far < g:
        g, far = far, g
    first = 8 * side
    row[first] = max(row[first], h)
    row[first + 1] = max(row[first + 1], k)
    row[first + 2] = max(row[first + 2], g)
    row[first + 3] = max(row[first + 3], g * far / k)
    row[first + 4] = max(row[first + 4], 1.0 / h)
    row[first + 5] = max(row[first + 5], 1.0 / k)
    row[first + 6] = max(row[first + 6], g / (h * k))
    row[first + 7] = max(row[first + 7], 1.0 / (h * k))


@helper
def _measure_triangle(u, v, row):
    u0, u1, u2 = u
    v0, v1, v2 = v
    if (u0 == u1 and v0 == v1) or (u1 == u2 and v1 == v2) or (u2 == u0 and v2 == v0):
        return  # two corners are one point, also on the screen: dropped as of zero area
    if not (u1 - u0) * (v2 - v0) - (v1 - v0) * (u2 - u0) < 0.0:  # of no area, or turned over
        row[:] = np.inf
    elif v0 == v1:
        _widen(row, 0, u0, u1, u2, abs(v2 - v0))
    elif v1 == v2:
        _widen(row, 0, u1, u2, u0, abs(v0 - v1))
    elif v2 == v0:
        _widen(row, 0, u2, u0, u1, abs(v1 - v2))
    elif u0 == u1:
        _widen(row, 1, v0, v1, v2, abs(u2 - u0))
    elif u1 == u2:
        _widen(row, 1, v1, v2, v0, abs(u0 - u1))
    elif u2 == u0:
        _widen(row, 1, v2, v0, v1, abs(u1 - u2))
    else:
        row[:] = np.inf


@kernel
def _measure(uv, first_point, indices, first_triangle, steps):
    for k in range(len(steps)):
        base = first_point[k]
        for t in range(first_triangle[k], first_triangle[k + 1]):
            a, b, c = base + indices[3 * t], base + indices[3 * t + 1], base + indices[3 * t + 2]
            u = (np.float64(uv[0, a]), np.float64(uv[0, b]), np.float64(uv[0, c]))
            v = (np.float64(uv[1, a]), np.float64(uv[1, b]), np.float64(uv[1, c]))
            _measure_triangle(u, v, steps[k])


def measure_steps(factors: TessFactors, numbers: I64, partitioning: int = Partitioning.ANY) -> F64:
    """Steps of the patches `numbers`, float64[len(numbers), NUM_STEPS]; of ANY, the worst of all partitionings.

    Infinite where a factor culls the patch, and where a pattern turns a triangle over (two points that cross).
    """
    some = TessFactors(factors.edge[numbers], factors.inside[numbers])
    worst = np.zeros((len(numbers), NUM_STEPS))
    for name in PARTITIONINGS[Partitioning(partitioning)]:
        patterns = make_patterns(some, name, WINDING)
        steps = np.zeros((len(patterns.first_point) - 1, NUM_STEPS))
        _measure(patterns.uv, patterns.first_point, patterns.indices, patterns.first_triangle, steps)
        steps = np.concatenate([steps, np.full((1, NUM_STEPS), np.inf)])  # the last one answers for -1
        np.maximum(worst, steps[patterns.of_patch], out=worst)
    return worst
