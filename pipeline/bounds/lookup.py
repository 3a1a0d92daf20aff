"""The range of each patch's displacement over its domain, in batches."""

import numpy as np

from pipeline.bounds.lanes import padded
from pipeline.bounds.restrict import domain_displacement
from pipeline.bounds.vector import fill_special_ranges
from pipeline.jit import kernel
from pipeline.types import F64, HullInput


@kernel
def _displacement_ranges(map_id, texcoords, maps, pyramids, domain, exact, out):
    n = len(map_id)
    for p in range(out.shape[1]):
        q = min(p, n - 1)
        u0, u1, v0, v1 = domain[q]
        out[0, p], out[1, p] = domain_displacement(map_id[q], texcoords[q], maps, pyramids, u0, u1, v0, v1, exact)


def displacement_ranges(stage: HullInput, *, exact: bool = False) -> F64:
    """Least and greatest displacement of each patch, world units: float64[2, P rounded up to whole blocks].

    (0, 0) without a map, NaN for a broken one; of vectors +- their greatest length. exact : from each texel of the
    footprint, not from at most four of a pyramid's level for each piece of it.
    """
    patches = stage.patches
    ranges = np.empty((2, padded(len(patches.map_id))))
    _displacement_ranges(
        patches.map_id, patches.texcoords, stage.maps, stage.pyramids, stage.domain, exact, ranges
    )  # fmt: skip
    fill_special_ranges(stage, exact, ranges)
    return ranges
