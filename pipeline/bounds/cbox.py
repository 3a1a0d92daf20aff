"""`cbox`: Cartesian box of the control points, grown by the largest displacement anywhere in the patch's map.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, section 3.1 and 5.1: the simplest bound, and the baseline of the others.
The surface lies in the convex hull of its control points (weights positive); a displacement t along a unit vector moves
it by at most |t| along any axis. Over a part of a patch the control points are those of the part.

Why it holds for what float32 computes (u = 2^-24): a basis value has at most 3 roundings, a product 1, each of the two
sums 2, so a coordinate is off by at most (3 + 1 + 2) + (3 + 1 + 2) = 12 u max|c| to first order; a rational one divides
two such sums, and as all weights are positive both errors are relative to w: (12 + 12 + 1) u max|X/w|. A unit normal's
component exceeds 1 by at most 4 u; t n and p + t n round once each. The constants below are those, rounded up, which
covers float64 too. The maxima are over the whole patch: that is what the shader adds up, in a part of it as well.

The least and the greatest of float32 numbers are exact in float32: whole patches are reduced in it, in blocks (`lanes`),
and widened in float64. Others go by the scalar functions.
"""

import numpy as np

from pipeline.bounds.gregory import most_inner_weight, reach_of_inner, widest_inner
from pipeline.bounds.lanes import LANES, least4, most4
from pipeline.bounds.project import Boxes, allocate_boxes, project_boxes, unprojected
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.bounds.transpose import load_block, prefer_wide, store_block
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, HullInput, PatchBounds

U = 2.0**-24
ZERO, ONE = np.float32(0.0), np.float32(1.0)
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


@kernel
def _fill_boxes(numbers, patches, domain, ranges, by_map, net, bounds):
    for p in numbers:
        column = patches.map_id[p] if by_map else p
        reach = max(abs(ranges[0, column]), abs(ranges[1, column])) if column >= 0 else 0.0
        _fill_box(p, _restricted_box(patches, p, domain, net), reach, bounds)


# Whole polynomial patches, in blocks. Rows of float32: the points, least, greatest and poison of x, y, z, PLAIN; of
# float64: center, axes and the reach of the displacement.

LOW, HIGH, POISON, PLAIN, ROWS = 48, 51, 54, 57, 58
CENTER, AXES, REACH, ROWS64 = 0, 3, 12, 13


@inlined
def _all_plain(first, rational, tangent_id, gregory_id, ends):
    """Whether all patches of a whole block are plain: numbers in a row, which vectorizes."""
    rational, tangent_id, gregory_id = rational[first:], tangent_id[first:], gregory_id[first:]
    some = False
    for lane in range(LANES):
        some |= (rational[lane] != 0) | (tangent_id[lane] >= 0) | (gregory_id[lane] >= 0)
    ends = ends[4 * first :]
    for i in range(4 * LANES):
        some |= ends[i] != np.float64(i & 1)
    return not some


@inlined
def find_plain(first, count, rational, tangent_id, gregory_id, ends, row, s):
    """Row `row` of a block's first lanes: 1 where a patch is plain: polynomial, with no tangent patches or inner points, and
    whole. ends : domains, float64[4 n]."""
    for lane in range(LANES):
        s[row * LANES + lane] = ONE
    if count < LANES or not _all_plain(first, rational, tangent_id, gregory_id, ends):
        for lane in range(count):
            p = first + lane
            plain = (rational[p] == 0) & (tangent_id[p] < 0) & (gregory_id[p] < 0)
            whole = (
                (ends[4 * p] == 0.0) & (ends[4 * p + 1] == 1.0) & (ends[4 * p + 2] == 0.0) & (ends[4 * p + 3] == 1.0)
            )
            s[row * LANES + lane] = ONE if plain & whole else ZERO


@inlined
def _least16(s, i):
    a, b = least4(s[i], s[i + LANES], s[i + 2 * LANES], s[i + 3 * LANES]), i + 4 * LANES
    c, d = least4(s[b], s[b + LANES], s[b + 2 * LANES], s[b + 3 * LANES]), b + 4 * LANES
    e, f = least4(s[d], s[d + LANES], s[d + 2 * LANES], s[d + 3 * LANES]), d + 4 * LANES
    return least4(a, c, e, least4(s[f], s[f + LANES], s[f + 2 * LANES], s[f + 3 * LANES]))


@inlined
def _most16(s, i):
    a, b = most4(s[i], s[i + LANES], s[i + 2 * LANES], s[i + 3 * LANES]), i + 4 * LANES
    c, d = most4(s[b], s[b + LANES], s[b + 2 * LANES], s[b + 3 * LANES]), b + 4 * LANES
    e, f = most4(s[d], s[d + LANES], s[d + 2 * LANES], s[d + 3 * LANES]), d + 4 * LANES
    return most4(a, c, e, most4(s[f], s[f + LANES], s[f + 2 * LANES], s[f + 3 * LANES]))


