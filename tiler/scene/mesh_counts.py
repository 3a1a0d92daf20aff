"""What a control mesh is made of, counted: faces, valences, boundaries, seams, and what is wrong with it.

Only counts: the topology that subdivision needs is another module's. All is NumPy over the list of half-edges, which are
the face corners: corner k stands for the edge from its vertex to the next one of its face.
"""

from typing import NamedTuple

import numpy as np

from pipeline.types import F64, I64
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.texture_charts import texture_coverage

FEW = 5  # offenders that are named


class MeshCounts(NamedTuple):
    """Counts of one control mesh. Valences: edges at interior vertices, faces at boundary vertices."""

    vertices: int
    faces: int
    faces_of_size: dict[int, int]
    components: int
    interior_valences: dict[int, int]
    boundary_faces: dict[int, int]
    ordinary: int  # quads whose vertices are interior with valence 4
    regular: int  # quads whose patch is the exact limit surface: ordinary ones and regular boundary ones
    extraordinary: int  # all other faces
    edges: int
    boundary_edges: int
    boundary_loops: int
    nonmanifold_edges: int
    flipped_edges: int  # that both their faces run along in the same direction
    split_vertices: int  # whose faces are more than one fan
    crease_edges: int
    sharp_corners: int
    texture_area: float  # sum over the faces, overlaps counted each time; 1 is the unit square
    texture_coverage: float  # part of the unit square that some face covers, coordinates wrapped
    seam_edges: int  # interior edges whose faces have different texture coordinates
    faces_without_texcoords: int
    low: tuple[float, ...]  # corners of the bounding box of finite vertices
    high: tuple[float, ...]
    warnings: tuple[str, ...]


