"""Bernstein polynomials of degree 2 and 3, and sums over them, as float32 shader code evaluates them.

Every sum is symmetric under reversal of its parameter (t -> 1-t with the control points in reverse order): the outer
pair and the inner pair are added first, and 1-t is exact because t is a multiple of 2^-16. At t = 0 and t = 1 a sum
returns its end point bit for bit. So two patches that share an edge compute the same points on it, whichever way and
along whichever parameter each runs.
"""

from pipeline.jit import helper


@helper
def cubic(t, one):
    """Cubic Bernstein polynomials at t; `one` is 1 in the type to compute in."""
    s = one - t
    tt = t * t
    ss = s * s
    three = one + one + one
    return ss * s, (three * t) * ss, (three * s) * tt, tt * t


@helper
def quadratic(t, one):
    """Quadratic Bernstein polynomials at t."""
    s = one - t
    st = s * t
    return s * s, st + st, t * t


@helper
def sum4(b, p):
    """Sum of b[i] * p[i], symmetric under reversal."""
    return (b[0] * p[0] + b[3] * p[3]) + (b[1] * p[1] + b[2] * p[2])


@helper
def sum3(b, p):
    """Sum of b[i] * p[i], symmetric under reversal."""
    return (b[0] * p[0] + b[2] * p[2]) + b[1] * p[1]


# Nets of one coordinate: a tuple over j (along v) of tuples over i (along u). As tuples they are registers to the
# compiler, not memory that a store might change, and loops over points vectorize.


@helper
def net(cp, c):
    """Coordinate c of the control points cp[i, j]: 4 x 4."""
    return (
        (cp[0, 0, c], cp[1, 0, c], cp[2, 0, c], cp[3, 0, c]),
        (cp[0, 1, c], cp[1, 1, c], cp[2, 1, c], cp[3, 1, c]),
        (cp[0, 2, c], cp[1, 2, c], cp[2, 2, c], cp[3, 2, c]),
        (cp[0, 3, c], cp[1, 3, c], cp[2, 3, c], cp[3, 3, c]),
    )


@helper
def net_34(p, c):
    """Coordinate c of control vectors p[i, j], 3 along u and 4 along v."""
    return (
        (p[0, 0, c], p[1, 0, c], p[2, 0, c]),
        (p[0, 1, c], p[1, 1, c], p[2, 1, c]),
        (p[0, 2, c], p[1, 2, c], p[2, 2, c]),
        (p[0, 3, c], p[1, 3, c], p[2, 3, c]),
    )


@helper
def net_43(p, c):
    """Coordinate c of control vectors p[i, j], 4 along u and 3 along v."""
    return (
        (p[0, 0, c], p[1, 0, c], p[2, 0, c], p[3, 0, c]),
        (p[0, 1, c], p[1, 1, c], p[2, 1, c], p[3, 1, c]),
        (p[0, 2, c], p[1, 2, c], p[2, 2, c], p[3, 2, c]),
    )


@helper
def _steps(p):
    return p[1] - p[0], p[2] - p[1], p[3] - p[2]


@helper
def _sub(p, q):
    return p[0] - q[0], p[1] - q[1], p[2] - q[2], p[3] - q[3]


@helper
def differences_u(p):
    """Control-point differences along u: 3 along u, 4 along v. One third of the derivative's control points."""
    return _steps(p[0]), _steps(p[1]), _steps(p[2]), _steps(p[3])


@helper
def differences_v(p):
    """Control-point differences along v: 4 along u, 3 along v."""
    return _sub(p[1], p[0]), _sub(p[2], p[1]), _sub(p[3], p[2])


@helper
def eval_44(p, bu, bv):
    """Value of a 4 x 4 net: along u first, then along v."""
    return sum4(bv, (sum4(bu, p[0]), sum4(bu, p[1]), sum4(bu, p[2]), sum4(bu, p[3])))


@helper
def eval_34(p, qu, bv):
    """Value of a net with 3 control points along u and 4 along v."""
    return sum4(bv, (sum3(qu, p[0]), sum3(qu, p[1]), sum3(qu, p[2]), sum3(qu, p[3])))


@helper
def eval_43(p, bu, qv):
    """Value of a net with 4 control points along u and 3 along v."""
    return sum3(qv, (sum4(bu, p[0]), sum4(bu, p[1]), sum4(bu, p[2])))
