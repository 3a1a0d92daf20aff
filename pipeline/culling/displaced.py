"""`backface:displaced`: the displaced surface's own normal, bounded over parts of a patch.

Over a part the boxes of `chords` hold the way q from the eye, d_u and d_v of the displaced surface d = p + t n. The surface
faces away at every point where q . (d_u x d_v) > 0 over all three boxes, towards the eye where it is < 0. Parts that
decide nothing are quartered, up to LEVELS times; a part whose middle faces the other way ends it, and so does one that faces
a way that is not asked for. There is no limit on the displacement: where t reaches a centre of curvature, the box of d_u
reaches zero and nothing is told.

Exact for the displaced surface with its map as the filter reads it, wherever it has a normal (it has none on the creases at
texel borders); a tessellation is another surface (`docs/backface.md`). Undisplaced patches are answered for in the same way.

`classify_from` is also the heart of `tessellation_safe` for displaced patches: given the pattern's steps it takes chords of
triangles in place of derivatives, and what the screen's grid may do to them (`displaced_screen`).
"""

from collections.abc import Sequence

import numpy as np

from pipeline.culling import chords, displaced_screen
from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, cull_facing, eye_or_none, is_single_net, turn_mirrored
from pipeline.culling.chords import bound_part, make_scratch, measure_differences, place_patch
from pipeline.culling.displaced_screen import (
    MOST_W,
    ROOM,
    WHOLE,
    View,
    fill_screen,
    pixels_along,
    vertex_error,
    viewport_size,
)
from pipeline.culling.intervals import bend, cross_dot
from pipeline.culling.middle_point import facing_at_middle
from pipeline.culling.part_displacement import (
    DISPLACEMENT,
    PLACE,
    find_displacement,
    find_footprints,
    place_map,
    read_footprints,
)
from pipeline.culling.pattern_steps import NUM_STEPS, Step
from pipeline.jit import helper, inlined, kernel
from pipeline.slopes import build_slopes
from pipeline.types import F64, I64, U8, HullInput, PatchBounds
from pipeline.vector_width import prefer_wide
from pipeline.wide import LANES, choose, greater, load, store

LEVELS = 3
H, K, G, INV_H, INV_K, SKEW, INV_HK = (
    int(getattr(Step, n)) for n in ("H", "K", "G", "INV_H", "INV_K", "SKEW", "INV_HK")
)

# Rows of a block's scratch, after those of `chords` and `displaced_screen`.
STEPS = chords.ROWS + displaced_screen.NUM_ROWS  # NUM_STEPS of the pattern
FINE, DET, HOLDS = (STEPS + NUM_STEPS + k for k in range(3))  # of a part: 1 or 0, of its middle, 1 or 0
NUM_ROWS = displaced_screen.NUM_ROWS + NUM_STEPS + 3
# Rows that are kept of a patch from `_measure_block` until it is looked at.
KEPT = (chords.LONG_U, chords.LONG_V, chords.SIZE, *range(chords.ROWS, STEPS))


@helper
def _left(s, side, least, bent, inv_k):
    """What a corner off the edge's ends leaves of the least determinant."""
    g = load(s, STEPS + 8 * side + G)
    return least - choose(g > 0.0, g * inv_k * bent, 0.0)


@helper
def _test_block(s, view, triangles):
    """Rows FINE, DET and HOLDS: whether each lane's part faces the way of its middle, all of it or all its triangles."""
    part = bound_part(s, view.eye, view.eye_error)
    least, _ = cross_dot(part.q, part.a, part.b)
    least = least - 1e-12 * (1.0 + abs(least))
    holds = least > 0.0
    if triangles:
        du, dv = load(s, PLACE + 1) - load(s, PLACE), load(s, PLACE + 3) - load(s, PLACE + 2)
        d = vertex_error(s, part, view)
        length_u, length_v = pixels_along(s, part.a, part, view) / du, pixels_along(s, part.b, part, view) / dv
        most_w = load(s, MOST_W)
        to_pixels = 0.25 * view.size[0] * view.size[1] / (most_w * most_w * most_w)
        to_pixels = to_pixels * (abs(view.det * part.det) / (du * dv) / ROOM)
        bent_u, bent_v = bend(part.q, part.a) * (dv / du) * ROOM, bend(part.q, part.b) * (du / dv) * ROOM
        for side in range(2):
            bent = bent_u if side == 0 else bent_v
            own, other = (length_u, length_v) if side == 0 else (length_v, length_u)
            first = STEPS + 8 * side
            inv_k = load(s, first + INV_K)
            left = _left(s, side, least, bent, inv_k)
            wobble = own * inv_k + other * load(s, first + INV_H) + own * load(s, first + SKEW)
            room = 2.0 * d * wobble + 8.0 * d * d * load(s, first + INV_HK)
            holds = holds & (left * to_pixels > room * ROOM)
    store(s, FINE, choose(part.fine, 1.0, 0.0))
    store(s, DET, part.det)
    store(s, HOLDS, choose(holds, 1.0, 0.0))


