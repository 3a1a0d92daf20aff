"""Intervals as pairs (lo, hi) of numbers, plain or `Wide`, for kernels.

Rounding is the caller's to add, relative to magnitudes.
"""

from pipeline.jit import helper
from pipeline.wide import choose, greater, lesser


@helper
def add(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1]


@helper
def sub(a, b):
    """a - b."""
    return a[0] - b[1], a[1] - b[0]


@helper
def mul(a, b):
    """a b."""
    p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    return lesser(lesser(p, q), lesser(r, s)), greater(greater(p, q), greater(r, s))


@helper
def scale(x, a):
    """x a, x a number."""
    p, q = x * a[0], x * a[1]
    return lesser(p, q), greater(p, q)


@helper
def most(a):
    """Largest magnitude."""
    return greater(abs(a[0]), abs(a[1]))


@helper
def square(a):
    """a a, the same number twice."""
    p, q = a[0] * a[0], a[1] * a[1]
    return choose((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, lesser(p, q)), greater(p, q)


@helper
def cross_dot(q, a, b):
    """q . (a x b), vectors of three intervals."""
    x = sub(mul(a[1], b[2]), mul(a[2], b[1]))
    y = sub(mul(a[2], b[0]), mul(a[0], b[2]))
    z = sub(mul(a[0], b[1]), mul(a[1], b[0]))
    return add(add(mul(q[0], x), mul(q[1], y)), mul(q[2], z))


@helper
def _turn(a, b):
    """Largest |x y' - y x'| with x, x' in a and y, y' in b: centres cancel but for the other one's spread."""
    ca, cb, ra, rb = 0.5 * (a[0] + a[1]), 0.5 * (b[0] + b[1]), 0.5 * (a[1] - a[0]), 0.5 * (b[1] - b[0])
    return 2.0 * (abs(ca) * rb + abs(cb) * ra + ra * rb)


@helper
def bend(q, a):
    """Largest |q . (a' x a'')|, a' and a'' both in the box a."""
    return most(q[0]) * _turn(a[1], a[2]) + most(q[1]) * _turn(a[2], a[0]) + most(q[2]) * _turn(a[0], a[1])
