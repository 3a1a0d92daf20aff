"""Connectivity of a tessellation pattern: which domain points make a triangle, a line or a point.

D3D11.3 functional specification 11.7.9 and 11.7.15; the order of the triangles is the reference tessellator's.

Only the number of points on each side counts here: `n` points, in slot order (edges, then insides). An even `n` is a
side of odd parity; `n // 2` points lie on each half of it. An inside of two points is the minimal patch's alone.

Rings of points are closed loops, listed one after the other from the border inwards. A *row* is one side of a ring, as
point numbers; neighbouring rings are stitched row by row.
"""

import numpy as np

from pipeline.jit import helper
from pipeline.tess_factors import ISOLINE, LINE, POINT, QUAD, TRIANGLE_CCW
from pipeline.types import I64, U16

HALF_SLOTS = 32  # segments that a half side can have


def _birth_order() -> I64:
    """birth[i]: how many segments a half side must have before slot i, counted from the corner, is one of them."""
    birth = np.zeros(HALF_SLOTS + 1, np.int64)
    birth[1] = HALF_SLOTS
    for i in range(2, HALF_SLOTS + 1):
        twos = ((i - 1) & -(i - 1)).bit_length() - 1
        birth[i] = (16 >> twos) + ((i - 1) >> (twos + 1))
    return birth


BIRTH = _birth_order()
# The slots from 1 up that are alive at h segments lie in FIRST_SLOT[h] .. LAST_SLOT[h]; the others need no visit.
_ALIVE = [np.flatnonzero(BIRTH[1:] < h) + 1 for h in range(HALF_SLOTS + 1)]
FIRST_SLOT = np.array([a[0] if a.size else HALF_SLOTS + 1 for a in _ALIVE], np.int64)
LAST_SLOT = np.array([a[-1] if a.size else 0 for a in _ALIVE], np.int64)


@helper
def num_points(domain: int, n: I64) -> int:
    """Number of domain points, from the number of points on each side."""
    if domain == ISOLINE:
        return (n[0] - 1) * n[1]
    if domain == QUAD:
        return n[0] + n[1] + n[2] + n[3] - 4 + (n[4] - 2) * (n[5] - 2)
    z = n[3] // 2 - 1
    return n[0] + n[1] + n[2] - 3 + (3 * z * (z + 1) + 1 if n[3] & 1 else 3 * z * z)


@helper
def num_indices(domain: int, output: int, n: I64) -> int:
    """Length of the index list. A disc of V points, B of them on its border, has 2V - 2 - B triangles."""
    points = num_points(domain, n)
    if output == POINT:
        return points
    if domain == ISOLINE:
        return 2 * (n[0] - 1) * (n[1] - 1)
    if output == LINE:
        return 2 * (points - 1)
    border = n[0] + n[1] + n[2] - 3
    if domain == QUAD:
        border += n[3] - 1
    return 3 * (2 * points - 2 - border)


@helper
def _put(index: U16, k: int, flip: int, x: int, y: int, z: int) -> int:
    """Write the triangle x, y, z, given clockwise; counter-clockwise keeps the first corner and swaps the others."""
    index[k] = x
    index[k + 1 + flip] = y
    index[k + 2 - flip] = z
    return k + 3


@helper
def _fill_row(row: I64, base: int, offset: int, segments: int, perimeter: int, turn: int) -> None:
    """Write one side of the ring that starts at point `base`; the side begins `offset` segments along the loop.

    Beyond `turn` the loop comes back over its own points: only the last step does so, to the first point, or, in a ring
    folded flat (the innermost of an even inside), the whole second half.
    """
    for x in range(segments + 1):
        w = offset + x
        row[x] = base + (perimeter - w if w > turn else w)


@helper
def _stitch_transition(out: I64, num_out: int, inn: I64, num_in: int, index: U16, k: int, flip: int) -> int:
    """Stitch a border row to the first inner row, which may have any other number of segments.

    num_out, num_in : points on the whole border side, and on the whole inside in the same direction. Segments advance
    in birth order, so that each level only adds triangles to those of the level before. The halves mirror each other.
    """
    h_out = (num_out - 1) // 2
    h_in = (num_in - 1) // 2
    first = min(FIRST_SLOT[h_in], FIRST_SLOT[h_out])
    last = max(LAST_SLOT[h_in], LAST_SLOT[h_out])
    a = b = 0
    if h_out > 0:
        k = _put(index, k, flip, out[b], out[b + 1], inn[a])
        b += 1
    for i in range(first, last + 1):
        if BIRTH[i] < h_in:
            k = _put(index, k, flip, inn[a], out[b], inn[a + 1])
            a += 1
        if BIRTH[i] < h_out:
            k = _put(index, k, flip, out[b], out[b + 1], inn[a])
            b += 1
    if num_in % 2 == 0:  # the inner row has a middle segment
        k = _put(index, k, flip, inn[a], out[b], inn[a + 1])
        a += 1
    if num_out % 2 == 0:  # the border has one
        k = _put(index, k, flip, inn[a], out[b], out[b + 1])
        b += 1
    for i in range(last, first - 1, -1):
        if BIRTH[i] < h_out:
            k = _put(index, k, flip, out[b], out[b + 1], inn[a])
            b += 1
        if BIRTH[i] < h_in:
            k = _put(index, k, flip, inn[a], out[b], inn[a + 1])
            a += 1
    if h_out > 0:
        k = _put(index, k, flip, out[b], out[b + 1], inn[a])
    return k


