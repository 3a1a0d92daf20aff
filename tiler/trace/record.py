"""A frame drawn once more with everything kept that a timeline shows: each tile's entries in order, pass by pass.

The machine is the same, only its tally and its queues' memory take notes; a frame that is not traced pays nothing.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pipeline.primitives import NUM_OUTCOMES
from pipeline.types import I32, I64, U8
from tiler.binning import TileQueues
from tiler.config import Machine
from tiler.counters import Counters
from tiler.front_end import Geometry
from tiler.grid import Grid, make_grid
from tiler.host import Host
from tiler.machine import draw_frame, last_frame
from tiler.queue_lists import Sum
from tiler.queue_memory import Items, QueueMemory
from tiler.queue_models import load_queue_model
from tiler.scene.model import Scene
from tiler.tally import OUTCOME_COUNTERS, TILE_COUNTERS, Tally
from tiler.units import Units, num_domain_points


class Entries(NamedTuple):
    """Queue entries, batch by batch and tile by tile in queue order; (entries,) each."""

    pass_number: I64  # from 1
    tile: I64
    unit: I64  # number of the unit; the patch in triangle binning
    hidden: U8  # 1: coarse Z hid it, and nothing of it was worked on
    shaded: U8  # 1: its unit was shaded for it (patch and subpatch binning)


@dataclass(frozen=True)
class Recording:
    """What a frame's timeline is made of.

    visits : keys pass * tiles + tile, and counters by column of `tile_columns`, int64[visits, NUM_TILE_COUNTS], one row for
    each batch of the host in which the tile counted something; those of the domain shader and its cache are not in it.
    outcomes : int64[units, NUM_OUTCOMES], clipping and set-up of a unit wherever it is worked on. points : int64[units],
    domain points of a unit. owner : int32[units], patch of a unit. pool : after each batch (pass, bytes in use).
    """

    scene: str
    machine: Machine
    number: float
    grid: Grid
    walk: I64
    counters: Counters
    entries: Entries
    visits: tuple[I64, I64]
    outcomes: I64
    points: I64
    owner: I32
    pool: tuple[tuple[int, int], ...]


def tile_columns(machine: Machine) -> dict[str, int]:
    """Counters that are known of every visit of a tile, by column. Binning writes the entries: they are the front end's."""
    columns = {name: int(column) for name, column in TILE_COUNTERS.items() if name != "queue_entries"}
    if machine.binning != "triangle":
        columns |= {name: int(column) for name, column in OUTCOME_COUNTERS.items()}
    return columns


class NotingTally(Tally):
    """A tally that keeps what each pass adds to each tile, and every queue entry."""

    def __init__(self, scene: Scene, machine: Machine, grid: Grid) -> None:
        super().__init__(scene, machine, grid)
        self.visits: list[tuple[I64, I64]] = []
        self.noted: list[Entries] = []
        self.outcomes_of: I64 = np.zeros((0, NUM_OUTCOMES), np.int64)
        self.units: Units | None = None
        self._before = self.tiles.copy()
        self._patch_of: I32 = np.zeros(0, np.int32)

    def count_batch(self, units: Units, live: I32, geometry: Geometry, queues: TileQueues) -> None:
        """As the tally does, and note what set-up made of each unit."""
        super().count_batch(units, live, geometry, queues)
        if self.units is None:
            self.units, self.outcomes_of = units, np.zeros((len(units.owner), NUM_OUTCOMES), np.int64)
        self.outcomes_of[live] = geometry.outcomes
        self._patch_of = geometry.triangles.patch

    def count_entries(self, live: I32, queues: TileQueues, outcome: U8, number: int) -> None:
        """As the tally does, and note the entries and what they added to their tiles."""
        super().count_entries(live, queues, outcome, number)
        added = self.tiles - self._before
        self._before = self.tiles.copy()
        tiles = np.flatnonzero(added.any(axis=1))
        self.visits.append((number * self.grid.num_tiles + tiles, added[tiles]))
        n, by_unit = len(queues.item), self.machine.binning != "triangle"
        self.noted.append(
            Entries(
                np.full(n, number, np.int64),
                np.repeat(np.arange(self.grid.num_tiles), np.diff(queues.first)),
                (live if by_unit else self._patch_of)[queues.item].astype(np.int64),
                outcome.copy(),
                np.zeros(n, np.uint8),
            )
        )

    def entries(self) -> Entries:
        """All entries, after the frame."""
        kinds = (np.int64, np.int64, np.int64, np.uint8, np.uint8)
        none: tuple[Any, ...] = tuple(np.zeros(0, kind) for kind in kinds)
        whole = Entries(*(np.concatenate(parts) for parts in zip(none, *self.noted, strict=True)))
        return whole if self.machine.binning == "triangle" else whole._replace(shaded=self.shaded)


class NotingMemory(QueueMemory):
    """Queue memory that keeps how many bytes were in use after each batch."""

    pool: list[tuple[int, int]]

    def append(self, queues: TileQueues, items: Items) -> list[TileQueues]:
        """As the memory does, and note the bytes in use."""
        parts = super().append(queues, items)
        self.pool.append((self.passes, int(self.sums[Sum.USED])))
        return parts


def record_frame(scene: Scene, machine: Machine, number: float, threads: int) -> Recording:
    """Draw a frame and keep what its timeline shows. Arguments as of `tiler.simulate`, already checked."""
    tally = NotingTally(scene, machine, make_grid(scene.picture.width, scene.picture.height, machine.tile))
    memory = NotingMemory(
        load_queue_model(machine.queue_model), machine.binning, tally.grid, name=machine.queue_model,
        pool=machine.queue_pool, policy=machine.queue_policy, samples=scene.picture.samples, phased=machine.phased,
    )  # fmt: skip
    memory.pool = []
    with Host(threads) as host:
        history = last_frame(scene, machine, number, host) if machine.phased else None
        target = draw_frame(scene, machine, number, host, history, tally, memory, lambda part: None)
    units = tally.units
    keys, rows = zip(*tally.visits, strict=True)  # there is a batch, of no patch if need be
    return Recording(
        scene=scene.name,
        machine=machine,
        number=number,
        grid=tally.grid,
        walk=tally.walk,
        counters=tally.counters(target, memory.report().counters()),
        entries=tally.entries(),
        visits=(np.concatenate(keys), np.concatenate(rows)),
        outcomes=tally.outcomes_of,
        points=np.zeros(0, np.int64)
        if units is None
        else num_domain_points(units, np.arange(len(units.owner), dtype=np.int32)),
        owner=np.zeros(0, np.int32) if units is None else units.owner,
        pool=tuple(memory.pool),
    )
