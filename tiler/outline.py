"""The outline of a bound on the screen: lines that all of it lies on one side of.

The outline is the hull of the bound's clip corners on the screen. Every straight line through two of the box's neighbouring
corners gives two directions n; all of the hull lies in n . p <= c, c the largest value over the corners. A rectangle wholly
beyond one of these lines has nothing of the bound. This is right for any n, so no hull need be built; the lines that belong
to edges of the hull make it exact. A corner counts as the rectangle of the window positions that its clip coordinates may be
off to (`slack`), widened by the rounding of the viewport transform and the snap (`pipeline.bounds.project`). A box that is
not surely in front of the eye, all of it, has no outline.
"""

import numpy as np

from pipeline.bounds.project import SNAP, U
from pipeline.jit import helper

NUM_LINES = 24  # 12 edges of a box, both sides


@helper
def _corner_ranges(corners, slack, viewport, box):
    """Window rectangle of each corner into box float64[8, 4] (x0, x1, y0, y1); False where one is not surely in front."""
    sx, sy, sz, sw = slack
    for k in range(8):
        x, y, z, w = corners[k]
        if not (z > 2.0 * sz and w > 2.0 * sw and abs(x) < np.inf and abs(y) < np.inf and w < np.inf):
            return False
        near, far = w - sw, w + sw
        lo_x, hi_x = min((x - sx) / near, (x - sx) / far), max((x + sx) / near, (x + sx) / far)
        lo_y, hi_y = min((-y - sy) / near, (-y - sy) / far), max((-y + sy) / near, (-y + sy) / far)
        box[k, 0], box[k, 1] = _widen(lo_x, hi_x, viewport.width, viewport.left)
        box[k, 2], box[k, 3] = _widen(lo_y, hi_y, viewport.height, viewport.top)
    return True


@helper
def _widen(lo, hi, size, offset):
    """Pixels of a range of normalized device coordinates, widened by rounding and snap as in `pipeline.bounds.project`."""
    a, b = (lo + 1.0) * 0.5 * size + offset, (hi + 1.0) * 0.5 * size + offset
    pad = 5.0 * U * (max(abs(a), abs(b)) + size + abs(offset)) + SNAP
    return a - pad, b + pad


@helper
def make_lines(corners, slack, viewport, box, lines):
    """Lines (n_x, n_y, c) about the projected hull into lines float64[24, 3]; False where there are none to trust."""
    if not _corner_ranges(corners, slack, viewport, box):
        return False
    n = 0
    for k in range(8):
        for bit in range(3):
            if k & (1 << bit):
                continue
            other = k | (1 << bit)
            dx = (box[other, 0] + box[other, 1]) - (box[k, 0] + box[k, 1])
            dy = (box[other, 2] + box[other, 3]) - (box[k, 2] + box[k, 3])
            for side in range(2):
                nx, ny = (dy, -dx) if side == 0 else (-dy, dx)
                c, size = -np.inf, 0.0
                for j in range(8):
                    x, y = box[j, 1] if nx > 0.0 else box[j, 0], box[j, 3] if ny > 0.0 else box[j, 2]
                    c = max(c, nx * x + ny * y)
                    size = max(size, abs(nx * x) + abs(ny * y))
                lines[n, 0], lines[n, 1], lines[n, 2] = nx, ny, c + 1e-12 * size
                n += 1
    return True


@helper
def reached(lines, x0, y0, x1, y1):
    """Whether pixels x0..x1, y0..y1 (inclusive) are beyond none of the lines."""
    left, top, right, bottom = np.float64(x0), np.float64(y0), np.float64(x1 + 1), np.float64(y1 + 1)
    for n in range(NUM_LINES):
        nx, ny = lines[n, 0], lines[n, 1]
        least = (nx * left if nx > 0.0 else nx * right) + (ny * top if ny > 0.0 else ny * bottom)
        if least - 1e-12 * (abs(nx) * right + abs(ny) * bottom) > lines[n, 2]:
            return False
    return True
