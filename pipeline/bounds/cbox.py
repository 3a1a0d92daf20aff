"""`cbox`: Cartesian box of the control points, grown by the largest displacement anywhere in the patch's map.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, section 3.1 and 5.1: the simplest bound, and the baseline of the others.
The surface lies in the convex hull of its control points (weights positive); a displacement t along a unit vector moves
it by at most |t| along any axis. Over a part of a patch the control points are those of the part.

Why it holds for what float32 computes (u = 2^-24): a basis value has at most 3 roundings, a product 1, each of the two
sums 2, so a coordinate is off by at most (3 + 1 + 2) + (3 + 1 + 2) = 12 u max|c| to first order; a rational one divides
two such sums, and as all weights are positive both errors are relative to w: (12 + 12 + 1) u max|X/w|. A unit normal's
component exceeds 1 by at most 4 u; t n and p + t n round once each. The constants below are those, rounded up, which
covers float64 too. The maxima are over the whole patch: that is what the shader adds up, in a part of it as well.

The least and the greatest of float32 numbers are exact in float32: whole patches are reduced in it, in blocks (`extremes`),
and widened in float64. Others go by the scalar functions.
"""

import numpy as np

from pipeline.bounds.extremes import HIGH, LOW, find_extremes, put_diagonals
from pipeline.bounds.gregory import most_inner_weight, reach_of_inner, widest_inner
from pipeline.bounds.lanes import LANES, aligned
from pipeline.bounds.project import Boxes, allocate_boxes, project_boxes, unprojected
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.bounds.transpose import fill_tail
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, HullInput, PatchBounds
from pipeline.vector_width import prefer_wide

U = 2.0**-24
UNDERFLOW = 2.0**-140  # above the rounding of denormal results


@inlined
def error_factor(twice):
    """Roundings of an undisplaced coordinate, in multiples of the largest; `twice`: of a rational or Gregory patch."""
    return 26.0 * U if twice else 13.0 * U


@inlined
def widen_errors(x, y, z, least_w, twice):
    """`position_errors` from the largest magnitudes and the least weight (1 if all are)."""
    tiny = UNDERFLOW / least_w if least_w > 0.0 else np.nan  # what denormal products lose, after the division
    factor = error_factor(twice) + tiny
    return factor * x + tiny, factor * y + tiny, factor * z + tiny


@helper
def position_errors(cp, rational):
    """How far the shader's x, y, z (before displacement) may be off; NaN where a weight <= 0. cp float32[4, 4, 4]."""
    x = y = z = 0.0
    least_w = 1.0
    for i in range(4):
        for j in range(4):
            if rational:
                w = np.float64(cp[i, j, 3])
                least_w = min(least_w, w)
                x, y, z = max(x, abs(cp[i, j, 0] / w)), max(y, abs(cp[i, j, 1] / w)), max(z, abs(cp[i, j, 2] / w))
            else:
                x = max(x, abs(np.float64(cp[i, j, 0])))
                y = max(y, abs(np.float64(cp[i, j, 1])))
                z = max(z, abs(np.float64(cp[i, j, 2])))
    return widen_errors(x, y, z, least_w, rational)


@helper
def _restricted_box(patches, p, domain, net):
    """Box lo, hi (3 + 3 floats) of patch p's control points over the domain, widened for float32 evaluation.

    NaN where a weight <= 0 or a coordinate is not finite. net : float64[4, 4, 4], scratch.
    """
    cp, rational, row = patches.control_points[p], patches.rational[p] != 0, patches.gregory_id[p]
    u0, u1, v0, v1 = domain[p]
    restrict_patch(cp, u0, u1, v0, v1, net)
    if rational:
        project_net(net)
    lo0 = lo1 = lo2 = np.inf
    hi0 = hi1 = hi2 = -np.inf
    poison = 0.0
    for i in range(4):
        for j in range(4):
            x, y, z = net[i, j, 0], net[i, j, 1], net[i, j, 2]
            lo0, lo1, lo2 = min(lo0, x), min(lo1, y), min(lo2, z)
            hi0, hi1, hi2 = max(hi0, x), max(hi1, y), max(hi2, z)
            poison += (x * 0.0 + y * 0.0) + z * 0.0
    pad0, pad1, pad2 = position_errors(cp, rational)
    if row >= 0:
        inner, weight = patches.inner[row], most_inner_weight(u0, u1, v0, v1)
        flat = cp.reshape(64)
        most0, most1 = max(abs(lo0), abs(hi0), widest_inner(inner, 0)), max(abs(lo1), abs(hi1), widest_inner(inner, 1))
        most2 = max(abs(lo2), abs(hi2), widest_inner(inner, 2))
        more0, more1, more2 = widen_errors(most0, most1, most2, 1.0, True)
        pad0 = max(pad0, more0) + weight * reach_of_inner(flat, inner, 1.0, 0.0, 0.0)
        pad1 = max(pad1, more1) + weight * reach_of_inner(flat, inner, 0.0, 1.0, 0.0)
        pad2 = max(pad2, more2) + weight * reach_of_inner(flat, inner, 0.0, 0.0, 1.0)
    pad0, pad1, pad2 = pad0 + poison, pad1 + poison, pad2 + poison
    return lo0 - pad0, lo1 - pad1, lo2 - pad2, hi0 + pad0, hi1 + pad1, hi2 + pad2


