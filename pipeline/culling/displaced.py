"""`backface:displaced`: the displaced surface's own normal, bounded over parts of a patch.

Over a part the boxes of `chords` hold the way q from the eye, d_u and d_v of the displaced surface d = p + t n. The surface
faces away at every point where q . (d_u x d_v) > 0 over all three boxes, towards the eye where it is < 0. Parts that
decide nothing are quartered, up to LEVELS times; a part whose middle faces the other way ends it. There is no limit on
the displacement: where t reaches a centre of curvature, the box of d_u reaches zero and nothing is told.

Exact for the displaced surface with its map as the filter reads it, wherever it has a normal (it has none on the creases at
texel borders); a tessellation is another surface (`docs/backface.md`). Undisplaced patches are answered for in the same way.

`faces_one_way` is also the heart of `tessellation_safe` for displaced patches: given the pattern's steps it takes chords of
triangles in place of derivatives, and what the screen's grid may do to them (`Screen`).
"""

from typing import NamedTuple

import numpy as np

from pipeline.bounds.restrict import domain_displacement
from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, cull_facing, eye_or_none, is_single_net, turn_mirrored
from pipeline.culling.chords import Part, bound_part, longest_differences, make_work
from pipeline.culling.intervals import bend, cross_dot
from pipeline.culling.pattern_steps import Step
from pipeline.culling.screen import DENORMAL, MOST_PIXELS, SNAP, U, clip_error
from pipeline.jit import helper, kernel
from pipeline.slopes import build_slopes
from pipeline.types import F64, I64, U8, HullInput, PatchBounds

LEVELS = 3
H, K, G, INV_H, INV_K, SKEW, INV_HK = (
    int(getattr(Step, n)) for n in ("H", "K", "G", "INV_H", "INV_K", "SKEW", "INV_HK")
)
ROOM = 1.0 + 1e-6


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
def _vertex_error(points, origin, part, screen, view):
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
def _pixels_along(row, screen, view, work):
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


@helper
def _interval(box, row, c):
    return box[row, c, 0], box[row, c, 1]


@helper
def _vector(box, row):
    return _interval(box, row, 0), _interval(box, row, 1), _interval(box, row, 2)


@helper
def _holds(points, origin, part, steps, screen, view, du, dv, work):
    """Whether the part faces the way of its middle; steps float64[NUM_STEPS] of its triangles, or of length 0: points only."""
    q, a, b = _vector(work.box, 0), _vector(work.box, 1), _vector(work.box, 2)
    least, _ = cross_dot(q, a, b)
    least -= 1e-12 * (1.0 + abs(least))
    if not least > 0.0 or len(steps) == 0:
        return least > 0.0
    d = _vertex_error(points, origin, part, screen, view)
    length_u, length_v = _pixels_along(1, screen, view, work) / du, _pixels_along(2, screen, view, work) / dv
    to_pixels = 0.25 * view.size[0] * view.size[1] / (screen.most_w * screen.most_w * screen.most_w)
    to_pixels *= abs(view.det * part.det) / (du * dv) / ROOM
    bent_u, bent_v = bend(q, a) * (dv / du) * ROOM, bend(q, b) * (du / dv) * ROOM
    for side in range(2):
        s = steps[8 * side : 8 * side + 8]
        if side == 0:
            left = least - (s[G] * s[INV_K] * bent_u if s[G] > 0.0 else 0.0)
            wobble = length_u * s[INV_K] + length_v * s[INV_H] + length_u * s[SKEW]
        else:
            left = least - (s[G] * s[INV_K] * bent_v if s[G] > 0.0 else 0.0)
            wobble = length_v * s[INV_K] + length_u * s[INV_H] + length_v * s[SKEW]
        if not left * to_pixels > (2.0 * d * wobble + 8.0 * d * d * s[INV_HK]) * ROOM:
            return False
    return True


