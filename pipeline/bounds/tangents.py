"""Control vectors of a patch's tangents over a domain, one patch at a time: `cones` says what they are."""

import math
from typing import NamedTuple

import numpy as np

from pipeline.bounds.restrict import restrict_net
from pipeline.jit import helper
from pipeline.types import F64

LIMIT, RATIONAL_LIMIT = 2.0**60, 2.0**26
LEAST_WEIGHT, MOST_WEIGHT = 2.0**-12, 2.0**12
NUDGE = 2.0**-9  # of domain.py

BINOMIALS = np.array([[math.comb(n, k) for k in range(7)] for n in range(7)], np.float64)


class Work(NamedTuple):
    """Scratch of one thread."""

    axes: F64  # (3, 3) frame, rows x, y, z
    along_u: F64  # (3, 4, 4) tangent net
    along_v: F64  # (4, 3, 4)
    rational_u: F64  # (5, 7, 4) of a rational patch
    rational_v: F64  # (7, 5, 4)
    factors_u: F64  # (3, 4, 9) nets that the rational ones are products of
    factors_v: F64  # (4, 3, 9)
    normals: F64  # (6, 6, 4) normal patch
    rational_normals: F64  # (11, 11, 4)


def make_work() -> Work:
    """Scratch, not initialized."""
    shapes = [(3, 3), (3, 4, 4), (4, 3, 4), (5, 7, 4), (7, 5, 4)]
    shapes += [(3, 4, 9), (4, 3, 9), (6, 6, 4), (11, 11, 4)]
    return Work(*(np.empty(shape) for shape in shapes))


@helper
def _length(x, y, z):
    return math.sqrt(x * x + y * y + z * z)


@helper
def _fill_differences(cp, along_u, along_v):
    """Tangent nets of a polynomial patch cp float32[4, 4, 4]."""
    for i in range(3):
        for j in range(4):
            for c in range(3):
                along_u[i, j, c] = np.float64(cp[i + 1, j, c]) - cp[i, j, c]
            along_u[i, j, 3] = _length(along_u[i, j, 0], along_u[i, j, 1], along_u[i, j, 2])
    for i in range(4):
        for j in range(3):
            for c in range(3):
                along_v[i, j, c] = np.float64(cp[i, j + 1, c]) - cp[i, j, c]
            along_v[i, j, 3] = _length(along_v[i, j, 0], along_v[i, j, 1], along_v[i, j, 2])


@helper
def _zero_corner(net, size):
    """Whether a corner of the net (its component `size`) is exactly zero."""
    i, j = net.shape[0] - 1, net.shape[1] - 1
    return net[0, 0, size] == 0.0 or net[i, 0, size] == 0.0 or net[0, j, size] == 0.0 or net[i, j, size] == 0.0


@helper
def _extend(a, b):
    """[a, b] with the points that the shader moves to from there."""
    return min(a, a + (0.5 - a) * NUDGE), max(b, b + (0.5 - b) * NUDGE)


@helper
def _fill_nets(cp, acc, tangent_u, tangent_v, along_u, along_v):
    """Tangent nets of a polynomial patch, or (acc >= 0) the tangent patches of that row."""
    if acc < 0:
        _fill_differences(cp, along_u, along_v)
        return
    for net, given in ((along_u, tangent_u[acc]), (along_v, tangent_v[acc])):
        for i in range(net.shape[0]):
            for j in range(net.shape[1]):
                for c in range(3):
                    net[i, j, c] = given[i, j, c]
                net[i, j, 3] = _length(net[i, j, 0], net[i, j, 1], net[i, j, 2])


@helper
def polynomial_nets(cp, acc, tangent_u, tangent_v, u0, u1, v0, v1, work):
    """Fill work.along_u and along_v over the domain, from cp float32[4, 4, 4] or from the tangent patches of row acc >= 0."""
    _fill_nets(cp, acc, tangent_u, tangent_v, work.along_u, work.along_v)
    if u0 == 0.0 and u1 == 1.0 and v0 == 0.0 and v1 == 1.0:
        return
    restrict_net(work.along_u, u0, u1, v0, v1)
    restrict_net(work.along_v, u0, u1, v0, v1)
    if _zero_corner(work.along_u, 3) or _zero_corner(work.along_v, 3):
        (u0, u1), (v0, v1) = _extend(u0, u1), _extend(v0, v1)
        _fill_nets(cp, acc, tangent_u, tangent_v, work.along_u, work.along_v)
        restrict_net(work.along_u, u0, u1, v0, v1)
        restrict_net(work.along_v, u0, u1, v0, v1)


@helper
def _fill_factors(cp, weight, radius, factors):
    """Factors float64[3, 4, 9] (along u) or [4, 3, 9] of a rational tangent: X_L and w_L, dX and dw, size."""
    rows, columns = factors.shape[0], factors.shape[1]
    step_u, step_v = 4 - rows, 4 - columns
    for i in range(rows):
        for j in range(columns):
            for c in range(4):
                left = np.float64(cp[i, j, c])
                factors[i, j, c] = left
                factors[i, j, 4 + c] = cp[i + step_u, j + step_v, c] - left
            d = factors[i, j]
            d[8] = weight * _length(d[4], d[5], d[6]) + radius * abs(d[7])


@helper
def _multiply_factors(factors, out):
    """out = w_L dX - dw X_L and its size, scaled: without the divisors of the product's basis."""
    rows, columns = factors.shape[0], factors.shape[1]
    m, n = rows - 1, columns - 1
    out[:] = 0.0
    for i in range(rows):
        for j in range(columns):
            left = factors[i, j]
            outer = BINOMIALS[m, i] * BINOMIALS[n, j]
            for k in range(rows):
                for h in range(columns):
                    right = factors[k, h]
                    scale = outer * BINOMIALS[m, k] * BINOMIALS[n, h]
                    target = out[i + k, j + h]
                    for c in range(3):
                        target[c] += scale * (left[3] * right[4 + c] - right[7] * left[c])
                    target[3] += scale * right[8]


@helper
def _rational_net(cp, weight, radius, u0, u1, v0, v1, factors, out):
    """Fill one tangent net over the domain; whether a corner of it is zero."""
    _fill_factors(cp, weight, radius, factors)
    restrict_net(factors, u0, u1, v0, v1)
    _multiply_factors(factors, out)
    return _zero_corner(factors, 8)


@helper
def rational_nets(cp, u0, u1, v0, v1, work):
    """Fill work.rational_u and rational_v over the domain; False where float32 weights lose too much."""
    weight, least, radius = 0.0, np.inf, 2.0**-60
    for i in range(4):
        for j in range(4):
            w = np.float64(cp[i, j, 3])
            weight, least = max(weight, w), min(least, w)
            radius = max(radius, _length(np.float64(cp[i, j, 0]), np.float64(cp[i, j, 1]), np.float64(cp[i, j, 2])))
    if not (least >= LEAST_WEIGHT and weight <= MOST_WEIGHT):
        return False
    zero = _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_u, work.rational_u)
    zero |= _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_v, work.rational_v)
    if zero and not (u0 == 0.0 and u1 == 1.0 and v0 == 0.0 and v1 == 1.0):
        (u0, u1), (v0, v1) = _extend(u0, u1), _extend(v0, v1)
        _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_u, work.rational_u)
        _rational_net(cp, weight, radius, u0, u1, v0, v1, work.factors_v, work.rational_v)
    return True
