"""Bound and split: patches cut into parametric sub-domains that are bounded, culled and binned by themselves.

The tessellation pattern of the whole patch is kept. A sub-domain owns the triangles whose centroid lies in its cell, which is
found in exact integers (16.16 fixed point, times 3); cells are halves of halves of the patch's domain, so each triangle has
one owner. What is bounded is the rectangle in (u, v) of the owned triangles' corners: at the rim it may reach a little over
the cell. A sub-domain shades the distinct domain points that its triangles touch; those on a border are shaded on both sides,
by the same arithmetic, so nothing cracks.

A sub-domain is split while its screen rectangle is wider or higher than an extent and touches more than one tile, the one
with the largest rectangle first, until the patch has as many as the budget allows. It is cut across the side that is longer in
world units. One that lies outside the frustum is dropped, and never split; a half that owns no triangle is dropped, too.
"""

from typing import Any, NamedTuple

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.bounds.refine import gather_parts, side_lengths, split_domains
from pipeline.culling import CULL_TESTS
from pipeline.jit import helper, kernel
from pipeline.types import F64, I32, I64, U8, HullInput, PatchBounds, Patterns
from tiler.config import Machine
from tiler.units import Units

ONE = 1 << 16  # of the pattern's fixed point
MIN_SIDE = 1.0 / 64.0  # no pattern is finer
PART_CULLS = ("frustum", "frustum:world")  # the cull tests that answer for a part of a patch


class Parts(NamedTuple):
    """Sub-domains: patch, cell, owned triangles and points, and what the bound says."""

    patch: I32  # (n,)
    cell: F64  # (n, 4) u0, u1, v0, v1
    bounds: PatchBounds  # n rows
    culled: U8  # (n,) 1: outside the frustum

    def take(self, rows: I64) -> "Parts":
        """These rows."""
        return Parts(self.patch[rows], self.cell[rows], take_bounds(self.bounds, rows), self.culled[rows])


def take_bounds(bounds: PatchBounds, rows: I32 | I64) -> PatchBounds:
    """The bounds of these rows."""
    columns: list[Any] = [column[rows] for column in bounds]
    return PatchBounds(*columns)


class Split(NamedTuple):
    """The outcome for a frame, and what it cost."""

    units: Units
    live: I32  # units that live on, in submit order
    bounded: int  # sub-domains for which a bound was evaluated
    culled: int  # leaves outside the frustum


@helper
def _owns(patterns, t, base, low_u, high_u, low_v, high_v):
    """Whether the centroid of triangle t is in the cell; limits in fixed point times 3, the last ones inclusive."""
    u, v = np.int64(0), np.int64(0)
    for c in range(3):
        point = base + patterns.indices[3 * t + c]
        u += np.int64(patterns.uv[0, point] * np.float32(ONE))
        v += np.int64(patterns.uv[1, point] * np.float32(ONE))
    return low_u <= u and u < high_u and low_v <= v and v < high_v


@helper
def _limits(cell):
    """(low u, high u, low v, high v) of a cell in fixed point times 3, exclusive at the top; 1 belongs to the last cell."""
    low_u, high_u = np.int64(cell[0] * (3 * ONE)), np.int64(cell[1] * (3 * ONE))
    low_v, high_v = np.int64(cell[2] * (3 * ONE)), np.int64(cell[3] * (3 * ONE))
    return low_u, high_u + (cell[1] == 1.0), low_v, high_v + (cell[3] == 1.0)


@kernel
def _measure(patterns, which, cell, triangles, points, reach, mark):
    """For each (pattern, cell): triangles owned, distinct points, and reach float64[n, 4] of these points in (u, v)."""
    for k in range(len(which)):
        base = patterns.first_point[which[k]]
        low_u, high_u, low_v, high_v = _limits(cell[k])
        triangles[k], points[k] = 0, 0
        reach[k, 0], reach[k, 1], reach[k, 2], reach[k, 3] = 1.0, 0.0, 1.0, 0.0
        for t in range(patterns.first_triangle[which[k]], patterns.first_triangle[which[k] + 1]):
            if _owns(patterns, t, base, low_u, high_u, low_v, high_v):
                triangles[k] += 1
                for c in range(3):
                    local = patterns.indices[3 * t + c]
                    if mark[local] != k:
                        mark[local] = k
                        points[k] += 1
                        u, v = np.float64(patterns.uv[0, base + local]), np.float64(patterns.uv[1, base + local])
                        reach[k, 0], reach[k, 1] = min(reach[k, 0], u), max(reach[k, 1], u)
                        reach[k, 2], reach[k, 3] = min(reach[k, 2], v), max(reach[k, 3], v)


