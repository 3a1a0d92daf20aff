"""Cull tests of the hull stage. `CULL_TESTS` is the table: tests, command line and reports loop over it.

Every entry is called as `cull(stage, bounds, flags)`, `stage` a HullInput: it may set `flags[p]` (uint8[P], a CullFlag) of
a patch that is still ALIVE, and only if no sample of the displaced patch can be drawn. The `backface:` tests but
`backface:tessellation_safe` answer for the smooth patch, and may drop a front-facing triangle of its coarse tessellation
(`docs/backface.md`).

To add one: a module beside `frustum`, a value in `types.CullFlag`, and a line here.
"""

from collections.abc import Callable

import numpy as np

from pipeline.culling import (
    displaced,
    frustum,
    frustum_planes,
    ncone,
    normal_box,
    tangent_plane,
    tcone,
    tessellation_safe,
)
from pipeline.culling.backface import Classifier
from pipeline.types import U8, CullFlag, HullInput, PatchBounds

CullTest = Callable[[HullInput, PatchBounds, U8], None]

CULL_TESTS: dict[str, CullTest] = {
    "frustum": frustum.cull_patches,
    "frustum:world": frustum_planes.cull_patches,
    "frustum:object": frustum_planes.cull_objects,
    "backface:ncone": ncone.cull_patches,
    "backface:tcone": tcone.cull_patches,
    "backface:tangent_plane": tangent_plane.cull_patches,
    "backface:normal_box": normal_box.cull_patches,
    "backface:displaced": displaced.cull_patches,
    "backface:tessellation_safe": tessellation_safe.cull_patches,
}

# Tests that look at each patch by itself, and so may be run on parts of a frame.
PER_PATCH = frozenset(CULL_TESTS) - {"frustum:object"}

TRIANGLE_SAFE = {"backface:tessellation_safe"}  # answer for every triangle, not for the surface

FLAG_OF: dict[str, CullFlag] = {
    "frustum": CullFlag.FRUSTUM,
    "frustum:world": CullFlag.FRUSTUM,
    "frustum:object": CullFlag.FRUSTUM,
    "backface:ncone": CullFlag.BACKFACE,
    "backface:tcone": CullFlag.BACKFACE,
    "backface:tangent_plane": CullFlag.BACKFACE,
    "backface:normal_box": CullFlag.BACKFACE,
    "backface:displaced": CullFlag.BACKFACE,
    "backface:tessellation_safe": CullFlag.BACKFACE,
}

CLASSIFIERS: dict[str, Classifier] = {
    "backface:ncone": ncone.classify_patches,
    "backface:tcone": tcone.classify_patches,
    "backface:tangent_plane": tangent_plane.classify_patches,
    "backface:normal_box": normal_box.classify_patches,
    "backface:displaced": displaced.classify_patches,
    "backface:tessellation_safe": tessellation_safe.classify_patches,
}


def classify(stage: HullInput, name: str) -> U8:
    """Which side of each patch is seen, by a test of `CLASSIFIERS`: `backface.Facing`, uint8[P].

    FRONT: all of it front-facing or edge-on. BACK: all of it back-facing or edge-on. SILHOUETTE: both, or not known.
    """
    return CLASSIFIERS[name](stage, np.arange(len(stage.patches.control_points)))
