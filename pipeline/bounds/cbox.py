"""`cbox`: Cartesian box of the control points, grown by the largest displacement anywhere in the patch's map.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, section 3.1 and 5.1: the simplest bound, and the baseline of the others.
The surface lies in the convex hull of its control points (weights positive); a displacement t along a unit vector moves
it by at most |t| along any axis. Over a part of a patch the control points are those of the part.

Why it holds for what float32 computes (u = 2^-24): a basis value has at most 3 roundings, a product 1, each of the two
sums 2, so a coordinate is off by at most (3 + 1 + 2) + (3 + 1 + 2) = 12 u max|c| to first order; a rational one divides
two such sums, and as all weights are positive both errors are relative to w: (12 + 12 + 1) u max|X/w|. A unit normal's
component exceeds 1 by at most 4 u; t n and p + t n round once each. The constants below are those, rounded up, which
covers float64 too. The maxima are over the whole patch: that is what the shader adds up, in a part of it as well.
"""

import numpy as np

from pipeline.bounds.project import allocate, project_box
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.jit import helper, kernel
from pipeline.types import HullInput, PatchBounds

U = 2.0**-24
UNDERFLOW = 2.0**-140  # above the rounding of denormal results


@helper
def position_errors(cp, rational):
    """How far the shader's x, y, z (before displacement) may be off; NaN where a weight <= 0. cp float32[4, 4, 4]."""
    x = y = z = 0.0
    least_w = 1.0
    for i in range(4):
        for j in range(4):
            if rational:
                w = np.float64(cp[i, j, 3])
                least_w = min(least_w, w)
                x, y, z = max(x, abs(cp[i, j, 0] / w)), max(y, abs(cp[i, j, 1] / w)), max(z, abs(cp[i, j, 2] / w))
            else:
                x = max(x, abs(np.float64(cp[i, j, 0])))
                y = max(y, abs(np.float64(cp[i, j, 1])))
                z = max(z, abs(np.float64(cp[i, j, 2])))
    factor = 26.0 * U if rational else 13.0 * U
    tiny = UNDERFLOW / least_w if least_w > 0.0 else np.nan  # what denormal products lose, after the division
    factor += tiny
    return factor * x + tiny, factor * y + tiny, factor * z + tiny


@helper
def control_box(cp, rational, u0, u1, v0, v1, net):
    """Box lo, hi (3 + 3 floats) of a patch's control points over the domain, widened for float32 evaluation.

    NaN where a weight <= 0. net : float64[4, 4, 4], scratch; afterwards the projected control points over the domain.
    """
    restrict_patch(cp, u0, u1, v0, v1, net)
    if rational:
        project_net(net)
    lo0 = lo1 = lo2 = np.inf
    hi0 = hi1 = hi2 = -np.inf
    for i in range(4):
        for j in range(4):
            x, y, z = net[i, j, 0], net[i, j, 1], net[i, j, 2]
            lo0, lo1, lo2 = min(lo0, x), min(lo1, y), min(lo2, z)
            hi0, hi1, hi2 = max(hi0, x), max(hi1, y), max(hi2, z)
    pad0, pad1, pad2 = position_errors(cp, rational)
    return lo0 - pad0, lo1 - pad1, lo2 - pad2, hi0 + pad0, hi1 + pad1, hi2 + pad2


@helper
def _grow(lo, hi, reach):
    """Grow [lo, hi] by a displacement of at most `reach`, and by its roundings."""
    pad = reach * (1.0 + 6.0 * U) + (2.0 * U * max(abs(lo), abs(hi)) if reach > 0.0 else 0.0)
    return lo - pad, hi + pad


@helper
def fill_cartesian_box(p, box, reach, bounds):
    """Box p: `box` (of `control_box`) grown by a displacement of at most `reach` along any axis."""
    x0, y0, z0, x1, y1, z1 = box
    (x0, x1), (y0, y1), (z0, z1) = _grow(x0, x1, reach), _grow(y0, y1, reach), _grow(z0, z1, reach)
    for c in range(3):
        for r in range(3):
            bounds.axes[p, r, c] = 0.0
    bounds.center[p, 0], bounds.axes[p, 0, 0] = 0.5 * (x0 + x1), 0.5 * (x1 - x0)
    bounds.center[p, 1], bounds.axes[p, 1, 1] = 0.5 * (y0 + y1), 0.5 * (y1 - y0)
    bounds.center[p, 2], bounds.axes[p, 2, 2] = 0.5 * (z0 + z1), 0.5 * (z1 - z0)
    bounds.cone_cos[p] = -1.0


@kernel
def _bound_patches(patches, ranges, domain, matrix, viewport, net, bounds):
    for p in range(len(patches.control_points)):
        u0, u1, v0, v1 = domain[p]
        box = control_box(patches.control_points[p], patches.rational[p], u0, u1, v0, v1, net)
        m = patches.map_id[p]
        reach = max(abs(ranges[m, 0]), abs(ranges[m, 1])) if m >= 0 else 0.0
        fill_cartesian_box(p, box, reach, bounds)
        project_box(p, matrix, viewport, bounds)


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 gives a NaN box, which culls nothing."""
    bounds = allocate(len(stage.patches.control_points))
    _bound_patches(
        stage.patches,
        stage.pyramids.whole,
        stage.domain,
        stage.clip_from_world,
        stage.viewport,
        np.empty((4, 4, 4)),
        bounds,
    )
    return bounds
