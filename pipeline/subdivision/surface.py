"""A subdivision surface ready to become patches: cages, masks and who owns which edge. Made once; animation only moves points.

Patches come from *layers*: one cage and those of its faces that become patches. There is one layer, but for `adaptive`,
which keeps the ordinary faces of the cage (layer 0) and takes the four children of each other face from the cage after one
step (layer 1). Where the two meet an edge of one patch lies along two edges of others: the surface is the same curve, the
tessellation is not unless factors match, so adaptive refinement is for culling studies, not for pictures without cracks.
"""

from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np

from pipeline.subdivision import limit, refine
from pipeline.subdivision.topology import Cage, Rings, Topology, TopologyFault, VertexKind, make_rings, make_topology
from pipeline.types import F32, F64, I32, U8

Refine = Literal["none", "uniform", "adaptive"]
MAX_SHARPNESS_STEPS = 4  # uniform steps that semi-sharp creases may ask for: each makes four times as many patches
SIDE_OF_EDGE = [3, 0, 1, 2]  # the side of a face at the edges u=0, v=0, u=1, v=1
CORNER_ORDER = [0, 1, 3, 2]  # of a face, as texture corners (u, v) = (0,0) (1,0) (0,1) (1,1)


class Basis(IntEnum):
    """What faces that are not regular become; regular ones are exact bicubic patches in either."""

    ACC = 0
    GREGORY = 1


class Sharing(NamedTuple):
    """Which patches of a layer share the normals of an edge or a corner, and which of them makes these."""

    edge: I32  # (M, 4) row of side k's normals
    edge_write: U8  # (M, 4) what the face does to them: 0 nothing, 1 writes them, 2 adds to them (a crease)
    corner: I32  # (M, 4) row of corner k's normal
    corner_write: U8  # (M, 4) as edge_write
    num_edges: int  # rows
    num_corners: int


class Layer(NamedTuple):
    """Faces of one cage as patches, as the kernel of the control-point phase reads them. M patches, E edges, V vertices."""

    level: int  # steps from the control mesh to this cage
    quad: I32  # (M, 4) vertices
    edge: I32  # (M, 4) edge k runs from corner k to corner k + 1
    along: U8  # (M, 4) 1: it runs as the edge does, 0: against it
    smooth: U8  # (M, 4) 1: the edge has two faces and is not sharp
    turn: F64  # (M, 4) c of the corners
    fullness: F64  # (M, 4) N of the corners
    tangent: I32  # (M, 4, 2) rows of the limit tangents along edge k and back along edge k - 1; unset in regular faces
    regular: U8  # (M,) the patch is the exact limit surface
    joined: "Sharing"  # of normals to displace along: every edge and every vertex has one
    sided: "Sharing"  # of normals to shade with: a sharp edge has one on each side, a vertex one for each sector
    ends: (
        I32  # (E, 6) of each edge from a to b: a, b, and the vertices next to them on its first and second side, or -1
    )
    end_fullness: F64  # (E, 2) N of both ends
    end_tangent: I32  # (E, 2) rows of the limit tangents at both ends, where a Gregory point needs them, else -1
    end_reach: F64  # (E, 2)
    position: limit.Rows
    tangents: limit.Rows


class Surface(NamedTuple):
    """A subdivision surface without its points; patches are those of the layers, one after the other."""

    basis: Basis
    num_vertices: int  # of the control mesh
    used_vertices: int  # of these, those that some face has
    steps: tuple[refine.Step, ...]
    layers: tuple[Layer, ...]
    texcoords: F32  # (P, 4, 2) at (u, v) = (0,0) (1,0) (0,1) (1,1)
    irregular_id: I32  # (P,) running number of the patches that are not regular, -1 for those that are
    edge_row: I32  # (P, 4) row of each edge's normals, in SV_TessFactor order; ~row where it runs against the patch's parameter
    corner_row: I32  # (P, 4) row of the normal at (u, v) = (0,0) (1,0) (0,1) (1,1)
    side_row: I32  # (P, 4) as edge_row, of normals that stay apart at sharp edges
    sector_row: I32  # (P, 4) as corner_row, likewise
    num_edges: int  # edges
    seam_id: I32  # (P,) row in seam_edges of the patches that touch a texture seam, -1 for others
    seam_edges: F32  # (S, 4, 2, 2) texture coordinates of the first patch at each edge, as `types.Patches` has them
    seam_corners: F32  # (S, 4, 2) of the first patch at each corner

    @property
    def num_patches(self) -> int:
        """Number of patches."""
        return len(self.texcoords)


