"""Boxes that hold every tangent, and every chord, of a displaced patch over a part of it.

The displaced surface is d = p + t n, n the unit of N = p_u x p_v. Wherever the filtered displacement t has derivatives,

    d_u = p_u + t_u n + t n_u,    n_u = (N_u - n (n . N_u)) / |N|,

and the same along v. t is continuous and piecewise smooth (a blend of texels), so a chord of d along u, divided by its
length in u, is a mean of d_u: it lies in every box that holds d_u. Creases at texel borders therefore do not matter, and
a box of d_u is a box of chords as well.

- p_u: hull of 12 differences of control points over the part. t, t_u, t_v: from the min-max and slope pyramids over the
  part's filter footprint, with (s, t) bilinear in (u, v).
- n: a positive combination of the 36 unit control vectors of N. Such a sum is not longer than its vectors' hull, and not
  shorter than the cosine of the cone about them, so n lies in that hull times [1, 1 / cos].
- N_u, N_v: hulls of 30 differences of control vectors each; |N| between the least height and the greatest length.

The boxes have axes of their own: those that map the middle of the d_u, of the d_v and of the way from the eye to unit
vectors (`Boxes`). det[q, a, b] of a way from the eye q and chords a, b is then near 1 times that of the middles.

Rounding, float64: everything is formed about the patch's first control point, and widened by 1e-14 (ERROR) of magnitudes.
Any map to boxes is as good as the next, so its own rounding needs no room.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.bounds.restrict import domain_displacement, restrict_net, texcoord_rect
from pipeline.culling.cones import MAX_VECTORS, normal_vectors
from pipeline.culling.intervals import add, mul, scale, square, sub
from pipeline.jit import helper
from pipeline.slopes import slope_range
from pipeline.types import F64

U = 2.0**-24
ERROR = 1e-14
EDGE_ON = 1e-5  # sine between the surface and the way to the eye from which nothing is told apart
MOST_TEXEL = 2.0**20  # texels from the map's origin; the shader's coordinates get coarse beyond
SHORTEST = 2.0**-60  # control polygons' legs, for which float32 tangents have their relative accuracy
C5 = np.array([1.0, 5.0, 10.0, 10.0, 5.0, 1.0])


class Work(NamedTuple):
    """Scratch of one call of a kernel."""

    net: F64  # (4, 4, 4) the part's control points about the origin
    points: F64  # (16, 3) the same, flat
    normals: F64  # (MAX_VECTORS, 3) control vectors of N over the part, 6 p + q
    units: F64  # (36, 3) of them
    box: F64  # (3, 3, 2) rows q, a, b: (least, greatest) of each coordinate
    middle: F64  # (3, 3) rows q, a, b: what is mapped to the unit vectors


@helper
def make_work():
    """Scratch, not initialized."""
    return Work(
        np.empty((4, 4, 4)), np.empty((16, 3)), np.empty((MAX_VECTORS, 3)), np.empty((36, 3)), np.empty((3, 3, 2)),
        np.empty((3, 3)),
    )  # fmt: skip


@helper
def _length(v):
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@helper
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@helper
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper
def _fill_part(cp, u0, u1, v0, v1, work):
    """Control points of patch cp float32[4, 4, 4], all weights 1, over the part, about its first one."""
    for i in range(4):
        for j in range(4):
            for c in range(3):
                work.net[i, j, c] = np.float64(cp[i, j, c]) - np.float64(cp[0, 0, c])
            work.net[i, j, 3] = 0.0
    restrict_net(work.net, u0, u1, v0, v1)
    for k in range(16):
        for c in range(3):
            work.points[k, c] = work.net[k >> 2, k & 3, c]


@helper
def longest_differences(points):
    """Longest difference of neighbouring control points along u and along v, and the largest distance from the first."""
    a = b = size = 0.0
    for k in range(16):
        p = points[k]
        x, y, z = p[0] - points[0, 0], p[1] - points[0, 1], p[2] - points[0, 2]
        size = max(size, math.sqrt(x * x + y * y + z * z))
        if k < 12:
            q = points[k + 4]
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            a = max(a, math.sqrt(x * x + y * y + z * z))
        if k & 3 < 3:
            q = points[k + 1]
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            b = max(b, math.sqrt(x * x + y * y + z * z))
    return a, b, size


@helper
def normal_cone(cp, points, work):
    """Control vectors of (p_u x p_v) / 9 of the points, true Bernstein coefficients, and their units.

    Returns (axis, cosine of the half angle, least height, greatest length); cosine -1 where there is no cone, or some
    vector is zero.
    """
    normal_vectors(cp, points, False, work.normals)
    none = (0.0, 0.0, 0.0)
    x = y = z = 0.0
    for k in range(36):
        n = work.normals[k]
        divisor = C5[k // 6] * C5[k % 6]
        n[0], n[1], n[2] = n[0] / divisor, n[1] / divisor, n[2] / divisor
        length = _length(n)
        if not (length > 0.0 and length < np.inf):
            return none, -1.0, 0.0, 0.0
        unit = work.units[k]
        unit[0], unit[1], unit[2] = n[0] / length, n[1] / length, n[2] / length
        x, y, z = x + unit[0], y + unit[1], z + unit[2]
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1.0:
        return none, -1.0, 0.0, 0.0
    axis = (x / length, y / length, z / length)
    cosine, least, greatest = 1.0, np.inf, 0.0
    for k in range(36):
        cosine = min(cosine, _dot(work.units[k], axis))
        least = min(least, _dot(work.normals[k], axis))
        greatest = max(greatest, _length(work.normals[k]))
    return axis, cosine, least, greatest


@helper
def _hull(rows, first, n, direction, low, high):
    """Range of the rows' extents along a direction, from (low, high) outwards."""
    for k in range(first, first + n):
        along = rows[k, 0] * direction[0] + rows[k, 1] * direction[1] + rows[k, 2] * direction[2]
        low, high = min(low, along), max(high, along)
    return low, high


