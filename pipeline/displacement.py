"""Displacement maps: bilinear lookups as the domain shader makes them, and the range that a map can return.

A map gives a number, by which a point moves along its normal, or a vector, by which it moves as it is.

Texture space: texel (i, j) of a w x h map has its centre at s = (i + 0.5) / w, t = (j + 0.5) / h; row 0 is at t = 0.
The address mode is applied to each texel number by itself (D3D11.3 functional specification, 7.18).
"""

from collections.abc import Sequence

import numpy as np

from pipeline.jit import helper, inlined, kernel
from pipeline.types import F32, F64, Address, DisplacementMaps

ONE = np.float32(1.0)
HALF = np.float32(0.5)
FAR_TEXEL = np.float32(2.0**30)  # beyond it a texel number is no longer meaningful: texel 0 then
WRAP, MIRROR, CLAMP = int(Address.WRAP), int(Address.MIRROR), int(Address.CLAMP)


def pack_maps(maps: Sequence[tuple[F32, Address, float, float]]) -> DisplacementMaps:
    """Pack maps, each (texels float32[h, w], or [h, w, 3] for vectors; address, scale, bias), into what kernels read.

    The axes of vectors are the world's; `turn` may be replaced.
    """
    rows: list[tuple[F32, Address, float, float]] = []
    components: list[tuple[F32, Address, float, float]] = []
    planes: list[tuple[int, int, int]] = []
    for texels, address, scale, bias in maps:
        if texels.ndim == 2:
            rows.append((texels, address, scale, bias))
            planes.append((-1, -1, -1))
        else:
            first = len(maps) + len(components)
            rows.append((np.zeros((1, 1), np.float32), address, 0.0, 0.0))
            planes.append((first, first + 1, first + 2))
            components += [(texels[..., c], address, scale, bias) for c in range(3)]
    rows += components
    planes += [(-1, -1, -1)] * len(components)
    sizes = [texels.shape[::-1] for texels, _, _, _ in rows]
    return DisplacementMaps(
        texels=np.concatenate(
            [np.zeros(0, np.float32)] + [texels.astype(np.float32).ravel() for texels, _, _, _ in rows]
        ),
        first=np.cumsum([0] + [w * h for w, h in sizes], dtype=np.int64),
        size=np.array(sizes, np.int32).reshape(-1, 2),
        address=np.array([address for _, address, _, _ in rows], np.int32),
        scale=np.array([scale for _, _, scale, _ in rows], np.float32),
        bias=np.array([bias for _, _, _, bias in rows], np.float32),
        planes=np.array(planes, np.int32).reshape(-1, 3),
        turn=np.tile(np.eye(3, dtype=np.float32), (len(rows), 1, 1)),
    )


def map_ranges(maps: DisplacementMaps) -> F64:
    """Smallest and largest displacement that any lookup in each map can return, world units: float64[L, 2].

    A bilinear value is a convex combination of texels, so the texels' range holds it up to rounding: the fetch rounds
    three times an axis, scale and bias once each, every time by at most 2^-24 of a magnitude that the range bounds.
    NaN where the map holds a NaN. Of a map of vectors: minus and plus the greatest length (`vector_lengths`).
    """
    ranges = np.zeros((len(maps.size), 2))
    for m in range(len(ranges)):
        texels = maps.texels[maps.first[m] : maps.first[m + 1]]
        lo, hi = float(texels.min()), float(texels.max())
        scale, bias = float(maps.scale[m]), float(maps.bias[m])
        ends = (scale * lo + bias, scale * hi + bias)
        pad = 2.0**-24 * (10.0 * abs(scale) * max(abs(lo), abs(hi)) + 2.0 * abs(bias)) + 2.0**-140 * (1.0 + abs(scale))
        ranges[m] = min(ends) - pad, max(ends) + pad
        if not np.isfinite(lo + hi):
            ranges[m] = np.nan
    return vector_lengths(maps, ranges)


