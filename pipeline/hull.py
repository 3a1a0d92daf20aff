"""Hull shader, patch-constant phase: non-finite patches, tessellation factors, and the list of patches that live on.

The control-point phase of a Bezier patch hands its 16 control points through; that of a subdivision surface is
pipeline/subdivision/control_points.py, of which `surface_patches` makes patches.
"""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.culling import CULL_TESTS
from pipeline.jit import helper, kernel
from pipeline.minmax import build_pyramids
from pipeline.subdivision.control_points import run_control_points
from pipeline.subdivision.surface import Basis, Surface
from pipeline.types import (
    B1,
    F32,
    F64,
    I32,
    U8,
    CullFlag,
    DisplacementMaps,
    FaceCull,
    HullInput,
    Partitioning,
    PatchBounds,
    Patches,
    Pyramids,
    Slopes,
    TessFactors,
    Viewport,
)


@kernel
def _find_finite(rows, out):
    for r in range(len(rows)):
        bad = 0
        for k in range(rows.shape[1]):
            bad |= 0 if rows[r, k] - rows[r, k] == 0.0 else 1
        out[r] = bad == 0


def _finite_rows(table: F32) -> B1:
    """Which rows of the first axis hold finite numbers alone."""
    fine = np.empty(len(table), np.bool_)
    with np.errstate(invalid="ignore"):  # where nothing is compiled
        _find_finite(np.ascontiguousarray(table).reshape(len(table), math.prod(table.shape[1:])), fine)
    return fine


def flag_nonfinite(patches: Patches, ranges: F64) -> U8:
    """Cull flags, uint8[P]: NONFINITE for patches with a NaN or infinity in what the domain shader reads of them.

    That is control points, tangent patches, inner points, and where they are displaced texcoords, map, and shared normals.

    ranges : float64[L, 2] of `displacement.map_ranges`, NaN for a map that holds a NaN or infinity.
    """
    fine = _finite_rows(patches.control_points)
    for table, row in (
        (patches.tangent_u, patches.tangent_id),
        (patches.tangent_v, patches.tangent_id),
        (patches.inner, patches.gregory_id),
    ):
        if len(table):
            fine &= np.append(_finite_rows(table), True)[row]  # the last one answers row -1
    displaced = patches.map_id >= 0
    if displaced.any():
        map_fine = np.append(np.isfinite(ranges).all(axis=1), True)  # the last one answers map_id = -1
        fine &= map_fine[patches.map_id] & (_finite_rows(patches.texcoords) | ~displaced)
        if len(patches.edge_row):
            fine &= _fine_edges(patches)[patches.normal_id] | ~displaced
    return np.where(fine, np.uint8(CullFlag.ALIVE), np.uint8(CullFlag.NONFINITE))


def _fine_edges(patches: Patches) -> B1:
    """Which rows of edge_row and corner_row name finite normals alone; one more, true, answers row -1."""
    edges, corners = _finite_rows(patches.edge_normals), _finite_rows(patches.corner_normals)
    if edges.all() and corners.all():  # as nearly always
        return np.ones(len(patches.edge_row) + 1, np.bool_)
    edge = np.where(patches.edge_row >= 0, patches.edge_row, ~patches.edge_row)
    return np.append(edges[edge].all(axis=1) & corners[patches.corner_row].all(axis=1), True)


def surface_patches(surface: Surface, vertices: F32, map_id: int, object_id: int, close_seams: bool = False) -> Patches:
    """Control-point phase: patches of a subdivision surface, of its control mesh's points float32[V, 3] in world space.

    close_seams : displace edges and vertices by the texture coordinates of the lowest of their patches.
    """
    made = run_control_points(surface, vertices, map_id >= 0)
    n = surface.num_patches
    none, all_of_them = np.full(n, -1, np.int32), np.arange(n, dtype=np.int32)
    return Patches(
        control_points=made.control_points,
        rational=np.zeros(n, np.uint8),
        texcoords=surface.texcoords,
        map_id=np.full(n, map_id, np.int32),
        object_id=np.full(n, object_id, np.int32),
        tangent_id=surface.irregular_id if surface.basis == Basis.ACC else none,
        gregory_id=surface.irregular_id if surface.basis == Basis.GREGORY else none,
        tangent_u=made.tangent_u,
        tangent_v=made.tangent_v,
        inner=made.inner,
        normal_id=all_of_them,
        edge_row=surface.edge_row if map_id >= 0 else surface.side_row,
        corner_row=surface.corner_row if map_id >= 0 else surface.sector_row,
        edge_normals=made.edge_normals,
        corner_normals=made.corner_normals,
        normal_slack=made.normal_slack,
        seam_id=surface.seam_id if close_seams and map_id >= 0 else none,
        seam_edges=surface.seam_edges,
        seam_corners=surface.seam_corners,
    )


