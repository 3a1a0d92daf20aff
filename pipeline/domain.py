"""Domain shader: (u, v) on a bicubic patch to a displaced position in clip space and a unit normal.

The arithmetic is float32 throughout, in an order that is part of the contract (the bounds' error terms count its
roundings, and the slow twin repeats it):

- position: sum over i (along u) for each row j, then over j, by `bezier.sum4`;
- tangents from *differences* of control points, so that they keep their relative accuracy next to collapsed edges; the
  constant factor 3 is left out where only directions are used;
- rational patches: X = (wx, wy, wz) and w are interpolated and divided; a tangent is (dX - dw x) / w, where x is the point
  and d the interpolated differences. So both sides of a shared edge agree here too;
- ACC patches: position as above, tangents from the two tangent patches (`types.Patches`), not divided by 3;
- Gregory patches: as above with the inner control points that (u, v) gives, and the derivatives of these (gregory.py);
- unit normal n of du x dv; where that vanishes (collapsed edges) the normal of a point moved 2^-9 of the way to the
  patch's middle, which is the limit to that accuracy; zero if that vanishes too;
- patches that share their edges' normals (`normal_id`): on an edge n is the edge's (edge_normals.py), but where they are
  displaced by vectors; where it is zero, displaced points are not moved, and others keep the patch's own;
- texture seams that are closed (`seam_id`): on an edge t, or the vector, is that of the edge's lowest patch (seams.py);
- displaced position d = p + t n, or p + L (x, y, z) for a map of vectors, L its `turn`, a row of it summed as
  (L0 x + L1 y) + L2 z; then each clip component ((m0 x + m1 y) + m2 z) + m3;
- the normal handed to the pixel shader is that of the displaced surface to first order in its slope (Blinn 1978):
  p_u x p_v + t_v (p_u x n) + t_u (n x p_v), made unit; n itself where there is no map. Displaced by vectors: d_u x d_v, d_u =
  p_u + the derivative of the vector, a component after the other.

Points are shaded in blocks, in passes over rows of one scratch array (domain_rows.py): the surface (domain_surfaces.py), its
normals where float32 does not tell them (domain_mending.py), the map (domain_lookup.py), and here the rest.
"""

import numpy as np

from pipeline.domain_lookup import locate, look_up
from pipeline.domain_mending import mend_bezier_normals, mend_normals
from pipeline.domain_rows import (
    AX,
    AY,
    AZ,
    BLOCK,
    BX,
    BY,
    BZ,
    CORNERS,
    CW,
    CX,
    CY,
    CZ,
    DX,
    DY,
    DZ,
    GU,
    GV,
    HUGE,
    LANES,
    NETS,
    NX,
    NY,
    NZ,
    ONE,
    PX,
    PY,
    PZ,
    ROW,
    SCRATCH,
    TINY,
    ZERO,
    S,
    T,
    U,
    V,
    filled,
)
from pipeline.domain_surfaces import acc_passes, bezier_passes, find_grid, gregory_passes
from pipeline.edge_normals import SPACE, write_edge_normals
from pipeline.jit import helper, inlined, kernel
from pipeline.prefetch import prefetch
from pipeline.seams import write_seam_values

__all__ = ["BLOCK", "SCRATCH", "shade_patches"]

THREE = np.float32(3.0)
LINE = 16  # numbers in a line of the cache
IN_CACHE = 1 << 16  # points whose places, 28 bytes each, no prefetch brings nearer


@helper
def _row(s, first, n):
    return s[first : first + n]


@inlined
def _to_clip(matrix, s, k, x, y, z):
    """Rows C of point k: the clip position of (x, y, z)."""
    m0, m1, m2, m3 = matrix
    s[CX + k] = ((m0[0] * x + m0[1] * y) + m0[2] * z) + m0[3]
    s[CY + k] = ((m1[0] * x + m1[1] * y) + m1[2] * z) + m1[3]
    s[CZ + k] = ((m2[0] * x + m2[1] * y) + m2[2] * z) + m2[3]
    s[CW + k] = ((m3[0] * x + m3[1] * y) + m3[2] * z) + m3[3]