def vector_lengths(maps: DisplacementMaps, ranges: F64) -> F64:
    """`ranges` of all rows, with those of maps of vectors made of their components': for a `turn` that has changed."""
    if (maps.planes[:, 0] < 0).all():
        return ranges
    ranges = ranges.copy()
    _vector_lengths(maps, ranges)
    return ranges


@helper
def turned_sums(turn, box):
    """Largest sum of the magnitudes of the products in one row of turn @ d, for d in box ((lo, hi) of each component)."""
    most = 0.0
    for r in range(3):
        total = 0.0
        for c in range(3):
            total += abs(np.float64(turn[r, c])) * max(abs(box[c][0]), abs(box[c][1]))
        most = max(most, total)
    return most


@helper
def greatest_length(turn, box):
    """Greatest length of the shader's turn @ d for d in box ((lo, hi) of each component); NaN if something is not finite.

    The length is convex, so it is greatest at a corner of the box. Each row rounds five times, by at most 3 u (2^-24) of
    the sum of its products' magnitudes: 12 u of the largest such sum covers the three rows.
    """
    most = 0.0
    for corner in range(8):
        square = 0.0
        for r in range(3):
            x = 0.0
            for c in range(3):
                x += np.float64(turn[r, c]) * box[c][corner >> c & 1]
            square += x * x
        most = max(most, np.sqrt(square))
    sums = turned_sums(turn, box)
    poison = 0.0
    for c in range(3):
        poison += (box[c][0] - box[c][0]) + (box[c][1] - box[c][1])
        for r in range(3):
            poison += np.float64(turn[r, c]) * 0.0
    return most + 12.0 * 2.0**-24 * sums + 2.0**-140 + poison


@kernel
def _vector_lengths(maps, ranges):
    for m in range(len(maps.planes)):
        x, y, z = maps.planes[m]
        if x >= 0:
            box = ((ranges[x, 0], ranges[x, 1]), (ranges[y, 0], ranges[y, 1]), (ranges[z, 0], ranges[z, 1]))
            most = greatest_length(maps.turn[m], box)
            ranges[m, 0], ranges[m, 1] = -most, most


@helper
def texel(i, n, mode):
    """Texel number that address `mode` reads for i on an axis of n texels."""
    if mode == WRAP:
        return i % n
    if mode == MIRROR:
        i = i % (2 * n)
        return i if i < n else 2 * n - 1 - i
    return min(max(i, 0), n - 1)


@inlined
def fetch(maps, m, x, y):
    """Bilinear value of map m at texel coordinates (x, y), before scale and bias, and its derivatives along x and y.

    Of one point; `domain_lookup` does the same for a block of them.
    """
    if not (abs(x) < FAR_TEXEL and abs(y) < FAR_TEXEL):  # also where a coordinate is NaN
        x, y = np.float32(0.0), np.float32(0.0)
    fx, fy = np.floor(x), np.floor(y)
    i0, j0 = np.int64(fx), np.int64(fy)
    i1, j1 = i0 + 1, j0 + 1
    x1, y1 = x - fx, y - fy
    x0, y0 = ONE - x1, ONE - y1
    width, height = np.int64(maps.size[m, 0]), np.int64(maps.size[m, 1])
    if i0 < 0 or i1 >= width or j0 < 0 or j1 >= height:
        mode = maps.address[m]
        i0, i1 = texel(i0, width, mode), texel(i1, width, mode)
        j0, j1 = texel(j0, height, mode), texel(j1, height, mode)
    row0 = maps.first[m] + j0 * width
    row1 = maps.first[m] + j1 * width
    t00, t10 = maps.texels[row0 + i0], maps.texels[row0 + i1]
    t01, t11 = maps.texels[row1 + i0], maps.texels[row1 + i1]
    upper = x0 * t00 + x1 * t10
    lower = x0 * t01 + x1 * t11
    return y0 * upper + y1 * lower, y0 * (t10 - t00) + y1 * (t11 - t01), lower - upper
