"""A cage of quads under construction: faces are pulled out into limbs, and a Catmull-Clark step makes the whole finer.

Everything is +, -, * and / on float64 in a fixed order, so the same cage comes out on every machine.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.types import F64, I64

Uv = tuple[float, float]


class Cage:
    """A closed mesh of quads, counter-clockwise from outside.

    points : one row a vertex: x, y, z, and then whatever else belongs to a vertex (bone weights); all of it is refined alike.
    faces, texcoords : four vertices, and their four (s, t), for each face.
    """

    def __init__(self) -> None:
        self.points: list[F64] = []
        self.faces: list[tuple[int, ...]] = []
        self.texcoords: list[tuple[Uv, ...]] = []

    def add_ring(self, rows: F64) -> list[int]:
        """New vertices; their numbers."""
        first = len(self.points)
        self.points += list(np.asarray(rows, np.float64))
        return list(range(first, len(self.points)))

    def add_face(self, vertices: Sequence[int], texcoords: Sequence[Uv]) -> int:
        """A new face; its number."""
        self.faces.append(tuple(vertices))
        self.texcoords.append(tuple(texcoords))
        return len(self.faces) - 1

    def extrude(
        self, face: int, rows: F64, sides: Sequence[Sequence[Uv]] | None = None, inset: float = 0.6
    ) -> list[int]:
        """Pull a face out: it moves to new vertices (4, c), and four faces join their ring to the old one.

        sides : texture coordinates of the new faces (old a, old b, new b, new a) and of the moved one. Without them the
        moved face's shrink about their middle, the new faces fill the frame, and there is no seam.
        Returns the four new faces; number j is at the edge from corner j to corner j + 1 of the old face.
        """
        old, old_uv = self.faces[face], self.texcoords[face]
        new = self.add_ring(rows)
        if sides is None:
            middle = tuple(sum(uv[k] for uv in old_uv) / 4 for k in range(2))
            inner = [(m + inset * (s - m), n + inset * (t - n)) for s, t in old_uv for m, n in [middle]]
            sides = [(old_uv[j], old_uv[(j + 1) % 4], inner[(j + 1) % 4], inner[j]) for j in range(4)] + [inner]
        self.faces[face], self.texcoords[face] = tuple(new), tuple(sides[4])
        ends = [(j, (j + 1) % 4) for j in range(4)]
        return [self.add_face((old[a], old[b], new[b], new[a]), sides[a]) for a, b in ends]

    def corners(self, face: int) -> F64:
        """Rows (4, c) of a face's vertices."""
        return np.array([self.points[v] for v in self.faces[face]])


def strip_texcoords(rings: F64, origin: Uv, scale: float, middle: int | None = None) -> list[list[Uv]]:
    """Texture coordinates [ring][n + 1] of a tube cut open along vertex 0 of its rings and laid flat.

    rings : (r, n, 3). s runs along the tube and t around it, both in lengths times `scale`, rounded to multiples of
    2^-10; the point half way between vertices `middle` and `middle` + 1 (or half way around) is at t = origin[1].
    """
    around = np.concatenate([rings, rings[:, :1]], axis=1)
    steps = _lengths(around[:, 1:] - around[:, :-1])
    arc = np.concatenate([np.zeros((len(rings), 1)), np.cumsum(steps, axis=1)], axis=1)
    centres = rings.sum(axis=1) / rings.shape[1]
    along = np.concatenate([[0.0], np.cumsum(_lengths(centres[1:] - centres[:-1]))])
    zero = arc[:, -1] / 2 if middle is None else (arc[:, middle] + arc[:, middle + 1]) / 2
    s = np.rint((origin[0] + scale * along) * 1024) / 1024
    t = np.rint((origin[1] + scale * (arc - zero[:, None])) * 1024) / 1024
    return [[(float(s[r]), float(x)) for x in t[r]] for r in range(len(rings))]


def _lengths(vectors: F64) -> F64:
    squares = vectors * vectors
    return np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])


def refine(points: F64, faces: I64, texcoords: F64) -> tuple[F64, I64, F64]:
    """One Catmull-Clark step of a closed mesh of quads.

    points (V, c), faces (F, 4), texcoords (F, 4, 2), which refine linearly. Quad k of a face keeps its corner k first.
    """
    count = len(points)
    tail, head = faces, np.roll(faces, -1, axis=1)
    key, edge = np.unique(np.minimum(tail, head) * count + np.maximum(tail, head), return_inverse=True)
    edge = edge.reshape(faces.shape)
    ends = np.stack([key // count, key % count], axis=1)
    face_points = _mean4(points[faces])
    middles = (points[ends[:, 0]] + points[ends[:, 1]]) / 2
    beside = _summed(edge.ravel(), np.repeat(face_points, 4, axis=0), len(key))
    edge_points = (points[ends[:, 0]] + points[ends[:, 1]] + beside) / 4
    valence = np.bincount(faces.ravel(), minlength=count)[:, None].astype(np.float64)
    mean_faces = _summed(faces.ravel(), np.repeat(face_points, 4, axis=0), count) / valence
    mean_middles = _summed(ends.ravel(), np.repeat(middles, 2, axis=0), count) / valence
    vertex_points = (mean_faces + 2 * mean_middles + (valence - 3) * points) / valence
    centre = np.arange(len(faces))[:, None] + count + len(key)
    after, before = edge + count, np.roll(edge, 1, axis=1) + count
    quads = np.stack([faces, after, np.broadcast_to(centre, faces.shape), before], axis=2).reshape(-1, 4)
    return np.concatenate([vertex_points, edge_points, face_points]), quads, _refined_texcoords(texcoords)


def _refined_texcoords(texcoords: F64) -> F64:
    after = (texcoords + np.roll(texcoords, -1, axis=1)) / 2
    centre = np.broadcast_to(_mean4(texcoords)[:, None], texcoords.shape)
    return np.stack([texcoords, after, centre, np.roll(after, 1, axis=1)], axis=2).reshape(-1, 4, 2)


def _mean4(rows: F64) -> F64:
    return (rows[:, 0] + rows[:, 1] + rows[:, 2] + rows[:, 3]) / 4


def _summed(index: I64, rows: F64, count: int) -> F64:
    """Sums of rows by index, each added in the order of the rows."""
    total = np.zeros((count, rows.shape[1]))
    np.add.at(total, index, rows)
    return total


def pulled(corners: F64, offset: Sequence[float], scale: float) -> F64:
    """Rows of a face (4, c) moved by `offset` and shrunk about their middle; what is beyond x, y, z stays."""
    moved = corners.copy()
    middle = _mean4(corners[None])[0]
    moved[:, :3] = middle[:3] + scale * (corners[:, :3] - middle[:3]) + np.asarray(offset)
    return moved
