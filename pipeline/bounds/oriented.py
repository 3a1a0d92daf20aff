"""What the oriented bounds share: frame and displacement of a patch before, its box after the bound of its normals.

Munkberg et al. 2010, section 3.1: along each axis of the frame the box is the extent of the control points over the
domain, plus the range of displacement x normal. `obbtex`, `tpatch`, `tpatch_tight` and `npatch` differ in the range of
the normal alone. A patch whose normal is zero somewhere stays where it is there; no algorithm knows a normal bound then
(`cones`), and the range [-1, 1] holds zero.

Widened outwards for the float32 shader (u = 2^-24): the position as in `cbox`, seen along each axis; p + t n rounds once,
t n once, and the components of n are off by at most 4 u in length: 6 u |t|, as vectors at most sqrt(3) times that.
"""

import numpy as np

from pipeline.bounds.cbox import position_errors
from pipeline.bounds.obb_frame import make_frame
from pipeline.bounds.project import project_box
from pipeline.bounds.restrict import domain_displacement, project_net, restrict_patch
from pipeline.jit import helper

U = 2.0**-24
FLOAT64 = 2.0**-46  # above the rounding of projections on the axes, relative to the largest coordinate


@helper
def begin(p, patches, maps, pyramids, domain, work):
    """Fill work.points and work.axes of patch p; returns (least, greatest displacement), (cos, sin) of the frame."""
    u0, u1, v0, v1 = domain[p]
    restrict_patch(patches.control_points[p], u0, u1, v0, v1, work.points)
    if patches.rational[p]:
        project_net(work.points)
    reach = domain_displacement(p, patches, maps, pyramids, u0, u1, v0, v1, False)
    return reach, make_frame(work.points, work.axes)


@helper
def _extent(points, axis):
    """Range of the points along a unit vector."""
    lo, hi = np.inf, -np.inf
    for i in range(4):
        for j in range(4):
            along = points[i, j, 0] * axis[0] + points[i, j, 1] * axis[1] + points[i, j, 2] * axis[2]
            lo, hi = min(lo, along), max(hi, along)
    return lo, hi


@helper
def _product(t_lo, t_hi, n_lo, n_hi):
    """Range of t n."""
    a, b, c, d = t_lo * n_lo, t_lo * n_hi, t_hi * n_lo, t_hi * n_hi
    return min(a, b, c, d), max(a, b, c, d)


@helper
def finish(p, patches, reach, x_most, y_most, z_least, cosine, work, matrix, viewport, bounds):
    """Fill bounds of patch p, whose normals in the frame have |x| <= x_most, |y| <= y_most, z >= z_least.

    cosine : of the half angle of their cone about z; -1 if not known.
    """
    t_lo, t_hi = reach
    displaced = patches.map_id[p] >= 0
    errors = position_errors(patches.control_points[p], patches.rational[p])
    size = 0.0
    for i in range(4):
        for j in range(4):
            q = work.points[i, j]
            size = max(size, abs(q[0]), abs(q[1]), abs(q[2]))
    center = bounds.center[p]
    center[0] = center[1] = center[2] = 0.0
    for r in range(3):
        axis = work.axes[r]
        lo, hi = _extent(work.points, axis)
        pad = FLOAT64 * size + abs(axis[0]) * errors[0] + abs(axis[1]) * errors[1] + abs(axis[2]) * errors[2]
        if displaced:
            d_lo, d_hi = _product(t_lo, t_hi, z_least if r == 2 else -(x_most if r == 0 else y_most),
                                  1.0 if r == 2 else (x_most if r == 0 else y_most))  # fmt: skip
            pad += 12.0 * U * max(abs(t_lo), abs(t_hi)) + 2.0 * U * size * (abs(axis[0]) + abs(axis[1]) + abs(axis[2]))
            lo, hi = lo + d_lo, hi + d_hi
        if not (t_lo > -np.inf and t_hi < np.inf):
            lo = hi = np.nan
        middle, half = 0.5 * (lo + hi), 0.5 * (hi - lo) + pad
        for c in range(3):
            center[c] += middle * axis[c]
            bounds.axes[p, r, c] = half * axis[c]
            bounds.cone_axis[p, c] = axis[c] if cosine > -1.0 else 0.0
    bounds.cone_cos[p] = cosine
    project_box(p, matrix, viewport, bounds)
