"""The control-point phase of the hull shader for subdivision surfaces: the frame's points to patches (spec sections 4 to 7).

All arithmetic is float64, rounded to float32 once. What two patches share is computed once and read by both: limit
positions and tangents of a vertex, the two inner points of an edge. So shared boundary curves have the same bits.

A regular face becomes its exact bicubic patch. Another becomes, by the surface's basis, an ACC patch (Loop and Schaefer
2008: geometry patch and two tangent patches) or a Gregory patch (Loop, Schaefer, Ni, Castano 2009).

Normals on edges: along an edge the normals of both patches are parallel, but rounded differently. The normal of the
edge is therefore that of the first of its faces: with Y the quadratic along and X the cubic across the edge, X x Y as
control vectors of degree 5. At a sharp crease the two sides differ: each keeps its own to be shaded with, and both are
displaced along the sum; and so for vertices.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.subdivision import normal_slack
from pipeline.subdivision.limit import multiply
from pipeline.subdivision.normal_slack import (
    SLACK_LEVELS,
    corner_slack,
    edge_slack,
    load_differences,
    load_nets,
    side_slack,
)
from pipeline.subdivision.refine import move_points
from pipeline.subdivision.surface import Basis, Layer, Sharing, Surface
from pipeline.types import F32, F64
from pipeline.vector_width import prefer_wide
from pipeline.wide import LANES, greater, spread, store

GREGORY = int(Basis.GREGORY)
U = 2.0**-24


class Nets(NamedTuple):
    """Working space for one patch, float64."""

    b: F64  # (4, 4, 3)
    tu: F64  # (3, 4, 3)
    tv: F64  # (4, 3, 3)
    f: F64  # (4, 2, 3) f+ and f- of the corners
    n: F64  # (6, 3)


class Output(NamedTuple):
    """What the kernels write, of all patches of a surface."""

    control_points: F32  # (P, 4, 4, 4)
    tangent_u: F32  # (A, 3, 4, 3)
    tangent_v: F32  # (A, 4, 3, 3)
    inner: F32  # (G, 4, 2, 3)
    edge_normals: F64  # (E, 6, 3)
    corner_normals: F64  # (V, 3)


@kernel
def _edge_points(layer, points, position, tangents, out):
    """out : float64[E, 2, 3], the points of the boundary curve next to both ends."""
    for e in range(len(layer.ends)):
        for end in range(2):
            a, b = layer.ends[e, end], layer.ends[e, 1 - end]
            row, n = layer.end_tangent[e, end], layer.end_fullness[e, end]
            for c in range(3):
                if layer.ends[e, 4] < 0:
                    out[e, end, c] = (2.0 * points[a, c] + points[b, c]) / 3.0
                elif row >= 0:
                    out[e, end, c] = position[a, c] + layer.end_reach[e, end] * tangents[row, c]
                else:
                    near = points[layer.ends[e, 2 + end], c] + points[layer.ends[e, 4 + end], c]
                    far = points[layer.ends[e, 3 - end], c] + points[layer.ends[e, 5 - end], c]
                    total = 2.0 * n * points[a, c] + 4.0 * points[b, c] + 2.0 * near + far
                    out[e, end, c] = total / (2.0 * n + 10.0)


@helper
def _spot(i, j, x, y):
    """Indices of control point (i, j) counted from corner (x, y) of the patch, along u and v."""
    return (3 - i if x else i), (3 - j if y else j)


@helper
def _place(k):
    """(u, v) of corner k."""
    return k == 1 or k == 2, k >= 2


@helper
def _along_side(k, step):
    """Control point `step` places from corner k along side k, counter-clockwise."""
    if k == 0:
        return step, 0
    if k == 1:
        return 3, step
    if k == 2:
        return 3 - step, 3
    return 0, 3 - step


@helper
def _inner_place(k):
    x, y = _place(k)
    return _spot(1, 1, x, y)


@helper
def _geometry(layer, m, points, position, edge_points, b):
    """The 16 points of section 4."""
    for k in range(4):
        v = layer.quad[m, k]
        after, over, before = layer.quad[m, (k + 1) & 3], layer.quad[m, (k + 2) & 3], layer.quad[m, (k + 3) & 3]
        e, near = layer.edge[m, k], 1 - layer.along[m, k]
        n = layer.fullness[m, k]
        i, j = _along_side(k, 0)
        i1, j1 = _along_side(k, 1)
        i2, j2 = _along_side(k, 2)
        x, y = _inner_place(k)
        for c in range(3):
            b[i, j, c] = position[v, c]
            b[i1, j1, c] = edge_points[e, near, c]
            b[i2, j2, c] = edge_points[e, 1 - near, c]
            total = n * points[v, c] + 2.0 * points[after, c] + points[over, c] + 2.0 * points[before, c]
            b[x, y, c] = total / (n + 5.0)


@helper
def _differences(b, tu, tv):
    for i in range(3):
        for j in range(4):
            for c in range(3):
                tu[i, j, c] = 3.0 * (b[i + 1, j, c] - b[i, j, c])
                tv[j, i, c] = 3.0 * (b[j, i + 1, c] - b[j, i, c])


@helper
def _tangent_patches(layer, m, tangents, b, tu, tv):
    """Section 5; tu and tv hold the differences of b and are changed outside their middle."""
    out, back = layer.tangent[m, :, 0], layer.tangent[m, :, 1]
    turn, smooth = layer.turn[m], layer.smooth[m]
    c0, c1, c2, c3 = turn[0], turn[1], turn[2], turn[3]
    for c in range(3):
        tu[0, 0, c], tu[2, 0, c] = tangents[out[0], c], -tangents[back[1], c]
        tu[0, 3, c], tu[2, 3, c] = tangents[back[3], c], -tangents[out[2], c]
        tv[0, 0, c], tv[0, 2, c] = tangents[back[0], c], -tangents[out[3], c]
        tv[3, 0, c], tv[3, 2, c] = tangents[out[1], c], -tangents[back[2], c]
    for c in range(3):
        if smooth[3]:
            tu[0, 1, c] += (2.0 * c0 * tv[0, 1, c] - c3 * tv[0, 0, c]) / 3.0
            tu[0, 2, c] += (c0 * tv[0, 2, c] - 2.0 * c3 * tv[0, 1, c]) / 3.0
        if smooth[1]:
            tu[2, 1, c] -= (2.0 * c1 * tv[3, 1, c] - c2 * tv[3, 0, c]) / 3.0
            tu[2, 2, c] -= (c1 * tv[3, 2, c] - 2.0 * c2 * tv[3, 1, c]) / 3.0
        if smooth[0]:
            tv[1, 0, c] += (2.0 * c0 * tu[1, 0, c] - c1 * tu[0, 0, c]) / 3.0
            tv[2, 0, c] += (c0 * tu[2, 0, c] - 2.0 * c1 * tu[1, 0, c]) / 3.0
        if smooth[2]:
            tv[1, 2, c] -= (2.0 * c3 * tu[1, 3, c] - c2 * tu[0, 3, c]) / 3.0
            tv[2, 2, c] -= (c3 * tu[2, 3, c] - 2.0 * c2 * tu[1, 3, c]) / 3.0


@helper
def _across(layer, m, k):
    """Vertices next to corners k and k + 1 in the face on the other side of side k."""
    ends = layer.ends[layer.edge[m, k]]
    if layer.along[m, k]:
        return ends[4], ends[5]
    return ends[3], ends[2]


@helper
def _gregory_points(layer, m, points, b, f):
    """Section 7: f+ and f- of each corner; b holds the others and gets their mean inside."""
    quad, turn, smooth = layer.quad[m], layer.turn[m], layer.smooth[m]
    for k in range(4):
        after, over, before = (k + 1) & 3, (k + 2) & 3, (k + 3) & 3
        x, y = _inner_place(k)
        p = _along_side(k, 0)
        for c in range(3):
            f[k, 0, c] = f[k, 1, c] = b[x, y, c]
        if smooth[k]:
            near, far = _across(layer, m, k)
            e, other = _along_side(k, 1), _along_side(k, 2)
            for c in range(3):
                r = 2.0 * (points[quad[before], c] - points[near, c]) + (points[quad[over], c] - points[far, c])
                middle = 3.0 - 2.0 * turn[k] - turn[after]
                total = turn[after] * b[p[0], p[1], c] + middle * b[e[0], e[1], c]
                f[k, 0, c] = (total + 2.0 * turn[k] * b[other[0], other[1], c] + r / 6.0) / 3.0
        if smooth[before]:
            far, near = _across(layer, m, before)
            e, other = _along_side(before, 2), _along_side(before, 1)
            for c in range(3):
                r = 2.0 * (points[quad[after], c] - points[near, c]) + (points[quad[over], c] - points[far, c])
                middle = 3.0 - 2.0 * turn[k] - turn[before]
                total = turn[before] * b[p[0], p[1], c] + middle * b[e[0], e[1], c]
                f[k, 1, c] = (total + 2.0 * turn[k] * b[other[0], other[1], c] + r / 6.0) / 3.0
    for k in range(4):
        x, y = _inner_place(k)
        for c in range(3):
            b[x, y, c] = 0.5 * (f[k, 0, c] + f[k, 1, c])


@helper
def _gregory_edge_tangents(b, f, tu, tv):
    """tu and tv of a Gregory patch, right on its four edges, where the quotients are one of their two points."""
    _differences(b, tu, tv)
    for c in range(3):
        tu[0, 1, c], tu[0, 2, c] = 3.0 * (f[0, 1, c] - b[0, 1, c]), 3.0 * (f[3, 0, c] - b[0, 2, c])
        tu[2, 1, c], tu[2, 2, c] = 3.0 * (b[3, 1, c] - f[1, 0, c]), 3.0 * (b[3, 2, c] - f[2, 1, c])
        tv[1, 0, c], tv[2, 0, c] = 3.0 * (f[0, 0, c] - b[1, 0, c]), 3.0 * (f[1, 1, c] - b[2, 0, c])
        tv[1, 2, c], tv[2, 2, c] = 3.0 * (b[1, 3, c] - f[3, 1, c]), 3.0 * (b[2, 3, c] - f[2, 0, c])


@helper
def _add_product(n, k, w, y, i1, j1, x, i2, j2):
    """n[k] += w * y[i1, j1] x x[i2, j2]."""
    y0, y1, y2 = y[i1, j1, 0], y[i1, j1, 1], y[i1, j1, 2]
    x0, x1, x2 = x[i2, j2, 0], x[i2, j2, 1], x[i2, j2, 2]
    n[k, 0] += w * (y1 * x2 - y2 * x1)
    n[k, 1] += w * (y2 * x0 - y0 * x2)
    n[k, 2] += w * (y0 * x1 - y1 * x0)


@helper
def _edge_normal_net(tu, tv, k, n):
    """Control vectors (6, 3) of TU x TV on side k, in the direction of the parameter."""
    n[:] = 0.0
    quadratic, cubic, quintic = (1.0, 2.0, 1.0), (1.0, 3.0, 3.0, 1.0), (1.0, 5.0, 10.0, 10.0, 5.0, 1.0)
    far = k == 1 or k == 2
    along, across = (3, 2) if far else (0, 0)  # the last row of the nets, or the first
    for i in range(3):
        for j in range(4):
            w = quadratic[i] * cubic[j] / quintic[i + j]
            if k == 0 or k == 2:
                _add_product(n, i + j, w, tu, i, along, tv, j, across)
            else:
                _add_product(n, i + j, -w, tv, along, i, tu, across, j)


@helper
def _largest(n):
    m = 0.0
    for k in range(len(n)):
        for c in range(3):
            m = max(m, abs(n[k, c]))
    return m


@helper
def _add_normals(layer, sharing, m, edge_base, corner_base, nets, out):
    """The patch's share in the normals of its edges and corners."""
    tu, tv, n = nets.tu, nets.tv, nets.n
    for k in range(4):
        corner = sharing.corner_write[m, k]
        write = sharing.edge_write[m, k]
        if not (write or corner):
            continue
        _edge_normal_net(tu, tv, k, n)
        with_edge = (layer.along[m, k] == 1) == (k < 2)
        if write:
            row = out.edge_normals[edge_base + sharing.edge[m, k]]
            size = _largest(n)
            for h in range(6):
                for c in range(3):
                    value = n[h if with_edge else 5 - h, c] / size if size > 0.0 else 0.0
                    row[h, c] = value if write == 1 else row[h, c] + value
        if corner:
            h = 0 if k < 2 else 5  # sides 2 and 3 start where the parameter ends
            size = math.sqrt(n[h, 0] * n[h, 0] + n[h, 1] * n[h, 1] + n[h, 2] * n[h, 2])
            row = out.corner_normals[corner_base + sharing.corner[m, k]]
            for c in range(3):
                value = n[h, c] / size if size > 0.0 else 0.0
                row[c] = value if corner == 1 else row[c] + value


