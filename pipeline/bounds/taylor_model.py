"""Taylor models of bi-degree (5, 5): a polynomial in s, t in [-1, 1] plus an interval that holds what it leaves out.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, after Berz and Makino. A polynomial is float64[6, 6], entry
[i, j] the coefficient of s^i t^j, i along u; a remainder and a range are tuples (lo, hi). A model stands for every function
f with f(s, t) - polynomial(s, t) in the remainder for all s, t. Ranges are those of the Bernstein coefficients over the
square, which enclose the polynomial and are exact for bilinear ones.

A product is multiplied out to bi-degree (10, 10); all that exceeds (5, 5) goes into the remainder by its Bernstein range.

float64 rounding (e = 2^-53): a coefficient of a product sums at most 36 products, a Bernstein coefficient at most 11 + 11,
the tables are rounded once. With |P| the sum of the magnitudes of P's coefficients everything is off by at most
(37 + 24) e |P| |Q|; ROUND = 128 e, of the sums with the remainders' magnitudes included, is added to each result.

Scratch is the caller's: `wide` float64[11, 11], `half` float64[12, 11]. Functions named `_into` write to `out`, which may
be one of the polynomials given.
"""

from math import comb

import numpy as np

from pipeline.jit import helper
from pipeline.types import F64

N = 6  # coefficients an axis
WIDE = 2 * N - 1  # those of a product
WIDE_SHAPE, HALF_SHAPE = (WIDE, WIDE), (WIDE + 1, WIDE)
ROUND = 2.0**-46

# (1 + y)^(-1/2) = sum of SERIES[k] y^k, and the magnitude of the next coefficient
SERIES = np.array([1.0, -1 / 2, 3 / 8, -5 / 16, 35 / 128, -63 / 256])
NEXT = 231 / 1024


def bernstein_table(degree: int) -> F64:
    """Row i: the Bernstein coefficients of s^i, s = 2u - 1, as a polynomial of that degree in u; float64[degree+1, degree+1].

    s^i = (u - (1-u))^i (u + (1-u))^(degree-i), multiplied out. All entries lie in [-1, 1].
    """
    size = degree + 1
    table = np.zeros((size, size))
    for i in range(size):
        for k in range(size):
            terms = (
                comb(i, m) * (-1) ** (i - m) * comb(degree - i, k - m)
                for m in range(max(0, i + k - degree), min(i, k) + 1)
            )
            table[i, k] = sum(terms) / comb(degree, k)
    return table


NARROW_TABLE = bernstein_table(N - 1)
WIDE_TABLE = bernstein_table(WIDE - 1)


@helper
def add_intervals(a, b):
    """{x + y}."""
    return a[0] + b[0], a[1] + b[1]


@helper
def multiply_intervals(a, b):
    """{x y}."""
    c, d, e, f = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    return min(min(c, d), min(e, f)), max(max(c, d), max(e, f))


@helper
def largest(a):
    """Greatest magnitude in an interval."""
    return max(abs(a[0]), abs(a[1]))


@helper
def magnitude(p):
    """Sum of the magnitudes of the coefficients."""
    total = 0.0
    for i in range(N):
        for j in range(N):
            total += abs(p[i, j])
    return total


@helper
def range_of(p, half):
    """Bernstein range of a polynomial."""
    for i in range(N):
        for k in range(N):
            half[i, k] = 0.0
        for j in range(N):
            for k in range(N):
                half[i, k] += p[i, j] * NARROW_TABLE[j, k]
    lo, hi = np.inf, -np.inf
    row = half[WIDE]
    for r in range(N):
        for k in range(N):
            row[k] = 0.0
        for i in range(N):
            for k in range(N):
                row[k] += NARROW_TABLE[i, r] * half[i, k]
        for k in range(N):
            lo, hi = min(lo, row[k]), max(hi, row[k])
    pad = ROUND * magnitude(p)
    return lo - pad, hi + pad


@helper
def add_product(p, q, wide):
    """Add p q, bi-degree (10, 10), to `wide`."""
    for i in range(N):
        for k in range(N):
            row = wide[i + k]
            for j in range(N):
                for m in range(N):
                    row[j + m] += p[i, j] * q[k, m]


@helper
def wide_range(wide, first, half):
    """Bernstein range of a polynomial of bi-degree (10, 10): of all of it (first = 0), or of its excess (first = N).

    The excess is the terms with i >= N or j >= N; no entry of `wide` changes.
    """
    for i in range(WIDE):
        for k in range(WIDE):
            half[i, k] = 0.0
        for j in range(first if i < N else 0, WIDE):
            for k in range(WIDE):
                half[i, k] += wide[i, j] * WIDE_TABLE[j, k]
    lo, hi = np.inf, -np.inf
    row = half[WIDE]
    for r in range(WIDE):
        for k in range(WIDE):
            row[k] = 0.0
        for i in range(WIDE):
            for k in range(WIDE):
                row[k] += WIDE_TABLE[i, r] * half[i, k]
        for k in range(WIDE):
            lo, hi = min(lo, row[k]), max(hi, row[k])
    return lo, hi


