"""Slow twin of `tiler/near_planes.py`: the faces of one bound's box as planes in window space, corner by corner."""

import math
from fractions import Fraction

import numpy as np

from pipeline.types import PatchBounds, Viewport

U = 2.0**-24


def naive_nearest(bound: PatchBounds, viewport: Viewport, box: tuple[int, int, int, int]) -> np.float32:
    """Least depth of a bound of one row in pixels x0 y0 x1 y1, inclusive: its own, or that of a face turned to the viewer."""
    corners, (sx, sy, sz, sw) = bound.corners[0], bound.slack[0]
    z_min = bound.z_min[0]
    if not all(2 * sw < w < math.inf for w in corners[:, 3]):
        return z_min
    ranges = []
    for x, y, z, w in corners:
        lows, highs = [], []
        for value, spread, size, offset in (
            (x, sx, viewport.width, viewport.left), (-y, sy, viewport.height, viewport.top), (z, sz, 0, 0),
        ):  # fmt: skip
            ends = [a / b for a in (value - spread, value + spread) for b in (w - sw, w + sw)]
            lo, hi = min(ends), max(ends)
            if size:
                lo, hi = (lo + 1.0) * 0.5 * size + offset, (hi + 1.0) * 0.5 * size + offset
                pad = 5.0 * U * (max(abs(lo), abs(hi)) + size + abs(offset)) + 1.0 / 512.0
                lo, hi = lo - pad, hi + pad
            else:
                lo -= 8.0 * U * (1.0 + abs(lo))
            lows.append(lo)
            highs.append(hi)
        ranges.append((np.array(lows), np.array(highs)))
    middle = [lo + hi for lo, hi in ranges]
    nearest = float(z_min)
    for axis in range(3):
        for side in (0, 1):
            first = side << axis
            across = [1 << ((axis + k) % 3) for k in (1, 2)]
            normal = np.cross(middle[first ^ across[0]] - middle[first], middle[first ^ across[1]] - middle[first])
            depth = np.dot(normal, middle[first ^ (1 << axis)] - middle[first])
            if not depth * normal[2] > 0.0:
                continue
            a, b = -normal[0] / normal[2], -normal[1] / normal[2]
            under = min(
                Fraction(lo[2]) - max(Fraction(a) * Fraction(x) for x in (lo[0], hi[0]))
                - max(Fraction(b) * Fraction(y) for y in (lo[1], hi[1]))
                for lo, hi in ranges
            )  # fmt: skip
            at = [Fraction(a) * x + Fraction(b) * y for x in (box[0], box[2] + 1) for y in (box[1], box[3] + 1)]
            nearest = max(nearest, float(under + min(at)))
    return z_min if nearest <= z_min else np.float32(min(nearest, 1.0) * (1.0 - 4.0 * U))
