"""Whether a tessellated, displaced mesh is closed: every edge of two patches, point by point: `tiler validate watertight`.

Edges of subdivision surfaces are those of the mesh, edges of patch sets those whose control points are the same, bit for
bit, in one object. Both sides must put the same points on an edge, at the same places of clip space, bit for bit. A seam is
an edge along which a displaced surface has two sets of texture coordinates: it may be open where the object keeps its
seams. An edge that is open and no such seam is a failure. How wide open is measured in world space, at points with the
same parameter on both sides.

Edges of no length (all control points the same, as at a pole) are not looked at. Where an adaptively refined mesh changes
its level, an edge of one patch lies along two others: how wide it cracks is measured (levels.py) and told, and no failure.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pipeline.silhouette import edges_and_directions
from pipeline.tessellator import make_patterns
from pipeline.types import B1, F32, F64, I32, I64, Patches, Patterns, Viewport
from tiler import front_end
from tiler.host import Host, available_threads
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene, Tessellation
from tiler.validation.levels import LevelEdges, level_cracks, level_edges
from tiler.validation.tally import KEPT

Progress = Callable[[float], None]

ENDS = np.array([[0, 2], [0, 1], [1, 3], [2, 3]])  # texture corners at the ends of the edges u=0, v=0, u=1, v=1
PARTITIONINGS = ("integer", "pow2", "fractional_odd", "fractional_even")
FACTORS = (1.0, 2.5, 7.0, 16.0)


class Sides(NamedTuple):
    """Pairs of patches that share an edge: the lowest patch at it, and another."""

    patch: I32  # (n, 2)
    side: I32  # (n, 2) in SV_TessFactor order
    turned: B1  # (n, 2) the edge runs against u or v
    seam: B1  # (n,) displaced by two sets of texture coordinates
    may_open: B1  # (n,) a seam, and nothing closes it
    boundaries: int  # edges of one patch


class Found(NamedTuple):
    """What one tessellation showed, of n pairs."""

    open: B1  # (n,)
    crack: F64  # (n,) world units
    position: F64  # (n, 3) of the widest place on the first side
    level_crack: float  # the widest where a mesh changes its level


def settings_of(scene: Scene, given: bool) -> list[Tessellation]:
    """The scene's own tessellation where its factors are given; else factors of several kinds in every partitioning."""
    if given:
        return [scene.tessellation]
    policies = [Tessellation(factor=(f,) * 6) for f in FACTORS]
    policies.append(Tessellation(edge_pixels=8.0, silhouette=4.0))
    return [replace(policy, partitioning=p) for p in PARTITIONINGS for policy in policies]  # type: ignore[arg-type]


def validate_watertight(
    scene: Scene,
    settings: Sequence[Tessellation],
    *,
    number: float = 0,
    threads: int | None = None,
    progress: Progress = lambda done: None,
) -> dict[str, Any]:
    """The JSON object of `tiler validate watertight`; a case is a pair of patches at an edge, at one of the settings.

    `details` has the widest cracks, those that are failures first; the counts beside it are of pairs at the worst setting.
    """
    patches = front_end.run_vertex_shader(scene, number)
    sides, levels = pair_sides(scene, patches), level_edges(scene, patches)
    level_crack = 0.0
    diagonal = _diagonal(patches)
    worst, opened, failed, rows = np.zeros(len(sides.seam)), np.zeros(len(sides.seam), bool), 0, []
    with Host(available_threads() if threads is None else threads) as host:
        for k, policy in enumerate(settings):
            found = check_sides(replace(scene, tessellation=policy), patches, sides, levels, number, host)
            level_crack = max(level_crack, found.level_crack)
            wrong = found.open & ~sides.may_open
            failed += int(wrong.sum())
            worst, opened = np.maximum(worst, found.crack), opened | found.open
            order = np.lexsort((-found.crack, ~wrong))[:KEPT]
            rows += [_row(patches, sides, found, i, policy, diagonal) for i in order if found.open[i]]
            progress(k + 1)
    rows.sort(key=lambda row: (not row["failure"], -row["crack"]))
    return {
        "what": "watertight",
        "cases": len(sides.seam) * len(settings),
        "failed": failed,
        "details": rows[:KEPT],
        "scene": scene.name,
        "edges": len(sides.seam),
        "boundary_edges": sides.boundaries
        - len(levels.start)
        - len(np.unique(levels.patch[:, 0] * 4 + levels.side[:, 0])),
        "level_edges": len(levels.start),
        "largest_level_crack": level_crack,
        "seams": int(sides.seam.sum()),
        "open_edges": int((opened & ~sides.seam).sum()),
        "open_seams": int((opened & sides.seam).sum()),
        "largest_crack": float(worst.max(initial=0.0)),
        "largest_relative": float(worst.max(initial=0.0) / diagonal) if diagonal > 0 else 0.0,
        "mean_seam_crack": float(worst[sides.seam].mean()) if sides.seam.any() else 0.0,
        "diagonal": diagonal,
    }


