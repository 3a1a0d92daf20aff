"""What every bound shares: an oriented box in world space to clip corners, screen rectangle and nearest depth.

Conservative for what the pipeline computes in float32 (u = 2^-24), all of it evaluated in float64 and widened outwards:

- a clip component ((m0 x + m1 y) + m2 z) + m3 has at most 4 roundings, each of at most u times the sum of the terms'
  magnitudes; vertices made by the clipper are rounded once more: `slack` is 6 u times that sum;
- x/w, + 1, * width, + left: each rounds once; 5 u (|x_win| + width) covers it, and the snap moves by 1/512 pixel;
- z/w rounds once, its scaling to the depth range twice, the interpolated depth is clamped to its triangle's range.

Division only where w is surely positive: a box that reaches behind the near plane z = 0 is first cut by it (12 edges;
box of the corners in front and the crossing points). Where no positive w is certain the whole viewport is returned.
"""

import numpy as np

from pipeline.jit import helper
from pipeline.types import PatchBounds

U = 2.0**-24
SLACK = 6.0 * U
SNAP = 1.0 / 512.0


def allocate(n: int) -> PatchBounds:
    """Arrays for n patches, to be filled."""
    return PatchBounds(
        center=np.empty((n, 3)),
        axes=np.empty((n, 3, 3)),
        corners=np.empty((n, 8, 4)),
        slack=np.empty((n, 4)),
        rect=np.empty((n, 4), np.int32),
        z_min=np.empty(n, np.float32),
        inside=np.empty(n, np.uint8),
        cone_axis=np.zeros((n, 3)),
        cone_cos=np.empty(n),
    )


@helper
def _transform_corners(p, matrix, bounds):
    """Clip-space corners and slack of box p. Corner k: bit r of k gives the sign of axis r."""
    center, axes = bounds.center[p], bounds.axes[p]
    for row in range(4):
        m0, m1, m2, m3 = matrix[row, 0], matrix[row, 1], matrix[row, 2], matrix[row, 3]
        middle = m0 * center[0] + m1 * center[1] + m2 * center[2] + m3
        reach0 = m0 * axes[0, 0] + m1 * axes[0, 1] + m2 * axes[0, 2]
        reach1 = m0 * axes[1, 0] + m1 * axes[1, 1] + m2 * axes[1, 2]
        reach2 = m0 * axes[2, 0] + m1 * axes[2, 1] + m2 * axes[2, 2]
        for k in range(8):
            sum0 = middle + reach0 if k & 1 else middle - reach0
            sum1 = sum0 + reach1 if k & 2 else sum0 - reach1
            bounds.corners[p, k, row] = sum1 + reach2 if k & 4 else sum1 - reach2
        extent0 = abs(center[0]) + abs(axes[0, 0]) + abs(axes[1, 0]) + abs(axes[2, 0])
        extent1 = abs(center[1]) + abs(axes[0, 1]) + abs(axes[1, 1]) + abs(axes[2, 1])
        extent2 = abs(center[2]) + abs(axes[0, 2]) + abs(axes[1, 2]) + abs(axes[2, 2])
        bounds.slack[p, row] = SLACK * (abs(m0) * extent0 + abs(m1) * extent1 + abs(m2) * extent2 + abs(m3))


@helper
def _all_inside(p, bounds):
    """Whether every point of the box is inside all six planes by more than the slack."""
    sx, sy, sz, sw = bounds.slack[p]
    for k in range(8):
        x, y, z, w = bounds.corners[p, k]
        if not (w + x > sw + sx and w - x > sw + sx and w + y > sw + sy and w - y > sw + sy):
            return False
        if not (z > sz and w - z > sw + sz):
            return False
    return True


@helper
def _ratio_range(a, w, slack_a, slack_w):
    """Range of (a +- slack_a) / (w +- slack_w) for w > slack_w."""
    lo, hi = a - slack_a, a + slack_a
    near, far = w - slack_w, w + slack_w
    return min(lo / near, lo / far), max(hi / near, hi / far)