@kernel
def _fill(patterns, which, cell, first_point, first_triangle, uv, indices, original, mark, place):
    """Write the points and triangles of each (pattern, cell), both in the order of the whole pattern's triangles."""
    for k in range(len(which)):
        base = patterns.first_point[which[k]]
        low_u, high_u, low_v, high_v = _limits(cell[k])
        point, triangle = first_point[k], first_triangle[k]
        for t in range(patterns.first_triangle[which[k]], patterns.first_triangle[which[k] + 1]):
            if _owns(patterns, t, base, low_u, high_u, low_v, high_v):
                for c in range(3):
                    local = patterns.indices[3 * t + c]
                    if mark[local] != k:
                        mark[local], place[local] = k, point - first_point[k]
                        uv[0, point], uv[1, point] = patterns.uv[0, base + local], patterns.uv[1, base + local]
                        point += 1
                    indices[3 * triangle + c] = place[local]
                original[triangle] = t - patterns.first_triangle[which[k]]
                triangle += 1


def _most_points(patterns: Patterns) -> int:
    return int(np.diff(patterns.first_point).max(initial=0))


def _distinct(which: I32, cell: F64) -> tuple[I64, I64]:
    """Rows that stand for the distinct (pattern, cell) pairs, and for each row which of these it has."""
    # Sides of cells are multiples of 2^-6 or coarser, so this numbers them.
    code = np.rint(cell * 128).astype(np.int64) @ np.array([1, 1 << 8, 1 << 16, 1 << 24]) + (
        which.astype(np.int64) << 32
    )
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    return first, inverse


def _own(patterns: Patterns, which: I32, cell: F64) -> tuple[I64, F64]:
    """Triangles owned by each (pattern, cell), int64[n], and the reach of their corners, float64[n, 4]."""
    first, inverse = _distinct(which, cell)
    n = len(first)
    triangles, points, reach = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 4))
    mark = np.full(_most_points(patterns), -1, np.int64)
    _measure(patterns, which[first], cell[first], triangles, points, reach, mark)
    return triangles[inverse], reach[inverse]


def _bound_parts(stage: HullInput, patterns: Patterns, patch: I32, cell: F64, machine: Machine) -> tuple[Parts, I64]:
    """Parts that own a triangle, bounded and tested; and how many triangles each owns."""
    triangles, reach = _own(patterns, patterns.of_patch[patch], cell)
    some = triangles > 0
    patch, cell, reach = patch[some], cell[some], reach[some]
    part_stage = gather_parts(stage, patch, reach)
    bounds = BOUNDS[machine.bounds](part_stage)
    flags = np.zeros(len(patch), np.uint8)
    for name in machine.cull:
        if name in PART_CULLS:
            CULL_TESTS[name](part_stage, bounds, flags)
    return Parts(patch, cell, bounds, (flags != 0).astype(np.uint8)), triangles[some]


def _wishes(parts: Parts, triangles: I64, machine: Machine) -> tuple[U8, I64]:
    """Which parts should be split, and the pixels of their rectangles."""
    rect = parts.bounds.rect.astype(np.int64)
    size = rect[:, 2:] - rect[:, :2]
    tile_log2 = machine.tile.bit_length() - 1
    tiles = ((rect[:, 2:] - 1) >> tile_log2) - (rect[:, :2] >> tile_log2) + 1
    side = np.maximum(parts.cell[:, 1] - parts.cell[:, 0], parts.cell[:, 3] - parts.cell[:, 2])
    wish = (size.max(axis=1) > machine.subpatch_extent) & (tiles.prod(axis=1) > 1) & (parts.culled == 0)
    return (wish & (triangles > 2) & (side > MIN_SIDE)).astype(np.uint8), size.prod(axis=1)


