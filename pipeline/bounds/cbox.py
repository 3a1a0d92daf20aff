"""`cbox`: Cartesian box of the control points, grown by the largest displacement anywhere in the patch's map.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, section 3.1 and 5.1: the simplest bound, and the baseline of the others.
The surface lies in the convex hull of its control points (weights positive); a displacement t along a unit vector moves
it by at most |t| along any axis.

Why it holds for what float32 computes (u = 2^-24): a basis value has at most 3 roundings, a product 1, each of the two
sums 2, so a coordinate is off by at most (3 + 1 + 2) + (3 + 1 + 2) = 12 u max|c| to first order; a rational one divides
two such sums, and as all weights are positive both errors are relative to w: (12 + 12 + 1) u max|X/w|. A unit normal's
component exceeds 1 by at most 4 u; t n and p + t n round once each. The constants below are those, rounded up.
"""

import numpy as np

from pipeline.bounds.project import allocate, project_box
from pipeline.jit import helper, kernel
from pipeline.types import HullInput, PatchBounds

U = 2.0**-24
UNDERFLOW = 2.0**-140  # above the rounding of denormal results


@helper
def control_box(cp, rational):
    """Box lo, hi (3 + 3 floats) of a patch's control points, widened for float32 evaluation; NaN where a weight <= 0."""
    lo0 = lo1 = lo2 = np.inf
    hi0 = hi1 = hi2 = -np.inf
    factor = 26.0 * U if rational else 13.0 * U
    least_w = 1.0
    for i in range(4):
        for j in range(4):
            w = np.float64(cp[i, j, 3])
            if not w > 0.0:
                factor = np.nan
            least_w = min(least_w, w)
            x, y, z = cp[i, j, 0] / w, cp[i, j, 1] / w, cp[i, j, 2] / w
            lo0, lo1, lo2 = min(lo0, x), min(lo1, y), min(lo2, z)
            hi0, hi1, hi2 = max(hi0, x), max(hi1, y), max(hi2, z)
    tiny = UNDERFLOW / least_w  # what denormal products lose, after the division
    pad0 = (factor + tiny) * max(abs(lo0), abs(hi0)) + tiny
    pad1 = (factor + tiny) * max(abs(lo1), abs(hi1)) + tiny
    pad2 = (factor + tiny) * max(abs(lo2), abs(hi2)) + tiny
    return lo0 - pad0, lo1 - pad1, lo2 - pad2, hi0 + pad0, hi1 + pad1, hi2 + pad2


@helper
def _grow(lo, hi, reach):
    """Grow [lo, hi] by a displacement of at most `reach`, and by its roundings."""
    pad = reach * (1.0 + 6.0 * U) + (2.0 * U * max(abs(lo), abs(hi)) if reach > 0.0 else 0.0)
    return lo - pad, hi + pad


@helper
def _bound(p, patches, ranges, bounds):
    x0, y0, z0, x1, y1, z1 = control_box(patches.control_points[p], patches.rational[p])
    m = patches.map_id[p]
    reach = max(abs(ranges[m, 0]), abs(ranges[m, 1])) if m >= 0 else 0.0
    (x0, x1), (y0, y1), (z0, z1) = _grow(x0, x1, reach), _grow(y0, y1, reach), _grow(z0, z1, reach)
    for c in range(3):
        for r in range(3):
            bounds.axes[p, r, c] = 0.0
    bounds.center[p, 0], bounds.axes[p, 0, 0] = 0.5 * (x0 + x1), 0.5 * (x1 - x0)
    bounds.center[p, 1], bounds.axes[p, 1, 1] = 0.5 * (y0 + y1), 0.5 * (y1 - y0)
    bounds.center[p, 2], bounds.axes[p, 2, 2] = 0.5 * (z0 + z1), 0.5 * (z1 - z0)
    bounds.cone_cos[p] = -1.0


@kernel
def _bound_patches(patches, ranges, matrix, viewport, bounds):
    for p in range(len(patches.control_points)):
        _bound(p, patches, ranges, bounds)
        project_box(p, matrix, viewport, bounds)


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch; all of it, whatever its domain. A weight <= 0 gives a NaN box, which culls nothing."""
    bounds = allocate(len(stage.patches.control_points))
    _bound_patches(stage.patches, stage.pyramids.whole, stage.clip_from_world, stage.viewport, bounds)
    return bounds
