"""USD files as control meshes: every Mesh prim with its scheme, creases, corners, boundary rule and texture coordinates.

Needs usd-core (extra `usd`). Points are in world space, in the stage's own axes (`up_axis` tells which is up), at the
default time, or at the first time sample where a prim has no default. Time samples of points, and of the transforms above
them, become keys: a time code is a frame's number, and points run linearly between. The prims' order is that of the stage.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.types import F32, I32
from tiler.scene.arrays import ArrayFault, check_file
from tiler.scene.control_mesh import Boundary, ControlMesh, Keys
from tiler.scene.obj_lines import NO_TAGS, Tags
from tiler.scene.polygons import Polygons, split_objects

FILE_LIMIT = 2**31  # bytes
CORNER_LIMIT = 2**26


def read_usd(path: Path) -> tuple[list[ControlMesh], tuple[str, ...]]:
    """The meshes of a stage, and warnings. Raises ArrayFault that names the prim."""
    stage = _open(path)
    from pxr import Usd, UsdGeom

    prims = [prim for prim in stage.Traverse(Usd.TraverseInstanceProxies()) if prim.IsA(UsdGeom.Mesh)]
    meshes: list[ControlMesh] = []
    warnings: list[str] = []
    for prim in prims:
        made, told = _read_prim(UsdGeom.Mesh(prim))
        meshes += made
        warnings += [f"{prim.GetPath()}: {warning}" for warning in told]
    if not meshes:
        raise ArrayFault(f"has {len(prims)} Mesh prims, none with a face; allowed: at least one")
    return meshes, tuple(warnings)


def up_axis(path: Path) -> str:
    """y or z, the axis that points upwards on the stage. Raises ArrayFault."""
    stage = _open(path)
    from pxr import UsdGeom

    return str(UsdGeom.GetStageUpAxis(stage)).lower()


def _open(path: Path) -> Any:
    check_file(path, FILE_LIMIT)
    try:
        from pxr import Tf, Usd
    except ImportError:
        raise ArrayFault("needs the package usd-core: pip install 'tilesim[usd]'") from None
    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise ArrayFault(f"is no USD file that can be read ({_reason(error)})") from None


def _reason(error: Any) -> str:
    """The first of the messages that usd-core collected, without its own source lines."""
    text = " ".join(str(getattr(error.args[0], "commentary", error.args[0])).split()) if error.args else "unknown"
    line = re.search(r":(\d+):\d+: parse error", text)
    return f"line {line[1]}: not valid" if line else text[:160]


def _read_prim(mesh: Any) -> tuple[list[ControlMesh], list[str]]:
    """The mesh of a prim, none where it has no face; and warnings."""
    where = str(mesh.GetPath())
    warnings = _scheme_warnings(mesh, where)
    points = _array(mesh.GetPointsAttr(), np.float64, (-1, 3))
    sizes = _array(mesh.GetFaceVertexCountsAttr(), np.int64, (-1,))
    vertex = _array(mesh.GetFaceVertexIndicesAttr(), np.int64, (-1,))
    if not len(sizes):
        return [], warnings
    _check_faces(where, len(points), sizes, vertex)
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    texcoords, texture = _texcoords(mesh, where, len(points), vertex, warnings)
    turned = _value(mesh.GetOrientationAttr()) == "leftHanded"
    matrix, mirrored = _to_world(mesh)
    if turned != mirrored:  # a mirror image of a left-handed mesh is right-handed again
        order = _reversed_corners(first, sizes)
        vertex, texture = vertex[order], texture[order]
    tags = _tags(mesh, where, len(points))
    world = _in_world(points, matrix)
    polygons = Polygons(world, first, vertex.astype(np.int32), texcoords, texture)
    meshes, told = split_objects(polygons, np.zeros(len(sizes), np.int64), [mesh.GetPrim().GetName()], tags)
    times = _times(mesh)
    if len(times) > 1:
        keys = Keys(np.array(times), _points_at(mesh, where, times, points)[:, np.unique(vertex)])
        meshes = [one._replace(keys=keys) for one in meshes]  # one object, whose vertices are those that faces name
        if str(mesh.GetPrim().GetStage().GetInterpolationType()).endswith("Held"):
            warnings.append("the stage holds values between samples; they are read as running linearly")
    return meshes, warnings + told


def _in_world(points: np.ndarray, matrix: np.ndarray) -> F32:
    with np.errstate(over="ignore", invalid="ignore"):
        return (points @ matrix[:3, :3] + matrix[3, :3]).astype(np.float32)


def _times(mesh: Any) -> list[float]:
    """Time codes at which points or a transform above them have samples, rising."""
    from pxr import UsdGeom

    times, prim = set(mesh.GetPointsAttr().GetTimeSamples()), mesh.GetPrim()
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            times |= set(UsdGeom.Xformable(prim).GetTimeSamples())
        prim = prim.GetParent()
    return sorted(times)


def _points_at(mesh: Any, where: str, times: list[float], standing: np.ndarray) -> F32:
    """Points (K, V, 3) in world space at the times."""
    if 12 * len(times) * len(standing) > FILE_LIMIT:
        raise ArrayFault(
            f"{where}: has {len(times)} times of {len(standing)} points; allowed: {FILE_LIMIT:,} bytes in all"
        )
    keys = np.empty((len(times), len(standing), 3), np.float32)
    for k, time in enumerate(times):
        value = mesh.GetPointsAttr().Get(time)
        points = np.zeros((0, 3)) if value is None else np.array(value, np.float64).reshape(-1, 3)
        if len(points) != len(standing):
            raise ArrayFault(
                f"{where}: has {len(points)} points at time {time:g}; allowed: {len(standing)}, as at first"
            )
        keys[k] = _in_world(points, np.array(mesh.ComputeLocalToWorldTransform(time)))
    return keys


def _scheme_warnings(mesh: Any, where: str) -> list[str]:
    scheme = _value(mesh.GetSubdivisionSchemeAttr())
    if scheme == "none":
        return ["subdivisionScheme none (a polygon mesh) is read as catmullClark"]
    if scheme not in ("catmullClark", None):
        raise ArrayFault(f"{where}: has subdivisionScheme {scheme}; allowed: catmullClark, none")
    return ["holes are filled"] if _value(mesh.GetHoleIndicesAttr()) else []


def _check_faces(where: str, num_points: int, sizes: np.ndarray, vertex: np.ndarray) -> None:
    if len(vertex) > CORNER_LIMIT:
        raise ArrayFault(f"{where}: has {len(vertex):,} face corners; allowed: at most {CORNER_LIMIT:,}")
    if sizes.min() < 3:
        f = int(np.argmax(sizes < 3))
        raise ArrayFault(f"{where}: faceVertexCounts[{f}] is {sizes[f]}; allowed: at least 3")
    if sizes.sum() != len(vertex):
        raise ArrayFault(
            f"{where}: faceVertexCounts add up to {sizes.sum()}, and there are {len(vertex)} faceVertexIndices"
        )
    if vertex.min() < 0 or vertex.max() >= num_points:
        k = int(np.argmax((vertex < 0) | (vertex >= num_points)))
        raise ArrayFault(f"{where}: faceVertexIndices[{k}] is {vertex[k]}; allowed: 0 to {num_points - 1}")
    face = np.repeat(np.arange(len(sizes)), sizes)
    order = np.lexsort((vertex, face))
    same = (face[order][1:] == face[order][:-1]) & (vertex[order][1:] == vertex[order][:-1])
    if same.any():
        k = order[int(np.argmax(same))]
        raise ArrayFault(f"{where}: face {face[k]} names vertex {vertex[k]} twice; allowed: different vertices")


def _texcoords(mesh: Any, where: str, num_points: int, vertex: np.ndarray, warnings: list[str]) -> tuple[F32, I32]:
    """Texture coordinates (T, 2) and the index of each corner, -1 where the prim has none that we know."""
    from pxr import UsdGeom

    primvars = UsdGeom.PrimvarsAPI(mesh.GetPrim())
    found = [p for p in primvars.GetPrimvarsWithValues() if str(p.GetTypeName()) in ("texCoord2f[]", "float2[]")]
    chosen = next((p for p in found if p.GetPrimvarName() == "st"), found[0] if len(found) == 1 else None)
    none = np.zeros((0, 2), np.float32), np.full(len(vertex), -1, np.int32)
    if chosen is None:
        return none
    name, kind = chosen.GetPrimvarName(), str(chosen.GetInterpolation())
    values = _array(chosen, np.float32, (-1, 2))
    indices = _array(chosen.GetIndicesAttr(), np.int64, (-1,)) if chosen.IsIndexed() else np.arange(len(values))
    corner = {"faceVarying": np.arange(len(vertex)), "vertex": vertex, "varying": vertex}.get(kind)
    if corner is None:
        warnings.append(f"primvar {name} is {kind}; allowed: faceVarying, vertex, varying; it is left out")
        return none
    needed = len(vertex) if kind == "faceVarying" else num_points
    if len(indices) != needed:
        raise ArrayFault(f"{where}: primvar {name} has {len(indices)} {kind} values; needed: {needed}")
    if len(indices) and (indices.min() < 0 or indices.max() >= len(values)):
        raise ArrayFault(f"{where}: primvar {name} has index {indices.max()}; allowed: 0 to {len(values) - 1}")
    return values, indices[corner].astype(np.int32)


def _tags(mesh: Any, where: str, num_points: int) -> Tags:
    """Creases, corners and the boundary rule."""
    indices = _array(mesh.GetCreaseIndicesAttr(), np.int64, (-1,))
    lengths = _array(mesh.GetCreaseLengthsAttr(), np.int64, (-1,))
    sharpness = _array(mesh.GetCreaseSharpnessesAttr(), np.float32, (-1,))
    corners = _array(mesh.GetCornerIndicesAttr(), np.int64, (-1,))
    corner_sharpness = _array(mesh.GetCornerSharpnessesAttr(), np.float32, (-1,))
    for name, array in (("creaseIndices", indices), ("cornerIndices", corners)):
        if len(array) and (array.min() < 0 or array.max() >= num_points):
            raise ArrayFault(f"{where}: {name} has {array.max()}; allowed: 0 to {num_points - 1}")
    if len(corners) != len(corner_sharpness):
        raise ArrayFault(f"{where}: has {len(corners)} cornerIndices and {len(corner_sharpness)} cornerSharpnesses")
    if lengths.sum() != len(indices) or (lengths < 2).any():
        raise ArrayFault(f"{where}: creaseLengths {lengths[:8].tolist()} do not cut up {len(indices)} creaseIndices")
    # Edges join neighbours in the list, but not the last vertex of a chain with the first of the next.
    inner = np.ones(max(len(indices) - 1, 0), bool)
    inner[np.cumsum(lengths)[:-1] - 1] = False
    edges = np.stack([indices[:-1][inner], indices[1:][inner]], axis=1)
    if len(sharpness) == len(lengths):
        sharpness = np.repeat(sharpness, lengths - 1)
    if len(sharpness) != len(edges):
        raise ArrayFault(f"{where}: has {len(sharpness)} creaseSharpnesses; allowed: one a crease, or one an edge")
    rule = _value(mesh.GetInterpolateBoundaryAttr())
    boundary: Boundary = "edge_only" if rule == "edgeOnly" else "edge_and_corner"
    sharp, pointed = sharpness > 0, corner_sharpness > 0
    return NO_TAGS._replace(
        crease_edges=edges[sharp].astype(np.int32),
        crease_sharpness=sharpness[sharp],
        corner_vertices=corners[pointed].astype(np.int32),
        corner_sharpness=corner_sharpness[pointed],
        boundary=boundary,
    )


def _to_world(mesh: Any) -> tuple[np.ndarray, bool]:
    """Object to world at first, a row-vector matrix (4, 4), and whether it mirrors."""
    from pxr import Usd

    matrix = np.array(mesh.ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime()))
    return matrix, bool(np.linalg.det(matrix[:3, :3]) < 0)


def _reversed_corners(first: I32, sizes: np.ndarray) -> np.ndarray:
    """For each corner the one that takes its place when its face is turned around; the first corner stays."""
    start, size = np.repeat(first[:-1], sizes), np.repeat(sizes, sizes)
    step = np.arange(int(sizes.sum())) - start
    return start + (size - step) % size


def _value(attribute: Any) -> Any:
    """Value at the default time, or at the first sample."""
    from pxr import Usd

    value = attribute.Get()
    return attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value


def _array(attribute: Any, dtype: type[np.generic], shape: tuple[int, ...]) -> np.ndarray:
    value = _value(attribute)
    return np.zeros([max(n, 0) for n in shape], dtype) if value is None else np.array(value, dtype).reshape(shape)
