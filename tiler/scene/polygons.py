"""From the polygons of a file to its control meshes: vertices that no face has are dropped, odd values are told."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.types import F32, I32
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.obj_lines import Tags


class Polygons(NamedTuple):
    """Faces of one or several objects that share one list of vertices; indices were checked."""

    vertices: F32  # (V, 3)
    face_first: I32  # (F+1,)
    face_vertices: I32  # (corners,)
    texcoords: F32  # (T, 2)
    face_texcoords: I32  # (corners,), -1 where a corner has none


def split_objects(
    polygons: Polygons, object_of_face: np.ndarray, names: Sequence[str], tags: Tags
) -> tuple[list[ControlMesh], list[str]]:
    """One mesh for each object that has faces, in the order of their first faces, and warnings.

    object_of_face : (F,) index into names.
    """
    used = np.zeros(len(polygons.vertices), bool)
    used[polygons.face_vertices] = True
    warnings = []
    if not used.all():
        warnings.append(f"{_counted(~used, 'vertices', 'no face has them; dropped', 1)}")
    odd = used & ~np.isfinite(polygons.vertices).all(axis=1)
    if odd.any():
        warnings.append(_counted(odd, "vertices", "not finite; the patches around them will be culled", 1))
    bad = ~np.isfinite(polygons.texcoords).all(axis=1)
    if bad.any():
        warnings.append(_counted(bad, "texture coordinates", "not finite", 1))
    objects, at = np.unique(object_of_face, return_index=True)
    meshes = [_mesh_of(polygons, object_of_face == k, names[k], tags, warnings) for k in objects[np.argsort(at)]]
    return meshes, warnings


def _mesh_of(polygons: Polygons, chosen: np.ndarray, name: str, tags: Tags, warnings: list[str]) -> ControlMesh:
    """The mesh of the faces that are chosen."""
    sizes = np.diff(polygons.face_first)
    corners = np.repeat(chosen, sizes)
    new_vertex, kept = _renumbered(polygons.face_vertices[corners], len(polygons.vertices))
    texture = polygons.face_texcoords[corners]
    bare = texture < 0
    texcoords = polygons.texcoords
    if bare.all():
        face_texcoords, texcoords = texture, np.zeros((0, 2), np.float32)
    else:
        if bare.any():
            faces = np.zeros(int(chosen.sum()), bool)
            faces[np.repeat(np.arange(len(faces)), sizes[chosen])[bare]] = True
            warnings.append(_counted(faces, f"faces of {name!r}", "no texture coordinates; (0, 0) is taken", 0))
            texture = np.where(bare, len(texcoords), texture)
            texcoords = np.concatenate([texcoords, np.zeros((1, 2), np.float32)])
        new_texcoord, kept_texcoords = _renumbered(texture, len(texcoords))
        face_texcoords, texcoords = new_texcoord[texture], texcoords[kept_texcoords]
    creases = (new_vertex[tags.crease_edges] >= 0).all(axis=1)
    pointed = new_vertex[tags.corner_vertices] >= 0
    return ControlMesh(
        name=name,
        vertices=np.ascontiguousarray(polygons.vertices[kept]),
        face_first=np.concatenate([[0], np.cumsum(sizes[chosen])]).astype(np.int32),
        face_vertices=new_vertex[polygons.face_vertices[corners]],
        texcoords=np.ascontiguousarray(texcoords),
        face_texcoords=face_texcoords.astype(np.int32),
        crease_edges=new_vertex[tags.crease_edges[creases]],
        crease_sharpness=tags.crease_sharpness[creases],
        corner_vertices=new_vertex[tags.corner_vertices[pointed]],
        corner_sharpness=tags.corner_sharpness[pointed],
        boundary=tags.boundary or "edge_and_corner",
    )


def _renumbered(index: I32, count: int) -> tuple[I32, np.ndarray]:
    """New numbers (count,) of the entries that `index` names, -1 for others, in their old order; and which are kept."""
    kept = np.zeros(count, bool)
    kept[index] = True
    number = np.cumsum(kept, dtype=np.int32) - np.int32(1)
    return np.where(kept, number, np.int32(-1)), kept


def _counted(marked: Any, what: str, problem: str, base: int) -> str:
    """`3 vertices (5, 9, 12): problem`, the first few by number."""
    numbers = np.flatnonzero(marked) + base
    shown = ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")
    return f"{len(numbers)} {what} ({shown}): {problem}"
