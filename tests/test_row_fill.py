"""Pixels of a row at once against the same one by one, and small triangles row by row against all pixels of their box."""

import numpy as np
import pytest

from pipeline.jit import kernel
from tiler.rasterizer import depth_limits, fill_small
from tiler.row_fill import LANES, count_bits, test_row

by_seed = pytest.mark.parametrize("seed", range(4))
test_row.__test__ = False  # a name that pytest takes for a test's


@kernel
def _test(depth, visible, place, count, values, steps, biases, plane, t, looks_first):
    return test_row(depth, visible, place, count, values, steps, biases, plane, t, looks_first)


@kernel
def _count(bits):
    return count_bits(bits)


@by_seed
def test_a_row_at_once_is_its_pixels_one_by_one(seed):
    rng = np.random.default_rng(seed)
    for _ in range(300):
        depth, visible = rng.uniform(0, 1, 40).astype(np.float32), rng.integers(-1, 9, 40).astype(np.int32)
        place, count = int(rng.integers(0, 30)), int(rng.integers(1, LANES + 3))
        values = tuple(float(v) for v in rng.integers(-2000, 4000, 3))
        steps = tuple(float(v) for v in rng.integers(-900, 900, 3))
        biases = tuple(float(v) for v in rng.integers(0, 2, 3))
        low, high = np.float32(0.2), np.float32(0.9)
        plane = (float(rng.uniform(0, 1)), *(float(v) for v in rng.uniform(-2e-4, 2e-4, 2)), low, high)
        arguments = (place, count, values, steps, biases, plane, 77, bool(rng.integers(2)))
        expected = depth.copy(), visible.copy()
        bits = _test.py_func(*expected, *arguments)
        assert _test(depth, visible, *arguments) == bits
        np.testing.assert_array_equal(depth, expected[0])
        np.testing.assert_array_equal(visible, expected[1])
        assert bits >> LANES & ~bits == 0, "what passed is covered"


def test_a_row_at_the_end_of_the_picture_touches_nothing_behind_it():
    depth, visible = np.ones(64, np.float32), np.full(64, -1, np.int32)
    plane = (0.5, 0.0, 0.0, np.float32(0), np.float32(1))
    inside = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    assert _test(depth[:61], visible[:61], 58, 3, *inside, plane, 5, False) == 0b111 << LANES | 0b111
    assert (visible != -1).nonzero()[0].tolist() == [58, 59, 60] and (depth[61:] == 1).all()


def test_of_equal_depths_a_zero_keeps_its_sign():
    """As Python's min and max, and Numba's: of equal ones the first."""
    inside, limits = ((1.0,) * 3, (0.0,) * 3, (0.0,) * 3), (np.float32(0.0), np.float32(1))
    for base in (0.0, -0.0):
        signs = []
        for run in (_test, _test.py_func):
            depth, visible = np.ones(8, np.float32), np.full(8, -1, np.int32)
            run(depth, visible, 0, 1, *inside, (base, -0.0, -0.0, *limits), 1, False)
            signs.append(np.signbit(depth[0]))
        assert signs[0] == signs[1]


def test_bits_are_counted():
    for bits in (0, 1, 0b1011, (1 << 40) - 1, (1 << 62) + 5):
        assert _count(bits) == count_bits(bits) == bin(bits).count("1")


@kernel
def _fill(t, box, corners, depths, width, depth, visible, ties, order, stored):
    (xa, ya), (xb, yb), (xc, yc) = corners
    z_a, z_b, z_c = depths
    lo, hi = depth_limits(z_a, z_b, z_c, (np.float32(0), np.float32(1)))
    x0, y0, x1, y1 = box
    return fill_small(
        t, x0, y0, x1, y1, xa, ya, xb, yb, xc, yc, z_a, z_b, z_c, lo, hi, width, depth, visible, ties, order, stored
    )  # fmt: skip


@by_seed
def test_rows_at_once_are_the_walk_that_asks_for_ties(seed):
    """Depths that never meet decide alike with ties and without; the walk with ties goes pixel by pixel."""
    rng = np.random.default_rng(seed)
    width, height = 40, 24
    depth, other = (np.ones(width * height, np.float32) for _ in range(2))
    visible, shown = (np.full(width * height, -1, np.int32) for _ in range(2))
    order, stored = np.arange(400), np.full(width * height, -1, np.int64)
    for t in range(400):
        corner = rng.integers(0, (width - 16, height - 16))
        points = 256 * corner + rng.integers(0, 16 * 256, (3, 2))
        (dx1, dy1), (dx2, dy2) = points[1] - points[0], points[2] - points[0]
        area = int(dx1 * dy2 - dy1 * dx2)
        if area == 0:
            continue
        points = points if area > 0 else points[[0, 2, 1]]
        low, high = points.min(axis=0) // 256, np.minimum((points.max(axis=0)) // 256, corner + 15)
        low[0] += rng.integers(0, 3)  # as where a tile begins
        if (low > high).any():
            continue
        box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        corners = tuple((np.int32(x), np.int32(y)) for x, y in points)
        depths = tuple(np.float32(z) for z in rng.uniform(0, 1, 3))
        found = _fill(t, box, corners, depths, width, depth, visible, False, order, stored)
        wanted = _fill(t, box, corners, depths, width, other, shown, True, order, stored)
        assert found == wanted, t
    np.testing.assert_array_equal(depth, other)
    np.testing.assert_array_equal(visible, shown)
    assert (visible >= 0).mean() > 0.5