@helper
def _stitch_regular(out: I64, inn: I64, count: int, index: U16, k: int, flip: int) -> int:
    """Stitch two inner rows; `inn` has `count` points, `out` two more. Diagonals point to the nearer corner."""
    k = _put(index, k, flip, out[0], out[1], inn[0])
    for a in range(count - 1):
        if a < count // 2:
            k = _put(index, k, flip, out[a + 1], inn[a + 1], inn[a])
            k = _put(index, k, flip, out[a + 1], out[a + 2], inn[a + 1])
        else:
            k = _put(index, k, flip, inn[a], out[a + 1], out[a + 2])
            k = _put(index, k, flip, inn[a], out[a + 2], inn[a + 1])
    return _put(index, k, flip, out[count], out[count + 1], inn[count - 1])


@helper
def _fill_centre_strip(n_u: int, n_v: int, first: int, out: I64, inn: I64, index: U16, k: int, flip: int) -> None:
    """Write the triangles inside the last ring of a quad, two points wide, whose points begin at `first`."""
    along_u = n_u > n_v
    m = abs(n_u - n_v) + 2
    turn = 1 if along_u else 0  # where in the loop of 2m points the outer row begins; the inner one ends just before
    for x in range(m):
        out[x] = first + turn + x
        inn[x] = first + (turn + 2 * m - 1 - x) % (2 * m)
    middle = m // 2 - 1
    mirrored = not along_u and n_v % 2 == 0
    for x in range(m - 1):
        if not mirrored:
            k = _put(index, k, flip, inn[x], out[x], out[x + 1])
            k = _put(index, k, flip, inn[x], out[x + 1], inn[x + 1])
        elif x != middle:  # the same diagonal, the first triangle begun at another corner
            k = _put(index, k, flip, out[x], out[x + 1], inn[x])
            k = _put(index, k, flip, inn[x], out[x + 1], inn[x + 1])
        else:
            k = _put(index, k, flip, out[x], inn[x + 1], inn[x])
            k = _put(index, k, flip, out[x], out[x + 1], inn[x + 1])


@helper
def _fill_triangles(domain: int, n: I64, rows: I64, index: U16, flip: int) -> None:
    sides = 4 if domain == QUAD else 3
    n_across = n[4] if domain == QUAD else n[3]  # points along sides 1 and 3: along u on a quad
    n_upright = n[5] if domain == QUAD else n[3]  # points along sides 0 and 2
    shorter = min(n_across, n_upright)
    innermost = (shorter - 1) // 2
    out, inn = rows[0], rows[1]
    perimeter = -sides
    for e in range(sides):
        perimeter += n[e]
    base = k = np.int64(0)  # not a literal 0, for which Numba would compile the helpers a second time
    for r in range(1, innermost + 1):
        inner_base = base + perimeter
        inner_perimeter = 0
        for e in range(sides):
            inner_perimeter += (n_across if e & 1 else n_upright) - 1 - 2 * r
        folded = r == innermost and shorter % 2 == 1
        inner_turn = inner_perimeter // 2 if folded else inner_perimeter - 1
        offset = inner_offset = np.int64(0)
        for e in range(sides):
            along = n_across if e & 1 else n_upright
            inner_segments = along - 1 - 2 * r
            segments = n[e] - 1 if r == 1 else inner_segments + 2
            _fill_row(out, base, offset, segments, perimeter, perimeter - 1)
            _fill_row(inn, inner_base, inner_offset, inner_segments, inner_perimeter, inner_turn)
            if r == 1:
                k = _stitch_transition(out, n[e], inn, along, index, k, flip)
            else:
                k = _stitch_regular(out, inn, inner_segments + 1, index, k, flip)
            offset += segments
            inner_offset += inner_segments
        base, perimeter = inner_base, inner_perimeter
    if shorter % 2 == 1:
        return
    if domain != QUAD:
        _put(index, k, flip, base, base + 1, base + 2)
    elif n_across > 2:
        _fill_centre_strip(n_across, n_upright, base, out, inn, index, k, flip)
    else:  # the minimal patch: its corners are listed from another one
        k = _put(index, k, flip, base, base + 1, base + 3)
        _put(index, k, flip, base + 1, base + 2, base + 3)


@helper
def _fill_lines(lines: int, points_per_line: int, index: U16) -> None:
    k = 0
    for line in range(lines):
        for i in range(points_per_line - 1):
            index[k] = line * points_per_line + i
            index[k + 1] = line * points_per_line + i + 1
            k += 2


@helper
def fill_indices(domain: int, output: int, n: I64, rows: I64, index: U16) -> None:
    """Write the index list of a pattern whose sides have `n` points. rows : int64 (2, 65), scratch.

    Answers as the reference does also where D3D11 forbids the output: lines through all points of a quad or tri.
    """
    if output == POINT:
        for k in range(index.size):
            index[k] = k
    elif domain == ISOLINE or output == LINE:
        lines = n[0] - 1 if domain == ISOLINE else 1
        _fill_lines(lines, n[1] if domain == ISOLINE else num_points(domain, n), index)
    else:
        _fill_triangles(domain, n, rows, index, 1 if output == TRIANGLE_CCW else 0)
