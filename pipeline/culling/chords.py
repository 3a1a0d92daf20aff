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

Blocks of LANES parts are worked off together (`pipeline.wide`), each of a patch of its own; a lane that has none left, or
of which nothing is known, gives numbers that nobody looks at, NaN among them.

Rounding, float64: everything is formed about the patch's first control point, and widened by 1e-14 (ERROR) of magnitudes.
Any map to boxes is as good as the next, so its own rounding needs no room.
"""

from typing import Any, NamedTuple

import numpy as np

from pipeline.bounds.restrict import cut_cubic
from pipeline.culling import part_displacement
from pipeline.culling.intervals import add, mul, scale, square, sub
from pipeline.culling.part_displacement import DISPLACEMENT, MAP_BIAS, PLACE
from pipeline.jit import helper, inlined
from pipeline.wide import LANES, choose, greater, lesser, load, root, spread, store

U = 2.0**-24
ERROR = 1e-14
EDGE_ON = 1e-5  # sine between the surface and the way to the eye from which nothing is told apart
SHORTEST = 2.0**-60  # control polygons' legs, for which float32 tangents have their relative accuracy

# Weights of the products of the differences (i, j) along u and (k, m) along v in control vector (i + k, j + m) of N.
_B2, _B3, _C5 = (np.array(row) for row in ((1.0, 2.0, 1.0), (1.0, 3.0, 3.0, 1.0), (1.0, 5.0, 10.0, 10.0, 5.0, 1.0)))
_AT = np.arange(4)
PRODUCTS = (
    (_B2[:, None, None, None] * _B3[:, None, None] * _B3[:, None] * _B2)
    / (_C5[_AT[:3, None] + _AT][:, None, :, None] * _C5[_AT[:, None] + _AT[:3]][None, :, None, :])
)  # fmt: skip

# Rows of the scratch, after those of `part_displacement`. Three to a vector, x, y, z; control points and vectors in the
# order of their numbers.
POINTS = part_displacement.ROWS  # the patch's 16 control points about the first
PART = POINTS + 48  # the same of the part
STEPS_U, STEPS_V = PART + 48, PART + 84  # 12 differences each of neighbours in PART: 4 i + j along u, 3 i + j along v
NORMALS, UNITS = STEPS_V + 36, STEPS_V + 144  # control vectors 6 p + q of N over the part, and of length 1
ORIGIN = UNITS + 108  # the first control point
LONG_U, LONG_V, SIZE = ORIGIN + 3, ORIGIN + 4, ORIGIN + 5  # `measure_differences`
SLACK = ORIGIN + 6  # of the shared normals
ROWS = ORIGIN + 7


@helper
def make_scratch(more):
    """Scratch of one block: ROWS and `more`."""
    return np.zeros((ROWS + more, LANES))


@inlined
def load_vector(s, row):
    """Rows row, row + 1, row + 2."""
    return load(s, row), load(s, row + 1), load(s, row + 2)


@inlined
def _store_vector(s, row, v):
    store(s, row, v[0])
    store(s, row + 1, v[1])
    store(s, row + 2, v[2])


@inlined
def length(v):
    """Euclidean."""
    return root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def dot(a, b):
    """Of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@helper
def place_patch(cp, slack, lane, s):
    """Rows POINTS, ORIGIN and SLACK of a lane: control points float32[4, 4, 4], all weights 1."""
    for c in range(3):
        s[ORIGIN + c, lane] = cp[0, 0, c]
    for k in range(16):
        for c in range(3):
            s[POINTS + 3 * k + c, lane] = np.float64(cp[k >> 2, k & 3, c]) - np.float64(cp[0, 0, c])
    s[SLACK, lane] = slack


@helper
def measure_differences(s):
    """Rows LONG_U, LONG_V, SIZE: longest differences of neighbouring control points along u and v, the largest distance
    from the first."""
    a = b = size = spread(0.0)
    for k in range(16):
        p = load_vector(s, POINTS + 3 * k)
        size = greater(size, length(p))
        if k < 12:
            a = greater(a, length(_minus(load_vector(s, POINTS + 3 * k + 12), p)))
        if k & 3 < 3:
            b = greater(b, length(_minus(load_vector(s, POINTS + 3 * k + 3), p)))
    store(s, LONG_U, a)
    store(s, LONG_V, b)
    store(s, SIZE, size)


@helper
def _is_whole(s):
    """Whether all lanes' parts are whole patches."""
    whole = True
    for lane in range(LANES):
        whole &= s[PLACE, lane] == 0.0 and s[PLACE + 1, lane] == 1.0
        whole &= s[PLACE + 2, lane] == 0.0 and s[PLACE + 3, lane] == 1.0
    return whole