@kernel
def _fill_patches(
    layer, sharing, basis, points, position, tangents, edge_points, first, irregular, edge_base, corner_base, nets, out
):
    b, tu, tv, f = nets.b, nets.tu, nets.tv, nets.f
    for m in range(len(layer.quad)):
        _geometry(layer, m, points, position, edge_points, b)
        if layer.regular[m]:
            _differences(b, tu, tv)
        elif basis == GREGORY:
            _gregory_points(layer, m, points, b, f)
            _gregory_edge_tangents(b, f, tu, tv)
            out.inner[irregular] = f
            irregular += 1
        else:
            _differences(b, tu, tv)
            _tangent_patches(layer, m, tangents, b, tu, tv)
            out.tangent_u[irregular], out.tangent_v[irregular] = tu, tv
            irregular += 1
        target = out.control_points[first + m]
        for i in range(4):
            for j in range(4):
                for c in range(3):
                    target[i, j, c] = b[i, j, c]
                target[i, j, 3] = 1.0
        _add_normals(layer, sharing, m, edge_base, corner_base, nets, out)


@kernel
def _finish_normals(edge_sums, corner_sums, edge_normals, corner_normals):
    """Scale sums to a largest component of 1 (edges), and to unit length (corners); zero stays zero."""
    for e in range(len(edge_sums)):
        size = _largest(edge_sums[e])
        for k in range(6):
            for c in range(3):
                edge_normals[e, k, c] = edge_sums[e, k, c] / size if size > 0.0 else 0.0
    for v in range(len(corner_sums)):
        x, y, z = corner_sums[v]
        size = math.sqrt(x * x + y * y + z * z)
        for c in range(3):
            corner_normals[v, c] = corner_sums[v, c] / size if size > 0.0 else 0.0


