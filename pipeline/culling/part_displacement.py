"""The displacement of parts of patches and its slopes along u and v, a block of lanes at a time.

Texture coordinates (s, t) are bilinear in (u, v), so by the chain rule d_u = d_s s_u + d_t t_u, products of intervals; those
of d are `minmax`'s, of d_s and d_t `slopes`'. All three pyramids of a map have the same levels, so a footprint is cut into
pieces once, and each piece read from all three. That is what is done lane by lane; it sees arrays alone, as every tuple of
arrays that Numba hands on is counted, array by array, and that took longer than all the rest.
"""

import numpy as np

from pipeline.culling.intervals import add, mul, scale
from pipeline.jit import helper, inlined
from pipeline.minmax import pieces
from pipeline.slopes import DENORMAL, ROUNDING
from pipeline.types import Address
from pipeline.wide import LANES, choose, floor, greater, lesser, load, store

U = 2.0**-24
MOST_TEXEL = 2.0**20  # texels from the map's origin; the shader's coordinates get coarse beyond
MIRROR, CLAMP = float(Address.MIRROR), float(Address.CLAMP)

# Rows of the scratch.
PLACE = 0  # u0, u1, v0, v1 of the part
MAP, MODE, MAP_SCALE, MAP_BIAS = 4, 5, 6, 7  # number of the map, -1 for none; its address mode, scale and bias
TEXELS = 8  # of the map along s, along t
COORDS = 10  # s, t at (u, v) = (0,0) (1,0) (0,1) (1,1)
FOOTPRINT = 18  # first and last texel along s, along t, before addressing; infinite where nothing is to be read
RANGES = 22  # least and greatest texel, difference along s, difference along t
DISPLACEMENT = 28  # least and greatest t, t_u, t_v over the part, and what the shader's t may be off by
ROWS = 35


@helper
def place_map(m, texcoords, address, factors, biases, whole, size, lane, s):
    """Rows MAP .. COORDS of a lane: map m, -1 for none, of a patch's texcoords float32[4, 2].

    address, factors, biases : of `DisplacementMaps`; whole, size : of `Pyramids`.
    """
    s[MAP, lane] = m
    s[MODE, lane] = s[MAP_SCALE, lane] = s[MAP_BIAS, lane] = 0.0
    s[TEXELS, lane] = s[TEXELS + 1, lane] = 1.0
    if m >= 0:
        s[MODE, lane], s[MAP_SCALE, lane], s[MAP_BIAS, lane] = address[m], factors[m], biases[m]
        if not (whole[m, 0] > -np.inf and whole[m, 1] < np.inf):
            s[MAP_SCALE, lane] = np.nan  # a broken map
        s[TEXELS, lane], s[TEXELS + 1, lane] = size[m, 0, 0], size[m, 0, 1]
    for k in range(4):
        s[COORDS + 2 * k, lane], s[COORDS + 2 * k + 1, lane] = texcoords[k, 0], texcoords[k, 1]


@inlined
def _mix(p, q, t):
    return (1.0 - t) * p + t * q


@inlined
def _corners(s, axis):
    return load(s, COORDS + axis), load(s, COORDS + 2 + axis), load(s, COORDS + 4 + axis), load(s, COORDS + 6 + axis)


@inlined
def _place(s):
    return load(s, PLACE), load(s, PLACE + 1), load(s, PLACE + 2), load(s, PLACE + 3)


@inlined
def _coordinate_range(corners, place):
    """Least and greatest texture coordinate over the part, and the largest magnitude at a corner of the patch.

    As `restrict.texcoord_rect`, with what float32 may be off by.
    """
    (c00, c10, c01, c11), (u0, u1, v0, v1) = corners, place
    corner = greater(greater(abs(c00), abs(c10)), greater(abs(c01), abs(c11)))
    whole = (u0 <= 0.0) & (u1 >= 1.0) & (v0 <= 0.0) & (v1 >= 1.0)
    pad = choose(whole, 0.0, 8.0 * U * corner)
    low_u, high_u = _mix(c00, c10, u0), _mix(c00, c10, u1)
    low_v, high_v = _mix(c01, c11, u0), _mix(c01, c11, u1)
    a, b = _mix(low_u, low_v, v0), _mix(high_u, high_v, v0)
    c, d = _mix(low_u, low_v, v1), _mix(high_u, high_v, v1)
    least, most = lesser(lesser(a, b), lesser(c, d)), greater(greater(a, b), greater(c, d))
    return least - pad, most + pad, corner


