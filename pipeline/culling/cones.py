"""Cones of directions that hold a patch's tangents or normals, and the test of an eye against a cone of normals.

A vector that is a positive combination of control vectors lies in every cone of half angle below 90 degrees that holds
them, because such a cone is convex. Control vectors of exactly zero length add nothing and are skipped; none other is.

- polynomial patch: tangents along u are combinations of the 12 differences of neighbouring control points along u, along v
  likewise; normals of the 36 vectors of the normal patch of bi-degree (5, 5), 144 cross products;
- rational patch: w X_u - w_u X, of bi-degree (4, 6), has 35 control vectors, the other tangent as many; normals are
  w^-3 times the normal part of the tangent plane, of bi-degree (7, 7), 64 vectors (`tangent_plane_table`).

Constant positive factors are left out: directions alone count. Rounding, float64: sines and cosines are widened by PAD,
some hundred times what the sums of products round relative to their largest term; a control vector that is zero but for
cancellation has a direction of its own and widens the cone, which is safe.
"""

import math

import numpy as np

from pipeline.culling.backface import BACK, FRONT, SILHOUETTE
from pipeline.culling.tangent_plane_table import POINTS, TARGET, WEIGHT
from pipeline.jit import helper

PAD = 1e-12
STEPS = 32  # of the smallest cone; the half angle is then within a hundredth of the smallest one
MAX_VECTORS = 64
B2 = np.array([1.0, 2.0, 1.0])
B3 = np.array([1.0, 3.0, 3.0, 1.0])


@helper
def _cross_add(out, k, factor, ax, ay, az, bx, by, bz):
    out[k, 0] += factor * (ay * bz - az * by)
    out[k, 1] += factor * (az * bx - ax * bz)
    out[k, 2] += factor * (ax * by - ay * bx)


@helper
def projected(cp, points):
    """Points X / w of the control points cp (4, 4, 4), float64[16, 3], world space; False where some w is not > 0."""
    fine = True
    for k in range(16):
        i, j = k >> 2, k & 3
        w = np.float64(cp[i, j, 3])
        if not w > 0.0:
            fine = False
        for c in range(3):
            points[k, c] = cp[i, j, c] / w
    return fine


@helper
def _tangents_polynomial(points, along_u, out):
    n = 0
    for i in range(3):
        for j in range(4):
            k = 4 * i + j if along_u else 4 * j + i
            step = 4 if along_u else 1
            for c in range(3):
                out[n, c] = points[k + step, c] - points[k, c]
            n += 1
    return n


@helper
def _tangents_rational(cp, points, along_u, out):
    """w X_u - w_u X = 3 (wL XR - wR XL) = 3 wL wR (pR - pL), products of the sub-nets L and R: 5 x 7 control vectors."""
    for k in range(35):
        out[k, 0] = out[k, 1] = out[k, 2] = 0.0
    for i in range(3):
        for j in range(4):
            for k in range(3):
                for m in range(4):
                    a, b = (4 * i + j, 4 * (k + 1) + m) if along_u else (4 * j + i, 4 * m + k + 1)
                    weight = np.float64(cp[a >> 2, a & 3, 3]) * np.float64(cp[b >> 2, b & 3, 3])
                    weight *= B2[i] * B3[j] * B2[k] * B3[m]
                    n = 7 * (i + k) + j + m
                    for c in range(3):
                        out[n, c] += weight * (points[b, c] - points[a, c])
    return 35


@helper
def tangent_vectors(cp, points, rational, along_u, out):
    """Control vectors of the direction of p_u (or p_v), into out float64[MAX_VECTORS, 3]; their number."""
    if rational:
        return _tangents_rational(cp, points, along_u, out)
    return _tangents_polynomial(points, along_u, out)


@helper
def normal_vectors(cp, points, rational, out):
    """Control vectors of the direction of p_u x p_v, into out float64[MAX_VECTORS, 3]; their number."""
    for k in range(MAX_VECTORS):
        out[k, 0] = out[k, 1] = out[k, 2] = 0.0
    if rational:
        # Normal part of cross4(A, B, C) with A = (w p, w) and so on: wa wb wc (b - a) x (c - a).
        for s in range(len(TARGET)):
            a, b, c = POINTS[s, 0], POINTS[s, 1], POINTS[s, 2]
            wa, wb = np.float64(cp[a >> 2, a & 3, 3]), np.float64(cp[b >> 2, b & 3, 3])
            weight = WEIGHT[s] * wa * wb * np.float64(cp[c >> 2, c & 3, 3])
            _cross_add(
                out, TARGET[s], weight,
                points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2],
                points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2],
            )  # fmt: skip
        return 64
    for i in range(3):
        for j in range(4):
            a = 4 * i + j
            ax, ay = points[a + 4, 0] - points[a, 0], points[a + 4, 1] - points[a, 1]
            az = points[a + 4, 2] - points[a, 2]
            for k in range(4):
                for m in range(3):
                    b = 4 * k + m
                    _cross_add(
                        out, 6 * (i + k) + j + m, B2[i] * B3[j] * B3[k] * B2[m], ax, ay, az,
                        points[b + 1, 0] - points[b, 0], points[b + 1, 1] - points[b, 1], points[b + 1, 2] - points[b, 2],
                    )  # fmt: skip
    return 36


