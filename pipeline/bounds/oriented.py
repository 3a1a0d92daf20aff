"""The driver of the oriented bounds: fitted box, displacement, bound of the normals, and the box that they make together.

Munkberg et al. 2010, section 3.1: along each axis of the frame the box is the extent of the control points over the
domain, plus the range of displacement x normal. `obbtex`, `tpatch`, `tpatch_tight` and `npatch` differ in the range of
the normal alone. A patch whose normal is zero somewhere stays where it is there; no algorithm knows a normal bound then
(`cones`), and the range [-1, 1] holds zero.

Widened outwards for the float32 shader (u = 2^-24), beside what `fit` adds: p + t n rounds once, t n once, and the
components of n are off by at most 4 u in length: 6 u |t|, as vectors at most sqrt(3) times that.

Box and normals are one kernel (`normals`; `fit` alone where nothing is asked of the normals), growing and projecting are
others; between them go rows over all patches (`lanes`).
"""

import numpy as np

from pipeline.bounds import single, single_normals
from pipeline.bounds.cbox import find_left
from pipeline.bounds.fit import AXES, HI, KEPT, LO, SIZE, fit_boxes
from pipeline.bounds.lanes import LANES, aligned, least4, most4, padded, scratch
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.normals import bound_normals
from pipeline.bounds.project import Boxes, allocate_boxes, project_boxes, unprojected
from pipeline.bounds.rows import copy_lanes, load_rows
from pipeline.bounds.shared_normals import find_slacks, widen_column
from pipeline.bounds.single import FINE, MIDDLE, POINTS, REACH, UNIT, ZERO, clear_first, fit_single
from pipeline.bounds.single_normals import CONE, X_MOST, Y_MOST, Z_LEAST, bound_single
from pipeline.bounds.spread import store3, store9
from pipeline.bounds.transpose import load_block
from pipeline.bounds.vector import grow_by_vectors
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, I64, HullInput, PatchBounds
from pipeline.vector_width import prefer_wide

U = 2.0**-24

NOTHING = -1  # is known of the normals

T_LO, T_HI = KEPT, KEPT + 1
CENTER, HALF, CONE_AXIS = KEPT + 6, KEPT + 9, KEPT + 18
ROWS = KEPT + 21


@inlined
def _displace(s, lane, size, known):
    """What the displacement adds to the extents along x, y and z: reach, reach, range; to each half what it rounds.

    NaN if the displacement is. size : largest magnitude of a coordinate of the whole patch. known : whether rows X_MOST ..
    say something of the normals.
    """
    t_lo, t_hi = s[T_LO * LANES + lane], s[T_HI * LANES + lane]
    most = max(abs(t_lo), abs(t_hi)) + (t_lo - t_lo) + (t_hi - t_hi)
    pad = 12.0 * U * most + (3.5 * U * size if most > 0.0 else 0.0)
    if not known:
        return most, most, -most, most, pad
    x, y, z = most * s[X_MOST * LANES + lane], most * s[Y_MOST * LANES + lane], s[Z_LEAST * LANES + lane]
    z_lo, z_hi = least4(t_lo, t_hi, t_lo * z, t_hi * z), most4(t_lo, t_hi, t_lo * z, t_hi * z)
    return x, y, z_lo, z_hi, pad


@inlined
def _put_box(s, lane, x, y, z, middles, halves):
    """Rows CENTER and HALF (3 r + c: component c of half-extent vector r): a box about (x, y, z) + axes times middles."""
    i, j, k = AXES * LANES + lane, CENTER * LANES + lane, HALF * LANES + lane
    (m0, m1, m2), (h0, h1, h2) = middles, halves
    a, b, c = s[i], s[i + 3 * LANES], s[i + 6 * LANES]
    s[j] = x + (m0 * a + m1 * b + m2 * c)
    s[k], s[k + 3 * LANES], s[k + 6 * LANES] = h0 * a, h1 * b, h2 * c
    a, b, c = s[i + LANES], s[i + 4 * LANES], s[i + 7 * LANES]
    s[j + LANES] = y + (m0 * a + m1 * b + m2 * c)
    s[k + LANES], s[k + 4 * LANES], s[k + 7 * LANES] = h0 * a, h1 * b, h2 * c
    a, b, c = s[i + 2 * LANES], s[i + 5 * LANES], s[i + 8 * LANES]
    s[j + 2 * LANES] = z + (m0 * a + m1 * b + m2 * c)
    s[k + 2 * LANES], s[k + 5 * LANES], s[k + 8 * LANES] = h0 * a, h1 * b, h2 * c


