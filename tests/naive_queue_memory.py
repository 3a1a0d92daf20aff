"""Slow twin of `tiler/queue_memory.py`: lists of Python objects, chunk by chunk, one entry at a time, everything looked up."""

import copy
from dataclasses import dataclass, field

from tiler.queue_models import Binning, QueueModel


@dataclass
class Chunk:
    """A piece of a list: how many entries it has room for, and those in it."""

    room: int
    taken_from_pool: int
    entries: list[int] = field(default_factory=list)


@dataclass
class Overflow(Exception):
    """An item that did not fit."""

    item: int
    needed: int


class NaiveQueueMemory:
    """The queues of one frame. items are appended as (owner, tiles, names of shared records)."""

    def __init__(
        self,
        model: QueueModel,
        binning: Binning,
        tiles_x: int,
        tiles_y: int,
        *,
        pool: int | None = None,
        policy: str = "",
    ) -> None:
        self.model, self.tiles_x, self.tiles_y = model, tiles_x, tiles_y
        self.policy = policy or model.policy
        self.capacity = pool or model.pool_bytes or 0
        self.entry_bytes = model.entry_bytes(binning)
        self.item_bytes, self.shared_bytes = model.record_bytes(binning)
        self.flushes = self.grows = self.peak = self.allocated = self.written = self.read = self.chunks = 0
        self.entries_written = self.entries_read = self.appended = 0
        self.tiles = [(x, y) for y in range(tiles_y) for x in range(tiles_x)]
        self.tile_bytes = dict.fromkeys(self.tiles, 0)
        self.tile_passes = dict.fromkeys(self.tiles, 0)
        self.owners: dict[tuple[int, int], list[int]] = {tile: [] for tile in self.tiles}
        self.cuts: list[int] = []
        self.open_pass()
        while self.capacity and self.used > self.capacity:
            self.capacity, self.grows = 2 * self.capacity, self.grows + 1

    # A pass.

    def squares(self, level: int) -> list[tuple[int, int]]:
        side = self.model.level[level].side
        return sorted({(x // side, y // side) for x, y in self.tiles})

    def open_pass(self) -> None:
        self.lists: dict[tuple, list[Chunk]] = {}
        self.item_of_list: dict[tuple, list[int]] = {}
        self.records: set = set()
        self.item_records = 0
        self.block_room = 0
        self.used = 0
        self.touched: set = set()
        for k, level in enumerate(self.model.level):
            for square in self.squares(k):
                for stream in range(level.streams):
                    self.lists[k, square, stream] = []
                    self.used += level.header_bytes
                    for _ in range(level.static_chunks):
                        self.lists[k, square, stream].append(self.new_chunk(k))
        self.static = self.used
        self.fresh = True
        self.note_peak()

    def close_pass(self) -> None:
        """Walk all lists, and count what is read."""
        self.allocated += self.used
        for tile in self.touched:
            self.tile_passes[tile] += 1
        for (k, square, _stream), chunks in self.lists.items():
            level = self.model.level[k]
            self.written += level.header_bytes
            self.chunks += len(chunks) if level.entries_of(self.entry_bytes) else 0
            side = level.side
            below = [tile for tile in self.tiles if (tile[0] // side, tile[1] // side) == square]
            readers = below if self.model.scheme == "hierarchy" else [None if k else below[0]]
            for reader in readers:
                walked = level.header_bytes
                for chunk in chunks:
                    if chunk.entries:
                        walked += level.link_bytes + len(chunk.entries) * self.entry_bytes
                        self.entries_read += len(chunk.entries)
                        self.read += sum(self.item_bytes + shared * self.shared_bytes for shared in chunk.entries)
                self.read += walked
                if reader is not None:
                    self.tile_bytes[reader] += walked
            for chunk in chunks:
                if chunk.entries:
                    self.written += level.link_bytes + len(chunk.entries) * self.entry_bytes

    def note_peak(self) -> None:
        self.peak = max(self.peak, self.used)

    def new_chunk(self, k: int) -> Chunk:
        level = self.model.level[k]
        room, size = level.entries_of(self.entry_bytes), level.bytes_of(self.entry_bytes)
        chunk = Chunk(room or 1, size or self.entry_bytes)
        self.used += chunk.taken_from_pool
        return chunk

    # An item.

    def lists_of(self, tiles: list[tuple[int, int]]) -> list[tuple]:
        model = self.model
        everywhere = {
            k: sorted({(x // level.side, y // level.side) for x, y in tiles}) for k, level in enumerate(model.level)
        }
        if model.scheme == "flat":
            chosen = [0]
        elif model.scheme == "cascade":
            chosen = list(everywhere)
        else:
            fits = [
                k for k, squares in everywhere.items()
                if max(x for x, _ in squares) - min(x for x, _ in squares) < model.spread
                and max(y for _, y in squares) - min(y for _, y in squares) < model.spread
            ]  # fmt: skip
            chosen = fits[:1] or [len(model.level) - 1]
        return [
            (k, square, self.appended // model.level[k].stream_batch % model.level[k].streams)
            for k in chosen
            for square in everywhere[k]
        ]

    def write(self, number: int, tiles: list[tuple[int, int]], shared: list) -> None:
        """Write an item, whatever the pool says."""
        stored = self.item_bytes
        for name in shared:
            if name not in self.records:
                self.records.add(name)
                stored += self.shared_bytes
        block = self.model.record.block_bytes
        if not block:
            self.used += stored
        elif stored <= self.block_room:
            self.block_room -= stored
        else:
            blocks = 0
            while blocks * block < stored:
                blocks += 1
            self.used += blocks * block
            self.block_room = blocks * block - stored
        self.item_records += stored
        self.written += stored
        for place in self.lists_of(tiles):
            chunks = self.lists[place]
            with_room = [chunk for chunk in chunks if len(chunk.entries) < chunk.room]
            if not with_room:
                with_room = [self.new_chunk(place[0])]
                chunks += with_room
            with_room[0].entries.append(len(shared))
            self.entries_written += 1
        self.touched.update(tiles)
        self.fresh = False

    def append(self, number: int, owner: int, tiles: list[tuple[int, int]], shared: list) -> None:
        if not tiles:
            return
        for tile in tiles:
            self.owners[tile].append(owner)
        if self.capacity:
            tried = copy.deepcopy(self)
            tried.write(number, tiles, shared)
            if tried.used > self.capacity and self.policy == "flush" and not self.fresh:
                self.close_pass()
                self.open_pass()
                self.flushes += 1
                self.cuts.append(number)
                tried = copy.deepcopy(self)
                tried.write(number, tiles, shared)
            if tried.used > self.capacity and self.policy != "grow":
                raise Overflow(number, tried.used)
            while tried.used > self.capacity:
                self.capacity *= 2
                self.grows += 1
        self.write(number, tiles, shared)
        self.appended += 1
        self.note_peak()

    def drain(self) -> None:
        """The tiles work off what is queued, though the pool is not full."""
        if not self.fresh:
            self.close_pass()
            self.open_pass()

    def finish(self) -> None:
        self.close_pass()

    def longest(self) -> tuple[int, int]:
        """The tile with the longest queue, and the patch that caused it."""
        lengths = [len(self.owners[tile]) for tile in self.tiles]
        if not any(lengths):
            return -1, -1
        tile = lengths.index(max(lengths))
        owners = self.owners[self.tiles[tile]]
        spread = [owner for queue in self.owners.values() for owner in queue]
        best = max(sorted(set(owners)), key=lambda p: (owners.count(p), spread.count(p), -p))
        return tile, best

    def counters(self, tile: int, width: int, height: int, samples: int) -> dict[str, int]:
        spilled = 0
        for (x, y), passes in self.tile_passes.items():
            pixels = sum(1 for i in range(tile) for j in range(tile) if x * tile + i < width and y * tile + j < height)
            for _ in range(passes - 1):
                spilled += 2 * 8 * samples * pixels
        return {
            "queue_bytes_written": self.written, "queue_bytes_read": self.read, "queue_peak_bytes": self.peak,
            "queue_chunks": self.chunks, "queue_wasted_bytes": self.allocated - self.written,
            "queue_flushes": self.flushes, "queue_grows": self.grows,
            "queue_tile_passes": sum(self.tile_passes.values()), "om_spilled_bytes": spilled,
        }  # fmt: skip
