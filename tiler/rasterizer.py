"""Rasterization of one triangle inside one rectangle: exact coverage, depth, early depth test, visible triangle id.

Coverage is exact in integers: top-left rule on 16.8 positions (D3D11.3 functional specification 3.4.2). Depth is linear
in screen space, float64 from the exact edge values, rounded to float32 and clamped to the triangle's own range, so that
a triangle's depth bounds are rigorous. The depth function is LESS; of equal depths the first submitted stays: the first
that comes where triangles come in submit order, else the one of lower number (`tiler/order.py`). What passes writes its
depth and its triangle number; shading comes later, for the triangles that stay visible.
"""

from typing import Any

import numpy as np
from numba import extending
from numba.cpython.unsafe import numbers

from pipeline.inside import SIDE
from pipeline.jit import helper, inlined
from tiler.order import comes_before
from tiler.row_fill import LANES, count_bits, test_row

BLOCK_LOG2 = 3  # triangles wider than a block are walked by blocks of 8x8 pixels, and blocks outside an edge skipped
SMALL = 1 << BLOCK_LOG2
IN_LOOP = 2 * SMALL  # pixels a side of what `fill_small` is for

# Standard patterns (19.2.4): offsets of the samples from the pixel centre, 1/256 pixel, x right, y down.
SAMPLE_X = {1: np.array([0], np.int64), 4: np.array([-2, 6, -6, 2], np.int64) * 16}
SAMPLE_Y = {1: np.array([0], np.int64), 4: np.array([-6, -2, 2, 6], np.int64) * 16}
MARGIN = {1: 0, 4: 96}  # farthest sample from the centre along an axis


def _num_pairs(odd: int, bits: int) -> int:
    """Pairs of columns, aligned to even ones, that hold the set bits of four columns from an even or odd one on."""
    return len({(column + odd) >> 1 for column in range(SIDE) if bits >> column & 1})


_PAIRS = np.array([_num_pairs(*place) for place in np.ndindex(2, 16)], np.uint8)  # [16 * odd + bits]


@inlined
def num_quads(x0, y0, bits):
    """2x2 blocks, aligned to even pixels, that hold the set bits of a `types.Triangles.cover` of a box from (x0, y0) on."""
    if bits & (bits - 1) == 0:
        return np.int64(bits != 0)
    odd = np.uint32(16 * (x0 & 1))
    rows = bits << (4 * (y0 & 1))  # five, the first even
    rows |= rows >> 4
    first, second, third = np.uint32(rows & 15), np.uint32((rows >> 8) & 15), np.uint32((rows >> 16) & 15)
    return np.int64(_PAIRS[odd + first]) + np.int64(_PAIRS[odd + second]) + np.int64(_PAIRS[odd + third])


@inlined
def _top_left_bias(dx, dy):
    """0 where a sample exactly on the edge is inside (a top or a left edge), else -1."""
    return 0 if (dy < 0 or (dy == 0 and dx > 0)) else -1


@inlined
def depth_limits(z0, z1, z2, depth_range):
    """Nearest and farthest depth that a triangle of these corners can give: what `_depth` clamps to."""
    lo = min(max(min(z0, z1, z2), depth_range[0]), depth_range[1])
    hi = min(max(max(z0, z1, z2), depth_range[0]), depth_range[1])
    return lo, hi


@inlined
def _make_plane(z0, z1, z2, lo, hi, twice_area):
    """z0, what z gains with edge functions 1 and 2, in float64, and the range that depths are clamped to (`depth_limits`)."""
    base, area = np.float64(z0), np.float64(twice_area)
    return base, (np.float64(z1) - base) / area, (np.float64(z2) - base) / area, lo, hi


@helper
def _depth_plane(triangles, window, t, depth_range, twice_area):
    z0 = window.z[triangles.vertex[t, 0]]
    z1 = window.z[triangles.vertex[t, 1]]
    z2 = window.z[triangles.vertex[t, 2]]
    lo, hi = depth_limits(z0, z1, z2, depth_range)
    return _make_plane(z0, z1, z2, lo, hi, twice_area)


