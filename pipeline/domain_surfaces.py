"""Passes over rows: point, tangents and unit normal of a patch at the points (u, v) of a block.

Tangents are thirds of the derivatives, but for ACC patches, whose tangents are whole. Where a value is a sum over i (along u)
and then over j, the inner sums depend on u alone. Patterns that come in rows of v have the same u's again and again, and
for these the inner sums are tabulated once a patch: the same roundings in the same order, a fifth of the arithmetic.
"""

import numpy as np

from pipeline.bezier import (
    cubic,
    differences_u,
    differences_v,
    eval_34,
    eval_43,
    eval_44,
    net,
    net_34,
    net_43,
    quadratic,
    sum3,
    sum4,
)
from pipeline.domain_rows import (
    AX,
    AY,
    AZ,
    BX,
    BY,
    BZ,
    HUGE,
    LANES,
    MOST_COLUMNS,
    NX,
    NY,
    NZ,
    ONE,
    POSITIVE,
    PX,
    PY,
    PZ,
    TABLE,
    TABLE_ROW,
    TABLE_U,
    TINY,
    ZERO,
    S,
    U,
    V,
    filled,
)
from pipeline.gregory import gregory_u, gregory_v, gregory_value, inner_net, inverse_weights
from pipeline.jit import helper, inlined


@helper
def rational_u(p, w, value, qu, bv):
    """One coordinate of a rational patch's tangent along u, times w / 3; p, w: its net and the weights', value: the point."""
    return eval_34(differences_u(p), qu, bv) - eval_34(differences_u(w), qu, bv) * value


@helper
def rational_v(p, w, value, bu, qv):
    """As `rational_u`, along v."""
    return eval_43(differences_v(p), bu, qv) - eval_43(differences_v(w), bu, qv) * value


@inlined
def _put(s, k, x, y, z):
    """Write what is known of point k. x, y, z: each coordinate of the point, the tangent along u, and that along v.

    The normal is the unit of their cross product; S is 1 where its squared length was safe, 0 where it must be mended.
    """
    px, ax, bx = x
    py, ay, by = y
    pz, az, bz = z
    s[PX + k], s[PY + k], s[PZ + k] = px, py, pz
    s[AX + k], s[AY + k], s[AZ + k] = ax, ay, az
    s[BX + k], s[BY + k], s[BZ + k] = bx, by, bz
    nx = ay * bz - az * by
    ny = az * bx - ax * bz
    nz = ax * by - ay * bx
    square = (nx * nx + ny * ny) + nz * nz
    length = np.sqrt(square)
    s[NX + k], s[NY + k], s[NZ + k] = nx / length, ny / length, nz / length
    s[S + k] = ONE if (square > TINY) & (square < HUGE) else ZERO


@inlined
def _polynomial_at(nets, basis):
    """One coordinate. nets: 4 x 4 of the point, 3 x 4 and 4 x 3 of the tangents. basis: cubic and quadratic, of u and of v."""
    p, along_u, along_v = nets
    bu, qu, bv, qv = basis
    return eval_44(p, bu, bv), eval_34(along_u, qu, bv), eval_43(along_v, bu, qv)


@inlined
def polynomial_pass(nets, s, begin, n):
    """The points begin .. begin + n - 1. nets: of each coordinate, as `_polynomial_at` has them."""
    begin = begin & POSITIVE
    for i in range(n):
        k = begin + i
        u, v = s[U + k], s[V + k]
        basis = cubic(u, ONE), quadratic(u, ONE), cubic(v, ONE), quadratic(v, ONE)
        _put(s, k, _polynomial_at(nets[0], basis), _polynomial_at(nets[1], basis), _polynomial_at(nets[2], basis))