@inlined
def _grow(lo, hi, reach):
    """Grow [lo, hi] by a displacement of at most `reach`, and by its roundings."""
    pad = reach * (1.0 + 6.0 * U) + (2.0 * U * max(abs(lo), abs(hi)) if reach > 0.0 else 0.0)
    return lo - pad, hi + pad


@helper
def _fill_box(p, box, reach, bounds):
    """Box p: `box` grown by a displacement of at most `reach` along any axis."""
    x0, y0, z0, x1, y1, z1 = box
    (x0, x1), (y0, y1), (z0, z1) = _grow(x0, x1, reach), _grow(y0, y1, reach), _grow(z0, z1, reach)
    for c in range(3):
        for r in range(3):
            bounds.axes[p, r, c] = 0.0
    bounds.center[p, 0], bounds.axes[p, 0, 0] = 0.5 * (x0 + x1), 0.5 * (x1 - x0)
    bounds.center[p, 1], bounds.axes[p, 1, 1] = 0.5 * (y0 + y1), 0.5 * (y1 - y0)
    bounds.center[p, 2], bounds.axes[p, 2, 2] = 0.5 * (z0 + z1), 0.5 * (z1 - z0)
    bounds.cone_cos[p] = -1.0


@inlined
def _reach_of(p, map_id, ranges, by_map):
    """How far patch p may be displaced; ranges as in `box_patches`."""
    if by_map:
        m = map_id[p]
        return max(abs(ranges[m, 0]), abs(ranges[m, 1])) if m >= 0 else 0.0
    return max(abs(ranges[0, p]), abs(ranges[1, p]))


@kernel
def _fill_boxes(numbers, patches, domain, ranges, by_map, net, bounds):
    for p in numbers:
        reach = _reach_of(p, patches.map_id, ranges, by_map)
        _fill_box(p, _restricted_box(patches, p, domain, net), reach, bounds)


# Whole polynomial patches, in blocks. What is known of a patch's x, y, z lies as `extremes` leaves it, patch after patch:
# so centers are already where they belong. REACH, how far a displacement moves a point, roundings included; GAIN, what of
# the largest magnitude roundings may move it; both float64, like half the extents, HALF.

HALF, REACH, GAIN, NUM_FLOATS = 0, 3 * LANES, 6 * LANES, 9 * LANES
MIXED = np.int32(-2)  # maps


