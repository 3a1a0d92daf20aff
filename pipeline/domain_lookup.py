"""Passes over rows: displacement by a map at the points (u, v) of a block, and its derivatives along u and v.

The same values as `displacement.fetch`, bit for bit, in three passes: where the texels lie, for all points at once; the texels,
one after the other; the sums, for all points at once. `ints` and `places` are the scratch as
int32 and as uint32: an index without a sign needs no test.
"""

import numpy as np

from pipeline.displacement import CLAMP, FAR_TEXEL, HALF, MIRROR, texel
from pipeline.domain_rows import FX, FY, GU, GV, I0, I1, J0, J1, ONE, T00, T01, T10, T11, ZERO, U, V
from pipeline.jit import inlined


@inlined
def _blend(c, u, v):
    """The texture coordinate at (u, v) from those of the corners; exact there, and symmetric under reversal of an edge."""
    u0, v0 = ONE - u, ONE - v
    return v0 * (u0 * c[0] + u * c[1]) + v * (u0 * c[2] + u * c[3])


@inlined
def _corners(texcoords, axis):
    """Texture coordinate `axis` of the corners (0,0) (1,0) (0,1) (1,1)."""
    return texcoords[0, axis], texcoords[1, axis], texcoords[2, axis], texcoords[3, axis]


@inlined
def _locate_pass(corners_s, corners_t, width, height, s, ints, n):
    """Rows FX and FY: fractions of the texel coordinates (texel centres at whole numbers). I0 and J0: their whole parts."""
    for k in range(n):
        u, v = s[U + k], s[V + k]
        x = _blend(corners_s, u, v) * width - HALF
        y = _blend(corners_t, u, v) * height - HALF
        near = (abs(x) < FAR_TEXEL) & (abs(y) < FAR_TEXEL)  # not where a coordinate is NaN
        x = x if near else ZERO
        y = y if near else ZERO
        i, j = np.floor(x), np.floor(y)
        s[FX + k], s[FY + k] = x - i, y - j
        ints[I0 + k], ints[J0 + k] = np.int32(i), np.int32(j)


@inlined
def _fold_pass(row, second, shift, period, size, ints, n):
    """Texels of WRAP and MIRROR for numbers that, `shift` added, are at least 0 and less than twice the period."""
    for k in range(n):
        i = np.int32(ints[row + k] + shift)
        j = np.int32(i + 1)
        i = np.int32(i - period) if i >= period else i
        j = np.int32(j - period) if j >= period else j
        ints[row + k] = i if i < size else np.int32(period - 1 - i)  # beyond the size in the second half of MIRROR only
        ints[second + k] = j if j < size else np.int32(period - 1 - j)


@inlined
def _address_pass(row, second, size, mode, ints, n):
    """Replace the numbers i of `row` by the texels read for them, and write those for i + 1 to `second`; an axis of `size`."""
    low, high = ints[row], ints[row]
    for k in range(n):
        low, high = min(low, ints[row + k]), max(high, ints[row + k])
    period = 2 * size if mode == MIRROR else size
    shift = -(low // period * period)
    if low >= 0 and high + 1 < size:
        for k in range(n):
            ints[second + k] = ints[row + k] + 1
    elif mode != CLAMP and high + 1 + shift < 2 * period:
        _fold_pass(row, second, np.int32(shift), np.int32(period), np.int32(size), ints, n)
    else:
        for k in range(n):
            i = np.int64(ints[row + k])
            ints[row + k], ints[second + k] = texel(i, size, mode), texel(i + 1, size, mode)


@inlined
def locate(texcoords, maps, m, s, ints, n):
    """Where the four texels of map m lie for each of the n points in rows U and V: rows FX and FY, I0, I1, J0 and J1."""
    width, height, mode = np.int64(maps.size[m, 0]), np.int64(maps.size[m, 1]), maps.address[m]
    _locate_pass(
        _corners(texcoords, 0), _corners(texcoords, 1), np.float32(maps.size[m, 0]), np.float32(maps.size[m, 1]), s, ints, n
    )  # fmt: skip
    _address_pass(I0, I1, width, mode, ints, n)
    _address_pass(J0, J1, height, mode, ints, n)


@inlined
def _fetch_texels(texels, first, width, s, places, n):
    """Rows T00, T10, T01, T11: the texels of a map. No vectors here, so it is kept as short as can be."""
    for k in range(n):
        i0, i1 = np.uint64(places[I0 + k]), np.uint64(places[I1 + k])
        row0, row1 = first + width * np.uint64(places[J0 + k]), first + width * np.uint64(places[J1 + k])
        s[T00 + k] = texels[row0 + i0]
        s[T10 + k] = texels[row0 + i1]
        s[T01 + k] = texels[row1 + i0]
        s[T11 + k] = texels[row1 + i1]


@inlined
def filtered(k, s):
    """Bilinear value at point k before scale and bias, and its derivatives along the texels' columns and lines."""
    x1, y1 = s[FX + k], s[FY + k]
    x0, y0 = ONE - x1, ONE - y1
    t00, t10, t01, t11 = s[T00 + k], s[T10 + k], s[T01 + k], s[T11 + k]
    upper = x0 * t00 + x1 * t10
    lower = x0 * t01 + x1 * t11
    return y0 * upper + y1 * lower, y0 * (t10 - t00) + y1 * (t11 - t01), lower - upper


@inlined
def _filter_pass(a, b, width, height, scale, bias, value, s, n):
    """Row `value`: the displacement; GU, GV: its derivatives along u and v. a, b: both texture coordinates of the corners."""
    to_x, to_y = scale * width, scale * height
    for k in range(n):
        t, gx, gy = filtered(k, s)
        u1, v1 = s[U + k], s[V + k]
        u0, v0 = ONE - u1, ONE - v1
        s_u, t_u = v0 * (a[1] - a[0]) + v1 * (a[3] - a[2]), v0 * (b[1] - b[0]) + v1 * (b[3] - b[2])
        s_v, t_v = u0 * (a[2] - a[0]) + u1 * (a[3] - a[1]), u0 * (b[2] - b[0]) + u1 * (b[3] - b[1])
        s[value + k] = scale * t + bias
        s[GU + k] = to_x * (gx * s_u) + to_y * (gy * t_u)
        s[GV + k] = to_x * (gx * s_v) + to_y * (gy * t_v)


@inlined
def look_up(texcoords, maps, m, value, s, places, n):
    """Row `value`: the displacement by map m at the n points in rows U and V; rows GU and GV: its derivatives along u and v.

    The points are those that `locate` was called for, perhaps for another component of the same map of vectors.
    """
    _fetch_texels(maps.texels, np.uint64(maps.first[m]), np.uint64(maps.size[m, 0]), s, places, n)
    width, height = np.float32(maps.size[m, 0]), np.float32(maps.size[m, 1])
    a, b = _corners(texcoords, 0), _corners(texcoords, 1)
    _filter_pass(a, b, width, height, maps.scale[m], maps.bias[m], value, s, n)
