"""The queue of one tile, entry by entry: what the machine did for each, and what became of it.

While the machine draws the frame, an onlooker works the tile's queue off once more, on a render target and a pyramid of its
own: the same tile loop is called for one entry at a time. So the counters of the entries add up to the tile's, and what a
sample shows at the end is known by entry.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.primitives import Outcome
from pipeline.types import I32, I64, U8
from tiler import back_end
from tiler.back_end import Bins
from tiler.binning import TileQueues
from tiler.coarse_z import build
from tiler.config import Machine
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.host import Host
from tiler.order import PATCH_SHIFT
from tiler.scene.model import Scene
from tiler.tile import NUM_TILE_COUNTS, Target, TileCount
from tiler.units import Units, num_domain_points

MOST_ENTRIES = 1000  # that are looked at one by one


class Fate(NamedTuple):
    """What became of a queue entry."""

    title: str
    text: str


FATES: dict[str, Fate] = {
    "visible": Fate("visible", "Samples of it are seen in the tile at the end of the frame."),
    "occluded": Fate("occluded by coarse Z", "The test against coarse Z found it hidden; nothing of it was worked on."),
    "outside": Fate("outside the view", "No triangle of the patch or sub-domain is left by the clipper."),
    "backface": Fate("back-facing", "No triangle of it passes set-up, and some are culled for their face."),
    "no_sample": Fate("between samples", "No triangle of it passes set-up: without area, between samples or off the picture."),
    "no_triangle": Fate("no triangle in the tile", "It was shaded, and all of its triangles lie in other tiles."),
    "triangles_occluded": Fate("triangles occluded", "Coarse Z hid each of its triangles in the tile, or all their blocks."),
    "uncovered": Fate("covers no sample", "Triangles of it touch the tile and cover no sample of it."),
    "failed": Fate("behind, all samples failed", "It covers samples, and all failed the depth test."),
    "overdrawn": Fate("overdrawn later", "Samples of it were written, and later entries hide them all."),
    "rest": Fate("not looked at one by one", f"What follows the first {MOST_ENTRIES:,} entries, as one line."),
}  # fmt: skip


class TileQueue(NamedTuple):
    """The entries of a tile in the order in which it worked them off; rows of all arrays.

    The last row stands for all entries after the first MOST_ENTRIES; then `unit` and `patch` of it are -1.
    """

    unit: I64  # number of the patch or sub-domain among the frame's units
    patch: I64
    triangle: I64  # tessellator's number of the triangle in the patch; -1 where entries are no triangles
    pass_number: I64
    phase: I64
    counts: I64  # (n, NUM_TILE_COUNTS) what the tile did for it
    visible: I64  # samples of the tile that show it at the end
    fate: list[str]  # names of FATES

    def column(self, name: TileCount) -> I64:
        """A counter of the entries."""
        return self.counts[:, name]


class _OneTile(Host):
    """Runs a stage over one tile alone, on the calling thread."""

    def __init__(self, tile: int) -> None:
        super().__init__(1)
        self.tile = tile

    def chunks(self, items: int, least: int = 1) -> list[tuple[int, int]]:
        return [(self.tile, self.tile + 1)]


class TileWatch:
    """An `Onlooker` that takes one tile's queue apart."""

    def __init__(self, scene: Scene, machine: Machine, grid: Grid, tile: int, check: Callable[[], None]) -> None:
        """tile : its number in the grid. check : called between entries; what it raises ends the frame."""
        self._scene, self._machine, self._grid, self._tile, self._check = scene, machine, grid, tile, check
        self._by_unit = machine.binning != "triangle"
        self._host = _OneTile(tile)
        self._target = back_end.make_target(scene.picture, ordered=True)
        for array, value in ((self._target.depth, 1.0), (self._target.visible, -1), (self._target.order, -1)):
            array.fill(value)
        self._coarse = back_end.make_coarse_z(machine, grid)
        self._phase = 0
        side, x, y = 1 << grid.tile_log2, tile % grid.tiles_x, tile // grid.tiles_x
        self._window = np.s_[y * side : (y + 1) * side, x * side : (x + 1) * side]
        self._shown_by = np.full(self._target.visible[self._window].shape, -1, np.int64)  # row of the entry seen
        self._rows: list[tuple[int, ...]] = []  # place among all entries of the frame, then the columns
        self._rest: list[tuple[int, int]] = []  # place and unit of the entries after the first MOST_ENTRIES
        self._counts: list[I64] = []
        self._seen = 0  # entries of all tiles and passes so far
        self.queue: TileQueue | None = None

    def see(
        self, number: int, phase: int, bins: Bins, batch: I32, units: Units, geometry: Geometry, order: I64
    ) -> None:
        """Work off the tile's entries of a pass, one after the other."""
        if phase > self._phase:
            self._phase = phase
            build(self._coarse, self._target.depth)
        first, end = int(bins.queue.first[self._tile]), int(bins.queue.first[self._tile + 1])
        triangles = geometry.triangles
        for q in range(first, end):
            self._check()
            if len(self._rows) == MOST_ENTRIES:
                items = bins.queue.item[q:end]
                rest = batch[items].tolist() if self._by_unit else [-1] * len(items)
                self._rest += zip(range(self._seen + q, self._seen + end), rest, strict=True)
                self._step(items, bins, batch, units, geometry, order)
                break
            item = int(bins.queue.item[q])
            if self._by_unit:
                unit, triangle = int(batch[item]), -1
                patch = int(units.owner[unit])
                one = triangles._replace(first=triangles.first[item : item + 2], used=triangles.used[item : item + 1])
                part = geometry._replace(triangles=one, outcomes=geometry.outcomes[item : item + 1])
                self._step(np.zeros(1, np.int32), bins, batch[item : item + 1], units, part, order)
            else:
                unit = patch = int(order[item]) >> PATCH_SHIFT
                triangle = int(order[item]) & ((1 << PATCH_SHIFT) - 1)
                self._step(bins.queue.item[q : q + 1], bins, batch[:0], units, geometry, order)
            self._rows.append((self._seen + q, unit, patch, triangle, number, phase))
        self._seen += len(bins.queue.item)

    def _step(
        self, items: I32, bins: Bins, batch: I32, units: Units, geometry: Geometry, order: I64
    ) -> None:  # fmt: skip
        """Work off items in the tile, and note what it counts."""
        first = np.zeros(self._grid.num_tiles + 1, np.int64)
        first[self._tile + 1 :] = len(items)
        queue = TileQueues(first, items.copy())
        counts = np.zeros((self._grid.num_tiles, NUM_TILE_COUNTS), np.int64)
        back_end.run_tiles(
            Bins(queue, bins.triangles if self._by_unit else queue), batch, geometry, order, units.bounds,
            back_end.make_rules(self._machine, self._phase), self._scene, self._grid, self._target, self._coarse, counts,
            False, False, self._host,
        )  # fmt: skip
        self._counts.append(counts[self._tile])
        if counts[self._tile, TileCount.SAMPLES_PASSED]:
            self._shown_by[self._target.visible[self._window] >= 0] = len(self._counts) - 1

    def end(self, units: Units, shaded: U8, target: Target) -> None:
        """Put the queue together. The domain cache was replayed after the frame: who shaded is known now."""
        rows = np.array(self._rows, np.int64).reshape(-1, 6)
        counts = np.array(self._counts, np.int64).reshape(-1, NUM_TILE_COUNTS)
        n = len(rows)
        if self._rest:
            rows = np.concatenate([rows, np.full((1, 6), -1)])
            counts = np.concatenate([counts[:n], counts[n:].sum(axis=0, keepdims=True)])
        if self._by_unit:
            entries = np.array([(row[0], row[1]) for row in self._rows] + self._rest, np.int64).reshape(-1, 2)
            points = num_domain_points(units, entries[:, 1].astype(np.int32))
            cost = np.where(shaded[entries[:, 0]] == 1, points, 0)
            self._charge(counts, [*cost[:n], cost[n:].sum()], [*shaded[entries[:n, 0]], shaded[entries[n:, 0]].sum()])
        shown = np.minimum(self._shown_by[self._shown_by >= 0], max(0, len(counts) - 1))
        visible = np.bincount(shown, minlength=len(counts)).astype(np.int64)
        fate = _fates(counts, visible, self._by_unit)
        if self._rest:
            fate[-1] = "rest"
        _, unit, patch, triangle, number, phase = rows.T
        self.queue = TileQueue(unit, patch, triangle, number, phase, counts, visible, fate)

    def _charge(self, counts: I64, cost: list[int], shaded: list[int]) -> None:
        """Domain-shader invocations and the domain cache's lookups, by row; `counts` is modified in place."""
        n = len(counts)
        counts[:, TileCount.DS_INVOCATIONS] = cost[:n]
        if self._machine.domain_cache != "none":
            worked = counts[:, TileCount.QUEUE_ENTRIES] - counts[:, TileCount.PAIRS_OCCLUDED]
            counts[:, TileCount.CACHE_LOOKUPS] = worked
            counts[:, TileCount.CACHE_HITS] = worked - shaded[:n]


def _fates(counts: I64, visible: I64, by_unit: bool) -> list[str]:
    """Names of FATES, a row each."""

    def of(name: TileCount | Outcome) -> I64:
        return counts[:, name]

    no_triangle = np.full(len(counts), by_unit)
    hidden = of(TileCount.TRIANGLES_OCCLUDED) + of(TileCount.BLOCKS_OCCLUDED)
    tests = [
        (visible > 0, "visible"),
        (of(TileCount.PAIRS_OCCLUDED) > 0, "occluded"),
        (no_triangle & (of(Outcome.C_OUT) == 0), "outside"),
        (no_triangle & (of(Outcome.SETUP) == 0) & (of(Outcome.FACE) > 0), "backface"),
        (no_triangle & (of(Outcome.SETUP) == 0), "no_sample"),
        (of(TileCount.TRIANGLES) + of(TileCount.TRIANGLES_OCCLUDED) == 0, "no_triangle"),
        (of(TileCount.SAMPLES_PASSED) > 0, "overdrawn"),
        (of(TileCount.SAMPLES_COVERED) > 0, "failed"),
        (hidden > 0, "triangles_occluded"),
    ]
    names = np.select([test for test, _ in tests], [name for _, name in tests], "uncovered")
    return [str(name) for name in names]
