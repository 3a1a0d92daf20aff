"""Bounds of the unit normals in blocks of patches: TPATCH, its tight form, and NPATCH (`cones` has the mathematics).

As `cones`, with the control vectors of the tangents in the box's frame: a cone about an axis of the frame needs the
components alone, and the cross products of the normal patch come out in the frame. They are the differences of the control
points that `fit` has turned into it. The steepest vector of a cone is found by comparing quotients as products, so there
is one division a cone. What differs from the scalar functions:

- a turned point is off by 2^-51 of the largest coordinate, a control vector by less than 2^-46 of it. Vectors that are
  not longer than SHORT of it, zero ones among them, send their patch to the scalar functions; longer ones with a dot of at
  most STEEP of it count as beyond 90 degrees. What is left is off by less than 2^-26 = u / 4 of its dot: with the 15
  roundings of the shader less than the 16 of TANGENT;
- the error of a tangent in its cone, size / dot, is that of the steepest vector where the domain is the whole patch: there
  `size` is the vector's length, so it is sqrt(1 + tan^2);
- the error of the normal in NPATCH's cone is TPATCH's where the tangents have cones of their own, as both are about the
  same thing: the direction of the shader's normal. Else it is at most (2 TANGENT + 3) u A B / h, with A and B the largest
  sizes of the tangents' control vectors and h the least n.z of the normal patch's, binomials divided out. Both cover
  float64: where the tangents have cones and the normals' cosine is above 2^-10, v.z >= apart cos(theta) sum |a| |b| for a
  normal patch's control vector v, and 2^-49 of that sum is what rounds;
- coordinates of 2^59 or more, and control vectors of ACC patches of 2^60 or more, count as unknown: products of four
  components neither overflow nor underflow.

ACC patches (`Patches.tangent_id`): the normal is that of the tangent patches, nets of the same degrees, taken as given (the
shader's differences are one rounding more). Gregory patches: unknown. Rational patches, and parts of patches whose tangents
vanish at a corner of the domain, go to the scalar functions too; they are compiled when first needed.
"""

import math

import numpy as np

from pipeline.bounds import fit, scalar_normals
from pipeline.bounds.cones import TANGENT, U, combine_tangent_cones, widen
from pipeline.bounds.fit import AXES, COSINE, DOMAIN, SINE, SIZE, TURNED, fit_block, turn_points
from pipeline.bounds.lanes import LANES, columns, most4, restrict_rows, scratch
from pipeline.bounds.obb_frame import cross
from pipeline.bounds.rows import store_rows
from pipeline.bounds.shared_normals import widen_normals
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, HullInput
from pipeline.vector_width import prefer_wide

TPATCH, TPATCH_TIGHT, NPATCH = 0, 1, 2
SHORT, STEEP = 2.0**-18, 2.0**-20  # of the largest coordinate
LEAST_SIZE, MOST_SIZE = 2.0**-100, 2.0**59
LEAST_NORMAL = 2.0**-240
MOST_SQUARE = 2.0**120
LEAST_COSINE = 2.0**-10

# Rows of a block's scratch, after those of `fit`. Nets of x, y, z and size, one after the other; along u 3 x 4, along v 4 x 3.
ALONG_U, ALONG_V = fit.ROWS, fit.ROWS + 48
STEEP_T, SPREAD_T, SHORT_T, STEEP_B, SPREAD_B, SHORT_B = (fit.ROWS + 96 + k for k in range(6))
COS, SIN, MOST_X, MOST_Y, ERROR, LONGEST_U, LONGEST_V, OVER, UNDER, LEAST_Z = (fit.ROWS + 102 + k for k in range(10))
BOUND = fit.ROWS + 112  # 4, the result
ROWS = fit.ROWS + 116
WHOLE = ALONG_U  # 48, before the nets: the points of whole patches
NORMALS = fit.POINTS  # 36 each of x, y, z, in place of points and weights