@inlined
def _put_sums(nets, bu, qu, s, at):
    """One coordinate's sums over i, four, four and three, in a column of the table; s[at] is its first entry."""
    p, along_u, along_v = nets
    s[at], s[at + TABLE_ROW] = sum4(bu, p[0]), sum4(bu, p[1])
    s[at + 2 * TABLE_ROW], s[at + 3 * TABLE_ROW] = sum4(bu, p[2]), sum4(bu, p[3])
    s[at + 4 * TABLE_ROW], s[at + 5 * TABLE_ROW] = sum3(qu, along_u[0]), sum3(qu, along_u[1])
    s[at + 6 * TABLE_ROW], s[at + 7 * TABLE_ROW] = sum3(qu, along_u[2]), sum3(qu, along_u[3])
    s[at + 8 * TABLE_ROW], s[at + 9 * TABLE_ROW] = sum4(bu, along_v[0]), sum4(bu, along_v[1])
    s[at + 10 * TABLE_ROW] = sum4(bu, along_v[2])


@inlined
def tabulate(nets, s, columns):
    """Fill the table: the inner sums of `polynomial_pass` for each u of row TABLE_U."""
    for i in range(columns):
        u = s[TABLE_U + i]
        bu, qu = cubic(u, ONE), quadratic(u, ONE)
        _put_sums(nets[0], bu, qu, s, TABLE + i)
        _put_sums(nets[1], bu, qu, s, TABLE + 11 * TABLE_ROW + i)
        _put_sums(nets[2], bu, qu, s, TABLE + 22 * TABLE_ROW + i)


@inlined
def _sum_table(s, at, bv, qv):
    """One coordinate from its sums over i; s[at] is the first of them."""
    p = (s[at], s[at + TABLE_ROW], s[at + 2 * TABLE_ROW], s[at + 3 * TABLE_ROW])
    along_u = (s[at + 4 * TABLE_ROW], s[at + 5 * TABLE_ROW], s[at + 6 * TABLE_ROW], s[at + 7 * TABLE_ROW])
    along_v = (s[at + 8 * TABLE_ROW], s[at + 9 * TABLE_ROW], s[at + 10 * TABLE_ROW])
    return sum4(bv, p), sum4(bv, along_u), sum3(qv, along_v)


@inlined
def table_pass(s, first, period, n):
    """As `polynomial_pass` for points 0 .. n-1 (and up to a full vector), from the table.

    first : number of point 0 in its pattern, where u repeats after `period` points.
    """
    i = first % period
    step = LANES % period
    for block in range(0, n, LANES):
        for lane in range(LANES):
            k, at = (block & POSITIVE) + lane, TABLE + (i & POSITIVE) + lane
            v = s[V + k]
            bv, qv = cubic(v, ONE), quadratic(v, ONE)
            x = _sum_table(s, at, bv, qv)
            y = _sum_table(s, at + 11 * TABLE_ROW, bv, qv)
            z = _sum_table(s, at + 22 * TABLE_ROW, bv, qv)
            _put(s, k, x, y, z)
        i += step
        i = i - period if i >= period else i


@inlined
def _rational_at(p, w, weight, basis):
    """As `_polynomial_at`. p, w: the nets of the coordinate and of the weights; weight: the sum over the latter."""
    bu, qu, bv, qv = basis
    value = eval_44(p, bu, bv) / weight
    return value, rational_u(p, w, value, qu, bv) / weight, rational_v(p, w, value, bu, qv) / weight


@inlined
def _rational_pass(x, y, z, w, s, n):
    """As `polynomial_pass` for a rational patch: nets of its coordinates and weights."""
    for k in range(n):
        u, v = s[U + k], s[V + k]
        basis = cubic(u, ONE), quadratic(u, ONE), cubic(v, ONE), quadratic(v, ONE)
        weight = eval_44(w, basis[0], basis[2])
        _put(
            s,
            k,
            _rational_at(x, w, weight, basis),
            _rational_at(y, w, weight, basis),
            _rational_at(z, w, weight, basis),
        )


