"""Uniform bicubic B-spline surfaces as Bezier patches that meet without a crack, bit for bit.

A displaced surface has no cracks when both patches of a shared edge compute the same float32 position there. The shader
reads two things along an edge: the edge's control points, and the differences to the next row of control points (they
give the cross tangent, and so the normal). So both must be equal in every bit on the two sides.

A uniform B-spline has them equal in real numbers: at a knot with de Boor points a, b, c the Bezier points are
(a+2b)/3, (a+4b+c)/6, (2b+c)/3, and the two differences are both (c-a)/6. Here they are equal in the machine too, because
nothing is ever rounded: de Boor points are whole multiples of 36 * 2^-16, so that every Bezier point, with its division
by 6 along u and by 6 along v, is a whole multiple of 2^-16; and no coordinate exceeds 128, so that points and
differences have 24 bits at most and are exact in float32. (A vertex shader that scales by other than powers of two
rounds again, and then nothing is promised.)
"""

import numpy as np

from pipeline.types import F32, F64, I64

UNIT = 2.0**-16  # world units; every control point is a whole multiple of it
STEP = 36 * UNIT  # de Boor points are whole multiples of it
LIMIT = 128.0  # largest coordinate: differences then stay below 2^24 units

# Bezier points of a segment, times 6, from the four de Boor points that it depends on.
_SEGMENT = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]])


def on_grid(values: F64) -> F64:
    """The nearest multiples of STEP. Sums of them, and negatives, are multiples again: builders that mirror a net need it."""
    return np.rint(values / STEP) * STEP


def bezier_patches(net: F64, *, periodic_u: bool = False, periodic_v: bool = False) -> F32:
    """Bezier points (P, 4, 4, c) float32 of the B-spline with de Boor points `net` (m, n, c), i along u, j along v.

    A periodic direction of m points gives m segments, and the last meets the first; an open one gives m - 3. Patches
    come with v running fastest: patch number = (segment along u) * (segments along v) + (segment along v).
    Points are first moved to the nearest multiples of STEP. Raises ValueError where a coordinate exceeds LIMIT.
    """
    if not (np.abs(net) <= LIMIT).all():
        raise ValueError(f"de Boor points up to {np.abs(net).max():g} are not allowed; allowed: at most {LIMIT:g}")
    units: I64 = np.rint(net / STEP).astype(np.int64) * 36
    along_u = _windows(units, 0, periodic_u)  # (segments u, 4, n, c)
    rows = np.einsum("ia,uanc->uinc", _SEGMENT, along_u)
    along_v = _windows(rows, 2, periodic_v)  # (segments u, i, segments v, 4, c)
    points = np.einsum("jb,uivbc->uvijc", _SEGMENT, along_v) // 36
    return np.ascontiguousarray((points * UNIT).astype(np.float32).reshape(-1, 4, 4, net.shape[2]))


def _windows(values: I64, axis: int, periodic: bool) -> I64:
    """The runs of four consecutive entries along `axis`; the axis becomes two, (run, position in the run).

    Of a periodic axis, run k starts one entry before k, so that segment k begins at de Boor point k.
    """
    count = values.shape[axis]
    first = np.arange(count) - 1 if periodic else np.arange(count - 3)
    return np.take(values, (first[:, None] + np.arange(4)) % count, axis=axis)
