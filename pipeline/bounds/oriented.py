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
from pipeline.bounds.cbox import find_plain
from pipeline.bounds.fit import AXES, HI, KEPT, LO, SIZE, fit_boxes
from pipeline.bounds.lanes import LANES, least4, load_rows, most4, padded, scratch
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.normals import bound_normals
from pipeline.bounds.project import allocate, project_boxes
from pipeline.bounds.shared_normals import find_slacks, widen_column
from pipeline.bounds.single import FINE, ZERO, fit_single
from pipeline.bounds.single_normals import CONE, X_MOST, Y_MOST, Z_LEAST, bound_single
from pipeline.bounds.transpose import load_block, prefer_wide, store_block
from pipeline.bounds.vector import grow_by_vectors
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, I64, HullInput, PatchBounds

U = 2.0**-24

NOTHING = -1  # is known of the normals

T_LO, T_HI = KEPT, KEPT + 1
CENTER, HALF, CONE_AXIS = KEPT + 6, KEPT + 9, KEPT + 18
ROWS = KEPT + 21

PLAIN = single_normals.ROWS  # of float32


@inlined
def _grow_axis(s, r, most, d_lo, d_hi, lane):
    """Middle and half of the extent along axis r with displacements d_lo .. d_hi along it, |t| <= most; NaN if they are."""
    poison = (d_lo - d_lo) + (d_hi - d_hi)
    size = s[SIZE * LANES + lane]
    pad = 12.0 * U * most + (3.5 * U * size if most > 0.0 else 0.0) + poison
    lo, hi = s[(LO + r) * LANES + lane] + d_lo, s[(HI + r) * LANES + lane] + d_hi
    return 0.5 * (lo + hi), 0.5 * (hi - lo) + pad


@helper
def _grow_block(s):
    """Rows CENTER and HALF (3 r + c: component c of half-extent vector r) of a block."""
    prefer_wide()
    for lane in range(LANES):
        t_lo, t_hi = s[T_LO * LANES + lane], s[T_HI * LANES + lane]
        most = max(abs(t_lo), abs(t_hi)) + (t_lo - t_lo) + (t_hi - t_hi)
        x, y, z = most * s[X_MOST * LANES + lane], most * s[Y_MOST * LANES + lane], s[Z_LEAST * LANES + lane]
        z_lo, z_hi = least4(t_lo, t_hi, t_lo * z, t_hi * z), most4(t_lo, t_hi, t_lo * z, t_hi * z)
        (m0, h0), (m1, h1) = _grow_axis(s, 0, most, -x, x, lane), _grow_axis(s, 1, most, -y, y, lane)
        m2, h2 = _grow_axis(s, 2, most, z_lo, z_hi, lane)
        for c in range(3):
            a, b = s[(AXES + c) * LANES + lane], s[(AXES + 3 + c) * LANES + lane]
            d = s[(AXES + 6 + c) * LANES + lane]
            s[(CENTER + c) * LANES + lane] = m0 * a + m1 * b + m2 * d
            s[(HALF + c) * LANES + lane], s[(HALF + 3 + c) * LANES + lane] = h0 * a, h1 * b
            s[(HALF + 6 + c) * LANES + lane] = h2 * d


@helper
def _store(first, count, cones, s, bounds):
    """Boxes of the first `count` lanes to bounds: its center, axes and cone_cos; cone_axis where there are cones."""
    center, axes, cone_axis, cone_cos = bounds
    store_block(s, CENTER, first, center)
    store_block(s, HALF, first, axes)
    if cones:
        for c in range(3):
            for lane in range(LANES):
                axis, known = s[(AXES + 6 + c) * LANES + lane], s[CONE * LANES + lane] > -1.0
                s[(CONE_AXIS + c) * LANES + lane] = axis if known else 0.0
        store_block(s, CONE_AXIS, first, cone_axis)
    for lane in range(count):
        cone_cos[first + lane] = s[CONE * LANES + lane]


@helper
def _know_nothing(s):
    """Rows X_MOST .. CONE."""
    for k in range(4):
        for lane in range(LANES):
            s[(X_MOST + k) * LANES + lane] = 1.0 if k < 2 else -1.0


# Whole Bezier patches