def make_surface(cage: Cage, basis: Basis = Basis.ACC, refinement: Refine = "none") -> tuple[Surface, tuple[str, ...]]:
    """Surface and warnings of a control mesh. Raises TopologyFault.

    A mesh with faces that are no quads gets one uniform step first, and so does one with semi-sharp tags: as many as its
    greatest finite sharpness, at most MAX_SHARPNESS_STEPS; what is left then is smooth below 1, else infinitely sharp.
    """
    topology, warnings = make_topology(cage)
    used = int((np.diff(topology.around_first) > 0).sum())
    steps: list[refine.Step] = []
    wanted = 1 if (np.diff(topology.face_first) != 4).any() or refinement == "uniform" else 0
    first = cage
    while len(steps) < wanted or (refine.needs_step(topology) and len(steps) < MAX_SHARPNESS_STEPS):
        steps.append(refine.make_step(topology))
        cage = refine.refine_cage(cage, topology)
        topology, _ = make_topology(cage)
    if refine.needs_step(topology):
        cage = _settled(cage)
        topology, _ = make_topology(cage)
        warnings += (f"sharpness beyond {MAX_SHARPNESS_STEPS} steps: what is left of it counts as infinite",)
    rings = make_rings(topology)
    _refuse_valence_two(topology, rings, steps)
    regular = _regular_faces(topology, rings)
    everything = np.arange(len(regular))
    if refinement == "adaptive" and not regular.all():
        ordinary = np.flatnonzero(_ordinary_faces(topology, rings))
        others = np.setdiff1d(everything, ordinary)
        layers = [_make_layer(len(steps), topology, rings, regular, ordinary, basis)] if len(ordinary) else []
        texcoords = [_texcoords(cage, ordinary)]
        steps.append(refine.make_step(topology))
        cage = refine.refine_cage(cage, topology)
        topology, _ = make_topology(cage)
        rings = make_rings(topology)
        children = (4 * others[:, None] + np.arange(4)).ravel()
        regular = _regular_faces(topology, rings)
        layers.append(_make_layer(len(steps), topology, rings, regular, children, basis))
        texcoords.append(_texcoords(cage, children))
    else:
        layers = [_make_layer(len(steps), topology, rings, regular, everything, basis)]
        texcoords = [_texcoords(cage, everything)]
    irregular = np.concatenate([layer.regular == 0 for layer in layers])
    seam_id, seam_edges, seam_corners = _seams(layers, texcoords)
    edge_row, corner_row = _rows(layers, [layer.joined for layer in layers])
    side_row, sector_row = _rows(layers, [layer.sided for layer in layers])
    surface = Surface(
        basis=basis,
        num_vertices=first.num_vertices,
        used_vertices=used,
        steps=tuple(steps),
        layers=tuple(layers),
        texcoords=np.concatenate(texcoords),
        irregular_id=np.where(irregular, np.cumsum(irregular) - 1, -1).astype(np.int32),
        edge_row=edge_row,
        corner_row=corner_row,
        side_row=side_row,
        sector_row=sector_row,
        num_edges=sum(len(layer.ends) for layer in layers),
        seam_id=seam_id,
        seam_edges=seam_edges,
        seam_corners=seam_corners,
    )
    return surface, warnings


def _rows(layers: list[Layer], sharing: list[Sharing]) -> tuple[I32, I32]:
    """Surface.edge_row and corner_row of all layers: sides 0 and 1 of a face run with the parameter, 2 and 3 against it."""
    edges, corners, edge_base, corner_base = [], [], 0, 0
    for layer, shared in zip(layers, sharing, strict=True):
        with_edge = (layer.along == 1) == (np.arange(4) < 2)
        row = shared.edge + edge_base
        edges.append(np.where(with_edge, row, ~row)[:, SIDE_OF_EDGE].astype(np.int32))
        corners.append((shared.corner + corner_base)[:, CORNER_ORDER].astype(np.int32))
        edge_base, corner_base = edge_base + shared.num_edges, corner_base + shared.num_corners
    return np.concatenate(edges), np.concatenate(corners)


