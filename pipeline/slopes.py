"""Slopes of displacement maps: the range of the derivative of every bilinear lookup over a part of a map.

Between texel centres a bilinear lookup is a blend of two differences of neighbouring texels along each axis; across a
texel border its derivative jumps, so a chord has a slope between the least and the greatest difference that the lookups
along it use. The differences of a map make a map of the same size, hence a min-max pyramid (`minmax`) for each axis:
texel i of the first holds T[i+1] - T[i] along s, after addressing. A query covers the same filter footprint; it takes one
difference more than the lookups use, which is safe.

- wrap: the last difference is T[0] - T[N-1];
- clamp: beyond the ends the slope is 0, which a query that leaves the map adds;
- mirror: a folded part has differences of the other sign, so a query takes both signs.
"""

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.minmax import build_pyramids, texel_range
from pipeline.types import F32, F64, Address, DisplacementMaps, Slopes

WRAP, MIRROR, CLAMP = int(Address.WRAP), int(Address.MIRROR), int(Address.CLAMP)
ROUNDING = 1.0 + 2.0**-22  # of a difference in float32
DENORMAL = 2.0**-148


def _differences(texels: F32, axis: int, address: int) -> F32:
    """Next texel less this one along an axis; the last one's neighbour is what the address mode reads there."""
    with np.errstate(all="ignore"):
        steps = np.roll(texels, -1, axis).astype(np.float64) - texels
        if address != Address.WRAP:
            np.moveaxis(steps, axis, 0)[-1] *= 0.0  # and NaN stays
        return steps.astype(np.float32)


def build_slopes(maps: DisplacementMaps) -> Slopes:
    """Slope pyramids of all maps. Of a map with a NaN or infinity they mean nothing; its range (`Pyramids.whole`) tells."""
    pyramids = []
    for axis in (1, 0):
        texels = np.empty_like(maps.texels)
        for m, (width, height) in enumerate(maps.size):
            part = slice(maps.first[m], maps.first[m + 1])
            texels[part] = _differences(maps.texels[part].reshape(height, width), axis, maps.address[m]).ravel()
        with np.errstate(all="ignore"):
            pyramids.append(build_pyramids(maps._replace(texels=texels)))
    return Slopes(*pyramids)


@helper
def slope_range(maps, pyramids, m, axis, s0, s1, t0, t1):
    """Range of the derivative along an axis (0: s, 1: t), per texel and before scale, of lookups in that rectangle.

    pyramids : of that axis. maps : as for `minmax.texel_range`.
    """
    lo, hi = texel_range(maps, pyramids, m, s0, s1, t0, t1, False)
    n = np.float64(pyramids.size[m, 0, axis])
    a, b = (s0, s1) if axis == 0 else (t0, t1)
    mode = maps.address[m]
    if mode == MIRROR:
        hi = max(hi, -lo)
        lo = -hi
    elif mode == CLAMP and not (a * n >= 1.0 and b * n <= n - 1.0):  # half a texel off the ends, and room for rounding
        lo, hi = min(lo, 0.0), max(hi, 0.0)
    lo, hi = min(lo / ROUNDING, lo * ROUNDING) - DENORMAL, max(hi / ROUNDING, hi * ROUNDING) + DENORMAL
    return lo, hi


@kernel
def _query(maps, pyramids, map_id, axis, rects, out):
    for k in range(len(map_id)):
        r = rects[k]
        out[k, 0], out[k, 1] = slope_range(maps, pyramids, map_id[k], axis, r[0], r[1], r[2], r[3])


def query_slopes(maps: DisplacementMaps, slopes: Slopes, map_id: np.ndarray, rects: F64) -> F64:
    """Slopes float64[n, 2, 2], [k, axis] = (least, greatest), over rectangles float64[n, 4] (s0, s1, t0, t1) of maps.

    map_id : int32[n]. Per texel and before scale; axis 0 is along s.
    """
    out = np.empty((2, len(map_id), 2))
    rects, numbers = np.ascontiguousarray(rects, np.float64), np.asarray(map_id, np.int32)
    for axis in range(2):
        _query(maps, slopes[axis], numbers, axis, rects, out[axis])
    return np.ascontiguousarray(out.transpose(1, 0, 2))
