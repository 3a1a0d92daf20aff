"""`backface:tcone`: cone of normals from the cones of both tangents (Munkberg et al. 2010, eq. 14; Loop et al. 2011).

With half angles alpha_t, alpha_b of the smallest cones about the control vectors of p_u and of p_v, and beta the angle
between their axes, folded to at most 90 degrees, all normals lie within theta of the axis t x b, where
sin(theta) = sqrt(sin^2 a_t + 2 sin a_t sin a_b cos(beta) + sin^2 a_b) / sin(beta); valid where a_t + a_b < beta (strict).

Exact for the smooth patch, and for that displaced by a constant while t * curvature < 1 (`offset`). Undisplaced, also for
every triangle with one edge along u and one along v: its edges are chords, and chords lie in the tangents' cones. Other
triangles of a tessellation have no such promise.
"""

import math

import numpy as np

from pipeline.culling.apex import Cones, allocate, classify_by_cones, find_apexes
from pipeline.culling.backface import cull_facing
from pipeline.culling.cones import MAX_VECTORS, PAD, projected, tangent_vectors
from pipeline.culling.offset import Offsets
from pipeline.culling.smallest_cone import LANES, fit_cones, make_bundle, set_lane
from pipeline.jit import helper, kernel
from pipeline.types import I64, U8, HullInput, PatchBounds, Patches


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


@helper
def _lane(fit, lane):
    return fit[0, lane], fit[1, lane], fit[2, lane], fit[3, lane], fit[4, lane]


@kernel
def _make(control_points, rational, numbers, t, out):
    points, vectors = np.empty((LANES, 16, 3)), np.empty((MAX_VECTORS, 3))
    along_u, along_v = np.empty((5, LANES)), np.empty((5, LANES))
    bundle_u, bundle_v = make_bundle(), make_bundle()
    for first in range(0, len(numbers), LANES):
        lanes, count = min(LANES, len(numbers) - first), 0
        for lane in range(lanes):
            p, n = numbers[first + lane], 0
            cp, weighted = control_points[p], rational[p] != 0
            fine = projected(cp, points[lane])
            if fine:
                n = tangent_vectors(cp, points[lane], weighted, True, vectors)
            count = max(count, set_lane(bundle_u, lane, vectors, n))
            if fine:
                n = tangent_vectors(cp, points[lane], weighted, False, vectors)
            count = max(count, set_lane(bundle_v, lane, vectors, n))
        fit_cones(bundle_u, count, along_u)
        fit_cones(bundle_v, count, along_v)
        for lane in range(lanes):
            k = first + lane
            x, y, z, cosine, sine = _normal_cone(_lane(along_u, lane), _lane(along_v, lane))
            find_apexes(points[lane], x, y, z, cosine, sine, t[k, 0], t[k, 1], out, k)


def make_cones(patches: Patches, numbers: I64, offsets: Offsets) -> Cones:
    """Cones of the patches `numbers`, moved by `offsets`: for `apex.face_eyes`."""
    cones = allocate(len(numbers))
    _make(patches.control_points, patches.rational, numbers, offsets.t, cones)
    return cones


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the patches `numbers`, uint8."""
    return classify_by_cones(make_cones, stage, numbers)


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
