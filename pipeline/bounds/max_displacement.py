"""`max_displacement`: Cartesian box of the control points, grown by the patch's own largest |displacement|.

Sathe 2011, "View Frustum Culling of Catmull-Clark Patches in DirectX 11": each patch has the largest magnitude of the
displacement within its part of the map, the largest *absolute* value, the texels that the filter reaches included, and over
the hull of the texture corners rather than their outline. Here from every texel of the footprint, not from a pyramid.
"""

from pipeline.bounds.cbox import bound_cartesian
from pipeline.bounds.lookup import displacement_ranges
from pipeline.types import HullInput, PatchBounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    return bound_cartesian(stage, displacement_ranges(stage, exact=True), False)
