"""Wide numbers: every operation is that of its scalar twin, lane by lane."""

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.wide import LANES, choose, floor, greater, lesser, load, root, spread, store

SPECIAL = np.array([0.0, -0.0, 1.0, -1.5, np.inf, -np.inf, np.nan, 1e308, 5e-324, 2.5, -2.5])


@helper
def _fold(s, a):
    """Tuples, loops and branches over Wides, and a plain array among them."""
    least, most = spread(np.inf), spread(-np.inf)
    for k in range(3):
        v = a[k] * load(s, 0) + load(s, 1)
        least, most = lesser(least, v), greater(most, v)
    return least, most


@kernel
def _operate(s, a, out):
    x, y = load(s, 0), load(s, 1)
    store(out, 0, x + y)
    store(out, 1, x - y)
    store(out, 2, x * y)
    store(out, 3, x / y)
    store(out, 4, lesser(x, y))
    store(out, 5, greater(x, y))
    store(out, 6, root(x))
    store(out, 7, floor(x))
    store(out, 8, abs(x))
    store(out, 9, -x)
    store(out, 10, choose((x < y) | (x >= 1.0), x, 7))
    store(out, 11, choose(~(x <= y) & (y > x * 0), 1.0, y))
    store(out, 12, 2 - x)
    store(out, 13, 1.0 / x)
    low, high = _fold(s, a)
    store(out, 14, low)
    store(out, 15, high)


def test_each_operation_is_its_scalar_twin():
    """Zeros of both signs, infinities, NaN and all pairs of them."""
    x, y = (axis.ravel() for axis in np.meshgrid(SPECIAL, SPECIAL))
    rest = -len(x) % LANES
    x, y = np.append(x, SPECIAL[:rest]), np.append(y, SPECIAL[::-1][:rest])
    a = np.array([0.5, -2.0, 3.0])
    with np.errstate(all="ignore"):
        least = most = None
        for k in range(3):
            v = a[k] * x + y
            least = np.where(v < (np.inf if k == 0 else least), v, np.inf if k == 0 else least)
            most = np.where(v > (-np.inf if k == 0 else most), v, -np.inf if k == 0 else most)
        expected = np.stack(
            [
                x + y, x - y, x * y, x / y, np.where(y < x, y, x), np.where(y > x, y, x), np.sqrt(x), np.floor(x), abs(x), -x,
                np.where((x < y) | (x >= 1), x, 7), np.where(~(x <= y) & (y > x * 0), 1, y), 2 - x, 1 / x, least, most,
            ]
        )  # fmt: skip
        got = np.empty_like(expected)
        for first in range(0, len(x), LANES):
            out = np.empty((16, LANES))
            _operate(np.stack([x, y])[:, first : first + LANES].copy(), a, out)
            got[:, first : first + LANES] = out
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(np.signbit(got[:6]), np.signbit(expected[:6]), "zeros have the same sign")


@kernel
def _plain(a, b):
    return lesser(a, b), greater(a, b), choose(a < b, a, b)


def test_plain_numbers_are_taken_too():
    assert tuple(map(float, _plain(1.0, 2.0))) == (1.0, 2.0, 1.0)
    assert tuple(map(float, _plain(3, 2.5))) == (2.5, 3.0, 2.5)
