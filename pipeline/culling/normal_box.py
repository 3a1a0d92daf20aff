"""`backface:normal_box`: interval box of the normal control vectors (Kumar, Manocha, Lastra 1995).

(e - p) . n over the box of the vectors from the control points to the eye and the box of the normal patch's control
vectors, in world axes, by interval products: back-facing where the upper end is not above 0. The loosest of the tests.

Exact for the smooth patch; a coarse tessellation may still have a front-facing triangle (`docs/backface.md`).
"""

import numpy as np

from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, classify_with, cull_facing
from pipeline.culling.cones import MAX_VECTORS, PAD, normal_vectors, projected
from pipeline.jit import helper, kernel
from pipeline.types import I64, U8, HullInput, PatchBounds


@helper
def _facing(points, vectors, n, eye):
    lo = hi = scale = 0.0
    for c in range(3):
        d0 = d1 = eye[c] - points[0, c]
        for k in range(1, 16):
            d0, d1 = min(d0, eye[c] - points[k, c]), max(d1, eye[c] - points[k, c])
        n0 = n1 = vectors[0, c]
        for k in range(1, n):
            n0, n1 = min(n0, vectors[k, c]), max(n1, vectors[k, c])
        lo += min(d0 * n0, d0 * n1, d1 * n0, d1 * n1)
        hi += max(d0 * n0, d0 * n1, d1 * n0, d1 * n1)
        scale += max(abs(d0), abs(d1)) * max(abs(n0), abs(n1))
    noise = PAD * scale
    if not (lo <= hi and scale < np.inf):
        return SILHOUETTE
    if hi <= -noise and lo < -noise:
        return BACK
    if lo >= noise and hi > noise:
        return FRONT
    return SILHOUETTE


@kernel
def _classify(control_points, rational, eye, numbers, out):
    points, vectors = np.empty((16, 3)), np.empty((MAX_VECTORS, 3))
    for k in range(len(numbers)):
        p = numbers[k]
        out[k] = SILHOUETTE
        if projected(control_points[p], points):
            n = normal_vectors(control_points[p], points, rational[p] != 0, vectors)
            out[k] = _facing(points, vectors, n, eye)


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the patches `numbers`, uint8; SILHOUETTE for displaced ones."""
    return classify_with(_classify, stage, numbers)


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
