"""One Catmull-Clark step: the finer cage, made once, and a `Step` that moves the finer points whenever the coarse ones move.

Spec section 2; creases and corners by DeRose, Kass, Truong 1998 as OpenSubdiv has them: sharpness falls by 1 with each
step, an edge of sharpness below 1 blends both rules, and a vertex whose rule changes in this step blends the rules before
and after by the sharpness that is used up.

Fine vertices are the coarse ones, then one an edge, then one a face. The fine face of half-edge h has number h: (its
vertex, the point of its edge, the face's point, the point of the edge before).
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.subdivision.topology import INFINITELY_SHARP, Cage, Topology
from pipeline.types import F32, F64, I32, I64


class Step(NamedTuple):
    """How one step moves points: plain arrays for the kernel."""

    face_first: I32  # (F+1,)
    vertex: I32  # (corners,)
    face: I32  # (corners,)
    next: I32  # (corners,)
    around_first: I64  # (V+1,)
    around: I32  # (corners,)
    edge_ends: I32  # (E, 2)
    edge_faces: I32  # (E, 2) the second is -1 at a boundary
    edge_crease: F64  # (E,) weight of the crease rule; the smooth one has the rest
    crease_ends: I32  # (V, 2) where the crease rule of a vertex looks; -1 unused
    vertex_crease: F64  # (V,) weight of the crease rule
    vertex_corner: F64  # (V,) weight of the corner rule; the smooth rule has the rest


def make_step(t: Topology) -> Step:
    """The step of a topology."""
    a, b = t.half_edges.T
    ends = np.stack([t.vertex[a], t.vertex[t.next[a]]], 1)
    edge_faces = np.stack([t.face[a], np.where(b < 0, -1, t.face[b])], 1).astype(np.int32)
    crease_ends, vertex_crease, vertex_corner = _vertex_rules(t, ends)
    return Step(
        t.face_first,
        t.vertex,
        t.face,
        t.next,
        t.around_first,
        t.around,
        ends.astype(np.int32),
        edge_faces,
        np.minimum(t.edge_sharpness, 1.0).astype(np.float64),
        crease_ends,
        vertex_crease,
        vertex_corner,
    )


def _vertex_rules(t: Topology, ends: I32) -> tuple[I32, F64, F64]:
    """Ends of each vertex's crease, and the weights of the crease and the corner rule."""
    n = len(t.vertex_sharpness)
    before, after = t.edge_sharpness, t.edge_sharpness - np.float32(1)  # infinity stays
    num_before, num_after = (np.bincount(ends[s > 0].ravel(), minlength=n) for s in (before, after))
    parent = _rule(num_before, t.vertex_sharpness)
    child = _rule(num_after, t.vertex_sharpness - np.float32(1))
    # The weight of the rule before: the mean of the sharpness that ends in this step.
    ending = (before > 0) & (after <= 0)
    total, count = np.zeros(n), np.zeros(n)
    for side in (0, 1):
        np.add.at(total, ends[ending, side], before[ending])
        np.add.at(count, ends[ending, side], 1.0)
    ends_here = (t.vertex_sharpness > 0) & (t.vertex_sharpness <= 1)
    total[ends_here] += t.vertex_sharpness[ends_here]
    count[ends_here] += 1
    share = np.where(parent == child, 1.0, np.minimum(total / np.maximum(count, 1), 1.0))
    weight = [share * (parent == rule) + (1 - share) * (child == rule) for rule in (1, 2)]
    crease_ends = np.full((n, 2), -1, np.int32)
    for sharp, who in ((after, child == 1), (before, parent == 1)):  # the parent's where both have one
        edges = np.flatnonzero(sharp > 0)
        near, far = ends[edges].ravel(), ends[edges][:, ::-1].ravel()
        order = np.argsort(near, kind="stable")
        near, far = near[order], far[order]
        chosen = who[near]
        crease_ends[np.flatnonzero(who)] = far[chosen].reshape(-1, 2)
    return crease_ends, *weight


def _rule(num_sharp: I64, sharpness: F32) -> I64:
    """0 smooth or dart, 1 crease, 2 corner."""
    return np.where((sharpness > 0) | (num_sharp >= 3), 2, np.where(num_sharp == 2, 1, 0))