@helper
def faces_one_way(p, patches, maps, pyramids, along_s, along_t, view, steps, points, parts, work):
    """Sign of q . (d_u x d_v) over all of patch p: 1, -1, or 0 where it is not sure. Boxes are about view.eye.

    steps : of the pattern, float64[NUM_STEPS]: then for every triangle, on the 16.8 grid too; float64[0]: for every point.
    points float64[16, 3], parts float64[3 LEVELS + 1, 5], work : scratch.
    """
    cp = patches.control_points[p]
    for k in range(16):
        for c in range(3):
            points[k, c] = np.float64(cp[k >> 2, k & 3, c]) - np.float64(cp[0, 0, c])
    origin = (np.float64(cp[0, 0, 0]), np.float64(cp[0, 0, 1]), np.float64(cp[0, 0, 2]))
    longest = longest_differences(points)
    none = (0.0, 0.0)
    screen = Screen(False, none, none, none, 0.0, 0.0)
    reach_u = reach_v = 0.0
    if len(steps) > 0:
        reach_u, reach_v = max(steps[H] + steps[G], steps[8 + K]), max(steps[8 + H] + steps[8 + G], steps[K])
        t0, t1 = domain_displacement(p, patches, maps, pyramids, 0.0, 1.0, 0.0, 1.0, False)
        screen = screen_of(points, origin, max(abs(t0), abs(t1)), view)
        if not (reach_u + reach_v < np.inf and t0 <= t1 and screen.whole):
            return 0
    parts[0, 0], parts[0, 1], parts[0, 2], parts[0, 3], parts[0, 4] = 0.0, 1.0, 0.0, 1.0, 0.0
    todo, sign = 1, 0
    while todo > 0:
        todo -= 1
        u0, u1, v0, v1, level = parts[todo]
        # All triangles whose least u and least v lie in the part lie in u0 .. a1, v0 .. b1.
        a1, b1 = min(u1 + reach_u, 1.0), min(v1 + reach_v, 1.0)
        part: Part = bound_part(
            p, patches, maps, pyramids, along_s, along_t, view.eye, view.eye_error, u0, a1, v0, b1, longest, work
        )  # fmt: skip
        if part.fine:
            side = 1 if part.det > 0.0 else -1
            if sign != 0 and side != sign:
                return 0
            if sign == 0:
                sign = side
            if _holds(points, origin, part, steps, screen, view, a1 - u0, b1 - v0, work):
                continue
        if level >= LEVELS or (2.0 * (u1 - u0) < reach_u and 2.0 * (v1 - v0) < reach_v):
            return 0
        um, vm = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
        for quarter in range(4):
            new = parts[todo]
            new[0], new[1] = (u0, um) if quarter & 1 == 0 else (um, u1)
            new[2], new[3] = (v0, vm) if quarter & 2 == 0 else (vm, v1)
            new[4] = level + 1.0
            todo += 1
    return sign


@kernel
def _classify(patches, maps, pyramids, along_s, along_t, view, numbers, steps, out):
    """steps : float64[len(numbers), NUM_STEPS], or [len(numbers), 0] for the surface."""
    points, parts, work = np.empty((16, 3)), np.empty((3 * LEVELS + 1, 5)), make_work()
    orientation = 1.0 if steps.shape[1] == 0 else -view.det
    for k in range(len(numbers)):
        sign = faces_one_way(
            numbers[k], patches, maps, pyramids, along_s, along_t, view, steps[k], points, parts, work
        ) * orientation  # fmt: skip
        out[k] = BACK if sign > 0.0 else (FRONT if sign < 0.0 else SILHOUETTE)


def classify_from(stage: HullInput, view: View, numbers: I64, steps: F64) -> U8:
    """Facing of the patches `numbers`, all of which are `is_single_net`, as `view` sees them; steps as for `_classify`."""
    out = np.empty(len(numbers), np.uint8)
    along_s, along_t = build_slopes(stage.maps) if stage.slopes is None else stage.slopes
    _classify(stage.patches, stage.maps, stage.pyramids, along_s, along_t, view, numbers, steps, out)
    return out


def _size(stage: HullInput) -> F64:
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
    return View(eye, error, matrix, det, _size(stage)) if np.isfinite(eye).all() and np.isfinite(error) else None


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the displaced surface of the patches `numbers`, uint8; SILHOUETTE for those that are no single net."""
    facing = np.zeros(len(numbers), np.uint8)
    eye = eye_or_none(stage)
    if eye is None:
        return facing
    at = np.flatnonzero(is_single_net(stage.patches, numbers))
    view = View(eye, 0.0, np.zeros((4, 4)), 0.0, _size(stage))
    facing[at] = turn_mirrored(stage, classify_from(stage, view, numbers[at], np.empty((len(at), 0))))
    return facing


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
