"""The back end: render target, binning of a batch in either mode, and the tile loop over the host's threads."""

import math
from typing import NamedTuple

import numpy as np

from pipeline import pixel
from pipeline.types import I32, I64, PatchBounds
from tiler.binning import TileQueues, bin_boxes
from tiler.config import Machine
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.host import Host
from tiler.rasterizer import MARGIN, SAMPLE_X, SAMPLE_Y
from tiler.scene.model import Picture, Scene
from tiler.tile import PatchWork, Target, process_tiles


def make_target(picture: Picture) -> Target:
    """The render target, not yet cleared: the tiles clear their own part."""
    shape = (picture.height, picture.width, picture.samples)
    color = np.empty((*shape, 4), np.uint8)
    resolved = np.empty((*shape[:2], 4), np.uint8) if picture.samples > 1 else color.reshape(*shape[:2], 4)
    return Target(np.empty(shape, np.float32), np.empty(shape, np.int32), color, resolved)


class Bins(NamedTuple):
    """Queues of a batch. `triangles`: its set-up triangles; `queue`: what the modelled machine queues, in either mode."""

    queue: TileQueues
    triangles: TileQueues


def bin_batch(live: I32, geometry: Geometry, bounds: PatchBounds, machine: Machine, grid: Grid, host: Host) -> Bins:
    """Bin a batch's set-up triangles by their boxes, and in `patch` binning its patches by their bounds on the screen."""
    triangles = geometry.triangles
    by_triangle = bin_boxes(triangles.first, triangles.used, triangles.box, grid, host)
    if machine.binning == "triangle":
        return Bins(by_triangle, by_triangle)
    rect = bounds.rect[live]
    box = (rect - np.array([0, 0, 1, 1], np.int32)).astype(np.int16)
    seen = (rect[:, 0] < rect[:, 2]).astype(np.int32)
    return Bins(bin_boxes(np.arange(len(live) + 1, dtype=np.int64), seen, box, grid, host), by_triangle)


def cut_bins(bins: Bins, parts: list[TileQueues]) -> list[Bins]:
    """The bins of each pass of a batch; parts : its queues, cut where a new pass begins."""
    if len(parts) == 1:
        return [bins]
    by_triangle = bins.queue is bins.triangles
    return [Bins(part, part if by_triangle else bins.triangles) for part in parts]


def _patch_work(queues: TileQueues, geometry: Geometry, machine: Machine) -> PatchWork:
    """What each patch of the batch costs a tile that has it queued."""
    domain_points = np.diff(geometry.points.first)
    shading_tile = np.full(len(domain_points), -1, np.int64)
    if machine.binning == "patch" and machine.domain_cache == "frame":
        # Walk the queues as the machine does, tiles in scanline order: the first tile that has a patch shades it.
        tile_of_entry = np.repeat(np.arange(len(queues.first) - 1), np.diff(queues.first))
        patches, where = np.unique(queues.item, return_index=True)
        shading_tile[patches] = tile_of_entry[where]
    return PatchWork(domain_points, shading_tile, geometry.outcomes)


def _unit(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    length = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    return (vector[0] / length, vector[1] / length, vector[2] / length)


def run_tiles(
    bins: Bins,
    live: I32,
    geometry: Geometry,
    scene: Scene,
    machine: Machine,
    grid: Grid,
    target: Target,
    tile_counts: I64,
    first_batch: bool,
    last_batch: bool,
    host: Host,
) -> None:
    """Work off every tile's queue; `target` and `tile_counts` int64[tiles, NUM_TILE_COUNTS] are modified in place."""
    picture = scene.picture
    work = _patch_work(bins.queue, geometry, machine)
    pattern = (SAMPLE_X[picture.samples], SAMPLE_Y[picture.samples], MARGIN[picture.samples])
    depth_range = (np.float32(0.0), np.float32(1.0))
    background = np.array([*picture.background, 255], np.uint8)
    shading, light = int(pixel.Shade[picture.shading.upper()]), _unit(scene.light)
    chunks = host.chunks(grid.num_tiles)

    def work_off(c: int) -> None:
        process_tiles(
            *chunks[c], grid, machine.binning == "patch", bins.queue, bins.triangles, live, work, geometry.triangles,
            geometry.window, geometry.points.normal, pattern, depth_range, background, shading, light, first_batch,
            last_batch, target, tile_counts, np.empty(pixel.SCRATCH, np.float32),
        )  # fmt: skip

    host.run(work_off, len(chunks))