@inlined
def _find_footprint(s, axis):
    """Two rows of FOOTPRINT, as `minmax._footprint`; returns the largest coordinate, of the part or a corner, in texels."""
    n = load(s, TEXELS + axis)
    least, most, corner = _coordinate_range(_corners(s, axis), _place(s))
    far = greater(abs(least), abs(most)) * n
    pad = 8.0 * U * (far + 1.0)
    store(s, FOOTPRINT + 2 * axis, floor(least * n - 0.5 - pad))
    store(s, FOOTPRINT + 2 * axis + 1, floor(most * n - 0.5 + pad) + 1.0)
    return greater(far, corner * n)


@inlined
def _reads(s):
    """Mask of the lanes that have a map that can be read there, and of those that have none."""
    far = greater(_find_footprint(s, 0), _find_footprint(s, 1))
    given = load(s, MAP) >= 0.0
    return given & (far < MOST_TEXEL) & (abs(load(s, MAP_SCALE)) < np.inf)


@helper
def find_footprints(s):
    """Rows FOOTPRINT of all lanes. Infinite in the first place where nothing is to be read."""
    reads = _reads(s)
    store(s, FOOTPRINT, choose(reads, load(s, FOOTPRINT), np.inf))


@inlined
def _read(lo, hi, upper, lower, x0, x1):
    """Least and greatest of four texels of a level."""
    a, b, c, d = np.uint64(upper + x0), np.uint64(upper + x1), np.uint64(lower + x0), np.uint64(lower + x1)
    return min(min(lo[a], lo[b]), min(lo[c], lo[d])), max(max(hi[a], hi[b]), max(hi[c], hi[d]))


@helper
def read_footprints(s, busy, first, size, address, t_lo, t_hi, s_lo, s_hi, r_lo, r_hi):
    """Rows RANGES of the lanes that are `busy` >= 0.

    first, size : of the pyramids. t, s, r : texels, their differences along s and along t.
    """
    for lane in range(LANES):
        if busy[lane] < 0 or s[FOOTPRINT, lane] == np.inf:
            continue
        m = np.int64(s[MAP, lane])
        mode = address[m]
        xa0, xa1, xb0, xb1 = pieces(s[FOOTPRINT, lane], s[FOOTPRINT + 1, lane], size[m, 0, 0], mode)
        ya0, ya1, yb0, yb1 = pieces(s[FOOTPRINT + 2, lane], s[FOOTPRINT + 3, lane], size[m, 0, 1], mode)
        t0 = s0 = r0 = np.float32(np.inf)
        t1 = s1 = r1 = np.float32(-np.inf)
        for i in range(2):
            x0, x1 = (xa0, xa1) if i == 0 else (xb0, xb1)
            for j in range(2):
                y0, y1 = (ya0, ya1) if j == 0 else (yb0, yb1)
                if x0 <= x1 and y0 <= y1:
                    level = 0
                    while max((x1 >> level) - (x0 >> level), (y1 >> level) - (y0 >> level)) > 1:
                        level += 1
                    begin, width = first[m, level], size[m, level, 0]
                    upper, lower = begin + (y0 >> level) * width, begin + (y1 >> level) * width
                    a, b = x0 >> level, x1 >> level
                    lo, hi = _read(t_lo, t_hi, upper, lower, a, b)
                    t0, t1 = min(t0, lo), max(t1, hi)
                    lo, hi = _read(s_lo, s_hi, upper, lower, a, b)
                    s0, s1 = min(s0, lo), max(s1, hi)
                    lo, hi = _read(r_lo, r_hi, upper, lower, a, b)
                    r0, r1 = min(r0, lo), max(r1, hi)
        s[RANGES, lane], s[RANGES + 1, lane] = t0, t1
        s[RANGES + 2, lane], s[RANGES + 3, lane] = s0, s1
        s[RANGES + 4, lane], s[RANGES + 5, lane] = r0, r1


