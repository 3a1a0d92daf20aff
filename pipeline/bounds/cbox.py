"""`cbox`: Cartesian box of the control points, grown by the largest displacement anywhere in the patch's map.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, section 3.1 and 5.1: the simplest bound, and the baseline of the others.
The surface lies in the convex hull of its control points (weights positive); a displacement t along a unit vector moves
it by at most |t| along any axis. Over a part of a patch the control points are those of the part.

Why it holds for what float32 computes (u = 2^-24): a basis value has at most 3 roundings, a product 1, each of the two
sums 2, so a coordinate is off by at most (3 + 1 + 2) + (3 + 1 + 2) = 12 u max|c| to first order; a rational one divides
two such sums, and as all weights are positive both errors are relative to w: (12 + 12 + 1) u max|X/w|. A unit normal's
component exceeds 1 by at most 4 u; t n and p + t n round once each. The constants below are those, rounded up, which
covers float64 too. The maxima are over the whole patch: that is what the shader adds up, in a part of it as well.

The least and the greatest of float32 numbers are exact in float32: whole Bezier patches are reduced as they lie in memory,
16 numbers at a time. Others go by the scalar functions.
"""

import numpy as np

from pipeline.bounds.gregory import most_inner_weight, reach_of_inner, widest_inner
from pipeline.bounds.project import allocate, project_boxes
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, HullInput, PatchBounds

U = 2.0**-24
ZERO = np.float32(0.0)
UNDERFLOW = 2.0**-140  # above the rounding of denormal results


@inlined
def error_factor(twice):
    """Roundings of an undisplaced coordinate, in multiples of the largest; `twice`: of a rational or Gregory patch."""
    return 26.0 * U if twice else 13.0 * U


@inlined
def widen_errors(x, y, z, least_w, twice):
    """`position_errors` from the largest magnitudes and the least weight (1 if all are)."""
    tiny = UNDERFLOW / least_w if least_w > 0.0 else np.nan  # what denormal products lose, after the division
    factor = error_factor(twice) + tiny
    return factor * x + tiny, factor * y + tiny, factor * z + tiny


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
    return widen_errors(x, y, z, least_w, rational)


@helper
def _restricted_box(patches, p, domain, net):
    """Box lo, hi (3 + 3 floats) of patch p's control points over the domain, widened for float32 evaluation.

    NaN where a weight <= 0 or a coordinate is not finite. net : float64[4, 4, 4], scratch.
    """
    cp, rational, row = patches.control_points[p], patches.rational[p] != 0, patches.gregory_id[p]
    u0, u1, v0, v1 = domain[p]
    restrict_patch(cp, u0, u1, v0, v1, net)
    if rational:
        project_net(net)
    lo0 = lo1 = lo2 = np.inf
    hi0 = hi1 = hi2 = -np.inf
    poison = 0.0
    for i in range(4):
        for j in range(4):
            x, y, z = net[i, j, 0], net[i, j, 1], net[i, j, 2]
            lo0, lo1, lo2 = min(lo0, x), min(lo1, y), min(lo2, z)
            hi0, hi1, hi2 = max(hi0, x), max(hi1, y), max(hi2, z)
            poison += (x * 0.0 + y * 0.0) + z * 0.0
    pad0, pad1, pad2 = position_errors(cp, rational)
    if row >= 0:
        inner, weight = patches.inner[row], most_inner_weight(u0, u1, v0, v1)
        flat = cp.reshape(64)
        most0, most1 = max(abs(lo0), abs(hi0), widest_inner(inner, 0)), max(abs(lo1), abs(hi1), widest_inner(inner, 1))
        most2 = max(abs(lo2), abs(hi2), widest_inner(inner, 2))
        more0, more1, more2 = widen_errors(most0, most1, most2, 1.0, True)
        pad0 = max(pad0, more0) + weight * reach_of_inner(flat, inner, 1.0, 0.0, 0.0)
        pad1 = max(pad1, more1) + weight * reach_of_inner(flat, inner, 0.0, 1.0, 0.0)
        pad2 = max(pad2, more2) + weight * reach_of_inner(flat, inner, 0.0, 0.0, 1.0)
    pad0, pad1, pad2 = pad0 + poison, pad1 + poison, pad2 + poison
    return lo0 - pad0, lo1 - pad1, lo2 - pad2, hi0 + pad0, hi1 + pad1, hi2 + pad2


