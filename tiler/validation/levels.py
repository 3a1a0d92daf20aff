"""Where an adaptively refined mesh changes its level: one edge of a patch lies along two edges of smaller ones.

Both sides are the same cubic curve, but tessellated apart, so a vertex of one side may lie on no vertex of the other (a
T-junction). How far it then is from the other side's segment, in world space, is the width of the crack.
"""

from typing import NamedTuple

import numpy as np

from pipeline.subdivision.surface import Surface
from pipeline.types import B1, F32, F64, I32, I64, Patches
from tiler.scene.model import Scene


class LevelEdges(NamedTuple):
    """Pairs of patches: one before the step, and one of the two after it along one of its edges."""

    patch: I32  # (n, 2) the larger one first
    side: I32  # (n, 2) in SV_TessFactor order
    turned: B1  # (n, 2) the edge runs against u or v
    start: F64  # (n,) parameter of the larger one's edge where the smaller one's begins: 0, 0.5 or 1
    step: F64  # (n,) and how it runs on: 0.5 or -0.5


def level_edges(scene: Scene, patches: Patches) -> LevelEdges:
    """All pairs of a scene's meshes; none but of adaptive refinement."""
    found = [_of_surface(mesh.surface, np.flatnonzero(patches.object_id == mesh.object_id)) for mesh in scene.meshes]
    found = [part for part in found if part is not None]
    if not found:
        none = np.zeros((0, 2), np.int32)
        return LevelEdges(none, none, np.zeros((0, 2), bool), np.zeros(0), np.zeros(0))
    return LevelEdges(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _of_surface(surface: Surface, rows: np.ndarray) -> LevelEdges | None:
    """rows : the surface's patches in the scene."""
    if len(surface.layers) < 2:
        return None
    coarse, fine = surface.layers
    num_vertices, num_edges = len(coarse.position.first) - 1, len(coarse.ends)
    number, turned = np.where(surface.edge_row >= 0, surface.edge_row, ~surface.edge_row), surface.edge_row < 0
    half = np.full(num_edges, -1)  # the last half-edge of each edge before the step
    own = np.arange(4 * len(coarse.quad))
    half[number.ravel()[own]] = own
    # After the step vertices keep their numbers, and that of an edge follows: an edge's half ends in both kinds.
    child = 4 * len(coarse.quad) + np.arange(4 * len(fine.quad))
    ends = fine.ends[number.ravel()[child] - num_edges, :2]
    low, high = ends.min(axis=1), ends.max(axis=1)
    parent = high - num_vertices
    meets = (low < num_vertices) & (parent >= 0) & (parent < num_edges)
    meets[meets] = half[parent[meets]] >= 0
    child, ends, low, parent = child[meets], ends[meets], low[meets], parent[meets]
    end = np.where(coarse.ends[parent, 0] == low, 0.0, 1.0)  # of the edge before the step
    from_end = ends[:, 0] == low
    start = np.where(from_end, end, 0.5)
    step = np.where(from_end, 0.5 - end, end - 0.5)
    pair = np.stack([half[parent], child], axis=1)
    return LevelEdges(
        rows[pair // 4].astype(np.int32), (pair % 4).astype(np.int32), turned.reshape(-1)[pair], start, step
    )


def level_cracks(edges: LevelEdges, world: F32, start: I64, count: I64, point: I64, t: F32) -> F64:
    """Width of each pair's crack, float64[n].

    world : (3, N). start, count : (n, 2) runs of `point`, numbers into world, and of t, parameters along the sides' own edges.
    """
    width = np.zeros(len(edges.start))
    for i in range(len(width)):
        runs = [slice(start[i, k], start[i, k] + count[i, k]) for k in (0, 1)]
        places = [world[:, point[run]].T.astype(np.float64) for run in runs]
        large, small = t[runs[0]].astype(np.float64), edges.start[i] + edges.step[i] * t[runs[1]].astype(np.float64)
        order = np.argsort(small, kind="stable")
        small, places[1] = small[order], places[1][order]
        within = (large >= small[0]) & (large <= small[-1])
        width[i] = max(
            _distance(places[1], small, places[0], large), _distance(places[0][within], large[within], places[1], small)
        )
    return width


def _distance(points: F64, at: F64, line: F64, t: F64) -> float:
    """How far the farthest point, of parameter `at`, is from the segment of a line of vertices at t that it belongs to."""
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    a, along = line[k], line[k + 1] - line[k]
    with np.errstate(all="ignore"):
        square = (along**2).sum(axis=1)
        x = np.where(square > 0, ((points - a) * along).sum(axis=1) / square, 0.0)
        gap = np.linalg.norm(points - (a + np.clip(x, 0, 1)[:, None] * along), axis=1)
    return float(np.nan_to_num(gap, nan=np.inf).max(initial=0.0))