@helper
def _measure_block(s, view, triangles, least, most):
    """Rows of whole patches: their longest differences, and how they lie on the screen.

    Row HOLDS: 0 where the middle faces a side that is not in least .. most.
    """
    measure_differences(s)
    store(s, HOLDS, 1.0)
    if most - least < 2:
        low, high = facing_at_middle(s, view.eye)
        store(s, HOLDS, choose(low > 0.0 if most < 1 else high < 0.0, 0.0, 1.0))
    if triangles:
        fill_screen(s, greater(abs(load(s, DISPLACEMENT)), abs(load(s, DISPLACEMENT + 1))), view)


@helper
def _reaches(steps):
    """How far triangles whose least u and v lie in a part reach out of it along u and v; 0 without triangles."""
    if len(steps) == 0:
        return 0.0, 0.0
    return max(steps[H] + steps[G], steps[8 + K]), max(steps[8 + H] + steps[8 + G], steps[K])


@inlined
def _place(u0, u1, v0, v1, lane, s):
    s[PLACE, lane], s[PLACE + 1, lane], s[PLACE + 2, lane], s[PLACE + 3, lane] = u0, u1, v0, v1


@helper
def _split(u0, u1, v0, v1, level, parts, todo):
    """Put the quarters of a part on a lane's stack; how many parts there are then."""
    um, vm = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    for quarter in range(4):
        new = parts[todo + quarter]
        new[0], new[1] = (u0, um) if quarter & 1 == 0 else (um, u1)
        new[2], new[3] = (v0, vm) if quarter & 2 == 0 else (vm, v1)
        new[4] = level + 1.0
    return todo + 4


@kernel
def _find_signs(
    control_points, slack, map_id, texcoords, address, factors, biases, whole, first, size, t_lo, t_hi, s_lo, s_hi, r_lo, r_hi,
    view, numbers, steps, least, most, out,
):  # fmt: skip
    """Sign of q . (d_u x d_v) over all of each patch, int8: 1, -1, or 0 where it is not sure or not in least .. most.

    steps : of the patterns, float64[len(numbers), NUM_STEPS]: then for every triangle, on the 16.8 grid too; with no columns:
    for every point. Boxes are about view.eye. slack : float64[P], `Patches.normal_slack` or 0. The rest are arrays of Patches,
    DisplacementMaps and Pyramids (`part_displacement.read_footprints`), one by one: what is taken out of a tuple of arrays in a
    loop is counted each time, which took longer than all the rest.

    Each lane has a patch, and a stack of the parts of it that are still to be looked at. A step looks at one part of each
    lane's patch; a lane that comes to an answer takes the next patch.
    """
    prefer_wide()
    triangles = steps.shape[1] > 0
    s = make_scratch(NUM_ROWS)
    kept = np.empty((len(numbers), len(KEPT)))
    parts = np.empty((LANES, 3 * LEVELS + 1, 5))
    of_lane, todo, sign = np.full(LANES, -1), np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
    for begin in range(0, len(numbers), LANES):
        n = min(LANES, len(numbers) - begin)
        of_lane[:n], of_lane[n:] = 0, -1  # lanes that have a patch
        for lane in range(n):
            p = numbers[begin + lane]
            place_patch(control_points[p], slack[p], lane, s)
            place_map(map_id[p], texcoords[p], address, factors, biases, whole, size, lane, s)
            _place(0.0, 1.0, 0.0, 1.0, lane, s)
        find_footprints(s)
        read_footprints(s, of_lane, first, size, address, t_lo, t_hi, s_lo, s_hi, r_lo, r_hi)
        find_displacement(s)
        _measure_block(s, view, triangles, least, most)
        for lane in range(n):
            k = begin + lane
            for r in range(len(KEPT)):
                kept[k, r] = s[KEPT[r], lane]
            reach_u, reach_v = _reaches(steps[k])
            known = reach_u + reach_v < np.inf and s[DISPLACEMENT, lane] <= s[DISPLACEMENT + 1, lane]
            out[k] = 1 if known and s[HOLDS, lane] > 0.0 and (s[WHOLE, lane] > 0.0 or not triangles) else 0
    of_lane[:] = -1
    taken, busy = 0, True
    while busy:
        busy = False
        for lane in range(LANES):
            while of_lane[lane] < 0 and taken < len(numbers):
                k = taken
                taken += 1
                if out[k] == 0:
                    continue
                of_lane[lane], todo[lane], sign[lane] = k, 1, 0
                parts[lane, 0, 0], parts[lane, 0, 1], parts[lane, 0, 2], parts[lane, 0, 3] = 0.0, 1.0, 0.0, 1.0
                parts[lane, 0, 4] = 0.0
                p = numbers[k]
                place_patch(control_points[p], slack[p], lane, s)
                place_map(map_id[p], texcoords[p], address, factors, biases, whole, size, lane, s)
                for r in range(len(KEPT)):
                    s[KEPT[r], lane] = kept[k, r]
                for r in range(steps.shape[1]):
                    s[STEPS + r, lane] = steps[k, r]
            k = of_lane[lane]
            if k >= 0:
                busy = True
                # All triangles whose least u and least v lie in the part lie in u0 .. a1, v0 .. b1.
                u0, u1, v0, v1, _ = parts[lane, todo[lane] - 1]
                reach_u, reach_v = _reaches(steps[k])
                a1, b1 = min(u1 + reach_u, 1.0), min(v1 + reach_v, 1.0)
                _place(u0, a1, v0, b1, lane, s)
        if busy:
            find_footprints(s)
            read_footprints(s, of_lane, first, size, address, t_lo, t_hi, s_lo, s_hi, r_lo, r_hi)
            find_displacement(s)
            _test_block(s, view, triangles)
        for lane in range(LANES):
            k = of_lane[lane]
            if k < 0:
                continue
            todo[lane] -= 1
            u0, u1, v0, v1, level = parts[lane, todo[lane]]
            fine = s[FINE, lane] > 0.0
            alive = True
            if fine:
                side = 1 if s[DET, lane] > 0.0 else -1
                alive = (sign[lane] == 0 or side == sign[lane]) and least <= side <= most
                sign[lane] = side
            if alive and not (fine and s[HOLDS, lane] > 0.0):
                reach_u, reach_v = _reaches(steps[k])
                alive = level < LEVELS and not (2.0 * (u1 - u0) < reach_u and 2.0 * (v1 - v0) < reach_v)
                if alive:
                    todo[lane] = _split(u0, u1, v0, v1, level, parts[lane], todo[lane])
            if not alive:
                out[k], of_lane[lane] = 0, -1
            elif todo[lane] == 0:
                out[k], of_lane[lane] = sign[lane], -1


