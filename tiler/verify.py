"""The conservativeness oracle: every bound and every cull against the vertices that were really shaded.

A frame that is verified is drawn as always, and then once more without any cull: all patches are shaded by the
production domain shader, in clip space and (through the identity matrix, which changes no bit) in world space. Each
bound is compared with every vertex and with every set-up triangle of its patch; each cull with what is visible in the
picture that culls nothing. What does not hold is a `Violation`, with the patch, (u, v), the algorithm and the margin.

The checks of a bound (`CHECKS`), each a margin that must not be negative:

- the float32 world position lies in the oriented box, axis by axis;
- the float32 clip position lies in the hull of the box's clip corners, widened by `slack`, seen along x, y, z, w and along
  the distances from the planes w + x, w - x, w + y, w - y, w - z (z itself is the near plane's);
- the snapped window position, clamped to the viewport, lies in `rect`; where `rect` is empty no vertex is on the screen;
- the window depth is at least `z_min`;
- where `inside` is set, no vertex is outside a plane of the frustum;
- the unit normal of the base surface lies in the normal cone, where that is known;
- the samples' box of each set-up triangle lies in `rect`, and its vertices' depths are at least `z_min`.

A bound says "unknown" with NaN, an infinite box, the whole viewport, or `cone_cos = -1`; then there is nothing to break.

A back-patch test answers for the smooth surface. Where it drops a patch of which a coarse triangle faces the eye and
would be seen, while the surface itself does not, that is a *false cull*: counted apart, and no violation.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from pipeline import hull, primitives
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from pipeline.jit import helper, kernel
from pipeline.tessellator import make_patterns
from pipeline.types import (
    F32,
    F64,
    I32,
    I64,
    U8,
    DisplacementMaps,
    DomainPoints,
    FaceCull,
    HullInput,
    PatchBounds,
    Patches,
    Patterns,
    Viewport,
    Window,
)
from tiler import back_end, front_end
from tiler.config import Machine
from tiler.front_end import Geometry
from tiler.grid import make_grid
from tiler.host import Host
from tiler.scene.camera import Camera, camera_at
from tiler.scene.model import Scene
from tiler.tile import NUM_TILE_COUNTS, Target

U = 2.0**-24
ROUNDING = 2.0**-50  # of the float64 arithmetic of the checks themselves, relative
UNIT_ERROR = 8.0 * U  # how far the length of a float32 unit normal may be from 1, with room

CHECKS: tuple[tuple[str, str], ...] = (
    ("box axis 0", "world units"),
    ("box axis 1", "world units"),
    ("box axis 2", "world units"),
    ("clip x", "clip units"),
    ("clip y", "clip units"),
    ("clip z", "clip units"),
    ("clip w", "clip units"),
    ("clip w + x", "clip units"),
    ("clip w - x", "clip units"),
    ("clip w + y", "clip units"),
    ("clip w - y", "clip units"),
    ("clip w - z", "clip units"),
    ("rectangle", "pixels"),
    ("depth", "depth units"),
    ("inside flag", "clip units"),
    ("normal cone", "cosine"),
    ("triangle's rectangle", "pixels"),
    ("triangle's depth", "depth units"),
)
NUM_CHECKS = len(CHECKS)
BOX, CLIP, RECT, DEPTH, INSIDE, CONE, TRIANGLE_RECT, TRIANGLE_DEPTH = 0, 3, 12, 13, 14, 15, 16, 17
NUM_FUNCTIONS = 9  # of clip space, columns CLIP ..
NUM_PLANES = 6
SCRATCH = (5, NUM_FUNCTIONS)  # float64, the caller's, one for each thread

NONFINITE, NOT_BEHIND = primitives.NONFINITE, 0xFF & ~0b1111  # codes other than left, right, bottom, top


@dataclass(frozen=True)
class Violation:
    """One promise that did not hold.

    patch : patch number in submit order. u, v : where on the patch; NaN where no domain point can be named. algorithm :
    name of the bound or cull test. what : the promise that was broken. margin : by how much, negative, in `unit`.
    """

    patch: int
    u: float
    v: float
    algorithm: str
    what: str
    margin: float
    unit: str

    def __str__(self) -> str:
        place = f" at (u, v) = ({self.u:.9g}, {self.v:.9g})" if math.isfinite(self.u + self.v) else ""
        return f"patch {self.patch}{place}: {self.algorithm}: {self.what}, margin {self.margin:.6g} {self.unit}"

    def record(self) -> dict[str, Any]:
        """The violation as JSON has it; null for what is not a finite number."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(self).items()
        }


