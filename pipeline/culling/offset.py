"""Patches displaced by a constant: offset surfaces, whose normals are those of their base while t * curvature < 1.

Munkberg et al. 2010, section 5.3, test such patches with the cone of the base normals. The offset surface d = p + t n has
d_u x d_v = (1 - t k1)(1 - t k2) p_u x p_v, k1 and k2 the principal curvatures: where t goes past a centre of curvature
the normal turns over, and the test is wrong. A sufficient condition over the whole patch: for every direction (x, y)

    |t| |n_u x + n_v y| <= |t| sqrt(|n_u|^2 + |n_v|^2) |(x, y)| < |(x, y)| |N| / sqrt(|p_u|^2 + |p_v|^2) <= |p_u x + p_v y|,

as the smaller eigenvalue of the first fundamental form is at least det / trace. |N| is at least the least height of its
control vectors above the middle of their cone, |n_u| = |n x N_u| / |N| at most the largest |a x N_u| + |n - a| |N_u| over
the control vectors of N_u, divided by that. Then d_u and d_v keep their orientation, and the normals the base's direction.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.bounds.restrict import domain_displacement, texcoord_rect
from pipeline.culling.backface import is_plain, is_single_net
from pipeline.culling.normal_cone import longest_differences, make_work, normal_cone
from pipeline.jit import helper, kernel
from pipeline.minmax import texel_range
from pipeline.types import B1, F64, I64, HullInput


class Offsets(NamedTuple):
    """How far the points of n patches are moved along their normals."""

    known: B1  # (n,) the patch is its base surface, or a regular offset surface of it
    t: F64  # (n, 2) least and greatest displacement

    def of(self, rows: I64) -> "Offsets":
        """Those of some of the patches."""
        return Offsets(self.known[rows], self.t[rows])


@helper
def _most_turning(normals, step, axis, apart):
    """Largest |n x N_u| (step 6) or |n x N_v| (1) over the patch, n within the distance `apart` of the axis."""
    most = 0.0
    for k in range(36):
        if (step == 1 and k % 6 == 5) or (step == 6 and k >= 30):
            continue
        x = 5.0 * (normals[k + step, 0] - normals[k, 0])
        y = 5.0 * (normals[k + step, 1] - normals[k, 1])
        z = 5.0 * (normals[k + step, 2] - normals[k, 2])
        cx, cy, cz = y * axis[2] - z * axis[1], z * axis[0] - x * axis[2], x * axis[1] - y * axis[0]
        most = max(most, math.sqrt(cx * cx + cy * cy + cz * cz) + apart * math.sqrt(x * x + y * y + z * z))
    return most


@helper
def is_regular_offset(cp, t, points, work):
    """Whether t * curvature < 1 is sure all over patch cp float32[4, 4, 4], all weights 1; points float64[16, 3]: scratch."""
    for k in range(16):
        for c in range(3):
            points[k, c] = np.float64(cp[k >> 2, k & 3, c]) - np.float64(cp[0, 0, c])
    axis, cosine, least, _ = normal_cone(cp, points, work)
    long_a, long_b, size = longest_differences(points)
    rounding = 4e-14 * size * (long_a + long_b)
    if not (cosine > 0.0 and least > 1e6 * rounding):
        return False
    apart = math.sqrt(max(2.0 - 2.0 * cosine, 0.0)) + 1e-6
    turn_u = _most_turning(work.normals, 6, axis, apart) + 20.0 * rounding
    turn_v = _most_turning(work.normals, 1, axis, apart) + 20.0 * rounding
    least = (least - rounding) / (1.0 + 1e-9)
    # N is 9 times the control vectors' sum, p_u and p_v 3 times the differences'.
    turning = (turn_u * turn_u + turn_v * turn_v) / (least * least)
    return t * t * turning * 9.0 * (long_a * long_a + long_b * long_b) < 81.0 * least * least


@kernel
def _measure(patches, maps, pyramids, numbers, known, t):
    points, work = np.empty((16, 3)), make_work()
    for k in range(len(numbers)):
        p = numbers[k]
        s0, s1, t0, t1 = texcoord_rect(patches.texcoords[p], 0.0, 1.0, 0.0, 1.0)
        lo, hi = texel_range(maps, pyramids, patches.map_id[p], s0, s1, t0, t1, False)
        if lo == hi:
            low, high = domain_displacement(
                patches.map_id[p], patches.texcoords[p], maps, pyramids, 0.0, 1.0, 0.0, 1.0, False
            )
            most = max(abs(low), abs(high))
            if low <= high and most < np.inf and is_regular_offset(patches.control_points[p], most, points, work):
                known[k], t[k, 0], t[k, 1] = True, low, high


def constant_offsets(stage: HullInput, numbers: I64) -> Offsets:
    """Offsets of the patches `numbers`: 0 for undisplaced ones; not known where the displacement varies, or is too large."""
    offsets = Offsets(is_plain(stage.patches, numbers), np.zeros((len(numbers), 2)))
    at = np.flatnonzero((stage.patches.map_id[numbers] >= 0) & is_single_net(stage, numbers))
    if len(at):
        known, t = np.zeros(len(at), np.bool_), np.zeros((len(at), 2))
        _measure(stage.patches, stage.maps, stage.pyramids, numbers[at], known, t)
        offsets.known[at], offsets.t[at] = known, t
    return offsets


def no_offsets(n: int) -> Offsets:
    """Offsets of n undisplaced patches."""
    return Offsets(np.ones(n, np.bool_), np.zeros((n, 2)))