@inlined
def _aim_cone(s, lane):
    """Rows CONE_AXIS: the third axis, zero where there is no cone."""
    known, i, j = s[CONE * LANES + lane] > -1.0, (AXES + 6) * LANES + lane, CONE_AXIS * LANES + lane
    x, y, z = s[i], s[i + LANES], s[i + 2 * LANES]
    s[j], s[j + LANES], s[j + 2 * LANES] = (x if known else 0.0), (y if known else 0.0), (z if known else 0.0)


@helper
def _grow_block(s):
    """Rows CENTER, HALF and CONE_AXIS, from LO and HI."""
    prefer_wide()
    for lane in range(LANES):
        x, y, z_lo, z_hi, pad = _displace(s, lane, s[SIZE * LANES + lane], True)
        i, j = LO * LANES + lane, HI * LANES + lane
        x0, x1, y0, y1 = s[i] - x, s[j] + x, s[i + LANES] - y, s[j + LANES] + y
        z0, z1 = s[i + 2 * LANES] + z_lo, s[j + 2 * LANES] + z_hi
        middles = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1)
        halves = 0.5 * (x1 - x0) + pad, 0.5 * (y1 - y0) + pad, 0.5 * (z1 - z0) + pad
        _put_box(s, lane, 0.0, 0.0, 0.0, middles, halves)
        _aim_cone(s, lane)


@inlined
def _grow_single(s, d, known):
    """Rows CENTER, HALF and CONE_AXIS of d, the last only if normals are `known`; whether a patch of the block is not FINE.

    From rows MIDDLE, REACH and POINTS of s. A sum here rounds by 2^-53 of it, within `single.AXIS`.
    """
    prefer_wide()
    left = np.uint8(0)
    for lane in range(LANES):
        x, y, z_lo, z_hi, pad = _displace(d, lane, np.float64(s[single.SIZE * LANES + lane]), known)
        unit, i, j, f = d[UNIT * LANES + lane], MIDDLE * LANES + lane, REACH * LANES + lane, POINTS * LANES + lane
        m0, m1, m2 = np.float64(s[i]), np.float64(s[i + LANES]), np.float64(s[i + 2 * LANES])
        h0, h1, h2 = np.float64(s[j]), np.float64(s[j + LANES]), np.float64(s[j + 2 * LANES])
        middles = unit * m0, unit * m1, unit * m2 + 0.5 * (z_lo + z_hi)
        halves = unit * h0 + (x + pad), unit * h1 + (y + pad), unit * h2 + (0.5 * (z_hi - z_lo) + pad)
        _put_box(
            d, lane, np.float64(s[f]), np.float64(s[f + 16 * LANES]), np.float64(s[f + 32 * LANES]), middles, halves
        )  # fmt: skip
        if known:
            _aim_cone(d, lane)
        left |= np.uint8(s[FINE * LANES + lane] == ZERO)
    return left != 0


@helper
def _store(first, count, cones, s, center, axes, cone_axis, cone_cos):
    """Boxes of the first `count` lanes; cone_axis where there are cones."""
    store3(s, CENTER, first, center)
    store9(s, HALF, first, axes)
    if cones:
        store3(s, CONE_AXIS, first, cone_axis)
    if count == LANES:
        copy_lanes(s, CONE * LANES, cone_cos, first)
    else:
        for lane in range(count):
            cone_cos[np.uintp(first) + np.uintp(lane)] = s[CONE * LANES + lane]


@helper
def _know_nothing(s):
    """Rows X_MOST .. CONE."""
    for k in range(4):
        for lane in range(LANES):
            s[(X_MOST + k) * LANES + lane] = 1.0 if k < 2 else -1.0


# Whole Bezier patches


@inlined
def _bound_slacked(kind, slacks, first, count, s, d):
    """Rows X_MOST .. CONE of d, widened by the slacks of the block's patches where some share normals."""
    bound_single(kind, s, d)
    if len(slacks) > 0:
        rows = d[X_MOST * LANES : (CONE + 1) * LANES].reshape(4, LANES)
        for lane in range(count):
            widen_column(rows, lane, slacks[first + lane])