@helper
def _step_hull(points, step, last, factor, direction, pad):
    """Range along a direction of factor (points[k + step] - points[k]), k over the rows that have such a neighbour.

    step : 4 or 1 of a 4 x 4 net, 6 or 1 of a 6 x 6 one; last : 3 or 5.
    """
    side = last + 1
    low, high = np.inf, -np.inf
    for k in range(side * side):
        if (step == 1 and k % side == last) or (step != 1 and k >= side * last):
            continue
        p, q = points[k], points[k + step]
        along = (q[0] - p[0]) * direction[0] + (q[1] - p[1]) * direction[1] + (q[2] - p[2]) * direction[2]
        low, high = min(low, along), max(high, along)
    return factor * low - pad, factor * high + pad


@helper
def _turning(normals, step, axis, unit_box, least, greatest, pad):
    """Intervals along the frame's axes of n_u (step 6) or n_v (1), from those of n."""
    x, y, z = axis
    dx = _step_hull(normals, step, 5, 5.0, x, pad)
    dy = _step_hull(normals, step, 5, 5.0, y, pad)
    dz = _step_hull(normals, step, 5, 5.0, z, pad)
    nx, ny, nz = unit_box
    across = add(mul(nx, dx), mul(ny, dy))
    along = add(across, mul(nz, dz))
    over = (1.0 / greatest, 1.0 / least)
    tx = mul(sub(dx, mul(nx, along)), over)
    ty = mul(sub(dy, mul(ny, along)), over)
    tz = mul(sub(mul(dz, add(square(nx), square(ny))), mul(nz, across)), over)
    return tx, ty, tz


@helper
def _along(direction, axis, vector):
    """Interval of a vector, of intervals along the frame's axes, along a direction."""
    x = scale(_dot(direction, axis[0]), vector[0])
    y = scale(_dot(direction, axis[1]), vector[1])
    return add(add(x, y), scale(_dot(direction, axis[2]), vector[2]))


@helper
def _bilinear_steps(texcoords, c, u0, u1, v0, v1):
    """Ranges of the derivatives along u and v of texture coordinate c over the part, for u, v running from 0 to 1."""
    c00, c10 = np.float64(texcoords[0, c]), np.float64(texcoords[1, c])
    c01, c11 = np.float64(texcoords[2, c]), np.float64(texcoords[3, c])
    a, b = (1.0 - v0) * (c10 - c00) + v0 * (c11 - c01), (1.0 - v1) * (c10 - c00) + v1 * (c11 - c01)
    along_u = (min(a, b) * (u1 - u0), max(a, b) * (u1 - u0))
    a, b = (1.0 - u0) * (c01 - c00) + u0 * (c11 - c10), (1.0 - u1) * (c01 - c00) + u1 * (c11 - c10)
    return along_u, (min(a, b) * (v1 - v0), max(a, b) * (v1 - v0))


