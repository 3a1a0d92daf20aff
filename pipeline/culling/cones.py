"""Control vectors of a patch's tangents and normals: every cone or box that holds them holds all directions.

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

import numpy as np

from pipeline.culling.tangent_plane_table import POINTS, TARGET, WEIGHT
from pipeline.jit import helper

PAD = 1e-12
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
