"""`tpatch_tight`: as `tpatch`, with the normal's components in the tangent plane bounded one by one.

An extension of Munkberg et al. 2010, section 3.2, at no further cost: every normal n of a patch with tangent cones of half
angles alpha_t, alpha_b satisfies |n.t| <= sin(alpha_t) and |n.b| <= sin(alpha_b). The frame's x is t, and b lies in the
plane of x and y, so that bounds n_x and n_y; the cone of equation 14 bounds both by their worst sum.
"""

from pipeline.bounds.normals import TPATCH_TIGHT
from pipeline.bounds.oriented import bound_oriented
from pipeline.types import HullInput, PatchBounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    return bound_oriented(stage, TPATCH_TIGHT)
