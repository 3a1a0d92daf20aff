"""Bounds against shaded points: the margin of every promise (`CHECKS`) over the points and triangles of a patch."""

import math
from typing import Any, NamedTuple

import numpy as np

from pipeline import primitives
from pipeline.jit import helper, kernel
from pipeline.types import (
    F64,
    I32,
    I64,
    DisplacementMaps,
    DomainPoints,
    PatchBounds,
    Patches,
    Patterns,
    Viewport,
    Window,
)
from tiler import front_end
from tiler.front_end import Geometry
from tiler.host import Host
from tiler.scene.camera import Camera
from tiler.verify.report import Violation

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


class Margins(NamedTuple):
    """The smallest margin of each check over the points of each patch; infinite where there was nothing to check."""

    margin: F64  # (n, NUM_CHECKS)
    at: I64  # (n, NUM_CHECKS) number of the point within its patch; -1: none, or a vertex that the clipper made


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
    world: DomainPoints  # clip rows 0 .. 2 are world positions; `normal` is the base surface's, of its own tangents
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
    """Shade the live patches in clip space and in world space, with base normals and snapped window positions.

    Base normals are those of the patch's own tangents, which is what a cone claims to hold. What undisplaced patches of a mesh
    share on their edges in their place is for shading alone; what displaced ones share moves points, and these are checked.
    """
    clip = front_end.shade_domain_points(live, patches, patterns, maps, camera, host)
    identity = camera._replace(clip_from_world=np.eye(4, dtype=np.float32))
    world = front_end.shade_domain_points(live, patches, patterns, maps, identity, host)
    if ((patches.map_id[live] >= 0) | (patches.normal_id[live] >= 0)).any():
        none = np.full_like(patches.map_id, -1)
        base = patches._replace(map_id=none, normal_id=none)
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
        u, v = uv_of(patterns, live[k], margins.at[k, c])
        found.append(Violation(int(live[k]), u, v, algorithm, CHECKS[c][0], float(margins.margin[k, c]), CHECKS[c][1]))
    return found


def uv_of(patterns: Patterns, patch: int, point: int) -> tuple[float, float]:
    """(u, v) of a point of a patch; NaN for point -1."""
    if point < 0:
        return math.nan, math.nan
    u, v = patterns.uv[:, patterns.first_point[patterns.of_patch[patch]] + point]
    return float(u), float(v)