def _seams(layers: list[Layer], texcoords: list[F32]) -> tuple[I32, F32, F32]:
    """Surface.seam_id, seam_edges and seam_corners, from the texture coordinates of each layer's patches."""
    edges, corners, touched = [], [], []
    for layer, coords in zip(layers, texcoords, strict=True):
        own = coords[:, CORNER_ORDER]  # at the corners of the face; the order is its own inverse
        sides = np.stack([own, np.roll(own, -1, axis=1)], 2)  # (M, 4, 2, 2): side k, its ends as the face runs
        against = layer.along == 0
        with_edge = np.where(against[..., None, None], sides[:, :, ::-1], sides).reshape(-1, 2, 2)
        _, first, edge = np.unique(layer.edge, return_index=True, return_inverse=True)
        owner = with_edge[first][edge.reshape(layer.edge.shape)]
        # The patch's parameter runs with sides 0 and 1 and against the others.
        turned = against != (np.arange(4) >= 2)
        edges.append(np.where(turned[..., None, None], owner[:, :, ::-1], owner)[:, SIDE_OF_EDGE])
        plain = np.where((np.arange(4) >= 2)[:, None, None], sides[:, :, ::-1], sides)[:, SIDE_OF_EDGE]
        _, first, vertex = np.unique(layer.quad, return_index=True, return_inverse=True)
        corners.append(own.reshape(-1, 2)[first][vertex.reshape(layer.quad.shape)][:, CORNER_ORDER])
        touched.append((edges[-1] != plain).any((1, 2, 3)) | (corners[-1] != coords).any((1, 2)))
    seam = np.concatenate(touched)
    return (
        np.where(seam, np.cumsum(seam) - 1, -1).astype(np.int32),
        np.ascontiguousarray(np.concatenate(edges)[seam], np.float32),
        np.ascontiguousarray(np.concatenate(corners)[seam], np.float32),
    )


def _settled(cage: Cage) -> Cage:
    """The cage with every tag smooth or infinitely sharp."""
    return cage._replace(
        crease_sharpness=np.where(cage.crease_sharpness >= 1, np.float32(np.inf), np.float32(0)),
        corner_sharpness=np.where(cage.corner_sharpness >= 1, np.float32(np.inf), np.float32(0)),
    )


def _refuse_valence_two(t: Topology, rings: Rings, steps: list[refine.Step]) -> None:
    two = (np.diff(rings.first) == 2) & (rings.closed == 1)
    if two.any():
        v = int(t.vertex[rings.corner[rings.first[int(np.argmax(two))]]])
        where = "" if not steps else f" (numbered after {len(steps)} steps)"
        raise TopologyFault(f"vertex {v}{where} is inside the mesh and has two faces; allowed: three or more")


def _corner_valence(t: Topology, rings: Rings) -> np.ndarray:
    """Faces in the sector of each half-edge's vertex, negative where the sector is open."""
    k = np.diff(rings.first)
    return np.where(rings.closed == 1, k, -k)[rings.sector]


def _ordinary_faces(t: Topology, rings: Rings) -> np.ndarray:
    """Four interior vertices of valence 4, nothing sharp."""
    sharp = (np.bincount(t.vertex, t.edge_sharpness[t.edge] + t.edge_sharpness[t.edge[t.prev]]) > 0)[t.vertex]
    fine = (_corner_valence(t, rings) == 4) & ~sharp & (rings.kind[t.vertex] == VertexKind.SMOOTH)
    return fine.reshape(-1, 4).all(1)


def _regular_faces(t: Topology, rings: Rings) -> np.ndarray:
    """Faces whose patch is the exact limit surface (spec section 1), sharp creases counted as boundaries."""
    valence, kind = _corner_valence(t, rings), rings.kind[t.vertex]
    ends = t.vertex[np.stack([t.half_edges[:, 0], t.next[t.half_edges[:, 0]]])]
    at_sharp = np.zeros(len(rings.kind), bool)
    at_sharp[ends[:, t.edge_sharpness > 0]] = True
    fine = (valence == 4) & (kind == VertexKind.SMOOTH) & ~at_sharp[t.vertex]
    fine |= (valence == -2) & (kind == VertexKind.CREASE)
    fine |= (valence == -1) & (kind == VertexKind.CORNER)
    return fine.reshape(-1, 4).all(1)


def _texcoords(cage: Cage, faces: np.ndarray) -> F32:
    return np.ascontiguousarray(cage.texcoords.reshape(-1, 4, 2)[faces][:, CORNER_ORDER], np.float32)


