"""Limit positions and limit tangents at the vertices of a quad cage, as rows of weights (spec section 3, Loop and Schaefer
2008). Made once a topology; a frame only multiplies.

Weights hold cosines; libraries differ in their last bit, so cosines are rounded to multiples of 2^-40.

What the spec leaves open: a vertex kept in place with k >= 2 faces between its sharp edges has the tangents
cos(i th) (e_0 - v) + sin(i th) (e_k - v), th = pi / 2k, which keeps the property of its end, c = cos(th); one kept in place
without sharp edges takes the tangents of the smooth vertex.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.subdivision.topology import Rings, Topology, VertexKind
from pipeline.types import F64, I32, I64

GRID = 2.0**40
CREASE, CORNER = int(VertexKind.CREASE), int(VertexKind.CORNER)


class Rows(NamedTuple):
    """Sparse rows of weights: row r is the sum of weight[k] * point[source[k]] for k in first[r]:first[r+1]."""

    first: I64  # (rows+1,)
    source: I32
    weight: F64


@helper
def rounded_cos(x):
    """Cosine to a multiple of 2^-40."""
    return np.round(math.cos(x) * GRID) / GRID


@helper
def _ring_vertex(t, corner, end):
    """e_i of ring corner i; `end`: e_i+1."""
    return t.vertex[t.prev[corner]] if end else t.vertex[t.next[corner]]


@helper
def _diagonal(t, corner):
    return t.vertex[t.next[t.next[corner]]]


@helper
def _put(source, weight, at, vertex, value):
    source[at], weight[at] = vertex, value
    return at + 1


@kernel
def _position_rows(t, rings, first, source, weight):
    at = 0
    for v in range(len(rings.kind)):
        first[v] = at
        if t.around_first[v] == t.around_first[v + 1]:
            continue
        s = rings.sector[t.around[t.around_first[v]]]
        begin, end = rings.first[s], rings.first[s + 1]
        n = end - begin
        if rings.kind[v] == CORNER:
            at = _put(source, weight, at, v, 1.0)
        elif not rings.closed[s]:
            at = _put(source, weight, at, _ring_vertex(t, rings.corner[begin], False), 1.0 / 6.0)
            at = _put(source, weight, at, v, 4.0 / 6.0)
            at = _put(source, weight, at, _ring_vertex(t, rings.corner[end - 1], True), 1.0 / 6.0)
        else:
            total = n * (n + 5.0)
            at = _put(source, weight, at, v, n * n / total)
            for k in range(begin, end):
                at = _put(source, weight, at, _ring_vertex(t, rings.corner[k], False), 4.0 / total)
                at = _put(source, weight, at, _diagonal(t, rings.corner[k]), 1.0 / total)
    first[len(rings.kind)] = at
    return at


@helper
def _closed_tangent(t, rings, begin, n, i, source, weight, at):
    c = rounded_cos(math.pi / n)
    sigma = 1.0 / math.sqrt(4.0 + c * c)
    for j in range(n):
        corner = rings.corner[begin + (i + j) % n]
        alpha = (1.0 + sigma * c) / n * rounded_cos(2.0 * math.pi * j / n)
        beta = sigma / n * rounded_cos(math.pi * (2 * j + 1) / n)
        at = _put(source, weight, at, _ring_vertex(t, corner, False), alpha)
        at = _put(source, weight, at, _diagonal(t, corner), beta)
    return at


@helper
def _crease_tangent(t, rings, begin, k, i, v, source, weight, at):
    first = _ring_vertex(t, rings.corner[begin], False)
    last = _ring_vertex(t, rings.corner[begin + k - 1], True)
    th = math.pi / k
    c, ci, si = rounded_cos(th), rounded_cos(i * th), rounded_cos(math.pi / 2.0 - i * th)
    d = 3.0 * k + c
    ends = -(1.0 + 2.0 * c) * math.sqrt((1.0 + c) / (1.0 - c)) / d
    at = _put(source, weight, at, v, -4.0 * rounded_cos(math.pi / 2.0 - th) / d * si)
    at = _put(source, weight, at, first, 0.5 * ci + ends * si)
    at = _put(source, weight, at, last, -0.5 * ci + ends * si)
    for j in range(k):
        near, far = rounded_cos(math.pi / 2.0 - j * th), rounded_cos(math.pi / 2.0 - (j + 1) * th)
        if j > 0:
            at = _put(source, weight, at, _ring_vertex(t, rings.corner[begin + j], False), 4.0 * near / d * si)
        at = _put(source, weight, at, _diagonal(t, rings.corner[begin + j]), (near + far) / d * si)
    return at


@helper
def _corner_tangent(t, rings, begin, k, i, v, source, weight, at):
    first = _ring_vertex(t, rings.corner[begin], False)
    last = _ring_vertex(t, rings.corner[begin + k - 1], True)
    angle = i * math.pi / (2.0 * k)
    ci, si = rounded_cos(angle), rounded_cos(math.pi / 2.0 - angle)
    at = _put(source, weight, at, v, -(ci + si))
    at = _put(source, weight, at, first, ci)
    return _put(source, weight, at, last, si)


@kernel
def _tangent_rows(t, rings, row, first, source, weight):
    """row : (sectors,) number of the sector's first row, -1 = none; a sector of k corners has k rows, an open one k + 1."""
    at = 0
    for s in range(len(rings.closed)):
        begin, k = rings.first[s], rings.first[s + 1] - rings.first[s]
        if row[s] < 0:
            continue
        v = t.vertex[rings.corner[begin]]
        for i in range(k if rings.closed[s] else k + 1):
            first[row[s] + i] = at
            if rings.closed[s]:
                at = _closed_tangent(t, rings, begin, k, i, source, weight, at)
            elif rings.kind[v] == CREASE and k > 1:
                at = _crease_tangent(t, rings, begin, k, i, v, source, weight, at)
            else:
                at = _corner_tangent(t, rings, begin, k, i, v, source, weight, at)
    first[-1] = at
    return at


