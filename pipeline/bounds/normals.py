"""Bounds of the unit normals in blocks of patches: TPATCH, its tight form, and NPATCH (`cones` has the mathematics).

As `cones`, with the control vectors of the tangents turned into the box's frame first: a cone about an axis of the frame
needs the components alone, and the cross products of the normal patch come out in the frame. The steepest vector of a
cone is found by comparing quotients as products, so there is one division a cone. What differs from the scalar functions:

- the error of a tangent in its cone, size / dot, is that of the steepest vector where the domain is the whole patch: there
  `size` is the vector's length, so it is sqrt(1 + tan^2);
- the error of the normal in NPATCH's cone is TPATCH's where the tangents have cones of their own, as both are about the
  same thing: the direction of the shader's normal. Else it is at most (2 TANGENT + 3) u A B / h, with A and B the largest
  sizes of the tangents' control vectors and h the least n.z of the normal patch's, binomials divided out. Both cover
  float64: where the tangents have cones and the normals' cosine is above 2^-10, v.z >= apart cos(theta) sum |a| |b| for a
  normal patch's control vector v, and 2^-49 of that sum is what rounds;
- control vectors with 0 < dot <= LEAST count as beyond 90 degrees, and squares of 2^120 or more as unknown: products of
  four components neither overflow nor underflow.

ACC patches (`Patches.tangent_id`): the normal is that of the tangent patches, nets of the same degrees, taken as given (the
shader's differences are one rounding more). Gregory patches: unknown. Rational patches, and parts of patches whose tangents
vanish at a corner of the domain, go to the scalar functions; they are compiled when first needed.
"""

import math

import numpy as np

from pipeline.bounds import scalar_normals
from pipeline.bounds.cones import TANGENT, U, combine_tangent_cones, widen
from pipeline.bounds.fit import AXES, COSINE, SINE
from pipeline.bounds.lanes import LANES, load_domains, load_points, load_row, most4, restrict_rows, scratch
from pipeline.bounds.obb_frame import cross
from pipeline.bounds.shared_normals import widen_normals
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F64, HullInput

TPATCH, TPATCH_TIGHT, NPATCH = 0, 1, 2
LEAST, LEAST_NORMAL = 2.0**-120, 2.0**-240
MOST_SQUARE = 2.0**120
LEAST_COSINE = 2.0**-10

# Rows of a block's scratch. Nets of x, y, z and size, one after the other; along u 3 x 4, along v 4 x 3.
FRAME = 0
ALONG_U, ALONG_V, DOMAIN = 11, 59, 107
STEEP_T, SPREAD_T, SQUARE_T, STEEP_B, SPREAD_B, SQUARE_B = 111, 112, 113, 114, 115, 116
COS, SIN, MOST_X, MOST_Y, ERROR = 117, 118, 119, 120, 121
TURN_T, TURN_B = 122, 124  # cosine and sine of the tangents' axes in the frame's plane of x and y
LONGEST_U, LONGEST_V = 126, 127
POINTS = 128  # 48; afterwards the normal patch takes their place
NORMALS = 128  # 36 each of x, y, z
ROWS = NORMALS + 108

# Binomials of the places in the nets. With them in the vectors the normal patch is a plain convolution (its divisors are
# left out). The cones do not see them, as sizes are multiplied too.
FACTORS_U = tuple(a * b for a in (1.0, 2.0, 1.0) for b in (1.0, 3.0, 3.0, 1.0))
FACTORS_V = tuple(a * b for a in (1.0, 3.0, 3.0, 1.0) for b in (1.0, 2.0, 1.0))


# Control vectors


@helper
def _subtract(s, target, a, b, rows):
    """Rows target .. = rows a .. - rows b .. ."""
    for i in range(rows * LANES):
        s[target * LANES + i] = s[a * LANES + i] - s[b * LANES + i]


@inlined
def _differences(s):
    """Nets of x, y and z from the control points."""
    for c in range(3):
        points = POINTS + 16 * c
        _subtract(s, ALONG_U + 12 * c, points + 4, points, 12)
        for i in range(4):
            _subtract(s, ALONG_V + 12 * c + 3 * i, points + 4 * i + 1, points + 4 * i, 3)


