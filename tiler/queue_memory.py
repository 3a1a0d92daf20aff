"""What a frame's tile queues take of memory by a model (`tiler/queue_models.py`), and where a full pool cuts the frame.

`QueueMemory` follows a frame batch by batch: each batch hands over its tile queues and who owns what (plain arrays), and
gets back the same queues cut into passes. A flush is a partial render: the tiles work off what is queued, colour and depth
stay in memory, and the queues start empty again; the picture is the same, because nearer still wins and of equal depths
the first submitted stays.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.primitives import Outcome
from pipeline.types import I32, I64
from tiler import queue_lists
from tiler.binning import TileQueues
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.queue_lists import Layout, Levels, Lists, Scheme, Sum
from tiler.queue_models import Binning, Policy, QueueModel, load_queue_model
from tiler.regions import Drawn
from tiler.tile import TileCount

SAMPLE_BYTES = 8  # colour and depth of a sample
PERCENTILES = (50, 90, 99, 100)


class Items(NamedTuple):
    """What the entries of a batch stand for. owner : the patch of each item. shared : records that items share.

    lasting : whether the numbers of shared records mean the same in every batch. stored : how many items and shared records
    have an entry, where that is known and no two batches share a record.
    """

    owner: I32  # (items,) patch number
    shared: I32  # (items, K) numbers of shared records, 0 .. num_shared-1
    num_shared: int
    lasting: bool = False
    stored: tuple[int, int] | None = None


@dataclass(frozen=True)
class QueueReport:
    """Memory of a frame's queues by a model.

    entries_written, entries_read : entries of lists of all levels. bytes_written : entries, links, headers, records; in
    every pass again. bytes_read : the same where tiles (and the fine level of a cascade) walk them, without any cache: an
    entry that is read fetches its record, and each record that it shares. peak_bytes : most in use at a time.
    allocated_bytes : given out, of all passes: bytes_written + wasted_bytes. chunks : given to lists. flushes : passes
    begun because the pool was full. grows : how often the pool was doubled.
    tile_passes : int64[tiles_y, tiles_x], passes in which the tile had an
    entry. tile_bytes : int64[tiles_y, tiles_x], bytes of lists (headers, links, entries) that the tile walks.
    percentiles : of tile_bytes at 50, 90, 99 and 100 percent of the tiles (nearest rank). longest_tile : of the queue with
    most entries, the first of equal ones; -1 where nothing is queued. longest_patch : the patch that caused it: the one with
    most entries in it, of equal ones the one with most entries in all queues, then the earlier.
    spilled_bytes : colour and depth that tiles write at the end of a pass and read again at their next.
    """

    model: str
    entries_written: int
    entries_read: int
    bytes_written: int
    bytes_read: int
    peak_bytes: int
    allocated_bytes: int
    chunks: int
    flushes: int
    grows: int
    tile_passes: I64
    tile_bytes: I64
    percentiles: dict[int, int]
    longest_tile: int
    longest_patch: int
    spilled_bytes: int

    @property
    def wasted_bytes(self) -> int:
        """Bytes given out in which nothing was written."""
        return self.allocated_bytes - self.bytes_written

    def counters(self) -> dict[str, int]:
        """The counters of `tiler/counters.py` that come from here."""
        return {
            "queue_bytes_written": self.bytes_written,
            "queue_bytes_read": self.bytes_read,
            "queue_peak_bytes": self.peak_bytes,
            "queue_chunks": self.chunks,
            "queue_wasted_bytes": self.wasted_bytes,
            "queue_flushes": self.flushes,
            "queue_grows": self.grows,
            "queue_tile_passes": int(self.tile_passes.sum()),
            "om_spilled_bytes": self.spilled_bytes,
        }


def triangle_items(geometry: Geometry, overlap: str) -> Items:
    """`triangle` binning: an item is a set-up triangle, and shares its three vertices. overlap : as `Machine.overlap`.

    With `rect` each is in some tile's queue: its box holds a sample of the picture.
    """
    triangles = geometry.triangles
    stored = (int(triangles.used.sum()), int(geometry.num_used.sum())) if overlap == "rect" else None
    return Items(triangles.patch, triangles.vertex, len(geometry.window.x), stored=stored)


def patch_items(live: I32) -> Items:
    """`patch` binning: an item is a live patch, and shares nothing."""
    return Items(live, np.zeros((len(live), 0), np.int32), 0)


def subpatch_items(owner: I32) -> Items:
    """`subpatch` binning: an item is a sub-domain of patch owner[i], and shares that patch's record."""
    return Items(owner, owner.reshape(-1, 1), int(owner.max(initial=-1)) + 1, lasting=True)


