"""Primitives: assembly of tessellated triangles, clipping, viewport, snap to 16.8, face culling, set-up.

Order of operations and rules: D3D11.3 functional specification 15.3 to 15.16 and 3.4; where it leaves room:

- x and y are clipped only at a guard band, where a window coordinate would leave the 16.8 range; z always;
- a polygon is cut plane by plane (near, far, left, right, top, bottom guard), in float64 from the float32 vertices,
  always starting from the inside vertex, so that triangles sharing an edge make the same point; the result is rounded
  to float32 once, before the divide;
- a polygon of n corners becomes the fan (0,1,2), (0,2,3), ...;
- triangles of zero area are dropped at set-up: they cover no sample.
"""

from enum import IntEnum

import numpy as np

from pipeline.inside import BACK_FACE, CULL_BACK, CULL_FRONT, UNKNOWN, set_up_inside
from pipeline.jit import helper, inlined, kernel
from pipeline.types import Viewport

LEFT, RIGHT, BOTTOM, TOP, NEAR, FAR, GUARD, NONFINITE = (1 << k for k in range(8))  # bits of Window.code
FRUSTUM = LEFT | RIGHT | BOTTOM | TOP | NEAR | FAR
NEEDS_CLIP = NEAR | FAR | GUARD

WINDOW_MIN, WINDOW_MAX = -32768.0, 32767.0 + 255.0 / 256.0
ZERO = np.float32(0.0)
MAX_CORNERS = 9  # a triangle cut by six planes
POLYGON = 8  # float64 entries of a corner: x y z w nx ny nz, and 1 where the edge to the next corner is an original one
CLIP_SCRATCH = 2 * MAX_CORNERS * POLYGON


class Outcome(IntEnum):
    """Columns of the set-up stage's counts of a live patch: every triangle and fan triangle has exactly one outcome.

    C_IN = CLIPPED + INVALID + (triangles that left the clipper, whole or as a fan)
    C_OUT = ZERO_AREA + FACE + NO_SAMPLE + OFFSCREEN + SETUP
    """

    C_IN = 0  # triangles that reach the clipper
    C_OUT = 1  # triangles that leave it; a fan counts each
    CLIPPED = 2  # triangles wholly outside, or of which clipping left nothing
    INVALID = 3  # dropped for a NaN or infinity
    ZERO_AREA = 4
    FACE = 5  # culled as back face (or front face, by the cull mode)
    NO_SAMPLE = 6  # no column or no row of samples lies within its bounds
    OFFSCREEN = 7  # its samples lie outside the viewport
    SETUP = 8  # goes on to binning
    CUT = 9  # triangles that the clipper cut into a fan


NUM_OUTCOMES = len(Outcome)
_C_IN, _C_OUT, _CLIPPED, _INVALID, _ZERO_AREA, _FACE, _NO_SAMPLE, _OFFSCREEN, _SETUP, _CUT = (int(o) for o in Outcome)


def guard_band(viewport: Viewport) -> tuple[float, float, float, float]:
    """Limits a of the guard band: inside is `lo_x w <= x <= hi_x w`, `lo_y w <= y <= hi_y w` (clip space, y up)."""
    lo_x = (-32768.0 - viewport.left) * 2.0 / viewport.width - 1.0
    hi_x = (32767.0 - viewport.left) * 2.0 / viewport.width - 1.0
    lo_y = 1.0 - (32767.0 - viewport.top) * 2.0 / viewport.height
    hi_y = 1.0 - (-32768.0 - viewport.top) * 2.0 / viewport.height
    return lo_x, hi_x, lo_y, hi_y


@inlined
def _window(x, y, z, w, viewport):
    """Window coordinates in float32, D3D11.3 functional specification 15.6."""
    width, height = np.float32(viewport.width), np.float32(viewport.height)
    one, half = np.float32(1.0), np.float32(0.5)
    near, far = np.float32(viewport.min_depth), np.float32(viewport.max_depth)
    x_win = (x / w + one) * width * half + np.float32(viewport.left)
    y_win = (one - y / w) * height * half + np.float32(viewport.top)
    return x_win, y_win, near + (z / w) * (far - near)


@inlined
def _snap(a):
    """Window coordinate to 16.8 fixed point: nearest, ties to even, saturating (3.2.4.1)."""
    return np.int32(np.rint(min(max(np.float64(a), WINDOW_MIN), WINDOW_MAX) * 256.0))


