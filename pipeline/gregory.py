"""Gregory patches: a bicubic patch whose four inner control points are quotients that depend on (u, v).

Loop, Schaefer, Ni, Castano 2009, section 3; the corners' points f+ and f- are in the order (u, v) = (0,0) (1,0) (1,1)
(0,1). On the four edges the inner points have no weight, so edges are those of a bicubic patch, bit for bit. The quotient
is 0/0 in a corner of the patch only, where its weight is 0: there it counts as 0.
"""

from pipeline.bezier import cubic, differences_u, differences_v, eval_34, eval_43, eval_44, quadratic
from pipeline.jit import helper


@helper
def inner_net(f, c):
    """Coordinate c of the points f[corner, +-]: four pairs."""
    return (f[0, 0, c], f[0, 1, c]), (f[1, 0, c], f[1, 1, c]), (f[2, 0, c], f[2, 1, c]), (f[3, 0, c], f[3, 1, c])


@helper
def _inverse(a, b, one):
    total = a + b
    return one / (total if total > one - one else one)


@helper
def inverse_weights(u, v, one):
    """1 / (sum of the weights) of the four quotients; `one` is 1 in the type to compute in."""
    s, r = one - u, one - v
    return _inverse(u, v, one), _inverse(v, s, one), _inverse(s, r, one), _inverse(r, u, one)


@helper
def _net_at(p, f, d, u, v, one):
    """The net p with its inner points as they are at (u, v); d: `inverse_weights`."""
    s, r = one - u, one - v
    b11 = (u * f[0][0] + v * f[0][1]) * d[0]
    b21 = (v * f[1][0] + s * f[1][1]) * d[1]
    b22 = (s * f[2][0] + r * f[2][1]) * d[2]
    b12 = (r * f[3][0] + u * f[3][1]) * d[3]
    return p[0], (p[1][0], b11, b21, p[1][3]), (p[2][0], b12, b22, p[2][3]), p[3]


@helper
def _slopes(f, d):
    """(f+ - f-) / (sum of weights)^2 of the four corners: the quotients' derivatives but for a factor u, v, 1-u or 1-v."""
    return (
        (f[0][0] - f[0][1]) * (d[0] * d[0]),
        (f[1][0] - f[1][1]) * (d[1] * d[1]),
        (f[2][0] - f[2][1]) * (d[2] * d[2]),
        (f[3][0] - f[3][1]) * (d[3] * d[3]),
    )


@helper
def gregory_value(p, f, d, u, v, one):
    """One coordinate at (u, v): its net p, inner pairs f, and d of `inverse_weights`."""
    return eval_44(_net_at(p, f, d, u, v, one), cubic(u, one), cubic(v, one))


@helper
def gregory_u(p, f, d, u, v, one):
    """A third of the derivative along u."""
    bu, bv, r = cubic(u, one), cubic(v, one), one - v
    k = _slopes(f, d)
    low = v * (k[0] * (bu[1] * bv[1]) + k[1] * (bu[2] * bv[1]))
    high = r * (k[2] * (bu[2] * bv[2]) + k[3] * (bu[1] * bv[2]))
    third = one / (one + one + one)
    return eval_34(differences_u(_net_at(p, f, d, u, v, one)), quadratic(u, one), bv) + (low - high) * third


@helper
def gregory_v(p, f, d, u, v, one):
    """A third of the derivative along v."""
    bu, bv, s = cubic(u, one), cubic(v, one), one - u
    k = _slopes(f, d)
    left = u * (k[0] * (bu[1] * bv[1]) + k[3] * (bu[1] * bv[2]))
    right = s * (k[1] * (bu[2] * bv[1]) + k[2] * (bu[2] * bv[2]))
    third = one / (one + one + one)
    return eval_43(differences_v(_net_at(p, f, d, u, v, one)), bu, quadratic(v, one)) + (right - left) * third
