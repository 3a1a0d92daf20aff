"""`backface:tessellation_safe`: never drops a patch of which a triangle can be set up at the frame's factors.

Exact for the tessellation, as it stands on the 16.8 grid: not one triangle of a culled patch has the other sign of area
after the float32 shader and the snap, by the frame's partitioning (by any, where that is not known). This is proven, not
measured:

1. All in the clip-space rows Q = (x, y, w), homogeneous, so that rational patches are polynomials too. With w > 0 a
   triangle's area on the screen has the sign of F = det[Q0, Q1, Q2].
2. Every triangle of a pattern has an edge along u (or v: the same with u and v exchanged), from a to b on v0, and a corner
   at c on v1 (`pattern_steps`). Chords are Newton's divided differences, Q[a, b] and so on:

       F / ((b - a) (v1 - v0)) = det[Q, Q[a,b], Q_c[v0,v1]] + (c - a) (c - b) / (v1 - v0) det[Q, Q[a,b], Q[a,b,c]],

   Q = Q(a, v0), exactly: a function of the eye, a chord along each parameter, and what a corner off the edge's ends adds.
3. Q[a,b] = Q_u + h X, Q_c[v0,v1] = Q_v + k Y + g Z, |h| <= b - a, |k| <= |v1 - v0|, |g| <= |c - a|, where X, Y, Z lie in the
   convex hulls of the control vectors of Q_uu / 2, Q_vv / 2 and Q_uv, and Q[a,b,c] in that of Q_uu / 2.
4. So F / ((b - a) (v1 - v0)) differs from N = det[Q, Q_u, Q_v] at a point of the smooth patch by at most
   k D(U,Y) + g D(U,Z) + h D(X,V) + r D(U,X), where D(A,B) bounds |det[Q, a, b]| over both hulls. N is bounded by the 64
   coefficients of the tangent-plane test. The difference goes to 0 as the factors grow.
   Or, where that gives more: the first determinant is at least the least det[q, a, b] over the control points and both sets of
   tangent control vectors, whatever the factors, and r D(U,X) comes off it.
5. Corners on the screen are off by at most d (float32, 16.8). An area A of edges e1, e2 then changes by no more than
   2 d (|e1| + |e2|) + 8 d^2 (1-norms), and |A| must exceed that: small or thin triangles, whose sign the snap decides, keep a
   patch alive.
6. Patches that the clipper may cut (near, far, guard band) are kept.
7. Displaced patches: chords of the displaced surface in place of Q's, bounded part by part (`displaced`, `chords`); the
   rounding of the displacement and of the normal adds to d. Rational, ACC and Gregory ones are kept.

The frame of Q is sheared so that the patch's middle has x = y = 0: determinants stay, D becomes small.
"""

import numpy as np

from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, cull_facing, eye_or_none, is_plain, is_single_net
from pipeline.culling.displaced import classify_from
from pipeline.culling.displaced_screen import view_of_matrix
from pipeline.culling.pattern_steps import measure_steps
from pipeline.culling.screen import LEAST_WEIGHT, MOST_PIXELS, MOST_WEIGHT, SNAP, U, clip_error
from pipeline.culling.tangent_plane import LANES, sum_products
from pipeline.jit import helper, kernel
from pipeline.types import F64, I64, U8, FaceCull, HullInput, PatchBounds


@helper
def _load(cp, matrix, q):
    """Sheared (x, y, w) of the 16 control points into q float64[16, 3]; (fine, shear x, shear y, rounding of an entry)."""
    fine = True
    size = lo_x = lo_y = hi_x = hi_y = 0.0
    for k in range(16):
        i, j = k >> 2, k & 3
        for c in range(3):
            q[k, c] = terms = 0.0
            for column in range(4):
                product = matrix[c if c < 2 else 3, column] * np.float64(cp[i, j, column])
                q[k, c] += product
                terms += abs(product)
            size = max(size, terms)
        fine &= cp[i, j, 3] > 0.0 and q[k, 2] > 0.0
        ndc_x, ndc_y = q[k, 0] / q[k, 2], q[k, 1] / q[k, 2]
        if k == 0:
            lo_x, hi_x, lo_y, hi_y = ndc_x, ndc_x, ndc_y, ndc_y
        lo_x, hi_x, lo_y, hi_y = min(lo_x, ndc_x), max(hi_x, ndc_x), min(lo_y, ndc_y), max(hi_y, ndc_y)
    shear_x, shear_y = 0.5 * (lo_x + hi_x), 0.5 * (lo_y + hi_y)
    for k in range(16):
        q[k, 0] -= shear_x * q[k, 2]
        q[k, 1] -= shear_y * q[k, 2]
    return fine, shear_x, shear_y, 1e-15 * size * (1.0 + abs(shear_x) + abs(shear_y))


