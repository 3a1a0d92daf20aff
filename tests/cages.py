"""Control meshes for tests: those of the limit reference, OBJ models read the plainest way, and small ones made here."""

import numpy as np

from pipeline.subdivision.topology import Cage
from tests.shared_data import shared_file
from tiler.scene.control_mesh import ControlMesh

NONE = np.zeros(0, np.int32)


def cage_of_faces(faces, num_vertices, texcoords=None, keep_corners=True, creases=(), sharpness=(), corners=()):
    """Cage of lists of vertex numbers; corners are infinitely sharp."""
    first = np.cumsum([0, *map(len, faces)]).astype(np.int32)
    if texcoords is None:
        texcoords = np.zeros((first[-1], 2), np.float32)
    return Cage(
        num_vertices, first, np.concatenate(faces).astype(np.int32), np.asarray(texcoords, np.float32),
        np.array(creases, np.int32).reshape(-1, 2), np.array(sharpness, np.float32), np.array(corners, np.int32),
        np.full(len(corners), 10, np.float32), keep_corners,
    )  # fmt: skip


class Reference:
    """One model of the limit reference: its cage, points, and samples."""

    def __init__(self, name):
        arrays = np.load(shared_file("data", "catmull_clark_limit_reference.npz"))
        self.uv = arrays["uv"]
        for key in ("V", "P", "N", "Du", "Dv", "ptex", "vertex_limit", "vertex_normal"):
            setattr(self, key, arrays[f"{name}__{key}"])
        sizes = arrays[f"{name}__face_sizes"]
        first = np.cumsum([0, *sizes]).astype(np.int32)
        tags = [
            arrays[f"{name}__{key}"] for key in ("crease_edges", "crease_sharpness", "corner_verts", "corner_sharpness")
        ]
        self.cage = Cage(
            len(self.V), first, arrays[f"{name}__face_verts"], np.zeros((first[-1], 2), np.float32),
            tags[0].reshape(-1, 2), *tags[1:], keep_corners=int(arrays[f"{name}__boundary"]) == 2,
        )  # fmt: skip
        # With a polygon in it the mesh is refined once, and (face, k) is the quad of corner first[face] + k.
        quads = bool((sizes == 4).all())
        used = np.ones(len(self.ptex), bool) if quads else self.ptex[:, 1] >= 0
        self.ptex_rows = np.flatnonzero(used)
        face, k = self.ptex[used].T
        self.patch = face if quads else first[face] + k
        self.diagonal = float(np.linalg.norm(np.ptp(self.V, axis=0)))


def read_model(name):
    """Vertices and cage of `shared/data/models/NAME.obj`; texture coordinates as stored."""
    vertices, texcoords, faces, corners = [], [], [], []
    for line in shared_file("data", "models", f"{name}.obj").read_text().splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            vertices.append([float(w) for w in words[:3]])
        elif key == "vt":
            texcoords.append([float(w) for w in words[:2]])
        elif key == "f":
            numbers = [[int(n) if n else 0 for n in w.split("/")] for w in words]
            faces.append([n[0] - 1 for n in numbers])
            corners += [n[1] - 1 if len(n) > 1 else -1 for n in numbers]
    table = np.array([*texcoords, (0, 0)], np.float32)
    return np.array(vertices, np.float32), cage_of_faces(faces, len(vertices), table[corners])


def control_mesh(vertices, cage, name="made for a test"):
    """The same as mesh files give it, each face corner with a texture coordinate of its own."""
    return ControlMesh(
        name, np.asarray(vertices, np.float32), cage.face_first, cage.face_vertices, cage.texcoords,
        np.arange(len(cage.texcoords), dtype=np.int32), cage.crease_edges, cage.crease_sharpness, cage.corner_vertices,
        cage.corner_sharpness, "edge_and_corner" if cage.keep_corners else "edge_only",
    )  # fmt: skip


BOX_POINTS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
BOX_FACES = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6]]


def box(**tags):
    """A cube's points and cage, valence 3 everywhere, with the unit square as texture of each face."""
    square = np.tile(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32), (6, 1))
    return BOX_POINTS.copy(), cage_of_faces(BOX_FACES, 8, square, **tags)
