"""Bounds of unit normals, one patch at a time: rational patches, and what the lanes of `normals` leave.

The mathematics and its rounding: `cones`.
"""

import math

import numpy as np

from pipeline.bounds.cones import RATIONAL_TANGENT, TANGENT, U, combine_tangent_cones, cone_about, widen
from pipeline.bounds.fit import AXES, COSINE, SINE
from pipeline.bounds.tangents import BINOMIALS, LIMIT, RATIONAL_LIMIT, make_work, polynomial_nets, rational_nets
from pipeline.jit import helper, kernel
from pipeline.types import F64, I64, HullInput


@helper
def scale_net(net):
    """Multiply each vector by the binomials of its place, in place: a product of nets is then a plain convolution."""
    m, n = net.shape[0] - 1, net.shape[1] - 1
    for i in range(m + 1):
        for j in range(n + 1):
            scale = BINOMIALS[m, i] * BINOMIALS[n, j]
            for c in range(4):
                net[i, j, c] *= scale


@helper
def multiply_tangents(along_u, along_v, normals):
    """Control vectors of the normal patch, without the divisors of its basis: cross products of scaled tangent nets.

    Of bi-degree (2m-1, 2n-1) for a polynomial patch of bi-degree (m, n): degrees add along each axis. (Munkberg et al.
    print m+n-1 for both.) Sizes are multiplied and added.
    """
    normals[:] = 0.0
    for i in range(along_u.shape[0]):
        for j in range(along_u.shape[1]):
            ax, ay, az, size = along_u[i, j]
            for k in range(along_v.shape[0]):
                for h in range(along_v.shape[1]):
                    b, n = along_v[k, h], normals[i + k, j + h]
                    n[0] += ay * b[2] - az * b[1]
                    n[1] += az * b[0] - ax * b[2]
                    n[2] += ax * b[1] - ay * b[0]
                    n[3] += size * b[3]


@helper
def _cone_of_normals(along_u, along_v, normals, z, limit, tangent_error):
    """NPATCH: (cos, sin) of the cone about z of the normal patch; (-1, 1) where there is none. The nets are scaled."""
    for net in (along_u, along_v):
        for i in range(net.shape[0]):
            for j in range(net.shape[1]):
                if not net[i, j, 3] < limit:
                    return -1.0, 1.0
    multiply_tangents(along_u, along_v, normals)
    steep, spread = cone_about(normals, z[0], z[1], z[2], np.inf)
    if not steep < np.inf:
        return -1.0, 1.0
    cosine = 1.0 / math.sqrt(1.0 + steep)
    return widen(math.sqrt(steep) * cosine, cosine, (2.0 * tangent_error + 3.0) * U * spread + U)


@helper
def _tangent_cones(along_u, along_v, axes, cos_beta, sin_beta, limit, tangent_error):
    if not sin_beta > 0.0:
        return -1.0, 1.0, 1.0, 1.0
    x, y = axes[0], axes[1]
    cone_t = cone_about(along_u, x[0], x[1], x[2], limit)
    b = (cos_beta * x[0] + sin_beta * y[0], cos_beta * x[1] + sin_beta * y[1], cos_beta * x[2] + sin_beta * y[2])
    cone_b = cone_about(along_v, b[0], b[1], b[2], limit)
    cosine, sine, p, q, _ = combine_tangent_cones(cone_t, cone_b, cos_beta, sin_beta, tangent_error)
    return cosine, sine, p, q


@helper
def _bound_normal(patches, p, domain, cos_beta, sin_beta, normals, work):
    """(cos, sin, x, y) of patch p over its domain, in frame work.axes: of TPATCH, or (normals) the narrower cone of NPATCH."""
    cp, acc = patches.control_points[p], patches.tangent_id[p]
    u0, u1, v0, v1 = domain[p]
    if patches.rational[p] and acc < 0:
        if not rational_nets(cp, u0, u1, v0, v1, work):
            return -1.0, 1.0, 1.0, 1.0
        bound = _tangent_cones(
            work.rational_u, work.rational_v, work.axes, cos_beta, sin_beta, RATIONAL_LIMIT, RATIONAL_TANGENT
        )  # fmt: skip
        if normals:
            cosine, sine = _cone_of_normals(
                work.rational_u, work.rational_v, work.rational_normals, work.axes[2], RATIONAL_LIMIT, RATIONAL_TANGENT
            )  # fmt: skip
            bound = max(bound[0], cosine), min(bound[1], sine), bound[2], bound[3]
        return bound
    polynomial_nets(cp, acc, patches.tangent_u, patches.tangent_v, u0, u1, v0, v1, work)
    bound = _tangent_cones(work.along_u, work.along_v, work.axes, cos_beta, sin_beta, LIMIT, TANGENT)
    if normals:
        scale_net(work.along_u)
        scale_net(work.along_v)
        cosine, sine = _cone_of_normals(work.along_u, work.along_v, work.normals, work.axes[2], LIMIT, TANGENT)
        bound = max(bound[0], cosine), min(bound[1], sine), bound[2], bound[3]
    return bound


@kernel
def _bound_normals(patches, numbers, domain, boxes, normals, tight, work, out):
    for k in range(len(numbers)):
        p = numbers[k]
        for r in range(3):
            for c in range(3):
                work.axes[r, c] = boxes[AXES + 3 * r + c, p]
        cosine, sine, x, y = _bound_normal(patches, p, domain, boxes[COSINE, p], boxes[SINE, p], normals, work)
        out[0, p], out[1, p] = x if tight else sine, y if tight else sine
        out[2, p] = out[3, p] = cosine


def bound_normals(stage: HullInput, numbers: I64, boxes: F64, normals: bool, tight: bool, out: F64) -> None:
    """Fill the columns `numbers` of out float64[4, n] as `normals.bound_normals` does: TPATCH, its tight form, or NPATCH."""
    _bound_normals(stage.patches, numbers, stage.domain, boxes, normals, tight, make_work(), out)