@helper
def _noise(q, rounding):
    """What float64 may be off in a coefficient of det[Q, Q_u, Q_v]."""
    largest = widest = 0.0
    for k in range(16):
        for c in range(3):
            largest = max(largest, abs(q[k, c]))
            widest = max(widest, abs(q[k, c] - q[0, c]))
    return 1e3 * rounding * largest * (widest + rounding) + 1e-12 * largest * widest * widest


@kernel
def _least_plane(control_points, matrix, numbers, facing, margin):
    """Facing of the smooth patches `numbers`, and the least |det[Q, Q_u, Q_v]| on each that faces one way."""
    x, y, z = np.zeros((16, LANES)), np.zeros((16, LANES)), np.zeros((16, LANES))
    t, normal, noise, q = np.empty((64, LANES)), np.empty((3, LANES)), np.empty(LANES), np.empty((16, 3))
    for first in range(0, len(numbers), LANES):
        n = min(LANES, len(numbers) - first)
        for lane in range(n):
            fine, _, _, rounding = _load(control_points[numbers[first + lane]], matrix, q)
            noise[lane] = _noise(q, rounding) if fine else np.nan
            for k in range(16):
                x[k, lane], y[k, lane], z[k, lane] = q[k, 0], q[k, 1], q[k, 2]
        sum_products(x, y, z, t, normal)
        for lane in range(n):
            lo, hi = np.inf, -np.inf
            for k in range(64):
                lo, hi = min(lo, t[k, lane]), max(hi, t[k, lane])
            lo, hi = lo - noise[lane], hi + noise[lane]
            facing[first + lane], margin[first + lane] = SILHOUETTE, 0.0
            if lo > 0.0 and hi < np.inf:
                facing[first + lane], margin[first + lane] = FRONT, lo
            elif hi < 0.0 and lo > -np.inf:
                facing[first + lane], margin[first + lane] = BACK, -hi


@helper
def _differences(q, out, along_u, factor):
    """First differences of q along u or v times factor, into out; their number, 12."""
    n = 0
    for i in range(3):
        for j in range(4):
            k = 4 * i + j if along_u else 4 * j + i
            step = 4 if along_u else 1
            for c in range(3):
                out[n, c] = factor * (q[k + step, c] - q[k, c])
            n += 1
    return n


@helper
def _second_differences(q, out, along_u):
    """Control vectors of Q_uu / 2 or Q_vv / 2; their number, 8."""
    n = 0
    for i in range(2):
        for j in range(4):
            k = 4 * i + j if along_u else 4 * j + i
            step = 4 if along_u else 1
            for c in range(3):
                out[n, c] = 3.0 * ((q[k + 2 * step, c] - q[k + step, c]) - (q[k + step, c] - q[k, c]))
            n += 1
    return n


@helper
def _mixed_differences(q, out):
    """Control vectors of Q_uv; their number, 9."""
    n = 0
    for i in range(3):
        for j in range(3):
            k = 4 * i + j
            for c in range(3):
                out[n, c] = 9.0 * ((q[k + 5, c] - q[k + 4, c]) - (q[k + 1, c] - q[k, c]))
            n += 1
    return n


@helper
def _reach(most, a, na, b, nb):
    """Bound of |det[Q, a, b]| over hulls of control vectors; most: largest |x|, |y|, |w| of Q."""
    x = y = z = 0.0
    for i in range(na):
        for j in range(nb):
            x = max(x, abs(a[i, 1] * b[j, 2] - a[i, 2] * b[j, 1]))
            y = max(y, abs(a[i, 2] * b[j, 0] - a[i, 0] * b[j, 2]))
            z = max(z, abs(a[i, 0] * b[j, 1] - a[i, 1] * b[j, 0]))
    return most[0] * x + most[1] * y + most[2] * z


@helper
def _least_product(q, u, nu, v, nv, sign):
    """Lower bound of sign * det[Q, a, b], Q in the hull of q, a and b in those of u and v: chords anywhere, of any length."""
    x0 = y0 = z0 = np.inf
    x1 = y1 = z1 = -np.inf
    for k in range(16):
        x0, y0, z0 = min(x0, q[k, 0]), min(y0, q[k, 1]), min(z0, q[k, 2])
        x1, y1, z1 = max(x1, q[k, 0]), max(y1, q[k, 1]), max(z1, q[k, 2])
    least = np.inf
    for i in range(nu):
        for j in range(nv):
            x = sign * (u[i, 1] * v[j, 2] - u[i, 2] * v[j, 1])
            y = sign * (u[i, 2] * v[j, 0] - u[i, 0] * v[j, 2])
            z = sign * (u[i, 0] * v[j, 1] - u[i, 1] * v[j, 0])
            least = min(least, min(x * x0, x * x1) + min(y * y0, y * y1) + min(z * z0, z * z1))
    return least


