"""A bound made of a user's own function of one patch.

The function says where the *exact* displaced surface lies; what float32 may add is added here, so that a bound that is right
on paper is right for the shader. It is compiled by itself, and called through its address: the loop over patches is compiled
once for all of them, and is in the disk cache.

    box(points, reach, center, axes)

    points  float64[16, 3]  control points of the patch, or of the part of it that is asked for, world space; u slowest
    reach   float64         no point is displaced by more, world units
    center  float64[3]      to be filled: middle of the box
    axes    float64[3, 3]   to be filled, 0 when called: rows are half-extent vectors, the box is center +- each of them

It must hold every point of the Bezier patch of `points`, moved by `reach` or less in any direction. Rows of `axes` that are
not at right angles are no box: the Cartesian one around their parallelepiped is taken. A NaN says nothing of the patch.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from pipeline.bounds.cbox import U, position_errors, widen_errors
from pipeline.bounds.gregory import most_inner_weight, reach_of_inner, widest_inner
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.project import allocate, project_boxes
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.jit import compile_for, helper, kernel, typed_kernel
from pipeline.types import HullInput, PatchBounds

RIGHT_ANGLE = 2.0**-30  # cosine; what such a tilt does to a box is below what it is widened by
MATRIX, VECTOR = types.float64[:, ::1], types.float64[::1]
BOX = types.void(MATRIX, types.float64, VECTOR, MATRIX)


@typed_kernel(types.void(types.FunctionType(BOX), types.float64[:, :, ::1], VECTOR, MATRIX, types.float64[:, :, ::1]))
def _run(box, points, reach, center, axes):
    for p in range(len(points)):
        if np.isfinite(reach[p]):
            box(points[p], reach[p], center[p], axes[p])


@kernel
def _prepare(patches, domain, ranges, net, points, reach, slack):
    """Points and reach of each patch, and how far the float32 shader may leave the exact surface, float64[3]."""
    for p in range(len(points)):
        cp, rational, row = patches.control_points[p], patches.rational[p] != 0, patches.gregory_id[p]
        u0, u1, v0, v1 = domain[p]
        restrict_patch(cp, u0, u1, v0, v1, net)
        if rational:
            project_net(net)
        ex, ey, ez = position_errors(cp, rational)
        slack[p, 0], slack[p, 1], slack[p, 2] = ex, ey, ez
        if row >= 0:
            inner, weight, flat = patches.inner[row], most_inner_weight(u0, u1, v0, v1), cp.reshape(64)
            x, y, z = widest_inner(inner, 0), widest_inner(inner, 1), widest_inner(inner, 2)
            x, y, z = widen_errors(x, y, z, 1.0, True)
            slack[p, 0] = 2.0 * ex + x + weight * reach_of_inner(flat, inner, 1.0, 0.0, 0.0)
            slack[p, 1] = 2.0 * ey + y + weight * reach_of_inner(flat, inner, 0.0, 1.0, 0.0)
            slack[p, 2] = 2.0 * ez + z + weight * reach_of_inner(flat, inner, 0.0, 0.0, 1.0)
        most = max(abs(ranges[0, p]), abs(ranges[1, p]))
        poison = 0.0
        for c in range(3):
            far = 0.0
            for k in range(16):
                points[p, k, c] = net[k // 4, k % 4, c]
                far = max(far, abs(points[p, k, c]))
                poison += points[p, k, c] * 0.0
            if most > 0.0:  # the sum's rounding; a unit normal's excess is in the reach
                slack[p, c] += 2.0 * U * (far + most)
        reach[p] = most * (1.0 + 8.0 * U) + poison + (slack[p, 0] + slack[p, 1] + slack[p, 2]) * 0.0


@helper
def _length(a):
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@helper
def _is_box(axes):
    """Whether three half-extents are longer than 0 and at right angles."""
    for r in range(3):
        a, b = axes[r], axes[(r + 1) % 3]
        size = _length(a) * _length(b)
        if not (size > 1e-280 and abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) <= RIGHT_ANGLE * size):
            return False
    return True


@kernel
def _finish(reach, slack, bounds):
    """Widen each box by its slack; NaN where nothing is known."""
    half = np.empty(3)
    for p in range(len(reach)):
        axes, center, e = bounds.axes[p], bounds.center[p], slack[p]
        bounds.cone_cos[p] = -1.0
        if not np.isfinite(reach[p]):
            center[:] = np.nan
            continue
        if not _is_box(axes):
            for c in range(3):
                half[c] = abs(axes[0, c]) + abs(axes[1, c]) + abs(axes[2, c])
            axes[:] = 0.0
            for c in range(3):
                axes[c, c] = half[c] + e[c] + 2.0**-48 * (half[c] + abs(center[c]))
            continue
        for r in range(3):
            size = _length(axes[r])
            along = (abs(axes[r, 0]) * e[0] + abs(axes[r, 1]) * e[1] + abs(axes[r, 2]) * e[2]) / size
            far = abs(center[0]) + abs(center[1]) + abs(center[2]) + size
            grow = 1.0 + (along + 2.0**-28 * _length(axes[(r + 1) % 3]) + 2.0**-28 * _length(axes[(r + 2) % 3])) / size
            axes[r] *= grow + 2.0**-44 * (far / size)


def make_bound(box: Callable[..., Any]) -> Callable[[HullInput], PatchBounds]:
    """A bound as `BOUNDS` holds them from `box`, a Python function or one compiled by `numba.njit`; see the module.

    Raises TypeError if it cannot be compiled for those arguments, or returns something.
    """
    compiled = compile_for(box, BOX)

    def bound_patches(stage: HullInput) -> PatchBounds:
        n = len(stage.patches.control_points)
        bounds = allocate(n)
        bounds.center[:], bounds.axes[:] = 0.0, 0.0
        points, reach, slack = np.empty((n, 16, 3)), np.empty(n), np.empty((n, 3))
        ranges = displacement_ranges(stage)
        _prepare(stage.patches, stage.domain, ranges, np.empty((4, 4, 4)), points, reach, slack)
        _run(compiled, points, reach, bounds.center, bounds.axes)
        _finish(reach, slack, bounds)
        project_boxes(stage.clip_from_world, stage.viewport, bounds)
        return bounds

    return bound_patches