def classify_from(
    stage: HullInput, view: View, numbers: I64, steps: F64, wanted: Sequence[int] | U8 = (FRONT, BACK)
) -> U8:
    """Facing of the patches `numbers`, all of which are `is_single_net`, as `view` sees them, where it is one of `wanted`.

    steps : as for `_find_signs`.
    """
    patches, maps, pyramids = stage.patches, stage.maps, stage.pyramids
    slack = np.where(patches.normal_id >= 0, patches.normal_slack, 0.0).astype(np.float64)
    signs = np.empty(len(numbers), np.int8)
    along_s, along_t = build_slopes(stage.maps) if stage.slopes is None else stage.slopes
    # q . (d_u x d_v) > 0 looks away; a view that mirrors turns triangles over, but not the surface.
    back = 1 if steps.shape[1] == 0 or view.det < 0.0 else -1
    sides = [back] * int(BACK in wanted) + [-back] * int(FRONT in wanted)
    least, most = min(sides, default=0), max(sides, default=0)
    with np.errstate(all="ignore"):  # lanes of which nothing is known, where nothing is compiled
        _find_signs(
            patches.control_points, slack, patches.map_id, patches.texcoords, maps.address, maps.scale, maps.bias,
            pyramids.whole, pyramids.first, pyramids.size, pyramids.lo, pyramids.hi, along_s.lo, along_s.hi, along_t.lo,
            along_t.hi, view, numbers, steps, least, most, signs,
        )  # fmt: skip
    facing = np.full(len(numbers), SILHOUETTE, np.uint8)
    facing[signs == back], facing[signs == -back] = BACK, FRONT
    return facing


def _classify(stage: HullInput, numbers: I64, wanted: Sequence[int]) -> U8:
    """Facing of the displaced surface of the patches `numbers` where it is one of `wanted`."""
    facing = np.zeros(len(numbers), np.uint8)
    eye = eye_or_none(stage)
    if eye is None:
        return facing
    at = np.flatnonzero(is_single_net(stage, numbers))
    view = View(eye, 0.0, np.zeros((4, 4)), 0.0, viewport_size(stage))
    sides = turn_mirrored(stage, np.array(wanted, np.uint8))
    facing[at] = turn_mirrored(stage, classify_from(stage, view, numbers[at], np.empty((len(at), 0)), sides))
    return facing


def classify_patches(stage: HullInput, numbers: I64) -> U8:
    """Facing of the displaced surface of the patches `numbers`, uint8; SILHOUETTE for those that are no single net."""
    return _classify(stage, numbers, (FRONT, BACK))


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches that face away; `flags` uint8[P] modified in place."""
    cull_facing(lambda some, numbers: _classify(some, numbers, (some.face_cull,)), stage, flags)
