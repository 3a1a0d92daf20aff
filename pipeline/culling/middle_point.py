"""Which way a displaced patch faces at one point, u = v = 1/2: a patch that faces the eye there is not all back-facing.

The derivatives of the base surface there are known, and n with them; of t, t_u and t_v the ranges over the whole patch are
taken. An answer lets a test skip what it cannot cull: what rounds here keeps a patch at worst.
"""

import numpy as np

from pipeline.culling.chords import ORIGIN, POINTS, load_vector
from pipeline.culling.intervals import add, cross_dot, scale
from pipeline.culling.part_displacement import DISPLACEMENT
from pipeline.jit import helper, inlined
from pipeline.wide import load, root

# Bernstein polynomials of degree 3 at 1/2, their first and second derivatives.
BASIS = np.array([[0.125, 0.375, 0.375, 0.125], [-0.75, -0.75, 0.75, 0.75], [3.0, -3.0, -3.0, 3.0]])


@inlined
def _sum4(a, b, c, d, weights):
    return (
        (weights[0] * a[0] + weights[1] * b[0]) + (weights[2] * c[0] + weights[3] * d[0]),
        (weights[0] * a[1] + weights[1] * b[1]) + (weights[2] * c[1] + weights[3] * d[1]),
        (weights[0] * a[2] + weights[1] * b[2]) + (weights[2] * c[2] + weights[3] * d[2]),
    )


@helper
def _column(s, j, order):
    """The control points of column j summed along u, or their derivatives."""
    a, b = load_vector(s, POINTS + 3 * j), load_vector(s, POINTS + 3 * (4 + j))
    c, d = load_vector(s, POINTS + 3 * (8 + j)), load_vector(s, POINTS + 3 * (12 + j))
    return _sum4(a, b, c, d, BASIS[order])


@helper
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@helper
def _add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@helper
def _turning(n, inverse, step):
    """Derivative of the unit normal n from that of the normal, whose length is 1 / inverse."""
    along = n[0] * step[0] + n[1] * step[1] + n[2] * step[2]
    return (step[0] - along * n[0]) * inverse, (step[1] - along * n[1]) * inverse, (step[2] - along * n[2]) * inverse


@inlined
def _moved(base, slope, n, t, turn):
    """The box of base + slope n + t turn, slope and t intervals: three intervals."""
    return (
        _moved_along(base[0], slope, n[0], t, turn[0]),
        _moved_along(base[1], slope, n[1], t, turn[1]),
        _moved_along(base[2], slope, n[2], t, turn[2]),
    )


@inlined
def _moved_along(base, slope, n, t, turn):
    low, high = add(scale(n, slope), scale(turn, t))
    return base + low, base + high


@helper
def facing_at_middle(s, eye):
    """Interval of q . (d_u x d_v) at u = v = 1/2 of each lane's patch, q the way from eye float64[3]."""
    c0, c1, c2, c3 = _column(s, 0, 0), _column(s, 1, 0), _column(s, 2, 0), _column(s, 3, 0)
    p = _sum4(c0, c1, c2, c3, BASIS[0])
    p_v, p_vv = _sum4(c0, c1, c2, c3, BASIS[1]), _sum4(c0, c1, c2, c3, BASIS[2])
    c0, c1, c2, c3 = _column(s, 0, 1), _column(s, 1, 1), _column(s, 2, 1), _column(s, 3, 1)
    p_u, p_uv = _sum4(c0, c1, c2, c3, BASIS[0]), _sum4(c0, c1, c2, c3, BASIS[1])
    p_uu = _sum4(_column(s, 0, 2), _column(s, 1, 2), _column(s, 2, 2), _column(s, 3, 2), BASIS[0])
    normal = _cross(p_u, p_v)
    inverse = 1.0 / root(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    n = (normal[0] * inverse, normal[1] * inverse, normal[2] * inverse)
    n_u = _turning(n, inverse, _add(_cross(p_uu, p_v), _cross(p_u, p_uv)))
    n_v = _turning(n, inverse, _add(_cross(p_uv, p_v), _cross(p_u, p_vv)))
    t = (load(s, DISPLACEMENT), load(s, DISPLACEMENT + 1))
    t_u = (load(s, DISPLACEMENT + 2), load(s, DISPLACEMENT + 3))
    t_v = (load(s, DISPLACEMENT + 4), load(s, DISPLACEMENT + 5))
    origin = load_vector(s, ORIGIN)
    way = (p[0] + (origin[0] - eye[0]), p[1] + (origin[1] - eye[1]), p[2] + (origin[2] - eye[2]))
    q = (
        add((way[0], way[0]), scale(n[0], t)), add((way[1], way[1]), scale(n[1], t)),
        add((way[2], way[2]), scale(n[2], t)),
    )  # fmt: skip
    return cross_dot(q, _moved(p_u, t_u, n, t, n_u), _moved(p_v, t_v, n, t, n_v))
