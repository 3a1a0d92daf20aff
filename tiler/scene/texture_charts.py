"""How much of its texture a mesh uses: its faces drawn into a grid of texels, so that overlapping charts count once."""

import math

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F64, I64

GRID = 512  # texels along both sides of the unit square
MOST = 64.0  # faces farther from the unit square are left out: no chart of a texture lies there


@helper
def _span(a, b, y, low, high):
    """The span low .. high, wider by where edge a-b crosses the line at y."""
    if (a[1] <= y) == (b[1] <= y):
        return low, high
    x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    return min(low, x), max(high, x)


@helper
def _mark(row, begin, end):
    """One more from texel `begin` to before `end` of a row that repeats; row holds differences, GRID + 1 of them."""
    if end - begin >= GRID:
        begin, end = 0, GRID
    first = begin % GRID
    last = first + end - begin
    row[first] += 1
    row[min(last, GRID)] -= 1
    if last > GRID:
        row[0] += 1
        row[last - GRID] -= 1


@helper
def _draw_triangle(a, b, c, rows):
    for line in range(
        math.ceil(min(a[1], b[1], c[1]) * GRID - 0.5), math.floor(max(a[1], b[1], c[1]) * GRID - 0.5) + 1
    ):
        y = (line + 0.5) / GRID
        low, high = np.inf, -np.inf
        for p, q in ((a, b), (b, c), (c, a)):
            low, high = _span(p, q, y, low, high)
        if low <= high:
            begin, end = math.ceil(low * GRID - 0.5), math.floor(high * GRID - 0.5) + 1
            if begin < end:
                _mark(rows[line % GRID], begin, end)


@kernel
def _draw_faces(face_first, st, rows):
    for f in range(len(face_first) - 1):
        begin, end = face_first[f], face_first[f + 1]
        near = True
        for k in range(begin, end):
            near &= abs(st[k, 0]) <= MOST and abs(st[k, 1]) <= MOST
        if near:
            a = (st[begin, 0], st[begin, 1])
            for k in range(begin + 1, end - 1):
                _draw_triangle(a, (st[k, 0], st[k, 1]), (st[k + 1, 0], st[k + 1, 1]), rows)


def texture_coverage(face_first: I64, st: F64) -> float:
    """Part of the unit square's GRID x GRID texel centres that some face covers; coordinates wrap around.

    face_first : (F+1,), corners of face f are face_first[f]:face_first[f+1]. st : (corners, 2). Faces are fans of triangles.
    """
    rows = np.zeros((GRID, GRID + 1), np.int64)
    _draw_faces(face_first, st, rows)
    return float((np.cumsum(rows, axis=1)[:, :GRID] > 0).mean())