@helper
def _to_units(v, n):
    """Make v[:n] unit vectors in place and move zero ones out; the number left, -1 where one is not finite."""
    left = 0
    for k in range(n):
        m = max(abs(v[k, 0]), abs(v[k, 1]), abs(v[k, 2]))
        if m == 0.0:
            continue
        x, y, z = v[k, 0] / m, v[k, 1] / m, v[k, 2] / m
        length = math.sqrt(x * x + y * y + z * z)
        if not (m < np.inf and length > 0.0):
            return -1
        v[left, 0], v[left, 1], v[left, 2] = x / length, y / length, z / length
        left += 1
    return left


@helper
def _least_dot(v, n, x, y, z):
    """Vector of v[:n] farthest from the direction (x, y, z): its number, and the dot product."""
    least, at = np.inf, 0
    for k in range(n):
        dot = v[k, 0] * x + v[k, 1] * y + v[k, 2] * z
        if dot < least:
            least, at = dot, k
    return at, least


@helper
def smallest_cone(v, n):
    """Cone about the control vectors v[:n] (made unit in place): (axis x, y, z, cos, sin) of it and its half angle.

    cos = -1 where there is none of less than 90 degrees. Badoiu and Clarkson 2003: the centre of the smallest ball of the
    unit vectors, approached by steps of 1/2, 1/3, ... towards the farthest one; the best axis seen is taken.
    """
    n = _to_units(v, n)
    if n <= 0:
        return 0.0, 0.0, 0.0, -1.0, 0.0
    cx = cy = cz = 0.0
    for k in range(n):
        cx, cy, cz = cx + v[k, 0], cy + v[k, 1], cz + v[k, 2]
    cx, cy, cz = cx / n, cy / n, cz / n
    best, bx, by, bz, far = -1.0, 0.0, 0.0, 0.0, 0
    for step in range(STEPS):
        length = math.sqrt(cx * cx + cy * cy + cz * cz)
        if not length > 1e-3:
            break
        x, y, z = cx / length, cy / length, cz / length
        at, dot = _least_dot(v, n, x, y, z)
        if dot > best:
            best, bx, by, bz, far = dot, x, y, z, at
        pull = 1.0 / (step + 2.0)
        cx, cy, cz = cx + pull * (v[at, 0] - cx), cy + pull * (v[at, 1] - cy), cz + pull * (v[at, 2] - cz)
    if not best > 1e-6:
        return bx, by, bz, -1.0, 0.0
    # The sine from the cross product: sqrt(1 - cos^2) loses all digits of a narrow cone.
    sx, sy, sz = v[far, 1] * bz - v[far, 2] * by, v[far, 2] * bx - v[far, 0] * bz, v[far, 0] * by - v[far, 1] * bx
    return bx, by, bz, best, math.sqrt(sx * sx + sy * sy + sz * sz)


@helper
def facing_of_cone(points, ax, ay, az, cos, sin, eye):
    """Facing of a patch with control points float64[16, 3] and normals in the cone of axis a and half angle (cos, sin).

    Shirman and Abi-Ezzi 1993: all normals are back-facing at p where (e - p) . a <= -sin |e - p|. A cone about the line along
    a through the middle of the points' lateral extent holds the points, with its apex l at the least height h_i - r_i tan;
    then (e - l) . a <= -sin |e - l| answers for the whole hull. Front-facing: the greatest h_i + r_i tan, and >= +sin.
    """
    cos, sin = cos - PAD, sin + PAD
    if not cos > 0.0:
        return SILHOUETTE
    tan = sin / cos * (1.0 + PAD)
    # Two axes across a.
    if abs(ax) < 0.6:
        ux, uy, uz = 0.0, az, -ay
    else:
        ux, uy, uz = -az, 0.0, ax
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    vx, vy, vz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    ox, oy, oz = points[0, 0], points[0, 1], points[0, 2]
    u0 = u1 = v0 = v1 = size = 0.0
    for k in range(16):
        px, py, pz = points[k, 0] - ox, points[k, 1] - oy, points[k, 2] - oz
        u, v = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        size = max(size, abs(px), abs(py), abs(pz))
    mid_u, mid_v = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    lo, hi = np.inf, -np.inf
    for k in range(16):
        px, py, pz = points[k, 0] - ox, points[k, 1] - oy, points[k, 2] - oz
        u, v = px * ux + py * uy + pz * uz - mid_u, px * vx + py * vy + pz * vz - mid_v
        h, r = px * ax + py * ay + pz * az, math.sqrt(u * u + v * v)
        lo, hi = min(lo, h - r * tan), max(hi, h + r * tan)
    slack = PAD * size * (1.0 + tan)
    ex = eye[0] - ox - mid_u * ux - mid_v * vx
    ey = eye[1] - oy - mid_u * uy - mid_v * vy
    ez = eye[2] - oz - mid_u * uz - mid_v * vz
    dx, dy, dz = ex - (lo - slack) * ax, ey - (lo - slack) * ay, ez - (lo - slack) * az
    if dx * ax + dy * ay + dz * az < -sin * math.sqrt(dx * dx + dy * dy + dz * dz):
        return BACK
    dx, dy, dz = ex - (hi + slack) * ax, ey - (hi + slack) * ay, ez - (hi + slack) * az
    if dx * ax + dy * ay + dz * az > sin * math.sqrt(dx * dx + dy * dy + dz * dz):
        return FRONT
    return SILHOUETTE
