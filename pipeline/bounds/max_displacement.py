"""`max_displacement`: Cartesian box of the control points, grown by the patch's own largest |displacement|.

Sathe 2011, "View Frustum Culling of Catmull-Clark Patches in DirectX 11": each patch has the largest magnitude of the
displacement within its part of the map, the largest *absolute* value, the texels that the filter reaches included, and over
the hull of the texture corners rather than their outline. Here from every texel of the footprint, not from a pyramid.
"""

import numpy as np

from pipeline.bounds.cbox import control_box, fill_cartesian_box
from pipeline.bounds.project import allocate, project_box
from pipeline.bounds.restrict import domain_displacement
from pipeline.jit import kernel
from pipeline.types import HullInput, PatchBounds


@kernel
def _bound_patches(patches, maps, pyramids, domain, matrix, viewport, net, bounds):
    for p in range(len(patches.control_points)):
        u0, u1, v0, v1 = domain[p]
        box = control_box(patches.control_points[p], patches.rational[p], u0, u1, v0, v1, net)
        lo, hi = domain_displacement(p, patches, maps, pyramids, u0, u1, v0, v1, True)
        fill_cartesian_box(p, box, max(abs(lo), abs(hi)), bounds)
        project_box(p, matrix, viewport, bounds)


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    bounds = allocate(len(stage.patches.control_points))
    _bound_patches(
        stage.patches,
        stage.maps,
        stage.pyramids,
        stage.domain,
        stage.clip_from_world,
        stage.viewport,
        np.empty((4, 4, 4)),
        bounds,
    )
    return bounds