class Margins(NamedTuple):
    """The smallest margin of each check over the points of each patch; infinite where there was nothing to check."""

    margin: F64  # (n, NUM_CHECKS)
    at: I64  # (n, NUM_CHECKS) number of the point within its patch; -1: none, or a vertex that the clipper made


class Report(NamedTuple):
    """What the verification of a frame found."""

    violations: tuple[Violation, ...]
    false_culls: tuple[Violation, ...]


# Points against a bound


@helper
def _directions(axes, out):
    """Rows 0 .. 2 of `out`: unit vectors along the box's axes, and in column 3 the reach of the box along each.

    A null axis has no direction of its own: it gets one perpendicular to the others.
    """
    for r in range(3):
        length = np.sqrt(axes[r, 0] * axes[r, 0] + axes[r, 1] * axes[r, 1] + axes[r, 2] * axes[r, 2])
        for c in range(3):
            out[r, c] = axes[r, c] / length if length != 0.0 else 0.0
    for r in range(3):
        if out[r, 0] == 0.0 and out[r, 1] == 0.0 and out[r, 2] == 0.0:
            _complete(out, r)
    for r in range(3):
        out[r, 3] = 0.0
        for s in range(3):
            out[r, 3] += abs(axes[s, 0] * out[r, 0] + axes[s, 1] * out[r, 1] + axes[s, 2] * out[r, 2])


@helper
def _complete(out, r):
    """Row r of `out`: a unit vector perpendicular to the other two rows, as far as they are there."""
    best = -1.0
    a, b = (r + 1) % 3, (r + 2) % 3
    x0, x1, x2 = 0.0, 0.0, 0.0
    for k in range(3):  # the coordinate axis that keeps most when the other rows' parts are taken away
        y0, y1, y2 = 1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2)
        for row in (a, b):
            along = y0 * out[row, 0] + y1 * out[row, 1] + y2 * out[row, 2]
            y0, y1, y2 = y0 - along * out[row, 0], y1 - along * out[row, 1], y2 - along * out[row, 2]
        length = np.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
        if length > best:
            best, x0, x1, x2 = length, y0 / length, y1 / length, y2 / length
    out[r, 0], out[r, 1], out[r, 2] = x0, x1, x2


@helper
def _functions(x, y, z, w):
    return x, y, z, w, w + x, w - x, w + y, w - y, w - z


@helper
def _function_ranges(corners, slack, out):
    """Rows 3 and 4 of `out`: least and greatest value of each clip-space function over the corners, widened by slack."""
    sx, sy, sz, sw = slack
    wide = (sx, sy, sz, sw, sw + sx, sw + sx, sw + sy, sw + sy, sw + sz)
    for c in range(NUM_FUNCTIONS):
        out[3, c], out[4, c] = np.inf, -np.inf
    for k in range(8):
        values = _functions(corners[k, 0], corners[k, 1], corners[k, 2], corners[k, 3])
        for c in range(NUM_FUNCTIONS):
            value = values[c]
            out[3, c] = value if not value >= out[3, c] else out[3, c]  # a NaN stays
            out[4, c] = value if not value <= out[4, c] else out[4, c]
    for c in range(NUM_FUNCTIONS):
        out[3, c] -= wide[c]
        out[4, c] += wide[c]


