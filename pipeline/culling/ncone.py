"""`backface:ncone`: cone of the normal patch's control vectors with an apex (Shirman and Abi-Ezzi 1993, section 4).

The smallest cone about the 36 normal control vectors (64 of a rational patch). Loop, Niessner, Eisenacher 2011 print its
test without the minus of `(e - l) . a <= -sin |e - l|`; so printed it culls visible patches.

Exact for the smooth patch, and for that displaced by a constant while t * curvature < 1 (`offset`); a coarse
tessellation may still have a front-facing triangle (`docs/backface.md`).
"""

import numpy as np

from pipeline.culling.apex import Cones, allocate, classify_by_cones, find_apexes
from pipeline.culling.backface import cull_facing
from pipeline.culling.cones import MAX_VECTORS, normal_vectors, projected
from pipeline.culling.offset import Offsets
from pipeline.culling.smallest_cone import LANES, fit_cones, make_bundle, set_lane
from pipeline.jit import kernel
from pipeline.types import I64, U8, HullInput, PatchBounds, Patches


@kernel
def _make(control_points, rational, numbers, t, out):
    points, vectors, fit = np.empty((LANES, 16, 3)), np.empty((MAX_VECTORS, 3)), np.empty((5, LANES))
    bundle = make_bundle()
    for first in range(0, len(numbers), LANES):
        lanes, count = min(LANES, len(numbers) - first), 0
        for lane in range(lanes):
            p, n = numbers[first + lane], 0
            if projected(control_points[p], points[lane]):
                n = normal_vectors(control_points[p], points[lane], rational[p] != 0, vectors)
            count = max(count, set_lane(bundle, lane, vectors, n))
        fit_cones(bundle, count, fit)
        for lane in range(lanes):
            k = first + lane
            x, y, z, cosine, sine = fit[0, lane], fit[1, lane], fit[2, lane], fit[3, lane], fit[4, lane]
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