@helper
def _rounded_nets(layer, m, basis, cp, irregular, out, nets):
    """The nets as the domain shader has them: of the float32 control points."""
    b, f, tu, tv = nets.b, nets.f, nets.tu, nets.tv
    b[:] = cp[:, :, :3]
    if layer.regular[m]:
        _differences(b, tu, tv)
    elif basis == GREGORY:
        f[:] = out.inner[irregular]
        _gregory_edge_tangents(b, f, tu, tv)
    else:
        tu[:], tv[:] = out.tangent_u[irregular], out.tangent_v[irregular]


@helper
def _patch_slack(
    layer, sharing, basis, m, irregular, edge_base, corner_base, cp, nets, out, edge_normals, corner_normals, pieces
):
    """Slack of one patch."""
    n, most = nets.n, 0.0
    _rounded_nets(layer, m, basis, cp, irregular, out, nets)
    for k in range(4):
        _edge_normal_net(nets.tu, nets.tv, k, n)
        with_edge = (layer.along[m, k] == 1) == (k < 2)
        most = max(most, edge_slack(n, edge_normals[edge_base + sharing.edge[m, k]], with_edge, pieces))
        h = 0 if k < 2 else 5
        corner = corner_normals[corner_base + sharing.corner[m, k]]
        most = max(most, corner_slack(n[h, 0], n[h, 1], n[h, 2], corner))
    return most