@helper
def _note(margin, at, c, value, i):
    if value < margin[c]:
        margin[c], at[c] = value, i


@helper
def _rect_margin(x, y, rect, viewport):
    """Distance in pixels from a window position, clamped to the viewport, to the nearest side of rect; inside positive."""
    left, top = viewport.left, viewport.top
    right, bottom = left + viewport.width, top + viewport.height
    if rect[0] == rect[2]:
        return -min(x - left, right - x, y - top, bottom - y)
    x, y = min(max(x, left), right), min(max(y, top), bottom)
    return min(x - rect[0], rect[2] - x, y - rect[1], rect[3] - y)


@helper
def _check_point(i, p, x, y, z, w, px, py, pz, wx, wy, wz, code, bounds, viewport, s, margin, at):
    center = bounds.center[p]
    if abs(px) < np.inf and abs(py) < np.inf and abs(pz) < np.inf:
        for r in range(3):
            along = (px - center[0]) * s[r, 0] + (py - center[1]) * s[r, 1] + (pz - center[2]) * s[r, 2]
            room = ROUNDING * (s[r, 3] + abs(center[0] * s[r, 0]) + abs(center[1] * s[r, 1]) + abs(center[2] * s[r, 2]))
            _note(margin, at, BOX + r, s[r, 3] + room - abs(along), i)
    values = _functions(x, y, z, w)
    if not code & NONFINITE:
        for c in range(NUM_FUNCTIONS):
            _note(margin, at, CLIP + c, min(values[c] - s[3, c], s[4, c] - values[c]), i)
        if not code & NOT_BEHIND:
            _note(margin, at, RECT, _rect_margin(wx, wy, bounds.rect[p], viewport), i)
            _note(margin, at, DEPTH, wz - bounds.z_min[p], i)
    if bounds.inside[p]:
        room = min(values[4], values[5], values[6], values[7], z, values[8])
        _note(margin, at, INSIDE, -np.inf if code & NONFINITE else room, i)


@kernel
def _check_points(begin, end, rows, first, clip, world, window, bounds, viewport, scratch, margin, at):
    for k in range(begin, end):
        p = rows[k]
        _directions(bounds.axes[p], scratch)
        _function_ranges(bounds.corners[p], bounds.slack[p], scratch)
        for n in range(first[k], first[k + 1]):
            _check_point(
                n - first[k], p, np.float64(clip[0, n]), np.float64(clip[1, n]), np.float64(clip[2, n]),
                np.float64(clip[3, n]), np.float64(world[0, n]), np.float64(world[1, n]), np.float64(world[2, n]),
                window.x[n] / 256.0, window.y[n] / 256.0, np.float64(window.z[n]), window.code[n], bounds, viewport,
                scratch, margin[k], at[k],
            )  # fmt: skip


@kernel
def _check_normals(begin, end, rows, first, normal, bounds, margin, at):
    """The base surface's unit normals against the cones; where the surface has none (a null vector) there is no claim."""
    for k in range(begin, end):
        p = rows[k]
        axis = bounds.cone_axis[p]
        if not bounds.cone_cos[p] > -1.0:
            continue
        for n in range(first[k], first[k + 1]):
            x, y, z = np.float64(normal[0, n]), np.float64(normal[1, n]), np.float64(normal[2, n])
            if x != 0.0 or y != 0.0 or z != 0.0:
                cosine = axis[0] * x + axis[1] * y + axis[2] * z
                _note(margin[k], at[k], CONE, cosine + UNIT_ERROR - bounds.cone_cos[p], n - first[k])


