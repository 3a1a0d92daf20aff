"""Min-max pyramids of displacement maps: the range of every bilinear lookup over a part of a map.

Level k holds the least and the greatest texel of blocks of 2^k x 2^k texels; sizes are rounded up, so maps need be neither
square nor powers of two (Munkberg et al. 2010, section 3.2).

A query covers the filter footprint: a lookup at s reads texels floor(s N - 1/2) and the next one, and the shader rounds s N
in float32, so both ends are widened first. The address mode is applied before the pyramid: a wrapped range is up to two
pieces an axis, a mirrored one is folded, a clamped one has both ends clamped. Scale and bias come after; a negative scale
exchanges the ends.
"""

import numpy as np

from pipeline.displacement import map_ranges
from pipeline.jit import helper, inlined, kernel
from pipeline.types import F32, F64, Address, DisplacementMaps, Pyramids

U = 2.0**-24
WRAP, MIRROR = int(Address.WRAP), int(Address.MIRROR)
MAX_LEVELS = 32
FAR = 2.0**29  # texels; from twice as far on the shader reads texel (0, 0) whatever the address mode


def _halve(texels: F32, reduce: np.ufunc) -> F32:
    """Next level: `reduce` of blocks of 2 x 2, those at the right and bottom border of what there is."""
    by_rows = reduce.reduceat(texels, np.arange(0, texels.shape[0], 2), axis=0)
    return reduce.reduceat(by_rows, np.arange(0, texels.shape[1], 2), axis=1)


def build_pyramids(maps: DisplacementMaps) -> Pyramids:
    """Min-max pyramids of all maps. NaN texels give NaN, and a range that is NaN."""
    los: list[F32] = []
    his: list[F32] = []
    first = np.zeros((len(maps.size), MAX_LEVELS), np.int64)
    size = np.zeros((len(maps.size), MAX_LEVELS, 2), np.int64)
    total = 0
    for m, (width, height) in enumerate(maps.size):
        lo = hi = maps.texels[maps.first[m] : maps.first[m + 1]].reshape(height, width)
        for level in range(MAX_LEVELS):
            first[m, level], size[m, level] = total, lo.shape[::-1]
            total += lo.size
            los.append(lo.ravel())
            his.append(hi.ravel())
            if lo.size == 1:
                break
            lo, hi = _halve(lo, np.minimum), _halve(hi, np.maximum)
    empty = [np.zeros(0, np.float32)]
    return Pyramids(np.concatenate(empty + los), np.concatenate(empty + his), first, size, map_ranges(maps))


@inlined
def _footprint(a, b, n):
    """First and last texel number, before addressing, that lookups between texture coordinates a <= b may read.

    The shader's coordinate is bilinear in four products (6 roundings of at most the largest magnitude), times n, minus
    one half: 8 u (|s| n + 1) covers it.
    """
    pad = 8.0 * U * (max(abs(a), abs(b)) * n + 1.0)
    return np.floor(a * n - 0.5 - pad), np.floor(b * n - 0.5 + pad) + 1.0


@inlined
def pieces(first, last, n, mode):
    """Texels first .. last after addressing, on an axis of n: two ranges (lo, hi), the second empty where hi < lo."""
    i, j = np.int64(first), np.int64(last)
    if (mode == WRAP and j - i >= n - 1) or (mode == MIRROR and j - i >= 2 * n - 1):
        return 0, n - 1, 0, -1
    if mode == WRAP:
        i, j = _wrapped(i, n), _wrapped(j, n)
        if i <= j:
            return i, j, 0, -1
        return i, n - 1, 0, j
    if mode == MIRROR:
        i, j = i % (2 * n), i % (2 * n) + (j - i)
        # Unfolded, texel k of period 2n shows k, then 2n-1-k; the range may run over several folds.
        lo, hi = n, -1
        for start, backwards in ((0, False), (n, True), (2 * n, False), (3 * n, True)):
            a, b = max(i, start) - start, min(j, start + n - 1) - start
            if a <= b:
                lo, hi = (min(lo, n - 1 - b), max(hi, n - 1 - a)) if backwards else (min(lo, a), max(hi, b))
        return lo, hi, 0, -1
    return min(max(i, 0), n - 1), min(max(j, 0), n - 1), 0, -1


@helper
def _exact_range(pyramids, m, x0, x1, y0, y1):
    """Least and greatest texel of the rectangle: from all of level 0."""
    lo, hi = np.inf, -np.inf
    first, width = pyramids.first[m, 0], pyramids.size[m, 0, 0]
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            k = first + y * width + x
            lo, hi = min(lo, np.float64(pyramids.lo[k])), max(hi, np.float64(pyramids.hi[k]))
    return lo, hi


