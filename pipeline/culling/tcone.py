"""`backface:tcone`: cone of normals from the cones of both tangents (Munkberg et al. 2010, eq. 14; Loop et al. 2011).

With half angles alpha_t, alpha_b of the smallest cones about the control vectors of p_u and of p_v, and beta the angle
between their axes, folded to at most 90 degrees, all normals lie within theta of the axis t x b, where
sin(theta) = sqrt(sin^2 a_t + 2 sin a_t sin a_b cos(beta) + sin^2 a_b) / sin(beta); valid where a_t + a_b < beta (strict).

Exact for the smooth patch, and for every triangle with one edge along u and one along v: its edges are chords, and chords
lie in the tangents' cones. Other triangles of a tessellation have no such promise.
"""

import math

import numpy as np

from pipeline.culling.backface import SILHOUETTE, classify_with, cull_facing
from pipeline.culling.cones import MAX_VECTORS, PAD, facing_of_cone, projected, smallest_cone, tangent_vectors
from pipeline.jit import helper, kernel
from pipeline.types import I64, U8, HullInput, PatchBounds


@helper
def _normal_cone(t, b):
    """(axis x, y, z, cos, sin) of the cone of normals, from those of the tangents; cos = -1 where none is known."""
    tx, ty, tz, ct, st = t
    bx, by, bz, cb, sb = b
    st, sb = st + PAD, sb + PAD
    nx, ny, nz = ty * bz - tz * by, tz * bx - tx * bz, tx * by - ty * bx
    cos_beta, sin_beta = abs(tx * bx + ty * by + tz * bz), math.sqrt(nx * nx + ny * ny + nz * nz)
    if not (ct > 0.0 and cb > 0.0 and ct * cb - st * sb > cos_beta + PAD and sin_beta > 1e-6):
        return 0.0, 0.0, 0.0, -1.0, 0.0
    sin = math.sqrt(st * st + 2.0 * st * sb * cos_beta + sb * sb) / sin_beta
    if not sin < 1.0:
        return 0.0, 0.0, 0.0, -1.0, 0.0
    return nx / sin_beta, ny / sin_beta, nz / sin_beta, math.sqrt((1.0 - sin) * (1.0 + sin)), sin


@kernel
def _classify(control_points, rational, eye, numbers, out):
    points, vectors = np.empty((16, 3)), np.empty((MAX_VECTORS, 3))
    for k in range(len(numbers)):
        p = numbers[k]
        out[k] = SILHOUETTE
        if projected(control_points[p], points):
            n = tangent_vectors(control_points[p], points, rational[p] != 0, True, vectors)
            t = smallest_cone(vectors, n)
            n = tangent_vectors(control_points[p], points, rational[p] != 0, False, vectors)
            ax, ay, az, cos, sin = _normal_cone(t, smallest_cone(vectors, n))
            out[k] = facing_of_cone(points, ax, ay, az, cos, sin, eye)


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the patches `numbers`, uint8; SILHOUETTE for displaced ones."""
    return classify_with(_classify, stage, numbers)


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
