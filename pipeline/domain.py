"""Domain shader: (u, v) on a bicubic patch to a displaced position in clip space and a unit normal.

The arithmetic is float32 throughout, in an order that is part of the contract (the bounds' error terms count its
roundings, and the slow twin repeats it):

- position: sum over i (along u) for each row j, then over j, by `bezier.sum4`;
- tangents from *differences* of control points, so that they keep their relative accuracy next to collapsed edges; the
  constant factor 3 is left out where only directions are used;
- rational patches: X = (wx, wy, wz) and w are interpolated and divided; a tangent is (dX - dw x) / w, where x is the point
  and d the interpolated differences. So both sides of a shared edge agree here too;
- ACC patches: position as above, tangents from the two tangent patches (`types.Patches`), not divided by 3;
- Gregory patches: as above with the inner control points that (u, v) gives, and the derivatives of these (gregory.py);
- unit normal n of du x dv; where that vanishes (collapsed edges) the normal of a point moved 2^-9 of the way to the
  patch's middle, which is the limit to that accuracy; zero if that vanishes too;
- patches that share their edges' normals (`normal_id`): on an edge n is the edge's (edge_normals.py), but where they are
  displaced by vectors; where it is zero, displaced points are not moved, and others keep the patch's own;
- texture seams that are closed (`seam_id`): on an edge t, or the vector, is that of the edge's lowest patch (seams.py);
- displaced position d = p + t n, or p + L (x, y, z) for a map of vectors, L its `turn`, a row of it summed as
  (L0 x + L1 y) + L2 z; then each clip component ((m0 x + m1 y) + m2 z) + m3;
- the normal handed to the pixel shader is that of the displaced surface to first order in its slope (Blinn 1978):
  p_u x p_v + t_v (p_u x n) + t_u (n x p_v), made unit; n itself where there is no map. Displaced by vectors: d_u x d_v, d_u =
  p_u + the derivative of the vector, a component after the other.

Points are shaded in blocks of up to ROW, in passes over rows of one scratch array. All rows lie in one array at constant
distances, so LLVM sees without run-time checks that no store meets a later load, and vectorizes every pass but the
texture fetch.
"""

import math

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
)
from pipeline.displacement import fetch, gradient, texel_coordinates
from pipeline.edge_normals import SPACE, write_edge_normals
from pipeline.gregory import gregory_u, gregory_v, gregory_value, inner_net, inverse_weights
from pipeline.jit import helper, inlined, kernel
from pipeline.seams import write_seam_values

ROW = 256  # points in a block: all rows together stay in the first-level cache

U, V, PX, PY, PZ, AX, AY, AZ, BX, BY, BZ, T, S, NX, NY, NZ, CX, CY, CZ, CW, GX, GY, GV = (k * ROW for k in range(23))
SCRATCH = 23 * ROW  # float32 entries that the caller provides

ONE = np.float32(1.0)
THREE = np.float32(3.0)
TINY = np.float32(2.0**-100)  # squared length of du x dv below which float32 may have lost it to underflow
HUGE = np.float32(2.0**100)
NUDGE = 2.0**-9


@inlined
def _polynomial_pass(p, u, v, value, du, dv):
    """One coordinate of a polynomial patch, its net p, at the points (u, v): value and both differences; rows of n."""
    _net_pass(p, differences_u(p), differences_v(p), u, v, value, du, dv)


@inlined
def _net_pass(p, steps_u, steps_v, u, v, value, du, dv):
    """One coordinate: value of the 4 x 4 net p, and of the nets of tangents, 3 x 4 along u and 4 x 3 along v."""
    for k in range(len(u)):
        value[k] = eval_44(p, cubic(u[k], ONE), cubic(v[k], ONE))
    for k in range(len(u)):
        du[k] = eval_34(steps_u, quadratic(u[k], ONE), cubic(v[k], ONE))
    for k in range(len(u)):
        dv[k] = eval_43(steps_v, cubic(u[k], ONE), quadratic(v[k], ONE))


