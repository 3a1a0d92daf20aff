"""`backface:ncone`: cone of the normal patch's control vectors with an apex (Shirman and Abi-Ezzi 1993, section 4).

The smallest cone about the 36 normal control vectors (64 of a rational patch). Loop, Niessner, Eisenacher 2011 print its
test without the minus of `(e - l) . a <= -sin |e - l|`; so printed it culls visible patches.

Exact for the smooth patch; a coarse tessellation may still have a front-facing triangle (`docs/backface.md`).
"""

import numpy as np

from pipeline.culling.backface import SILHOUETTE, classify_with, cull_facing
from pipeline.culling.cones import MAX_VECTORS, facing_of_cone, normal_vectors, projected, smallest_cone
from pipeline.jit import kernel
from pipeline.types import I64, U8, HullInput, PatchBounds


@kernel
def _classify(control_points, rational, eye, numbers, out):
    points, vectors = np.empty((16, 3)), np.empty((MAX_VECTORS, 3))
    for k in range(len(numbers)):
        p = numbers[k]
        out[k] = SILHOUETTE
        if projected(control_points[p], points):
            n = normal_vectors(control_points[p], points, rational[p] != 0, vectors)
            ax, ay, az, cos, sin = smallest_cone(vectors, n)
            out[k] = facing_of_cone(points, ax, ay, az, cos, sin, eye)


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the patches `numbers`, uint8; SILHOUETTE for displaced ones."""
    return classify_with(_classify, stage, numbers)


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
