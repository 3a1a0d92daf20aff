"""Units: what is shaded, culled and binned as a whole. Patches in `triangle` and `patch` binning, else sub-domains of them."""

from typing import NamedTuple

import numpy as np

from pipeline.types import F64, I32, PatchBounds, Patches, Patterns


class Units(NamedTuple):
    """All units of a frame, in submit order; `live` numbers refer to these rows."""

    patches: Patches  # the patch of each unit
    owner: I32  # (n,) its number
    domain: F64  # (n, 4) u0, u1, v0, v1 of the cell that the unit owns the triangles of
    bounds: PatchBounds  # n rows
    patterns: Patterns  # `of_patch` by unit
    original: I32  # (triangles of the patterns,) number of each in the pattern of its whole patch


def whole_patches(patches: Patches, bounds: PatchBounds, patterns: Patterns) -> Units:
    """Every patch is a unit."""
    n = len(patterns.of_patch)
    counts = np.diff(patterns.first_triangle)
    original = np.arange(int(counts.sum())) - np.repeat(patterns.first_triangle[:-1], counts)
    domain = np.tile([0.0, 1.0, 0.0, 1.0], (n, 1))
    return Units(patches, np.arange(n, dtype=np.int32), domain, bounds, patterns, original.astype(np.int32))


def front_to_back(live: I32, bounds: PatchBounds) -> I32:
    """The units sorted by the nearest depth of their bounds; those of equal depth in submit order."""
    return live[np.argsort(bounds.z_min[live], kind="stable")]


def num_domain_points(units: Units, live: I32) -> np.ndarray:
    """Domain points that shading each of the units takes, int64[len(live)]; 0 for one that the tessellator culled."""
    return np.append(np.diff(units.patterns.first_point), 0)[units.patterns.of_patch[live]]