def num_control_points(patches: Patches) -> int:
    """Runs of the control-point phase: 16 for a Bezier patch, 20 for a Gregory patch, 32 for one with tangent patches.

    Those 32 are the 16 points and the 16 tangent control vectors that do not follow from them: the middle row of each
    tangent patch is a difference of points. 32 is also the most that D3D11 lets a hull shader put out.
    """
    acc, gregory = (int(np.count_nonzero(row >= 0)) for row in (patches.tangent_id, patches.gregory_id))
    return 16 * len(patches.control_points) + 16 * acc + 4 * gregory


def join_patches(parts: Sequence[Patches]) -> Patches:
    """The patches of all parts, one part after the other, with one set of tables."""
    if len(parts) == 1:
        return parts[0]
    fields: dict[str, list[np.ndarray]] = {name: [] for name in Patches._fields}
    for part in parts:
        size = {name: sum(map(len, fields[name])) for name in fields}  # rows of each table so far
        for name, values in part._asdict().items():
            base = size[_TABLE_OF[name]] if name in _TABLE_OF else 0
            if name == "edge_row":  # ~row where against: the complement moves the other way
                values = np.where(values >= 0, values + base, values - base)
            elif base:
                values = np.where(values >= 0, values + base, values)
            fields[name].append(values.astype(np.int32) if base else values)
    return Patches(**{name: np.concatenate(values) for name, values in fields.items()})


# Rows of which table a field holds.
_TABLE_OF = {
    "tangent_id": "tangent_u",
    "gregory_id": "inner",
    "normal_id": "edge_row",
    "edge_row": "edge_normals",
    "corner_row": "corner_normals",
    "seam_id": "seam_edges",
}


def make_input(
    patches: Patches,
    maps: DisplacementMaps,
    clip_from_world: F32,
    viewport: Viewport,
    *,
    pyramids: Pyramids | None = None,
    slopes: Slopes | None = None,
    eye: F64 | None = None,
    domain: F64 | None = None,
    factors: TessFactors | None = None,
    face_cull: FaceCull = FaceCull.NONE,
    partitioning: Partitioning = Partitioning.ANY,
) -> HullInput:
    """The input of bounds and cull tests, with what is not given: whole patches, factors 1, no eye, no face cull.

    partitioning : how the tessellator will round the factors; what is said of ANY holds for all.
    Raises ValueError for a rational patch with tangent patches or Gregory points: there are none, nothing is right for them.
    """
    n = len(patches.control_points)
    mixed = (patches.rational != 0) & ((patches.tangent_id >= 0) | (patches.gregory_id >= 0))
    if mixed.any():
        raise ValueError(
            f"rational: patch {int(np.argmax(mixed))} is rational and an ACC or Gregory patch; allowed: weights 1 there"
        )
    return HullInput(
        patches=patches,
        maps=maps,
        pyramids=build_pyramids(maps) if pyramids is None else pyramids,
        slopes=slopes,
        clip_from_world=clip_from_world,
        eye=np.full(3, np.nan) if eye is None else np.asarray(eye, np.float64),
        viewport=viewport,
        domain=np.tile([0.0, 1.0, 0.0, 1.0], (n, 1)) if domain is None else domain,
        factors=fixed_factors(n, (1.0,) * 6) if factors is None else factors,
        face_cull=int(face_cull),
        partitioning=int(partitioning),
    )