@kernel
def _check_triangles(begin, end, rows, first, window, triangles, bounds, viewport, margin, at):
    """Set-up triangles of each patch against its rectangle and nearest depth."""
    near = np.float64(np.float32(viewport.min_depth))
    for k in range(begin, end):
        p = rows[k]
        x0, y0, x1, y1 = bounds.rect[p]
        for t in range(triangles.first[k], triangles.first[k] + triangles.used[k]):
            vertex, box = triangles.vertex[t], triangles.box[t]
            lead = vertex[0] - first[k] if vertex[0] < first[k + 1] else -1
            room = min(box[0] - x0, box[1] - y0, x1 - 1 - box[2], y1 - 1 - box[3])
            _note(margin[k], at[k], TRIANGLE_RECT, np.float64(room), lead)
            z = np.float64(min(window.z[vertex[0]], window.z[vertex[1]], window.z[vertex[2]]))
            _note(margin[k], at[k], TRIANGLE_DEPTH, max(z, near) - bounds.z_min[p], lead)


@kernel
def _reach_planes(begin, end, first, clip, reach, at):
    for k in range(begin, end):
        for n in range(first[k], first[k + 1]):
            x, y = np.float64(clip[0, n]), np.float64(clip[1, n])
            z, w = np.float64(clip[2, n]), np.float64(clip[3, n])
            planes = (w + x, w - x, w + y, w - y, z, w - z)
            for c in range(NUM_PLANES):
                if planes[c] > reach[k, c]:
                    reach[k, c], at[k, c] = planes[c], n - first[k]


class Shaded(NamedTuple):
    """Every point of some patches as the production stages make it."""

    clip: DomainPoints
    world: DomainPoints  # clip rows 0 .. 2 are world positions; `normal` is the base surface's
    window: Window


def shade_all(
    live: I32,
    patches: Patches,
    patterns: Patterns,
    maps: DisplacementMaps,
    camera: Camera,
    viewport: Viewport,
    host: Host,
) -> Shaded:
    """Shade the live patches in clip space and in world space, with base normals and snapped window positions."""
    clip = front_end.shade_domain_points(live, patches, patterns, maps, camera, host)
    identity = camera._replace(clip_from_world=np.eye(4, dtype=np.float32))
    world = front_end.shade_domain_points(live, patches, patterns, maps, identity, host)
    if (patches.map_id[live] >= 0).any():
        base = patches._replace(map_id=np.full_like(patches.map_id, -1))
        normal = front_end.shade_domain_points(live, base, patterns, maps, identity, host).normal
        world = world._replace(normal=normal)
    n = clip.clip.shape[1]
    columns: list[Any] = [np.empty(n, t) for t in (np.int32, np.int32, np.float32, np.float32, np.uint8)]
    window = Window(*columns)
    guard, chunks = primitives.guard_band(viewport), host.chunks(n)
    host.run(lambda c: primitives.project_points(*chunks[c], clip.clip, viewport, guard, window), len(chunks))
    return Shaded(clip, world, window)


def measure_margins(
    bounds: PatchBounds, rows: I32, shaded: Shaded, viewport: Viewport, host: Host, geometry: Geometry | None = None
) -> Margins:
    """Margins of each check over all points of each patch; rows : int32[n], the patches' rows in `bounds`.

    geometry : the patches' set-up triangles, for the checks of triangles.
    """
    n = len(rows)
    margins = Margins(np.full((n, NUM_CHECKS), np.inf), np.full((n, NUM_CHECKS), -1, np.int64))
    chunks, first = host.chunks(n), shaded.clip.first

    def work(c: int) -> None:
        scratch = np.empty(SCRATCH)
        _check_points(
            *chunks[c], rows, first, shaded.clip.clip, shaded.world.clip, shaded.window, bounds, viewport, scratch, *margins
        )  # fmt: skip
        _check_normals(*chunks[c], rows, first, shaded.world.normal, bounds, *margins)
        if geometry is not None:
            _check_triangles(
                *chunks[c], rows, first, geometry.window, geometry.triangles, bounds, viewport, *margins
            )  # fmt: skip

    host.run(work, len(chunks))
    return margins