@inlined
def _are_whole(ends):
    """Whether all domains are whole patches. In pairs: to compare numbers that lie four apart, vectors are taken apart."""
    cut = np.uint8(0)
    for k in range(len(ends) // 2):
        i = np.uintp(2) * np.uintp(k)
        cut |= np.uint8((ends[i] != 0.0) | (ends[i + np.uintp(1)] != 1.0))
    return cut == 0


@helper
def find_left(rational, tangent_id, gregory_id, ends, left):
    """left bool[n]: whether a patch is not plain: polynomial, with no tangent patches or inner points, and whole.

    ends : domains, float64[4 n]. Returns whether one is left. Of all patches at once, without a branch: so it vectorizes.
    """
    some = np.uint8(0)
    for p in range(len(left)):
        is_left = (rational[p] != 0) | (tangent_id[p] >= 0) | (gregory_id[p] >= 0)
        left[p] = is_left
        some |= np.uint8(is_left)
    if not _are_whole(ends):
        for p in range(len(left)):
            starts = (ends[4 * p] != 0.0) | (ends[4 * p + 2] != 0.0)
            left[p] |= starts | (ends[4 * p + 1] != 1.0) | (ends[4 * p + 3] != 1.0)
        some = np.uint8(1)
    return some != 0


@inlined
def _shared_map(first, map_id):
    """The map of all patches of a whole block, -1 for none; MIXED if they differ."""
    begin = np.uintp(first)
    differences = np.int32(0)
    for lane in range(LANES):
        differences |= map_id[begin + np.uintp(lane)] ^ map_id[begin]
    return map_id[begin] if differences == 0 else MIXED


@inlined
def _put_reaches(first, count, map_id, ranges, by_map, d):
    """REACH and GAIN of a block, the same for each coordinate of a patch.

    Together what `widen_errors` and `_grow` add: `_grow`'s magnitude is that of a coordinate widened already, by under 14 u.
    """
    for lane in range(count):
        reach = _reach_of(first + lane, map_id, ranges, by_map)
        for c in range(3):
            d[REACH + 3 * lane + c] = reach * (1.0 + 6.0 * U) + UNDERFLOW
            d[GAIN + 3 * lane + c] = (
                error_factor(False) + UNDERFLOW + (2.0 * U * (1.0 + 14.0 * U) if reach > 0.0 else 0.0)
            )


@inlined
def _widen(s, d, center, begin):
    """Centers of a block and HALF."""
    prefer_wide()
    for i in range(3 * LANES):
        low, high = s[LOW + i], s[HIGH + i]
        most = np.float64(max(-low, high))
        lo, hi = np.float64(low), np.float64(high)
        center[begin + np.uintp(i)] = 0.5 * (lo + hi)
        d[HALF + i] = 0.5 * (hi - lo) + (d[GAIN + i] * most + d[REACH + i])


@kernel
def _fill_whole_boxes(
    control_points, rational, gregory_id, map_id, ends, ranges, by_map, center, axes, cone_cos, left
):  # fmt: skip
    """Boxes of all patches; left: those for which they do not hold, and all of a block with a number that is not finite.

    control_points : float32[n, 64]
    center, axes   : float64[3 n] and [9 n]
    """
    prefer_wide()
    n, some_left = len(control_points), find_left(rational, gregory_id, gregory_id, ends, left)
    tail, s = np.empty((LANES, 64), np.float32), aligned(np.empty(6 * LANES + 16, np.float32))
    d = aligned(np.zeros(NUM_FLOATS + 8))
    few, few_axes = np.empty(3 * LANES), np.empty(9 * LANES)
    known = MIXED
    for first in range(0, n, LANES):
        count = min(LANES, n - first)
        fill_tail(control_points, first, tail)
        if not find_extremes(control_points, first, tail, s):
            left[first : first + count] = True
            some_left = True
        m = _shared_map(first, map_id) if by_map and count == LANES else MIXED
        if m == MIXED or m != known:  # else REACH and GAIN are as the last block had them
            _put_reaches(first, count, map_id, ranges, by_map, d)
        known = m
        if count == LANES:
            _widen(s, d, center, np.uintp(3 * first))
            put_diagonals(d, axes, 9 * first)
        else:
            _widen(s, d, few, np.uintp(0))
            put_diagonals(d, few_axes, 0)
            center[3 * first :] = few[: 3 * count]
            axes[9 * first :] = few_axes[: 9 * count]
        for lane in range(count):
            cone_cos[np.uintp(first) + np.uintp(lane)] = -1.0
    return some_left


def put_boxes(stage: HullInput, ranges: F64, by_map: bool, boxes: Boxes) -> None:
    """Cartesian boxes of all patches over their domains, into `boxes`, of as many; their cone_axis is left as it is.

    ranges : least and greatest displacement, world units: float64[maps, 2] (by_map) or rows float64[2, at least P].
    """
    patches, n = stage.patches, len(stage.patches.control_points)
    left = np.empty(n, np.bool_)
    if _fill_whole_boxes(
        patches.control_points.reshape(n, 64), patches.rational, patches.gregory_id, patches.map_id,
        stage.domain.reshape(-1), ranges, by_map, boxes.center.reshape(-1), boxes.axes.reshape(-1), boxes.cone_cos, left,
    ):  # fmt: skip
        _fill_boxes(np.flatnonzero(left), patches, stage.domain, ranges, by_map, np.empty((4, 4, 4)), boxes)


def box_patches(stage: HullInput, ranges: F64, by_map: bool) -> Boxes:
    """`put_boxes` into arrays of their own."""
    boxes = allocate_boxes(len(stage.patches.control_points))
    put_boxes(stage, ranges, by_map, boxes)
    return boxes


def bound_cartesian(stage: HullInput, ranges: F64, by_map: bool) -> PatchBounds:
    """As `box_patches`, with all that follows. A weight <= 0 gives a NaN box, which culls nothing."""
    bounds = unprojected(box_patches(stage, ranges, by_map))
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 gives a NaN box, which culls nothing."""
    return bound_cartesian(stage, stage.pyramids.whole, True)
