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

from pipeline.bounds.fit import AXES, HI, KEPT, LO, SIZE, fit_boxes
from pipeline.bounds.lanes import LANES, least4, load_rows, most4, scratch
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.normals import bound_normals
from pipeline.bounds.project import allocate, project_boxes
from pipeline.bounds.vector import grow_by_vectors
from pipeline.jit import helper, inlined, kernel
from pipeline.types import HullInput, PatchBounds

U = 2.0**-24

T_LO, T_HI = KEPT, KEPT + 1
X_MOST, Y_MOST, Z_LEAST, CONE = (KEPT + 2 + k for k in range(4))
CENTER, HALF = KEPT + 6, KEPT + 9
ROWS = KEPT + 18


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
def _store(first, count, s, bounds):
    """Boxes and cones of the first `count` lanes to bounds."""
    center, axes = bounds.center[first:], bounds.axes[first:]
    cone_axis, cone_cos = bounds.cone_axis[first:], bounds.cone_cos[first:]
    for lane in range(count):
        cosine = s[CONE * LANES + lane]
        cone_cos[lane] = cosine
        for c in range(3):
            center[lane, c] = s[(CENTER + c) * LANES + lane]
            cone_axis[lane, c] = s[(AXES + 6 + c) * LANES + lane] if cosine > -1.0 else 0.0
            for r in range(3):
                axes[lane, r, c] = s[(HALF + 3 * r + c) * LANES + lane]


@kernel
def _grow_boxes(boxes, ranges, normals, s, bounds):
    n = len(bounds.center)
    for first in range(0, n, LANES):
        load_rows(s, 0, KEPT, boxes, first)
        load_rows(s, T_LO, 2, ranges, first)
        if normals.shape[1] > 0:
            load_rows(s, X_MOST, 4, normals, first)
        else:
            for k in range(4):
                for lane in range(LANES):
                    s[(X_MOST + k) * LANES + lane] = 1.0 if k < 2 else -1.0
        _grow_block(s)
        _store(first, min(LANES, n - first), s, bounds)


def bound_oriented(stage: HullInput, kind: int | None) -> PatchBounds:
    """Bound every patch over its domain. A weight <= 0 or a broken map gives a NaN box, which culls nothing.

    kind : of `normals.bound_normals`. None: nothing is known of the normals.
    """
    bounds = allocate(len(stage.patches.control_points))
    boxes, normals = (fit_boxes(stage), np.empty((4, 0))) if kind is None else bound_normals(stage, kind)
    ranges = displacement_ranges(stage)
    _grow_boxes(boxes, ranges, normals, scratch(ROWS), bounds)
    grow_by_vectors(stage, boxes, bounds)
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds
