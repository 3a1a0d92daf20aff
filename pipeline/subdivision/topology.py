"""Connectivity of a polygon mesh: half-edges, edges, and the ordered ring of faces around each vertex. Made once a mesh.

A half-edge has the number of its face corner: it runs from that corner's vertex to the next one of its face, face on its
left. Cracks in smoothness cut the rings: an infinitely sharp edge is to the limit masks what a boundary is, on both sides.
So a ring (a *sector* of a vertex) is closed, all around an interior vertex, or open, from one sharp edge to the next.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F32, I32, I64, U8

INFINITELY_SHARP = 10.0  # sharpness from which on a crease never becomes smooth, as in OpenSubdiv


class TopologyFault(ValueError):
    """Why a mesh is no surface with at most one boundary through each vertex; names face, edge or vertex by number."""


class VertexKind(IntEnum):
    """How the limit surface treats a vertex; a dart, where one sharp edge ends, is SMOOTH."""

    SMOOTH = 0
    CREASE = 1  # two sharp edges, a boundary's among them
    CORNER = 2  # kept in place


class Cage(NamedTuple):
    """A control mesh without its points."""

    num_vertices: int
    face_first: I32  # (F+1,) corners of face f are face_first[f]:face_first[f+1], counter-clockwise from outside
    face_vertices: I32  # (corners,)
    texcoords: F32  # (corners, 2)
    crease_edges: I32  # (E, 2) vertex pairs
    crease_sharpness: F32  # (E,)
    corner_vertices: I32  # (C,)
    corner_sharpness: F32  # (C,)
    keep_corners: bool  # boundary vertices of one face stay in place (EDGE_AND_CORNER)


class Topology(NamedTuple):
    """Half-edges of a cage; see the module's words."""

    face_first: I32  # (F+1,)
    vertex: I32  # (corners,) where the half-edge begins
    face: I32  # (corners,)
    next: I32  # (corners,) half-edge that follows in the face
    prev: I32  # (corners,)
    twin: I32  # (corners,) the half-edge on the other side, -1 at a boundary
    edge: I32  # (corners,)
    half_edges: I32  # (E, 2) of each edge; the first has the lower number, the second is -1 at a boundary
    edge_sharpness: F32  # (E,) infinite at a boundary
    vertex_sharpness: F32  # (V,) infinite where the vertex stays in place
    around_first: I64  # (V+1,) into around: the corners at each vertex, unordered
    around: I32  # (corners,)


class Rings(NamedTuple):
    """Sectors: the corners around a vertex in counter-clockwise order."""

    first: I64  # (sectors+1,)
    corner: I32  # (corners,)
    closed: U8  # (sectors,) 1: goes all around
    sector: I32  # (corners,) of each corner
    place: I32  # (corners,) of each corner in its sector
    kind: U8  # (V,) VertexKind


def make_topology(cage: Cage) -> tuple[Topology, tuple[str, ...]]:
    """Topology and warnings of a cage. Raises TopologyFault."""
    first, vertex = np.asarray(cage.face_first, np.int64), np.asarray(cage.face_vertices, np.int64)
    sizes, corners = np.diff(first), np.arange(len(vertex))
    _check_faces(cage.num_vertices, first, vertex, sizes)
    face = np.repeat(np.arange(len(sizes)), sizes)
    following, before = corners + 1, corners - 1
    following[first[1:] - 1], before[first[:-1]] = first[:-1], first[1:] - 1
    twin, edge, half_edges = _pair_half_edges(cage.num_vertices, vertex, following, face)
    around = np.argsort(vertex, kind="stable")
    around_first = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=cage.num_vertices))])
    edge_sharpness, vertex_sharpness, warnings = _sharpness(cage, vertex, following, half_edges, around_first)
    topology = Topology(
        face_first=first.astype(np.int32),
        vertex=vertex.astype(np.int32),
        face=face.astype(np.int32),
        next=following.astype(np.int32),
        prev=before.astype(np.int32),
        twin=twin.astype(np.int32),
        edge=edge.astype(np.int32),
        half_edges=half_edges.astype(np.int32),
        edge_sharpness=edge_sharpness,
        vertex_sharpness=vertex_sharpness,
        around_first=around_first.astype(np.int64),
        around=around.astype(np.int32),
    )
    bad = _find_second_fan(topology)
    if bad >= 0:
        raise TopologyFault(f"vertex {bad} joins two fans of faces that share no edge there; allowed: one fan of faces")
    return topology, (*_isolated(around_first), *warnings)


def make_rings(t: Topology) -> Rings:
    """Sectors of all vertices; infinitely sharp edges cut them, but for the one sharp edge of a dart."""
    sharp = t.edge_sharpness >= INFINITELY_SHARP
    ends = t.vertex[np.stack([t.half_edges[:, 0], t.next[t.half_edges[:, 0]]])]
    num_sharp = np.bincount(ends[:, sharp].ravel(), minlength=len(t.vertex_sharpness))
    kind = np.where(num_sharp >= 2, VertexKind.CREASE, VertexKind.SMOOTH)
    kind[(num_sharp >= 3) | (t.vertex_sharpness >= INFINITELY_SHARP)] = VertexKind.CORNER
    cut = np.where(sharp[t.edge] & (num_sharp >= 2)[t.vertex], -1, t.twin)  # leaving the vertex
    corners = len(t.vertex)
    first, corner = np.zeros(corners + 1, np.int64), np.empty(corners, np.int32)
    closed, sector, place = np.empty(corners, np.uint8), np.empty(corners, np.int32), np.empty(corners, np.int32)
    # The way on from a corner crosses the edge to the vertex before it: cut where that edge is cut.
    way = np.where(sharp[t.edge[t.prev]] & (num_sharp >= 2)[t.vertex], -1, t.twin[t.prev])
    count = _walk(
        t.around_first, t.around, cut.astype(np.int32), way.astype(np.int32), first, corner, closed, sector, place
    )
    return Rings(first[: count + 1].copy(), corner, closed[:count].copy(), sector, place, kind.astype(np.uint8))


def _check_faces(num_vertices: int, first: I64, vertex: I64, sizes: I64) -> None:
    if len(sizes) == 0:
        raise TopologyFault("the mesh has no face; allowed: at least one")
    if sizes.min() < 3:
        f = int(np.argmax(sizes < 3))
        raise TopologyFault(f"face {f} has {sizes[f]} vertices; allowed: 3 or more")
    outside = (vertex < 0) | (vertex >= num_vertices)
    if outside.any():
        c = int(np.argmax(outside))
        f = int(np.searchsorted(first, c, side="right")) - 1
        raise TopologyFault(f"face {f} names vertex {vertex[c]}; allowed: 0 to {num_vertices - 1}")
    key = np.repeat(np.arange(len(sizes)), sizes) * num_vertices + vertex
    key.sort()
    again = key[1:] == key[:-1]
    if again.any():
        f, v = divmod(int(key[1:][again][0]), num_vertices)
        raise TopologyFault(f"face {f} has vertex {v} twice; allowed: each vertex once")


def _pair_half_edges(num_vertices: int, start: I64, following: I64, face: I64) -> tuple[I64, I64, I64]:
    """Twin and edge of each half-edge, and the half-edges of each edge; edges are numbered by their two vertices."""
    end = start[following]
    low, high = np.minimum(start, end), np.maximum(start, end)
    _, edge, count = np.unique(low * num_vertices + high, return_inverse=True, return_counts=True)
    order = np.argsort(edge, kind="stable")
    begin = np.concatenate([[0], np.cumsum(count)[:-1]])
    if count.max() > 2:
        e = int(np.argmax(count > 2))
        faces = face[order[begin[e] : begin[e] + count[e]]].tolist()
        h = order[begin[e]]
        raise TopologyFault(f"edge ({low[h]}, {high[h]}) belongs to faces {faces}; allowed: one face or two")
    half_edges = np.full((len(count), 2), -1, np.int64)
    half_edges[:, 0] = order[begin]
    paired = count == 2
    half_edges[paired, 1] = order[begin[paired] + 1]
    h, g = half_edges[paired].T
    same = start[h] == start[g]
    if same.any():
        a, b = h[same][0], g[same][0]
        raise TopologyFault(
            f"faces {face[a]} and {face[b]} run along their edge ({start[a]}, {end[a]}) in the same direction: one of them "
            "is flipped; allowed: all faces counter-clockwise from outside"
        )
    twin = np.full(len(start), -1, np.int64)
    twin[h], twin[g] = g, h
    return twin, edge, half_edges