@helper
def _project(p, near_offset, bounds):
    """Ranges of x/w and y/w and the least z/w over the part of box p with z >= -near_offset.

    Returns (state, x_lo, x_hi, y_lo, y_hi, z_lo); state 0: nothing lies in front; 1: ranges are valid; -1: unknown.
    """
    sx, sy, sz, sw = bounds.slack[p]
    corners = bounds.corners[p]
    x_lo, x_hi, y_lo, y_hi, z_lo = np.inf, -np.inf, np.inf, -np.inf, np.inf
    state = 0
    for k in range(8):
        if not (corners[k, 2] > -np.inf and corners[k, 2] < np.inf):
            return -1, 0.0, 0.0, 0.0, 0.0, 0.0
        for bit in range(-1, 3):
            x, y, z, w = corners[k]
            if bit < 0:  # the corner itself
                if z < -near_offset:
                    continue
            else:  # the edge along axis `bit`, seen once, from its lower corner
                if k & (1 << bit):
                    continue
                other = corners[k | (1 << bit)]
                d, e = z + near_offset, other[2] + near_offset
                if (d < 0.0) == (e < 0.0):
                    continue
                t = d / (d - e)
                x, y, w = x + t * (other[0] - x), y + t * (other[1] - y), w + t * (other[3] - w)
                z = -near_offset
            if not (w > 2.0 * sw):
                return -1, 0.0, 0.0, 0.0, 0.0, 0.0
            state = 1
            a, b = _ratio_range(x, w, sx, sw)
            x_lo, x_hi = min(x_lo, a), max(x_hi, b)
            a, b = _ratio_range(y, w, sy, sw)
            y_lo, y_hi = min(y_lo, a), max(y_hi, b)
            a, b = _ratio_range(z, w, sz, sw)
            z_lo = min(z_lo, a)
    if not (x_lo <= x_hi and y_lo <= y_hi) and state == 1:
        return -1, 0.0, 0.0, 0.0, 0.0, 0.0
    return state, x_lo, x_hi, y_lo, y_hi, z_lo


@helper
def _pixels(lo, hi, size, offset):
    """Pixels [first, last + 1) that samples of window range lo .. hi (NDC, growing with the pixel) may lie in."""
    a, b = (lo + 1.0) * 0.5 * size + offset, (hi + 1.0) * 0.5 * size + offset
    pad = 5.0 * U * (max(abs(a), abs(b)) + size + abs(offset)) + SNAP
    first = min(max(np.floor(a - pad), np.float64(offset)), np.float64(offset + size))
    last = min(max(np.ceil(b + pad), np.float64(offset)), np.float64(offset + size))
    return np.int32(first), np.int32(max(first, last))


@helper
def project_box(p, matrix, viewport, bounds):
    """Fill corners, slack, rect, z_min and inside of box p from its center and axes."""
    _transform_corners(p, matrix, bounds)
    bounds.inside[p] = 1 if _all_inside(p, bounds) else 0
    state, x_lo, x_hi, y_lo, y_hi, z_lo = _project(p, 2.0 * bounds.slack[p, 2], bounds)
    rect = bounds.rect[p]
    rect[0], rect[1] = viewport.left, viewport.top
    rect[2], rect[3] = viewport.left + viewport.width, viewport.top + viewport.height
    bounds.z_min[p] = viewport.min_depth
    if state == 0:
        rect[2], rect[3] = rect[0], rect[1]
        bounds.z_min[p] = viewport.max_depth
    elif state == 1:
        rect[0], rect[2] = _pixels(x_lo, x_hi, viewport.width, viewport.left)
        rect[1], rect[3] = _pixels(-y_hi, -y_lo, viewport.height, viewport.top)
        if rect[0] == rect[2] or rect[1] == rect[3]:
            rect[2], rect[3] = rect[0], rect[1]
        depth = viewport.min_depth + z_lo * (viewport.max_depth - viewport.min_depth)
        depth -= 4.0 * U * (abs(z_lo) + viewport.min_depth)
        bounds.z_min[p] = _float32_below(min(max(depth, viewport.min_depth), viewport.max_depth))


@helper
def _float32_below(a):
    """A float32 not above `a`, for a in [0, 1]."""
    return np.float32(max(a * (1.0 - 2.0 * U) - 2.0**-149, 0.0))