@helper
def _largest(a, n, c):
    m = 0.0
    for k in range(n):
        m = max(m, abs(a[k, c]))
    return m


@helper
def _screen(cp, matrix, viewport, q, shear_x, shear_y):
    """How the patch lies on the screen: (whole, d, weight of an area).

    whole : no triangle needs the clipper. d : pixels that a corner may be off by, along each axis. The last: an area of
    |F| in clip space is at least so many times larger in square pixels.
    """
    most_x = most_y = most_z = 0.0
    for k in range(16):
        w = np.float64(cp[k >> 2, k & 3, 3])
        most_x = max(most_x, abs(cp[k >> 2, k & 3, 0] / w))
        most_y = max(most_y, abs(cp[k >> 2, k & 3, 1] / w))
        most_z = max(most_z, abs(cp[k >> 2, k & 3, 2] / w))
    error_x = clip_error(matrix[0], most_x, most_y, most_z)
    error_y = clip_error(matrix[1], most_x, most_y, most_z)
    error_z = clip_error(matrix[2], most_x, most_y, most_z)
    error_w = clip_error(matrix[3], most_x, most_y, most_z)
    whole = True
    least_w, largest_w, ndc_x, ndc_y = np.inf, 0.0, 0.0, 0.0
    for k in range(16):
        i, j = k >> 2, k & 3
        weight = np.float64(cp[i, j, 3])
        z = matrix[2, 0] * np.float64(cp[i, j, 0]) + matrix[2, 1] * np.float64(cp[i, j, 1])
        z = (z + matrix[2, 2] * np.float64(cp[i, j, 2]) + matrix[2, 3] * weight) / weight
        w = q[k, 2] / weight
        if not (weight >= LEAST_WEIGHT and weight <= MOST_WEIGHT):
            whole = False
        whole &= z > error_z and w - z > error_z + error_w and w > 2.0 * error_w
        least_w = min(least_w, w - error_w)
        largest_w = max(largest_w, q[k, 2])
        ndc_x, ndc_y = max(ndc_x, abs(q[k, 0] / q[k, 2] + shear_x)), max(ndc_y, abs(q[k, 1] / q[k, 2] + shear_y))
    width, height = np.float64(viewport.width), np.float64(viewport.height)
    far_x, far_y = (ndc_x + 1.0) * width + abs(viewport.left), (ndc_y + 1.0) * height + abs(viewport.top)
    whole &= far_x < MOST_PIXELS and far_y < MOST_PIXELS
    off_x = 0.5 * width * (error_x + ndc_x * error_w) / least_w + 5.0 * U * (far_x + width)
    off_y = 0.5 * height * (error_y + ndc_y * error_w) / least_w + 5.0 * U * (far_y + height)
    return whole, max(off_x, off_y) * 1.01 + SNAP, 0.25 * width * height / (largest_w * largest_w * largest_w)


