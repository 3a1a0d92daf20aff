"""The tile loop for machines that share stages (`tiler/shared.py`): what can be drawn once is drawn once.

A batch that is a whole phase of the frame is drawn on a copy of the canvas, so that the result can be kept; every machine
that hands the same queues to its tiles gets it. Machines that differ in their domain cache, cores, walk or queue memory do.

A machine that makes no test in its tiles and draws in submit order rasterizes, whatever it queues, the triangles of each tile
in that order: that is what a `triangle` machine with this tile size does, so both are drawn once. What the tiles of `patch`
binning count besides, each unit's own work, is added from the queues, and with it goes the proof that no triangle was left
out: the tile's queue holds the unit of each triangle that is binned to the tile. Where one is missing (a bound that is too
tight), the machine draws for itself.
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import kernel
from pipeline.primitives import NUM_OUTCOMES
from pipeline.types import I32, I64, U8, PatchBounds, Triangles, Window
from tiler import back_end
from tiler.back_end import Bins, Canvas
from tiler.binning import TileQueues
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.host import Host
from tiler.scene.model import Scene
from tiler.shared import ALONE, Stages
from tiler.tile import KEEP, NUM_TILE_COUNTS, Rules, TileCount

SAMPLE_BYTES = 20  # of a canvas: depth, visible triangle, colour, submit number
NO_UNITS = np.empty(0, np.int32)
NO_BOUNDS = PatchBounds(
    np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 8, 4)), np.empty((0, 4)), np.empty((0, 4), np.int32),
    np.empty(0, np.float32), np.empty(0, np.uint8), np.empty((0, 3)), np.empty(0),
)  # fmt: skip


class Drawn(NamedTuple):
    """A canvas after a batch, what its tiles counted, and what became of the queue entries (`back_end.run_tiles`)."""

    canvas: Canvas
    counts: I64  # (tiles, NUM_TILE_COUNTS)
    outcome: U8  # (entries,)


class Easel:
    """The canvas of a frame in the making."""

    def __init__(self, scene: Scene, grid: Grid, ordered: bool, block: int, host: Host, shared: Stages) -> None:
        """ordered, block : as in `back_end.make_canvas`. shared : how stages run."""
        self.scene, self.grid, self.host, self.shared = scene, grid, host, shared
        samples = scene.picture.width * scene.picture.height * scene.picture.samples
        self._is_kept = SAMPLE_BYTES * samples <= shared.most_bytes // 4  # else copies would take memory for nothing
        make = shared.run if self._is_kept else ALONE.run
        self.canvas: Canvas = make(back_end.make_canvas, scene.picture, ordered, block, grid)
        self._mine = not self._is_kept  # whether nobody else may see the canvas
        self._clear = True  # not drawn on yet

    def draw(
        self, part: Bins, batch: I32, geometry: Geometry, order: I64, bounds: PatchBounds, rules: Rules, counts: I64,
        last: bool, whole: bool,
    ) -> U8:  # fmt: skip
        """`back_end.run_tiles` of a pass of a batch; `counts` modified in place. whole : of all of a phase."""
        first, self._clear = self._clear, False
        if whole and self._is_kept:
            drawn = draw_phase(
                part, batch, geometry, order, bounds, rules, self.scene, self.grid, self.canvas, first, last, self.host,
                self.shared,
            )  # fmt: skip
            self.canvas, self._mine = drawn.canvas, False
            counts += drawn.counts
            return drawn.outcome
        if not self._mine:
            self.canvas, self._mine = back_end.copy_canvas(self.canvas, self.scene.picture, cleared=first), True
        return back_end.run_tiles(
            part, batch, geometry, order, bounds, rules, self.scene, self.grid, self.canvas.target, self.canvas.coarse,
            counts, first, last, self.host,
        )  # fmt: skip

    def build_pyramid(self) -> None:
        """Build the pyramid from what is drawn, between two phases."""
        run = ALONE.run if self._mine else self.shared.run
        self.canvas = run(back_end.rebuild, self.canvas)


def draw_phase(
    bins: Bins, live: I32, geometry: Geometry, order: I64, bounds: PatchBounds, rules: Rules, scene: Scene, grid: Grid,
    canvas: Canvas, first: bool, last: bool, host: Host, shared: Stages,
) -> Drawn:  # fmt: skip
    """`back_end.run_tiles` for a phase in one batch and one pass, on a canvas that stays as it is."""
    if not rules.by_unit:
        return shared.run(
            _draw_triangles, bins.triangles, geometry.drawn, geometry.window, geometry.points.normal, order, rules, scene,
            grid, canvas, first, last, host,
        )  # fmt: skip
    if not (rules.ties or rules.pairs or rules.triangles or rules.blocks) and rules.update == KEEP:
        counts = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
        if _count_units(bins.queue, bins.triangles, geometry.triangles, geometry.outcomes, counts):
            drawn = shared.run(
                _draw_triangles, bins.triangles, geometry.drawn, geometry.window, geometry.points.normal, order,
                rules._replace(by_unit=False), scene, grid, canvas, first, last, host,
            )  # fmt: skip
            counts += drawn.counts
            counts[:, TileCount.QUEUE_ENTRIES] = np.diff(bins.queue.first)
            return Drawn(drawn.canvas, counts, np.zeros(len(bins.queue.item), np.uint8))
    return shared.run(
        _draw_units, bins, live, geometry, order, bounds, rules, scene, grid, canvas, first, last, host
    )  # fmt: skip


def _draw_triangles(
    queue: TileQueues, drawn: Triangles, window: Window, normal: np.ndarray, order: I64, rules: Rules, scene: Scene,
    grid: Grid, canvas: Canvas, first: bool, last: bool, host: Host,
) -> Drawn:  # fmt: skip
    points = back_end.NO_POINTS._replace(normal=normal)
    geometry = Geometry(points, window, drawn, np.empty((0, NUM_OUTCOMES), np.int64), np.empty(0, np.int64), drawn)
    return _draw_units(
        Bins(queue, queue), NO_UNITS, geometry, order, NO_BOUNDS, rules, scene, grid, canvas, first, last, host
    )  # fmt: skip


def _draw_units(
    bins: Bins, live: I32, geometry: Geometry, order: I64, bounds: PatchBounds, rules: Rules, scene: Scene, grid: Grid,
    canvas: Canvas, first: bool, last: bool, host: Host,
) -> Drawn:  # fmt: skip
    canvas = back_end.copy_canvas(canvas, scene.picture, cleared=first)
    counts = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
    outcome = back_end.run_tiles(
        bins, live, geometry, order, bounds, rules, scene, grid, canvas.target, canvas.coarse, counts, first, last, host
    )
    return Drawn(canvas, counts, outcome)


@kernel
def _count(queue, triangle_queue, triangles, outcomes, outside, counts):
    for tile in range(len(counts)):
        place, end = triangle_queue.first[tile], triangle_queue.first[tile + 1]
        for q in range(queue.first[tile], queue.first[tile + 1]):
            k = queue.item[q]
            if place < end and triangle_queue.item[place] < triangles.first[k]:
                return False
            for c in range(NUM_OUTCOMES):
                counts[tile, c] += outcomes[k, c]
            counts[tile, outside] += triangles.used[k]
            while place < end and triangle_queue.item[place] < triangles.first[k] + triangles.used[k]:
                place += 1
                counts[tile, outside] -= 1
        if place < end:
            return False
    return True


def _count_units(
    queue: TileQueues, triangle_queue: TileQueues, triangles: Triangles, outcomes: I64, counts: I64
) -> bool:
    """Count what tiles do for the units in their queues, where coarse Z hides none; `counts` modified in place.

    False if a triangle is binned to a tile whose queue lacks its unit; then `counts` says nothing.
    """
    found: bool = _count(queue, triangle_queue, triangles, outcomes, int(TileCount.OUTSIDE), counts)
    return found