def count_mesh(mesh: ControlMesh) -> MeshCounts:
    """Count what `mesh` is made of. It may be broken in any way that its arrays allow."""
    sizes = np.diff(mesh.face_first)
    num_vertices, num_faces = len(mesh.vertices), len(sizes)
    face = np.repeat(np.arange(num_faces), sizes)
    after = _next_corner(mesh.face_first, sizes)
    tail = mesh.face_vertices.astype(np.int64)
    head = tail[after]
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    key, edge, faces_of_edge = np.unique(low * num_vertices + high, return_inverse=True, return_counts=True)
    ends = np.stack([key // num_vertices, key % num_vertices], axis=1)

    forward = np.bincount(edge, tail < head, len(key))
    flipped = (faces_of_edge == 2) & (forward != 1)
    boundary = faces_of_edge == 1
    faces_of_vertex = np.bincount(tail, minlength=num_vertices)
    at_boundary = np.zeros(num_vertices, bool)
    at_boundary[ends[boundary]] = True
    split = _split_vertices(tail, edge, after, faces_of_edge, num_vertices)

    interior = ~at_boundary & (faces_of_vertex > 0)
    sharp = _sharp(mesh, num_vertices)
    ordinary_vertex = interior & (faces_of_vertex == 4)
    corner_kept = mesh.boundary == "edge_and_corner"
    regular_boundary = at_boundary & ((faces_of_vertex == 2) | ((faces_of_vertex == 1) & corner_kept))
    whole = (sizes == 4) & ~_any_corner(face, (split | sharp)[tail], num_faces)
    ordinary = whole & ~_any_corner(face, ~ordinary_vertex[tail], num_faces)
    regular = whole & ~_any_corner(face, ~(ordinary_vertex | regular_boundary)[tail], num_faces)

    area, coverage, bare, seams = _texture(mesh, face, after, edge, tail, head, len(key))
    finite = np.isfinite(mesh.vertices).all(axis=1)
    points = mesh.vertices[finite] if finite.any() else np.full((1, 3), np.nan, np.float32)
    nonmanifold = faces_of_edge > 2
    return MeshCounts(
        vertices=num_vertices,
        faces=num_faces,
        faces_of_size=_histogram(sizes),
        components=len(np.unique(_components(num_vertices, ends)[tail])),
        interior_valences=_histogram(faces_of_vertex[interior]),
        boundary_faces=_histogram(faces_of_vertex[at_boundary]),
        ordinary=int(ordinary.sum()),
        regular=int(regular.sum()),
        extraordinary=int(num_faces - regular.sum()),
        edges=len(key),
        boundary_edges=int(boundary.sum()),
        boundary_loops=len(np.unique(_components(num_vertices, ends[boundary])[ends[boundary]])),
        nonmanifold_edges=int(nonmanifold.sum()),
        flipped_edges=int(flipped.sum()),
        split_vertices=int(split.sum()),
        crease_edges=len(mesh.crease_edges),
        sharp_corners=len(mesh.corner_vertices),
        texture_area=area,
        texture_coverage=coverage,
        seam_edges=seams,
        faces_without_texcoords=bare,
        low=tuple(float(x) for x in points.min(axis=0)),
        high=tuple(float(x) for x in points.max(axis=0)),
        warnings=_warnings(ends, nonmanifold, flipped, split, mesh, key),
    )


def _next_corner(face_first: np.ndarray, sizes: np.ndarray) -> I64:
    """The corner that follows each corner in its face."""
    after = np.arange(1, int(sizes.sum()) + 1)
    after[face_first[1:] - 1] = face_first[:-1]
    return after


def _split_vertices(tail: I64, edge: I64, after: I64, faces_of_edge: I64, num_vertices: int) -> np.ndarray:
    """Vertices whose corners do not all hang together through edges of two faces."""
    paired = np.flatnonzero(faces_of_edge[edge] == 2)
    paired = paired[np.argsort(edge[paired], kind="stable")]
    a, b = paired[0::2], paired[1::2]
    ends_a, ends_b = np.stack([a, after[a]], axis=1), np.stack([b, after[b]], axis=1)
    same_way = tail[a] == tail[b]
    ends_b = np.where(same_way[:, None], ends_b, ends_b[:, ::-1])
    links = np.stack([ends_a.ravel(), ends_b.ravel()], axis=1)
    fans = np.unique(np.stack([tail, _components(len(tail), links)], axis=1), axis=0)
    split: np.ndarray = np.bincount(fans[:, 0], minlength=num_vertices) > 1
    return split


def _components(count: int, links: I64) -> I64:
    """The smallest member of each member's component, (count,); links : (n, 2)."""
    root = np.arange(count)
    a, b = links[:, 0], links[:, 1]
    while True:
        low = np.minimum(root[a], root[b])
        new = root.copy()
        np.minimum.at(new, root[a], low)
        np.minimum.at(new, root[b], low)
        while not np.array_equal(new, new[new]):
            new = new[new]
        if np.array_equal(new, root):
            return root
        root = new


def _sharp(mesh: ControlMesh, num_vertices: int) -> np.ndarray:
    """Vertices that a crease or corner changes."""
    sharp = np.zeros(num_vertices, bool)
    sharp[mesh.crease_edges] = True
    sharp[mesh.corner_vertices] = True
    return sharp


def _any_corner(face: I64, marked: np.ndarray, num_faces: int) -> np.ndarray:
    """Faces with a marked corner."""
    found = np.zeros(num_faces, bool)
    found[face[marked]] = True
    return found


def _texture(
    mesh: ControlMesh, face: I64, after: I64, edge: I64, tail: I64, head: I64, num_edges: int
) -> tuple[float, float, int, int]:
    """Sum of the faces' areas in texture space, part of it covered, faces without texture coordinates, seam edges."""
    bare = _any_corner(face, mesh.face_texcoords < 0, len(mesh.face_first) - 1)
    if bare.all():
        return 0.0, 0.0, int(bare.sum()), 0
    st: F64 = mesh.texcoords[np.maximum(mesh.face_texcoords, 0)].astype(np.float64)
    with np.errstate(invalid="ignore"):
        cross = st[:, 0] * st[after][:, 1] - st[:, 1] * st[after][:, 0]
    areas = np.bincount(face, cross, len(bare))
    # Texture coordinates of each half-edge at its lower and its higher vertex: the same bits on both sides, or a seam.
    at_low = np.where((tail < head)[:, None], st, st[after])
    at_high = np.where((tail < head)[:, None], st[after], st)
    four = np.concatenate([at_low, at_high], axis=1)
    order = np.argsort(edge, kind="stable")
    same_edge = edge[order][1:] == edge[order][:-1]
    differ = (four[order][1:] != four[order][:-1]).any(axis=1)
    seams = np.unique(edge[order][1:][same_edge & differ])
    area = float(np.nansum(np.abs(areas[~bare])) / 2)
    st = np.where(bare[face][:, None], np.nan, st)  # NaN is near nothing: such a face is left out
    coverage = texture_coverage(mesh.face_first.astype(np.int64), np.ascontiguousarray(st))
    return area, coverage, int(bare.sum()), len(seams)


def _histogram(values: np.ndarray) -> dict[int, int]:
    numbers, counts = np.unique(values, return_counts=True)
    return {int(n): int(c) for n, c in zip(numbers, counts, strict=True)}


def _warnings(
    ends: I64, nonmanifold: np.ndarray, flipped: np.ndarray, split: np.ndarray, mesh: ControlMesh, key: I64
) -> tuple[str, ...]:
    """What subdivision will refuse or draw otherwise than meant, with the first few offenders; vertices from 1."""
    found = []
    for marked, what in (
        (nonmanifold, "edges have more than two faces"),
        (flipped, "edges have two faces of opposite winding"),
    ):
        if marked.any():
            pairs = ", ".join(f"{a + 1}-{b + 1}" for a, b in ends[marked][:FEW])
            found.append(f"{int(marked.sum())} {what}: {pairs}{_more(marked)}")
    if split.any():
        names = ", ".join(str(v + 1) for v in np.flatnonzero(split)[:FEW])
        found.append(f"{int(split.sum())} vertices join faces that share no edge there: {names}{_more(split)}")
    creases = np.sort(mesh.crease_edges.astype(np.int64), axis=1)
    strange = ~np.isin(creases[:, 0] * len(mesh.vertices) + creases[:, 1], key)
    if strange.any():
        pairs = ", ".join(f"{a + 1}-{b + 1}" for a, b in creases[strange][:FEW])
        found.append(f"{int(strange.sum())} creases are on no edge: {pairs}{_more(strange)}")
    return tuple(found)


def _more(marked: np.ndarray) -> str:
    return ", ..." if marked.sum() > FEW else ""