@inlined
def _cut(s, source, target, step, a, b):
    """One coordinate of four control points, `step` rows apart, on [a, b]."""
    p0, p1, p2, p3 = cut_cubic(
        load(s, source), load(s, source + step), load(s, source + 2 * step), load(s, source + 3 * step), a, b
    )
    store(s, target, p0)
    store(s, target + step, p1)
    store(s, target + 2 * step, p2)
    store(s, target + 3 * step, p3)


@helper
def _fill_part(s):
    """Rows PART, STEPS_U, STEPS_V. The arithmetic is that of `restrict.restrict_net`; a whole patch changes no bit."""
    if _is_whole(s):
        for k in range(48):
            store(s, PART + k, load(s, POINTS + k))
    else:
        for k in range(12):
            _cut(s, POINTS + k, PART + k, 12, load(s, PLACE), load(s, PLACE + 1))
        for i in range(4):
            for c in range(3):
                _cut(s, PART + 12 * i + c, PART + 12 * i + c, 3, load(s, PLACE + 2), load(s, PLACE + 3))
    for k in range(36):
        store(s, STEPS_U + k, load(s, PART + k + 12) - load(s, PART + k))
    for i in range(4):
        for k in range(9):
            store(s, STEPS_V + 9 * i + k, load(s, PART + 12 * i + k + 3) - load(s, PART + 12 * i + k))


@helper
def _fill_normals(s):
    """Rows NORMALS and UNITS: control vectors of (p_u x p_v) / 9, true Bernstein coefficients, and their units.

    Returns (axis, cosine of the half angle, least height, greatest length) of the cone about them; cosine -1 where there
    is none, or some vector is zero.
    """
    x = y = z = greatest = spread(0.0)
    known = spread(0.0) <= 0.0
    for p in range(6):
        for q in range(6):
            nx = ny = nz = spread(0.0)
            for i in range(max(0, p - 3), min(2, p) + 1):
                for j in range(max(0, q - 2), min(3, q) + 1):
                    k, m = p - i, q - j
                    a = load_vector(s, STEPS_U + 3 * (4 * i + j))
                    b = load_vector(s, STEPS_V + 3 * (3 * k + m))
                    product, weight = _cross(a, b), PRODUCTS[i, j, k, m]
                    nx, ny, nz = nx + weight * product[0], ny + weight * product[1], nz + weight * product[2]
            far = length((nx, ny, nz))
            known = known & (far > 0.0) & (far < np.inf)
            greatest = greater(greatest, far)
            inverse = 1.0 / far
            unit = (nx * inverse, ny * inverse, nz * inverse)
            row = 3 * (6 * p + q)
            _store_vector(s, NORMALS + row, (nx, ny, nz))
            _store_vector(s, UNITS + row, unit)
            x, y, z = x + unit[0], y + unit[1], z + unit[2]
    far = length((x, y, z))
    known = known & (far > 1.0)
    axis = (x / far, y / far, z / far)
    cosine, least = spread(1.0), spread(np.inf)
    for k in range(36):
        cosine = lesser(cosine, dot(load_vector(s, UNITS + 3 * k), axis))
        least = lesser(least, dot(load_vector(s, NORMALS + 3 * k), axis))
    return axis, choose(known, cosine, -1.0), least, greatest


@helper
def _hull(s, first, n, direction, low, high):
    """Range of the extents of n vectors along a direction, from (low, high) outwards."""
    for k in range(n):
        along = dot(load_vector(s, first + 3 * k), direction)
        low, high = lesser(low, along), greater(high, along)
    return low, high


@helper
def _step_hull(s, first, direction, pad):
    """Range along a direction of p_u or p_v: 3 times the 12 differences of rows first .. ."""
    low, high = _hull(s, first, 12, direction, spread(np.inf), spread(-np.inf))
    return 3.0 * low - pad, 3.0 * high + pad


@helper
def _normal_steps(s, step, axis, pad):
    """Ranges along the frame's axes of N_u (step 6) or N_v (1), N in its control vectors: 5 times their differences."""
    x0 = y0 = z0 = spread(np.inf)
    x1 = y1 = z1 = spread(-np.inf)
    for p in range(5 if step == 6 else 6):
        for q in range(6 if step == 6 else 5):
            row = NORMALS + 3 * (6 * p + q)
            v = _minus(load_vector(s, row + 3 * step), load_vector(s, row))
            x, y, z = dot(v, axis[0]), dot(v, axis[1]), dot(v, axis[2])
            x0, y0, z0 = lesser(x0, x), lesser(y0, y), lesser(z0, z)
            x1, y1, z1 = greater(x1, x), greater(y1, y), greater(z1, z)
    return (
        (5.0 * x0 - pad, 5.0 * x1 + pad), (5.0 * y0 - pad, 5.0 * y1 + pad), (5.0 * z0 - pad, 5.0 * z1 + pad),
    )  # fmt: skip