@helper
def _rational_u(p, w, value, qu, bv):
    """One coordinate of a rational patch's tangent along u, times w / 3; p, w: its net and the weights', value: the point."""
    return eval_34(differences_u(p), qu, bv) - eval_34(differences_u(w), qu, bv) * value


@helper
def _rational_v(p, w, value, bu, qv):
    """As `_rational_u`, along v."""
    return eval_43(differences_v(p), bu, qv) - eval_43(differences_v(w), bu, qv) * value


@inlined
def _rational_pass(p, w, u, v, value, du, dv):
    """As `_polynomial_pass` for a rational patch; w: the net of its weights."""
    for k in range(len(u)):
        bu, bv = cubic(u[k], ONE), cubic(v[k], ONE)
        value[k] = eval_44(p, bu, bv) / eval_44(w, bu, bv)
    for k in range(len(u)):
        bu, bv = cubic(u[k], ONE), cubic(v[k], ONE)
        du[k] = _rational_u(p, w, value[k], quadratic(u[k], ONE), bv) / eval_44(w, bu, bv)
    for k in range(len(u)):
        bu, bv = cubic(u[k], ONE), cubic(v[k], ONE)
        dv[k] = _rational_v(p, w, value[k], bu, quadratic(v[k], ONE)) / eval_44(w, bu, bv)


@helper
def _weights_pass(u, v, d0, d1, d2, d3):
    """`inverse_weights` of a Gregory patch, the same for its three coordinates."""
    for k in range(len(u)):
        d0[k], d1[k], d2[k], d3[k] = inverse_weights(u[k], v[k], ONE)


@inlined
def _gregory_pass(p, f, d, u, v, value, du, dv):
    """As `_polynomial_pass` for a Gregory patch; f: the pairs of its inner points, d: rows of `_weights_pass`."""
    d0, d1, d2, d3 = d
    for k in range(len(u)):
        value[k] = gregory_value(p, f, (d0[k], d1[k], d2[k], d3[k]), u[k], v[k], ONE)
    for k in range(len(u)):
        du[k] = gregory_u(p, f, (d0[k], d1[k], d2[k], d3[k]), u[k], v[k], ONE)
    for k in range(len(u)):
        dv[k] = gregory_v(p, f, (d0[k], d1[k], d2[k], d3[k]), u[k], v[k], ONE)


@helper
def _row(s, first, n):
    return s[first : first + n]


@helper
def _normal_pass(s, n):
    """Rows N = unit of A x B; row S = 1 where the squared length was safe, 0 where `_mend_normals` must look again."""
    for k in range(n):
        ax, ay, az = s[AX + k], s[AY + k], s[AZ + k]
        bx, by, bz = s[BX + k], s[BY + k], s[BZ + k]
        x = ay * bz - az * by
        y = az * bx - ax * bz
        z = ax * by - ay * bx
        square = (x * x + y * y) + z * z
        length = np.sqrt(square)
        s[NX + k] = x / length
        s[NY + k] = y / length
        s[NZ + k] = z / length
        s[S + k] = ONE if (square > TINY and square < HUGE) else np.float32(0.0)


@helper
def _scaled_unit(x, y, z):
    """Unit vector in float64 however small or large the input; zero for the zero vector and for non-finite ones."""
    m = max(abs(x), abs(y), abs(z))
    if not (m > 0.0 and m < np.inf):
        return 0.0, 0.0, 0.0
    x, y, z = x / m, y / m, z / m
    length = math.sqrt((x * x + y * y) + z * z)
    return x / length, y / length, z / length