def refine_cage(cage: Cage, t: Topology) -> Cage:
    """The cage after one step. Texture coordinates are means within each face, so seams stay."""
    num_vertices, num_edges = len(t.vertex_sharpness), len(t.edge_sharpness)
    corners = np.arange(len(t.vertex))
    at_edge = num_vertices + t.edge
    at_face = num_vertices + num_edges + t.face
    quads = np.stack([t.vertex, at_edge[corners], at_face, at_edge[t.prev]], 1)
    own = cage.texcoords
    middle = (own + own[t.next]) * np.float32(0.5)
    sizes = np.diff(t.face_first).astype(np.float32)
    centre = (np.add.reduceat(own.astype(np.float64), t.face_first[:-1]) / sizes[:, None]).astype(np.float32)
    texcoords = np.stack([own, middle, centre[t.face], middle[t.prev]], 1)
    sharp = np.flatnonzero((t.edge_sharpness > 1) & (t.half_edges[:, 1] >= 0))
    a = t.half_edges[sharp, 0]
    point = num_vertices + sharp
    creases = np.concatenate([np.stack([t.vertex[a], point], 1), np.stack([point, t.vertex[t.next[a]]], 1)])
    pinned = np.flatnonzero(t.vertex_sharpness > 1)
    return Cage(
        num_vertices + num_edges + len(t.face_first) - 1,
        np.arange(0, 4 * len(corners) + 1, 4, dtype=np.int32),
        quads.astype(np.int32).ravel(),
        texcoords.reshape(-1, 2),
        creases.astype(np.int32),
        np.tile(t.edge_sharpness[sharp] - np.float32(1), 2),
        pinned.astype(np.int32),
        t.vertex_sharpness[pinned] - np.float32(1),
        cage.keep_corners,
    )


def needs_step(t: Topology) -> bool:
    """Whether some edge or vertex is semi-sharp."""
    return any(bool(((s > 0) & (s < INFINITELY_SHARP)).any()) for s in (t.edge_sharpness, t.vertex_sharpness))


@helper
def _smooth_point(step, points, faces, v, c):
    """Coordinate c of an interior vertex: (Q + 2 R + (n - 3) v) / n."""
    begin, end = step.around_first[v], step.around_first[v + 1]
    n = end - begin
    face_sum, edge_sum = 0.0, 0.0
    for k in range(begin, end):
        corner = step.around[k]
        face_sum += faces[step.face[corner], c]
        edge_sum += points[step.vertex[step.next[corner]], c]
    return (face_sum / n + (edge_sum / n + points[v, c]) + (n - 3) * points[v, c]) / n


@kernel
def _move(step, points, out):
    num_vertices, num_edges = len(step.vertex_crease), len(step.edge_crease)
    faces = out[num_vertices + num_edges :]
    for f in range(len(faces)):
        begin, end = step.face_first[f], step.face_first[f + 1]
        for c in range(3):
            total = 0.0
            for k in range(begin, end):
                total += points[step.vertex[k], c]
            faces[f, c] = total / (end - begin)
    for e in range(num_edges):
        a, b = step.edge_ends[e]
        f, g = step.edge_faces[e]
        sharp = step.edge_crease[e]
        for c in range(3):
            ends = points[a, c] + points[b, c]
            point = 0.5 * ends
            if sharp < 1.0:
                point = sharp * point + (1.0 - sharp) * (0.25 * (ends + (faces[f, c] + faces[g, c])))
            out[num_vertices + e, c] = point
    for v in range(num_vertices):
        crease, corner = step.vertex_crease[v], step.vertex_corner[v]
        smooth = (1.0 - crease) - corner
        p, q = step.crease_ends[v]
        for c in range(3):
            point = corner * points[v, c]
            if crease > 0.0:
                point += crease * (0.125 * (points[p, c] + points[q, c]) + 0.75 * points[v, c])
            if smooth > 0.0 and step.around_first[v] < step.around_first[v + 1]:
                point += smooth * _smooth_point(step, points, faces, v, c)
            out[v, c] = point


def move_points(step: Step, points: F64) -> F64:
    """Points of the finer cage, float64[V', 3], of the coarser one's, float64[V, 3]."""
    out = np.empty((len(step.vertex_crease) + len(step.edge_crease) + len(step.face_first) - 1, 3))
    _move(step, points, out)
    return out
