"""Restriction of a patch to a parametric domain [u0, u1] x [v0, v1]: its control net, texture rectangle, displacement.

All in float64 from the float32 inputs. The whole domain [0, 1] x [0, 1] changes no bit.

Rounding (e = 2^-53). A restricted control point is a blossom: three interpolations (1-t) p + t q an axis, two roundings
each, in weights that add up to 1. So a component is off by at most 12 e times the same combination of the magnitudes
|c[i,j]|, hence by 2^-49 max|c|; a restricted weight (all w > 0) by 2^-49 of itself, and a projected point by 2^-48
max|X/w|. Equal control points give that point, bit for bit where t has at most 29 bits; zeros stay zeros.
"""

import numpy as np

from pipeline.jit import helper, inlined
from pipeline.minmax import displacement_range

U = 2.0**-24
FAR = 2.0**29  # texels; the shader reads texel (0, 0) from twice as far on


@inlined
def _mix(p, q, t):
    return (1.0 - t) * p + t * q


@inlined
def cut_quadratic(p0, p1, p2, a, b):
    """Control values on [a, b] of a quadratic Bezier curve: its blossoms at (a,a), (a,b), (b,b)."""
    a0, a1 = _mix(p0, p1, a), _mix(p1, p2, a)
    b0, b1 = _mix(p0, p1, b), _mix(p1, p2, b)
    return _mix(a0, a1, a), _mix(a0, a1, b), _mix(b0, b1, b)


@inlined
def cut_cubic(p0, p1, p2, p3, a, b):
    """Control values on [a, b] of a cubic Bezier curve: its blossoms at (a,a,a), (a,a,b), (a,b,b), (b,b,b)."""
    a0, a1, a2 = _mix(p0, p1, a), _mix(p1, p2, a), _mix(p2, p3, a)
    b0, b1, b2 = _mix(p0, p1, b), _mix(p1, p2, b), _mix(p2, p3, b)
    aa0, aa1 = _mix(a0, a1, a), _mix(a1, a2, a)
    bb0, bb1 = _mix(b0, b1, b), _mix(b1, b2, b)
    return _mix(aa0, aa1, a), _mix(aa0, aa1, b), _mix(bb0, bb1, a), _mix(bb0, bb1, b)


@helper
def restrict_net(net, u0, u1, v0, v1):
    """Restrict net float64[3 or 4, 3 or 4, k] (Bezier control values along u and v) to the domain, in place."""
    rows, columns, size = net.shape
    if u0 != 0.0 or u1 != 1.0:
        for j in range(columns):
            for c in range(size):
                if rows == 4:
                    net[0, j, c], net[1, j, c], net[2, j, c], net[3, j, c] = cut_cubic(
                        net[0, j, c], net[1, j, c], net[2, j, c], net[3, j, c], u0, u1
                    )
                else:
                    net[0, j, c], net[1, j, c], net[2, j, c] = cut_quadratic(
                        net[0, j, c], net[1, j, c], net[2, j, c], u0, u1
                    )
    if v0 != 0.0 or v1 != 1.0:
        for i in range(rows):
            for c in range(size):
                if columns == 4:
                    net[i, 0, c], net[i, 1, c], net[i, 2, c], net[i, 3, c] = cut_cubic(
                        net[i, 0, c], net[i, 1, c], net[i, 2, c], net[i, 3, c], v0, v1
                    )
                else:
                    net[i, 0, c], net[i, 1, c], net[i, 2, c] = cut_quadratic(
                        net[i, 0, c], net[i, 1, c], net[i, 2, c], v0, v1
                    )


@helper
def restrict_patch(cp, u0, u1, v0, v1, net):
    """Fill net float64[4, 4, 4] with the homogeneous control points of patch cp float32[4, 4, 4] over the domain."""
    for i in range(4):
        for j in range(4):
            for c in range(4):
                net[i, j, c] = cp[i, j, c]
    restrict_net(net, u0, u1, v0, v1)


@helper
def project_net(net):
    """Divide the points of a homogeneous net float64[4, 4, 4] by their weights, in place: net[i, j, :3] = (x, y, z)."""
    for i in range(4):
        for j in range(4):
            w = net[i, j, 3]
            if w != 1.0:
                net[i, j, 0], net[i, j, 1], net[i, j, 2] = net[i, j, 0] / w, net[i, j, 1] / w, net[i, j, 2] / w


@inlined
def _coordinate_range(texcoords, axis, u0, u1, v0, v1):
    """Least and greatest texture coordinate (axis 0: s, 1: t) over the domain, with what float32 may be off by."""
    c00, c10 = np.float64(texcoords[0, axis]), np.float64(texcoords[1, axis])
    c01, c11 = np.float64(texcoords[2, axis]), np.float64(texcoords[3, axis])
    pad = 0.0
    if u0 != 0.0 or u1 != 1.0 or v0 != 0.0 or v1 != 1.0:
        pad = 8.0 * U * max(abs(c00), abs(c10), abs(c01), abs(c11))
    a, b = _mix(_mix(c00, c10, u0), _mix(c01, c11, u0), v0), _mix(_mix(c00, c10, u1), _mix(c01, c11, u1), v0)
    c, d = _mix(_mix(c00, c10, u0), _mix(c01, c11, u0), v1), _mix(_mix(c00, c10, u1), _mix(c01, c11, u1), v1)
    return min(a, b, c, d) - pad, max(a, b, c, d) + pad


@inlined
def texcoord_rect(texcoords, u0, u1, v0, v1):
    """(s0, s1, t0, t1): box of the texture coordinates that the shader computes over the domain, texcoords float32[4, 2].

    (s, t) is bilinear in (u, v), so its image lies in the convex hull of its values at the domain's corners. (Not always
    within the outline of the quad that they make, which Sathe 2011 takes: a quad may be concave or cross itself.)
    The shader's own rounding, 6 u of its largest product, is in the footprint that a query adds; but that knows the
    coordinates of the rectangle only, and in a sub-domain the products may be larger: 8 u of the largest corner then.
    """
    s0, s1 = _coordinate_range(texcoords, 0, u0, u1, v0, v1)
    t0, t1 = _coordinate_range(texcoords, 1, u0, u1, v0, v1)
    return s0, s1, t0, t1


@inlined
def domain_displacement(m, texcoords, maps, pyramids, u0, u1, v0, v1, exact):
    """Range of the displacement by map m over the domain, world units; (0, 0) without a map, NaN for a broken map.

    exact : from each texel of the footprint, not from at most four of a pyramid's level for each piece of it.
    """
    if m < 0:
        return 0.0, 0.0
    lo, hi = pyramids.whole[m, 0], pyramids.whole[m, 1]
    s0, s1, t0, t1 = texcoord_rect(texcoords, u0, u1, v0, v1)
    width, height = np.float64(pyramids.size[m, 0, 0]), np.float64(pyramids.size[m, 0, 1])
    near = max(abs(s0), abs(s1)) * width < FAR and max(abs(t0), abs(t1)) * height < FAR
    if not (near and lo > -np.inf and hi < np.inf):
        return lo, hi
    return displacement_range(maps, pyramids, m, s0, s1, t0, t1, exact)
