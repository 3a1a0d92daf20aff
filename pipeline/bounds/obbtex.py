"""`obbtex`: oriented box of the control points, grown by the displacement in the part of the map that the patch reads.

Munkberg et al. 2010, section 5.1: the frame of section 3.1.1 and the min-max pyramid of section 3.2; nothing is known of
the unit normal but its length, so the displacement grows the box by its largest magnitude along every axis.
"""

from pipeline.bounds.cones import make_work
from pipeline.bounds.oriented import begin, finish
from pipeline.bounds.project import allocate
from pipeline.jit import kernel
from pipeline.types import HullInput, PatchBounds


@kernel
def _bound_patches(patches, maps, pyramids, domain, matrix, viewport, work, bounds):
    for p in range(len(patches.control_points)):
        reach, _ = begin(p, patches, maps, pyramids, domain, work)
        finish(p, patches, reach, 1.0, 1.0, -1.0, -1.0, work, matrix, viewport, bounds)


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