@helper
def _load_tangents(tangent_id, tangent_u, tangent_v, first, n, s):
    """Control vectors of the ACC patches of a block, in place of the differences."""
    for lane in range(LANES):
        row = tangent_id[min(first + lane, n - 1)]
        if row >= 0:
            for c in range(3):
                for k in range(12):
                    s[(ALONG_U + 12 * c + k) * LANES + lane] = tangent_u[row, k >> 2, k & 3, c]
                    s[(ALONG_V + 12 * c + k) * LANES + lane] = tangent_v[row, k // 3, k % 3, c]


@helper
def _set_sizes(s, net):
    """Rows of sizes: the vectors' lengths."""
    for k in range(12):
        for lane in range(LANES):
            i = (net + k) * LANES + lane
            x, y, z = s[i], s[i + 12 * LANES], s[i + 24 * LANES]
            s[i + 36 * LANES] = math.sqrt(x * x + y * y + z * z)


@inlined
def _corner_is_zero(s, lane):
    """Whether a tangent's control vector at a corner of the domain is exactly zero."""
    u, v = (ALONG_U + 36) * LANES + lane, (ALONG_V + 36) * LANES + lane
    zero = s[u] == 0.0 or s[u + 3 * LANES] == 0.0 or s[u + 8 * LANES] == 0.0 or s[u + 11 * LANES] == 0.0
    return (
        zero or s[v] == 0.0 or s[v + 2 * LANES] == 0.0 or s[v + 9 * LANES] == 0.0 or s[v + 11 * LANES] == 0.0
    )  # fmt: skip


@helper
def _turn(s, row, factor):
    """One vector of each lane, rows row, row + 12, row + 24, and its size, row + 36, times a factor to the frame."""
    for lane in range(LANES):
        i, f = row * LANES + lane, (FRAME + AXES) * LANES + lane
        x, y, z = s[i], s[i + 12 * LANES], s[i + 24 * LANES]
        s[i] = factor * (s[f] * x + s[f + LANES] * y + s[f + 2 * LANES] * z)
        s[i + 12 * LANES] = factor * (s[f + 3 * LANES] * x + s[f + 4 * LANES] * y + s[f + 5 * LANES] * z)
        s[i + 36 * LANES] = factor * s[i + 36 * LANES]
        s[i + 24 * LANES] = factor * (s[f + 6 * LANES] * x + s[f + 7 * LANES] * y + s[f + 8 * LANES] * z)


# Cones of tangents


@inlined
def _slope(x, y, z, dot, across, least):
    """(tan^2 of a vector's angle as numerator and denominator, its square); -1 / 1 for the zero vector."""
    square = dot * dot
    known = dot > least
    zero = (x == 0.0) & (y == 0.0) & (z == 0.0)
    over = across if known else np.inf
    return (-1.0 if zero else over), (square if known else 1.0), across + square


@inlined
def _slope_of(s, row, turn, lane):
    """`_slope` of the vector in rows row, row + 12, row + 24 about (rows turn, turn + 1; 0)."""
    i, j = row * LANES + lane, turn * LANES + lane
    x, y, z = s[i], s[i + 12 * LANES], s[i + 24 * LANES]
    side = s[j] * y - s[j + LANES] * x
    return _slope(x, y, z, s[j] * x + s[j + LANES] * y, side * side + z * z, LEAST)


@inlined
def _steeper(a, b):
    """The greater quotient of two, and the sum of the squares."""
    second = b[0] * a[1] > a[0] * b[1]
    return (b[0] if second else a[0]), (b[1] if second else a[1]), a[2] + b[2]


@inlined
def _steepest_of_3(s, row, turn, lane):
    a, b = _slope_of(s, row, turn, lane), _slope_of(s, row + 1, turn, lane)
    return _steeper(_steeper(a, b), _slope_of(s, row + 2, turn, lane))


@helper
def _cone(s, net, turn, out):
    """Rows out, out + 1, out + 2: tan^2 of a net's half angle, infinite where it has no cone; its secant; the squares."""
    for lane in range(LANES):
        a, b = _steepest_of_3(s, net, turn, lane), _steepest_of_3(s, net + 3, turn, lane)
        c, d = _steepest_of_3(s, net + 6, turn, lane), _steepest_of_3(s, net + 9, turn, lane)
        over, under, square = _steeper(_steeper(a, b), _steeper(c, d))
        steep = over / under if (over >= 0.0) & (square < MOST_SQUARE) else np.inf
        i = out * LANES + lane
        s[i], s[i + LANES], s[i + 2 * LANES] = steep, math.sqrt(1.0 + steep), square


@helper
def _longest(s, net, sizes, out):
    """Row out: square of the longest vector of a net, or (sizes) of its largest size. The rows POINTS are scratch."""
    for k in range(12):
        for lane in range(LANES):
            i = (net + k) * LANES + lane
            x, y, z, size = s[i], s[i + 12 * LANES], s[i + 24 * LANES], s[i + 36 * LANES]
            s[(POINTS + k) * LANES + lane] = size * size if sizes else x * x + y * y + z * z
    for lane in range(LANES):
        i = POINTS * LANES + lane
        a = most4(s[i], s[i + LANES], s[i + 2 * LANES], s[i + 3 * LANES])
        b = most4(s[i + 4 * LANES], s[i + 5 * LANES], s[i + 6 * LANES], s[i + 7 * LANES])
        c = most4(s[i + 8 * LANES], s[i + 9 * LANES], s[i + 10 * LANES], s[i + 11 * LANES])
        s[out * LANES + lane] = max(max(a, b), c)


@helper
def _spread(s, net, turn, out):
    """Row out: largest size / dot of a net's vectors. A size of zero adds nothing.

    For sub-domains: sizes there are those of the whole patch's vectors, restricted.
    """
    for lane in range(LANES):
        most = 0.0
        j = turn * LANES + lane
        for k in range(12):
            i = (net + k) * LANES + lane
            size = s[i + 36 * LANES]
            dot = s[j] * s[i] + s[j + LANES] * s[i + 12 * LANES]
            ratio = size / dot if dot > LEAST else np.inf
            most = max(most, 0.0 if size == 0.0 else ratio)
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
def _multiply(s):
    """Normal patch, without the divisors of its basis."""
    s[NORMALS * LANES : (NORMALS + 108) * LANES] = 0.0
    for i in range(3):
        for k in range(4):
            _convolve(s, ALONG_U + 4 * i, ALONG_V + 3 * k, NORMALS + 6 * (i + k), True)


@inlined
def _slope_n(s, k, lane):
    i = (NORMALS + k) * LANES + lane
    x, y, z = s[i], s[i + 36 * LANES], s[i + 72 * LANES]
    return _slope(x, y, z, z, x * x + y * y, LEAST_NORMAL)


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
    """Rows STEEP_B / STEEP_T: tan^2 of the normals' cone about z; SPREAD_B: least n.z, without binomials. (Free rows.)"""
    for lane in range(LANES):
        a = _steeper(_slopes_n(s, 0, lane), _slopes_n(s, 6, lane))
        b = _steeper(_slopes_n(s, 12, lane), _slopes_n(s, 18, lane))
        c = _steeper(_slopes_n(s, 24, lane), _slopes_n(s, 30, lane))
        s[STEEP_B * LANES + lane], s[STEEP_T * LANES + lane], _ = _steeper(_steeper(a, b), c)
    for lane in range(LANES):
        outer = min(_least_z(s, 0, lane), _least_z(s, 30, lane))
        middle = min(_least_z(s, 6, lane), _least_z(s, 24, lane)) * (1.0 / 5.0)
        inner = min(_least_z(s, 12, lane), _least_z(s, 18, lane)) * (1.0 / 10.0)
        s[SPREAD_B * LANES + lane] = min(outer, min(middle, inner))


@helper
def _finish_npatch(s):
    """Rows COS and SIN: of the normals' cone, or of the tangents' where that is narrower."""
    for lane in range(LANES):
        over, under, h = s[STEEP_B * LANES + lane], s[STEEP_T * LANES + lane], s[SPREAD_B * LANES + lane]
        squares = s[LONGEST_U * LANES + lane] * s[LONGEST_V * LANES + lane]
        by_tangents = s[COS * LANES + lane] > LEAST_COSINE
        by_length = (2.0 * TANGENT + 3.0) * U * math.sqrt(squares) / h + U
        error = s[ERROR * LANES + lane] if by_tangents else by_length
        steep = over / under
        cosine = 1.0 / math.sqrt(1.0 + steep)
        c, n = widen(math.sqrt(steep) * cosine, cosine, error)
        known = (over >= 0.0) & (steep < np.inf) & (by_tangents | (h > 0.0)) & (squares < MOST_SQUARE * MOST_SQUARE)
        s[COS * LANES + lane] = max(s[COS * LANES + lane], c) if known else s[COS * LANES + lane]
        s[SIN * LANES + lane] = min(s[SIN * LANES + lane], n) if known else s[SIN * LANES + lane]


# All patches


@kernel
def _bound_normals(
    control_points, rational, tangent_id, gregory_id, tangent_u, tangent_v, domain, boxes, kind, s, todo, out
):  # fmt: skip
    n = len(control_points)
    some_todo = False
    for first in range(0, n, LANES):
        load_points(control_points, first, n, POINTS, s)
        whole = load_domains(domain, first, n, DOMAIN, s)
        for k in range(11):
            load_row(s, FRAME + k, boxes[k], first)
        _differences(s)
        _load_tangents(tangent_id, tangent_u, tangent_v, first, n, s)
        if not whole:
            _set_sizes(s, ALONG_U)
            _set_sizes(s, ALONG_V)
            restrict_rows(s, ALONG_U, 4, 3, 4, DOMAIN)
            restrict_rows(s, ALONG_V, 4, 4, 3, DOMAIN)
        for lane in range(min(LANES, n - first)):
            p = first + lane
            later = rational[p] != 0 and tangent_id[p] < 0
            if not whole:
                later |= _corner_is_zero(s, lane)
            todo[p] = later and gregory_id[p] < 0
            some_todo |= todo[p]
        if kind == NPATCH:
            _longest(s, ALONG_U, not whole, LONGEST_U)
            _longest(s, ALONG_V, not whole, LONGEST_V)
        for lane in range(LANES):
            s[TURN_T * LANES + lane], s[(TURN_T + 1) * LANES + lane] = 1.0, 0.0
            s[TURN_B * LANES + lane], s[(TURN_B + 1) * LANES + lane] = s[COSINE * LANES + lane], s[SINE * LANES + lane]
        for k in range(12):
            _turn(s, ALONG_U + k, FACTORS_U[k])
            _turn(s, ALONG_V + k, FACTORS_V[k])
        _cone(s, ALONG_U, TURN_T, STEEP_T)
        _cone(s, ALONG_V, TURN_B, STEEP_B)
        if not whole:
            _spread(s, ALONG_U, TURN_T, SPREAD_T)
            _spread(s, ALONG_V, TURN_B, SPREAD_B)
        _combine(s)
        if kind == NPATCH:
            _multiply(s)
            _cone_n(s)
            _finish_npatch(s)
        for lane in range(LANES):
            unknown = gregory_id[min(first + lane, n - 1)] >= 0
            x = s[(MOST_X if kind == TPATCH_TIGHT else SIN) * LANES + lane]
            y = s[(MOST_Y if kind == TPATCH_TIGHT else SIN) * LANES + lane]
            out[0, first + lane], out[1, first + lane] = 1.0 if unknown else x, 1.0 if unknown else y
            cosine = -1.0 if unknown else s[COS * LANES + lane]
            out[2, first + lane] = out[3, first + lane] = cosine
    return some_todo


def bound_normals(stage: HullInput, boxes: F64, kind: int) -> F64:
    """Bounds of the normals of all patches over their domains, as `oriented.bound_oriented` takes them.

    boxes : of `fit.fit_boxes`. kind : TPATCH, TPATCH_TIGHT or NPATCH.
    """
    patches = stage.patches
    n = len(patches.control_points)
    out, todo = np.empty((4, boxes.shape[1])), np.zeros(n, np.bool_)
    if _bound_normals(
        patches.control_points.reshape(n, 64), patches.rational, patches.tangent_id, patches.gregory_id,
        patches.tangent_u, patches.tangent_v, stage.domain, boxes, kind, scratch(ROWS), todo, out,
    ):  # fmt: skip
        scalar_normals.bound_normals(stage, np.flatnonzero(todo), boxes, kind == NPATCH, kind == TPATCH_TIGHT, out)
    widen_normals(stage, out)
    return out