@helper
def _turning(s, step, axis, unit_box, least, greatest, pad):
    """Intervals along the frame's axes of n_u (step 6) or n_v (1), from those of n."""
    dx, dy, dz = _normal_steps(s, step, axis, pad)
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
    x = scale(dot(direction, axis[0]), vector[0])
    y = scale(dot(direction, axis[1]), vector[1])
    return add(add(x, y), scale(dot(direction, axis[2]), vector[2]))


class Part(NamedTuple):
    """What is known of each lane's part: where `fine` is not set, nothing."""

    fine: Any  # Mask
    det: Any  # of the middles: det[q, a, b] is det times that of the boxes' coordinates, u and v running from 0 to 1
    shift: Any  # how far a vertex of the float32 shader may be from the displaced surface, but for the rounding of p
    farthest: Any  # largest |t|
    middle_q: Any  # three Wides each: what is mapped to the unit vectors
    middle_a: Any
    middle_b: Any
    q: Any  # three intervals each, the box of the way from the eye to the surface, of d_u and of d_v
    a: Any
    b: Any


@helper
def _first_axis(z):
    """A unit vector across the unit vector z."""
    aside = abs(z[0]) < 0.6
    x = (choose(aside, 0.0, -z[2]), choose(aside, z[2], 0.0), choose(aside, -z[1], z[0]))
    far = length(x)
    return x[0] / far, x[1] / far, x[2] / far


@helper
def _middles(s, eye, t, t_u, t_v, axis, n_u, n_v):
    """Middles of q, d_u and d_v; axis: of the frame, its last one that of the normals."""
    mid_t, mid_tu, mid_tv = 0.5 * (t[0] + t[1]), 0.5 * (t_u[0] + t_u[1]), 0.5 * (t_v[0] + t_v[1])
    x, y, z = axis
    qx, qy, qz = _minus(load_vector(s, ORIGIN), eye)
    for k in range(16):
        v = load_vector(s, PART + 3 * k)
        qx, qy, qz = qx + v[0] / 16.0, qy + v[1] / 16.0, qz + v[2] / 16.0
    q = (qx + mid_t * z[0], qy + mid_t * z[1], qz + mid_t * z[2])
    ax = ay = az = bx = by = bz = spread(0.0)
    for k in range(4):
        v = _minus(load_vector(s, PART + 36 + 3 * k), load_vector(s, PART + 3 * k))
        ax, ay, az = ax + 0.25 * v[0], ay + 0.25 * v[1], az + 0.25 * v[2]
        v = _minus(load_vector(s, PART + 12 * k + 9), load_vector(s, PART + 12 * k))
        bx, by, bz = bx + 0.25 * v[0], by + 0.25 * v[1], bz + 0.25 * v[2]
    half = 0.5 * mid_t
    ux, uy, uz = half * (n_u[0][0] + n_u[0][1]), half * (n_u[1][0] + n_u[1][1]), half * (n_u[2][0] + n_u[2][1]) + mid_tu
    vx, vy, vz = half * (n_v[0][0] + n_v[0][1]), half * (n_v[1][0] + n_v[1][1]), half * (n_v[2][0] + n_v[2][1]) + mid_tv
    a = (
        ax + (ux * x[0] + uy * y[0] + uz * z[0]),
        ay + (ux * x[1] + uy * y[1] + uz * z[1]),
        az + (ux * x[2] + uy * y[2] + uz * z[2]),
    )
    b = (
        bx + (vx * x[0] + vy * y[0] + vz * z[0]),
        by + (vx * x[1] + vy * y[1] + vz * z[1]),
        bz + (vx * x[2] + vy * y[2] + vz * z[2]),
    )
    return q, a, b


@inlined
def _widened(a, relative, absolute):
    pad = relative * greater(abs(a[0]), abs(a[1])) + absolute
    return a[0] - pad, a[1] + pad