@inlined
def _depth(plane, e1, e2):
    """Depth where the edge functions 1 and 2 are e1 and e2: float64, rounded to float32, clamped."""
    base, along_1, along_2, lo, hi = plane
    z = np.float32(base + (np.float64(e1) * along_1 + np.float64(e2) * along_2))
    return min(max(z, lo), hi)


@inlined
def _fill_rows(t, x0, y0, x1, y1, values, down, right, biases, plane, width, depth, visible, looks_first):
    """Test the centre of pixels x0..x1, y0..y1 where triangles come in submit order: row by row, LANES pixels at a time.

    values : of the edge functions at the first pixel, without bias. down, right : dx and dy of the edges. looks_first : as in
    `test_row`; it pays in large triangles, whose rows are hidden or covered whole more often.
    """
    e0, e1, e2 = np.float64(values[0]), np.float64(values[1]), np.float64(values[2])
    down0, down1, down2 = np.float64(down[0] << 8), np.float64(down[1] << 8), np.float64(down[2] << 8)
    steps = np.float64(right[0] << 8), np.float64(right[1] << 8), np.float64(right[2] << 8)
    least = np.float64(-biases[0]), np.float64(-biases[1]), np.float64(-biases[2])
    covered, passed, quads, two_rows = 0, 0, 0, 0
    odd = x0 & 1
    for row in range(y0, y1 + 1):
        two_rows = two_rows if row & 1 else 0  # bit k: something passed in column k - odd of this pair of rows
        for column in range(x0, x1 + 1, LANES):
            k = np.float64(column - x0)
            now = e0 - k * steps[0], e1 - k * steps[1], e2 - k * steps[2]
            bits = test_row(
                depth, visible, row * width + column, x1 + 1 - column, now, steps, least, plane, t, looks_first
            )  # fmt: skip
            covered += count_bits(bits & ((1 << LANES) - 1))
            won = bits >> LANES
            passed += count_bits(won)
            two_rows |= won << (odd + column - x0)
        if row & 1 or row == y1:
            quads += count_bits((two_rows | (two_rows >> 1)) & 0x55555)
        e0, e1, e2 = e0 + down0, e1 + down1, e2 + down2
    return covered, passed, quads


@inlined
def fill_small(
    t, x0, y0, x1, y1, xa, ya, xb, yb, xc, yc, z_a, z_b, z_c, lo, hi, width, depth, visible, ties, order, stored
):  # fmt: skip
    """Rasterize a triangle at the centre of pixels x0..x1, y0..y1, few of them: without blocks, and without arrays to set up.

    xa .. yc : its window vertices. z_a, z_b, z_c : their depths, and lo, hi what `depth_limits` says of them. depth,
    visible, stored : flat, one sample a pixel, rows of `width`. Returns samples covered, samples passed, 2x2 blocks of
    pixels with a sample passed.
    """
    x, y = (x0 << 8) + 128, (y0 << 8) + 128
    rx, ry = np.int64(xc) - x, np.int64(yc) - y  # corners from the first pixel's centre
    qx, qy = np.int64(xb) - x, np.int64(yb) - y
    px, py = np.int64(xa) - x, np.int64(ya) - y
    dx0, dy0, dx1, dy1, dx2, dy2 = rx - qx, ry - qy, px - rx, py - ry, qx - px, qy - py
    b0, b1, b2 = _top_left_bias(dx0, dy0), _top_left_bias(dx1, dy1), _top_left_bias(dx2, dy2)
    e0 = dy0 * qx - dx0 * qy + b0
    e1 = dy1 * rx - dx1 * ry + b1
    e2 = dy2 * px - dx2 * py + b2
    plane = _make_plane(z_a, z_b, z_c, lo, hi, dx2 * (ry - py) - dy2 * (rx - px))
    if not ties:
        return _fill_rows(
            t, x0, y0, x1, y1, (e0 - b0, e1 - b1, e2 - b2), (dx0, dx1, dx2), (dy0, dy1, dy2), (b0, b1, b2), plane, width,
            depth, visible, False,
        )  # fmt: skip
    covered, passed, quads, quads_of_rows = 0, 0, 0, 0
    for row in range(y0, y1 + 1):
        quads_of_rows = quads_of_rows if row & 1 else 0  # bit k: the k-th block of this pair of rows is counted
        f0, f1, f2 = e0, e1, e2
        entered = False
        for column in range(x0, x1 + 1):
            if (f0 | f1 | f2) >= 0:
                entered = True
                covered += 1
                k = row * width + column
                d = depth[k]
                z = _depth(plane, f1 - b1, f2 - b2)
                if z < d or (z == d and comes_before(t, visible[k], order, stored[k])):
                    depth[k] = z
                    visible[k] = t
                    passed += 1
                    quad = 1 << ((column >> 1) - (x0 >> 1))
                    quads += (quads_of_rows & quad) == 0
                    quads_of_rows |= quad
            elif entered:
                break  # a triangle is convex: the row is done
            f0 -= dy0 << 8
            f1 -= dy1 << 8
            f2 -= dy2 << 8
        e0 += dx0 << 8
        e1 += dx1 << 8
        e2 += dx2 << 8
    return covered, passed, quads