@helper
def _wide(a, relative, absolute):
    pad = relative * max(abs(a[0]), abs(a[1])) + absolute
    return a[0] - pad, a[1] + pad


@helper
def displacement_slopes(p, patches, maps, along_s, along_t, u0, u1, v0, v1):
    """Ranges of t_u and t_v over the part, for u, v running from 0 to 1, and what the shader's t may be off by.

    The shader's texture coordinates are off by up to 8 u (|s| N + 1) texels (`minmax`), so by that times the slope.
    The last is NaN where texture coordinates are so large that the shader's are coarse.
    """
    m = patches.map_id[p]
    if m < 0:
        return (0.0, 0.0), (0.0, 0.0), 0.0
    texcoords = patches.texcoords[p]
    s0, s1, t0, t1 = texcoord_rect(texcoords, u0, u1, v0, v1)
    width, height = np.float64(maps.size[m, 0]), np.float64(maps.size[m, 1])
    far_s, far_t = max(abs(s0), abs(s1)) * width, max(abs(t0), abs(t1)) * height
    corner = 0.0
    for k in range(4):
        corner = max(corner, abs(texcoords[k, 0]) * width, abs(texcoords[k, 1]) * height)
    if not max(far_s, far_t, corner) < MOST_TEXEL:
        return (0.0, 0.0), (0.0, 0.0), np.nan
    factor = np.float64(maps.scale[m])
    gx = scale(factor, slope_range(maps, along_s, m, 0, s0, s1, t0, t1))
    gy = scale(factor, slope_range(maps, along_t, m, 1, s0, s1, t0, t1))
    off = 8.0 * U * (corner + 1.0) * (max(abs(gx[0]), abs(gx[1])) + max(abs(gy[0]), abs(gy[1])))
    s_u, s_v = _bilinear_steps(texcoords, 0, u0, u1, v0, v1)
    t_u, t_v = _bilinear_steps(texcoords, 1, u0, u1, v0, v1)
    along_u = add(mul(gx, scale(width, s_u)), mul(gy, scale(height, t_u)))
    along_v = add(mul(gx, scale(width, s_v)), mul(gy, scale(height, t_v)))
    return _wide(along_u, 1e-12, 0.0), _wide(along_v, 1e-12, 0.0), off


class Part(NamedTuple):
    """What is known of a part of a patch, beside `work.box`: where `fine` is not set, nothing."""

    fine: bool
    det: float  # of the middles: det[q, a, b] is det times that of the boxes' coordinates, u and v running from 0 to 1
    shift: float  # how far a vertex of the float32 shader may be from the displaced surface, but for the rounding of p
    farthest: float  # largest |t|


@helper
def _nothing():
    return Part(False, 0.0, 0.0, 0.0)


@helper
def _set(box, row, c, a, pad):
    box[row, c, 0], box[row, c, 1] = a[0] - pad, a[1] + pad


@helper
def _first_axis(z):
    """A unit vector across the unit vector z."""
    x = (0.0, z[2], -z[1]) if abs(z[0]) < 0.6 else (-z[2], 0.0, z[0])
    length = _length(x)
    return x[0] / length, x[1] / length, x[2] / length


