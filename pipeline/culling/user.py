"""A back-patch test made of a user's own function of one patch.

    facing(points, eye) -> 0, 1 or 2, as int64

    points  float64[16, 3]  control points of the patch, world space; u slowest
    eye     float64[3]      world space

The answer is a `backface.Facing`: 1 where (eye - p) . (p_u x p_v) >= 0 at every point p of the Bezier patch of `points`,
2 where it is <= 0 at every one, else 0. Its own rounding is the function's business. It is asked of undisplaced patches with
weights > 0 alone; another answer than those three counts as 0. What the view mirrors, and which side is dropped, is seen to
here.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, classify_with, cull_facing
from pipeline.culling.cones import projected
from pipeline.jit import compile_for, kernel, typed_kernel
from pipeline.types import I64, U8, HullInput, PatchBounds

FACING = types.int64(types.float64[:, ::1], types.float64[::1])


@typed_kernel(
    types.void(
        types.FunctionType(FACING), types.float64[:, :, ::1], types.uint8[::1], types.float64[::1], types.uint8[::1]
    )
)
def _run(facing, points, known, eye, out):
    for k in range(len(out)):
        answer = facing(points[k], eye) if known[k] else SILHOUETTE
        out[k] = answer if answer in (FRONT, BACK) else SILHOUETTE


@kernel
def _gather(control_points, numbers, points, known):
    for k in range(len(numbers)):
        known[k] = projected(control_points[numbers[k]], points[k])


def make_classifier(facing: Callable[..., Any]) -> Callable[[HullInput, I64], U8]:
    """A classifier as `CLASSIFIERS` holds them from `facing`, a Python function or one compiled by `numba.njit`.

    Raises TypeError if it cannot be compiled for those arguments, or does not return an integer.
    """
    compiled = compile_for(facing, FACING)

    def run(control_points: np.ndarray, rational: U8, eye: np.ndarray, numbers: I64, out: U8) -> None:
        points, known = np.empty((len(numbers), 16, 3)), np.empty(len(numbers), np.uint8)
        _gather(control_points, numbers, points, known)
        _run(compiled, points, known, eye, out)

    return lambda stage, numbers: classify_with(run, stage, numbers)


def make_cull_test(classify: Callable[[HullInput, I64], U8]) -> Callable[[HullInput, PatchBounds, U8], None]:
    """A test as `CULL_TESTS` holds them from a classifier."""

    def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
        cull_facing(classify, stage, flags)

    return cull_patches