def run_cull_tests(names: Sequence[str], stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Run the named tests of `CULL_TESTS` in order; each flags patches that are still alive (`flags` in place)."""
    for name in names:
        CULL_TESTS[name](stage, bounds, flags)


def part_of(stage: HullInput, begin: int, end: int) -> HullInput:
    """The input of patches begin .. end alone, in the memory of all."""
    rows = slice(begin, end)
    return stage._replace(
        patches=stage.patches.take(rows),
        domain=stage.domain[rows],
        factors=TessFactors(stage.factors.edge[rows], stage.factors.inside[rows]),
    )


def fixed_factors(num_patches: int, factor: Sequence[float]) -> TessFactors:
    """The same six factors (SV_TessFactor order, then inside u, v) for every patch."""
    six = np.asarray(factor, np.float32)
    return TessFactors(np.tile(six[:4], (num_patches, 1)), np.tile(six[4:], (num_patches, 1)))


@helper
def _screen_point(cp, e, k, matrix, half_width, half_height, least_w):
    """Control point k of edge e in pixels from the middle of the picture, as if at least `least_w` before the eye."""
    corner = 0 if e < 2 else 3
    i, j = (corner, k) if e % 2 == 0 else (k, corner)
    w = np.float64(cp[i, j, 3])
    x, y, z = cp[i, j, 0] / w, cp[i, j, 1] / w, cp[i, j, 2] / w
    clip_x = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]
    clip_y = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]
    clip_w = max(matrix[3, 0] * x + matrix[3, 1] * y + matrix[3, 2] * z + matrix[3, 3], least_w)
    return clip_x / clip_w * half_width, clip_y / clip_w * half_height


@helper
def _length(a, b):
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.sqrt(dx * dx + dy * dy)


@helper
def _edge_factor(a, b, c, d, edge_pixels, most):
    """Segments for the control polygon a b c d (pixels). The outer legs are added first: reversing the edge changes no bit."""
    length = (_length(a, b) + _length(c, d)) + _length(b, c)
    factor = length / edge_pixels
    return np.float32(min(factor, most)) if factor >= 1.0 else np.float32(1.0)  # 1 for NaN too


@kernel
def _screen_factors(control_points, matrix, half_width, half_height, least_w, edge_pixels, most, edge, inside):
    for p in range(len(control_points)):
        cp = control_points[p]
        for e in range(4):
            a = _screen_point(cp, e, 0, matrix, half_width, half_height, least_w)
            b = _screen_point(cp, e, 1, matrix, half_width, half_height, least_w)
            c = _screen_point(cp, e, 2, matrix, half_width, half_height, least_w)
            d = _screen_point(cp, e, 3, matrix, half_width, half_height, least_w)
            edge[p, e] = _edge_factor(a, b, c, d, edge_pixels, most)
        inside[p, 0] = max(edge[p, 1], edge[p, 3])
        inside[p, 1] = max(edge[p, 0], edge[p, 2])


def screen_factors(
    control_points: F32, clip_from_world: F32, viewport: Viewport, least_w: float, edge_pixels: float, most: float
) -> TessFactors:
    """Factors that cut each edge into segments of about `edge_pixels` on the screen.

    An edge's length is that of its control polygon in pixels, undisplaced, with every point taken to be at least
    `least_w` (clip-space w, e.g. the near distance) in front of the eye. It depends on the edge's own control points
    alone and not on their direction, so both sides of a shared edge get the same factor. Inside factors are the larger of
    the two edges that run along them. Factors lie in [1, most].
    """
    edge = np.empty((len(control_points), 4), np.float32)
    inside = np.empty((len(control_points), 2), np.float32)
    half_width, half_height = viewport.width * 0.5, viewport.height * 0.5
    _screen_factors(
        control_points, clip_from_world, half_width, half_height, least_w, edge_pixels, most, edge, inside
    )  # fmt: skip
    return TessFactors(edge, inside)


def drop_culled(factors: TessFactors, flags: U8) -> None:
    """Write factor 0 for culled patches, which the tessellator then drops (`factors.edge` modified in place)."""
    factors.edge[flags != CullFlag.ALIVE] = 0.0


def flag_factors(of_patch: I32, flags: U8) -> None:
    """Flag alive patches that the tessellator culled by a factor (`of_patch` -1); `flags` modified in place."""
    flags[(flags == CullFlag.ALIVE) & (of_patch < 0)] = CullFlag.FACTOR


def live_patches(flags: U8) -> I32:
    """Numbers of the patches still alive, int32[live], in submit order."""
    return np.flatnonzero(flags == CullFlag.ALIVE).astype(np.int32)