def lowest_bit(bits: Any) -> int:
    """Number of the lowest bit that is set, of an integer that is not 0."""
    return (int(bits) & -int(bits)).bit_length() - 1


_trailing_zeros: Any = numbers.trailing_zeros


@extending.overload(lowest_bit)
def _lowest_bit(bits):
    return lambda bits: np.int64(_trailing_zeros(bits))


@inlined
def fill_covered(
    bits, t, x0, y0, xa, ya, xb, yb, xc, yc, z_a, z_b, z_c, lo, hi, width, depth, visible, ties, order, stored
):  # fmt: skip
    """As `fill_small`, of a triangle whose box begins at pixel (x0, y0) and of which is known what it covers.

    bits : as in `types.Triangles.cover`, of the pixels that are to be drawn.
    """
    x, y = (x0 << 8) + 128, (y0 << 8) + 128
    rx, ry = np.int64(xc) - x, np.int64(yc) - y
    qx, qy = np.int64(xb) - x, np.int64(yb) - y
    px, py = np.int64(xa) - x, np.int64(ya) - y
    dx1, dy1, dx2, dy2 = px - rx, py - ry, qx - px, qy - py
    e1 = dy1 * rx - dx1 * ry
    e2 = dy2 * px - dx2 * py
    plane = _make_plane(z_a, z_b, z_c, lo, hi, dx2 * (ry - py) - dy2 * (rx - px))
    first = y0 * width + x0
    covered, passed, seen = 0, 0, np.int64(0)
    while bits:
        place = lowest_bit(bits)
        bit = bits & -bits
        bits ^= bit
        covered += 1
        row, column = place >> 2, place & 3
        k = np.uint32(first + row * width + column)  # an index that may be negative costs a test
        d = depth[k]
        if lo < d or ties:
            f1 = e1 + ((dx1 * row - dy1 * column) << 8)
            f2 = e2 + ((dx2 * row - dy2 * column) << 8)
            z = _depth(plane, f1, f2)
            if z < d or (ties and z == d and comes_before(t, visible[k], order, stored[k])):
                depth[k] = z
                visible[k] = t
                passed += 1
                seen |= bit
    return covered, passed, num_quads(x0, y0, seen)


@helper
def _fill_block(x0, y0, x1, y1, t, edges, plane, depth, visible):
    """As `_fill`, where triangles come in submit order."""
    (dx0, dy0, c0, b0), (dx1, dy1, c1, b1), (dx2, dy2, c2, b2) = edges
    e0 = c0 + ((dx0 * y0 - dy0 * x0) << 8)
    e1 = c1 + ((dx1 * y0 - dy1 * x0) << 8)
    e2 = c2 + ((dx2 * y0 - dy2 * x0) << 8)
    covered, passed, quads = _fill_rows(
        t, x0, y0, x1, y1, (e0, e1, e2), (dx0, dx1, dx2), (dy0, dy1, dy2), (b0, b1, b2), plane, depth.shape[1], depth.ravel(),
        visible.ravel(), True,
    )  # fmt: skip
    return covered, passed, passed, quads


