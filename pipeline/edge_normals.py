"""Normals on the edges and corners of patches that share them: the edge's own, so that both sides get the same bits.

Displaced points of two patches meet only where their normals have the same bits. Those of the patches' own tangents are
parallel along a shared edge, but rounded apart. Here the normal comes from a table: six control vectors an edge, one unit
vector a corner. The sum over the six is symmetric under reversal, as those of bezier.py are.
"""

import math

import numpy as np

from pipeline.jit import helper

ONE, ZERO = np.float32(1.0), np.float32(0.0)
SMALL = np.float32(2.0**-20)  # squared length below which the rounding of the control vectors (size 1) may be felt
NUDGE = 2.0**-9


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


@helper
def _edge_net(edge_normals, row, c):
    """Coordinate c of the edge's control vectors in the direction of the patch; row < 0: against the edge's."""
    if row >= 0:
        n = edge_normals[row]
        return n[0, c], n[1, c], n[2, c], n[3, c], n[4, c], n[5, c]
    n = edge_normals[~row]
    return n[5, c], n[4, c], n[3, c], n[2, c], n[1, c], n[0, c]


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


@helper
def _edge_run(net_x, net_y, net_z, t, nx, ny, nz, square):
    """Normals at the parameters t along one edge, into rows nx, ny, nz; `square` is working space."""
    for k in range(len(t)):
        b = _quintic(t[k], ONE)
        x, y, z = _sum6(b, net_x), _sum6(b, net_y), _sum6(b, net_z)
        q = (x * x + y * y) + z * z
        length = np.sqrt(q)
        nx[k] = x / length
        ny[k] = y / length
        nz[k] = z / length
        square[k] = q
    for k in range(len(t)):
        if not square[k] > SMALL:
            x, y, z = _careful(net_x, net_y, net_z, np.float64(t[k]))
            nx[k], ny[k], nz[k] = np.float32(x), np.float32(y), np.float32(z)


@helper
def write_edge_normals(edge_row, corner_row, edge_normals, corner_normals, u, v, nx, ny, nz, space):
    """Replace the normals (rows nx, ny, nz) of those points (u, v) that lie on the patch's edges.

    edge_row, corner_row : int32[4] of the patch. space : a row of working space. Points on one edge that follow each
    other, as the tessellator makes them, are done at once.
    """
    n, begin = len(u), 0
    while n > 0 and edge_of(u[n - 1], v[n - 1]) < 0:  # the points inside come last
        n -= 1
    while begin < n:
        edge = edge_of(u[begin], v[begin])
        end = begin + 1
        while end < n and edge_of(u[end], v[end]) == edge:
            end += 1
        if edge >= 4:
            row = corner_row[edge - 4]
            for k in range(begin, end):
                nx[k], ny[k], nz[k] = corner_normals[row, 0], corner_normals[row, 1], corner_normals[row, 2]
        elif edge >= 0:
            row = edge_row[edge]
            x, y, z = (
                _edge_net(edge_normals, row, 0),
                _edge_net(edge_normals, row, 1),
                _edge_net(edge_normals, row, 2),
            )
            t = v[begin:end] if edge % 2 == 0 else u[begin:end]
            _edge_run(x, y, z, t, nx[begin:end], ny[begin:end], nz[begin:end], space[begin:end])
        begin = end
