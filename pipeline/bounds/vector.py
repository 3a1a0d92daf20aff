"""Patches whose displacement takes more than one range along the normal: vectors, and texture seams that are closed.

Their displacement is bounded one patch after the other. A vector moves a point whichever way it likes (Sathe 2011): every
bound holds with the unit box of directions and the greatest length. Tighter is the range of each component over the
patch's part of the map, seen along the axes of a box: with turn L, component c between lo_c and hi_c, and axis a,

    a . (L d) = sum over c of (L^T a)_c d_c,

each product least and greatest at an end of its range. The oriented bounds all become that box for such patches, as nothing
depends on the normal; `cbox` and `max_displacement` take the length.

Rounding (u = 2^-24): a row of L d has three products and two sums, p + D one more: an error vector of at most
sqrt(3) 4 u S, with S the largest sum of magnitudes in a row, and sqrt(3) u |p|.
"""

import numpy as np

from pipeline.bounds.fit import AXES, HI, LO, SIZE
from pipeline.bounds.restrict import domain_displacement
from pipeline.displacement import greatest_length, turned_sums
from pipeline.jit import helper, kernel
from pipeline.types import B1, F64, I64, DisplacementMaps, HullInput, Patches

U = 2.0**-24
UNDERFLOW = 2.0**-140


def moves_by_vectors(patches: Patches, maps: DisplacementMaps) -> B1:
    """Which patches have a map of vectors, bool[P]."""
    return np.append(maps.planes[:, 0] >= 0, False)[patches.map_id]  # the last one answers map_id = -1


def is_special(patches: Patches, maps: DisplacementMaps) -> B1:
    """Which patches are bounded here: displaced by vectors, or with closed seams."""
    if len(patches.seam_edges) == 0 and (maps.planes[:, 0] < 0).all():
        return np.zeros(len(patches.map_id), bool)
    return moves_by_vectors(patches, maps) | ((patches.seam_id >= 0) & (patches.map_id >= 0))


@helper
def _touches(corner, low, high):
    return low == 0.0 if corner == 0 else high == 1.0


@helper
def _patch_displacement(p, m, patches, maps, pyramids, domain, exact):
    """Range of the displacement by map m of patch p over the domain (u0, u1, v0, v1), its seams' owners included.

    As `restrict.domain_displacement`. An edge that the domain touches is looked up between the ends of that part of it.
    """
    u0, u1, v0, v1 = domain
    lo, hi = domain_displacement(m, patches.texcoords[p], maps, pyramids, u0, u1, v0, v1, exact)
    row = patches.seam_id[p]
    if row < 0:
        return lo, hi
    coords = np.empty((4, 2), np.float32)
    for edge in range(4):
        along_v = edge % 2 == 0
        if _touches(edge // 2, u0, u1) if along_v else _touches(edge // 2, v0, v1):
            for k in range(4):
                coords[k] = patches.seam_edges[row, edge, k & 1]
            a, b = (v0, v1) if along_v else (u0, u1)
            low, high = domain_displacement(m, coords, maps, pyramids, a, b, 0.0, 1.0, exact)
            lo, hi = min(lo, low), max(hi, high)
    for corner in range(4):
        if _touches(corner & 1, u0, u1) and _touches(corner >> 1, v0, v1):
            for k in range(4):
                coords[k] = patches.seam_corners[row, corner]
            low, high = domain_displacement(m, coords, maps, pyramids, 0.0, 1.0, 0.0, 1.0, exact)
            lo, hi = min(lo, low), max(hi, high)
    return lo, hi


@helper
def _components(p, m, patches, maps, pyramids, domain, exact):
    """Range of each component over the domain, world units before `turn`."""
    x, y, z = maps.planes[m]
    return (
        _patch_displacement(p, x, patches, maps, pyramids, domain, exact),
        _patch_displacement(p, y, patches, maps, pyramids, domain, exact),
        _patch_displacement(p, z, patches, maps, pyramids, domain, exact),
    )


@helper
def _domain_of(domains, p):
    return domains[p, 0], domains[p, 1], domains[p, 2], domains[p, 3]


@kernel
def _fill_ranges(numbers, patches, maps, pyramids, domains, exact, out):
    for p in numbers:
        m, domain = patches.map_id[p], _domain_of(domains, p)
        if maps.planes[m, 0] >= 0:
            most = greatest_length(maps.turn[m], _components(p, m, patches, maps, pyramids, domain, exact))
            out[0, p], out[1, p] = -most, most
        else:
            out[0, p], out[1, p] = _patch_displacement(p, m, patches, maps, pyramids, domain, exact)


def fill_special_ranges(stage: HullInput, exact: bool, ranges: F64) -> None:
    """Displacement of special patches into ranges float64[2, at least P]; of vectors minus and plus their length."""
    numbers = np.flatnonzero(is_special(stage.patches, stage.maps))
    if len(numbers):
        _fill_ranges(numbers, stage.patches, stage.maps, stage.pyramids, stage.domain, exact, ranges)


@kernel
def _grow(numbers, boxes, patches, maps, pyramids, domains, center, axes):
    for p in numbers:
        m = patches.map_id[p]
        turn = maps.turn[m]
        d = _components(p, m, patches, maps, pyramids, _domain_of(domains, p), False)
        sums = turned_sums(turn, d)
        pad = 16.0 * U * sums + (3.5 * U * boxes[SIZE, p] if sums > 0.0 else 0.0) + UNDERFLOW * (1.0 + sums)
        for c in range(3):
            center[p, c] = 0.0
        for r in range(3):
            lo, hi = boxes[LO + r, p], boxes[HI + r, p]
            for c in range(3):
                along = 0.0
                for k in range(3):
                    along += np.float64(turn[k, c]) * boxes[AXES + 3 * r + k, p]
                a, b = along * d[c][0], along * d[c][1]
                lo, hi = lo + min(a, b), hi + max(a, b)
            for k in range(3):
                axis = boxes[AXES + 3 * r + k, p]
                center[p, k] += 0.5 * (lo + hi) * axis
                axes[p, r, k] = (0.5 * (hi - lo) + pad) * axis


def grow_by_vectors(stage: HullInput, boxes: F64, center: F64, axes: F64) -> None:
    """Boxes of the patches with maps of vectors, from those of `fit.fit_boxes`: center and axes in place."""
    numbers: I64 = np.flatnonzero(moves_by_vectors(stage.patches, stage.maps))
    if len(numbers):
        _grow(numbers, boxes, stage.patches, stage.maps, stage.pyramids, stage.domain, center, axes)