def reach_planes(points: DomainPoints, host: Host) -> tuple[F64, I64]:
    """How far inside each plane of the frustum each patch's points reach, float64[n, 6], and the point that does."""
    n = len(points.first) - 1
    reach, at = np.full((n, NUM_PLANES), -np.inf), np.full((n, NUM_PLANES), -1, np.int64)
    chunks = host.chunks(n)
    host.run(lambda c: _reach_planes(*chunks[c], points.first, points.clip, reach, at), len(chunks))
    return reach, at


def name_violations(algorithm: str, margins: Margins, live: I32, patterns: Patterns) -> list[Violation]:
    """A violation for each patch and check whose margin is negative, at its worst point."""
    found = []
    for k, c in np.argwhere(margins.margin < 0.0):
        u, v = _uv_of(patterns, live[k], margins.at[k, c])
        found.append(Violation(int(live[k]), u, v, algorithm, CHECKS[c][0], float(margins.margin[k, c]), CHECKS[c][1]))
    return found


def _uv_of(patterns: Patterns, patch: int, point: int) -> tuple[float, float]:
    if point < 0:
        return math.nan, math.nan
    u, v = patterns.uv[:, patterns.first_point[patterns.of_patch[patch]] + point]
    return float(u), float(v)


# Culls


def run_each_cull(names: tuple[str, ...], stage: HullInput, bounds: PatchBounds, flags: U8) -> I32:
    """Run the tests in order as the hull stage does (`flags` in place): the test that dropped each patch, -1 for none."""
    culled_by = np.full(len(flags), -1, np.int32)
    for number, name in enumerate(names):
        before = flags.copy()
        CULL_TESTS[name](stage, bounds, flags)
        culled_by[flags != before] = number
    return culled_by


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
        points = front_end.shade_domain_points(bumpy, some, grid, maps, camera, host).clip[:3].astype(np.float64)
        p = points.reshape(3, len(bumpy), DENSE + 1, DENSE + 1)
        side_u, side_v = p[:, :, 1:, :-1] - p[:, :, :-1, :-1], p[:, :, :-1, 1:] - p[:, :, :-1, :-1]
        with np.errstate(all="ignore"):
            to_eye = stage.eye[:, None, None, None] - p[:, :, :-1, :-1]
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


# A frame


class _Owners(NamedTuple):
    """Who is seen at each sample of the picture that culls nothing."""

    patch: I32  # (H, W, S) patch number, -1 for none
    point: I32  # (H, W, S) a domain point of the visible triangle, within its patch; -1 where none can be named


def _note_owners(owners: _Owners, target: Target, geometry: Geometry, live: I32) -> None:
    seen = target.visible >= 0
    triangle = target.visible[seen]
    patch = geometry.triangles.patch[triangle]
    k = np.searchsorted(live, patch)
    lead = geometry.triangles.vertex[triangle, 0]
    inside = lead < geometry.points.first[k + 1]
    owners.patch[seen] = patch
    owners.point[seen] = np.where(inside, lead - geometry.points.first[k], -1)


