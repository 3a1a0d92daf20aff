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

import numpy as np

from pipeline.bounds.restrict import domain_displacement
from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, cull_facing, eye_or_none, is_single_net, turn_mirrored
from pipeline.culling.chords import Part, bound_part, longest_differences, make_work
from pipeline.culling.displaced_screen import ROOM, Screen, View, pixels_along, screen_of, vertex_error, viewport_size
from pipeline.culling.intervals import bend, cross_dot
from pipeline.culling.pattern_steps import Step
from pipeline.jit import helper, kernel
from pipeline.slopes import build_slopes
from pipeline.types import F64, I64, U8, HullInput, PatchBounds

LEVELS = 3
H, K, G, INV_H, INV_K, SKEW, INV_HK = (
    int(getattr(Step, n)) for n in ("H", "K", "G", "INV_H", "INV_K", "SKEW", "INV_HK")
)


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
    d = vertex_error(points, origin, part, screen, view)
    length_u, length_v = pixels_along(1, screen, view, work) / du, pixels_along(2, screen, view, work) / dv
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
        t0, t1 = domain_displacement(patches.map_id[p], patches.texcoords[p], maps, pyramids, 0.0, 1.0, 0.0, 1.0, False)
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


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the displaced surface of the patches `numbers`, uint8; SILHOUETTE for those that are no single net."""
    facing = np.zeros(len(numbers), np.uint8)
    eye = eye_or_none(stage)
    if eye is None:
        return facing
    at = np.flatnonzero(is_single_net(stage, numbers))
    view = View(eye, 0.0, np.zeros((4, 4)), 0.0, viewport_size(stage))
    facing[at] = turn_mirrored(stage, classify_from(stage, view, numbers[at], np.empty((len(at), 0))))
    return facing


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(classify_patches, stage, flags)