@inlined
def _gregory_at(p, f, d, u, v):
    return gregory_value(p, f, d, u, v, ONE), gregory_u(p, f, d, u, v, ONE), gregory_v(p, f, d, u, v, ONE)


@inlined
def _gregory_pass(x, y, z, s, n):
    """As `polynomial_pass` for a Gregory patch; of each coordinate the net and the pairs of its inner points."""
    for k in range(n):
        u, v = s[U + k], s[V + k]
        d = inverse_weights(u, v, ONE)
        _put(
            s, k, _gregory_at(x[0], x[1], d, u, v), _gregory_at(y[0], y[1], d, u, v), _gregory_at(z[0], z[1], d, u, v)
        )  # fmt: skip


@inlined
def _bezier_nets(cp, c):
    """Coordinate c of a polynomial patch."""
    p = net(cp, c)
    return p, differences_u(p), differences_v(p)


@inlined
def _acc_nets(cp, tu, tv, c):
    """Coordinate c of an ACC patch."""
    return net(cp, c), net_34(tu, c), net_43(tv, c)


@helper
def _nets_passes(nets, grid, first, s, n):
    """The n points of a patch without quotients; see `bezier_passes`."""
    begin, period, covered = grid
    place = first - begin  # in the rows
    m = max(min(covered - place, n), 0) if period > 0 and place >= 0 else 0
    if m > 0:
        if place == 0:
            tabulate(nets, s, filled(period + LANES - 1))
        table_pass(s, place, period, m)
    if m < n:
        polynomial_pass(nets, s, m, filled(n - m))


@inlined
def bezier_passes(cp, rational, grid, first, s, n):
    """Rows P, A, B, N and S: the n points of a Bezier patch in rows U and V; n is a multiple of LANES.

    first : number of the first of them in the pattern. grid : as `find_grid` says. The table is made where the rows begin,
    which is where a block begins, and stays for the blocks that follow.
    """
    if rational:
        _rational_pass(net(cp, 0), net(cp, 1), net(cp, 2), net(cp, 3), s, n)
    else:
        _nets_passes((_bezier_nets(cp, 0), _bezier_nets(cp, 1), _bezier_nets(cp, 2)), grid, first, s, n)


@inlined
def acc_passes(cp, tu, tv, grid, first, s, n):
    """As `bezier_passes` for an ACC patch."""
    _nets_passes((_acc_nets(cp, tu, tv, 0), _acc_nets(cp, tu, tv, 1), _acc_nets(cp, tu, tv, 2)), grid, first, s, n)


@inlined
def gregory_passes(cp, inner, s, n):
    """As `bezier_passes` for a Gregory patch."""
    x, y, z = (net(cp, 0), inner_net(inner, 0)), (net(cp, 1), inner_net(inner, 1)), (net(cp, 2), inner_net(inner, 2))
    _gregory_pass(x, y, z, s, n)


LEAST_COVERED = 400  # points in rows: with fewer, a table and a block more for the border cost more than they save


@inlined
def _on_border(u, v):
    return u in (ZERO, ONE) or v in (ZERO, ONE)


@helper
def find_grid(u, v, s):
    """Where a pattern's points begin to come in rows, the period of their u's, and how many keep to it; 0, 0, 0 where no
    table would pay.

    Points on the border, which come first, may lie anywhere. Fills row TABLE_U with the u's of a period, and on for as many
    points as a vector may begin before its end.
    """
    n, begin = len(u), 0
    while begin < n and _on_border(u[begin], v[begin]):
        begin += 1
    end = begin + 1
    while end < n and u[end] != u[begin]:
        end += 1
    period = end - begin
    while end < n and u[end] == u[end - period]:
        end += 1
    if period > MOST_COLUMNS or period < 4 or end - begin < LEAST_COVERED:
        return 0, 0, 0
    for i in range(filled(period + LANES - 1)):
        s[TABLE_U + i] = u[begin + i % period]
    return begin, period, end - begin