@helper
def _whole_box(cp, t):
    """The same of a whole polynomial patch cp float32[64]; t : float32[48], scratch."""
    for c in range(16):
        t[c] = min(min(cp[c], cp[c + 16]), min(cp[c + 32], cp[c + 48]))
        t[c + 16] = max(max(cp[c], cp[c + 16]), max(cp[c + 32], cp[c + 48]))
        t[c + 32] = (cp[c] * ZERO + cp[c + 16] * ZERO) + (cp[c + 32] * ZERO + cp[c + 48] * ZERO)
    for c in range(4):
        t[c] = min(min(t[c], t[c + 4]), min(t[c + 8], t[c + 12]))
        t[c + 16] = max(max(t[c + 16], t[c + 20]), max(t[c + 24], t[c + 28]))
        t[c + 32] = (t[c + 32] + t[c + 36]) + (t[c + 40] + t[c + 44])
    x0, y0, z0 = np.float64(t[0]), np.float64(t[1]), np.float64(t[2])
    x1, y1, z1 = np.float64(t[16]), np.float64(t[17]), np.float64(t[18])
    poison = np.float64((t[32] + t[33]) + t[34])
    most_x, most_y, most_z = max(abs(x0), abs(x1)), max(abs(y0), abs(y1)), max(abs(z0), abs(z1))
    x, y, z = widen_errors(most_x, most_y, most_z, 1.0, False)
    x, y, z = x + poison, y + poison, z + poison
    return x0 - x, y0 - y, z0 - z, x1 + x, y1 + y, z1 + z


@helper
def _grow(lo, hi, reach):
    """Grow [lo, hi] by a displacement of at most `reach`, and by its roundings."""
    pad = reach * (1.0 + 6.0 * U) + (2.0 * U * max(abs(lo), abs(hi)) if reach > 0.0 else 0.0)
    return lo - pad, hi + pad


@helper
def _fill_box(p, box, reach, bounds):
    """Box p: `box` grown by a displacement of at most `reach` along any axis."""
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
def _fill_boxes(patches, flat, domain, ranges, by_map, net, t, bounds):
    for p in range(len(flat)):
        whole = domain[p, 0] == 0.0 and domain[p, 1] == 1.0 and domain[p, 2] == 0.0 and domain[p, 3] == 1.0
        if whole and patches.rational[p] == 0 and patches.gregory_id[p] < 0:
            box = _whole_box(flat[p], t)
        else:
            box = _restricted_box(patches, p, domain, net)
        column = patches.map_id[p] if by_map else p
        reach = max(abs(ranges[0, column]), abs(ranges[1, column])) if column >= 0 else 0.0
        _fill_box(p, box, reach, bounds)


def bound_cartesian(stage: HullInput, ranges: F64, by_map: bool) -> PatchBounds:
    """Cartesian boxes of all patches over their domains. A weight <= 0 gives a NaN box, which culls nothing.

    ranges : least and greatest displacement, world units, rows float64[2, maps] (by_map) or float64[2, at least P].
    """
    n = len(stage.patches.control_points)
    bounds = allocate(n)
    flat = stage.patches.control_points.reshape(n, 64)
    net, t = np.empty((4, 4, 4)), np.empty(48, np.float32)
    _fill_boxes(stage.patches, flat, stage.domain, ranges, by_map, net, t, bounds)
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 gives a NaN box, which culls nothing."""
    return bound_cartesian(stage, np.ascontiguousarray(stage.pyramids.whole.T), True)
