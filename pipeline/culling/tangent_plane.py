"""`backface:tangent_plane`: the parametric tangent plane of Loop, Niessner, Eisenacher 2011, section 4.

The tangent plane at (u, v) is T = cross4(S, S_u, S_v), of bi-degree (7, 7) for a bicubic patch S of homogeneous points;
e . T = w^3 (e - p) . (p_u x p_v), so the signs of its 64 Bernstein coefficients answer for the whole patch. Each is a sum
of weighted products of three control points, 516 in all (`tangent_plane_table`). Rational patches need no other formula,
only all w > 0.

Evaluated relative to the eye: with a = xyz - w e, e . cross4(A, B, C) = -det[a, b, c], and by differences:
det[a, b - a, c - a] is exactly zero where two of the points coincide.

Exact for the smooth patch; a coarse tessellation may still have a front-facing triangle (`docs/backface.md`).

Decision, P rule: no coefficient is above the noise and some is below it. So edges that collapse to a point (whose
coefficients are zero) do not save a patch; a patch seen edge-on is a silhouette. The N rule (all 64 are below 0) never
culls a patch with a collapsed edge. Noise: 1e-13 of the largest coefficient, for zeros that come out of cancelling
products, and 1e-15 |a|^2 max|b - a|, for what the subtraction of the eye rounds. Where weights differ also 1e-12 |a|
max|b - a|^2, for what the products round: b - a is then as large as a, however small the patch, and products cancel. There
a coefficient within the noise may have either sign; unless it is exactly zero it makes the patch a silhouette.

Patches are worked off in blocks of LANES, one lane each, so that every product is a short loop that vectorizes.
"""

import numpy as np

from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, classify_with, cull_facing
from pipeline.culling.tangent_plane_table import POINTS, TARGET, WEIGHT
from pipeline.jit import helper, kernel
from pipeline.types import F32, F64, I64, U8, HullInput, PatchBounds

LANES = 32
NUM_TERMS = len(TARGET)


@helper
def sum_products(x, y, z, t, normal):
    """Bernstein coefficients of det[Q, Q_u, Q_v] of LANES bicubic vector patches Q; t modified in place.

    x, y, z : float64[16, LANES], control vectors 4 i + j. t : float64[64, LANES]. normal : float64[3, LANES], scratch.
    """
    for k in range(64):
        for lane in range(LANES):
            t[k, lane] = 0.0
    nx, ny, nz = normal[0], normal[1], normal[2]
    before_a = before_b = np.int64(-1)
    for s in range(NUM_TERMS):
        a, b, c = POINTS[s, 0], POINTS[s, 1], POINTS[s, 2]
        ax, ay, az = x[a], y[a], z[a]
        if a != before_a or b != before_b:  # terms come in the order of their first two points
            bx, by, bz = x[b], y[b], z[b]
            for lane in range(LANES):
                dx, dy, dz = bx[lane] - ax[lane], by[lane] - ay[lane], bz[lane] - az[lane]
                nx[lane] = ay[lane] * dz - az[lane] * dy
                ny[lane] = az[lane] * dx - ax[lane] * dz
                nz[lane] = ax[lane] * dy - ay[lane] * dx
            before_a, before_b = a, b
        cx, cy, cz, target = x[c], y[c], z[c], t[TARGET[s]]
        weight = WEIGHT[s]
        for lane in range(LANES):
            det = (nx[lane] * (cx[lane] - ax[lane]) + ny[lane] * (cy[lane] - ay[lane])) + nz[lane] * (
                cz[lane] - az[lane]
            )
            target[lane] += weight * det


