"""Control meshes that a scene file names become the surfaces of an object, and arrays beside them its motion."""

from pathlib import Path
from typing import get_args

import numpy as np

from pipeline.animate import Interpolation, Motion, interpolate
from pipeline.subdivision.surface import Basis, Refine, Surface, make_surface
from pipeline.subdivision.topology import Cage, TopologyFault
from pipeline.types import F32
from tiler.scene.arrays import ArrayFault, load_arrays
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.mesh_files import read_mesh
from tiler.scene.skinning import Skinning

MOTION_ARRAYS = ("frames", "interpolation", "points", "transforms", "bone_index", "bone_weight", "bones")


def read_surface(
    path: Path, basis: str, refinement: Refine, needs_texcoords: bool
) -> tuple[Surface, F32, Motion | None, tuple[str, ...]]:
    """Surface of all meshes of a file, their vertices (V, 3) one mesh after the other, how they move, and warnings.

    Raises ArrayFault.
    """
    meshes, warnings = read_mesh(path)
    if needs_texcoords:
        for mesh in meshes:
            corners = np.flatnonzero(mesh.face_texcoords < 0)
            faces = len(np.unique(np.searchsorted(mesh.face_first, corners, side="right")))
            if faces:
                raise ArrayFault(
                    f"has {faces} faces without texture coordinates in {mesh.name}, and the object has a displacement "
                    "map; allowed: texture coordinates at every corner, or no displacement"
                )
    surface, vertices, more = surface_of(meshes, basis, refinement)
    return surface, vertices, motion_of_keys(meshes, vertices), (*warnings, *more)


def surface_of(meshes: list[ControlMesh], basis: str, refinement: Refine) -> tuple[Surface, F32, tuple[str, ...]]:
    """One surface of several control meshes; its warnings. Raises ArrayFault where they are no surface."""
    for mesh in meshes:
        _check_vertices(mesh)
    cage, vertices = cage_of(meshes)
    try:
        surface, warnings = make_surface(cage, Basis[basis.upper()], refinement)
    except TopologyFault as fault:
        raise ArrayFault(f"is no surface: {fault}") from None
    return surface, vertices, warnings


def cage_of(meshes: list[ControlMesh]) -> tuple[Cage, F32]:
    """The meshes as one cage, and their vertices. Faces without texture coordinates get (0, 0)."""
    if len({mesh.boundary for mesh in meshes}) > 1:
        raise ArrayFault("has meshes with different boundary rules; allowed: one rule for all meshes of a file")
    vertex = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    corner = np.cumsum([0, *(len(mesh.face_vertices) for mesh in meshes)])
    texcoords = []
    for mesh in meshes:
        table = np.concatenate([mesh.texcoords, np.zeros((1, 2), np.float32)])  # the last row answers -1
        texcoords.append(table[mesh.face_texcoords])
    firsts = [mesh.face_first[:-1] + base for mesh, base in zip(meshes, corner[:-1], strict=True)]
    numbered = list(zip(meshes, vertex[:-1], strict=True))
    cage = Cage(
        num_vertices=int(vertex[-1]),
        face_first=np.concatenate([*firsts, corner[-1:]]).astype(np.int32),
        face_vertices=np.concatenate([mesh.face_vertices + base for mesh, base in numbered]).astype(np.int32),
        texcoords=np.concatenate(texcoords),
        crease_edges=np.concatenate([mesh.crease_edges.reshape(-1, 2) + base for mesh, base in numbered]).astype(
            np.int32
        ),
        crease_sharpness=np.concatenate([mesh.crease_sharpness for mesh in meshes]),
        corner_vertices=np.concatenate([mesh.corner_vertices + base for mesh, base in numbered]).astype(np.int32),
        corner_sharpness=np.concatenate([mesh.corner_sharpness for mesh in meshes]),
        keep_corners=meshes[0].boundary == "edge_and_corner",
    )
    return cage, np.ascontiguousarray(np.concatenate([mesh.vertices for mesh in meshes]), np.float32)


def _check_vertices(mesh: ControlMesh) -> None:
    """Refuse a face that names no vertex of its own mesh: as a number of the cage it might name one of another's."""
    outside = (mesh.face_vertices < 0) | (mesh.face_vertices >= len(mesh.vertices))
    if outside.any():
        corner = int(np.argmax(outside))
        face = int(np.searchsorted(mesh.face_first, corner, side="right")) - 1
        raise ArrayFault(
            f"is no surface: face {face} names vertex {mesh.face_vertices[corner]} in {mesh.name}; "
            f"allowed: 0 to {len(mesh.vertices) - 1}"
        )