@inlined
def _out_code(x, y, z, w, guard):
    """Bits of a clip-space position. Nothing here is a branch, so that the loop over points vectorizes."""
    lo_x, hi_x, lo_y, hi_y = guard
    code = LEFT if x < -w else 0
    code |= RIGHT if x > w else 0
    code |= BOTTOM if y < -w else 0
    code |= TOP if y > w else 0
    code |= NEAR if (z < 0.0) | (w <= 0.0) else 0
    code |= FAR if z > w else 0
    code |= GUARD if (x < lo_x * w) | (x > hi_x * w) | (y < lo_y * w) | (y > hi_y * w) else 0
    finite = (abs(x) < np.inf) & (abs(y) < np.inf) & (abs(z) < np.inf) & (abs(w) < np.inf)
    return code if finite else NONFINITE


@kernel
def project_points(begin, end, clip, viewport, guard, window):
    """Out codes and window coordinates of points begin .. end-1. clip : float32[4, N]. `window` is modified in place.

    Points that need the clipper get position 0: nothing reads it.
    """
    n = end - begin
    xs, ys, zs, ws = clip[0, begin:end], clip[1, begin:end], clip[2, begin:end], clip[3, begin:end]
    out_x, out_y, out_z = window.x[begin:end], window.y[begin:end], window.z[begin:end]
    out_w, out_code = window.w[begin:end], window.code[begin:end]
    for k in range(n):
        x, y, z, w = xs[k], ys[k], zs[k], ws[k]
        code = _out_code(x, y, z, w, guard)
        x_win, y_win, z_win = _window(x, y, z, w, viewport)
        drawn = (code & (NEEDS_CLIP | NONFINITE)) == 0
        out_x[k] = _snap(x_win if drawn else ZERO)
        out_y[k] = _snap(y_win if drawn else ZERO)
        out_z[k] = z_win if drawn else ZERO
        out_w[k], out_code[k] = w, code


@kernel
def count_cuts(begin, end, live, patterns, first_point, code, cuts):
    """cuts[k] = triangles of live patch k that go through the clipper's planes one by one."""
    for k in range(begin, end):
        any_code = 0
        for i in range(first_point[k], first_point[k + 1]):
            any_code |= code[i]
        cuts[k] = 0
        if any_code & NEEDS_CLIP:
            pattern = patterns.of_patch[live[k]]
            base = first_point[k]
            for t in range(patterns.first_triangle[pattern], patterns.first_triangle[pattern + 1]):
                a = code[base + patterns.indices[3 * t]]
                b = code[base + patterns.indices[3 * t + 1]]
                c = code[base + patterns.indices[3 * t + 2]]
                if _must_cut(a, b, c):
                    cuts[k] += 1


@helper
def _must_cut(a, b, c):
    """Not trivially rejected, and some vertex is outside a plane that the clipper cuts at."""
    return (a & b & c & FRUSTUM) == 0 and ((a | b | c) & NONFINITE) == 0 and ((a | b | c) & NEEDS_CLIP) != 0


@helper
def _distance(polygon, k, plane, guard):
    """Signed clip-space distance of corner k from a plane, inside positive."""
    x, y, z, w = polygon[k, 0], polygon[k, 1], polygon[k, 2], polygon[k, 3]
    if plane == 0:
        return z
    if plane == 1:
        return w - z
    if plane == 2:
        return x - guard[0] * w
    if plane == 3:
        return guard[1] * w - x
    if plane == 4:
        return guard[3] * w - y
    return y - guard[2] * w


@helper
def _cut_edge(polygon, inside, outside, d_in, d_out, result, n):
    """Corner n of `result`: where the edge from corner `inside` to corner `outside` meets the plane."""
    t = d_in / (d_in - d_out)
    for c in range(7):
        result[n, c] = polygon[inside, c] + t * (polygon[outside, c] - polygon[inside, c])


@helper
def _cut(polygon, n, plane, guard, result):
    """Cut a polygon of n corners by one plane into `result`; the number of corners left (Sutherland and Hodgman)."""
    m = 0
    for a in range(n):
        b = a + 1 if a + 1 < n else 0
        d_a, d_b = _distance(polygon, a, plane, guard), _distance(polygon, b, plane, guard)
        if d_a >= 0.0:
            result[m] = polygon[a]
            m += 1
            if d_b < 0.0:
                _cut_edge(polygon, a, b, d_a, d_b, result, m)
                result[m, 7] = 0.0  # from here along the plane
                m += 1
        elif d_b >= 0.0:
            _cut_edge(polygon, b, a, d_b, d_a, result, m)
            result[m, 7] = polygon[a, 7]
            m += 1
    return m