def check_frame(
    scene: Scene,
    machine: Machine,
    number: float,
    host: Host,
    picture: tuple[U8, F32],
    progress: Callable[[float], None] = lambda part: None,
) -> Report:
    """Verify one frame: all patches shaded, nothing culled, against the machine's bound, its culls and its picture.

    picture : resolved colours uint8[H, W, 4] and depth float32[H, W, S] that the machine drew.
    """
    width, height = scene.picture.width, scene.picture.height
    camera = camera_at(scene.camera, number, width / height)
    viewport = Viewport(0, 0, width, height, 0.0, 1.0)
    plain = Machine(tile=machine.tile, binning="triangle", cull=())
    grid, target = make_grid(width, height, plain.tile), back_end.make_target(scene.picture)
    packed = front_end.scene_maps(scene)
    patches = front_end.run_vertex_shader(scene)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    stage = front_end.raise_silhouettes(scene, stage)
    flags = hull.flag_nonfinite(patches, stage.pyramids.whole)
    broken = flags.copy()
    bounds = BOUNDS[machine.bounds](stage)
    culled_by = run_each_cull(machine.hull_cull, stage, bounds, flags)
    hull.drop_culled(stage.factors, broken)
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    live = np.flatnonzero((broken == 0) & (patterns.of_patch >= 0)).astype(np.int32)

    violations: list[Violation] = []
    owners = _Owners(np.full(target.visible.shape, -1, np.int32), np.full(target.visible.shape, -1, np.int32))
    counts = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
    batches = front_end.split_batches(live, patterns)
    for b, batch in enumerate(batches):
        shaded = shade_all(batch, patches, patterns, packed.maps, camera, viewport, host)
        geometry = front_end.set_up_triangles(batch, shaded.clip, patterns, viewport, scene, host)
        margins = measure_margins(bounds, batch, shaded, viewport, host, geometry)
        violations += name_violations(machine.bounds, margins, batch, patterns)
        bins = back_end.bin_batch(batch, geometry, bounds, plain, grid, scene.picture.samples, host)
        back_end.run_tiles(
            bins, batch, geometry, back_end.NO_ORDER, bounds, back_end.make_rules(plain), scene, grid, target,
            back_end.make_coarse_z(plain, grid), counts, b == 0, b == len(batches) - 1, host,
        )  # fmt: skip
        _note_owners(owners, target, geometry, batch)
        progress((b + 1) / len(batches))
    lost, false_culls = _check_culls(machine.hull_cull, culled_by, stage, packed.maps, patterns, owners, host)
    if not lost and not false_culls:
        lost = _compare_pictures(machine, target, picture, patterns, owners)
    return Report(tuple(violations + lost), tuple(false_culls))


def _check_culls(
    names: tuple[str, ...],
    culled_by: I32,
    stage: HullInput,
    maps: DisplacementMaps,
    patterns: Patterns,
    owners: _Owners,
    host: Host,
) -> tuple[list[Violation], list[Violation]]:
    """Culled patches that are seen in the picture without culls: violations, and false culls of back-patch tests."""
    violations: list[Violation] = []
    false_culls: list[Violation] = []
    seen, first, samples = np.unique(owners.patch, return_index=True, return_counts=True)
    lost = (seen >= 0) & (culled_by[seen] >= 0)
    cosines, where = facing(stage, seen[lost], maps, host)
    for k, p in enumerate(seen[lost]):
        name = names[culled_by[p]]
        u, v = _uv_of(patterns, p, owners.point.flat[first[lost][k]])
        dropped = Violation(int(p), u, v, name, "culled, yet visible", -float(samples[lost][k]), "samples")
        if not name.startswith("backface"):
            violations.append(dropped)
        elif sort_back_patch_cull(stage, cosines[k]):
            violations.append(dropped)
            if cosines[k] > 0.0:
                u, v = map(float, where[k])
                violations.append(
                    Violation(int(p), u, v, name, "culled, yet the surface faces the eye", -float(cosines[k]), "cosine")
                )
        else:
            false_culls.append(dropped)
    return violations, false_culls


def _compare_pictures(
    machine: Machine, target: Target, picture: tuple[U8, F32], patterns: Patterns, owners: _Owners
) -> list[Violation]:
    """A violation where the machine's picture is not the one that culls nothing: at its first sample."""
    color, depth = picture
    differ = (target.resolved != color).any(axis=2)[..., None] | (target.depth.view(np.uint32) != depth.view(np.uint32))
    if not differ.any():
        return []
    at = int(np.flatnonzero(differ)[0])
    patch, (y, x) = int(owners.patch.flat[at]), np.argwhere(differ.any(axis=2))[0]
    u, v = _uv_of(patterns, patch, int(owners.point.flat[at])) if patch >= 0 else (math.nan, math.nan)
    what = f"the picture differs, first in column {x}, row {y}"
    return [Violation(patch, u, v, machine.bounds, what, -float(np.count_nonzero(differ)), "samples")]