@helper
def _fill(x0, y0, x1, y1, t, edges, plane, depth, visible, order, stored):
    """Test the centre of pixels x0..x1, y0..y1, where triangles may come out of submit order.

    Returns samples covered, samples passed, pixels with a sample passed, 2x2 blocks of pixels with such a pixel.
    edges : for each edge (dx, dy, value at the centre of pixel (0, 0) without bias, bias).
    """
    (dx0, dy0, c0, b0), (dx1, dy1, c1, b1), (dx2, dy2, c2, b2) = edges
    step0, step1, step2 = dy0 << 8, dy1 << 8, dy2 << 8
    covered, passed, quads, quads_of_rows = 0, 0, 0, 0
    for y in range(y0, y1 + 1):
        quads_of_rows = quads_of_rows if y & 1 else 0  # bit k: the k-th block of this pair of rows is counted
        e0 = c0 + b0 + ((dx0 * y - dy0 * x0) << 8)
        e1 = c1 + b1 + ((dx1 * y - dy1 * x0) << 8)
        e2 = c2 + b2 + ((dx2 * y - dy2 * x0) << 8)
        entered = False
        for x in range(x0, x1 + 1):
            if (e0 | e1 | e2) >= 0:
                entered = True
                covered += 1
                d = depth[y, x, 0]
                z = _depth(plane, e1 - b1, e2 - b2)
                if z < d or (z == d and comes_before(t, visible[y, x, 0], order, stored[y, x, 0])):
                    depth[y, x, 0] = z
                    visible[y, x, 0] = t
                    passed += 1
                    quad = 1 << ((x >> 1) - (x0 >> 1))
                    quads += (quads_of_rows & quad) == 0
                    quads_of_rows |= quad
            elif entered:
                break  # a triangle is convex: the row is done
            e0 -= step0
            e1 -= step1
            e2 -= step2
    return covered, passed, passed, quads


@helper
def _fill_samples(
    x0, y0, x1, y1, t, edges, plane, sample_x, sample_y, depth, visible, ties, order, stored
):  # fmt: skip
    """As `_fill`, for every sample of a pattern of several."""
    (dx0, dy0, c0, b0), (dx1, dy1, c1, b1), (dx2, dy2, c2, b2) = edges
    covered, passed, pixels, quads, quads_of_rows = 0, 0, 0, 0, 0
    for y in range(y0, y1 + 1):
        quads_of_rows = quads_of_rows if y & 1 else 0
        for x in range(x0, x1 + 1):
            e0 = c0 + ((dx0 * y - dy0 * x) << 8)
            e1 = c1 + ((dx1 * y - dy1 * x) << 8)
            e2 = c2 + ((dx2 * y - dy2 * x) << 8)
            before = passed
            for s in range(len(sample_x)):
                ox, oy = sample_x[s], sample_y[s]
                s0 = e0 + dx0 * oy - dy0 * ox
                s1 = e1 + dx1 * oy - dy1 * ox
                s2 = e2 + dx2 * oy - dy2 * ox
                if ((s0 + b0) | (s1 + b1) | (s2 + b2)) >= 0:
                    covered += 1
                    d = depth[y, x, s]
                    if plane[3] >= d and not ties:
                        continue
                    z = _depth(plane, s1, s2)
                    if z < d or (ties and z == d and comes_before(t, visible[y, x, s], order, stored[y, x, s])):
                        depth[y, x, s] = z
                        visible[y, x, s] = t
                        passed += 1
            if passed > before:
                pixels += 1
                quad = 1 << ((x >> 1) - (x0 >> 1))
                quads += (quads_of_rows & quad) == 0
                quads_of_rows |= quad
    return covered, passed, pixels, quads


