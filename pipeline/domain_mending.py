"""Normals of patches where float32 does not tell them: in collapsed corners, and where patches are tiny or huge.

In float64 arithmetic on the float32 control points, in the same order as the shader's.
"""

import math

import numpy as np

from pipeline.bezier import (
    cubic,
    differences_u,
    differences_v,
    eval_34,
    eval_43,
    eval_44,
    net,
    net_34,
    net_43,
    quadratic,
)
from pipeline.domain_rows import NX, NY, NZ, ZERO, S, U, V
from pipeline.domain_surfaces import rational_u, rational_v
from pipeline.gregory import gregory_u, gregory_v, inner_net, inverse_weights
from pipeline.jit import helper

NUDGE = 2.0**-9


@helper
def _scaled_unit(x, y, z):
    """Unit vector in float64 however small or large the input; zero for the zero vector and for non-finite ones."""
    m = max(abs(x), abs(y), abs(z))
    if not (m > 0.0 and m < np.inf):
        return 0.0, 0.0, 0.0
    x, y, z = x / m, y / m, z / m
    length = math.sqrt((x * x + y * y) + z * z)
    return x / length, y / length, z / length


@helper
def _derivatives_at(cp, rational, u, v):
    """Directions of both derivatives in float64 arithmetic on the float32 control points of a Bezier patch."""
    bu, bv = cubic(u, 1.0), cubic(v, 1.0)
    qu, qv = quadratic(u, 1.0), quadratic(v, 1.0)
    x, y, z, w = net(cp, 0), net(cp, 1), net(cp, 2), net(cp, 3)
    if rational:
        weight = eval_44(w, bu, bv)
        px, py, pz = eval_44(x, bu, bv) / weight, eval_44(y, bu, bv) / weight, eval_44(z, bu, bv) / weight
        ax, bx = rational_u(x, w, px, qu, bv), rational_v(x, w, px, bu, qv)
        ay, by = rational_u(y, w, py, qu, bv), rational_v(y, w, py, bu, qv)
        az, bz = rational_u(z, w, pz, qu, bv), rational_v(z, w, pz, bu, qv)
    else:
        ax, bx = eval_34(differences_u(x), qu, bv), eval_43(differences_v(x), bu, qv)
        ay, by = eval_34(differences_u(y), qu, bv), eval_43(differences_v(y), bu, qv)
        az, bz = eval_34(differences_u(z), qu, bv), eval_43(differences_v(z), bu, qv)
    return (ax, ay, az), (bx, by, bz)


@helper
def _tangents_at(tu, tv, u, v):
    """As `_derivatives_at`, of an ACC patch's tangent patches."""
    bu, bv, qu, qv = cubic(u, 1.0), cubic(v, 1.0), quadratic(u, 1.0), quadratic(v, 1.0)
    a = eval_34(net_34(tu, 0), qu, bv), eval_34(net_34(tu, 1), qu, bv), eval_34(net_34(tu, 2), qu, bv)
    b = eval_43(net_43(tv, 0), bu, qv), eval_43(net_43(tv, 1), bu, qv), eval_43(net_43(tv, 2), bu, qv)
    return a, b


@helper
def _gregory_at(cp, f, u, v):
    """As `_derivatives_at`, of a Gregory patch."""
    x, y, z, fx, fy, fz = net(cp, 0), net(cp, 1), net(cp, 2), inner_net(f, 0), inner_net(f, 1), inner_net(f, 2)
    d = inverse_weights(u, v, 1.0)
    a = gregory_u(x, fx, d, u, v, 1.0), gregory_u(y, fy, d, u, v, 1.0), gregory_u(z, fz, d, u, v, 1.0)
    b = gregory_v(x, fx, d, u, v, 1.0), gregory_v(y, fy, d, u, v, 1.0), gregory_v(z, fz, d, u, v, 1.0)
    return a, b


@helper
def _unit_cross(a, b):
    """Unit vector of a x b in float64."""
    ax, ay, az = _scaled_unit(a[0], a[1], a[2])
    bx, by, bz = _scaled_unit(b[0], b[1], b[2])
    return _scaled_unit(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


@helper
def _normal_at(shape, u, v):
    """Unit normal of a patch in float64 arithmetic on its float32 control points; `shape` as in `domain._shade_surface`."""
    cp, rational, tu, tv, inner = shape
    if len(tu) > 0:
        a, b = _tangents_at(tu[0], tv[0], u, v)
    elif len(inner) > 0:
        a, b = _gregory_at(cp, inner[0], u, v)
    else:
        a, b = _derivatives_at(cp, rational, u, v)
    return _unit_cross(a, b)


@helper
def mend_bezier_normals(cp, rational, s, n):
    """Normals where du x dv vanishes, or is too small or too large for float32."""
    for k in range(n):
        if s[S + k] == ZERO:
            u, v = np.float64(s[U + k]), np.float64(s[V + k])
            a, b = _derivatives_at(cp, rational, u, v)
            x, y, z = _unit_cross(a, b)
            if x == 0.0 and y == 0.0 and z == 0.0:
                a, b = _derivatives_at(cp, rational, u + (0.5 - u) * NUDGE, v + (0.5 - v) * NUDGE)
                x, y, z = _unit_cross(a, b)
            s[NX + k], s[NY + k], s[NZ + k] = np.float32(x), np.float32(y), np.float32(z)


@helper
def mend_normals(shape, s, n):
    """As `mend_bezier_normals`, of any patch."""
    for k in range(n):
        if s[S + k] == ZERO:
            u, v = np.float64(s[U + k]), np.float64(s[V + k])
            x, y, z = _normal_at(shape, u, v)
            if x == 0.0 and y == 0.0 and z == 0.0:
                x, y, z = _normal_at(shape, u + (0.5 - u) * NUDGE, v + (0.5 - v) * NUDGE)
            s[NX + k], s[NY + k], s[NZ + k] = np.float32(x), np.float32(y), np.float32(z)
