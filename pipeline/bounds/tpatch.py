"""`tpatch`: as `obbtex`, with the normals bounded by a cone from the cones of both tangents.

Munkberg et al. 2010, section 3.2, equations 14 and 13: the cone about the box's third axis; [-1, 1] along each axis where
the tangents' cones are too wide (`cones.combine_tangent_cones`).
"""

from pipeline.bounds.normals import TPATCH
from pipeline.bounds.oriented import bound_oriented
from pipeline.types import HullInput, PatchBounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    return bound_oriented(stage, TPATCH)