@inlined
def _level_range(pyramids, m, x0, x1, y0, y1):
    """From at most 2 x 2 texels of one level: always four reads, of the same texel where there are fewer."""
    level = 0
    while max((x1 >> level) - (x0 >> level), (y1 >> level) - (y0 >> level)) > 1:
        level += 1
    first, width = pyramids.first[m, level], pyramids.size[m, level, 0]
    upper, lower = first + (y0 >> level) * width, first + (y1 >> level) * width
    a, b = np.uint64(upper + (x0 >> level)), np.uint64(upper + (x1 >> level))
    c, d = np.uint64(lower + (x0 >> level)), np.uint64(lower + (x1 >> level))
    lo = min(min(pyramids.lo[a], pyramids.lo[b]), min(pyramids.lo[c], pyramids.lo[d]))
    hi = max(max(pyramids.hi[a], pyramids.hi[b]), max(pyramids.hi[c], pyramids.hi[d]))
    return np.float64(lo), np.float64(hi)


@inlined
def _piece_range(pyramids, m, x0, x1, y0, y1, exact):
    """Least and greatest texel of the rectangle."""
    return _exact_range(pyramids, m, x0, x1, y0, y1) if exact else _level_range(pyramids, m, x0, x1, y0, y1)


@inlined
def _wrapped(i, n):
    """i modulo n; a division only where it is needed."""
    return i if (i >= 0) & (i < n) else i % n


@helper
def _pieces_range(pyramids, m, xa0, xa1, xb0, xb1, ya0, ya1, yb0, yb1, exact):
    """The same of up to two pieces an axis, the second empty where its end is less than its begin."""
    lo, hi = np.inf, -np.inf
    for x0, x1 in ((xa0, xa1), (xb0, xb1)):
        for y0, y1 in ((ya0, ya1), (yb0, yb1)):
            if x0 <= x1 and y0 <= y1:
                a, b = _piece_range(pyramids, m, x0, x1, y0, y1, exact)
                lo, hi = min(lo, a), max(hi, b)
    return lo, hi


@inlined
def texel_range(maps, pyramids, m, s0, s1, t0, t1, exact):
    """Least and greatest texel that lookups of map m with s0 <= s <= s1, t0 <= t <= t1 may blend."""
    width, height = pyramids.size[m, 0, 0], pyramids.size[m, 0, 1]
    mode = maps.address[m]
    i0, i1 = _footprint(s0, s1, np.float64(width))
    j0, j1 = _footprint(t0, t1, np.float64(height))
    if not (max(abs(i0), abs(i1)) < FAR and max(abs(j0), abs(j1)) < FAR):
        return _piece_range(pyramids, m, 0, width - 1, 0, height - 1, exact)
    xa0, xa1, xb0, xb1 = pieces(i0, i1, width, mode)
    ya0, ya1, yb0, yb1 = pieces(j0, j1, height, mode)
    if xb0 > xb1 and yb0 > yb1:
        return _piece_range(pyramids, m, xa0, xa1, ya0, ya1, exact)
    return _pieces_range(pyramids, m, xa0, xa1, xb0, xb1, ya0, ya1, yb0, yb1, exact)


@inlined
def displacement_range(maps, pyramids, m, s0, s1, t0, t1, exact):
    """Range of the displacement, world units, of lookups in that rectangle of texture coordinates.

    Widened by the roundings of the fetch, scale and bias, as `displacement.map_ranges` derives them.
    """
    lo, hi = texel_range(maps, pyramids, m, s0, s1, t0, t1, exact)
    scale, bias = np.float64(maps.scale[m]), np.float64(maps.bias[m])
    a, b = scale * lo + bias, scale * hi + bias
    pad = U * (10.0 * abs(scale) * max(abs(lo), abs(hi)) + 2.0 * abs(bias)) + 2.0**-140 * (1.0 + abs(scale))
    return min(a, b) - pad, max(a, b) + pad


@kernel
def _query(maps, pyramids, map_id, rects, exact, out):
    for k in range(len(map_id)):
        lo, hi = displacement_range(
            maps, pyramids, map_id[k], rects[k, 0], rects[k, 1], rects[k, 2], rects[k, 3], exact
        )
        out[k, 0], out[k, 1] = lo, hi


def query_ranges(
    maps: DisplacementMaps, pyramids: Pyramids, map_id: np.ndarray, rects: F64, *, exact: bool = False
) -> F64:
    """Displacement ranges float64[n, 2] over rectangles float64[n, 4] (s0, s1, t0, t1) of maps int32[n].

    exact : look at every texel of the footprint instead of at most four of a pyramid's level for each piece.
    """
    out = np.empty((len(map_id), 2))
    _query(maps, pyramids, np.asarray(map_id, np.int32), np.ascontiguousarray(rects, np.float64), exact, out)
    return out
