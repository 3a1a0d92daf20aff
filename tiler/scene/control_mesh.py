"""What mesh files and mesh builders hand to the loader: the control mesh of one Catmull-Clark subdivision surface."""

from typing import Literal, NamedTuple

from pipeline.types import F32, F64, I32

Boundary = Literal["edge_only", "edge_and_corner"]


class Keys(NamedTuple):
    """Points of a mesh at frames of its own; they run linearly between."""

    frames: F64  # (K,) rising
    points: F32  # (K, V, 3)


class ControlMesh(NamedTuple):
    """A polygon mesh as its file has it; checked only as far as its arrays go together.

    Faces are counter-clockwise seen from outside. A face corner is one entry of `face_vertices`: face f owns those from
    face_first[f] to face_first[f + 1] - 1.
    """

    name: str
    vertices: F32  # (V, 3) object space
    face_first: I32  # (F+1,)
    face_vertices: I32  # (corners,) into vertices
    texcoords: F32  # (T, 2) (s, t), t upwards as stored; (0, 2) where the mesh has none
    face_texcoords: I32  # (corners,) into texcoords; all -1 where the mesh has none
    crease_edges: I32  # (E, 2) vertex pairs
    crease_sharpness: F32  # (E,) above 0; 10 and more is infinitely sharp
    corner_vertices: I32  # (C,)
    corner_sharpness: F32  # (C,)
    boundary: Boundary = "edge_and_corner"
    keys: Keys | None = None  # how its file moves its points