def pair_sides(scene: Scene, patches: Patches) -> Sides:
    """All pairs of patches that share an edge, from the meshes of the scene and from equal control points."""
    number, turned = edges_and_directions(patches.control_points)
    keeps = np.zeros(len(scene.transforms), bool)
    base = int(number.max(initial=-1)) + 1
    number = number.astype(np.int64)
    for mesh in scene.meshes:
        rows = np.flatnonzero(patches.object_id == mesh.object_id)
        edge = mesh.surface.edge_row
        number[rows], turned[rows] = np.where(edge >= 0, edge, ~edge) + base, edge < 0
        base += mesh.surface.num_edges
        keeps[mesh.object_id] = mesh.seams == "keep"
    for k in set(range(len(keeps))) - {mesh.object_id for mesh in scene.meshes}:
        keeps[k] = True
    # Half-edges by edge and object, in the order of patches.
    points = np.stack([patches.control_points[:, 0], patches.control_points[:, :, 0], patches.control_points[:, 3],
                       patches.control_points[:, :, 3]], axis=1)  # fmt: skip
    real = (points != points[:, :, :1]).any(axis=(2, 3)).ravel()
    half = np.flatnonzero(real)
    key = number.ravel()[half] * len(scene.transforms) + patches.object_id[half // 4]
    order = np.argsort(key, kind="stable")
    half, key = half[order], key[order]
    new = np.append(True, key[1:] != key[:-1]) if len(key) else np.zeros(0, bool)
    first = np.maximum.accumulate(np.where(new, np.arange(len(key)), 0))
    other = np.flatnonzero(~new)
    pair = np.stack([half[first[other]], half[other]], axis=1)
    patch, side = (pair // 4).astype(np.int32), (pair % 4).astype(np.int32)
    turns = turned.reshape(-1)[pair]
    ends = patches.texcoords[patch[..., None], ENDS[side]]  # (n, 2, 2, 2)
    ends = np.where(turns[..., None, None], ends[:, :, ::-1], ends)
    seam = (ends[:, 0] != ends[:, 1]).any(axis=(1, 2)) & (patches.map_id[patch] >= 0).any(axis=1)
    alone = int(new.sum()) - len(np.unique(first[other]))
    return Sides(patch, side, turns, seam, seam & keeps[patches.object_id[patch[:, 0]]], alone)


def check_sides(scene: Scene, patches: Patches, sides: Sides, levels: LevelEdges, number: float, host: Host) -> Found:
    """Tessellate as the scene says, shade the points on edges, and compare both sides of each pair."""
    viewport = Viewport(0, 0, scene.picture.width, scene.picture.height, 0.0, 1.0)
    camera = camera_at(scene.camera, number, viewport.width / viewport.height)
    packed = front_end.scene_maps(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.raise_silhouettes(scene, front_end.hull_input(scene, patches, packed, factors, camera, viewport))
    patterns = _on_edges(make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING))
    live = np.arange(len(patches.map_id), dtype=np.int32)
    clip = front_end.shade_domain_points(live, patches, patterns, packed.maps, camera, host)
    identity = camera._replace(clip_from_world=np.eye(4, dtype=np.float32))
    world = front_end.shade_domain_points(live, patches, patterns, packed.maps, identity, host).clip[:3]
    runs = _points_of_sides(patterns, clip.first, levels)
    level_crack = float(level_cracks(levels, world, *runs).max(initial=0.0))
    start, count, point, t = _points_of_sides(patterns, clip.first, sides)
    same_count = count[:, 0] == count[:, 1]
    opened, crack = ~same_count, np.zeros(len(sides.seam))
    widest = np.zeros(len(sides.seam), np.int64)
    rows = np.flatnonzero(same_count & (count[:, 0] > 0))
    if len(rows):
        n, within = count[rows, 0], _ramp(count[rows, 0])
        at = [np.repeat(start[rows, k], n) + within for k in (0, 1)]
        bits = [(clip.clip[:, point[a]] + np.float32(0.0)).view(np.uint32) for a in at]  # + 0 makes -0 a +0
        differs = (bits[0] != bits[1]).any(axis=0) | (t[at[0]] != t[at[1]])
        first = np.cumsum(n) - n
        opened[rows] = np.logical_or.reduceat(differs, first)
        gap = _distance(world, point[at[0]], point[at[1]])
        crack[rows] = np.maximum.reduceat(gap, first)
        widest[rows] = [point[at[0][f + int(np.argmax(gap[f : f + c]))]] for f, c in zip(first, n, strict=True)]
    for i in np.flatnonzero(~same_count):  # at the points that both have
        a, b = (slice(start[i, k], start[i, k] + count[i, k]) for k in (0, 1))
        _, p, q = np.intersect1d(t[a], t[b], return_indices=True)
        gap = _distance(world, point[a][p], point[b][q])
        crack[i], widest[i] = gap.max(initial=0.0), point[a][p][int(np.argmax(gap))] if len(p) else 0
    return Found(opened, crack, world[:, widest].T.astype(np.float64), level_crack)


def _on_edges(patterns: Patterns) -> Patterns:
    """The patterns' points on edges, without triangles."""
    u, v = patterns.uv
    keep = (u == 0) | (u == 1) | (v == 0) | (v == 1)
    first = np.append(0, np.cumsum(keep))[patterns.first_point]
    nothing = np.zeros(len(patterns.first_triangle), np.int64)
    return Patterns(
        patterns.of_patch, np.ascontiguousarray(patterns.uv[:, keep]), first, np.zeros(0, np.uint16), nothing
    )


def _points_of_sides(patterns: Patterns, first: I64, sides: Sides | LevelEdges) -> tuple[I64, I64, I64, F32]:
    """Points of each side of each pair, in the edge's direction: start and count (n, 2) of runs in points and t."""
    patch, side, turned = sides.patch.ravel(), sides.side.ravel(), sides.turned.ravel()
    key = (patterns.of_patch[patch].astype(np.int64) * 4 + side) * 2 + turned
    kinds, kind = np.unique(key, return_inverse=True)
    local = [_local_points(patterns, int(k) >> 3, int(k) >> 1 & 3, bool(k & 1)) for k in kinds]
    sizes = np.array([len(points) for points, _ in local], np.int64)
    count = sizes[kind] if len(kind) else np.zeros(0, np.int64)
    start = np.cumsum(count) - count
    point, t = np.empty(int(count.sum()), np.int64), np.empty(int(count.sum()), np.float32)
    for k, (points, parameter) in enumerate(local):
        rows = np.flatnonzero(kind == k)
        to = start[rows, None] + np.arange(sizes[k])
        point[to], t[to] = first[patch[rows], None] + points, parameter
    return start.reshape(-1, 2), count.reshape(-1, 2), point, t


def _local_points(patterns: Patterns, pattern: int, side: int, turned: bool) -> tuple[I64, F32]:
    """Points of a pattern on one side, rising along the edge, and where on it each lies."""
    u, v = patterns.uv[:, patterns.first_point[pattern] : patterns.first_point[pattern + 1]]
    across, along = (u, v) if side % 2 == 0 else (v, u)
    points = np.flatnonzero(across == (0 if side < 2 else 1))
    t = np.float32(1.0) - along[points] if turned else along[points]
    order = np.argsort(t, kind="stable")
    return points[order], t[order]


def _distance(world: F32, a: I64, b: I64) -> F64:
    with np.errstate(all="ignore"):
        gap = np.linalg.norm(world[:, a].astype(np.float64) - world[:, b], axis=0)
    return np.nan_to_num(gap, nan=np.inf)


def _ramp(count: I64) -> I64:
    """0 .. c - 1 for each c, one after the other."""
    return np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)


def _diagonal(patches: Patches) -> float:
    with np.errstate(all="ignore"):
        points = patches.control_points[..., :3].astype(np.float64) / patches.control_points[..., 3:]
    points = points.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0


def _row(patches: Patches, sides: Sides, found: Found, i: int, policy: Tessellation, diagonal: float) -> dict[str, Any]:
    crack = float(found.crack[i])
    factor: Any = policy.factor[0] if len(set(policy.factor)) == 1 else list(policy.factor)
    return {
        "failure": bool(found.open[i] and not sides.may_open[i]),
        "object": int(patches.object_id[sides.patch[i, 0]]),
        "patches": sides.patch[i].tolist(),
        "edges": sides.side[i].tolist(),
        "seam": bool(sides.seam[i]),
        "crack": crack,
        "relative": crack / diagonal if diagonal > 0 else 0.0,
        "position": found.position[i].tolist(),
        "partitioning": policy.partitioning,
        "factor": factor if policy.edge_pixels is None else None,
        "edge_pixels": policy.edge_pixels,
    }
