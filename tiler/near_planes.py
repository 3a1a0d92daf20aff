"""How near a bound can be at each pixel: planes under its box, where the box's one nearest depth says too little.

A box that is seen at a slant has its nearest corner in one tile and reaches over others, where it is farther. Its faces are
planes in window space (x, y in pixels, z the depth), since a projective map keeps planes; the box lies behind each of its
faces that are turned to the viewer: z >= a x + b y + c. The nearest depth in a rectangle is then at least the least value of
each plane there, at one of the rectangle's corners.

Right for what the float32 pipeline makes of the box: a vertex is a mean of the corners, shifted by what its clip position
may be off (`PatchBounds.slack`), which shifts all corners alike; so a plane that lies under the window range of every shifted
corner lies under the vertex, snapped to 1/256 pixel and rounded (`pipeline.bounds.project`: SNAP and 5 u). c is chosen so,
whatever a and b are: they need no room for rounding. The depth at a sample is a mean of its triangle's depths in these window
positions, rounded (DEPTH). A box that is not surely in front of the eye, all of it, has no planes.
"""

import numpy as np

from pipeline.bounds.project import SNAP, U
from pipeline.jit import helper, kernel
from pipeline.types import F64, I32, PatchBounds, Viewport

MOST = 3  # faces of a box that can be seen at a time
DEPTH = 8.0 * U  # above the rounding of depths, which lie in 0..1


@helper
def _window_ranges(corners, slack, viewport, low, high):
    """Window ranges of the box's eight corners, slack, rounding and snap included: float64[8, 3] each; False where w <= 0."""
    sx, sy, sz, sw = slack
    for k in range(8):
        x, y, z, w = corners[k]
        near, far = w - sw, w + sw
        if not (w > 2.0 * sw and far < np.inf):
            return False
        for axis in range(3):
            value, spread = (x, sx) if axis == 0 else ((-y, sy) if axis == 1 else (z, sz))
            lo, hi = value - spread, value + spread
            lo, hi = min(lo / near, lo / far), max(hi / near, hi / far)
            if axis == 2:
                low[k, 2], high[k, 2] = lo - DEPTH * (1.0 + abs(lo)), hi
                continue
            size, offset = (viewport.width, viewport.left) if axis == 0 else (viewport.height, viewport.top)
            lo, hi = (lo + 1.0) * 0.5 * size + offset, (hi + 1.0) * 0.5 * size + offset
            pad = 5.0 * U * (max(abs(lo), abs(hi)) + size + abs(offset)) + SNAP
            low[k, axis], high[k, axis] = lo - pad, hi + pad
    return True


@helper
def _face(low, high, axis, side, plane):
    """Slopes of the plane through the middles of one face of the box; whether the face is turned to the viewer."""
    first = side << axis
    p, q, r = first, first | 1 << ((axis + 1) % 3), first | 1 << ((axis + 2) % 3)
    opposite = first ^ (1 << axis)
    ax, ay, az = low[q, 0] + high[q, 0] - low[p, 0] - high[p, 0], low[q, 1] + high[q, 1] - low[p, 1] - high[p, 1], 0.0
    bx, by, bz = low[r, 0] + high[r, 0] - low[p, 0] - high[p, 0], low[r, 1] + high[r, 1] - low[p, 1] - high[p, 1], 0.0
    ox, oy, oz = (
        low[opposite, 0] + high[opposite, 0] - low[p, 0] - high[p, 0],
        low[opposite, 1] + high[opposite, 1] - low[p, 1] - high[p, 1],
        low[opposite, 2] + high[opposite, 2] - low[p, 2] - high[p, 2],
    )
    az = low[q, 2] + high[q, 2] - low[p, 2] - high[p, 2]
    bz = low[r, 2] + high[r, 2] - low[p, 2] - high[p, 2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    if not (nx * ox + ny * oy + nz * oz) * nz > 0.0:
        return False
    plane[0], plane[1] = -nx / nz, -ny / nz
    return abs(plane[0]) < np.inf and abs(plane[1]) < np.inf


@helper
def _put_under(low, high, plane):
    """The largest c of a plane with slopes a, b that has every corner's range above it."""
    a, b = plane[0], plane[1]
    c = np.inf
    for k in range(8):
        c = min(c, low[k, 2] - max(a * low[k, 0], a * high[k, 0]) - max(b * low[k, 1], b * high[k, 1]))
    plane[2] = c - 1e-12 * (abs(c) + abs(a) * (abs(low[0, 0]) + 1e5) + abs(b) * (abs(low[0, 1]) + 1e5))


@kernel
def _planes_under(live, corners, slack, viewport, low, high, planes):
    for i in range(len(live)):
        for k in range(MOST):
            planes[i, k, 0], planes[i, k, 1], planes[i, k, 2] = 0.0, 0.0, -1.0
        if not _window_ranges(corners[live[i]], slack[live[i]], viewport, low, high):
            continue
        found = 0
        for face in range(6):
            if found < MOST and _face(low, high, face >> 1, face & 1, planes[i, found]):
                _put_under(low, high, planes[i, found])
                found += 1
        for k in range(found, MOST):
            planes[i, k, 0], planes[i, k, 1], planes[i, k, 2] = 0.0, 0.0, -1.0


def planes_under(live: I32, bounds: PatchBounds, viewport: Viewport) -> F64:
    """Planes (a, b, c) under the boxes of some patches or sub-domains, float64[live, MOST, 3]: no depth of one is less than
    a x + b y + c at window position (x, y), pixels. (0, 0, -1), which says nothing, where there are fewer.
    """
    planes = np.empty((len(live), MOST, 3))
    _planes_under(live, bounds.corners, bounds.slack, viewport, np.empty((8, 3)), np.empty((8, 3)), planes)
    return planes


@helper
def nearest_in(planes, z_min, x0, y0, x1, y1):
    """Least depth, float32, of samples in pixels x0..x1, y0..y1 (inclusive), by z_min and planes float64[MOST, 3]."""
    z = np.float64(z_min)
    for k in range(MOST):
        a, b = planes[k, 0], planes[k, 1]
        x, y = x0 if a > 0.0 else x1 + 1, y0 if b > 0.0 else y1 + 1
        z = max(z, (a * x + b * y + planes[k, 2]) * (1.0 - 2.0 * U))
    return np.float32(min(z, 1.0) * (1.0 - 2.0 * U)) if z > z_min else z_min