@inlined
def _poison4(s, i):
    return (s[i] * ZERO + s[i + LANES] * ZERO) + (s[i + 2 * LANES] * ZERO + s[i + 3 * LANES] * ZERO)


@inlined
def _reduce(s):
    """Rows LOW, HIGH, POISON: 0, or NaN where a coordinate is not finite."""
    prefer_wide()
    for c in range(3):
        for lane in range(LANES):
            i = 16 * c * LANES + lane
            s[(LOW + c) * LANES + lane], s[(HIGH + c) * LANES + lane] = _least16(s, i), _most16(s, i)
            a, b = _poison4(s, i) + _poison4(s, i + 4 * LANES), _poison4(s, i + 8 * LANES) + _poison4(s, i + 12 * LANES)
            s[(POISON + c) * LANES + lane] = a + b


@inlined
def _widen(s, d):
    """Rows CENTER and the diagonal of AXES."""
    prefer_wide()
    for lane in range(LANES):
        i, reach = LOW * LANES + lane, d[REACH * LANES + lane]
        x0, y0, z0 = np.float64(s[i]), np.float64(s[i + LANES]), np.float64(s[i + 2 * LANES])
        x1, y1, z1 = np.float64(s[i + 3 * LANES]), np.float64(s[i + 4 * LANES]), np.float64(s[i + 5 * LANES])
        most_x, most_y, most_z = max(abs(x0), abs(x1)), max(abs(y0), abs(y1)), max(abs(z0), abs(z1))
        x, y, z = widen_errors(most_x, most_y, most_z, 1.0, False)
        poison = np.float64((s[i + 6 * LANES] + s[i + 7 * LANES]) + s[i + 8 * LANES])
        x, y, z = x + poison, y + poison, z + poison
        (x0, x1), (y0, y1) = _grow(x0 - x, x1 + x, reach), _grow(y0 - y, y1 + y, reach)
        z0, z1 = _grow(z0 - z, z1 + z, reach)
        i, j = CENTER * LANES + lane, AXES * LANES + lane
        d[i], d[i + LANES], d[i + 2 * LANES] = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1)
        d[j], d[j + 4 * LANES], d[j + 8 * LANES] = 0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.5 * (z1 - z0)


@kernel
def _fill_whole_boxes(
    control_points, rational, gregory_id, map_id, ends, ranges, by_map, center, axes, cone_cos, left
):  # fmt: skip
    """Boxes of all patches; left: those for which they do not hold."""
    n, some_left = len(control_points), False
    tail, s = np.empty((LANES, 64), np.float32), np.empty(ROWS * LANES, np.float32)
    d = np.empty(ROWS64 * LANES)
    d[AXES * LANES : (AXES + 9) * LANES] = 0.0
    for first in range(0, n, LANES):
        count = min(LANES, n - first)
        find_plain(first, count, rational, gregory_id, gregory_id, ends, PLAIN, s)
        for lane in range(count):
            column = map_id[first + lane] if by_map else first + lane
            reach = max(abs(ranges[0, column]), abs(ranges[1, column])) if column >= 0 else 0.0
            d[REACH * LANES + lane] = reach
            is_left = s[PLAIN * LANES + lane] == ZERO
            left[first + lane] = is_left
            some_left |= is_left
        load_block(control_points, first, tail, s)
        _reduce(s)
        _widen(s, d)
        store_block(d, CENTER, first, center)
        store_block(d, AXES, first, axes)
        for lane in range(count):
            cone_cos[first + lane] = -1.0
    return some_left


def box_patches(stage: HullInput, ranges: F64, by_map: bool) -> Boxes:
    """Cartesian boxes of all patches over their domains.

    ranges : least and greatest displacement, world units, rows float64[2, maps] (by_map) or float64[2, at least P].
    """
    patches, n = stage.patches, len(stage.patches.control_points)
    boxes, left = allocate_boxes(n), np.empty(n, np.bool_)
    if _fill_whole_boxes(
        patches.control_points.reshape(n, 64), patches.rational, patches.gregory_id, patches.map_id,
        stage.domain.reshape(-1), ranges, by_map, boxes.center, boxes.axes, boxes.cone_cos, left,
    ):  # fmt: skip
        _fill_boxes(np.flatnonzero(left), patches, stage.domain, ranges, by_map, np.empty((4, 4, 4)), boxes)
    return boxes


def bound_cartesian(stage: HullInput, ranges: F64, by_map: bool) -> PatchBounds:
    """As `box_patches`, with all that follows. A weight <= 0 gives a NaN box, which culls nothing."""
    bounds = unprojected(box_patches(stage, ranges, by_map))
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds


def bound_patches(stage: HullInput) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 gives a NaN box, which culls nothing."""
    return bound_cartesian(stage, np.ascontiguousarray(stage.pyramids.whole.T), True)