def motion_of_keys(meshes: list[ControlMesh], vertices: F32) -> Motion | None:
    """Motion of the meshes of a file whose points the file itself keys; None where it keys none.

    Keys of one mesh are made in all at its frame: what runs linearly between keys does so between more of them.
    """
    frames = np.unique(np.concatenate([mesh.keys.frames for mesh in meshes if mesh.keys is not None] or [np.zeros(0)]))
    if not len(frames):
        return None
    points, at = np.tile(vertices, (len(frames), 1, 1)), 0
    for mesh in meshes:
        end = at + len(mesh.vertices)
        if mesh.keys is not None:
            own = Motion(mesh.keys.frames, points=mesh.keys.points)
            points[:, at:end] = [interpolate(own, mesh.keys.points, frame) for frame in frames]
        at = end
    return Motion(frames, points=points)


def read_motion(path: Path, num_vertices: int) -> Motion:
    """Motion of an object, from the arrays of an .npz file. Raises ArrayFault.

    frames (K,) of the keys, rising; interpolation, a text, linear (as when it is missing) or catmull_rom; and any of
    points (K, V, 3) control points in object space; transforms (K, 3, 4) object to world, in place of translate, rotate and
    scale; bone_index (V, B), bone_weight (V, B) and bones (K, J, 3, 4) for linear blend skinning. num_vertices : V, of all
    meshes of the object's file one after the other; 0 for an object of patches, which can only be moved as a whole.
    """
    arrays = load_arrays(path)
    unknown = [name for name in arrays if name not in MOTION_ARRAYS]
    if unknown:
        raise ArrayFault(f"has an array {unknown[0]}; allowed: {', '.join(MOTION_ARRAYS)}")
    if "frames" not in arrays:
        raise ArrayFault("has no array frames; allowed: the frame of each key, rising")
    frames = np.asarray(_numbers(arrays["frames"], "frames", (None,)), np.float64)
    if len(frames) == 0 or (np.diff(frames) <= 0).any():
        raise ArrayFault("has frames that do not rise; allowed: at least one key, frames in rising order")
    kind = str(arrays.get("interpolation", "linear"))
    if kind not in get_args(Interpolation):
        raise ArrayFault(f"has interpolation {kind!r}; allowed: {', '.join(get_args(Interpolation))}")
    keys = len(frames)
    skin = [name for name in ("bone_index", "bone_weight", "bones") if name in arrays]
    if len(skin) not in (0, 3):
        raise ArrayFault(f"has {' and '.join(skin)} only; allowed: bone_index, bone_weight and bones together")
    if num_vertices == 0 and (skin or "points" in arrays):
        raise ArrayFault("moves points of an object of patches; allowed there: transforms only")
    index = weight = bones = None
    if skin:
        bones = _numbers(arrays["bones"], "bones", (keys, None, 3, 4))
        weight = _numbers(arrays["bone_weight"], "bone_weight", (num_vertices, None))
        index = arrays["bone_index"]
        if index.shape != weight.shape or index.dtype.kind not in "iu":
            raise ArrayFault(
                f"has bone_index {index.dtype} of shape {index.shape}; allowed: whole numbers {weight.shape}"
            )
        if index.size and not (index.min() >= 0 and index.max() < bones.shape[1]):
            raise ArrayFault(
                f"has bone {index.max() if index.min() >= 0 else index.min()}; allowed: 0 to {bones.shape[1] - 1}"
            )
        index = np.ascontiguousarray(index, np.int32)
    points = _numbers(arrays["points"], "points", (keys, num_vertices, 3)) if "points" in arrays else None
    transforms = _numbers(arrays["transforms"], "transforms", (keys, 3, 4)) if "transforms" in arrays else None
    if points is None and transforms is None and not skin:
        raise ArrayFault("moves nothing; allowed: points, transforms, or bones with bone_index and bone_weight")
    interpolation: Interpolation = "linear" if kind == "linear" else "catmull_rom"
    return Motion(frames, interpolation, points, transforms, index, weight, bones)


def motion_of(skinning: Skinning) -> Motion:
    """A builder's skinning as the motion of its object."""
    return Motion(
        skinning.key_frame.astype(np.float64),
        bone_index=skinning.bone_index,
        bone_weight=skinning.bone_weight,
        bones=skinning.bone_transform,
    )


def _numbers(values: np.ndarray, name: str, shape: tuple[int | None, ...]) -> F32:
    """Finite float32 of the shape; None in it is any size."""
    fits = values.ndim == len(shape) and all(w is None or w == n for n, w in zip(values.shape, shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ArrayFault(f"has {name} of shape {values.shape}; allowed: ({wanted})")
    if values.dtype.kind not in "fiu":
        raise ArrayFault(f"has {name} of type {values.dtype}; allowed: numbers")
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(values, np.float32)
    if not np.isfinite(single).all():
        raise ArrayFault(f"has numbers in {name} that are not finite; allowed: finite float32 numbers")
    return single