@helper
def _clip_triangle(ids, clip, normal, guard, scratch):
    """Clip the triangle `ids` by all planes. The number of corners left; they are in the first polygon of `scratch`."""
    now, then = scratch[:MAX_CORNERS], scratch[MAX_CORNERS:]
    for k in range(3):
        for c in range(4):
            now[k, c] = clip[c, ids[k]]
        for c in range(3):
            now[k, 4 + c] = normal[c, ids[k]]
        now[k, 7] = 1.0
    n = 3
    for plane in range(6):  # an even number of swaps: the result is back in the first half
        n = _cut(now, n, plane, guard, then)
        now, then = then, now
    return n


@helper
def _add_corner(corner, viewport, window, normal, v):
    """Make vertex v from a clipped corner; False where its window position is not finite."""
    x, y, z, w = np.float32(corner[0]), np.float32(corner[1]), np.float32(corner[2]), np.float32(corner[3])
    x_win, y_win, z_win = _window(x, y, z, w, viewport)
    for c in range(3):
        normal[c, v] = corner[4 + c]
    window.w[v] = w
    if not (abs(x_win) < np.inf and abs(y_win) < np.inf and abs(z_win) < np.inf):
        window.x[v], window.y[v], window.z[v] = 0, 0, 0.0
        return False
    window.x[v], window.y[v], window.z[v] = _snap(x_win), _snap(y_win), z_win
    return True


@helper
def _set_up(ids, edges, patch, t, window, bounds, margin, face_cull, triangles):
    """Face-cull, bound and store a triangle of window vertices at place t; its Outcome."""
    a, b, c = ids
    xa, ya = np.int64(window.x[a]), np.int64(window.y[a])
    xb, yb = np.int64(window.x[b]), np.int64(window.y[b])
    xc, yc = np.int64(window.x[c]), np.int64(window.y[c])
    area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
    if area == 0:
        return _ZERO_AREA
    if area < 0:
        if face_cull == CULL_BACK:
            return _FACE
        b, c = c, b  # clockwise from here on; the leading vertex stays
        edges = (edges & 1) | ((edges & 2) << 1) | ((edges & 4) >> 1) | BACK_FACE
    elif face_cull == CULL_FRONT:
        return _FACE
    left, top, right, bottom = bounds
    x0, y0, x1, y1 = _box(xa, ya, xb, yb, xc, yc, margin)
    if x0 > x1 or y0 > y1:
        return _NO_SAMPLE
    x0, y0, x1, y1 = max(x0, left), max(y0, top), min(x1, right), min(y1, bottom)
    if x0 > x1 or y0 > y1:
        return _OFFSCREEN
    triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2] = a, b, c
    triangles.box[t, 0], triangles.box[t, 1], triangles.box[t, 2], triangles.box[t, 3] = x0, y0, x1, y1
    triangles.cover[t] = UNKNOWN
    triangles.edges[t] = edges
    triangles.patch[t] = patch
    return _SETUP


@helper
def _assemble_patch(
    k, patch, pattern, base, patterns, points, viewport, guard, bounds, margin, face_cull, window, spare, triangles,
    outcomes, scratch,
):  # fmt: skip
    """All triangles of live patch k; new vertices go to `spare`, `spare` + 1, ..."""
    t = triangles.first[k]
    for s in range(patterns.first_triangle[pattern], patterns.first_triangle[pattern + 1]):
        ids = (
            base + np.int64(patterns.indices[3 * s]),
            base + np.int64(patterns.indices[3 * s + 1]),
            base + np.int64(patterns.indices[3 * s + 2]),
        )
        a, b, c = window.code[ids[0]], window.code[ids[1]], window.code[ids[2]]
        outcomes[k, _C_IN] += 1
        number = s - patterns.first_triangle[pattern]
        if (a | b | c) & NONFINITE:
            outcomes[k, _INVALID] += 1
        elif a & b & c & FRUSTUM:
            outcomes[k, _CLIPPED] += 1
        elif ((a | b | c) & NEEDS_CLIP) == 0:
            outcomes[k, _C_OUT] += 1
            triangles.source[t] = number
            outcome = _set_up(ids, 7, patch, t, window, bounds, margin, face_cull, triangles)
            outcomes[k, outcome] += 1
            t += outcome == _SETUP
        else:
            n = _clip_triangle(ids, points.clip, points.normal, guard, scratch)
            if n < 3:
                outcomes[k, _CLIPPED] += 1
                continue
            finite = True
            for i in range(n):
                finite = _add_corner(scratch[i], viewport, window, points.normal, spare + i) and finite
            if not finite:
                outcomes[k, _INVALID] += 1
                continue
            outcomes[k, _CUT] += 1
            for i in range(1, n - 1):
                fan = (spare, spare + i, spare + i + 1)
                # Bit 0: edge i to i+1; bit 1: edge i+1 to 0; bit 2: edge 0 to i. Diagonals of the fan are not edges.
                edges = 1 if scratch[i, 7] > 0.0 else 0
                edges |= 2 if (i == n - 2 and scratch[n - 1, 7] > 0.0) else 0
                edges |= 4 if (i == 1 and scratch[0, 7] > 0.0) else 0
                outcomes[k, _C_OUT] += 1
                triangles.source[t] = number
                outcome = _set_up(fan, edges, patch, t, window, bounds, margin, face_cull, triangles)
                outcomes[k, outcome] += 1
                t += outcome == _SETUP
            spare += n
    triangles.used[k] = t - triangles.first[k]


