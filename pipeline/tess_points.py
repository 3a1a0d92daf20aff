"""Domain points of a tessellation pattern: where the points of a side lie, and the walk that lists them.

D3D11.3 functional specification 11.7.5 (order in which points split), 11.7.9 (pattern), 11.7.13 (symmetry). The order
of the points is the reference tessellator's, which the specification leaves free.

All locations are 16-bit fractions: 0 .. ONE, in integers. u runs right and v down; (0, 0) is the top left corner.
"""

import numpy as np

from pipeline.jit import helper
from pipeline.tess_factors import NUM_SLOTS, ONE, QUAD, TRI
from pipeline.types import F32, I32, I64

HALF = ONE // 2
TWO_THIRDS = 0xAAAA  # truncated, as the reference has it: tri rings are therefore not quite symmetric
ONE_THIRD = 0x5555
MAX_SIDE_POINTS = 65

# RECIPROCAL[s] = ONE / s to the nearest integer, s segments on a side. Not to be "improved": 3 * RECIPROCAL[6] exceeds
# HALF, which makes points cross near the middle just above factor 6, and the reference does the same.
RECIPROCAL = np.array([0] + [(2 * ONE + s) // (2 * s) for s in range(1, MAX_SIDE_POINTS)], np.int64)


@helper
def half_factor(factor: int, odd: int) -> int:
    """Half of a 16.16 factor, so placed that its whole part numbers the levels of one half of a side."""
    h = (factor + 1) // 2
    if odd or h == HALF:  # the latter: an inside factor of one, taken as even
        h += HALF
    return h


@helper
def num_side_points(factor: int, odd: int) -> int:
    """Number of points on a side, both corners included."""
    return 2 * ((half_factor(factor, odd) + ONE - 1) >> 16) + 1 - odd


@helper
def splitting_point(whole: int, odd: int) -> int:
    """The point of a half side that splits in two between this level and the next.

    In each power-of-two generation the points split one after the other, from the corner to the middle.
    """
    m = whole - odd
    if m == 0:
        return 0
    top = 1
    while 2 * top <= m:
        top *= 2
    return 2 * (m - top) + 1


@helper
def place_side(factor: int, odd: int, row: I64) -> None:
    """Write the locations of a side's points to `row`, from corner 0 to corner ONE: a blend of two whole levels."""
    h = half_factor(factor, odd)
    below = h >> 16
    above = (h + ONE - 1) >> 16
    frac = h & (ONE - 1)
    step_below = RECIPROCAL[2 * below - odd]
    step_above = RECIPROCAL[2 * above - odd]
    split = splitting_point(below, odd) if frac else MAX_SIDE_POINTS
    last = 2 * above - odd
    for i in range(above):
        parent = i - 1 if i > split else i
        x = (parent * step_below * (ONE - frac) + i * step_above * frac + HALF) >> 16
        row[i] = x
        row[last - i] = ONE - x
    if not odd:
        row[above] = HALF


@helper
def _quad_ring(at: I64, n: I64, r: int, u: F32, v: F32, k: int) -> int:
    """List ring r of a quad from its bottom left corner, clockwise. Ring 0 is the border."""
    left, top, right, bottom = (0, 1, 2, 3) if r == 0 else (5, 4, 5, 4)
    for i in range(n[left] - 1 - r, r, -1):
        u[k], v[k] = at[4, r], at[left, i]
        k += 1
    for i in range(r, n[top] - 1 - r):
        u[k], v[k] = at[top, i], at[5, r]
        k += 1
    for i in range(r, n[right] - 1 - r):
        u[k], v[k] = at[4, n[4] - 1 - r], at[right, i]
        k += 1
    for i in range(n[bottom] - 1 - r, r, -1):
        u[k], v[k] = at[bottom, i], at[5, n[5] - 1 - r]
        k += 1
    return k


@helper
def _quad(at: I64, n: I64, u: F32, v: F32) -> None:
    rings = min(n[4], n[5]) // 2
    k = np.int64(0)  # not a literal 0, for which Numba would compile the ring a second time
    for r in range(rings):
        k = _quad_ring(at, n, r, u, v, k)
    if n[4] == 2:  # the minimal patch is one ring, and the only one to start top left
        for i in range(4):
            u[i] = at[4, (i + 1) // 2 % 2]
            v[i] = at[5, i // 2]
    elif n[4] > n[5] and n[5] & 1:  # a centre row along u
        for i in range(rings, n[4] - rings):
            u[k], v[k] = at[4, i], HALF
            k += 1
    elif n[5] >= n[4] and n[4] & 1:  # or a centre column, listed upwards
        for i in range(n[5] - 1 - rings, rings - 1, -1):
            u[k], v[k] = HALF, at[5, i]
            k += 1


@helper
def number_in_rows(n: I64, number: I64) -> int:
    """number[k] for each point k of a quad, as `fill_points` lists them: its place where the points inside come in rows.

    Those on the border stay as they are, first. The rings inside lie on the grid of the two inside factors: its rows, of
    constant v, follow one after the other. Returns the number of points.
    """
    border = n[0] + n[1] + n[2] + n[3] - 4
    for k in range(border):
        number[k] = k
    if n[4] == 2:
        return border
    last_u, last_v, k = n[4] - 1, n[5] - 1, border
    begin, width = border - n[4] + 1, n[4] - 2  # of column i in row j: begin + width * j + i
    rings = min(n[4], n[5]) // 2
    for r in range(1, rings):
        for j in range(last_v - r, r, -1):
            number[k] = begin + width * j + r
            k += 1
        for i in range(r, last_u - r):
            number[k] = begin + width * r + i
            k += 1
        for j in range(r, last_v - r):
            number[k] = begin + width * j + (last_u - r)
            k += 1
        for i in range(last_u - r, r, -1):
            number[k] = begin + width * (last_v - r) + i
            k += 1
    if n[4] > n[5] and n[5] & 1:
        for i in range(rings, n[4] - rings):
            number[k] = begin + width * (last_v // 2) + i
            k += 1
    elif n[5] >= n[4] and n[4] & 1:
        for j in range(last_v - rings, rings - 1, -1):
            number[k] = begin + width * j + last_u // 2
            k += 1
    return k


@helper
def _tri_ring(at: I64, n: I64, r: int, u: F32, v: F32, k: int) -> int:
    """List ring r of a tri from the corner v = 1, clockwise. Ring 0 is the border."""
    side_u, side_v, side_w = (0, 1, 2) if r == 0 else (3, 3, 3)
    inset = (at[3, r] * TWO_THIRDS + HALF) >> 16
    shift = (inset + 1) >> 1
    for i in range(n[side_u] - 1 - r, r, -1):
        u[k], v[k] = inset, at[side_u, i] - shift
        k += 1
    for i in range(r, n[side_v] - 1 - r):
        u[k], v[k] = at[side_v, i] - shift, inset
        k += 1
    for i in range(n[side_w] - 1 - r, r, -1):
        t = at[side_w, i] - shift
        u[k], v[k] = t, ONE - t - inset
        k += 1
    return k


@helper
def _tri(at: I64, n: I64, u: F32, v: F32) -> None:
    k = np.int64(0)
    for r in range(n[3] // 2):
        k = _tri_ring(at, n, r, u, v, k)
    if n[3] & 1:
        u[k], v[k] = ONE_THIRD, ONE_THIRD


@helper
def _isoline(at: I64, n: I64, u: F32, v: F32) -> None:
    k = 0
    for line in range(n[0] - 1):  # none is drawn at v = 1
        for i in range(n[1]):
            u[k], v[k] = at[1, i], at[0, line]
            k += 1


@helper
def fill_points(domain: int, key: I32, n: I64, at: I64, u: F32, v: F32) -> None:
    """Write the domain points of the pattern `key`, whose sides have `n` points, to `u` and `v`.

    at : int64 (6, 65), scratch: the locations along each side.
    """
    for s in range(NUM_SLOTS):
        if n[s] > 0:
            place_side(np.int64(key[s]), 1 - (n[s] & 1), at[s])
    if domain == QUAD:
        _quad(at, n, u, v)
    elif domain == TRI:
        _tri(at, n, u, v)
    else:
        _isoline(at, n, u, v)
    for k in range(u.size):  # from integers to fractions: exact, at most 17 significant bits
        u[k] /= np.float32(ONE)
        v[k] /= np.float32(ONE)