@inlined
def _matrix_rows(m):
    return (
        (m[0, 0], m[0, 1], m[0, 2], m[0, 3]), (m[1, 0], m[1, 1], m[1, 2], m[1, 3]),
        (m[2, 0], m[2, 1], m[2, 2], m[2, 3]), (m[3, 0], m[3, 1], m[3, 2], m[3, 3]),
    )  # fmt: skip


@inlined
def _put_displaced(scale, matrix, s, k):
    """Point k, displaced by row T along its normal: rows C, its clip position; rows A, unit normal of the displaced surface.

    Derivatives are `scale` times A and B.
    """
    ax, ay, az = s[AX + k], s[AY + k], s[AZ + k]
    bx, by, bz = s[BX + k], s[BY + k], s[BZ + k]
    nx, ny, nz = s[NX + k], s[NY + k], s[NZ + k]
    t, along_u, along_v = s[T + k], s[GU + k], s[GV + k]
    _to_clip(matrix, s, k, s[PX + k] + t * nx, s[PY + k] + t * ny, s[PZ + k] + t * nz)
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    x = scale * cx + (along_v * (ay * nz - az * ny) + along_u * (ny * bz - nz * by))
    y = scale * cy + (along_v * (az * nx - ax * nz) + along_u * (nz * bx - nx * bz))
    z = scale * cz + (along_v * (ax * ny - ay * nx) + along_u * (nx * by - ny * bx))
    square = (x * x + y * y) + z * z
    safe = ((cx * cx + cy * cy) + cz * cz > TINY) & (square > TINY) & (square < HUGE)
    length = np.sqrt(square)
    x, y, z = x / length, y / length, z / length
    s[AX + k], s[AY + k], s[AZ + k] = x if safe else nx, y if safe else ny, z if safe else nz


@inlined
def _displace_pass(scale, matrix, s, n):
    """Rows C and A of points displaced along their normals."""
    rows = _matrix_rows(matrix)
    for k in range(n):
        _put_displaced(scale, rows, s, k)


@inlined
def _clip_pass(matrix, s, n):
    """Rows C of points that stay where they are: adding 0 n would turn NaN normals into cracks."""
    rows = _matrix_rows(matrix)
    for k in range(n):
        _to_clip(rows, s, k, s[PX + k], s[PY + k], s[PZ + k])


@inlined
def _some_unsafe(s, n):
    """Whether some S is 0."""
    count = 0
    for k in range(n):
        count += s[S + k] == ZERO
    return count > 0


@helper
def _vector_pass(factor, texcoords, seams, maps, m, s, ints, places, n, count):
    """Rows P: displaced by the vectors of map m; rows A: unit normal of that surface. Derivatives are `factor` A and B.

    seams : of one or no seam_edges and seam_corners. count : points that are not there to fill up a vector.
    """
    turn, planes = maps.turn[m], maps.planes[m]
    locate(texcoords, maps, planes[0], s, ints, n)
    for r in range(6):
        for k in range(n):
            s[AX + r * ROW + k] = factor * s[AX + r * ROW + k]
    for c in range(3):
        value = DX + c * ROW
        look_up(texcoords, maps, planes[c], value, s, places, n)
        if len(seams[0]) > 0:
            write_seam_values(
                seams[0][0], seams[1][0], maps, planes[c], _row(s, U, count), _row(s, V, count), _row(s, value, count)
            )  # fmt: skip
        for r in range(3):
            along = turn[r, c]
            for k in range(n):
                s[AX + r * ROW + k] += along * s[GU + k]
                s[BX + r * ROW + k] += along * s[GV + k]
    for r in range(3):
        t0, t1, t2 = turn[r, 0], turn[r, 1], turn[r, 2]
        for k in range(n):
            s[PX + r * ROW + k] += (t0 * s[DX + k] + t1 * s[DY + k]) + t2 * s[DZ + k]
    for k in range(n):
        ax, ay, az = s[AX + k], s[AY + k], s[AZ + k]
        bx, by, bz = s[BX + k], s[BY + k], s[BZ + k]
        x0, x1, x2 = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        square = (x0 * x0 + x1 * x1) + x2 * x2
        safe = square > TINY and square < HUGE
        length = np.sqrt(square)
        s[AX + k] = x0 / length if safe else s[NX + k]
        s[AY + k] = x1 / length if safe else s[NY + k]
        s[AZ + k] = x2 / length if safe else s[NZ + k]


