"""Window-space triangles through the production rasterizer: projection, assembly, set-up, binning and the tile loop."""

import numpy as np

from pipeline import pixel, primitives
from pipeline.inside import make_lanes
from pipeline.types import DomainPoints, FaceCull, Patterns, Triangles, Viewport, Window
from tiler.back_end import NO_ORDER, make_coarse_z, make_rules, touched_blocks
from tiler.binning import bin_boxes
from tiler.coarse_z import depth_rows
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.host import Host
from tiler.occlusion import make_sketch
from tiler.rasterizer import MARGIN, SAMPLE_X, SAMPLE_Y
from tiler.tile import NUM_TILE_COUNTS, Target, Work, process_tiles

TILE = 32


def _one_triangle_patches(positions: np.ndarray, viewport: Viewport) -> tuple[DomainPoints, Patterns]:
    """Each triangle as a patch of its own, in clip space with w = 1, halfway into the depth range."""
    n = len(positions)
    clip = np.empty((4, 3 * n), np.float32)
    clip[0] = (2 * positions[..., 0] / viewport.width - 1).ravel()
    clip[1] = (1 - 2 * positions[..., 1] / viewport.height).ravel()
    clip[2], clip[3] = 0.5, 1
    points = DomainPoints(np.arange(n + 1, dtype=np.int64) * 3, clip, np.zeros((3, 3 * n), np.float32))
    one = np.array([0, 3], np.int64), np.arange(3, dtype=np.uint16), np.array([0, 1], np.int64)
    return points, Patterns(np.zeros(n, np.int32), np.zeros((2, 3), np.float32), *one)


def draw(positions: np.ndarray, width: int, height: int, samples: int) -> np.ndarray:
    """Number of the triangle seen at each sample, int32[height, width, samples], -1 for none; no face is culled.

    positions : float64[T, 3, 2], window positions in pixels. The viewport is a power of two, so that positions in 1/4096
    pixel come through normalized device coordinates unrounded.
    """
    n = len(positions)
    side = 1 << (max(width, height) - 1).bit_length()
    viewport = Viewport(0, 0, side, side, 0.0, 1.0)
    guard = primitives.guard_band(viewport)
    points, patterns = _one_triangle_patches(positions, viewport)
    live = np.arange(n, dtype=np.int32)
    window = Window(*(np.empty(3 * n, t) for t in (np.int32, np.int32, np.float32, np.float32, np.uint8)))
    primitives.project_points(0, 3 * n, points.clip, viewport, guard, window)
    assert not (window.code & primitives.NEEDS_CLIP).any(), "the families stay inside the guard band"
    triangles = Triangles(
        np.arange(n + 1, dtype=np.int64), np.zeros(n, np.int32), np.zeros((n, 3), np.int32), np.zeros((n, 4), np.int16),
        np.zeros(n, np.uint16), np.zeros(n, np.uint8), np.zeros(n, np.int32), np.zeros(n, np.int32),
    )  # fmt: skip
    outcomes = np.zeros((n, primitives.NUM_OUTCOMES), np.int64)
    primitives.assemble(
        0, n, live, patterns, points, np.full(n + 1, 3 * n, np.int64), viewport, guard, (0, 0, width - 1, height - 1),
        MARGIN[samples], int(FaceCull.NONE), window, triangles, outcomes, np.zeros(3 * n, np.uint8), np.empty(n, np.int64),
        np.empty((2 * primitives.MAX_CORNERS, primitives.POLYGON)), make_lanes(3),
    )  # fmt: skip
    grid = make_grid(width, height, TILE)
    shape = (height, width, samples)
    color = np.zeros((*shape, 4), np.uint8)
    target = Target(
        np.empty(shape, np.float32), np.empty(shape, np.int32), color, np.zeros((height, width, 4), np.uint8),
        np.empty((0, 0, 0), np.int64),
    )  # fmt: skip
    with Host(1) as host:
        queue = bin_boxes(triangles.first, triangles.used, triangles.box, grid, host)
    machine = Machine(tile=TILE, binning="triangle")
    coarse = make_coarse_z(machine, grid)
    boxes = np.empty((0, 8, 4)), np.empty((0, 4))
    work = Work(np.zeros((n, 4), np.int32), np.zeros(n, np.float32), np.zeros((n, 3, 3)), *boxes, outcomes)
    process_tiles(
        0, grid.num_tiles, grid, make_rules(machine), queue, queue, work, viewport, triangles, NO_ORDER, window, points.normal,
        (SAMPLE_X[samples], SAMPLE_Y[samples], MARGIN[samples]), (np.float32(0), np.float32(1)), np.zeros(4, np.uint8), 0,
        (0.0, 0.0, 1.0), True, True, target, coarse, depth_rows(target.depth), touched_blocks(coarse), make_sketch(),
        np.zeros(len(queue.item), np.uint8), np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64),
        np.empty(pixel.SCRATCH, np.float32),
    )  # fmt: skip
    return np.where(target.visible >= 0, triangles.patch[target.visible], -1)


def production_coverage(triangles: np.ndarray, width: int, height: int, samples: int, cell: int) -> np.ndarray:
    """Samples that the production rasterizer covers, for each triangle by itself: bool[T, cell, cell, samples].

    triangles : float64[T, 3, 2], window positions in pixels before snapping, y down, either winding, in a window of
    cell x cell pixels whose upper left pixel is (0, 0).
    width, height : the render target to use, multiples of `cell`. When it holds several cells, triangles lie within
    [0, cell] and are put in one cell each, moved by whole cells; so that the rasterizer also works far from the origin.
    When cell == width == height each triangle gets the target to itself, and may reach far outside of it.
    """
    in_row = width // cell
    in_target = in_row * (height // cell)
    covered = np.zeros((len(triangles), cell, cell, samples), bool)
    for first in range(0, len(triangles), in_target):
        some = triangles[first : first + in_target]
        k = np.arange(len(some))
        moved = some + (np.stack([k % in_row, k // in_row], -1) * cell)[:, None]
        seen = draw(moved, width, height, samples)
        for t in k:
            y, x = t // in_row * cell, t % in_row * cell
            covered[first + t] = seen[y : y + cell, x : x + cell] == t
        assert covered[first : first + len(some)].sum() == (seen >= 0).sum(), "a triangle was drawn outside its cell"
    return covered
