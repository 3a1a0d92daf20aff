"""The tangent-plane test for many eyes: the 64 control planes of each patch once, then 64 dot products an eye.

e . T is linear in the eye. About a point o of the patch its coefficients are n_k . (e - o) + d_k with

    n_k = sum W wa wb wc (b - a) x (c - a),    d_k = sum W wa wb wc (o - a) . ((b - a) x (c - a))

over the products of `tangent_plane_table`. Decisions are those of `tangent_plane`, bit for bit: where the least or the
greatest coefficient is so close to 0 that either way of rounding could decide otherwise, that test itself is asked.

How close. Let D be the patch's radius about o, w its largest weight, |p| the largest coordinate, L = |e - o| + D. A target's
|W| add up to at most 9, so with |b - a| <= 2 D its terms to 36 w^3 D^2 L; some 40 roundings each, and those of a = P / w,
2^-53 |p|, are below 36 w^3 D L (2e-14 D + 4e-15 (|p| + |e|)). `tangent_plane` itself is off by less than its noise, and
calls zero what is within that or 1e-13 of the largest; twice both are added.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.culling import tangent_plane
from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, is_plain
from pipeline.culling.cones import projected
from pipeline.culling.tangent_plane_table import POINTS, TARGET, WEIGHT
from pipeline.jit import helper, kernel
from pipeline.types import F64, I64, U8, Patches

LANES = 64  # eyes at a time
X, Y, Z, LEAST, MOST = (k * LANES for k in range(5))
UNDECIDED = 255


class Planes(NamedTuple):
    """Control planes of n patches."""

    numbers: I64  # (n,) the patches
    plane: F64  # (n, 64, 4) n_k, d_k
    origin: F64  # (n, 3) o
    radius: F64  # (n,) D; NaN where a weight is <= 0 or something is not finite: then nothing is told
    weight: F64  # (n,) w
    size: F64  # (n,) |p|
    uneven: U8  # (n,) 1 where weights differ


@helper
def _fill_planes(cp, points, plane):
    plane[:] = 0.0
    for s in range(len(TARGET)):
        i, j, k = POINTS[s, 0], POINTS[s, 1], POINTS[s, 2]
        a, b, c, row = points[i], points[j], points[k], plane[TARGET[s]]
        wa, wb = np.float64(cp[i >> 2, i & 3, 3]), np.float64(cp[j >> 2, j & 3, 3])
        weight = WEIGHT[s] * wa * wb * np.float64(cp[k >> 2, k & 3, 3])
        px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = weight * (py * qz - pz * qy), weight * (pz * qx - px * qz), weight * (px * qy - py * qx)
        row[0] += x
        row[1] += y
        row[2] += z
        row[3] -= (a[0] * x + a[1] * y) + a[2] * z


@kernel
def _make(control_points, planes):
    points = np.empty((16, 3))
    for k in range(len(planes.numbers)):
        cp = control_points[planes.numbers[k]]
        planes.radius[k] = np.nan
        if not projected(cp, points):
            continue
        weight = size = radius = 0.0
        for i in range(16):
            w = np.float64(cp[i >> 2, i & 3, 3])
            weight = max(weight, w)
            if cp[i >> 2, i & 3, 3] != cp[0, 0, 3]:
                planes.uneven[k] = 1
            for c in range(3):
                size = max(size, abs(points[i, c]))
        for c in range(3):
            planes.origin[k, c] = points[0, c]
        for i in range(16):
            for c in range(3):
                points[i, c] -= planes.origin[k, c]
            x, y, z = points[i]
            radius = max(radius, math.sqrt(x * x + y * y + z * z))
        _fill_planes(cp, points, planes.plane[k])
        if size < np.inf:
            planes.radius[k], planes.weight[k], planes.size[k] = radius, weight, size


def make_planes(patches: Patches, numbers: I64) -> Planes:
    """Control planes of the patches `numbers`; nothing is told of those that are not `is_plain`."""
    n = len(numbers)
    planes = Planes(
        np.asarray(numbers, np.int64), np.zeros((n, 64, 4)), np.zeros((n, 3)), np.empty(n), np.zeros(n), np.zeros(n),
        np.zeros(n, np.uint8),
    )  # fmt: skip
    _make(patches.control_points, planes)
    planes.radius[~is_plain(patches, planes.numbers)] = np.nan
    return planes


@helper
def _range_of(plane, rows):
    """Rows LEAST and MOST: least and greatest of the 64 coefficients for the eyes in rows X, Y, Z."""
    for lane in range(LANES):
        rows[LEAST + lane], rows[MOST + lane] = np.inf, -np.inf
    for k in range(0, 64, 2):
        ax, ay, az, ad = plane[k, 0], plane[k, 1], plane[k, 2], plane[k, 3]
        bx, by, bz, bd = plane[k + 1, 0], plane[k + 1, 1], plane[k + 1, 2], plane[k + 1, 3]
        for lane in range(LANES):
            x, y, z = rows[X + lane], rows[Y + lane], rows[Z + lane]
            a, b = (ax * x + ay * y) + (az * z + ad), (bx * x + by * y) + (bz * z + bd)
            low, high = (a, b) if a < b else (b, a)
            rows[LEAST + lane] = low if low < rows[LEAST + lane] else rows[LEAST + lane]
            rows[MOST + lane] = high if high > rows[MOST + lane] else rows[MOST + lane]


@helper
def _decide(low, high, distance, eye_size, planes, k):
    d, w = planes.radius[k], planes.weight[k]
    reach = distance + d
    doubt = 36.0 * w * w * w * d * reach * (2e-14 * d + 4e-15 * (planes.size[k] + eye_size))
    largest = 1.01 * w * reach
    if planes.uneven[k]:
        widest = 2.0 * largest
        noise = (1e-15 * largest + 1e-12 * widest) * largest * widest
    else:
        noise = 1e-15 * largest * largest * (2.02 * w * d)
    doubt += 2.0 * noise + 2e-13 * max(abs(low), abs(high))
    if low > doubt:
        return FRONT
    if high < -doubt:
        return BACK
    return SILHOUETTE if (high > doubt and low < -doubt) else UNDECIDED


@kernel
def _face_eyes(planes, x, y, z, out):
    rows = np.empty(5 * LANES)
    for k in range(len(planes.numbers)):
        if not planes.radius[k] >= 0.0:
            out[k, :] = SILHOUETTE
            continue
        ox, oy, oz = planes.origin[k]
        for first in range(0, len(x), LANES):
            n = min(LANES, len(x) - first)
            for lane in range(n):
                rows[X + lane], rows[Y + lane] = x[first + lane] - ox, y[first + lane] - oy
                rows[Z + lane] = z[first + lane] - oz
            for lane in range(n, LANES):
                rows[X + lane] = rows[Y + lane] = rows[Z + lane] = 0.0
            _range_of(planes.plane[k], rows)
            for lane in range(n):
                dx, dy, dz = rows[X + lane], rows[Y + lane], rows[Z + lane]
                distance = math.sqrt(dx * dx + dy * dy + dz * dz)
                e = first + lane
                eye_size = max(abs(x[e]), abs(y[e]), abs(z[e]))
                out[k, e] = _decide(rows[LEAST + lane], rows[MOST + lane], distance, eye_size, planes, k)


def face_eyes(planes: Planes, patches: Patches, eyes: F64) -> U8:
    """Facing of each patch to each eye, uint8[patches, eyes], as `tangent_plane` has it; eyes : float64[eyes, 3]."""
    eyes = np.ascontiguousarray(eyes, np.float64)
    out = np.empty((len(planes.numbers), len(eyes)), np.uint8)
    _face_eyes(planes, *np.ascontiguousarray(eyes.T), out)
    out[:, ~np.isfinite(eyes).all(axis=1)] = SILHOUETTE
    patch, eye = np.nonzero(out == UNDECIDED)
    out[patch, eye] = tangent_plane.face_pairs(patches.control_points, eyes[eye], planes.numbers[patch])
    return out