@helper
def _load(cp, eye, lane, x, y, z):
    """Put a patch's eye-relative control vectors into a lane. The noise of its coefficients, NaN where a weight is <= 0,
    and whether its weights differ.

    A product's 10 roundings (2^-53) are relative to its 6 terms, each at most |a| (2 widest)^2; the greatest sum of |weight|
    of a target is 9, and adding its 21 products rounds as often: below 9 * 24 * 31 * 2^-53 = 7.5e-13.
    """
    ex, ey, ez = eye[0], eye[1], eye[2]
    largest = widest = 0.0
    fine = True
    uneven = False
    for k in range(16):
        i, j = k >> 2, k & 3
        w = np.float64(cp[i, j, 3])
        if cp[i, j, 3] != cp[0, 0, 3]:
            uneven = True
        if not w > 0.0:
            fine = False
        px, py, pz = cp[i, j, 0] - w * ex, cp[i, j, 1] - w * ey, cp[i, j, 2] - w * ez
        x[k, lane], y[k, lane], z[k, lane] = px, py, pz
        largest = max(largest, abs(px), abs(py), abs(pz))
        widest = max(widest, abs(px - x[0, lane]), abs(py - y[0, lane]), abs(pz - z[0, lane]))
    noise = (1e-15 * largest + (1e-12 * widest if uneven else 0.0)) * (largest * widest)
    return noise if fine else np.nan, uneven


@helper
def _count(t, noise, uneven, negative, positive):
    """Numbers of coefficients of e . T = -t below and above the noise, in each lane; 0 and 0 where one is not finite.

    Where weights differ, one within the noise but not zero counts as both.
    """
    for lane in range(LANES):
        largest = total = 0.0
        for k in range(64):
            largest = max(largest, abs(t[k, lane]))
            total += t[k, lane]
        tolerance = max(1e-13 * largest, noise[lane])
        negative[lane] = positive[lane] = 0
        if abs(total) < np.inf and noise[lane] >= 0.0:  # else nothing is known
            for k in range(64):
                doubtful = uneven[lane] and abs(t[k, lane]) <= tolerance and t[k, lane] != 0.0
                negative[lane] += doubtful or t[k, lane] > tolerance
                positive[lane] += doubtful or t[k, lane] < -tolerance


@kernel
def _sign_counts(control_points, eyes, numbers, out):
    x, y, z = np.zeros((16, LANES)), np.zeros((16, LANES)), np.zeros((16, LANES))
    t, normal, noise = np.empty((64, LANES)), np.empty((3, LANES)), np.empty(LANES)
    negative, positive, uneven = np.empty(LANES, np.int64), np.empty(LANES, np.int64), np.zeros(LANES, np.bool_)
    for first in range(0, len(numbers), LANES):
        n = min(LANES, len(numbers) - first)
        for lane in range(n):
            noise[lane], uneven[lane] = _load(control_points[numbers[first + lane]], eyes[first + lane], lane, x, y, z)
        sum_products(x, y, z, t, normal)
        _count(t, noise, uneven, negative, positive)
        for lane in range(n):
            out[first + lane, 0], out[first + lane, 1] = negative[lane], positive[lane]


def sign_counts(stage: HullInput, numbers: I64) -> U8:
    """N_cnt and P_cnt: how many of the 64 coefficients of e . T lie below and above the noise; uint8[len(numbers), 2].

    (0, 0) for what is not known. N rule: back-facing where N_cnt = 64. P rule: where P_cnt = 0 and N_cnt > 0.
    """
    counts = np.zeros((len(numbers), 2), np.uint8)
    _sign_counts(stage.patches.control_points, np.tile(stage.eye, (len(numbers), 1)), numbers, counts)
    return counts


def face_pairs(control_points: F32, eyes: F64, numbers: I64) -> U8:
    """Facing of patch numbers[k] to the eye eyes[k], by the P rule: uint8[n]; eyes : float64[n, 3]."""
    counts = np.zeros((len(numbers), 2), np.uint8)
    _sign_counts(control_points, eyes, numbers, counts)
    negative, positive = counts[:, 0] > 0, counts[:, 1] > 0
    facing = np.full(len(numbers), SILHOUETTE, np.uint8)
    facing[negative & ~positive] = BACK
    facing[positive & ~negative] = FRONT
    return facing


def _classify(control_points: F32, rational: U8, eye: F64, numbers: I64, out: U8) -> None:
    out[:] = face_pairs(control_points, np.tile(eye, (len(numbers), 1)), numbers)


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the patches `numbers` by the P rule, uint8; SILHOUETTE for displaced ones."""
    return classify_with(_classify, stage, numbers)


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