# Binomials of the places in the nets. With them in the vectors the normal patch is a plain convolution (its divisors are
# left out).
FACTORS_U = tuple(a * b for a in (1.0, 2.0, 1.0) for b in (1.0, 3.0, 3.0, 1.0))
FACTORS_V = tuple(a * b for a in (1.0, 3.0, 3.0, 1.0) for b in (1.0, 2.0, 1.0))


# Control vectors


@inlined
def _subtract(s, target, a, b, rows):
    """Rows target .. = rows a .. - rows b .. ."""
    for i in range(rows * LANES):
        s[target * LANES + i] = s[a * LANES + i] - s[b * LANES + i]


@inlined
def _differences_of(s, c):
    u, v, points = ALONG_U + 12 * c, ALONG_V + 12 * c, TURNED + 16 * c
    _subtract(s, u, points + 4, points, 12)
    _subtract(s, v, points + 1, points, 3)
    _subtract(s, v + 3, points + 5, points + 4, 3)
    _subtract(s, v + 6, points + 9, points + 8, 3)
    _subtract(s, v + 9, points + 13, points + 12, 3)


@helper
def _differences(s):
    """Nets of x, y and z from the turned points."""
    _differences_of(s, 0)
    _differences_of(s, 1)
    _differences_of(s, 2)


@helper
def _load_vector(s, row, lane, vector):
    """A given control vector float32[3] of one lane, turned into the frame; NaN if it is too long."""
    x, y, z, f = np.float64(vector[0]), np.float64(vector[1]), np.float64(vector[2]), AXES * LANES + lane
    if not max(abs(x), abs(y), abs(z)) < MOST_SIZE:
        x = np.float64(np.nan)
    i = row * LANES + lane
    s[i] = s[f] * x + s[f + LANES] * y + s[f + 2 * LANES] * z
    s[i + 12 * LANES] = s[f + 3 * LANES] * x + s[f + 4 * LANES] * y + s[f + 5 * LANES] * z
    s[i + 24 * LANES] = s[f + 6 * LANES] * x + s[f + 7 * LANES] * y + s[f + 8 * LANES] * z


