"""`frustum:world` and `frustum:object`: the frustum's six planes in world space against oriented boxes.

A plane of the frustum is a sum of two rows of the matrix, so a box center +- axes[0] +- axes[1] +- axes[2] lies outside of it
where n . center + d + sum of |n . axes[r]| < 0, less the slack of the float32 shader (`bounds/project.py`). In exact arithmetic
this is the answer of `frustum`, for 6 times 4 products instead of 8 corners.

`frustum:object` asks it of one box a scene object, that of all its patches' bounds; all of them are culled at once, and each
is counted. It culls nothing that `frustum` would not, but for a fraction of the work.
"""

import numpy as np

from pipeline.bounds.project import SLACK
from pipeline.jit import helper, kernel
from pipeline.types import U8, CullFlag, HullInput, PatchBounds

ALIVE, FRUSTUM = int(CullFlag.ALIVE), int(CullFlag.FRUSTUM)
ROUNDING = 2.0**-48  # of a plane's value in float64, relative to its terms


@helper
def box_outside(center, axes, matrix):
    """Whether a box lies outside one plane of the frustum by more than the slack; False for a NaN.

    center : (3,) axes : (3, 3), rows, world space. matrix : (4, 4), world to clip.
    """
    for plane in range(6):
        # left w + x, right w - x, bottom w + y, top w - y, near z, far w - z
        row = plane >> 1
        sign = 1.0 if plane & 1 == 0 else -1.0
        own = 0.0 if plane == 4 else 1.0
        value = own * np.float64(matrix[3, 3]) + sign * np.float64(matrix[row, 3])
        terms = own * abs(matrix[3, 3]) + abs(matrix[row, 3])
        for c in range(3):
            value += (own * np.float64(matrix[3, c]) + sign * np.float64(matrix[row, c])) * center[c]
            extent = abs(center[c]) + abs(axes[0, c]) + abs(axes[1, c]) + abs(axes[2, c])
            terms += (own * abs(matrix[3, c]) + abs(matrix[row, c])) * extent
        for r in range(3):
            reach = 0.0
            for c in range(3):
                reach += (own * np.float64(matrix[3, c]) + sign * np.float64(matrix[row, c])) * axes[r, c]
            value += abs(reach)
        if value < -(SLACK + ROUNDING) * terms:
            return True
    return False


@kernel
def _cull_patches(bounds, matrix, flags):
    for p in range(len(flags)):
        if flags[p] == ALIVE and box_outside(bounds.center[p], bounds.axes[p], matrix):
            flags[p] = FRUSTUM


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches whose box lies outside one plane of the frustum; `flags` uint8[P] modified in place."""
    _cull_patches(bounds, stage.clip_from_world, flags)


@kernel
def _cull_objects(bounds, object_id, matrix, ends, flags):
    for p in range(len(flags)):
        if flags[p] == ALIVE:
            o = object_id[p]
            for c in range(3):
                reach = abs(bounds.axes[p, 0, c]) + abs(bounds.axes[p, 1, c]) + abs(bounds.axes[p, 2, c])
                lo, hi = bounds.center[p, c] - reach, bounds.center[p, c] + reach
                if not (lo > -np.inf and hi < np.inf):  # nothing is known of this patch, nor of its object
                    lo, hi = -np.inf, np.inf
                ends[o, c], ends[o, 3 + c] = min(ends[o, c], lo), max(ends[o, 3 + c], hi)
    center, axes = np.empty(3), np.zeros((3, 3))
    outside = np.zeros(len(ends), np.uint8)
    for o in range(len(ends)):
        for c in range(3):
            center[c] = 0.5 * (ends[o, c] + ends[o, 3 + c])
            axes[c, c] = 0.5 * (ends[o, 3 + c] - ends[o, c]) * (1.0 + ROUNDING) + ROUNDING * abs(center[c])
        outside[o] = 1 if box_outside(center, axes, matrix) else 0
    for p in range(len(flags)):
        if flags[p] == ALIVE and outside[object_id[p]]:
            flags[p] = FRUSTUM


def cull_objects(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag all alive patches of each object whose box lies outside one plane; `flags` uint8[P] modified in place."""
    objects = int(stage.patches.object_id.max(initial=-1)) + 1
    ends = np.tile([np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf], (objects, 1))
    _cull_objects(bounds, stage.patches.object_id, stage.clip_from_world, ends, flags)