@helper
def bound_part(s, eye, eye_error):
    """The boxes of q (the way from the eye to the surface), d_u and d_v over each lane's part: Part.

    Of s the rows that `place_patch`, `measure_differences` and `part_displacement` fill. eye : (3,). Derivatives are those for
    u, v running from 0 to 1 over the part.
    """
    _fill_part(s)
    z, cosine, least, greatest = _fill_normals(s)
    long_a, long_b, size = load(s, LONG_U), load(s, LONG_V), load(s, SIZE)
    rounding = 4.0 * ERROR * size * (long_a + long_b)  # of a control vector of N, after restriction
    fine = (lesser(long_a, long_b) > SHORTEST) & (size < 1.0 / SHORTEST)
    fine = fine & (cosine > 0.01) & (least > 1e6 * rounding)
    t = (load(s, DISPLACEMENT), load(s, DISPLACEMENT + 1))
    t_u, t_v = (
        (load(s, DISPLACEMENT + 2), load(s, DISPLACEMENT + 3)),
        (load(s, DISPLACEMENT + 4), load(s, DISPLACEMENT + 5)),
    )
    off = load(s, DISPLACEMENT + 6)
    farthest = greater(abs(t[0]), abs(t[1]))
    fine = fine & (t[0] <= t[1]) & (farthest + off < np.inf)
    # The frame of the normals, and n and its derivatives in it.
    x = _first_axis(z)
    axis = (x, _cross(z, x), z)
    loose = rounding / least
    cosine = cosine - loose
    zero = spread(0.0)
    nx, ny = _hull(s, UNITS, 36, axis[0], zero, zero), _hull(s, UNITS, 36, axis[1], zero, zero)
    n = (
        (nx[0] / cosine - loose, nx[1] / cosine + loose), (ny[0] / cosine - loose, ny[1] / cosine + loose),
        (cosine - loose, 1.0 + loose),
    )  # fmt: skip
    least, greatest = least - rounding, greatest + rounding
    n_u = _turning(s, 6, axis, n, least, greatest, 10.0 * rounding)
    n_v = _turning(s, 1, axis, n, least, greatest, 10.0 * rounding)
    q, a, b = _middles(s, eye, t, t_u, t_v, axis, n_u, n_v)
    det = dot(q, _cross(a, b))
    long_q = length(q)
    fine = fine & (abs(det) > EDGE_ON * long_q * length(a) * length(b)) & (abs(det) < np.inf)
    origin = load_vector(s, ORIGIN)
    far = abs(origin[0]) + abs(origin[1]) + abs(origin[2]) + (abs(eye[0]) + abs(eye[1]) + abs(eye[2]))
    error_q = ERROR * (far + size + farthest + long_q) + eye_error
    over = 1.0 / det
    rows = (_cross(b, q), _cross(q, a), _cross(a, b))
    frame = (axis, cosine, loose, n_u, n_v)
    box0 = _box_along(s, rows[0], over, origin, eye, t, t_u, t_v, frame, size, error_q)
    box1 = _box_along(s, rows[1], over, origin, eye, t, t_u, t_v, frame, size, error_q)
    box2 = _box_along(s, rows[2], over, origin, eye, t, t_u, t_v, frame, size, error_q)
    # The shader's normal: 40 u of the longest tangents' product (`bounds.cones`), and its unit; the whole patch's.
    part = (load(s, PLACE + 1) - load(s, PLACE)) * (load(s, PLACE + 3) - load(s, PLACE + 2))
    turned = 40.0 * U * long_a * long_b * part / least + 4.0 * U
    turned = turned + load(s, SLACK)  # normals shared on edges
    shift = farthest * turned + off + U * (16.0 * farthest + 16.0 * abs(load(s, MAP_BIAS)))
    fine = fine & (turned < 0.01)
    return Part(
        fine, det, shift, farthest, q, a, b,
        (box0[0], box1[0], box2[0]), (box0[1], box1[1], box2[1]), (box0[2], box1[2], box2[2]),
    )  # fmt: skip


@helper
def _box_along(s, product, over, origin, eye, t, t_u, t_v, frame, size, error_q):
    """One coordinate of the three boxes: ranges of q, d_u and d_v along product times over."""
    axis, cosine, loose, n_u, n_v = frame
    row = (product[0] * over, product[1] * over, product[2] * over)
    far = length(row)
    none, all_ = spread(np.inf), spread(-np.inf)
    low, high = _hull(s, UNITS, 36, row, none, all_)
    unit = (lesser(low, low / cosine) - loose * far, greater(high, high / cosine) + loose * far)
    turn_u, turn_v = mul(t, _along(row, axis, n_u)), mul(t, _along(row, axis, n_v))
    pad = ERROR * far * size
    du = add(_step_hull(s, STEPS_U, row, pad), add(mul(t_u, unit), turn_u))
    dv = add(_step_hull(s, STEPS_V, row, pad), add(mul(t_v, unit), turn_v))
    way = dot(row, _minus(origin, eye))
    low, high = _hull(s, PART, 16, row, none, all_)
    to = add((low + way, high + way), mul(t, unit))
    return _widened(to, ERROR, error_q * far), _widened(du, 1e-12, 0.0), _widened(dv, 1e-12, 0.0)
