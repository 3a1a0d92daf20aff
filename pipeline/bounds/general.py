"""Equations 3 to 12 of Munkberg et al. 2010 for any bi-degree (m, n): plain NumPy float64, slow, no rounding analysis.

The twin of `cones`, which is the fast path for bicubic patches, and the reference for base patches of other degrees.
Everywhere a net is float64[m+1, n+1, k]: Bezier control values of bi-degree (m, n), first axis along u.

Where the paper's print is wrong this module is right: the product rule (equation 10) multiplies Bernstein polynomials of the
*same* variable, and the normal patch (equations 11 and 12) has bi-degree (2m-1, 2n-1), not m+n-1 in both.
"""

from math import comb

import numpy as np

from pipeline.types import F64


def bernstein(degree: int, t: F64 | float) -> F64:
    """Values of the Bernstein polynomials of a degree: float64[..., degree+1] for t of any shape."""
    t = np.asarray(t, np.float64)[..., None]
    k = np.arange(degree + 1)
    binomials = np.array([comb(degree, int(i)) for i in k], np.float64)
    return binomials * t**k * (1 - t) ** (degree - k)


def evaluate(net: F64, u: F64 | float, v: F64 | float) -> F64:
    """Value of a net at (u, v): float64[..., k] for u, v of the same shape."""
    m, n = net.shape[0] - 1, net.shape[1] - 1
    return np.einsum("...i,...j,ijk->...k", bernstein(m, u), bernstein(n, v), net)


def tangent_nets(points: F64) -> tuple[F64, F64]:
    """Derivatives along u and v of a polynomial patch: nets of bi-degree (m-1, n) and (m, n-1), equations 4 to 7.

    points : float64[m+1, n+1, 3].
    """
    m, n = points.shape[0] - 1, points.shape[1] - 1
    return m * np.diff(points, axis=0), n * np.diff(points, axis=1)


def multiply(a: F64, b: F64) -> F64:
    """Product of two nets of scalars, float64[m+1, n+1]; degrees add along each axis (equation 10, a variable at a time).

    B(m, i) B(n, j) = C(m, i) C(n, j) / C(m+n, i+j) B(m+n, i+j).
    """
    (rows_a, columns_a), (rows_b, columns_b) = a.shape, b.shape
    out = np.zeros((rows_a + rows_b - 1, columns_a + columns_b - 1))
    for i, j in np.ndindex(rows_a, columns_a):
        for k, h in np.ndindex(rows_b, columns_b):
            along_u = comb(rows_a - 1, i) * comb(rows_b - 1, k) / comb(rows_a + rows_b - 2, i + k)
            along_v = comb(columns_a - 1, j) * comb(columns_b - 1, h) / comb(columns_a + columns_b - 2, j + h)
            out[i + k, j + h] += along_u * along_v * a[i, j] * b[k, h]
    return out


def normal_patch(along_u: F64, along_v: F64) -> F64:
    """Net of the cross product of two nets of vectors: for tangents of a patch of bi-degree (m, n), (2m-1, 2n-1).

    Equations 8 to 12. Also for tangent patches of other degrees, which merely add.
    """

    def minor(c: int, d: int) -> F64:
        return multiply(along_u[..., c], along_v[..., d]) - multiply(along_u[..., d], along_v[..., c])

    return np.stack([minor(1, 2), minor(2, 0), minor(0, 1)], axis=-1)


def rational_tangent_nets(net: F64) -> tuple[F64, F64]:
    """Directions of both derivatives of a rational patch: w X_u - w_u X and w X_v - w_v X, with X = (wx, wy, wz).

    net : float64[m+1, n+1, 4], homogeneous, all w > 0; nets of bi-degree (2m-2, 2n) and (2m, 2n-2). They are w^2 times the
    derivatives: m (w_L X_R - w_R X_L) and n times the same along v, L and R the sub-nets without last and first row.
    """
    m, n = net.shape[0] - 1, net.shape[1] - 1

    def direction(left: F64, right: F64) -> F64:
        return np.stack(
            [multiply(left[..., 3], right[..., c]) - multiply(right[..., 3], left[..., c]) for c in range(3)], axis=-1
        )

    return m * direction(net[:-1], net[1:]), n * direction(net[:, :-1], net[:, 1:])


def frame(points: F64) -> F64:
    """Axes of the oriented box as rows, float64[3, 3], equation 3 and section 3.1.1; NaN for degenerate corners."""
    t = points[-1, 0] - points[0, 0] + points[-1, -1] - points[0, -1]
    b = points[0, -1] - points[0, 0] + points[-1, -1] - points[-1, 0]
    x, z = t / np.linalg.norm(t), np.cross(t, b)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])


def half_angle(vectors: F64, axis: F64) -> float:
    """Half angle, radians, of the smallest cone about a unit axis that holds all vectors (zero ones skipped).

    Sums of the vectors lie in it too if it is at most pi / 2, not beyond.
    """
    vectors = vectors.reshape(-1, 3)
    vectors = vectors[vectors.any(axis=1)]
    if not len(vectors):
        return np.pi
    return float(np.arctan2(np.linalg.norm(np.cross(vectors, axis), axis=1), vectors @ axis).max())
