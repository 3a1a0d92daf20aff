"""Slow twin of `tiler/outline.py`: the lines about one bound's box on the screen, exactly."""

import math
from fractions import Fraction
from itertools import product

from pipeline.types import PatchBounds, Viewport

U = 2.0**-24


def corner_rectangles(bound: PatchBounds, viewport: Viewport) -> list | None:
    """Window rectangle (x0, x1), (y0, y1) of each corner of a bound of one row; None if it is not surely in front."""
    sx, sy, sz, sw = bound.slack[0]
    found = []
    for x, y, z, w in bound.corners[0]:
        if not (z > 2 * sz and w > 2 * sw and all(map(math.isfinite, (x, y, w)))):
            return None
        ranges = []
        for value, spread, size, offset in (
            (x, sx, viewport.width, viewport.left), (-y, sy, viewport.height, viewport.top),
        ):  # fmt: skip
            ends = [a / b for a in (value - spread, value + spread) for b in (w - sw, w + sw)]
            lo, hi = ((end + 1.0) * 0.5 * size + offset for end in (min(ends), max(ends)))
            pad = 5.0 * U * (max(abs(lo), abs(hi)) + size + abs(offset)) + 1.0 / 512.0
            ranges.append((Fraction(lo - pad), Fraction(hi + pad)))
        found.append(ranges)
    return found


def naive_lines(bound: PatchBounds, viewport: Viewport) -> list | None:
    """Normals n and the largest n . p over the bound, a line on either side of each of its 12 edges; None if it has none."""
    rectangles = corner_rectangles(bound, viewport)
    if rectangles is None:
        return None
    lines = []
    for k, bit in product(range(8), (1, 2, 4)):
        if k & bit:
            continue
        (ax, ay), (bx, by) = rectangles[k], rectangles[k | bit]
        dx, dy = sum(bx) - sum(ax), sum(by) - sum(ay)
        for nx, ny in ((dy, -dx), (-dy, dx)):
            lines.append((nx, ny, max(nx * x + ny * y for xs, ys in rectangles for x in xs for y in ys)))
    return lines


def naive_reached(lines: list, box: tuple[int, int, int, int]) -> bool:
    """Whether pixels x0 y0 x1 y1, inclusive, are beyond none of the lines."""
    x0, y0, x1, y1 = box
    return all(min(nx * x + ny * y for x in (x0, x1 + 1) for y in (y0, y1 + 1)) <= c for nx, ny, c in lines)