def describe_items(binning: Binning, overlap: str, owner: I32, geometry: Geometry) -> Items:
    """Items of a batch of units, by what is binned. owner : the patch of each unit. overlap : as `Machine.overlap`."""
    if binning == "triangle":
        return triangle_items(geometry, overlap)
    return patch_items(owner) if binning == "patch" else subpatch_items(owner)


def make_queue_memory(machine: Machine, grid: Grid, samples: int) -> "QueueMemory":
    """The queues of a machine's frame. Raises TilerError where its pool is too small for any frame."""
    return QueueMemory(
        load_queue_model(machine.queue_model),
        machine.binning,
        grid,
        name=machine.queue_model,
        pool=machine.queue_pool,
        policy=machine.queue_policy,
        samples=samples,
        phased=machine.phased,
    )


class QueueMemory:
    """The queues of one frame in the making.

    model : the layout; name : what to call it. pool : bytes, or None for the model's own limit. policy : what happens where
    the pool is full, or None for the model's own. phased : whether `drain` may be called. Raises TilerError where the pool
    has no room for what lists have from the start.
    """

    def __init__(
        self,
        model: QueueModel,
        binning: Binning,
        grid: Grid,
        *,
        name: str = "",
        pool: int | None = None,
        policy: Policy | None = None,
        samples: int = 1,
        phased: bool = False,
    ) -> None:
        self.name, self.grid, self.samples = name, grid, samples
        self.levels = _levels(model, model.entry_bytes(binning), grid)
        self.policy: Policy = policy or model.policy
        self.layout = _layout(model, binning, self.policy, grid, self.levels)
        capacity = pool or model.pool_bytes or 0
        if self.policy != "grow" and 0 < capacity < self.layout.static_bytes:
            raise TilerError(
                f"machine.queue_pool: {capacity} is less than the {self.layout.static_bytes} bytes that the lists of "
                f"{name} have from the start; allowed: a larger pool, or queue_policy = grow"
            )
        num_lists = int(self.levels.first[-1])
        self.lists = Lists(*(np.zeros(num_lists, np.int64) for _ in Lists._fields))
        self.sums: I64 = np.zeros(len(Sum), np.int64)
        self.sums[Sum.CAPACITY], self.sums[Sum.FAILED_ITEM] = capacity, -1
        while 0 < self.sums[Sum.CAPACITY] < self.layout.static_bytes:
            self.sums[Sum.CAPACITY] *= 2
            self.sums[Sum.GROWS] += 1
        queue_lists.start(self.sums, self.layout)
        one_list = model.scheme == "flat" and model.level[0].streams == 1
        self.order_decides_nothing = one_list and not capacity and not model.record.block_bytes and not phased
        self.shared_pass: I64 = np.zeros(0, np.int64)  # of shared records that last from batch to batch
        self.tile_pass: I64 = np.zeros(grid.num_tiles, np.int64)
        self.tile_passes: I64 = np.zeros(grid.num_tiles, np.int64)
        self.entries: I64 = np.zeros(grid.num_tiles, np.int64)
        self.most: I64 = np.zeros((grid.num_tiles, 3), np.int64)
        self.most[:, 2] = -1

    @property
    def passes(self) -> int:
        """Passes begun so far."""
        return int(self.sums[Sum.PASS])

    def drain(self) -> None:
        """The tiles work off what is queued, though the pool is not full: between the phases of a machine that has two."""
        if self.sums[Sum.ITEMS] > self.sums[Sum.PASS_ITEMS]:
            queue_lists.start(self.sums, self.layout)

    def append(self, queues: TileQueues, items: Items) -> list[TileQueues]:
        """Append a batch's entries, item after item; its queues cut where a new pass began, at least one part.

        queues : the machine's own, one a tile; item numbers are in submit order. Raises TilerError where an item does not
        fit and the policy has no way out.
        """
        cuts = self.cut_at_pool(queues, items)
        self.entries += np.diff(queues.first)
        queue_lists.rank_owners(queues.first, queues.item, items.owner, _spread(queues, items.owner), self.most)
        return split_queues(queues, cuts)

    def append_drawn(self, drawn: Drawn) -> None:
        """As `append` for all triangles of a frame that was drawn in regions; where their order decides nothing."""
        entries = drawn.counts[:, TileCount.QUEUE_ENTRIES]
        first = np.zeros(len(entries) + 1, np.int64)
        np.cumsum(entries, out=first[1:])
        triangles, vertices = int(drawn.outcomes[:, Outcome.SETUP].sum()), int(drawn.num_used.sum())
        self._append_flat(first, triangles, vertices, 3)
        self.entries += entries
        self.most[:] = drawn.most

    def _append_flat(self, first: I64, items: int, records: int, num_shared: int) -> None:
        """first : int64[tiles+1], where each tile's entries begin. The others as in `queue_lists.append_flat`."""
        chunk = (int(column[0]) for column in self.levels[4:7])
        queue_lists.append_flat(
            first, items, records, num_shared, self.sums, self.layout, *chunk, int(self.levels.static_chunks[0]),
            self.lists.entries, self.lists.walked, self.tile_pass, self.tile_passes,
        )  # fmt: skip

    def cut_at_pool(self, queues: TileQueues, items: Items) -> I64:
        """Account for a batch's entries; the items with which a new pass began, in order."""
        n = len(items.owner)
        known = items.stored if self.order_decides_nothing else None
        shared_pass = np.zeros(0 if known else items.num_shared, np.int64)
        if items.lasting:
            shared_pass[: len(self.shared_pass)] = self.shared_pass[: items.num_shared]
            self.shared_pass = shared_pass = np.append(shared_pass, self.shared_pass[items.num_shared :])
        if self.order_decides_nothing:
            num_items, records = known or queue_lists.count_stored(
                queues.first, queues.item, items.shared, shared_pass, np.zeros(n, np.uint8)
            )
            self._append_flat(queues.first, num_items, records, items.shared.shape[1])
            return np.zeros(0, np.int64)
        first = np.zeros(n + 1, np.int64)
        np.cumsum(np.bincount(queues.item, minlength=n), out=first[1:])
        tile_of = np.empty(first[-1], np.int32)
        queue_lists.tiles_of_items(queues.first, queues.item, first[:-1].copy(), tile_of)
        cuts = np.empty(n if self.sums[Sum.CAPACITY] else 0, np.int64)
        num_cuts = queue_lists.append_items(
            first, tile_of, items.shared, shared_pass, self.sums, self.layout, self.levels,
            self.lists, self.tile_pass, self.tile_passes, cuts,
        )  # fmt: skip
        failed = int(self.sums[Sum.FAILED_ITEM])
        if failed >= 0:
            raise TilerError(self._overflow(int(items.owner[failed]), int(first[failed + 1] - first[failed])))
        return cuts[:num_cuts].copy()

    def report(self) -> QueueReport:
        """The frame's sums, when all batches are appended."""
        s, grid = self.sums, self.grid
        shape = (grid.tiles_y, grid.tiles_x)
        tile_bytes = self._tile_bytes()
        ordered = np.sort(tile_bytes.ravel())
        longest = int(self.entries.argmax()) if self.entries.any() else -1
        return QueueReport(
            model=self.name,
            entries_written=int(s[Sum.ENTRIES]),
            entries_read=int(s[Sum.WALKED]),
            bytes_written=int(s[Sum.WRITTEN]),
            bytes_read=int(s[Sum.READ]),
            peak_bytes=int(s[Sum.PEAK]),
            allocated_bytes=int(s[Sum.ALLOCATED]),
            chunks=int(s[Sum.CHUNKS]),
            flushes=int(s[Sum.FLUSHES]),
            grows=int(s[Sum.GROWS]),
            tile_passes=self.tile_passes.reshape(shape).copy(),
            tile_bytes=tile_bytes,
            percentiles={p: int(ordered[max(0, -(-p * len(ordered) // 100) - 1)]) for p in PERCENTILES},
            longest_tile=longest,
            longest_patch=int(self.most[longest, 2]) if longest >= 0 else -1,
            spilled_bytes=int((np.maximum(self.tile_passes - 1, 0) * self._tile_pixels()).sum())
            * (2 * SAMPLE_BYTES * self.samples),
        )

    def _overflow(self, patch: int, tiles: int) -> str:
        needed, pool = int(self.sums[Sum.NEEDED]), int(self.sums[Sum.CAPACITY])
        if self.policy == "flush":
            return (
                f"machine.queue_pool: {pool} is too small for an item of patch {patch} alone: with its {tiles} tile(s) "
                f"empty queues need {needed} bytes; allowed: at least that, or queue_policy = grow"
            )
        return (
            f"machine.queue_pool: {pool} is full at patch {patch}: with it the queues need {needed} bytes; "
            f"allowed: a larger pool, or queue_policy = grow or flush"
        )

    def _tile_pixels(self) -> I64:
        """Pixels of each tile, int64[tiles]; those at the right and bottom are cut off by the picture."""
        side = 1 << self.grid.tile_log2
        wide = np.minimum(side, self.grid.width - side * np.arange(self.grid.tiles_x))
        high = np.minimum(side, self.grid.height - side * np.arange(self.grid.tiles_y))
        return np.outer(high, wide).ravel()

    def _tile_bytes(self) -> I64:
        """Bytes of lists that each tile walks; of a cascade those of the finest level."""
        levels, shape = self.levels, (self.grid.tiles_y, self.grid.tiles_x)
        total = np.zeros(shape, np.int64)
        passes = int(self.sums[Sum.PASS])
        for k in range(len(levels.shift) if self.layout.scheme == Scheme.HIERARCHY else 1):
            lists = self.lists.walked[levels.first[k] : levels.first[k + 1]] + passes * levels.header_bytes[k]
            squares = lists.reshape(levels.tiles_y[k], levels.tiles_x[k], levels.streams[k]).sum(axis=2)
            y, x = (np.arange(n) >> levels.shift[k] for n in shape)
            total += squares[np.ix_(y, x)]
        return total


def _spread(queues: TileQueues, owner: I32) -> I64:
    """Entries that each patch has in all queues, int64[patches]. owner : int32[items], the patch of each item."""
    spread = np.zeros(int(owner.max(initial=-1)) + 1, np.int64)
    queue_lists.count_owners(queues.item, owner, spread)
    return spread


def split_queues(queues: TileQueues, cuts: I64) -> list[TileQueues]:
    """Cut queues into runs of items: one run before the first cut, one from each cut on; a run without an entry is left out.

    At least one part; all parts together hold each entry once, in the same order.
    """
    if len(cuts) == 0:
        return [queues]
    run = np.searchsorted(cuts, queues.item, side="right")
    order = np.argsort(run, kind="stable")
    tile = np.repeat(np.arange(len(queues.first) - 1), np.diff(queues.first))[order]
    item = queues.item[order]
    ends = np.cumsum(np.bincount(run, minlength=len(cuts) + 1))
    parts = []
    for begin, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
        if begin < end:
            first = np.searchsorted(tile[begin:end], np.arange(len(queues.first)), side="left")
            parts.append(TileQueues(first.astype(np.int64), item[begin:end]))
    return parts


def _levels(model: QueueModel, entry_bytes: int, grid: Grid) -> Levels:
    shift = np.array([level.side.bit_length() - 1 for level in model.level], np.int64)
    tiles_x, tiles_y = -(-grid.tiles_x >> shift), -(-grid.tiles_y >> shift)
    streams = np.array([level.streams for level in model.level], np.int64)

    def column(values: list[int]) -> I64:
        return np.array(values, np.int64)

    return Levels(
        shift=shift,
        tiles_x=tiles_x,
        tiles_y=tiles_y,
        first=np.concatenate([[0], np.cumsum(tiles_x * tiles_y * streams)]),
        chunk_entries=column([level.entries_of(entry_bytes) for level in model.level]),
        chunk_bytes=column([level.bytes_of(entry_bytes) for level in model.level]),
        link_bytes=column([level.link_bytes for level in model.level]),
        header_bytes=column([level.header_bytes for level in model.level]),
        static_chunks=column([level.static_chunks for level in model.level]),
        streams=streams,
        stream_batch=column([level.stream_batch for level in model.level]),
    )


def _layout(model: QueueModel, binning: Binning, policy: Policy, grid: Grid, levels: Levels) -> Layout:
    item_bytes, shared_bytes = model.record_bytes(binning)
    num_lists = np.diff(levels.first)
    headers = int((num_lists * levels.header_bytes).sum())
    read = headers
    if model.scheme == "hierarchy":
        read = grid.num_tiles * int((levels.header_bytes * levels.streams).sum())
    return Layout(
        scheme=int(Scheme[model.scheme.upper()]),
        spread=model.spread,
        policy=int(queue_lists.Policy[policy.upper()]),
        tiles_x=grid.tiles_x,
        tiles_y=grid.tiles_y,
        entry_bytes=model.entry_bytes(binning),
        item_bytes=item_bytes,
        shared_bytes=shared_bytes,
        block_bytes=model.record.block_bytes,
        static_bytes=headers + int((num_lists * levels.static_chunks * levels.chunk_bytes).sum()),
        header_read_bytes=read,
        header_bytes=headers,
        static_chunks=int((num_lists * levels.static_chunks).sum()),
    )
