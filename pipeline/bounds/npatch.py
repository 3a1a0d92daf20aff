"""`npatch`: as `obbtex`, with the normals bounded by the cone of the normal patch's control vectors.

Munkberg et al. 2010, section 3.1.3, equations 8 to 13: 36 control vectors of a bicubic patch, from 144 cross products;
[-1, 1] along each axis where one of them is 90 degrees or more from the box's third axis.
"""

from pipeline.bounds.normals import NPATCH
from pipeline.bounds.oriented import bound_oriented
from pipeline.types import HullInput, PatchBounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    return bound_oriented(stage, NPATCH)
