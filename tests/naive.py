"""Slow twins of the fast paths: plain Python and NumPy, no Numba, no cleverness."""

import numpy as np

# Offsets of the samples from the pixel's centre in 1/16 pixel, x right and y down [Direct3D 11.3 spec, 19.2.4].
SAMPLE_OFFSETS = {1: ((0, 0),), 4: ((-2, -6), (6, -2), (-6, 2), (2, 6))}


def naive_snap(position: float) -> int:
    """A window coordinate in pixels as 16.8 fixed point: round to nearest even, saturate."""
    return int(np.clip(np.rint(position * 256), -32768 * 256, 32767 * 256 + 255))


def naive_coverage(x: np.ndarray, y: np.ndarray, width: int, height: int, samples: int) -> np.ndarray:
    """Samples covered by one triangle, either winding: bool[height, width, samples].

    x, y : float64[3], window positions in pixels, y down, before snapping.
    """
    covered = np.zeros((height, width, samples), dtype=bool)
    corners = [(naive_snap(x[i]), naive_snap(y[i])) for i in range(3)]
    (x0, y0), (x1, y1), (x2, y2) = corners
    if (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0) < 0:  # counterclockwise: turn it round
        corners = [corners[0], corners[2], corners[1]]

    # A sample lies in its pixel, so pixels outside of the vertices' box need no look.
    left, right = max(min(x0, x1, x2) >> 8, 0), min((max(x0, x1, x2) >> 8) + 1, width)
    top, bottom = max(min(y0, y1, y2) >> 8, 0), min((max(y0, y1, y2) >> 8) + 1, height)
    if left >= right or top >= bottom:
        return covered
    columns = 256 * np.arange(left, right, dtype=np.int64)[None, :] + 128
    rows = 256 * np.arange(top, bottom, dtype=np.int64)[:, None] + 128

    for s, (offset_x, offset_y) in enumerate(SAMPLE_OFFSETS[samples]):
        sample_x, sample_y = columns + 16 * offset_x, rows + 16 * offset_y
        inside = np.ones((bottom - top, right - left), dtype=bool)
        for i in range(3):
            (ax, ay), (bx, by) = corners[i], corners[(i + 1) % 3]
            dx, dy = bx - ax, by - ay
            edge = dx * (sample_y - ay) - dy * (sample_x - ax)
            is_top_or_left = dy < 0 or (dy == 0 and dx > 0)
            inside &= edge >= 0 if is_top_or_left else edge > 0
        covered[top:bottom, left:right, s] = inside
    return covered