@helper
def _reaches(edge, x0, y0, x1, y1, margin):
    """Whether some sample position in the rectangle can be inside the edge: its value where it is largest."""
    dx, dy, c, bias = edge
    x = x0 if dy > 0 else x1
    y = y1 if dx > 0 else y0
    return c + ((dx * y - dy * x) << 8) + (abs(dx) + abs(dy)) * margin + bias >= 0


@helper
def reaches_all(edges, x0, y0, x1, y1, margin):
    """Whether none of the three edges keeps all sample positions of the rectangle outside."""
    return (
        _reaches(edges[0], x0, y0, x1, y1, margin)
        and _reaches(edges[1], x0, y0, x1, y1, margin)
        and _reaches(edges[2], x0, y0, x1, y1, margin)
    )


@helper
def triangle_edges(window, a, b, c):
    """Edge functions of a clockwise triangle, edge i opposite vertex i, and twice its area (both exact, 1/2^16 px^2)."""
    xa, ya = np.int64(window.x[a]), np.int64(window.y[a])
    xb, yb = np.int64(window.x[b]), np.int64(window.y[b])
    xc, yc = np.int64(window.x[c]), np.int64(window.y[c])
    dx0, dy0 = xc - xb, yc - yb
    dx1, dy1 = xa - xc, ya - yc
    dx2, dy2 = xb - xa, yb - ya
    edge0 = (dx0, dy0, dx0 * (128 - yb) - dy0 * (128 - xb), _top_left_bias(dx0, dy0))
    edge1 = (dx1, dy1, dx1 * (128 - yc) - dy1 * (128 - xc), _top_left_bias(dx1, dy1))
    edge2 = (dx2, dy2, dx2 * (128 - ya) - dy2 * (128 - xa), _top_left_bias(dx2, dy2))
    return (edge0, edge1, edge2), dx2 * (yc - ya) - dy2 * (xc - xa)


@helper
def rasterize(
    t, x0, y0, x1, y1, triangles, window, sample_x, sample_y, margin, depth_range, depth, visible, ties, order, stored
):  # fmt: skip
    """Rasterize triangle t inside pixels x0..x1, y0..y1 of its box; `depth`, `visible` modified in place.

    depth : float32[H, W, S]; visible : int32[H, W, S]. ties : whether triangles may come out of submit order; then order :
    int64[T], their submit numbers, and stored : int64[H, W, S], that of what a sample showed before this batch.
    Returns (samples covered, samples that passed the depth test, pixels with a sample that passed, aligned 2x2 blocks of
    pixels with such a pixel).
    """
    a, b, c = triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2]
    edges, twice_area = triangle_edges(window, a, b, c)
    plane = _depth_plane(triangles, window, t, depth_range, twice_area)
    small = x1 - x0 < SMALL and y1 - y0 < SMALL
    covered, passed, pixels, quads = 0, 0, 0, 0
    for py0 in range(y0 if small else y0 & -SMALL, y1 + 1, SMALL):
        for px0 in range(x0 if small else x0 & -SMALL, x1 + 1, SMALL):
            bx0, by0, bx1, by1 = max(x0, px0), max(y0, py0), min(x1, px0 + SMALL - 1), min(y1, py0 + SMALL - 1)
            if small or reaches_all(edges, bx0, by0, bx1, by1, margin):
                if len(sample_x) == 1 and not ties:
                    n, m, p, q = _fill_block(bx0, by0, bx1, by1, t, edges, plane, depth, visible)
                elif len(sample_x) == 1:
                    n, m, p, q = _fill(bx0, by0, bx1, by1, t, edges, plane, depth, visible, order, stored)
                else:
                    n, m, p, q = _fill_samples(
                        bx0, by0, bx1, by1, t, edges, plane, sample_x, sample_y, depth, visible, ties, order, stored
                    )  # fmt: skip
                covered += n
                passed += m
                pixels += p
                quads += q
    return covered, passed, pixels, quads