@inlined
def _shade_bezier(cp, rational, grid, first, s, count):
    """Surface and normals of a Bezier patch at the points in rows U and V: `count` of them, and what fills up a vector.

    grid, first : as in `domain_surfaces.bezier_passes`.
    """
    n = filled(count)
    bezier_passes(cp, rational, grid, first, s, n)
    if _some_unsafe(s, n):
        mend_bezier_normals(cp, rational, s, n)


@inlined
def _displace_bezier(texcoords, map_id, maps, matrix, s, ints, places, n):
    """What follows `_shade_bezier`. ints, places : s as int32 and as uint32.

    Apart from it, as references to the maps would be counted where some call between might give one back.
    """
    if map_id >= 0:
        locate(texcoords, maps, map_id, s, ints, n)
        look_up(texcoords, maps, map_id, T, s, places, n)
        _displace_pass(THREE, matrix, s, n)
    else:
        _clip_pass(matrix, s, n)


@helper
def _shade_surface(shape, edges, texcoords, map_id, maps, matrix, grid, first, s, ints, places, count):
    """Both, for any patch.

    shape : control points, rational, and arrays of one or no tangent_u, tangent_v and inner. edges : of one or no edge_row
    and corner_row, edge_normals and corner_normals, and of one or no seam_edges and seam_corners.
    """
    n = filled(count)
    cp, rational, tu, tv, inner = shape
    if len(tu) > 0:
        acc_passes(cp, tu[0], tv[0], grid, first, s, n)
    elif len(inner) > 0:
        gregory_passes(cp, inner[0], s, n)
    else:
        bezier_passes(cp, rational, grid, first, s, n)
    if _some_unsafe(s, n):
        mend_normals(shape, s, n)
    factor = ONE if len(tu) > 0 else THREE
    by_vectors = map_id >= 0 and maps.planes[map_id, 0] >= 0
    u, v = _row(s, U, count), _row(s, V, count)
    if by_vectors:
        _vector_pass(factor, texcoords, (edges[4], edges[5]), maps, map_id, s, ints, places, n, count)
    elif len(edges[0]) > 0:
        write_edge_normals(
            edges[0][0], edges[1][0], edges[2], edges[3], map_id < 0, u, v, _row(s, NX, count), _row(s, NY, count),
            _row(s, NZ, count), _row(s, CX, SPACE),
        )  # fmt: skip
    if map_id >= 0 and not by_vectors:
        locate(texcoords, maps, map_id, s, ints, n)
        look_up(texcoords, maps, map_id, T, s, places, n)
        if len(edges[4]) > 0:
            write_seam_values(edges[4][0], edges[5][0], maps, map_id, u, v, _row(s, T, count))
        _displace_pass(factor, matrix, s, n)
    else:
        _clip_pass(matrix, s, n)


@helper
def _one(table, row):
    """The row as an array of one; of none for row -1."""
    return table[row : row + 1]


@helper
def _shape_of(patches, p):
    """What `_shade_surface` must know of the form of patch p, and of its edges."""
    tangents, shared = patches.tangent_id[p], patches.normal_id[p]
    shape = (
        patches.control_points[p], patches.rational[p], _one(patches.tangent_u, tangents),
        _one(patches.tangent_v, tangents), _one(patches.inner, patches.gregory_id[p]),
    )  # fmt: skip
    edges = (
        _one(patches.edge_row, shared), _one(patches.corner_row, shared), patches.edge_normals, patches.corner_normals,
        _one(patches.seam_edges, patches.seam_id[p]), _one(patches.seam_corners, patches.seam_id[p]),
    )  # fmt: skip
    return shape, edges


