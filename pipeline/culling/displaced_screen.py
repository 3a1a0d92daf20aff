"""Displaced patches on the screen: whence they are seen, how they lie there, and what their vertices may be off by."""

from typing import NamedTuple

import numpy as np

from pipeline.culling.screen import DENORMAL, MOST_PIXELS, SNAP, U, clip_error
from pipeline.jit import helper
from pipeline.types import F64, HullInput

ROOM = 1.0 + 1e-6  # for what float64 rounds here


class View(NamedTuple):
    """Whence patches are seen: for kernels."""

    eye: F64  # (3,) world space
    eye_error: float  # how far the matrix's own eye may be from it
    matrix: F64  # (4, 4) clip from world
    det: float  # of the rows x, y, w of it, columns x, y, z
    size: F64  # (4,) viewport: width, height, |left|, |top|


class Screen(NamedTuple):
    """How a displaced patch lies on the screen."""

    whole: bool  # no triangle needs the clipper
    middle: tuple[float, float]  # NDC x, y
    spread: tuple[float, float]  # largest distance from it
    far: tuple[float, float]  # pixels: largest |coordinate| of a vertex
    least_w: float
    most_w: float


@helper
def _row_dot(row, v):
    return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]


@helper
def _row_length(row):
    return np.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])


@helper
def _tilt(row, other, factor):
    """Length of row - factor other."""
    x, y, z = row[0] - factor * other[0], row[1] - factor * other[1], row[2] - factor * other[2]
    return np.sqrt(x * x + y * y + z * z)


@helper
def screen_of(points, origin, farthest, view):
    """The Screen of a patch of control points float64[16, 3] about `origin`, displaced by at most `farthest`."""
    m = view.matrix
    sz, sw = _row_length(m[2]), _row_length(m[3])
    s_far = _tilt(m[3], m[2], 1.0)
    reach = farthest * ROOM
    most = (0.0, 0.0, 0.0)
    mid_x = mid_y = mid_w = 0.0
    least_w, most_w = np.inf, 0.0
    for k in range(16):
        p = (points[k, 0] + origin[0], points[k, 1] + origin[1], points[k, 2] + origin[2])
        most = (max(most[0], abs(p[0])), max(most[1], abs(p[1])), max(most[2], abs(p[2])))
        w = _row_dot(m[3], p) + m[3, 3]
        mid_x, mid_y, mid_w = mid_x + _row_dot(m[0], p) + m[0, 3], mid_y + _row_dot(m[1], p) + m[1, 3], mid_w + w
        least_w, most_w = min(least_w, w - reach * sw), max(most_w, w + reach * sw)
    x, y, z = most[0] + reach, most[1] + reach, most[2] + reach
    error_z, error_w = clip_error(m[2], x, y, z) + sz * 1e-6 * reach, clip_error(m[3], x, y, z) + sw * 1e-6 * reach
    none = (0.0, 0.0)
    if not (least_w > 2.0 * error_w and most_w < np.inf):
        return Screen(False, none, none, none, 0.0, 0.0)
    mid_x, mid_y = mid_x / mid_w, mid_y / mid_w
    tilt_x, tilt_y = _tilt(m[0], m[3], mid_x), _tilt(m[1], m[3], mid_y)
    spread_x = spread_y = 0.0
    whole = True
    for k in range(16):
        p = (points[k, 0] + origin[0], points[k, 1] + origin[1], points[k, 2] + origin[2])
        w = _row_dot(m[3], p) + m[3, 3]
        clip_x, clip_y, clip_z = _row_dot(m[0], p) + m[0, 3], _row_dot(m[1], p) + m[1, 3], _row_dot(m[2], p) + m[2, 3]
        whole &= clip_z - reach * sz > error_z and w - clip_z - reach * s_far > error_z + error_w
        spread_x = max(spread_x, (abs(clip_x - mid_x * w) + reach * tilt_x) / (w - reach * sw))
        spread_y = max(spread_y, (abs(clip_y - mid_y * w) + reach * tilt_y) / (w - reach * sw))
    far_x = (abs(mid_x) + spread_x + 1.0) * view.size[0] + view.size[2]
    far_y = (abs(mid_y) + spread_y + 1.0) * view.size[1] + view.size[3]
    whole &= far_x < MOST_PIXELS and far_y < MOST_PIXELS
    return Screen(whole, (mid_x, mid_y), (spread_x, spread_y), (far_x, far_y), least_w, most_w)


