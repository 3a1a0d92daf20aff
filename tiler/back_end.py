"""The back end: render target, binning of a batch in each mode, and the tile loop over the host's threads."""

import math
from typing import NamedTuple

import numpy as np

from pipeline import pixel
from pipeline.types import I32, I64, U8, DomainPoints, PatchBounds, Triangles, Viewport, Window
from tiler.binning import TileQueues, bin_boxes
from tiler.coarse_z import CoarseZ, build, depth_rows, make_pyramid
from tiler.config import Machine
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.host import Host
from tiler.lent import lend
from tiler.near_planes import planes_under
from tiler.occlusion import make_sketch
from tiler.overlap import bin_hulls, bin_triangles
from tiler.rasterizer import MARGIN, SAMPLE_X, SAMPLE_Y
from tiler.scene.model import Picture, Scene
from tiler.tile import FEED_FORWARD, KEEP, RECOMPUTE, Rules, Target, Touched, Work, process_tiles

NO_ORDER = np.empty(0, np.int64)
NO_POINTS = DomainPoints(np.zeros(1, np.int64), np.empty((4, 0), np.float32), np.empty((3, 0), np.float32))


def make_target(picture: Picture, ordered: bool = False) -> Target:
    """The render target, not yet cleared: the tiles clear their own part. ordered : with submit numbers of the samples."""
    shape = (picture.height, picture.width, picture.samples)
    color = lend((*shape, 4), np.uint8)
    resolved = lend((*shape[:2], 4), np.uint8) if picture.samples > 1 else color.reshape(*shape[:2], 4)
    order = lend(shape if ordered else (0, 0, 0), np.int64)
    return Target(lend(shape, np.float32), lend(shape, np.int32), color, resolved, order)


def make_coarse_z(machine: Machine, grid: Grid) -> CoarseZ:
    """The machine's pyramid over the cleared picture; one cell where the machine makes no occlusion tests."""
    return cleared_pyramid(machine.coarse_z_block if machine.occlusion else 0, grid)


def cleared_pyramid(block: int, grid: Grid) -> CoarseZ:
    """A pyramid over the cleared picture. block : side of its finest blocks in pixels; 0: one cell, for no test."""
    if block == 0:
        return make_pyramid(grid._replace(width=1, height=1, tiles_x=1, tiles_y=1), 1 << grid.tile_log2)
    return make_pyramid(grid, block)


class Canvas(NamedTuple):
    """What the tiles draw on."""

    target: Target
    coarse: CoarseZ


def make_canvas(picture: Picture, ordered: bool, block: int, grid: Grid) -> Canvas:
    """A canvas that is not yet cleared. ordered, block : as in `make_target` and `cleared_pyramid`."""
    return Canvas(make_target(picture, ordered), cleared_pyramid(block, grid))


def rebuild(canvas: Canvas) -> Canvas:
    """The canvas with a pyramid of its own, built from all its depths."""
    old = canvas.coarse
    coarse = old._replace(farthest=np.empty_like(old.farthest), nearest=np.empty_like(old.nearest))
    build(coarse, canvas.target.depth)
    return canvas._replace(coarse=coarse)


def copy_canvas(canvas: Canvas, picture: Picture, cleared: bool) -> Canvas:
    """A canvas of its own memory that shows the same. cleared : the tiles will clear it, so nothing need be shown."""
    old = canvas.target
    target = make_target(picture, old.order.size > 0)
    if not cleared:
        for name in Target._fields:
            np.copyto(getattr(target, name), getattr(old, name))
    coarse = canvas.coarse._replace(farthest=canvas.coarse.farthest.copy(), nearest=canvas.coarse.nearest.copy())
    return Canvas(target, coarse)


def make_rules(machine: Machine, phase: int = 0) -> Rules:
    """How the tiles work in phase 0 or 1 of the frame; a machine that is not phased has phase 0 alone.

    The first of two phases tests nothing in the tiles, the second tests against the pyramid that stood between them.
    """
    tests = machine.occlusion if phase == 1 or not machine.phased else ()
    update = KEEP
    if tests and not machine.phased:
        update = RECOMPUTE if machine.coarse_z_update == "recompute" else FEED_FORWARD
    by_unit = machine.binning != "triangle"
    return Rules(
        by_unit=by_unit,
        ties=machine.reordered,
        pairs="occlusion" in tests,
        triangles=by_unit and "occlusion:triangle" in tests,
        blocks="occlusion:block" in tests,
        hulls=by_unit and "occlusion" in tests and machine.occlusion_area == "hull",
        update=update,
    )


class Bins(NamedTuple):
    """Queues of a batch. `triangles`: its set-up triangles; `queue`: what the modelled machine queues, in any mode."""

    queue: TileQueues
    triangles: TileQueues


def bin_batch(
    live: I32, geometry: Geometry, bounds: PatchBounds, machine: Machine, grid: Grid, samples: int, host: Host
) -> Bins:
    """Bin a batch's set-up triangles, and in other modes than `triangle` its units by their bounds on the screen."""
    by_triangle = bin_drawn(geometry.drawn, geometry.window, machine.overlap, grid, samples, host)
    if machine.binning == "triangle":
        return Bins(by_triangle, by_triangle)
    return Bins(bin_units(live, bounds, machine.overlap, grid, host), by_triangle)


def bin_drawn(
    triangles: Triangles, window: Window, overlap: str, grid: Grid, samples: int, host: Host
) -> TileQueues:  # fmt: skip
    """Bin set-up triangles. overlap : as `Machine.overlap`."""
    if overlap == "exact":
        return bin_triangles(triangles, window, grid, MARGIN[samples], host)
    return bin_boxes(triangles.first, triangles.used, triangles.box, grid, host)


def bin_units(live: I32, bounds: PatchBounds, overlap: str, grid: Grid, host: Host) -> TileQueues:
    """Bin units by their bounds on the screen; items are places in `live`."""
    if overlap == "exact":
        return bin_hulls(live, bounds, grid, host)
    rect = bounds.rect[live]
    box = (rect - np.array([0, 0, 1, 1], np.int32)).astype(np.int16)
    seen = (rect[:, 0] < rect[:, 2]).astype(np.int32)
    return bin_boxes(np.arange(len(live) + 1, dtype=np.int64), seen, box, grid, host)


def cut_bins(bins: Bins, parts: list[TileQueues]) -> list[Bins]:
    """The bins of each pass of a batch; parts : its queues, cut where a new pass begins."""
    if len(parts) == 1:
        return [bins]
    by_triangle = bins.queue is bins.triangles
    return [Bins(part, part if by_triangle else bins.triangles) for part in parts]


def unit_vector(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """`vector`, made unit."""
    length = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    return (vector[0] / length, vector[1] / length, vector[2] / length)


def touched_blocks(coarse: CoarseZ) -> Touched:
    """Scratch of one thread for a machine with this pyramid."""
    blocks = 1 << (2 * coarse.tile_level)
    return Touched(np.full(blocks, -1, np.int64), np.zeros(blocks + 1, np.int32), np.empty(2, np.int32))


def run_tiles(
    bins: Bins,
    live: I32,
    geometry: Geometry,
    order: I64,
    bounds: PatchBounds,
    rules: Rules,
    scene: Scene,
    grid: Grid,
    target: Target,
    coarse: CoarseZ,
    tile_counts: I64,
    first_batch: bool,
    last_batch: bool,
    host: Host,
) -> U8:
    """Work off every tile's queue; `target`, `coarse`, `tile_counts` int64[tiles, NUM_TILE_COUNTS] are modified in place.

    live, bounds : the batch's units, and the bounds of all. order : submit numbers of its triangles, or `NO_ORDER`.
    Returns what became of each queue entry, uint8: 1 where coarse Z hid a unit, else 0.
    """
    picture = scene.picture
    viewport = Viewport(0, 0, grid.width, grid.height, 0.0, 1.0)
    tested = live if rules.pairs and rules.by_unit else live[:0]
    planes, hulls = planes_under(tested, bounds, viewport), tested if rules.hulls else live[:0]
    work = Work(
        bounds.rect[live], bounds.z_min[live], planes, bounds.corners[hulls], bounds.slack[hulls], geometry.outcomes
    )
    pattern = (SAMPLE_X[picture.samples], SAMPLE_Y[picture.samples], MARGIN[picture.samples])
    depth_range = (np.float32(0.0), np.float32(1.0))
    background = np.array([*picture.background, 255], np.uint8)
    shading, light = int(pixel.Shade[picture.shading.upper()]), unit_vector(scene.light)
    outcome = np.zeros(len(bins.queue.item), np.uint8)
    rows = depth_rows(target.depth)
    chunks = host.chunks(grid.num_tiles)

    def work_off(c: int) -> None:
        process_tiles(
            *chunks[c], grid, rules, bins.queue, bins.triangles, work, viewport, geometry.triangles, order,
            geometry.window, geometry.points.normal, pattern, depth_range, background, shading, light, first_batch,
            last_batch, target, coarse, rows, touched_blocks(coarse), make_sketch(), outcome, tile_counts,
            np.empty(pixel.SCRATCH, np.float32),
        )  # fmt: skip

    host.run(work_off, len(chunks))
    return outcome