def _sharpness(
    cage: Cage, start: I64, following: I64, half_edges: I64, around_first: I64
) -> tuple[F32, F32, tuple[str, ...]]:
    """Sharpness of edges and vertices, and warnings of creases that lie on no edge."""
    n, warnings = cage.num_vertices, []
    edge_sharpness = np.zeros(len(half_edges), np.float32)
    ends = start[np.stack([half_edges[:, 0], following[half_edges[:, 0]]])]
    keys = ends.min(0) * n + ends.max(0)  # sorted: edges are numbered by it
    creases = np.asarray(cage.crease_edges, np.int64).reshape(-1, 2)
    if len(creases):
        wanted = creases.min(1) * n + creases.max(1)
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        found = (keys[at] == wanted) & (creases >= 0).all(1) & (creases < n).all(1)
        np.maximum.at(edge_sharpness, at[found], cage.crease_sharpness[found])
        if not found.all():
            a, b = creases[~found][0]
            warnings.append(f"{(~found).sum()} creases lie on no edge, the first on ({a}, {b}): left out")
    edge_sharpness[(half_edges[:, 1] < 0) | (edge_sharpness >= INFINITELY_SHARP)] = np.inf
    vertex_sharpness = np.zeros(n, np.float32)
    inside = (cage.corner_vertices >= 0) & (cage.corner_vertices < n)
    np.maximum.at(vertex_sharpness, cage.corner_vertices[inside], cage.corner_sharpness[inside])
    if not inside.all():
        first = cage.corner_vertices[~inside][0]
        warnings.append(f"{(~inside).sum()} corner tags name no vertex, the first {first}: left out")
    vertex_sharpness[vertex_sharpness >= INFINITELY_SHARP] = np.inf
    if cage.keep_corners:
        at_boundary = np.zeros(n, bool)
        at_boundary[ends[:, half_edges[:, 1] < 0]] = True
        vertex_sharpness[at_boundary & (np.diff(around_first) == 1)] = np.inf
    return edge_sharpness, vertex_sharpness, tuple(warnings)


def _isolated(around_first: I64) -> tuple[str, ...]:
    alone = np.flatnonzero(np.diff(around_first) == 0)
    if len(alone) == 0:
        return ()
    return (f"{len(alone)} vertices belong to no face, the first is {alone[0]}: dropped",)


@helper
def _count_fan(around, begin, end, twin, prev):
    """Corners in the fan of a vertex that holds the first boundary, or the first corner."""
    start = around[begin]
    for k in range(begin, end):
        if twin[around[k]] < 0:
            start = around[k]
            break
    count, corner = 1, twin[prev[start]]
    while corner >= 0 and corner != start and count <= end - begin:
        count += 1
        corner = twin[prev[corner]]
    return count


@kernel
def _second_fan(around_first, around, twin, prev):
    for v in range(len(around_first) - 1):
        begin, end = around_first[v], around_first[v + 1]
        if begin < end and _count_fan(around, begin, end, twin, prev) != end - begin:
            return v
    return -1


def _find_second_fan(t: Topology) -> int:
    """The first vertex whose faces are not one fan; -1 where there is none."""
    return int(_second_fan(t.around_first, t.around, t.twin, t.prev))


@kernel
def _walk(around_first, around, cut, way, first, corner, closed, sector, place):
    """Write all sectors; their number. cut : -1 where a corner begins an open sector. way : the next corner of the ring."""
    count, at = 0, 0
    for v in range(len(around_first) - 1):
        begin, end = around_first[v], around_first[v + 1]
        num_open = 0
        for k in range(begin, end):
            num_open += cut[around[k]] < 0
        for k in range(begin, end):
            c = around[k]
            if cut[c] >= 0 and (num_open > 0 or k > begin):
                continue
            closed[count] = num_open == 0
            start = c
            while True:
                corner[at], sector[c], place[c] = c, count, at - first[count]
                at += 1
                c = way[c]
                if c < 0 or c == start:
                    break
            count += 1
            first[count] = at
    return count