def _make_layer(level: int, t: Topology, rings: Rings, regular: np.ndarray, faces: np.ndarray, basis: Basis) -> Layer:
    corners = (4 * faces[:, None] + np.arange(4)).astype(np.int64)
    turn, fullness, reach = limit.sector_numbers(t, rings)
    edge, sector = t.edge[corners], rings.sector[corners]
    smooth = (t.half_edges[:, 1] >= 0) & (t.edge_sharpness == 0)
    is_regular = regular[faces]
    # Edges that are not at a regular corner take a Gregory point from the tangent.
    wanted = np.zeros(len(rings.closed), bool)
    wanted[sector[~is_regular]] = True
    ends, end_corner = _edge_ends(t, smooth)
    end_sector = rings.sector[np.maximum(end_corner, 0)]
    valence = _corner_valence(t, rings)[np.maximum(end_corner, 0)]
    kind = rings.kind[ends[:, :2]]
    plain = ((valence == 4) & (kind == VertexKind.SMOOTH)) | ((valence == -2) & (kind == VertexKind.CREASE))
    by_tangent = (smooth[:, None] & ~plain) if basis == Basis.GREGORY else np.zeros_like(plain)
    touched = np.zeros(len(smooth), bool)
    touched[edge] = True
    by_tangent &= touched[:, None]
    wanted[end_sector[by_tangent]] = True
    rows, row = limit.tangent_rows(t, rings, wanted)
    tangent = _tangent_of_corner(rings, row, corners)
    # The first end's tangent leaves along its half-edge; the second's runs back along the half-edge that arrives.
    of_end = _tangent_of_corner(rings, row, end_corner)
    end_tangent = np.where(by_tangent, np.stack([of_end[:, 0, 0], of_end[:, 1, 1]], 1), -1)
    cut = np.flatnonzero(~smooth & (t.half_edges[:, 1] >= 0))
    second = np.full(len(ends), -1)
    second[cut] = len(ends) + np.arange(len(cut))
    side = np.where((second[edge] >= 0) & (t.half_edges[edge, 0] != corners), second[edge], edge)
    return Layer(
        level=level,
        quad=t.vertex[corners],
        edge=edge,
        along=(t.half_edges[edge, 0] == corners).astype(np.uint8),
        smooth=smooth[edge].astype(np.uint8),
        turn=turn[sector],
        fullness=fullness[sector],
        tangent=tangent.astype(np.int32),
        regular=is_regular.astype(np.uint8),
        joined=_share(edge, np.where(smooth[edge], 0, corners), len(ends), t.vertex[corners], sector, len(rings.kind)),
        sided=_share(side, side, len(ends) + len(cut), sector, sector, len(rings.closed)),
        ends=ends.astype(np.int32),
        end_fullness=fullness[end_sector],
        end_tangent=end_tangent.astype(np.int32),
        end_reach=reach[end_sector],
        position=limit.position_rows(t, rings),
        tangents=rows,
    )


def _edge_ends(t: Topology, smooth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Layer.ends, and the corners (E, 2) of the first side's face at both ends."""
    h, g = t.half_edges[:, 0], np.where(smooth, t.half_edges[:, 1], -1)
    b = t.next[h]
    across = np.stack([t.vertex[t.next[t.next[g]]], t.vertex[t.prev[g]]], 1)
    across[g < 0] = -1
    ends = np.stack([t.vertex[h], t.vertex[b], t.vertex[t.prev[h]], t.vertex[t.next[b]]], 1)
    return np.concatenate([ends, across], 1), np.stack([h, b], 1)


def _tangent_of_corner(rings: Rings, row: I32, corners: np.ndarray) -> np.ndarray:
    """Rows of the limit tangents along the edges that leave and enter a corner; -1 where there are none."""
    sector = rings.sector[corners]
    size = np.diff(rings.first)[sector]
    place = rings.place[corners]
    after = np.where((rings.closed[sector] == 1) & (place + 1 == size), 0, place + 1)
    base = row[sector]
    return np.where(base[..., None] < 0, -1, base[..., None] + np.stack([place, after], -1))


def _share(
    edge: np.ndarray,
    edge_part: np.ndarray,
    num_edges: int,
    corner: np.ndarray,
    corner_part: np.ndarray,
    num_corners: int,
) -> Sharing:
    """Sharing of rows that are made of one share for each of their parts: sides of an edge, sectors of a vertex."""
    writes = _first_writes(edge, edge_part), _first_writes(corner, corner_part)
    return Sharing(edge.astype(np.int32), writes[0], corner.astype(np.int32), writes[1], num_edges, num_corners)


def _first_writes(item: np.ndarray, part: np.ndarray) -> U8:
    """1 where an item is met for the first time, in patch order; 2 where another part of it is, 0 elsewhere."""
    flat, parts = item.ravel().astype(np.int64), part.ravel().astype(np.int64)
    writes = np.zeros(len(flat), np.uint8)
    order = np.lexsort((np.arange(len(flat)), parts, flat))
    new = np.concatenate([[True], (flat[order][1:] != flat[order][:-1]) | (parts[order][1:] != parts[order][:-1])])
    writes[order[new]] = 2
    _, first = np.unique(flat, return_index=True)
    writes[first] = 1
    return writes.reshape(item.shape)