def position_rows(t: Topology, rings: Rings) -> Rows:
    """Limit position of every vertex; an empty row for those of no face."""
    most = len(rings.kind) * 3 + 2 * len(rings.corner)
    first, source, weight = np.empty(len(rings.kind) + 1, np.int64), np.empty(most, np.int32), np.empty(most)
    used = _position_rows(t, rings, first, source, weight)
    return Rows(first, source[:used].copy(), weight[:used].copy())


def tangent_rows(t: Topology, rings: Rings, wanted: np.ndarray) -> tuple[Rows, I32]:
    """Limit tangents along the edges of the wanted sectors (bool[sectors]), and each sector's first row, -1 for none."""
    k = np.diff(rings.first)
    rows = np.where(wanted, k + (rings.closed == 0), 0)
    row = np.where(wanted, np.cumsum(rows) - rows, -1).astype(np.int32)
    most = int((rows * (2 * k + 3)).sum())
    first, source, weight = np.empty(rows.sum() + 1, np.int64), np.empty(most, np.int32), np.empty(most)
    used = _tangent_rows(t, rings, row, first, source, weight)
    return Rows(first, source[:used].copy(), weight[:used].copy()), row


@helper
def _turn(kind, closed, k):
    """c of a sector: t_i-1 + t_i+1 = 2 c t_i."""
    if closed:
        return rounded_cos(2.0 * math.pi / k)
    if k == 1:
        return 0.0
    return rounded_cos(math.pi / k) if kind == CREASE else rounded_cos(math.pi / (2.0 * k))


@kernel
def _sector_numbers(t, rings, turn, fullness, reach):
    for s in range(len(rings.closed)):
        k = rings.first[s + 1] - rings.first[s]
        turn[s] = _turn(rings.kind[t.vertex[rings.corner[rings.first[s]]]], rings.closed[s], k)
        fullness[s], reach[s] = 4.0, 1.0 / 3.0
        if rings.closed[s]:
            c1, c2 = rounded_cos(math.pi / k), rounded_cos(2.0 * math.pi / k)
            fullness[s] = k
            reach[s] = (2.0 / 3.0) * (5.0 + c2 + c1 * math.sqrt(18.0 + 2.0 * c2)) / 16.0


def sector_numbers(t: Topology, rings: Rings) -> tuple[F64, F64, F64]:
    """Of each sector: its c (section 3), its N (section 4), and how far along the limit tangent a Gregory point lies."""
    turn, fullness, reach = np.empty((3, len(rings.closed)))
    _sector_numbers(t, rings, turn, fullness, reach)
    return turn, fullness, reach


@kernel
def _multiply(rows, points, out):
    for r in range(len(out)):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(rows.first[r], rows.first[r + 1]):
            weight, source = rows.weight[k], rows.source[k]
            x += weight * points[source, 0]
            y += weight * points[source, 1]
            z += weight * points[source, 2]
        out[r, 0], out[r, 1], out[r, 2] = x, y, z


def multiply(rows: Rows, points: F64) -> F64:
    """Rows applied to points float64[V, 3]: float64[rows, 3]."""
    out = np.empty((len(rows.first) - 1, 3))
    _multiply(rows, points, out)
    return out