@helper
def truncate_into(wide, half, out):
    """The part of `wide` of bi-degree (5, 5) to `out`; returns the Bernstein range of the rest."""
    for i in range(N):
        for j in range(N):
            out[i, j] = wide[i, j]
    return wide_range(wide, N, half)


@helper
def clear(wide):
    """Fill with zeros."""
    for i in range(len(wide)):
        for j in range(len(wide)):
            wide[i, j] = 0.0


@helper
def multiply_into(p, p_rest, q, q_rest, q_range, wide, half, out):
    """Product of two models: polynomial to `out`, returns its remainder.

    q_range : the range of what q stands for, remainder included. With f = P + r and g = Q + s: f g = P Q + P s + r g, which
    encloses tighter than P Q + P s + Q r + r s where that range is known better than the sum of its parts.
    """
    pad = ROUND * (magnitude(p) + largest(p_rest)) * (magnitude(q) + largest(q_rest) + largest(q_range))
    rest = multiply_intervals(range_of(p, half), q_rest)
    rest = add_intervals(rest, multiply_intervals(p_rest, q_range))
    clear(wide)
    add_product(p, q, wide)
    rest = add_intervals(rest, truncate_into(wide, half, out))
    return rest[0] - pad, rest[1] + pad


@helper
def scale_into(p, rest, factor, out):
    """Model times a number: polynomial to `out`, returns the remainder."""
    pad = ROUND * (magnitude(p) + largest(rest)) * abs(factor)
    for i in range(N):
        for j in range(N):
            out[i, j] = factor * p[i, j]
    a, b = factor * rest[0], factor * rest[1]
    return min(a, b) - pad, max(a, b) + pad


@helper
def add_into(p, p_rest, q, q_rest, out):
    """Sum of two models: polynomial to `out`, returns the remainder."""
    pad = ROUND * (magnitude(p) + magnitude(q) + largest(p_rest) + largest(q_rest))
    for i in range(N):
        for j in range(N):
            out[i, j] = p[i, j] + q[i, j]
    return p_rest[0] + q_rest[0] - pad, p_rest[1] + q_rest[1] + pad


@helper
def square_length_into(v, rest, wide, half, out):
    """|v|^2 of a vector float64[3, 6, 6] of models with one remainder: polynomial to `out`; returns (remainder, range).

    The range is that of bi-degree (10, 10), before anything is cut off: far tighter than that of the parts, and whether
    |v| can be normalized hangs on it.
    """
    ranges = total = 0.0
    reach = largest(rest)
    clear(wide)
    for r in range(3):
        ranges += largest(range_of(v[r], half))
        total += magnitude(v[r]) + reach
        add_product(v[r], v[r], wide)
    pad = 2.0 * ranges * reach + 3.0 * reach * reach + 4.0 * ROUND * total * total
    lo, hi = wide_range(wide, 0, half)
    lowest, highest = truncate_into(wide, half, out)
    return (lowest - pad, highest + pad), (lo - pad, hi + pad)


@helper
def series_tail(r):
    """Largest value over |y| <= r of (1 + y)^(-1/2) minus its series to order 5; the least is 0.

    Lagrange: NEXT y^6 (1 + xi)^(-13/2), xi between 0 and y, so at most NEXT r^6 (1 - r)^(-13/2). That grows beyond all use as
    r nears 1, where the difference itself (all terms of the series are positive at y = -r) stays near (1 - r)^(-1/2).
    The smaller of the two; the difference cancels for small r, and is rounded by less than ROUND. Infinite from r = 1 on.
    """
    s = max(1.0 - r, 0.0)
    root = np.sqrt(s)
    lagrange = NEXT * (r * r * r) * (r * r * r) / (s * s * s * s * s * s * root)
    partial = 0.0
    for k in range(5, -1, -1):
        partial = partial * r + abs(SERIES[k])
    return min(lagrange * (1.0 + ROUND), (1.0 + ROUND) / root - partial + ROUND)


@helper
def rsqrt_into(q, q_rest, q_range, y, wide, half, out):
    """1 / sqrt of a model by a series of order 5 about the midpoint of its range: polynomial to `out`, returns its remainder.

    q_range : the range of what q stands for, above 0. y : float64[6, 6], scratch.
    """
    lo, hi = q_range
    middle = 0.5 * (lo + hi)
    r = (hi - lo) / (hi + lo) * (1.0 + ROUND) + ROUND
    y_rest = scale_into(q, q_rest, 1.0 / middle, y)
    y[0, 0] -= 1.0
    rest = scale_into(y, y_rest, SERIES[5], out)
    for k in range(4, 0, -1):
        out[0, 0] += SERIES[k]
        rest = multiply_into(out, rest, y, y_rest, (-r, r), wide, half, out)
    out[0, 0] += SERIES[0]
    return scale_into(out, (rest[0] - ROUND, rest[1] + series_tail(r) + ROUND), 1.0 / np.sqrt(middle), out)