@helper
def _is_safe(cp, matrix, viewport, sign, margin, steps, q, u, v, x, y, z):
    """Whether every triangle keeps the sign of the smooth patch, on which sign * det[Q, Q_u, Q_v] is at least `margin`."""
    fine, shear_x, shear_y, rounding = _load(cp, matrix, q)
    whole, d, to_pixels = _screen(cp, matrix, viewport, q, shear_x, shear_y)
    if not (fine and whole):
        return False
    nu, nv = _differences(q, u, True, 3.0), _differences(q, v, False, 3.0)
    nx, ny, nz = _second_differences(q, x, True), _second_differences(q, y, False), _mixed_differences(q, z)
    most = (_largest(q, 16, 0), _largest(q, 16, 1), _largest(q, 16, 2))
    # Pixels that a chord along u, v of parameter length 1 spans at most, x and y together.
    least_w, ndc_x, ndc_y = np.inf, 0.0, 0.0
    for k in range(16):
        least_w = min(least_w, q[k, 2])
        ndc_x, ndc_y = max(ndc_x, abs(q[k, 0] / q[k, 2])), max(ndc_y, abs(q[k, 1] / q[k, 2]))
    half_w, half_h = 0.5 * viewport.width / least_w, 0.5 * viewport.height / least_w
    length_u = half_w * (_largest(u, nu, 0) + ndc_x * _largest(u, nu, 2))
    length_u += half_h * (_largest(u, nu, 1) + ndc_y * _largest(u, nu, 2))
    length_v = half_w * (_largest(v, nv, 0) + ndc_x * _largest(v, nv, 2))
    length_v += half_h * (_largest(v, nv, 1) + ndc_y * _largest(v, nv, 2))
    from_uy, from_xv = _reach(most, u, nu, y, ny), _reach(most, x, nx, v, nv)
    from_uz, from_ux, from_vz, from_vy = 0.0, 0.0, 0.0, 0.0
    if steps[2] > 0.0 or steps[3] > 0.0 or steps[10] > 0.0 or steps[11] > 0.0:
        from_uz, from_ux = _reach(most, u, nu, z, nz), _reach(most, u, nu, x, nx)
        from_vz, from_vy = _reach(most, v, nv, z, nz), _reach(most, v, nv, y, ny)
    product = _least_product(q, u, nu, v, nv, sign) - _noise(q, rounding)
    for side in range(2):
        s = steps[8 * side : 8 * side + 8]
        if side == 0:
            bend = s[3] * from_ux
            change = s[1] * from_uy + s[2] * from_uz + s[0] * from_xv + bend
            wobble = length_u * s[5] + length_v * s[4] + length_u * s[6]
        else:
            bend = s[3] * from_vy
            change = s[1] * from_xv + s[2] * from_vz + s[0] * from_uy + bend
            wobble = length_v * s[5] + length_u * s[4] + length_v * s[6]
        left = max(margin - change * (1.0 + 1e-9), product - bend * (1.0 + 1e-9))
        if not left * to_pixels > (2.0 * d * wobble + 8.0 * d * d * s[7]) * (1.0 + 1e-9):
            return False
    return True


@kernel
def _keep_safe(control_points, matrix, viewport, numbers, steps, margin, facing):
    q, u, v = np.empty((16, 3)), np.empty((12, 3)), np.empty((12, 3))
    x, y, z = np.empty((8, 3)), np.empty((8, 3)), np.empty((9, 3))
    for k in range(len(numbers)):
        cp = control_points[numbers[k]]
        sign = 1.0 if facing[k] == FRONT else -1.0
        if not _is_safe(cp, matrix, viewport, sign, margin[k], steps[k], q, u, v, x, y, z):
            facing[k] = SILHOUETTE


def _classify_plain(stage: HullInput, plain: I64, wanted: tuple[int, ...]) -> U8:
    """`_classify` of undisplaced patches."""
    facing, margin = np.empty(len(plain), np.uint8), np.empty(len(plain))
    control_points, matrix = stage.patches.control_points, stage.clip_from_world.astype(np.float64)
    _least_plane(control_points, matrix, plain, facing, margin)
    one_way = np.flatnonzero(np.isin(facing, wanted))
    steps: F64 = measure_steps(stage.factors, plain[one_way], stage.partitioning)
    sides = facing[one_way]
    _keep_safe(control_points, matrix, stage.viewport, plain[one_way], steps, margin[one_way], sides)
    answer = np.full(len(plain), SILHOUETTE, np.uint8)
    answer[one_way] = sides
    return answer


def _classify(stage: HullInput, numbers: I64, wanted: tuple[int, ...]) -> U8:
    """Facing of the patches `numbers` where it is one of `wanted`."""
    answer = np.full(len(numbers), SILHOUETTE, np.uint8)
    if eye_or_none(stage) is None:
        return answer
    at = np.flatnonzero(is_plain(stage.patches, numbers))
    if len(at):
        answer[at] = _classify_plain(stage, numbers[at], wanted)
    at = np.flatnonzero((stage.patches.map_id[numbers] >= 0) & is_single_net(stage, numbers))
    view = view_of_matrix(stage) if len(at) else None
    if view is not None:
        steps = measure_steps(stage.factors, numbers[at], stage.partitioning)
        answer[at] = classify_from(stage, view, numbers[at], steps, wanted)
    return answer


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing, for every triangle at the frame's factors, of the patches `numbers`, uint8."""
    return _classify(stage, numbers, (FRONT, BACK))


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches all of whose triangles face away; `flags` uint8[P] modified in place."""
    if stage.face_cull != FaceCull.NONE:
        cull_facing(lambda some, numbers: _classify(some, numbers, (stage.face_cull,)), stage, flags)
