"""`tpatch_tight`: as `tpatch`, with the normal's components in the tangent plane bounded one by one.

An extension of Munkberg et al. 2010, section 3.2, at no further cost: every normal n of a patch with tangent cones of half
angles alpha_t, alpha_b satisfies |n.t| <= sin(alpha_t) and |n.b| <= sin(alpha_b). The frame's x is t, and b lies in the
plane of x and y, so that bounds n_x and n_y; the cone of equation 14 bounds both by their worst sum.
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
        cosine, _, x, y = tangent_normal_bound(cp, rational, u0, u1, v0, v1, frame[0], frame[1], work)
        finish(p, patches, reach, x, y, cosine, cosine, work, matrix, viewport, bounds)


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
