"""A bound and a back-patch test of one's own: the example of docs/extending.md."""

import numpy as np
from numba import njit

import tiler


def diagonal_box(points, reach, center, axes):
    """A box along the patch's diagonals: the first axis from corner to corner, the second across, the third at right angles.

    points float64[16, 3], reach float64; fills center float64[3] and axes float64[3, 3].
    """
    for c in range(3):
        axes[0, c] = points[15, c] - points[0, c]
        axes[1, c] = points[12, c] - points[3, c]
    _normalize(axes[0])
    along = axes[1, 0] * axes[0, 0] + axes[1, 1] * axes[0, 1] + axes[1, 2] * axes[0, 2]
    for c in range(3):
        axes[1, c] -= along * axes[0, c]
    _normalize(axes[1])
    for c in range(3):
        axes[2, c] = axes[0, (c + 1) % 3] * axes[1, (c + 2) % 3] - axes[0, (c + 2) % 3] * axes[1, (c + 1) % 3]
    center[:] = 0.0
    for r in range(3):  # the slab between the first and the last control point, and what displacement adds
        first = last = points[0, 0] * axes[r, 0] + points[0, 1] * axes[r, 1] + points[0, 2] * axes[r, 2]
        for k in range(1, 16):
            at = points[k, 0] * axes[r, 0] + points[k, 1] * axes[r, 1] + points[k, 2] * axes[r, 2]
            first, last = min(first, at), max(last, at)
        for c in range(3):
            center[c] += 0.5 * (first + last) * axes[r, c]
        half = 0.5 * (last - first) + reach
        for c in range(3):
            axes[r, c] *= half


@njit
def _normalize(a):
    """Scale to length 1; a NaN where the length is 0, which says nothing of the patch."""
    length = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    for c in range(3):
        a[c] = a[c] / length


def all_products(points, eye):
    """2 if (eye - p) . (p_u x p_v) <= 0 everywhere, 1 if it is >= 0 everywhere, else 0.

    By the signs of all products of a control point, a difference along u and a difference along v: the polynomial is a sum of
    them with weights >= 0.
    """
    least, greatest, size = np.inf, -np.inf, 0.0
    for i in range(3):
        for j in range(4):
            ux = points[4 * i + 4 + j, 0] - points[4 * i + j, 0]
            uy = points[4 * i + 4 + j, 1] - points[4 * i + j, 1]
            uz = points[4 * i + 4 + j, 2] - points[4 * i + j, 2]
            for k in range(4):
                for m in range(3):
                    vx = points[4 * k + m + 1, 0] - points[4 * k + m, 0]
                    vy = points[4 * k + m + 1, 1] - points[4 * k + m, 1]
                    vz = points[4 * k + m + 1, 2] - points[4 * k + m, 2]
                    area = (abs(ux) + abs(uy) + abs(uz)) * (abs(vx) + abs(vy) + abs(vz))
                    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                    for p in range(16):
                        ex, ey, ez = eye[0] - points[p, 0], eye[1] - points[p, 1], eye[2] - points[p, 2]
                        product = ex * nx + ey * ny + ez * nz
                        least, greatest = min(least, product), max(greatest, product)
                        size = max(size, (abs(ex) + abs(ey) + abs(ez)) * area)
    noise = 1e-12 * size  # far above what rounding can do to a product
    return 2 if greatest < -noise else (1 if least > noise else 0)


tiler.register_bound("diagonal", box=diagonal_box)
tiler.register_cull_test("backface:all_products", facing=all_products)
