"""Triangle meshes as occluders: each triangle, or two that make a flat convex quad, becomes a bicubic patch of that shape.

Corners are raised from bilinear to bicubic, so the patch draws exactly the flat polygon; of a lone triangle the edge v = 1
is collapsed to its last corner. Neighbours have the same bits along shared edges. Read by trimesh.
"""

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.types import F32, F64, I64
from tiler.scene.arrays import ArrayFault, bytes_of, check_file, float32_of
from tiler.scene.mesh import Mesh, mesh_of

SUFFIXES = (".ply", ".stl", ".off", ".glb", ".gltf")
TRIANGLE_LIMIT = 2**22
FILE_LIMIT = 2**30  # bytes
HEAD = 65536  # bytes in which counts are looked for
FLAT = 2.0**-20  # of a quad's size: so little may its fourth corner be off the plane of the others


def read_triangles(path: Path) -> tuple[Mesh, tuple[str, ...]]:
    """Patches of a triangle mesh, and warnings. Raises ArrayFault."""
    check_file(path, FILE_LIMIT)
    _check_header(path)
    points, faces = _load(path)
    corners, warnings = quads_of(points, faces)
    return mesh_of(_bicubic(corners)), warnings


def quads_of(points: F32, faces: I64) -> tuple[F32, tuple[str, ...]]:
    """Corners (q, 4, 3), counter-clockwise; the last two are equal where a triangle stays alone. And warnings."""
    straight = points[faces].astype(np.float64)
    area = np.linalg.norm(np.cross(straight[:, 1] - straight[:, 0], straight[:, 2] - straight[:, 0]), axis=1)
    kept = area > 0  # false for NaN too
    warnings = () if kept.all() else (f"{int((~kept).sum())} triangles without area are left out",)
    faces = faces[kept]
    if not len(faces):
        raise ArrayFault("has no triangle; allowed: at least one with an area")
    quads, paired = _pairs(points, faces)
    alone = faces[~paired]
    indices = np.concatenate([quads, np.concatenate([alone, alone[:, 2:]], axis=1)])
    return points[indices], warnings


def _pairs(points: F32, faces: I64) -> tuple[I64, np.ndarray]:
    """Corner indices (q, 4) of pairs of triangles, and which triangles are in one; earlier triangles choose first."""
    # Each edge of each triangle, in both of its triangles once in each direction: (a, b) here, (b, a) there.
    a, b, c = (np.concatenate([faces[:, (k + d) % 3] for k in range(3)]) for d in range(3))
    triangle = np.tile(np.arange(len(faces)), 3)
    key, back = a * len(points) + b, b * len(points) + a
    order = np.argsort(key, kind="stable")
    place = np.minimum(np.searchsorted(key[order], back), len(key) - 1)
    other = order[place]
    match = (key[other] == back) & (triangle < triangle[other])
    edge = np.flatnonzero(match)
    # The quad around the shared edge (a, b): a, d, b, c with c of this triangle and d of the other.
    quad = np.stack([a[edge], c[other[edge]], b[edge], c[edge]], axis=1)
    good = _flat_and_convex(points[quad].astype(np.float64))
    edge, quad = edge[good], quad[good]
    first, second = triangle[edge], triangle[other[edge]]
    paired = np.zeros(len(faces), bool)
    chosen = []
    for k in np.lexsort((second, first)):
        if not paired[first[k]] and not paired[second[k]]:
            paired[first[k]] = paired[second[k]] = True
            chosen.append(k)
    return quad[chosen], paired


def _flat_and_convex(quad: F64) -> np.ndarray:
    """Which quads (q, 4, 3) are flat, and turn the same way at all their corners."""
    side = np.roll(quad, -1, axis=1) - quad
    turns = np.cross(np.roll(side, 1, axis=1), side)
    normal = turns.sum(axis=1)
    length = np.sqrt((normal**2).sum(axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = normal / length[:, None]
        convex = (np.einsum("qkc,qc->qk", turns, unit) > 2.0**-10 * length[:, None]).all(axis=1)
        off = np.abs(np.einsum("qkc,qc->qk", quad - quad[:, :1], unit)).max(axis=1)
    return convex & (off <= FLAT * np.sqrt((side**2).sum(axis=(1, 2))))


def _bicubic(corners: F32) -> F32:
    """Control points (q, 4, 4, 3), [i, j] at (u, v) = (i / 3, j / 3) of the bilinear patch.

    On an edge two of the four products are 0 and the others exact, so both neighbours round the same sum.
    """
    a, b, c, d = (corners[:, k, None, None].astype(np.float64) for k in range(4))
    i, j = np.arange(4.0)[:, None, None], np.arange(4.0)[None, :, None]
    return (((3 - i) * (3 - j) * a + i * (3 - j) * b + i * j * c + (3 - i) * j * d) / 9).astype(np.float32)


def _load(path: Path) -> tuple[F32, I64]:
    """Vertices and triangles of a file."""
    import trimesh

    try:
        mesh: Any = trimesh.load_scene(path, process=False).to_mesh()  # everything in the file, transforms applied
        points, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    except Exception as error:  # trimesh raises what its parsers happen to meet in a broken file
        raise ArrayFault(f"is no {path.suffix.lower()} file of triangles that can be read ({_short(error)})") from None
    if faces.ndim != 2 or not len(faces):
        raise ArrayFault("has no triangle; allowed: at least one")
    if len(faces) > TRIANGLE_LIMIT:
        raise ArrayFault(f"has {len(faces):,} triangles; allowed: at most {TRIANGLE_LIMIT:,}")
    if faces.min() < 0 or faces.max() >= len(points):
        raise ArrayFault(f"has vertex {int(faces.max())} in a triangle; allowed: 0 to {len(points) - 1}")
    # Files repeat a vertex for each of its triangles or normals; neighbours know each other by equal positions.
    merged, index = np.unique(float32_of(points, "vertices") + np.float32(0), axis=0, return_inverse=True)
    return merged, index.reshape(-1)[faces].astype(np.int64)


def _check_header(path: Path) -> None:
    """Refuse counts that are too large, or that the file has no room for, before anything is allocated for them."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEAD)
    kind = path.suffix.lower()
    if kind == ".ply":
        counts = [int(n) for n in re.findall(rb"element\s+\w+\s+(\d{1,18})", head.split(b"end_header")[0])]
    elif kind == ".off":
        words = re.sub(rb"#[^\n]*", b"", head).split()
        counts = [int(word) for word in words[1:3] if word.isdigit()]
    elif kind == ".stl" and not head.lstrip().startswith(b"solid") and len(head) >= 84:
        counts = [struct.unpack_from("<I", head, 80)[0]]
    else:
        counts = _accessor_counts(path) if kind in (".glb", ".gltf") else []
    for count in counts:
        if count > 3 * TRIANGLE_LIMIT:
            raise ArrayFault(f"says it has {count:,} faces or vertices; allowed: at most {TRIANGLE_LIMIT:,} triangles")
        if count > size and kind not in (".gltf", ".glb"):
            raise ArrayFault(f"says it has {count:,} faces or vertices, and has only {size:,} bytes")


def _accessor_counts(path: Path) -> list[int]:
    """Lengths of the arrays that a glTF file speaks of; none where it is so broken that trimesh will say so."""
    data = bytes_of(path, FILE_LIMIT)
    if path.suffix.lower() == ".glb":
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    try:
        accessors = json.loads(data).get("accessors", [])
        return [int(accessor["count"]) for accessor in accessors]
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError):
        return []


def _short(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:120]}"