@inlined
def _slopes(s, axis):
    """Interval of the derivative along s or t, per texel, of lookups in the footprint: as `slopes.slope_range`, scaled."""
    lo, hi = load(s, RANGES + 2 + 2 * axis), load(s, RANGES + 3 + 2 * axis)
    n, mode = load(s, TEXELS + axis), load(s, MODE)
    most = greater(abs(lo), abs(hi))
    mirrored = (mode >= MIRROR) & (mode <= MIRROR)
    least_s, most_s, _ = _coordinate_range(_corners(s, axis), _place(s))
    inside = (least_s * n >= 1.0) & (most_s * n <= n - 1.0)  # half a texel off the ends, and room for rounding
    leaves = (mode >= CLAMP) & (mode <= CLAMP) & ~inside
    lo, hi = choose(mirrored, -most, lo), choose(mirrored, most, hi)
    lo, hi = choose(leaves, lesser(lo, 0.0), lo), choose(leaves, greater(hi, 0.0), hi)
    lo, hi = lesser(lo / ROUNDING, lo * ROUNDING) - DENORMAL, greater(hi / ROUNDING, hi * ROUNDING) + DENORMAL
    return scale(load(s, MAP_SCALE), (lo, hi))


@inlined
def _ends(p, q, low, high, step):
    """Range of (1 - t) p + t q, t in low .. high, times step."""
    a, b = _mix(p, q, low), _mix(p, q, high)
    return lesser(a, b) * step, greater(a, b) * step


@inlined
def _bilinear_steps(s, axis):
    """Ranges of the derivatives along u and v of a texture coordinate, in texels, for u, v running from 0 to 1."""
    (c00, c10, c01, c11), (u0, u1, v0, v1) = _corners(s, axis), _place(s)
    n = load(s, TEXELS + axis)
    along_u = _ends(c10 - c00, c11 - c01, v0, v1, u1 - u0)
    return scale(n, along_u), scale(n, _ends(c01 - c00, c11 - c10, u0, u1, v1 - v0))


@inlined
def _most(a):
    return greater(abs(a[0]), abs(a[1]))


@inlined
def _store_interval(s, row, a, given, relative):
    pad = relative * _most(a)
    store(s, row, choose(given, a[0] - pad, 0.0))
    store(s, row + 1, choose(given, a[1] + pad, 0.0))


@helper
def find_displacement(s):
    """Rows DISPLACEMENT: t as `minmax.displacement_range`, t_u, t_v for u, v running from 0 to 1, and the shader's error.

    The shader's texture coordinates are off by up to 8 u (|s| N + 1) texels (`minmax`), so t by that times the slope. The
    error is NaN where texture coordinates are so large that the shader's are coarse, and where the map is broken.
    """
    given, reads = load(s, MAP) >= 0.0, load(s, FOOTPRINT) < np.inf
    factor, bias = load(s, MAP_SCALE), load(s, MAP_BIAS)
    lo, hi = load(s, RANGES), load(s, RANGES + 1)
    a, b = factor * lo + bias, factor * hi + bias
    pad = U * (10.0 * abs(factor) * _most((lo, hi)) + 2.0 * abs(bias)) + 2.0**-140 * (1.0 + abs(factor))
    _store_interval(s, DISPLACEMENT, (lesser(a, b) - pad, greater(a, b) + pad), given, 0.0)
    gx, gy = _slopes(s, 0), _slopes(s, 1)
    (s_u, s_v), (t_u, t_v) = _bilinear_steps(s, 0), _bilinear_steps(s, 1)
    _store_interval(s, DISPLACEMENT + 2, add(mul(gx, s_u), mul(gy, t_u)), given, 1e-12)
    _store_interval(s, DISPLACEMENT + 4, add(mul(gx, s_v), mul(gy, t_v)), given, 1e-12)
    _, _, far_s = _coordinate_range(_corners(s, 0), _place(s))
    _, _, far_t = _coordinate_range(_corners(s, 1), _place(s))
    corner = greater(far_s * load(s, TEXELS), far_t * load(s, TEXELS + 1))
    off = 8.0 * U * (corner + 1.0) * (_most(gx) + _most(gy))
    store(s, DISPLACEMENT + 6, choose(given, choose(reads, off, np.nan), 0.0))