@helper
def vertex_error(points, origin, part, screen, view):
    """Pixels that a vertex of the part may be off by along each axis: float32, viewport, snap."""
    m = view.matrix
    x = y = z = 0.0
    for k in range(16):
        x, y = max(x, abs(points[k, 0] + origin[0])), max(y, abs(points[k, 1] + origin[1]))
        z = max(z, abs(points[k, 2] + origin[2]))
    x, y, z = x + part.farthest, y + part.farthest, z + part.farthest
    shift = part.shift * ROOM + DENORMAL
    error_x = clip_error(m[0], x, y, z) + _row_length(m[0]) * shift
    error_y = clip_error(m[1], x, y, z) + _row_length(m[1]) * shift
    error_w = clip_error(m[3], x, y, z) + _row_length(m[3]) * shift
    ndc_x, ndc_y = abs(screen.middle[0]) + screen.spread[0], abs(screen.middle[1]) + screen.spread[1]
    least_w = screen.least_w - error_w
    if not least_w > 0.0:
        return np.inf
    off_x = 0.5 * view.size[0] * (error_x + ndc_x * error_w) / least_w + 5.0 * U * (screen.far[0] + view.size[0])
    off_y = 0.5 * view.size[1] * (error_y + ndc_y * error_w) / least_w + 5.0 * U * (screen.far[1] + view.size[1])
    return max(off_x, off_y) * 1.01 + SNAP


@helper
def pixels_along(row, screen, view, work):
    """Pixels, x and y together, that a chord of parameter length 1 spans at most; row 1: along u, 2: along v."""
    m, middle, box = view.matrix, work.middle, work.box
    length = 0.0
    for c in range(2):
        along = depth = 0.0
        for s in range(3):
            vector = middle[1] if s == 0 else (middle[2] if s == 1 else middle[0])
            size = max(abs(box[row, s, 0]), abs(box[row, s, 1]))
            w = _row_dot(m[3], vector)
            along += abs(_row_dot(m[c], vector) - screen.middle[c] * w) * size
            depth += abs(w) * size
        length += 0.5 * view.size[c] * (along + screen.spread[c] * depth) / screen.least_w
    return length * ROOM


def viewport_size(stage: HullInput) -> F64:
    """The viewport as `View` has it."""
    v = stage.viewport
    return np.array([v.width, v.height, abs(v.left), abs(v.top)], np.float64)


def view_of_matrix(stage: HullInput) -> View | None:
    """The view of the matrix alone: its eye is where the rows x, y and w are 0. None where it has none, or nearly so."""
    matrix = stage.clip_from_world.astype(np.float64)
    if not np.isfinite(matrix).all():
        return None
    rows = matrix[[0, 1, 3]]
    linear, offset = rows[:, :3], rows[:, 3]
    with np.errstate(all="ignore"):
        det = float(np.linalg.det(linear))
        if not abs(det) > 1e-6 * np.prod(np.linalg.norm(linear, axis=1)):
            return None
        inverse = np.linalg.inv(linear)
        eye = -inverse @ offset
        # Of the equations' residual, and of what float64 loses in it.
        left = abs(linear @ eye + offset) + 1e-15 * (abs(linear) @ abs(eye) + abs(offset))
        error = float((abs(inverse) @ left).sum()) * (1.0 + 1e-6)
    return (
        View(eye, error, matrix, det, viewport_size(stage)) if np.isfinite(eye).all() and np.isfinite(error) else None
    )
