"""What the back-patch tests share: the three-way class of a patch, and how a class becomes a cull.

Which side of a patch is seen. A point p is front-facing to the eye e where (e - p) . (p_u x p_v) > 0, back-facing where
it is < 0. A test answers for the whole patch: every point front-facing or edge-on (FRONT), every point back-facing or
edge-on (BACK), or neither is certain (SILHOUETTE). A matrix that mirrors exchanges what the rasterizer calls front and
back, and so it does here.

No test answers for a displaced patch: the normal of the displaced surface is not that of the base patch, and nothing here
bounds it. The same holds for weights <= 0, an eye that is not known, and whatever gives a NaN.
"""

from collections.abc import Callable
from enum import IntEnum

import numpy as np

from pipeline.types import F64, I64, U8, CullFlag, FaceCull, HullInput


class Facing(IntEnum):
    """Class of a patch. FRONT and BACK have the values of the FaceCull that drops them."""

    SILHOUETTE = 0
    FRONT = 1
    BACK = 2


SILHOUETTE, FRONT, BACK = (int(f) for f in Facing)

Classifier = Callable[[HullInput, I64], U8]


def eye_or_none(stage: HullInput) -> F64 | None:
    """The eye, float64[3], world space; None where it is not finite."""
    return stage.eye if np.isfinite(stage.eye).all() else None


def mirrored(stage: HullInput) -> bool:
    """Whether the view turns clockwise triangles into counter-clockwise ones: det of the rows x, y, w is above 0.

    A usual camera (x right, y up, w against z, from a right-handed world) has it below 0.
    """
    rows = stage.clip_from_world[[0, 1, 3], :3].astype(np.float64)
    scale = np.abs(rows).max(axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        return bool(np.linalg.det(rows / scale) > 0.0) if np.isfinite(rows).all() and scale.all() else False


def undisplaced(stage: HullInput, numbers: I64) -> I64:
    """Those of the patches `numbers` that a back-patch test may answer for."""
    return numbers[stage.patches.map_id[numbers] < 0]


def classify_with(kernel: Callable[..., None], stage: HullInput, numbers: I64) -> U8:
    """Run `kernel(control_points, rational, eye, numbers, out)` on the undisplaced patches of `numbers`.

    Returns the Facing of each, uint8[len(numbers)], front and back exchanged where the view mirrors.
    """
    facing = np.zeros(len(numbers), np.uint8)
    eye = eye_or_none(stage)
    if eye is None:
        return facing
    plain = stage.patches.map_id[numbers] < 0
    out = np.zeros(int(plain.sum()), np.uint8)
    kernel(stage.patches.control_points, stage.patches.rational, eye, numbers[plain], out)
    if mirrored(stage):
        out = np.array([SILHOUETTE, BACK, FRONT], np.uint8)[out]
    facing[plain] = out
    return facing


def cull_facing(classify: Classifier, stage: HullInput, flags: U8) -> None:
    """Flag alive patches that `classify` puts wholly on the side that the rasterizer drops; `flags` modified in place."""
    if stage.face_cull == FaceCull.NONE or eye_or_none(stage) is None:
        return
    alive = np.flatnonzero(flags == CullFlag.ALIVE)
    dropped = classify(stage, alive) == stage.face_cull
    flags[alive[dropped]] = CullFlag.BACKFACE
