"""What the back-patch tests share: the three-way class of a patch, and how a class becomes a cull.

Which side of a patch is seen. A point p is front-facing to the eye e where (e - p) . (p_u x p_v) > 0, back-facing where
it is < 0. A test answers for the whole patch: every point front-facing or edge-on (FRONT), every point back-facing or
edge-on (BACK), or neither is certain (SILHOUETTE). A matrix that mirrors exchanges what the rasterizer calls front and
back, and so it does here.

Which patches a test answers for is decided here, in one place. A displaced surface has another normal than its base, so the
tests of base normals take undisplaced patches (`is_plain`); `displaced` and `tessellation_safe` bound the displaced normal,
and take displaced patches that are one polynomial net (`is_single_net`): neither rational, nor ACC, whose displacement has
the direction of other tangents; nor displaced by vectors or by a seam's owner. Where displaced patches share normals on
their edges, the surface jumps there by t times `Patches.normal_slack`: with more than MOST_SLACK of it a patch is no single
net. `tessellation_safe` counts that jump among what a vertex may be off by; the others answer for the surface inside. No test
answers for Gregory patches (they are not the surface of 16 points), for weights <= 0, for an eye that is not known, and where
something gives a NaN.
"""

from collections.abc import Callable
from enum import IntEnum

import numpy as np

from pipeline.bounds.vector import is_special
from pipeline.types import B1, F64, I64, U8, CullFlag, FaceCull, HullInput, Patches


class Facing(IntEnum):
    """Class of a patch. FRONT and BACK have the values of the FaceCull that drops them."""

    SILHOUETTE = 0
    FRONT = 1
    BACK = 2


SILHOUETTE, FRONT, BACK = (int(f) for f in Facing)

MOST_SLACK = (
    2.0**-12
)  # of a displaced patch's normals on its edges; rounding makes 2^-17, creases and corners more than 1

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


def is_plain(patches: Patches, numbers: I64) -> B1:
    """Which of the patches `numbers` are the surface of their 16 control points: undisplaced, Bezier or ACC."""
    return (patches.map_id[numbers] < 0) & (patches.gregory_id[numbers] < 0)


def is_single_net(stage: HullInput, numbers: I64) -> B1:
    """Which of the patches `numbers` follow from one net of points, all weights 1, displaced along its own normal or not.

    Not those displaced by vectors, and not those whose edges take the displacement of another patch (closed seams).
    """
    patches = stage.patches
    own_normal = (patches.tangent_id[numbers] < 0) & (patches.normal_slack[numbers] <= MOST_SLACK)
    bezier = (patches.map_id[numbers] < 0) | own_normal
    fine = bezier & (patches.gregory_id[numbers] < 0) & (patches.rational[numbers] == 0)
    return fine & ~is_special(patches, stage.maps)[numbers]


def turn_mirrored(stage: HullInput, facing: U8) -> U8:
    """`facing` with front and back exchanged where the view mirrors."""
    return np.array([SILHOUETTE, BACK, FRONT], np.uint8)[facing] if mirrored(stage) else facing


def classify_with(kernel: Callable[..., None], stage: HullInput, numbers: I64) -> U8:
    """Run `kernel(control_points, rational, eye, numbers, out)` on the plain patches of `numbers`.

    Returns the Facing of each, uint8[len(numbers)], front and back exchanged where the view mirrors.
    """
    facing = np.zeros(len(numbers), np.uint8)
    eye = eye_or_none(stage)
    if eye is None:
        return facing
    plain = is_plain(stage.patches, numbers)
    out = np.zeros(int(plain.sum()), np.uint8)
    kernel(stage.patches.control_points, stage.patches.rational, eye, numbers[plain], out)
    facing[plain] = turn_mirrored(stage, out)
    return facing


def cull_facing(classify: Classifier, stage: HullInput, flags: U8) -> None:
    """Flag alive patches that `classify` puts wholly on the side that the rasterizer drops; `flags` modified in place."""
    if stage.face_cull == FaceCull.NONE or eye_or_none(stage) is None:
        return
    alive = np.flatnonzero(flags == CullFlag.ALIVE)
    dropped = classify(stage, alive) == stage.face_cull
    flags[alive[dropped]] = CullFlag.BACKFACE