@helper
def _box(xa, ya, xb, yb, xc, yc, margin):
    """First and last column and row of pixels with a sample within the bounds of a triangle; none where first > last."""
    x0 = (min(xa, xb, xc) + 127 - margin) >> 8
    y0 = (min(ya, yb, yc) + 127 - margin) >> 8
    x1 = (max(xa, xb, xc) - 128 + margin) >> 8
    y1 = (max(ya, yb, yc) - 128 + margin) >> 8
    return x0, y0, x1, y1


@inlined
def _count_ones(flags):
    total = 0
    for i in range(len(flags)):
        total += flags[i]
    return total


@kernel
def assemble(
    begin, end, live, patterns, points, first_spare, viewport, guard, bounds, margin, face_cull, window, triangles,
    outcomes, used, num_used, scratch, lanes,
):  # fmt: skip
    """Assemble, clip, cull and set up the triangles of live patches begin .. end-1.

    points : clip float32[4, N] and normal float32[3, V]; normals of new vertices are added. first_spare : int64[live],
    the first vertex number that each patch may add. bounds : first and last column and row of the viewport, inclusive
    (x0, y0, x1, y1). margin : reach of the sample pattern from the pixel centre, 1/256 pixel. outcomes : int64[live,
    NUM_OUTCOMES]. used : uint8[V], 0 at first, set to 1 for each vertex of a set-up triangle; num_used : int64[live], how many
    each patch has. scratch : float64[2 * MAX_CORNERS, POLYGON]. lanes : `inside.Lanes`. `window`, `triangles`, `outcomes`,
    `used`, `num_used` are modified in place.
    """
    indices, xs, ys = patterns.indices, window.x, window.y
    vertex, box, edges, patches, source = (
        triangles.vertex, triangles.box, triangles.edges, triangles.patch, triangles.source,
    )  # fmt: skip
    for k in range(begin, end):
        patch = live[k]
        pattern = patterns.of_patch[patch]
        base, count = points.first[k], points.first[k + 1] - points.first[k]
        any_code, code = np.uint8(0), window.code[base : base + count]
        for i in range(count):
            any_code |= code[i]
        if any_code == 0:
            first, last = patterns.first_triangle[pattern], patterns.first_triangle[pattern + 1]
            t, zero_area, culled, no_sample, offscreen = set_up_inside(
                patch, first, last, base, count, indices, xs, ys, bounds, margin, face_cull, vertex, box, triangles.cover,
                edges, patches, source, triangles.first[k], used, lanes,
            )  # fmt: skip
            triangles.used[k] = t - triangles.first[k]
            outcomes[k, _C_IN] += last - first
            outcomes[k, _C_OUT] += last - first
            outcomes[k, _ZERO_AREA] += zero_area
            outcomes[k, _FACE] += culled
            outcomes[k, _NO_SAMPLE] += no_sample
            outcomes[k, _OFFSCREEN] += offscreen
            outcomes[k, _SETUP] += t - triangles.first[k]
        else:
            _assemble_patch(
                k, patch, pattern, base, patterns, points, viewport, guard, bounds, margin,
                face_cull, window, first_spare[k], triangles, outcomes, scratch,
            )  # fmt: skip
            for t in range(triangles.first[k], triangles.first[k] + triangles.used[k]):
                used[vertex[t, 0]], used[vertex[t, 1]], used[vertex[t, 2]] = 1, 1, 1
        num_used[k] = _count_ones(used[base : base + count]) + _count_ones(used[first_spare[k] : first_spare[k + 1]])