@kernel
def _bound_single(
    control_points, rational, tangent_id, gregory_id, ends, map_id, planes, kind, slacks, ranges, center, axes, cone_axis,
    cone_cos, left,
):  # fmt: skip
    prefer_wide()
    n, vectors = len(control_points), False
    some_left = find_left(rational, tangent_id, gregory_id, ends, left)
    s, d = aligned(np.empty(single_normals.ROWS * LANES + 16, np.float32)), aligned(np.empty(single.ROWS64 * LANES + 8))
    tail = np.empty((LANES, 64), np.float32)
    for m in range(len(planes)):
        vectors |= planes[m, 0] >= 0
    _know_nothing(d)
    clear_first(s)
    for first in range(0, n, LANES):
        count = min(LANES, n - first)
        load_block(control_points, first, tail, s)
        load_rows(d, T_LO, 2, ranges, first)
        if kind == NOTHING:
            fit_single(s, d, False)
            left_here = _grow_single(s, d, False)
        else:
            fit_single(s, d, True)
            _bound_slacked(kind, slacks, first, count, s, d)
            left_here = _grow_single(s, d, True)
        _store(first, count, kind != NOTHING, d, center, axes, cone_axis, cone_cos)
        if left_here:
            for lane in range(count):
                left[first + lane] |= s[FINE * LANES + lane] == ZERO
        some_left |= left_here
    if vectors:
        for p in range(n):
            left[p] |= map_id[p] >= 0 and planes[map_id[p], 0] >= 0
    return some_left or vectors


# All others


@kernel
def _grow_boxes(boxes, ranges, normals, s, center, axes, cone_axis, cone_cos):
    n = len(center)
    for first in range(0, n, LANES):
        load_rows(s, 0, KEPT, boxes, first)
        load_rows(s, T_LO, 2, ranges, first)
        if normals.shape[1] > 0:
            load_rows(s, X_MOST, 4, normals, first)
        else:
            _know_nothing(s)
        _grow_block(s)
        count = min(LANES, n - first)
        _store(first, count, normals.shape[1] > 0, s, center, axes, cone_axis, cone_cos)


def _box_any(stage: HullInput, kind: int, ranges: F64, boxes: Boxes) -> None:
    fitted, normals = (fit_boxes(stage), np.empty((4, 0))) if kind == NOTHING else bound_normals(stage, kind)
    _grow_boxes(fitted, ranges, normals, scratch(ROWS), *boxes)
    grow_by_vectors(stage, fitted, boxes.center, boxes.axes)


def _box_some(stage: HullInput, kind: int, numbers: I64, ranges: F64, boxes: Boxes) -> None:
    """Boxes of the patches of these numbers."""
    part = stage._replace(patches=stage.patches.take(numbers), domain=stage.domain[numbers])
    some = allocate_boxes(len(numbers))
    of_part = np.zeros((2, padded(len(numbers))))
    of_part[:, : len(numbers)] = ranges[:, numbers]
    _box_any(part, kind, of_part, some)
    for target, source in zip(boxes, some, strict=True):
        target[numbers] = source


def put_boxes(stage: HullInput, kind: int, ranges: F64, boxes: Boxes) -> None:
    """Boxes and cones of all patches over their domains, into `boxes`, of as many.

    kind : NOTHING, nothing is known of the normals; or of `normals.bound_normals`. ranges : `lookup.displacement_ranges`.
    """
    patches, n = stage.patches, len(stage.patches.control_points)
    left = np.empty(n, np.bool_)
    some_left = _bound_single(
        patches.control_points.reshape(n, 64), patches.rational, patches.tangent_id, patches.gregory_id,
        stage.domain.reshape(-1), patches.map_id, stage.maps.planes, kind, find_slacks(stage), ranges, *boxes, left,
    )  # fmt: skip
    if some_left:
        numbers = np.flatnonzero(left)
        if 0 < len(numbers) < n:
            _box_some(stage, kind, numbers, ranges, boxes)
        elif len(numbers):
            _box_any(stage, kind, ranges, boxes)


def box_patches(stage: HullInput, kind: int, ranges: F64) -> Boxes:
    """`put_boxes` into arrays of their own."""
    boxes = allocate_boxes(len(stage.patches.control_points))
    put_boxes(stage, kind, ranges, boxes)
    return boxes


def bound_oriented(stage: HullInput, kind: int) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    bounds = unprojected(box_patches(stage, kind, displacement_ranges(stage)))
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds
