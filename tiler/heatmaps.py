"""Maps over the picture: per tile what each tile did, per pixel how often it was covered; and pictures of them with a scale.

Per-pixel maps are made anew from the scene, apart from the machine's run, so that a frame that nobody maps pays nothing:

- `overdraw`: samples of the pixel that triangles cover, each one a depth test, if no occlusion test hides them first; their
  sum is `rs_samples_covered` of a machine without such tests.
- `depth_complexity`: the same of all patches and both faces: the layers that the scene has there, whatever is culled.
- `bounds_overlap`: patches alive after the hull stage whose screen rectangle has the pixel (Munkberg et al. 2010, Figure 8).
- `bounds_overlap:hull`: those whose projected box has the pixel's centre: exact where the box lies before the eye.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.jit import kernel
from pipeline.tessellator import make_patterns
from pipeline.types import F64, I32, I64, DisplacementMaps, PatchBounds, Patches, Patterns, Viewport
from tiler import front_end
from tiler.config import Machine
from tiler.errors import TilerError, unknown_name
from tiler.front_end import Geometry
from tiler.host import Host, available_threads
from tiler.rasterizer import SAMPLE_X, SAMPLE_Y, triangle_edges
from tiler.scene.camera import Camera, camera_at
from tiler.scene.model import Scene
from tiler.tally import TILE_COUNTERS

if TYPE_CHECKING:
    from PIL.Image import Image

    from tiler.frame import Frame

BAR = 22  # height of the legend, pixels
MARGIN = 6

# Black, then the hues from blue to red, then white: neighbouring counts differ in hue, not only in lightness.
FALSE_COLORS = np.array(
    [
        (0, 0, 0),
        (30, 40, 160),
        (20, 120, 220),
        (20, 180, 170),
        (60, 190, 60),
        (210, 210, 40),
        (240, 140, 20),
        (220, 40, 30),
        (255, 255, 255),
    ],
    np.float64,
)


class Alive(NamedTuple):
    """The patches of a frame that live after the hull stage, with their bounds."""

    live: I32
    bounds: PatchBounds
    patches: Patches
    maps: DisplacementMaps
    patterns: Patterns
    camera: Camera
    viewport: Viewport


def live_patches(scene: Scene, machine: Machine, number: float) -> Alive:
    """The front end of a frame up to the tessellator, as `machine.render_frame` runs it."""
    viewport = Viewport(0, 0, scene.picture.width, scene.picture.height, 0.0, 1.0)
    camera = camera_at(scene.camera, number, viewport.width / viewport.height)
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    packed = front_end.scene_maps(scene, number)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    stage = front_end.raise_silhouettes(scene, stage)
    flags = hull.flag_nonfinite(patches, stage.pyramids.whole)
    bounds = BOUNDS[machine.bounds](stage)
    hull.run_cull_tests(machine.hull_cull, stage, bounds, flags)
    hull.drop_culled(stage.factors, flags)
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    hull.flag_factors(patterns.of_patch, flags)
    return Alive(hull.live_patches(flags), bounds, patches, packed.maps, patterns, camera, viewport)


def live_triangles(scene: Scene, alive: Alive, host: Host) -> Iterator[Geometry]:
    """Set-up triangles of the live patches, a batch after the other."""
    for batch in front_end.split_batches(alive.live, alive.patterns):
        points = front_end.shade_domain_points(batch, alive.patches, alive.patterns, alive.maps, alive.camera, host)
        yield front_end.set_up_triangles(batch, points, alive.patterns, alive.viewport, scene, host)


@kernel
def _count_rows(rect, edges_x):
    """Add patches' rectangles (x0 y0 x1 y1, ends exclusive) to edges_x : int32[H, W+1], differences along each row."""
    for p in range(len(rect)):
        for y in range(rect[p, 1], rect[p, 3]):
            edges_x[y, rect[p, 0]] += 1
            edges_x[y, rect[p, 2]] -= 1


@kernel
def _count_hulls(corners, rect, edges_x):
    """Add the pixels whose centre is in the hull of eight points; corners : float64[P, 8, 2], pixels; NaN: the rectangle."""
    width = edges_x.shape[1] - 1
    for p in range(len(rect)):
        known = True
        for k in range(8):
            known = known and corners[p, k, 0] == corners[p, k, 0] and corners[p, k, 1] == corners[p, k, 1]
        for y in range(rect[p, 1], rect[p, 3]):
            first, end = rect[p, 0], rect[p, 2]
            if known:
                # The slice of the hull at this row's centre: from the least to the largest crossing of any two corners.
                row, lo, hi = y + 0.5, np.inf, -np.inf
                for a in range(8):
                    for b in range(a + 1):
                        ya, yb = corners[p, a, 1], corners[p, b, 1]
                        if min(ya, yb) <= row and row <= max(ya, yb):
                            t = (row - ya) / (yb - ya) if yb != ya else 0.0
                            x = corners[p, a, 0] + t * (corners[p, b, 0] - corners[p, a, 0])
                            lo, hi = min(lo, x), max(hi, x)
                if not lo <= hi:
                    continue
                first = np.int64(max(0.0, min(np.ceil(lo - 0.5), np.float64(width))))
                end = np.int64(max(0.0, min(np.floor(hi - 0.5) + 1.0, np.float64(width))))
            if first < end:
                edges_x[y, first] += 1
                edges_x[y, end] -= 1


def overlap_map(scene: Scene, machine: Machine, number: float = 0, *, exact: bool = False) -> I32:
    """How many live patches' bounds lie over each pixel, int32[H, W].

    number : of the frame. exact : the projected box at the pixel's centre instead of the rectangle around it (the
    rectangle still where a corner is not before the eye). Munkberg et al. 2010, Figure 8.
    """
    alive = live_patches(scene, machine, number)
    rect = alive.bounds.rect[alive.live]
    edges = np.zeros((alive.viewport.height, alive.viewport.width + 1), np.int32)
    if exact:
        _count_hulls(window_corners(alive.bounds, alive.live, alive.viewport), rect, edges)
    else:
        _count_rows(rect, edges)
    return np.cumsum(edges[:, :-1], axis=1, dtype=np.int32)


def window_corners(bounds: PatchBounds, live: I32, viewport: Viewport) -> F64:
    """Box corners in pixels, float64[live, 8, 2]; NaN for all of a box with a corner behind the near plane or w <= 0."""
    x, y, z, w = np.moveaxis(bounds.corners[live], -1, 0)
    with np.errstate(all="ignore"):
        column = (x / w + 1.0) * 0.5 * viewport.width + viewport.left
        row = (1.0 - y / w) * 0.5 * viewport.height + viewport.top
    shown = np.stack([column, row], axis=-1)
    shown[~((w > 0) & (z >= 0)).all(axis=1)] = np.nan
    return np.ascontiguousarray(shown)


@kernel
def _count_coverage(triangles, window, sample_x, sample_y, count):
    """Add to count[y, x] the samples that each triangle covers."""
    for k in range(len(triangles.used)):
        for t in range(triangles.first[k], triangles.first[k] + triangles.used[k]):
            a, b, c = triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2]
            (edge0, edge1, edge2), _ = triangle_edges(window, a, b, c)
            for y in range(triangles.box[t, 1], triangles.box[t, 3] + 1):
                for x in range(triangles.box[t, 0], triangles.box[t, 2] + 1):
                    for s in range(len(sample_x)):
                        px, py = (x << 8) + sample_x[s], (y << 8) + sample_y[s]
                        e0 = edge0[2] + edge0[3] + edge0[0] * py - edge0[1] * px
                        e1 = edge1[2] + edge1[3] + edge1[0] * py - edge1[1] * px
                        e2 = edge2[2] + edge2[3] + edge2[0] * py - edge2[1] * px
                        if (e0 | e1 | e2) >= 0:
                            count[y, x] += 1


def overdraw_map(scene: Scene, machine: Machine, number: float = 0, *, threads: int | None = None) -> I32:
    """Samples of each pixel that triangles cover, int32[H, W]; the sum is `rs_samples_covered`. number : of the frame."""
    picture = scene.picture
    count = np.zeros((picture.height, picture.width), np.int32)
    with Host(threads or available_threads()) as host:
        for geometry in live_triangles(scene, live_patches(scene, machine, number), host):
            _count_coverage(
                geometry.triangles, geometry.window, SAMPLE_X[picture.samples], SAMPLE_Y[picture.samples], count
            )
    return count


def depth_complexity_map(scene: Scene, machine: Machine, number: float = 0) -> I32:
    """Samples that triangles of all patches and both faces cover, int32[H, W]: nothing is culled."""
    everything = Machine(binning="triangle", cull=(), bounds=machine.bounds, tile=machine.tile)
    return overdraw_map(replace(scene, face_cull="none"), everything, number)


PIXEL_MAPS: dict[str, Callable[[Scene, Machine, float], I32]] = {
    "overdraw": overdraw_map,
    "depth_complexity": depth_complexity_map,
    "bounds_overlap": overlap_map,
    "bounds_overlap:hull": lambda scene, machine, number: overlap_map(scene, machine, number, exact=True),
}


def wasted_samples(frame: "Frame") -> I64:
    """Samples tested in each tile that are not seen at the end, int64[tiles_y, tiles_x]: `rs_samples_covered` less visible."""
    tile, seen = frame.machine.tile, (frame.depth_samples < 1.0).sum(axis=2)
    rows = np.add.reduceat(seen, np.arange(0, seen.shape[0], tile), axis=0)
    visible = np.add.reduceat(rows, np.arange(0, seen.shape[1], tile), axis=1)
    return frame.tiles["rs_samples_covered"] - visible


TILE_MAPS: dict[str, Callable[["Frame"], I64]] = {
    "queue_bytes": lambda frame: frame.queues.memory.tile_bytes,
    "queue_passes": lambda frame: frame.queues.memory.tile_passes,
    "wasted_samples": wasted_samples,
    "wasted_domain_points": lambda frame: frame.tile_map("wasted_domain_points"),
}


def heatmap_names() -> list[str]:
    """Every map: per-tile counters first."""
    return [*TILE_COUNTERS, *TILE_MAPS, *PIXEL_MAPS]


def check_heatmaps(names: Sequence[str]) -> list[str]:
    """The names, if each is a map. Raises TilerError otherwise."""
    for name in names:
        if name not in heatmap_names():
            raise TilerError(f"heatmap: {name!r} is unknown; {unknown_name(name, heatmap_names())}")
    return list(names)


def heatmap_values(scene: Scene, frame: "Frame", name: str) -> I64:
    """Values of a map for each pixel, int64[H, W]; a tile's value at all of its pixels. Raises TilerError for the name."""
    check_heatmaps([name])
    if name in PIXEL_MAPS:
        return PIXEL_MAPS[name](scene, frame.machine, frame.number).astype(np.int64)
    values = TILE_MAPS[name](frame) if name in TILE_MAPS else frame.tiles[name]
    height, width = frame.depth.shape
    return values.repeat(frame.machine.tile, axis=0).repeat(frame.machine.tile, axis=1)[:height, :width]


def heatmap_picture(scene: Scene, frame: "Frame", name: str) -> "Image":
    """A map as a picture with its scale below: overlap and coverage in false colours, per-tile maps in those of `Frame`."""
    from tiler.frame import RAMP

    values = heatmap_values(scene, frame, name)
    colors = FALSE_COLORS if name in PIXEL_MAPS else RAMP
    top = int(values.max(initial=0))
    return with_scale(
        paint(values, top, colors), f"{name} per {'pixel' if name in PIXEL_MAPS else 'tile'}", 0, top, colors
    )


def paint(values: I64, top: float, colors: F64 = FALSE_COLORS) -> "Image":
    """Values in colours: 0 in the first, `top` and above in the last, straight lines between."""
    from PIL import Image

    place = np.clip(values / top if top > 0 else values * 0.0, 0.0, 1.0) * (len(colors) - 1)
    low = np.minimum(place.astype(int), len(colors) - 2)
    part = (place - low)[..., None]
    return Image.fromarray((colors[low] * (1 - part) + colors[low + 1] * part + 0.5).astype(np.uint8))


def with_scale(image: "Image", label: str, low: float, high: float, colors: F64 = FALSE_COLORS) -> "Image":
    """The picture with a legend below it: what is shown, and a bar of colours from `low` to `high`."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(size=12)
    width = max(image.width, 160)
    legend = Image.new("RGB", (width, 2 * BAR), (24, 24, 24))
    draw = ImageDraw.Draw(legend)
    draw.text((MARGIN, 4), label, (235, 235, 235), font)
    ends = [f"{low:,g}" if abs(low) < 1e6 else f"{low:.3g}", f"{high:,g}" if abs(high) < 1e6 else f"{high:.3g}"]
    begin = MARGIN + int(draw.textlength(ends[0], font)) + MARGIN
    end = width - 2 * MARGIN - int(draw.textlength(ends[1], font))
    ramp = np.tile(np.arange(max(1, end - begin), dtype=np.int64), (12, 1))
    legend.paste(paint(ramp, ramp.shape[1] - 1, colors), (begin, BAR + 4))
    draw.text((MARGIN, BAR + 2), ends[0], (235, 235, 235), font)
    draw.text((end + MARGIN, BAR + 2), ends[1], (235, 235, 235), font)
    result = Image.new("RGB", (width, image.height + legend.height), (24, 24, 24))
    result.paste(image.convert("RGB"), (0, 0))
    result.paste(legend, (0, image.height))
    return result
