"""Where the surface of a patch faces the eye, without any of the tests: what a back-patch cull is checked against."""

import math

import numpy as np

from pipeline import primitives
from pipeline.tessellator import make_patterns
from pipeline.types import (
    F32,
    F64,
    I32,
    I64,
    DisplacementMaps,
    FaceCull,
    HullInput,
    Partitioning,
    Patches,
    Patterns,
    TessFactors,
)
from tiler import front_end
from tiler.host import Host
from tiler.scene.camera import Camera


def _bernstein(t: F64, degree: int) -> F64:
    """Bernstein polynomials of `degree` at t, float64[n, degree + 1]."""
    k = np.arange(degree + 1)
    choose = np.array([math.comb(degree, i) for i in k], float)
    return choose * t[:, None] ** k * (1.0 - t[:, None]) ** (degree - k)


def surface_facing(control_points: F32, uv: F64, eye: F64) -> F64:
    """Cosine between the normal of the smooth base surface and the way to the eye at (u, v), in float64.

    control_points : float32[n, 4, 4, 4]. uv : float64[n, m, 2]. Returns float64[n, m], positive where the front is seen;
    -1 where the surface has no normal.
    """
    cosines = np.full(uv.shape[:2], -1.0)
    with np.errstate(all="ignore"):
        for k, (net, points) in enumerate(zip(control_points.astype(np.float64), uv, strict=True)):
            a = net - np.append(eye, 0.0) * net[..., 3:]  # homogeneous points about the eye: w (p - e)
            b = [_bernstein(t, 3) for t in points.T]
            q = [_bernstein(t, 2) for t in points.T]
            value = np.einsum("ni,nj,ijc->nc", b[0], b[1], a)
            du = np.einsum("ni,nj,ijc->nc", q[0], b[1], np.diff(a, axis=0))
            dv = np.einsum("ni,nj,ijc->nc", b[0], q[1], np.diff(a, axis=1))
            p, w = value[:, :3] / value[:, 3:], value[:, 3:]
            normal = np.cross(_unit((du[:, :3] - du[:, 3:] * p) / w), _unit((dv[:, :3] - dv[:, 3:] * p) / w))
            length = np.linalg.norm(normal, axis=1)
            cosine = -(_unit(p) * normal).sum(axis=1) / length
            cosines[k] = np.where(length > 1e-9, cosine, -1.0)
    return cosines


def _unit(a: F64) -> F64:
    largest = abs(a).max(axis=-1, keepdims=True)
    a = a / largest
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


CUTTING = 0xFF & ~0b1111  # outcodes of near, far, the guard band and what is not finite

DENSE = 48  # cells along a side of a patch, for the facing of displaced surfaces
SURFACE_NOISE = 1e-9  # cosine: float64 rounding of `surface_facing`
DENSE_NOISE = 0.05  # cosine: what small triangles may be turned against the surface


def grid_patterns(patches: int, domain: F64, side: int) -> Patterns:
    """The same grid of (side + 1)^2 points, multiples of 2^-16, over each patch's domain float64[P, 4]; no triangles."""
    t = np.arange(side + 1) / side
    ends = np.rint(domain * 65536.0)
    u = np.rint(ends[:, :1] + t * (ends[:, 1:2] - ends[:, :1])) / 65536.0
    v = np.rint(ends[:, 2:3] + t * (ends[:, 3:] - ends[:, 2:3])) / 65536.0
    uv = np.empty((2, patches, side + 1, side + 1), np.float32)
    uv[0], uv[1] = u[:, :, None], v[:, None, :]
    return point_patterns(uv.reshape(2, patches, -1))


def point_patterns(uv: F32) -> Patterns:
    """Patterns without triangles: patch p has the points uv[:, p], float32[2, P, m]."""
    patches, m = uv.shape[1:]
    return Patterns(
        np.arange(patches, dtype=np.int32),
        np.ascontiguousarray(uv.reshape(2, -1)),
        np.arange(patches + 1, dtype=np.int64) * m,
        np.zeros(0, np.uint16),
        np.zeros(patches + 1, np.int64),
    )


def _about_themselves(patches: Patches, eye: F64) -> tuple[Patches, F64]:
    """Patches moved to their first control point, and where that puts the eye for each, float64[P, 3].

    Far from the origin float32 rounds more than small triangles are large; the surface itself faces where it did.
    """
    cp = patches.control_points.astype(np.float64)
    inner, gregory = patches.inner.astype(np.float64), np.flatnonzero(patches.gregory_id >= 0)
    with np.errstate(all="ignore"):
        first = cp[:, 0, 0, :3] / cp[:, 0, 0, 3:]
        cp[..., :3] -= first[:, None, None] * cp[..., 3:]
        inner[patches.gregory_id[gregory]] -= first[gregory, None, None]
        moved = patches._replace(control_points=cp.astype(np.float32), inner=inner.astype(np.float32))
    return moved, eye - first