@helper
def bound_part(p, patches, maps, pyramids, along_s, along_t, eye, eye_error, u0, u1, v0, v1, longest, work):
    """Fill work.box with the boxes of q (the way from the eye to the surface), d_u and d_v over the part.

    longest : of `longest_differences` of the whole patch. Derivatives are those for u, v running from 0 to 1 over the part.
    """
    cp = patches.control_points[p]
    _fill_part(cp, u0, u1, v0, v1, work)
    points = work.points
    z, cosine, least, greatest = normal_cone(cp, points, work)
    long_a, long_b, size = longest
    rounding = 4.0 * ERROR * size * (long_a + long_b)  # of a control vector of N, after restriction
    tame = min(long_a, long_b) > SHORTEST and size < 1.0 / SHORTEST
    if not (tame and cosine > 0.01 and least > 1e6 * rounding):
        return _nothing()
    t0, t1 = domain_displacement(patches.map_id[p], patches.texcoords[p], maps, pyramids, u0, u1, v0, v1, False)
    t_u, t_v, off = displacement_slopes(p, patches, maps, along_s, along_t, u0, u1, v0, v1)
    t = (t0, t1)
    farthest = max(abs(t0), abs(t1))
    if not (t0 <= t1 and farthest + off < np.inf):
        return _nothing()
    # The frame of the normals, and n and its derivatives in it.
    x = _first_axis(z)
    axis = (x, _cross(z, x), z)
    loose = rounding / least
    units = work.units
    cosine -= loose
    nx, ny = _hull(units, 0, 36, axis[0], 0.0, 0.0), _hull(units, 0, 36, axis[1], 0.0, 0.0)
    n = (
        (nx[0] / cosine - loose, nx[1] / cosine + loose), (ny[0] / cosine - loose, ny[1] / cosine + loose),
        (cosine - loose, 1.0 + loose),
    )  # fmt: skip
    least, greatest = least - rounding, greatest + rounding
    n_u = _turning(work.normals, 6, axis, n, least, greatest, 10.0 * rounding)
    n_v = _turning(work.normals, 1, axis, n, least, greatest, 10.0 * rounding)
    # The middles.
    q, a, b = work.middle[0], work.middle[1], work.middle[2]
    mid_t, mid_tu, mid_tv = 0.5 * (t0 + t1), 0.5 * (t_u[0] + t_u[1]), 0.5 * (t_v[0] + t_v[1])
    for c in range(3):
        q[c] = a[c] = b[c] = 0.0
        for k in range(16):
            q[c] += points[k, c] / 16.0
        for k in range(4):
            a[c] += 0.75 * (points[12 + k, c] - points[k, c]) / 3.0
            b[c] += 0.75 * (points[4 * k + 3, c] - points[4 * k, c]) / 3.0
        a[c], b[c] = a[c] + mid_tu * z[c], b[c] + mid_tv * z[c]
        q[c] = (q[c] + mid_t * z[c]) + (np.float64(cp[0, 0, c]) - eye[c])
        for r in range(3):
            a[c] += mid_t * 0.5 * (n_u[r][0] + n_u[r][1]) * axis[r][c]
            b[c] += mid_t * 0.5 * (n_v[r][0] + n_v[r][1]) * axis[r][c]
    det = _dot(q, _cross(a, b))
    long_q = _length(q)
    if not (abs(det) > EDGE_ON * long_q * _length(a) * _length(b) and abs(det) < np.inf):
        return _nothing()
    far = abs(cp[0, 0, 0]) + abs(cp[0, 0, 1]) + abs(cp[0, 0, 2]) + abs(eye[0]) + abs(eye[1]) + abs(eye[2])
    error_q = ERROR * (far + size + farthest + long_q) + eye_error
    box = work.box
    for r in range(3):
        row = _cross(b, q) if r == 0 else (_cross(q, a) if r == 1 else _cross(a, b))
        row = (row[0] / det, row[1] / det, row[2] / det)
        length = _length(row)
        low, high = _hull(units, 0, 36, row, np.inf, -np.inf)
        unit = (min(low, low / cosine) - loose * length, max(high, high / cosine) + loose * length)
        turn_u, turn_v = mul(t, _along(row, axis, n_u)), mul(t, _along(row, axis, n_v))
        pad = ERROR * length * size
        du = add(_step_hull(points, 4, 3, 3.0, row, pad), add(mul(t_u, unit), turn_u))
        dv = add(_step_hull(points, 1, 3, 3.0, row, pad), add(mul(t_v, unit), turn_v))
        way = row[0] * (cp[0, 0, 0] - eye[0]) + row[1] * (cp[0, 0, 1] - eye[1]) + row[2] * (cp[0, 0, 2] - eye[2])
        low, high = _hull(points, 0, 16, row, np.inf, -np.inf)
        to = add((low + way, high + way), mul(t, unit))
        _set(box, 0, r, _wide(to, ERROR, 0.0), error_q * length)
        _set(box, 1, r, _wide(du, 1e-12, 0.0), 0.0)
        _set(box, 2, r, _wide(dv, 1e-12, 0.0), 0.0)
    # The shader's normal: 40 u of the longest tangents' product (`bounds.cones`), and its unit; the whole patch's.
    part = (u1 - u0) * (v1 - v0)
    turned = 40.0 * U * long_a * long_b * part / least + 4.0 * U
    turned += np.float64(patches.normal_slack[p]) if patches.normal_id[p] >= 0 else 0.0  # normals shared on edges
    bias = abs(np.float64(maps.bias[patches.map_id[p]])) if patches.map_id[p] >= 0 else 0.0
    shift = farthest * turned + off + U * (16.0 * farthest + 16.0 * bias)
    if not turned < 0.01:
        return _nothing()
    return Part(True, det, shift, farthest)