@helper
def _derivatives_at(cp, rational, u, v):
    """Directions of both derivatives in float64 arithmetic on the float32 control points of a Bezier patch."""
    bu, bv = cubic(u, 1.0), cubic(v, 1.0)
    qu, qv = quadratic(u, 1.0), quadratic(v, 1.0)
    x, y, z, w = net(cp, 0), net(cp, 1), net(cp, 2), net(cp, 3)
    if rational:
        weight = eval_44(w, bu, bv)
        px, py, pz = eval_44(x, bu, bv) / weight, eval_44(y, bu, bv) / weight, eval_44(z, bu, bv) / weight
        ax, bx = _rational_u(x, w, px, qu, bv), _rational_v(x, w, px, bu, qv)
        ay, by = _rational_u(y, w, py, qu, bv), _rational_v(y, w, py, bu, qv)
        az, bz = _rational_u(z, w, pz, qu, bv), _rational_v(z, w, pz, bu, qv)
    else:
        ax, bx = eval_34(differences_u(x), qu, bv), eval_43(differences_v(x), bu, qv)
        ay, by = eval_34(differences_u(y), qu, bv), eval_43(differences_v(y), bu, qv)
        az, bz = eval_34(differences_u(z), qu, bv), eval_43(differences_v(z), bu, qv)
    return (ax, ay, az), (bx, by, bz)


@helper
def _tangents_at(tu, tv, u, v):
    """As `_derivatives_at`, of an ACC patch's tangent patches."""
    bu, bv, qu, qv = cubic(u, 1.0), cubic(v, 1.0), quadratic(u, 1.0), quadratic(v, 1.0)
    a = eval_34(net_34(tu, 0), qu, bv), eval_34(net_34(tu, 1), qu, bv), eval_34(net_34(tu, 2), qu, bv)
    b = eval_43(net_43(tv, 0), bu, qv), eval_43(net_43(tv, 1), bu, qv), eval_43(net_43(tv, 2), bu, qv)
    return a, b


@helper
def _gregory_at(cp, f, u, v):
    """As `_derivatives_at`, of a Gregory patch."""
    x, y, z, fx, fy, fz = net(cp, 0), net(cp, 1), net(cp, 2), inner_net(f, 0), inner_net(f, 1), inner_net(f, 2)
    d = inverse_weights(u, v, 1.0)
    a = gregory_u(x, fx, d, u, v, 1.0), gregory_u(y, fy, d, u, v, 1.0), gregory_u(z, fz, d, u, v, 1.0)
    b = gregory_v(x, fx, d, u, v, 1.0), gregory_v(y, fy, d, u, v, 1.0), gregory_v(z, fz, d, u, v, 1.0)
    return a, b