def split_parts(
    stage: HullInput, bounds: PatchBounds, patterns: Patterns, live: I32, machine: Machine
) -> tuple[Parts, int]:
    """Split the live patches; the leaves ordered by patch, then by u0, then by v0, and how many bounds that took.

    A patch that is not split is one part: the whole cell, with the patch's bound.
    """
    lengths = side_lengths(stage.patches)
    whole = np.tile([0.0, 1.0, 0.0, 1.0], (len(live), 1))
    parts = Parts(live, whole, take_bounds(bounds, live), np.zeros(len(live), np.uint8))
    triangles = np.diff(patterns.first_triangle)[patterns.of_patch[live]]
    count = np.zeros(len(stage.patches.control_points), np.int64)  # leaves of each patch
    count[live] = 1
    bounded, done = 0, [parts.take(np.empty(0, np.int64))]
    while len(parts.patch):
        wish, pixels = _wishes(parts, triangles, machine)
        # Of each patch as many of the largest as the budget has room for, each split adding one.
        order = np.lexsort((parts.cell[:, 2], parts.cell[:, 0], -pixels, parts.patch))
        order = order[wish[order] == 1]
        patch = parts.patch[order]
        place = np.arange(len(patch)) - np.searchsorted(patch, patch)
        chosen = order[place < (machine.subpatch_budget - count[patch])]
        stays = np.ones(len(parts.patch), bool)
        stays[chosen] = False
        done.append(parts.take(np.flatnonzero(stays)))
        chosen = np.sort(chosen)
        patch = parts.patch[chosen]
        halves = split_domains(parts.cell[chosen], lengths[patch], MIN_SIDE).reshape(-1, 4)
        np.add.at(count, patch, -1)
        parts, triangles = _bound_parts(stage, patterns, np.repeat(patch, 2), halves, machine)
        np.add.at(count, parts.patch, 1)
        bounded += len(parts.patch)
    leaves = Parts(
        np.concatenate([d.patch for d in done]),
        np.concatenate([d.cell for d in done]),
        PatchBounds(*(np.concatenate(arrays) for arrays in zip(*(d.bounds for d in done), strict=True))),
        np.concatenate([d.culled for d in done]),
    )
    return leaves.take(np.lexsort((leaves.cell[:, 2], leaves.cell[:, 0], leaves.patch))), bounded


def part_patterns(patterns: Patterns, which: I32, cell: F64) -> tuple[Patterns, I32]:
    """Patterns of parts: the points and triangles of each (pattern, cell), and the triangles' numbers in the whole pattern."""
    first, inverse = _distinct(which, cell)
    n, which, cell = len(first), which[first], cell[first]
    triangles, points, reach = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 4))
    _measure(patterns, which, cell, triangles, points, reach, np.full(_most_points(patterns), -1, np.int64))
    first_point = np.concatenate([[0], np.cumsum(points)])
    first_triangle = np.concatenate([[0], np.cumsum(triangles)])
    uv = np.empty((2, int(first_point[-1])), np.float32)
    indices = np.empty(3 * int(first_triangle[-1]), np.uint16)
    original = np.empty(int(first_triangle[-1]), np.int32)
    mark = np.full(_most_points(patterns), -1, np.int64)
    place = np.empty(len(mark), np.uint16)
    _fill(patterns, which, cell, first_point, first_triangle, uv, indices, original, mark, place)
    return Patterns(inverse.astype(np.int32), uv, first_point, indices, first_triangle), original


def split_rules(machine: Machine) -> Machine:
    """The machine with nothing but what decides how patches are cut; all else by default."""
    return Machine(
        tile=machine.tile,
        bounds=machine.bounds,
        cull=tuple(name for name in machine.cull if name in PART_CULLS),
        subpatch_budget=machine.subpatch_budget,
        subpatch_extent=machine.subpatch_extent,
    )


def split_patches(stage: HullInput, bounds: PatchBounds, patterns: Patterns, live: I32, machine: Machine) -> Split:
    """Cut the live patches of a frame into sub-domains by the machine's budget.

    stage, bounds, patterns : of whole patches.
    """
    parts, bounded = split_parts(stage, bounds, patterns, live, machine)
    parts_patterns, original = part_patterns(patterns, patterns.of_patch[parts.patch], parts.cell)
    units = Units(
        stage.patches.take(parts.patch), parts.patch, parts.cell, parts.bounds, parts_patterns, original
    )  # fmt: skip
    alive = np.flatnonzero(parts.culled == 0).astype(np.int32)
    return Split(units, alive, bounded, int(parts.culled.sum()))
