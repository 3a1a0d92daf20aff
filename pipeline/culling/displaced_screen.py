"""Displaced patches on the screen: whence they are seen, how they lie there, and what their vertices may be off by."""

from typing import NamedTuple

import numpy as np

from pipeline.culling import chords
from pipeline.culling.chords import ORIGIN, POINTS, load_vector
from pipeline.culling.screen import DENORMAL, MOST_PIXELS, SNAP, U, clip_error
from pipeline.jit import helper, inlined
from pipeline.types import F64, HullInput
from pipeline.wide import choose, greater, lesser, load, root, spread, store

ROOM = 1.0 + 1e-6  # for what float64 rounds here


class View(NamedTuple):
    """Whence patches are seen: for kernels."""

    eye: F64  # (3,) world space
    eye_error: float  # how far the matrix's own eye may be from it
    matrix: F64  # (4, 4) clip from world
    det: float  # of the rows x, y, w of it, columns x, y, z
    size: F64  # (4,) viewport: width, height, |left|, |top|


# Rows of a block's scratch, after those of `chords`: how a displaced patch lies on the screen.
MOST = chords.ROWS  # largest |x|, |y|, |z| of its control points, world space
MIDDLE = chords.ROWS + 3  # NDC x, y
SPREAD = chords.ROWS + 5  # largest distance from it
FAR = chords.ROWS + 7  # pixels: largest |coordinate| of a vertex
LEAST_W, MOST_W = chords.ROWS + 9, chords.ROWS + 10
WHOLE = chords.ROWS + 11  # 1 where no triangle needs the clipper, 0 elsewhere
NUM_ROWS = 12


@inlined
def _row_dot(row, v):
    return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]


@inlined
def _row_length(row):
    return np.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])


@inlined
def _tilt(row, other, factor):
    """Length of row - factor other; factor: Wide."""
    x, y, z = row[0] - factor * other[0], row[1] - factor * other[1], row[2] - factor * other[2]
    return root(x * x + y * y + z * z)


@inlined
def _point(s, k, origin):
    p = load_vector(s, POINTS + 3 * k)
    return p[0] + origin[0], p[1] + origin[1], p[2] + origin[2]


@helper
def fill_screen(s, farthest, view):
    """Rows MOST .. WHOLE of the patches of a block, displaced by at most `farthest`, from POINTS and ORIGIN."""
    m = view.matrix
    sz, sw = _row_length(m[2]), _row_length(m[3])
    s_far = _tilt(m[3], m[2], spread(1.0))
    reach = farthest * ROOM
    origin = load_vector(s, ORIGIN)
    zero = spread(0.0)
    most_x = most_y = most_z = mid_x = mid_y = mid_w = most_w = zero
    least_w = spread(np.inf)
    for k in range(16):
        p = _point(s, k, origin)
        most_x, most_y, most_z = greater(most_x, abs(p[0])), greater(most_y, abs(p[1])), greater(most_z, abs(p[2]))
        w = _row_dot(m[3], p) + m[3, 3]
        mid_x, mid_y, mid_w = mid_x + (_row_dot(m[0], p) + m[0, 3]), mid_y + (_row_dot(m[1], p) + m[1, 3]), mid_w + w
        least_w, most_w = lesser(least_w, w - reach * sw), greater(most_w, w + reach * sw)
    x, y, z = most_x + reach, most_y + reach, most_z + reach
    error_z, error_w = clip_error(m[2], x, y, z) + sz * 1e-6 * reach, clip_error(m[3], x, y, z) + sw * 1e-6 * reach
    whole = (least_w > 2.0 * error_w) & (most_w < np.inf)
    mid_x, mid_y = mid_x / mid_w, mid_y / mid_w
    tilt_x, tilt_y = _tilt(m[0], m[3], mid_x), _tilt(m[1], m[3], mid_y)
    spread_x = spread_y = zero
    for k in range(16):
        p = _point(s, k, origin)
        w = _row_dot(m[3], p) + m[3, 3]
        clip_x, clip_y, clip_z = _row_dot(m[0], p) + m[0, 3], _row_dot(m[1], p) + m[1, 3], _row_dot(m[2], p) + m[2, 3]
        whole = whole & (clip_z - reach * sz > error_z) & (w - clip_z - reach * s_far > error_z + error_w)
        under = 1.0 / (w - reach * sw)
        spread_x = greater(spread_x, (abs(clip_x - mid_x * w) + reach * tilt_x) * under)
        spread_y = greater(spread_y, (abs(clip_y - mid_y * w) + reach * tilt_y) * under)
    far_x = (abs(mid_x) + spread_x + 1.0) * view.size[0] + view.size[2]
    far_y = (abs(mid_y) + spread_y + 1.0) * view.size[1] + view.size[3]
    whole = whole & (far_x < MOST_PIXELS) & (far_y < MOST_PIXELS)
    store(s, MOST, most_x)
    store(s, MOST + 1, most_y)
    store(s, MOST + 2, most_z)
    store(s, MIDDLE, mid_x)
    store(s, MIDDLE + 1, mid_y)
    store(s, SPREAD, spread_x)
    store(s, SPREAD + 1, spread_y)
    store(s, FAR, far_x)
    store(s, FAR + 1, far_y)
    store(s, LEAST_W, least_w)
    store(s, MOST_W, most_w)
    store(s, WHOLE, choose(whole, 1.0, zero))


@helper
def vertex_error(s, part, view):
    """Pixels that a vertex of each lane's part may be off by along each axis: float32, viewport, snap."""
    m = view.matrix
    x, y, z = load(s, MOST) + part.farthest, load(s, MOST + 1) + part.farthest, load(s, MOST + 2) + part.farthest
    shift = part.shift * ROOM + DENORMAL
    error_x = clip_error(m[0], x, y, z) + _row_length(m[0]) * shift
    error_y = clip_error(m[1], x, y, z) + _row_length(m[1]) * shift
    error_w = clip_error(m[3], x, y, z) + _row_length(m[3]) * shift
    ndc_x, ndc_y = abs(load(s, MIDDLE)) + load(s, SPREAD), abs(load(s, MIDDLE + 1)) + load(s, SPREAD + 1)
    least_w = load(s, LEAST_W) - error_w
    under = 1.0 / least_w
    off_x = 0.5 * view.size[0] * (error_x + ndc_x * error_w) * under + 5.0 * U * (load(s, FAR) + view.size[0])
    off_y = 0.5 * view.size[1] * (error_y + ndc_y * error_w) * under + 5.0 * U * (load(s, FAR + 1) + view.size[1])
    return choose(least_w > 0.0, greater(off_x, off_y) * 1.01 + SNAP, np.inf)


@inlined
def _pixels_on(s, c, box, part, view):
    m, middle = view.matrix, load(s, MIDDLE + c)
    along = depth = spread(0.0)
    for vector, interval in ((part.middle_a, box[0]), (part.middle_b, box[1]), (part.middle_q, box[2])):
        size = greater(abs(interval[0]), abs(interval[1]))
        w = _row_dot(m[3], vector)
        along = along + abs(_row_dot(m[c], vector) - middle * w) * size
        depth = depth + abs(w) * size
    return 0.5 * view.size[c] * (along + load(s, SPREAD + c) * depth) / load(s, LEAST_W)


@helper
def pixels_along(s, box, part, view):
    """Pixels, x and y together, that a chord of parameter length 1 spans at most; box: `part.a` along u, `part.b` along v."""
    return (_pixels_on(s, 0, box, part, view) + _pixels_on(s, 1, box, part, view)) * ROOM


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