@helper
def _unit_cross(a, b):
    """Unit vector of a x b in float64."""
    ax, ay, az = _scaled_unit(a[0], a[1], a[2])
    bx, by, bz = _scaled_unit(b[0], b[1], b[2])
    return _scaled_unit(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


@helper
def _normal_at(shape, u, v):
    """Unit normal of a patch in float64 arithmetic on its float32 control points; `shape` as in `_shade_surface`."""
    cp, rational, tu, tv, inner = shape
    if len(tu) > 0:
        a, b = _tangents_at(tu[0], tv[0], u, v)
    elif len(inner) > 0:
        a, b = _gregory_at(cp, inner[0], u, v)
    else:
        a, b = _derivatives_at(cp, rational, u, v)
    return _unit_cross(a, b)


@helper
def _mend_bezier_normals(cp, rational, s, n):
    """Normals where du x dv vanishes, or is too small or too large for float32."""
    for k in range(n):
        if s[S + k] == np.float32(0.0):
            u, v = np.float64(s[U + k]), np.float64(s[V + k])
            a, b = _derivatives_at(cp, rational, u, v)
            x, y, z = _unit_cross(a, b)
            if x == 0.0 and y == 0.0 and z == 0.0:
                a, b = _derivatives_at(cp, rational, u + (0.5 - u) * NUDGE, v + (0.5 - v) * NUDGE)
                x, y, z = _unit_cross(a, b)
            s[NX + k], s[NY + k], s[NZ + k] = np.float32(x), np.float32(y), np.float32(z)


@helper
def _mend_normals(shape, s, n):
    """As `_mend_bezier_normals`, of any patch."""
    for k in range(n):
        if s[S + k] == np.float32(0.0):
            u, v = np.float64(s[U + k]), np.float64(s[V + k])
            x, y, z = _normal_at(shape, u, v)
            if x == 0.0 and y == 0.0 and z == 0.0:
                x, y, z = _normal_at(shape, u + (0.5 - u) * NUDGE, v + (0.5 - v) * NUDGE)
            s[NX + k], s[NY + k], s[NZ + k] = np.float32(x), np.float32(y), np.float32(z)


@helper
def _displacement_pass(texcoords, maps, m, s, n):
    """Row T: the filtered displacement of map m; rows S and CX: its derivatives along u and v."""
    u, v, t = _row(s, U, n), _row(s, V, n), _row(s, T, n)
    x, y, gx, gy = _row(s, S, n), _row(s, CX, n), _row(s, GX, n), _row(s, GY, n)
    texel_coordinates(texcoords, maps, m, u, v, x, y)
    for k in range(n):
        t[k], gx[k], gy[k] = fetch(maps, m, x[k], y[k])
    scale, bias = maps.scale[m], maps.bias[m]
    for k in range(n):
        t[k] = scale * t[k] + bias
    gradient(texcoords, np.float32(maps.size[m, 0]), np.float32(maps.size[m, 1]), scale, u, v, gx, gy, x, y)


@helper
def _bump_pass(scale, s, n):
    """Rows A: unit normal of the displaced surface, from N, S, CX and tangents A, B; derivatives are `scale` times these."""
    for k in range(n):
        ax, ay, az = s[AX + k], s[AY + k], s[AZ + k]
        bx, by, bz = s[BX + k], s[BY + k], s[BZ + k]
        nx, ny, nz = s[NX + k], s[NY + k], s[NZ + k]
        along_u, along_v = s[S + k], s[CX + k]
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        x = scale * cx + (along_v * (ay * nz - az * ny) + along_u * (ny * bz - nz * by))
        y = scale * cy + (along_v * (az * nx - ax * nz) + along_u * (nz * bx - nx * bz))
        z = scale * cz + (along_v * (ax * ny - ay * nx) + along_u * (nx * by - ny * bx))
        square = (x * x + y * y) + z * z
        safe = (cx * cx + cy * cy) + cz * cz > TINY and square > TINY and square < HUGE
        length = np.sqrt(square)
        s[AX + k] = x / length if safe else nx
        s[AY + k] = y / length if safe else ny
        s[AZ + k] = z / length if safe else nz


@helper
def _vector_pass(factor, texcoords, seams, maps, m, s, n):
    """Rows P: displaced by the vectors of map m; rows A: unit normal of that surface. Derivatives are `factor` A and B.

    seams : of one or no seam_edges and seam_corners.
    """
    u, v, x, y = _row(s, U, n), _row(s, V, n), _row(s, S, n), _row(s, T, n)
    gx, gy, gu, gv = _row(s, GX, n), _row(s, GY, n), _row(s, CW, n), _row(s, GV, n)
    turn, planes = maps.turn[m], maps.planes[m]
    width, height = np.float32(maps.size[planes[0], 0]), np.float32(maps.size[planes[0], 1])
    texel_coordinates(texcoords, maps, planes[0], u, v, x, y)
    for r in range(6):
        a = _row(s, AX + r * ROW, n)
        for k in range(n):
            a[k] = factor * a[k]
    for c in range(3):
        plane, value = planes[c], _row(s, CX + c * ROW, n)
        scale, bias = maps.scale[plane], maps.bias[plane]
        for k in range(n):
            value[k], gx[k], gy[k] = fetch(maps, plane, x[k], y[k])
        for k in range(n):
            value[k] = scale * value[k] + bias
        if len(seams[0]) > 0:
            write_seam_values(seams[0][0], seams[1][0], maps, plane, u, v, value)
        gradient(texcoords, width, height, scale, u, v, gx, gy, gu, gv)
        for r in range(3):
            along = turn[r, c]
            for k in range(n):
                s[AX + r * ROW + k] += along * s[CW + k]
                s[BX + r * ROW + k] += along * s[GV + k]
    for r in range(3):
        t0, t1, t2 = turn[r, 0], turn[r, 1], turn[r, 2]
        for k in range(n):
            s[PX + r * ROW + k] += (t0 * s[CX + k] + t1 * s[CY + k]) + t2 * s[CZ + k]
    for k in range(n):
        ax, ay, az = s[AX + k], s[AY + k], s[AZ + k]
        bx, by, bz = s[BX + k], s[BY + k], s[BZ + k]
        x0, x1, x2 = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        square = (x0 * x0 + x1 * x1) + x2 * x2
        safe = square > TINY and square < HUGE
        length = np.sqrt(square)
        s[AX + k] = x0 / length if safe else s[NX + k]
        s[AY + k] = x1 / length if safe else s[NY + k]
        s[AZ + k] = x2 / length if safe else s[NZ + k]


@helper
def _transform_pass(matrix, displaced, s, n):
    """Rows C: clip position of p + t n (of p where the patch has no map: adding 0 n would turn NaN normals into cracks)."""
    if displaced:
        for k in range(n):
            s[PX + k] = s[PX + k] + s[T + k] * s[NX + k]
            s[PY + k] = s[PY + k] + s[T + k] * s[NY + k]
            s[PZ + k] = s[PZ + k] + s[T + k] * s[NZ + k]
    for r in range(4):
        m0, m1, m2, m3 = matrix[r, 0], matrix[r, 1], matrix[r, 2], matrix[r, 3]
        for k in range(n):
            s[CX + r * ROW + k] = ((m0 * s[PX + k] + m1 * s[PY + k]) + m2 * s[PZ + k]) + m3


@inlined
def _bezier_passes(cp, rational, s, n):
    """Rows P, A and B: point and thirds of the derivatives of a Bezier patch at the n points in rows U and V."""
    u, v = _row(s, U, n), _row(s, V, n)
    for c in range(3):
        value, du, dv = _row(s, PX + c * ROW, n), _row(s, AX + c * ROW, n), _row(s, BX + c * ROW, n)
        if rational:
            _rational_pass(net(cp, c), net(cp, 3), u, v, value, du, dv)
        else:
            _polynomial_pass(net(cp, c), u, v, value, du, dv)


@inlined
def _acc_passes(cp, tu, tv, s, n):
    """As `_bezier_passes` for an ACC patch; its tangents whole."""
    u, v = _row(s, U, n), _row(s, V, n)
    for c in range(3):
        value, du, dv = _row(s, PX + c * ROW, n), _row(s, AX + c * ROW, n), _row(s, BX + c * ROW, n)
        _net_pass(net(cp, c), net_34(tu, c), net_43(tv, c), u, v, value, du, dv)


@inlined
def _gregory_passes(cp, inner, s, n):
    """As `_bezier_passes` for a Gregory patch."""
    u, v = _row(s, U, n), _row(s, V, n)
    d0, d1, d2, d3 = _row(s, CX, n), _row(s, CY, n), _row(s, CZ, n), _row(s, CW, n)
    _weights_pass(u, v, d0, d1, d2, d3)
    for c in range(3):
        value, du, dv = _row(s, PX + c * ROW, n), _row(s, AX + c * ROW, n), _row(s, BX + c * ROW, n)
        _gregory_pass(net(cp, c), inner_net(inner, c), (d0, d1, d2, d3), u, v, value, du, dv)


@helper
def _shade_bezier(cp, rational, texcoords, map_id, maps, matrix, s, n):
    """Shade the n points of a Bezier patch in rows U and V of scratch s."""
    _bezier_passes(cp, rational, s, n)
    _normal_pass(s, n)
    _mend_bezier_normals(cp, rational, s, n)
    if map_id >= 0:
        _displacement_pass(texcoords, maps, map_id, s, n)
        _bump_pass(THREE, s, n)
    _transform_pass(matrix, map_id >= 0, s, n)


@helper
def _shade_surface(shape, edges, texcoords, map_id, maps, matrix, s, n):
    """As `_shade_bezier`, for any patch.

    shape : control points, rational, and arrays of one or no tangent_u, tangent_v and inner. edges : of one or no edge_row
    and corner_row, edge_normals and corner_normals, and of one or no seam_edges and seam_corners.
    """
    cp, rational, tu, tv, inner = shape
    if len(tu) > 0:
        _acc_passes(cp, tu[0], tv[0], s, n)
    elif len(inner) > 0:
        _gregory_passes(cp, inner[0], s, n)
    else:
        _bezier_passes(cp, rational, s, n)
    _normal_pass(s, n)
    _mend_normals(shape, s, n)
    factor = ONE if len(tu) > 0 else THREE
    by_vectors = map_id >= 0 and maps.planes[map_id, 0] >= 0
    if by_vectors:
        _vector_pass(factor, texcoords, (edges[4], edges[5]), maps, map_id, s, n)
    elif len(edges[0]) > 0:
        write_edge_normals(
            edges[0][0], edges[1][0], edges[2], edges[3], map_id < 0, _row(s, U, n), _row(s, V, n), _row(s, NX, n),
            _row(s, NY, n), _row(s, NZ, n), _row(s, CX, SPACE),
        )  # fmt: skip
    if map_id >= 0 and not by_vectors:
        _displacement_pass(texcoords, maps, map_id, s, n)
        if len(edges[4]) > 0:
            write_seam_values(edges[4][0], edges[5][0], maps, map_id, _row(s, U, n), _row(s, V, n), _row(s, T, n))
        _bump_pass(factor, s, n)
    _transform_pass(matrix, map_id >= 0 and not by_vectors, s, n)


@helper
def _one(table, row):
    """The row as an array of one; of none for row -1."""
    return table[row : row + 1]


@helper
def _shape_of(patches, p):
    """What `_shade_surface` must know of the form of patch p, and of its edges."""
    tangents, shared = patches.tangent_id[p], patches.normal_id[p]
    shape = (
        patches.control_points[p], patches.rational[p], _one(patches.tangent_u, tangents),
        _one(patches.tangent_v, tangents), _one(patches.inner, patches.gregory_id[p]),
    )  # fmt: skip
    edges = (
        _one(patches.edge_row, shared), _one(patches.corner_row, shared), patches.edge_normals, patches.corner_normals,
        _one(patches.seam_edges, patches.seam_id[p]), _one(patches.seam_corners, patches.seam_id[p]),
    )  # fmt: skip
    return shape, edges


@kernel
def shade_patches(begin, end, live, patches, patterns, maps, matrix, points, scratch):
    """Shade every domain point of live patches begin .. end-1 into `points` (modified in place).

    live : int32[...], patch numbers in submit order. patches : world space. matrix : float32[4, 4], world to clip.
    scratch : float32[SCRATCH], the caller's, one for each thread.
    """
    for k in range(begin, end):
        p = live[k]
        pattern = patterns.of_patch[p]
        source = patterns.first_point[pattern]
        count = patterns.first_point[pattern + 1] - source
        target = points.first[k]
        cp, texcoords, map_id = patches.control_points[p], patches.texcoords[p], patches.map_id[p]
        plain = (
            patches.tangent_id[p] < 0
            and patches.gregory_id[p] < 0
            and patches.normal_id[p] < 0
            and (map_id < 0 or (patches.seam_id[p] < 0 and maps.planes[map_id, 0] < 0))
        )
        for block in range(0, count, ROW):
            n = min(ROW, count - block)
            for i in range(n):
                scratch[U + i] = patterns.uv[0, source + block + i]
                scratch[V + i] = patterns.uv[1, source + block + i]
            if plain:
                _shade_bezier(cp, patches.rational[p], texcoords, map_id, maps, matrix, scratch, n)
            else:
                shape, edges = _shape_of(patches, p)
                _shade_surface(shape, edges, texcoords, map_id, maps, matrix, scratch, n)
            first = target + block
            normal_row = AX if map_id >= 0 else NX
            for c in range(4):
                for i in range(n):
                    points.clip[c, first + i] = scratch[CX + c * ROW + i]
            for c in range(3):
                for i in range(n):
                    points.normal[c, first + i] = scratch[normal_row + c * ROW + i]
