"""Submit order of triangles, for machines that draw them in another order.

LESS keeps the primitive that was submitted first where depths are equal. A machine that reorders its queues, cuts patches
into sub-domains or draws in two phases must therefore compare (depth, submit number). The number is the patch's, and within
it the tessellator's number of the triangle that it is, or was cut from.
"""

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import I32, I64, Patterns, Triangles

PATCH_SHIFT = 16  # a pattern has at most 2 * 64 * 64 triangles


@kernel
def _number(live, owner, of_patch, first, original, triangles, order):
    for k in range(len(live)):
        patch = np.int64(owner[live[k]])
        base = first[of_patch[live[k]]]
        for t in range(triangles.first[k], triangles.first[k] + triangles.used[k]):
            order[t] = (patch << PATCH_SHIFT) + original[base + triangles.source[t]]
            triangles.patch[t] = patch


def number_triangles(live: I32, owner: I32, original: I32, patterns: Patterns, triangles: Triangles) -> I64:
    """Submit number of each set-up triangle, int64[T]; `triangles.patch` becomes the number of the whole patch.

    owner : int32[units], the patch that a unit is, or is a part of. original : for each triangle of the patterns its number
    in the pattern of the whole patch.
    """
    order = np.empty(len(triangles.patch), np.int64)
    _number(live, owner, patterns.of_patch, patterns.first_triangle, original, triangles, order)
    return order


@helper
def comes_before(t, seen, order, stored):
    """Whether triangle t was submitted before what is seen at a sample: `seen` of this batch, -1 for none, or else `stored`."""
    return order[t] < (order[seen] if seen >= 0 else stored)