@inlined
def _load_points(uv, first, n, s):
    """Rows U and V: the points first .. first + n - 1; a full vector and one more are filled up with the last of them."""
    first = np.uint64(first)  # an index without a sign needs no test
    for i in range(n):
        s[U + i], s[V + i] = uv[0, first + np.uint64(i)], uv[1, first + np.uint64(i)]
    for i in range(n, filled(n) + LANES):
        s[U + i], s[V + i] = s[U + n - 1], s[V + n - 1]


@inlined
def _store_row(s, row, out, c, first, n):
    for i in range(n):
        out[c, first + np.uint64(i)] = s[row + i]


@inlined
def _store_points(points, first, displaced, s, n):
    """What was found of the n points, into their places from `first` on."""
    first = np.uint64(first)
    for c in range(4):
        _store_row(s, CX + c * ROW, points.clip, c, first, n)
    for c in range(3):
        if displaced:
            _store_row(s, AX + c * ROW, points.normal, c, first, n)
        else:
            _store_row(s, NX + c * ROW, points.normal, c, first, n)


@inlined
def _ask_for_room(points, first, n):
    """Ask for the places of the n points from `first` on, which the next block will write."""
    for k in range(first, first + n, LINE):
        for c in range(4):
            prefetch(points.clip, c * points.clip.shape[1] + k)
        for c in range(3):
            prefetch(points.normal, c * points.normal.shape[1] + k)


@inlined
def _copy_patch(patches, p, cp, texcoords):
    """Control points and texture coordinates of patch p: slices of its own would be counted references, slow ones."""
    for i in range(4):
        for j in range(4):
            for c in range(4):
                cp[i, j, c] = patches.control_points[p, i, j, c]
        for c in range(2):
            texcoords[i, c] = patches.texcoords[p, i, c]


@inlined
def _block_length(first, end):
    """Points of the next block of first .. end-1: blocks of about equal length, whole vectors all but the last."""
    count = end - first
    return min(count, filled(-(-count // max(-(-count // BLOCK), 1))))


@kernel
def shade_patches(begin, end, live, patches, patterns, maps, matrix, points, scratch):
    """Shade every domain point of live patches begin .. end-1 into `points` (modified in place).

    live : int32[...], patch numbers in submit order. patches : world space. matrix : float32[4, 4], world to clip.
    scratch : float32[SCRATCH], the caller's, one for each thread.
    """
    last, grid, loaded = -1, (0, 0, 0), (-1, -1)
    ints, places = scratch.view(np.int32), scratch.view(np.uint32)
    cp, texcoords = scratch[NETS:CORNERS].reshape(4, 4, 4), scratch[CORNERS:SCRATCH].reshape(4, 2)
    for k in range(begin, end):
        p = live[k]
        pattern = patterns.of_patch[p]
        source = patterns.first_point[pattern]
        count = patterns.first_point[pattern + 1] - source
        if pattern != last:
            end = source + count
            last, grid = pattern, find_grid(patterns.uv[0, source:end], patterns.uv[1, source:end], scratch)
        map_id = patches.map_id[p]
        _copy_patch(patches, p, cp, texcoords)
        plain = (
            patches.tangent_id[p] < 0
            and patches.gregory_id[p] < 0
            and patches.normal_id[p] < 0
            and (map_id < 0 or (patches.seam_id[p] < 0 and maps.planes[map_id, 0] < 0))
        )
        first = 0
        while first < count:
            n = _block_length(first, grid[0] if first < grid[0] else count)
            if (pattern, first) != loaded:
                _load_points(patterns.uv, source + first, n, scratch)
                loaded = (pattern, first)
            if points.clip.shape[1] > IN_CACHE:
                _ask_for_room(points, points.first[k] + first + n, n)
            if plain:
                _shade_bezier(cp, patches.rational[p], grid, first, scratch, n)
                _displace_bezier(texcoords, map_id, maps, matrix, scratch, ints, places, filled(n))
            else:
                shape, edges = _shape_of(patches, p)
                _shade_surface(shape, edges, texcoords, map_id, maps, matrix, grid, first, scratch, ints, places, n)
            _store_points(points, points.first[k] + first, map_id >= 0, scratch, n)
            first += n
