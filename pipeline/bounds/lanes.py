"""Blocks of patches, one lane each: what the batched bounds share.

A block is LANES patches in rows of one scratch array, row k at s[k * LANES : (k + 1) * LANES]; a step is one loop over the
lanes, and the rows it touches are at literal distances, so that LLVM sees without run-time checks that no store meets a
later load, and vectorizes it. Steps have no branch but selects; what would need one (a frame that degenerates, a box that
crosses the near plane, a sub-domain whose tangents vanish at a corner) goes to the scalar functions, lane by lane.

A step must also be large, about twenty operations a lane: a smaller loop LLVM takes apart before it looks for vectors, and
works it off number by number; and for what was stored so, or in halves, the next step's vectors wait until it has left the
processor. So small things are done where large ones are, copies are whole vectors (`rows`, `spread`), and differences are
made again rather than kept. It was a third of the time of `npatch` and half of that of the projection.

The last block of a batch is filled up with its last patch.
"""

import numpy as np

from pipeline.bounds.restrict import cut_cubic, cut_quadratic
from pipeline.jit import helper, inlined
from pipeline.types import F64

LANES = 16


def padded(n: int) -> int:
    """n rounded up to whole blocks."""
    return -(-n // LANES) * LANES


def columns(n: int) -> int:
    """Length of rows over n patches: whole blocks, odd in number, so that rows do not fall on the same lines of a cache."""
    return padded(n) + (padded(n) // LANES + 1) % 2 * LANES


def scratch(rows: int) -> F64:
    """Rows of one block."""
    return np.zeros(rows * LANES)


@helper
def aligned(numbers):
    """Array without its first few numbers, 15 at most, so that it begins where a line of a cache of 64 bytes does.

    Rows of a block then lie in whole lines: vectors of 512 bits that begin elsewhere cost two accesses.
    """
    return numbers[(-numbers.ctypes.data % 64) // numbers.itemsize :]


@helper
def load_points(control_points, first, n, x, s):
    """Homogeneous control points float32[n, 64] of a block: rows x + 4 i + j, then 16 rows each for y, z and w."""
    for lane in range(LANES):
        cp = control_points[min(first + lane, n - 1)]
        for k in range(16):
            s[(x + k) * LANES + lane] = cp[4 * k]
            s[(x + 16 + k) * LANES + lane] = cp[4 * k + 1]
            s[(x + 32 + k) * LANES + lane] = cp[4 * k + 2]


@helper
def load_weights(control_points, first, n, w, s):
    """Their weights: rows w + 4 i + j."""
    for lane in range(LANES):
        cp = control_points[min(first + lane, n - 1)]
        for k in range(16):
            s[(w + k) * LANES + lane] = cp[4 * k + 3]


@helper
def load_domains(domain, first, n, u0, s):
    """Rows u0 .. u0 + 3 of domain float64[n, 4]; returns whether each is the whole patch."""
    whole = True
    for lane in range(LANES):
        p = min(first + lane, n - 1)
        for c in range(4):
            s[(u0 + c) * LANES + lane] = domain[p, c]
        whole &= domain[p, 0] == 0.0 and domain[p, 1] == 1.0 and domain[p, 2] == 0.0 and domain[p, 3] == 1.0
    return whole


@inlined
def _row(s, k):
    return s[k * LANES : (k + 1) * LANES]


@helper
def _cut_cubics(s, k, step, ends):
    """Restrict one cubic curve of each lane, rows k, k + step, ...; ends: row of the lower end, the upper follows."""
    p0, p1, p2, p3 = _row(s, k), _row(s, k + step), _row(s, k + 2 * step), _row(s, k + 3 * step)
    a, b = _row(s, ends), _row(s, ends + 1)
    for lane in range(LANES):
        p0[lane], p1[lane], p2[lane], p3[lane] = cut_cubic(p0[lane], p1[lane], p2[lane], p3[lane], a[lane], b[lane])


@helper
def _cut_quadratics(s, k, step, ends):
    p0, p1, p2 = _row(s, k), _row(s, k + step), _row(s, k + 2 * step)
    a, b = _row(s, ends), _row(s, ends + 1)
    for lane in range(LANES):
        p0[lane], p1[lane], p2[lane] = cut_quadratic(p0[lane], p1[lane], p2[lane], a[lane], b[lane])


@helper
def restrict_rows(s, first, nets, rows, columns, u0):
    """Restrict nets of Bezier control values, rows x columns (3 or 4) each, one after the other from row `first`.

    u0 : row of the domains. The arithmetic is that of `restrict.restrict_net`; the whole domain changes no bit.
    """
    for net in range(nets):
        base = first + net * rows * columns
        for j in range(columns):
            if rows == 4:
                _cut_cubics(s, base + j, columns, u0)
            else:
                _cut_quadratics(s, base + j, columns, u0)
        for i in range(rows):
            if columns == 4:
                _cut_cubics(s, base + columns * i, 1, u0 + 2)
            else:
                _cut_quadratics(s, base + columns * i, 1, u0 + 2)


@inlined
def least4(a, b, c, d):
    """Least of four."""
    return min(min(a, b), min(c, d))


@inlined
def most4(a, b, c, d):
    """Greatest of four."""
    return max(max(a, b), max(c, d))
