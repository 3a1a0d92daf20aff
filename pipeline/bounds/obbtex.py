"""`obbtex`: oriented box of the control points, grown by the displacement in the part of the map that the patch reads.

Munkberg et al. 2010, section 5.1: the frame of section 3.1.1 and the min-max pyramid of section 3.2; nothing is known of
the unit normal but its length, so the displacement grows the box by its largest magnitude along every axis.
"""

from pipeline.bounds.oriented import NOTHING, bound_oriented
from pipeline.types import HullInput, PatchBounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    return bound_oriented(stage, NOTHING)
