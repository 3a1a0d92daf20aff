"""`tpatch`: as `obbtex`, with the normals bounded by a cone from the cones of both tangents.

Munkberg et al. 2010, section 3.2, equations 14 and 13: the cone about the box's third axis; [-1, 1] along each axis where
the tangents' cones are too wide (`cones.combine_tangent_cones`).
"""

from pipeline.bounds.cones import make_work, tangent_normal_bound
from pipeline.bounds.oriented import begin, finish
from pipeline.bounds.project import allocate
from pipeline.jit import kernel
from pipeline.types import HullInput, PatchBounds


@kernel
def _bound_patches(patches, maps, pyramids, domain, matrix, viewport, work, bounds):
    for p in range(len(patches.control_points)):
        reach, frame = begin(p, patches, maps, pyramids, domain, work)
        cp, rational = patches.control_points[p], patches.rational[p]
        u0, u1, v0, v1 = domain[p]
        cosine, sine, _, _ = tangent_normal_bound(cp, rational, u0, u1, v0, v1, frame[0], frame[1], work)
        finish(p, patches, reach, sine, sine, cosine, cosine, work, matrix, viewport, bounds)


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
        make_work(),
        bounds,
    )
    return bounds