@helper
def _load_tangents(tangent_id, tangent_u, tangent_v, first, n, s):
    """Control vectors of the ACC patches of a block, in place of the differences."""
    for lane in range(LANES):
        row = tangent_id[min(first + lane, n - 1)]
        if row >= 0:
            for k in range(12):
                _load_vector(s, ALONG_U + k, lane, tangent_u[row, k >> 2, k & 3])
                _load_vector(s, ALONG_V + k, lane, tangent_v[row, k // 3, k % 3])


@helper
def _set_sizes(s, net):
    """Rows of sizes: the vectors' lengths."""
    for k in range(12):
        for lane in range(LANES):
            i = (net + k) * LANES + lane
            x, y, z = s[i], s[i + 12 * LANES], s[i + 24 * LANES]
            s[i + 36 * LANES] = math.sqrt(x * x + y * y + z * z)


@helper
def _scale(s, net, factors):
    """Vectors of a net, times their binomials."""
    for k in range(12):
        for lane in range(LANES):
            i, factor = (net + k) * LANES + lane, factors[k]
            x, y, z = s[i] * factor, s[i + 12 * LANES] * factor, s[i + 24 * LANES] * factor
            s[i], s[i + 12 * LANES], s[i + 24 * LANES] = x, y, z


@inlined
def _corner_is_zero(s, lane):
    """Whether a tangent's control vector at a corner of the domain is exactly zero."""
    u, v = (ALONG_U + 36) * LANES + lane, (ALONG_V + 36) * LANES + lane
    zero = s[u] == 0.0 or s[u + 3 * LANES] == 0.0 or s[u + 8 * LANES] == 0.0 or s[u + 11 * LANES] == 0.0
    return (
        zero or s[v] == 0.0 or s[v + 2 * LANES] == 0.0 or s[v + 9 * LANES] == 0.0 or s[v + 11 * LANES] == 0.0
    )  # fmt: skip


# Cones of tangents


@inlined
def _slope_t(s, row, lane):
    """(tan^2 of a vector's angle about (1, 0, 0) as numerator and denominator, square of its length)."""
    i = row * LANES + lane
    x, y, z = s[i], s[i + 12 * LANES], s[i + 24 * LANES]
    across, square = y * y + z * z, x * x
    known = x > STEEP * s[SIZE * LANES + lane]
    return (across if known else np.inf), (square if known else 1.0), across + square


@inlined
def _slope_b(s, row, lane):
    """The same about (COSINE, SINE, 0)."""
    i = row * LANES + lane
    x, y, z, c, d = s[i], s[i + 12 * LANES], s[i + 24 * LANES], s[COSINE * LANES + lane], s[SINE * LANES + lane]
    dot, side = c * x + d * y, c * y - d * x
    across, square = side * side + z * z, dot * dot
    known = dot > STEEP * s[SIZE * LANES + lane]
    return (across if known else np.inf), (square if known else 1.0), across + square


@inlined
def _steeper(a, b):
    """The greater quotient of two, and the lesser square."""
    second = b[0] * a[1] > a[0] * b[1]
    return (b[0] if second else a[0]), (b[1] if second else a[1]), min(a[2], b[2])


@inlined
def _steepest_t(s, row, lane):
    a, b = _slope_t(s, row, lane), _slope_t(s, row + 1, lane)
    return _steeper(_steeper(a, b), _slope_t(s, row + 2, lane))


@inlined
def _steepest_b(s, row, lane):
    a, b = _slope_b(s, row, lane), _slope_b(s, row + 1, lane)
    return _steeper(_steeper(a, b), _slope_b(s, row + 2, lane))


@inlined
def _put_cone(s, out, slope, lane):
    """Rows out, out + 1, out + 2: tan^2 of a cone's half angle, infinite where there is none; its secant; `short`."""
    over, under, least = slope
    i, size = out * LANES + lane, s[SIZE * LANES + lane]
    steep = over / under if size < MOST_SIZE else np.inf
    short = (least <= (SHORT * size) * (SHORT * size)) | (size < LEAST_SIZE)
    s[i], s[i + LANES], s[i + 2 * LANES] = steep, math.sqrt(1.0 + steep), 1.0 if short else 0.0


@helper
def _cone_t(s):
    for lane in range(LANES):
        a, b = _steepest_t(s, ALONG_U, lane), _steepest_t(s, ALONG_U + 3, lane)
        c, d = _steepest_t(s, ALONG_U + 6, lane), _steepest_t(s, ALONG_U + 9, lane)
        _put_cone(s, STEEP_T, _steeper(_steeper(a, b), _steeper(c, d)), lane)


@helper
def _cone_b(s):
    for lane in range(LANES):
        a, b = _steepest_b(s, ALONG_V, lane), _steepest_b(s, ALONG_V + 3, lane)
        c, d = _steepest_b(s, ALONG_V + 6, lane), _steepest_b(s, ALONG_V + 9, lane)
        _put_cone(s, STEEP_B, _steeper(_steeper(a, b), _steeper(c, d)), lane)


@helper
def _longest(s, net, out):
    """Row out: square of the largest size of a net. The rows NORMALS are scratch."""
    for k in range(12):
        for lane in range(LANES):
            size = s[(net + 36 + k) * LANES + lane]
            s[(NORMALS + k) * LANES + lane] = size * size
    for lane in range(LANES):
        i = NORMALS * LANES + lane
        a = most4(s[i], s[i + LANES], s[i + 2 * LANES], s[i + 3 * LANES])
        b = most4(s[i + 4 * LANES], s[i + 5 * LANES], s[i + 6 * LANES], s[i + 7 * LANES])
        c = most4(s[i + 8 * LANES], s[i + 9 * LANES], s[i + 10 * LANES], s[i + 11 * LANES])
        s[out * LANES + lane] = max(max(a, b), c)


@helper
def _spread(s, net, about_b, out):
    """Row out: largest size / dot of a net's vectors with x, or (about_b) with (COSINE, SINE, 0).

    For sub-domains: sizes there are those of the whole patch's vectors, restricted.
    """
    for lane in range(LANES):
        most = 0.0
        c, d = (s[COSINE * LANES + lane], s[SINE * LANES + lane]) if about_b else (1.0, 0.0)
        for k in range(12):
            i = (net + k) * LANES + lane
            dot = c * s[i] + d * s[i + 12 * LANES]
            most = max(most, s[i + 36 * LANES] / dot if dot > STEEP * s[SIZE * LANES + lane] else np.inf)
        s[out * LANES + lane] = most


@helper
def _combine(s):
    """Rows COS, SIN, MOST_X, MOST_Y, ERROR of TPATCH."""
    for lane in range(LANES):
        cosine, sine, x, y, error = combine_tangent_cones(
            (s[STEEP_T * LANES + lane], s[SPREAD_T * LANES + lane]),
            (s[STEEP_B * LANES + lane], s[SPREAD_B * LANES + lane]),
            s[COSINE * LANES + lane],
            s[SINE * LANES + lane],
            TANGENT,
        )
        s[COS * LANES + lane], s[SIN * LANES + lane] = cosine, sine
        s[MOST_X * LANES + lane], s[MOST_Y * LANES + lane] = x, y
        s[ERROR * LANES + lane] = error


# The normal patch


@inlined
def _vector(s, i, step):
    return s[i], s[i + step * LANES], s[i + 2 * step * LANES]


@inlined
def _add(p, q):
    return p[0] + q[0], p[1] + q[1], p[2] + q[2]


@inlined
def _put(s, i, add, v):
    for_x, for_y, for_z = v
    if add:
        s[i] += for_x
        s[i + 36 * LANES] += for_y
        s[i + 72 * LANES] += for_z
    else:
        s[i], s[i + 36 * LANES], s[i + 72 * LANES] = for_x, for_y, for_z


@helper
def _convolve(s, a, b, n, add):
    """Cross products of a row of 4 vectors along v (rows a ..) and one of 3 (rows b ..), summed to 6 (rows n ..)."""
    prefer_wide()
    for lane in range(LANES):
        i, j, k = a * LANES + lane, b * LANES + lane, n * LANES + lane
        a0, a1, a2, a3 = (
            _vector(s, i, 12), _vector(s, i + LANES, 12), _vector(s, i + 2 * LANES, 12), _vector(s, i + 3 * LANES, 12)
        )  # fmt: skip
        b0, b1, b2 = _vector(s, j, 12), _vector(s, j + LANES, 12), _vector(s, j + 2 * LANES, 12)
        _put(s, k, add, cross(a0, b0))
        _put(s, k + LANES, add, _add(cross(a0, b1), cross(a1, b0)))
        _put(s, k + 2 * LANES, add, _add(_add(cross(a0, b2), cross(a1, b1)), cross(a2, b0)))
        _put(s, k + 3 * LANES, add, _add(_add(cross(a1, b2), cross(a2, b1)), cross(a3, b0)))
        _put(s, k + 4 * LANES, add, _add(cross(a2, b2), cross(a3, b1)))
        _put(s, k + 5 * LANES, add, cross(a3, b2))


@inlined
def multiply_nets(s, along_u, along_v, product):
    """Normal patch, without the divisors of its basis, of two nets with their binomials; rows of either precision."""
    for i in range(108 * LANES):
        s[product * LANES + i] = 0.0
    for i in range(3):
        for k in range(4):
            _convolve(s, along_u + 4 * i, along_v + 3 * k, product + 6 * (i + k), True)


@inlined
def _slope_n(s, k, lane):
    i = (NORMALS + k) * LANES + lane
    x, y, z = s[i], s[i + 36 * LANES], s[i + 72 * LANES]
    known = z > LEAST_NORMAL
    return (x * x + y * y if known else np.inf), (z * z if known else 1.0), 0.0


@inlined
def _slopes_n(s, k, lane):
    """The steepest of six."""
    a = _steeper(_steeper(_slope_n(s, k, lane), _slope_n(s, k + 1, lane)), _slope_n(s, k + 2, lane))
    b = _steeper(_steeper(_slope_n(s, k + 3, lane), _slope_n(s, k + 4, lane)), _slope_n(s, k + 5, lane))
    return _steeper(a, b)


@inlined
def _least_z(s, k, lane):
    """Least z of six, without their binomials along v."""
    i = (NORMALS + 72 + k) * LANES + lane
    outer = min(s[i], s[i + 5 * LANES])
    middle = min(s[i + LANES], s[i + 4 * LANES]) * (1.0 / 5.0)
    inner = min(s[i + 2 * LANES], s[i + 3 * LANES]) * (1.0 / 10.0)
    return min(outer, min(middle, inner))


@helper
def _cone_n(s):
    """Rows OVER / UNDER: tan^2 of the normals' cone about z."""
    for lane in range(LANES):
        a = _steeper(_slopes_n(s, 0, lane), _slopes_n(s, 6, lane))
        b = _steeper(_slopes_n(s, 12, lane), _slopes_n(s, 18, lane))
        c = _steeper(_slopes_n(s, 24, lane), _slopes_n(s, 30, lane))
        s[OVER * LANES + lane], s[UNDER * LANES + lane], _ = _steeper(_steeper(a, b), c)


@helper
def _find_least_z(s):
    """Row LEAST_Z: least n.z, without binomials."""
    for lane in range(LANES):
        outer = min(_least_z(s, 0, lane), _least_z(s, 30, lane))
        middle = min(_least_z(s, 6, lane), _least_z(s, 24, lane)) * (1.0 / 5.0)
        inner = min(_least_z(s, 12, lane), _least_z(s, 18, lane)) * (1.0 / 10.0)
        s[LEAST_Z * LANES + lane] = min(outer, min(middle, inner))


@helper
def _finish_npatch(s):
    """Rows COS and SIN: of the normals' cone, or of the tangents' where that is narrower."""
    for lane in range(LANES):
        over, under, h = s[OVER * LANES + lane], s[UNDER * LANES + lane], s[LEAST_Z * LANES + lane]
        squares = s[LONGEST_U * LANES + lane] * s[LONGEST_V * LANES + lane]
        by_tangents = s[COS * LANES + lane] > LEAST_COSINE
        by_length = (2.0 * TANGENT + 3.0) * U * math.sqrt(squares) / h + U
        error = s[ERROR * LANES + lane] if by_tangents else by_length
        steep = over / under
        cosine = 1.0 / math.sqrt(1.0 + steep)
        c, n = widen(math.sqrt(steep) * cosine, cosine, error)
        known = (steep < np.inf) & (by_tangents | ((h > 0.0) & (squares < MOST_SQUARE * MOST_SQUARE)))
        s[COS * LANES + lane] = max(s[COS * LANES + lane], c) if known else s[COS * LANES + lane]
        s[SIN * LANES + lane] = min(s[SIN * LANES + lane], n) if known else s[SIN * LANES + lane]


@helper
def _bound_by_normals(s, whole):
    """NPATCH, after TPATCH. Sizes and least n.z are found where a lane of the block needs them."""
    some_wide = False
    for lane in range(LANES):
        some_wide |= not s[COS * LANES + lane] > LEAST_COSINE
    if some_wide:
        if whole:
            _set_sizes(s, ALONG_U)
            _set_sizes(s, ALONG_V)
        _longest(s, ALONG_U, LONGEST_U)
        _longest(s, ALONG_V, LONGEST_V)
    _scale(s, ALONG_U, FACTORS_U)
    _scale(s, ALONG_V, FACTORS_V)
    multiply_nets(s, ALONG_U, ALONG_V, NORMALS)
    _cone_n(s)
    if some_wide:
        _find_least_z(s)
    _finish_npatch(s)


# All patches


@helper
def _bound_block(whole, kind, s):
    """Rows COS, SIN, MOST_X, MOST_Y from the nets."""
    if not whole:
        _set_sizes(s, ALONG_U)
        _set_sizes(s, ALONG_V)
        restrict_rows(s, ALONG_U, 4, 3, 4, DOMAIN)
        restrict_rows(s, ALONG_V, 4, 4, 3, DOMAIN)
    _cone_t(s)
    _cone_b(s)
    if not whole:
        _spread(s, ALONG_U, False, SPREAD_T)
        _spread(s, ALONG_V, True, SPREAD_B)
    _combine(s)
    if kind == NPATCH:
        _bound_by_normals(s, whole)


@kernel
def _bound_normals(
    control_points, rational, tangent_id, gregory_id, inner, tangent_u, tangent_v, domain, kind, s, points, axes, boxes,
    todo, out,
):  # fmt: skip
    n = len(control_points)
    some_todo = False
    for first in range(0, n, LANES):
        whole = fit_block(control_points, rational, gregory_id, inner, domain, first, WHOLE, s, points, axes)
        store_rows(s, 0, fit.KEPT, boxes, first)
        if not whole:
            turn_points(s, WHOLE)
        _differences(s)
        _load_tangents(tangent_id, tangent_u, tangent_v, first, n, s)
        _bound_block(whole, kind, s)
        for lane in range(min(LANES, n - first)):
            p = first + lane
            later = (rational[p] != 0 and tangent_id[p] < 0) or s[SHORT_T * LANES + lane] + s[
                SHORT_B * LANES + lane
            ] > 0.0
            if not whole:
                later |= _corner_is_zero(s, lane)
            todo[p] = later and gregory_id[p] < 0
            some_todo |= todo[p]
        for lane in range(LANES):
            if gregory_id[min(first + lane, n - 1)] >= 0:
                s[SIN * LANES + lane] = s[MOST_X * LANES + lane] = s[MOST_Y * LANES + lane] = 1.0
                s[COS * LANES + lane] = -1.0
        for lane in range(LANES):
            i, j = SIN * LANES + lane, BOUND * LANES + lane
            s[j] = s[i + LANES] if kind == TPATCH_TIGHT else s[i]
            s[j + LANES] = s[i + 2 * LANES] if kind == TPATCH_TIGHT else s[i]
            s[j + 2 * LANES] = s[j + 3 * LANES] = s[i - LANES]
        store_rows(s, BOUND, 4, out, first)
    return some_todo


def bound_normals(stage: HullInput, kind: int) -> tuple[F64, F64]:
    """(boxes of `fit.fit_boxes`, bounds of the normals) of all patches over their domains.

    The bounds are rows float64[4, columns of boxes]: normals n in the frame have |n.x| <= row 0, |n.y| <= row 1, n.z >= row
    2; row 3 is the cosine of the half angle of their cone about z, -1 if not known. kind : TPATCH, TPATCH_TIGHT or NPATCH.
    """
    patches = stage.patches
    n = len(patches.control_points)
    boxes, out, todo = np.empty((fit.KEPT, columns(n))), np.empty((4, columns(n))), np.zeros(n, np.bool_)
    if _bound_normals(
        patches.control_points.reshape(n, 64), patches.rational, patches.tangent_id, patches.gregory_id, patches.inner,
        patches.tangent_u, patches.tangent_v, stage.domain, kind, scratch(ROWS), np.empty((4, 4, 3)), np.empty((3, 3)),
        boxes, todo, out,
    ):  # fmt: skip
        scalar_normals.bound_normals(stage, np.flatnonzero(todo), boxes, kind == NPATCH, kind == TPATCH_TIGHT, out)
    widen_normals(stage, out)
    return boxes, out