@helper
def _load_nets(layer, m, basis, cp, irregular, out, nets, lane, s):
    """The nets of `_rounded_nets`, of the patch of a lane."""
    if layer.regular[m]:
        load_differences(cp, lane, s)
    elif basis == GREGORY:
        _rounded_nets(layer, m, basis, cp, irregular, out, nets)
        load_nets(nets.tu, nets.tv, lane, s)
    else:
        load_nets(out.tangent_u[irregular], out.tangent_v[irregular], lane, s)


@helper
def _load_side(layer, sharing, m, k, lane, edge_base, corner_base, edge_normals, corner_normals, s):
    """Normals that the patch of a lane shares on side k, the edge's in the direction of the parameter."""
    edge, corner = edge_normals[edge_base + sharing.edge[m, k]], corner_normals[corner_base + sharing.corner[m, k]]
    with_edge = (layer.along[m, k] == 1) == (k < 2)
    for c in range(3):
        for h in range(6):
            s[normal_slack.EDGE + 3 * h + c, lane] = edge[h if with_edge else 5 - h, c]
        s[normal_slack.CORNER + c, lane] = corner[c]


@kernel
def _fill_slack(
    layer, sharing, basis, first, irregular, edge_base, corner_base, nets, out, edge_normals, corner_normals, slack
):
    prefer_wide()
    n, s, pieces = len(layer.quad), np.zeros((normal_slack.ROWS, LANES)), np.empty((3, SLACK_LEVELS + 1, 6, 3))
    numbers = np.empty(LANES, np.int64)
    for begin in range(0, n, LANES):
        count = min(LANES, n - begin)
        for lane in range(count):
            m, numbers[lane] = begin + lane, irregular
            _load_nets(layer, m, basis, out.control_points[first + m], irregular, out, nets, lane, s)
            irregular += layer.regular[m] == 0
        most, unsure = spread(0.0), spread(0.0)
        for k in range(4):
            for lane in range(count):
                _load_side(
                    layer, sharing, begin + lane, k, lane, edge_base, corner_base, edge_normals, corner_normals, s
                )
            most_here, unsure_here = side_slack(k, s)
            most, unsure = greater(most, most_here), greater(unsure, unsure_here)
        store(s, 0, most)
        store(s, 1, unsure)
        for lane in range(count):
            m, value = begin + lane, s[0, lane]
            if s[1, lane] > 0.0:
                value = _patch_slack(
                    layer, sharing, basis, m, numbers[lane], edge_base, corner_base, out.control_points[first + m], nets,
                    out, edge_normals, corner_normals, pieces,
                )  # fmt: skip
            slack[first + m] = np.float32(value * (1.0 + 4.0 * U))