def facing(stage: HullInput, rows: I32, maps: DisplacementMaps, host: Host) -> tuple[F64, F64]:
    """Where the surface of each of some patches faces the eye most: cosine float64[n], and (u, v) float64[n, 2].

    Of the smooth base surface in float64 where nothing is displaced; of small triangles, by the production domain shader,
    where something is. What exceeds the cosine's noise is surely front-facing; the noise is taken off already.
    """
    n = len(rows)
    cosine, where = np.full(n, -1.0), np.zeros((n, 2))
    if n == 0:
        return cosine, where
    some = stage.patches.take(rows)
    grid = grid_patterns(n, stage.domain[rows], DENSE)
    uv = grid.uv.reshape(2, n, -1).transpose(1, 2, 0).astype(np.float64)
    sign = -1.0 if stage.face_cull == int(FaceCull.FRONT) else 1.0
    plain = np.flatnonzero(some.map_id < 0)
    if len(plain):
        turned = some.control_points[plain] if sign > 0 else some.control_points[plain].transpose(0, 2, 1, 3)
        at = uv[plain] if sign > 0 else uv[plain][..., ::-1]  # exchanging u and v exchanges front and back
        all_of_them = surface_facing(turned, at, stage.eye)
        best = all_of_them.argmax(axis=1)
        cosine[plain] = all_of_them.max(axis=1) - SURFACE_NOISE
        where[plain] = uv[plain, best]
    bumpy = np.flatnonzero(some.map_id >= 0).astype(np.int32)
    if len(bumpy):
        camera = Camera(np.eye(4, dtype=np.float32), stage.eye, 0.0, 0.0)
        moved, eyes = _about_themselves(some, stage.eye)
        points = front_end.shade_domain_points(bumpy, moved, grid, maps, camera, host).clip[:3].astype(np.float64)
        p = points.reshape(3, len(bumpy), DENSE + 1, DENSE + 1)
        side_u, side_v = p[:, :, 1:, :-1] - p[:, :, :-1, :-1], p[:, :, :-1, 1:] - p[:, :, :-1, :-1]
        with np.errstate(all="ignore"):
            to_eye = eyes[bumpy].T[:, :, None, None] - p[:, :, :-1, :-1]
            normal = np.cross(side_u, side_v, axis=0)
            length = np.sqrt((normal**2).sum(axis=0) * (to_eye**2).sum(axis=0))
            cosines = np.nan_to_num(sign * (normal * to_eye).sum(axis=0) / length, nan=-1.0).reshape(len(bumpy), -1)
        best = cosines.argmax(axis=1)
        cosine[bumpy] = cosines.max(axis=1) - DENSE_NOISE
        corner = best // DENSE * (DENSE + 1) + best % DENSE
        where[bumpy] = uv[bumpy, corner]
    return cosine, where


def sort_back_patch_cull(stage: HullInput, cosine: float) -> bool:
    """Whether a back-patch cull is wrong for the surface itself: no face is dropped at all, or the surface is seen."""
    return stage.face_cull == int(FaceCull.NONE) or cosine > 0.0


def front_triangles(stage: HullInput, rows: I32, host: Host) -> I64:
    """How many triangles of each of some patches, at the stage's factors, would pass the face cull: int64[n].

    By the production tessellator, domain shader and snap; a triangle that the clipper would cut counts too, and one of no
    area does not. Patches that a factor culls have none. A stage of ANY partitioning is counted in its worst one.
    """
    if stage.partitioning == Partitioning.ANY:
        each = [front_triangles(stage._replace(partitioning=int(p)), rows, host) for p in Partitioning if p]
        return np.max(each, axis=0)
    name = Partitioning(stage.partitioning).name.lower()
    factors = TessFactors(stage.factors.edge[rows], stage.factors.inside[rows])
    patterns = make_patterns(factors, name, front_end.WINDING)
    live = np.flatnonzero(patterns.of_patch >= 0).astype(np.int32)
    camera = Camera(stage.clip_from_world, stage.eye, 0.0, 0.0)
    points = front_end.shade_domain_points(live, stage.patches.take(rows), patterns, stage.maps, camera, host)
    window = front_end.allocate_window(points.clip.shape[1])
    guard = primitives.guard_band(stage.viewport)
    primitives.project_points(0, points.clip.shape[1], points.clip, stage.viewport, guard, window)
    counts = np.zeros(len(rows), np.int64)
    sign = -1 if stage.face_cull == int(FaceCull.FRONT) else 1
    for k, p in enumerate(live):
        pattern = patterns.of_patch[p]
        part = slice(3 * patterns.first_triangle[pattern], 3 * patterns.first_triangle[pattern + 1])
        corner = points.first[k] + patterns.indices[part].reshape(-1, 3).astype(np.int64)
        x, y = window.x[corner].astype(np.int64), window.y[corner].astype(np.int64)
        area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
        cut = (window.code[corner] & CUTTING).any(axis=1)
        counts[p] = (cut | (sign * area > 0)).sum()
    return counts
