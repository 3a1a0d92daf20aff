"""Normals on the edges and corners of patches that share them: the edge's own, so that both sides get the same bits.

Displaced points of two patches meet only where their normals have the same bits, and a mesh without a map is shaded without
a seam only where they are close. Those of the patches' own tangents are parallel along a shared edge, but rounded apart: in
float32 differences of control points cancel. Here the normal comes from a table: six control vectors an edge, one unit
vector a corner. The sum over the six is symmetric under reversal, as those of bezier.py are.

Runs of points on one edge are short (a tessellation factor), so they are done in blocks of 8, the last one filled up: a
loop of constant length is vectorized whole, where one of 7 points would run as the remainder of a vector loop.
"""

import math

import numpy as np

from pipeline.jit import helper, inlined

ONE, ZERO = np.float32(1.0), np.float32(0.0)
SMALL = np.float32(2.0**-20)  # squared length below which the rounding of the control vectors (size 1) may be felt
NUDGE = 2.0**-9
BLOCK = 8  # points at once: a 256-bit vector
SPACE = 5 * BLOCK  # float32 entries of working space: t, the normal's components, squared length


@helper
def _quintic(t, one):
    """Bernstein polynomials of degree 5 at t."""
    s = one - t
    tt, ss = t * t, s * s
    five = one + one + one + one + one
    ten = five + five
    t4, s4 = tt * tt, ss * ss
    return s4 * s, (five * t) * s4, (ten * tt) * (ss * s), (ten * ss) * (tt * t), (five * s) * t4, t4 * t


@helper
def _sum6(b, p):
    return ((b[0] * p[0] + b[5] * p[5]) + (b[1] * p[1] + b[4] * p[4])) + (b[2] * p[2] + b[3] * p[3])


@inlined
def _edge_net(n, row, c):
    """Coordinate c of the edge's control vectors in the direction of the patch; row < 0: against the edge's."""
    if row >= 0:
        return n[row, 0, c], n[row, 1, c], n[row, 2, c], n[row, 3, c], n[row, 4, c], n[row, 5, c]
    row = ~row
    return n[row, 5, c], n[row, 4, c], n[row, 3, c], n[row, 2, c], n[row, 1, c], n[row, 0, c]


@helper
def edge_of(u, v):
    """Number of the edge that (u, v) lies on in SV_TessFactor order, 4 + number of the corner, or -1 inside."""
    on_u, on_v = not ZERO < u < ONE, not ZERO < v < ONE
    if on_u:
        if on_v:
            return 4 + (1 if u == ONE else 0) + (2 if v == ONE else 0)
        return 0 if u == ZERO else 2
    if on_v:
        return 1 if v == ZERO else 3
    return -1


@helper
def _careful(net_x, net_y, net_z, t):
    """Unit normal in float64; where there is none, that of a point 2^-9 nearer to the middle; zero if need be."""
    for _ in range(2):
        b = _quintic(t, 1.0)
        x, y, z = _sum6(b, net_x), _sum6(b, net_y), _sum6(b, net_z)
        length = math.sqrt((x * x + y * y) + z * z)
        if length > 0.0:
            return x / length, y / length, z / length
        t = t + (0.5 - t) * NUDGE
    return 0.0, 0.0, 0.0


@inlined
def _edge_block(x, y, z, s):
    """Normals and squared lengths at the BLOCK parameters that lead the working space s, into what follows them there."""
    for k in range(BLOCK):
        b = _quintic(s[k], ONE)
        nx, ny, nz = _sum6(b, x), _sum6(b, y), _sum6(b, z)
        square = (nx * nx + ny * ny) + nz * nz
        length = np.sqrt(square)
        s[BLOCK + k] = nx / length
        s[2 * BLOCK + k] = ny / length
        s[3 * BLOCK + k] = nz / length
        s[4 * BLOCK + k] = square


@inlined
def _edge_run(x, y, z, edge, u, v, begin, end, nx, ny, nz, keep, s):
    """Normals at the points begin .. end-1, all on one edge, nets x, y and z, into rows nx, ny, nz; s: SPACE entries.

    Rows are handed on whole: a slice of an array costs more here than the work on a point.
    """
    for first in range(begin, end, BLOCK):
        count = min(BLOCK, end - first)
        for k in range(BLOCK):
            at = first + min(k, count - 1)
            s[k] = v[at] if edge % 2 == 0 else u[at]
        _edge_block(x, y, z, s)
        for k in range(count):
            if s[4 * BLOCK + k] > SMALL:
                nx[first + k], ny[first + k], nz[first + k] = s[BLOCK + k], s[2 * BLOCK + k], s[3 * BLOCK + k]
            else:
                a, b, c = _careful(x, y, z, np.float64(s[k]))
                if not (keep and a == 0.0 and b == 0.0 and c == 0.0):
                    nx[first + k], ny[first + k], nz[first + k] = np.float32(a), np.float32(b), np.float32(c)


@inlined
def _end_of_run(edge, across, along, begin, n):
    """Points begin .. the result - 1 lie all on this edge, or are one: in a corner or inside each is a run of its own."""
    end = begin + 1
    while 0 <= edge < 4 and end < n and across[end] == across[begin] and ZERO < along[end] < ONE:
        end += 1
    return end


@helper
def _count_outer(u, v):
    """Number of leading points up to the last one that lies on an edge."""
    count = np.int32(0)  # as wide as a coordinate: so many to a vector
    for k in range(len(u)):
        inside = (u[k] > ZERO) & (u[k] < ONE) & (v[k] > ZERO) & (v[k] < ONE)
        count = max(count, np.int32(0) if inside else np.int32(k + 1))
    return np.int64(count)


@helper
def write_edge_normals(edge_row, corner_row, edge_normals, corner_normals, keep, u, v, nx, ny, nz, space):
    """Replace the normals (rows nx, ny, nz) of those points (u, v) that lie on the patch's edges.

    edge_row, corner_row : int32[4] of the patch. keep : where the shared normal is zero the patch's own stays. space : at
    least SPACE float32. Points on one edge that follow each other, as the tessellator makes them, are done at once.
    """
    n, begin = _count_outer(u, v), 0  # the points inside come last
    while begin < n:
        edge = edge_of(u[begin], v[begin])
        end = _end_of_run(edge, u if edge % 2 == 0 else v, v if edge % 2 == 0 else u, begin, n)
        if edge >= 4:
            row = corner_row[edge - 4]
            x, y, z = corner_normals[row, 0], corner_normals[row, 1], corner_normals[row, 2]
            if not (keep and x == ZERO and y == ZERO and z == ZERO):
                for k in range(begin, end):
                    nx[k], ny[k], nz[k] = x, y, z
        elif edge >= 0:
            row = edge_row[edge]
            net_x, net_y, net_z = (
                _edge_net(edge_normals, row, 0),
                _edge_net(edge_normals, row, 1),
                _edge_net(edge_normals, row, 2),
            )
            _edge_run(net_x, net_y, net_z, edge, u, v, begin, end, nx, ny, nz, keep, space)
        begin = end