class Result(NamedTuple):
    """Patches of a surface: see `types.Patches`."""

    control_points: F32
    tangent_u: F32
    tangent_v: F32
    inner: F32
    edge_normals: F32
    corner_normals: F32
    normal_slack: F32


def run_control_points(surface: Surface, vertices: F32, displaced: bool) -> Result:
    """Control points of all patches, of the control mesh's points float32[V, 3], in the space that these are in.

    displaced : the normals that patches share are those of `Surface.edge_row` and `corner_row`, and have a slack; else those
        of `side_row` and `sector_row`, whose slack is 0: nothing but shading depends on them.
    """
    num_irregular = int(surface.irregular_id.max(initial=-1)) + 1
    num_acc, num_gregory = (0, num_irregular) if surface.basis == Basis.GREGORY else (num_irregular, 0)
    sharing = [layer.joined if displaced else layer.sided for layer in surface.layers]
    out = Output(
        np.empty((surface.num_patches, 4, 4, 4), np.float32),
        np.empty((num_acc, 3, 4, 3), np.float32),
        np.empty((num_acc, 4, 3, 3), np.float32),
        np.empty((num_gregory, 4, 2, 3), np.float32),
        np.zeros((sum(shared.num_edges for shared in sharing), 6, 3)),
        np.zeros((sum(shared.num_corners for shared in sharing), 3)),
    )
    nets = Nets(*(np.empty(shape) for shape in ((4, 4, 3), (3, 4, 3), (4, 3, 3), (4, 2, 3), (6, 3))))
    points, level = vertices.astype(np.float64), 0
    parts = list(zip(surface.layers, sharing, _starts(surface.layers, sharing), strict=True))
    basis = int(surface.basis)
    for layer, shared, start in parts:
        while level < layer.level:
            points, level = move_points(surface.steps[level], points), level + 1
        position, tangents = multiply(layer.position, points), multiply(layer.tangents, points)
        edge_points = np.empty((len(layer.ends), 2, 3))
        _edge_points(layer, points, position, tangents, edge_points)
        _fill_patches(layer, shared, basis, points, position, tangents, edge_points, *start, nets, out)
    edge_normals, corner_normals = (np.empty(a.shape, np.float32) for a in (out.edge_normals, out.corner_normals))
    _finish_normals(out.edge_normals, out.corner_normals, edge_normals, corner_normals)
    slack = np.zeros(surface.num_patches, np.float32)
    for layer, shared, start in parts if displaced else ():
        _fill_slack(layer, shared, basis, *start, nets, out, edge_normals, corner_normals, slack)
    return Result(*out[:4], edge_normals, corner_normals, slack)


def _starts(layers: Sequence[Layer], sharing: Sequence[Sharing]) -> Iterator[tuple[int, int, int, int]]:
    """Of each layer: its first patch, first patch that is not regular, first row of edge and of corner normals."""
    first = irregular = edge = corner = 0
    for layer, shared in zip(layers, sharing, strict=True):
        yield first, irregular, edge, corner
        first += len(layer.quad)
        irregular += int((layer.regular == 0).sum())
        edge += shared.num_edges
        corner += shared.num_corners