@kernel
def _bound_single(
    control_points, rational, tangent_id, gregory_id, domain, map_id, planes, kind, slacks, ranges, tail, s, d, bounds, left
):  # fmt: skip
    prefer_wide()
    n, some_left, vectors = len(control_points), False, False
    for m in range(len(planes)):
        vectors |= planes[m, 0] >= 0
    _know_nothing(d)
    for first in range(0, n, LANES):
        count = min(LANES, n - first)
        if count == LANES:
            find_plain(first, LANES, rational, tangent_id, gregory_id, domain, PLAIN, s)
        else:
            find_plain(first, count, rational, tangent_id, gregory_id, domain, PLAIN, s)
        load_block(control_points, first, tail, s)
        fit_single(s, d)
        if kind != NOTHING:
            bound_single(kind, s, d)
            if len(slacks) > 0:
                rows = d[X_MOST * LANES : (CONE + 1) * LANES].reshape(4, LANES)
                for lane in range(count):
                    widen_column(rows, lane, slacks[first + lane])
        load_rows(d, T_LO, 2, ranges, first)
        _grow_block(d)
        _store(first, count, kind != NOTHING, d, bounds)
        for lane in range(count):
            is_left = s[FINE * LANES + lane] * s[PLAIN * LANES + lane] == ZERO
            left[first + lane] = is_left
            some_left |= is_left
    if vectors:
        for p in range(n):
            left[p] |= map_id[p] >= 0 and planes[map_id[p], 0] >= 0
    return some_left or vectors


# All others


@kernel
def _grow_boxes(boxes, ranges, normals, s, bounds):
    n = len(bounds[0])
    for first in range(0, n, LANES):
        load_rows(s, 0, KEPT, boxes, first)
        load_rows(s, T_LO, 2, ranges, first)
        if normals.shape[1] > 0:
            load_rows(s, X_MOST, 4, normals, first)
        else:
            _know_nothing(s)
        _grow_block(s)
        _store(first, min(LANES, n - first), normals.shape[1] > 0, s, bounds)


def _boxes_of(bounds: PatchBounds) -> tuple[F64, F64, F64, F64]:
    """What is known before the projection; a plain tuple, as Numba takes 2 us to look at a named one."""
    return bounds.center, bounds.axes, bounds.cone_axis, bounds.cone_cos


def _box_any(stage: HullInput, kind: int, ranges: F64, bounds: PatchBounds) -> None:
    boxes, normals = (fit_boxes(stage), np.empty((4, 0))) if kind == NOTHING else bound_normals(stage, kind)
    _grow_boxes(boxes, ranges, normals, scratch(ROWS), _boxes_of(bounds))
    grow_by_vectors(stage, boxes, bounds)


def _box_some(stage: HullInput, kind: int, numbers: I64, ranges: F64, bounds: PatchBounds) -> None:
    """Boxes of the patches of these numbers."""
    part = stage._replace(patches=stage.patches.take(numbers), domain=stage.domain[numbers])
    boxes = allocate(len(numbers))
    of_part = np.zeros((2, padded(len(numbers))))
    of_part[:, : len(numbers)] = ranges[:, numbers]
    _box_any(part, kind, of_part, boxes)
    for name in ("center", "axes", "cone_axis", "cone_cos"):
        getattr(bounds, name)[numbers] = getattr(boxes, name)


def box_patches(stage: HullInput, kind: int, ranges: F64) -> PatchBounds:
    """Boxes and cones of all patches over their domains; what follows from them on screen is not filled in.

    kind : NOTHING, nothing is known of the normals; or of `normals.bound_normals`. ranges : `lookup.displacement_ranges`.
    """
    patches, n = stage.patches, len(stage.patches.control_points)
    bounds, left = allocate(n), np.empty(n, np.bool_)
    some_left = _bound_single(
        patches.control_points.reshape(n, 64), patches.rational, patches.tangent_id, patches.gregory_id, stage.domain,
        patches.map_id, stage.maps.planes, kind, find_slacks(stage), ranges, np.empty((LANES, 64), np.float32),
        np.empty((PLAIN + 1) * LANES, np.float32), np.empty(single.ROWS64 * LANES), _boxes_of(bounds), left,
    )  # fmt: skip
    if some_left:
        numbers = np.flatnonzero(left)
        if 0 < len(numbers) < n:
            _box_some(stage, kind, numbers, ranges, bounds)
        elif len(numbers):
            _box_any(stage, kind, ranges, bounds)
    return bounds


def bound_oriented(stage: HullInput, kind: int) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing."""
    bounds = box_patches(stage, kind, displacement_ranges(stage))
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds
