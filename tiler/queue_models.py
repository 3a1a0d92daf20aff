"""How a machine lays out its tile queues in memory: the schema of the files in `tiler/_data/queue_models`.

Lists are made of chunks; a chunk holds so many entries, and some bytes that link it to the next. An entry refers to a
record that is stored once. Three schemes:

- `flat`: a list a tile.
- `cascade`: a list a tile of each level; an item is written to the coarse lists first, read again, and written to the
  fine ones.
- `hierarchy`: a list a tile of each level; an item is written to one level, the finest at which it covers at most
  `spread` x `spread` tiles (else the coarsest). A tile reads the lists of all levels above it.

Sides of levels are in tiles of the machine, so a model keeps its structure at any tile size; `tile` is the size that its
machine has, and what `Machine(queue_model=...)` takes when it is not told another.
"""

from typing import Literal

from pydantic import Field, model_validator

from tiler.data_files import load_model, model_names
from tiler.scene.strict import Faults, Strict, whole

KIND = "queue_models"
MOST_BYTES = 2**40

Binning = Literal["triangle", "patch", "subpatch"]
Policy = Literal["grow", "flush", "fail"]


class EntryFile(Strict):
    """Table [entry]: bytes of a list's entry, by what is binned."""

    triangle: int = whole(4, 1, 65536, " (bytes)")
    patch: int = whole(4, 1, 65536, " (bytes)")
    subpatch: int = whole(8, 1, 65536, " (bytes)")


class RecordFile(Strict):
    """Table [record]: bytes of what entries refer to, stored once for each item that is queued anywhere.

    A triangle refers to three vertices, which triangles of a patch share; a sub-patch to its patch.
    """

    triangle: int = whole(0, 0, 65536, " (bytes)")
    vertex: int = whole(0, 0, 65536, " (bytes)")
    patch: int = whole(0, 0, 65536, " (bytes)")
    subpatch: int = whole(0, 0, 65536, " (bytes)")
    block_bytes: int = whole(0, 0, 2**30, " (bytes; records are cut from blocks of this size, 0: allocated exactly)")


class LevelFile(Strict):
    """Table [[level]]: the lists of one level, the finest first."""

    side: int = whole(1, 1, 4096, " (tiles along a side of a list's square; a power of two)")
    chunk_entries: int = whole(0, 0, 2**20, " (entries of a chunk; 0: by chunk_bytes, or as long as it has to be)")
    chunk_bytes: int = whole(0, 0, 2**30, " (bytes of a chunk with its link; 0: by chunk_entries)")
    link_bytes: int = whole(0, 0, 65536, " (bytes of a chunk that hold no entry)")
    header_bytes: int = whole(0, 0, 65536, " (bytes of every list, empty ones too)")
    static_chunks: int = whole(0, 0, 1, " (chunks that every list has from the start)")
    streams: int = whole(1, 1, 256, " (lists side by side for a tile, items are dealt out to)")
    stream_batch: int = whole(1, 1, 2**20, " (items in a row that go to one stream)")

    def entries_of(self, entry_bytes: int) -> int:
        """Entries of a chunk; 0 where lists are exact."""
        return (self.chunk_bytes - self.link_bytes) // entry_bytes if self.chunk_bytes else self.chunk_entries

    def bytes_of(self, entry_bytes: int) -> int:
        """Bytes of a chunk; 0 where lists are exact."""
        return self.chunk_bytes or (self.chunk_entries * entry_bytes + self.link_bytes if self.chunk_entries else 0)


class QueueModel(Strict):
    """A queue memory model."""

    title: str = Field(description="a text")
    source: str = Field(description="a text: where the figures are from, and which are assumed")
    tile: int = whole(32, 8, 512, " (pixels along a side of the tiles that the machine has; a power of two)")
    scheme: Literal["flat", "cascade", "hierarchy"] = "flat"
    spread: int = whole(2, 1, 64, " (tiles along a side that an item may cover on a level of a hierarchy)")
    pool_bytes: int | None = Field(None, ge=1, le=MOST_BYTES, description=f"a whole number from 1 to {MOST_BYTES}")
    policy: Policy = "grow"
    entry: EntryFile = Field(EntryFile(), description="a table")
    record: RecordFile = Field(RecordFile(), description="a table")
    level: list[LevelFile] = Field(min_length=1, max_length=16, description="one to 16 tables [[level]]")

    @model_validator(mode="after")
    def _levels_fit(self) -> "QueueModel":
        faults: list[tuple[tuple[str | int, ...], str]] = []
        if self.tile & (self.tile - 1):
            faults.append((("tile",), f"{self.tile} is not allowed; allowed: a power of two from 8 to 512"))
        if self.scheme == "flat" and len(self.level) > 1:
            faults.append((("level",), "has more than one entry; allowed: one with scheme = flat"))
        largest = max(self.entry.triangle, self.entry.patch, self.entry.subpatch)
        for k, level in enumerate(self.level):
            least = 1 if k == 0 else 2 * self.level[k - 1].side
            if level.side & (level.side - 1) or level.side < least or (k == 0 and level.side != 1):
                allowed = "1 for the first level" if k == 0 else f"a power of two of at least {least}"
                faults.append((("level", k, "side"), f"{level.side} is not allowed; allowed: {allowed}"))
            if level.chunk_entries and level.chunk_bytes:
                faults.append((("level", k, "chunk_bytes"), "stands beside chunk_entries; allowed: one of the two"))
            elif level.chunk_bytes and level.entries_of(largest) < 1:
                problem = f"{level.chunk_bytes} has no room for an entry of {largest}; allowed: at least "
                faults.append((("level", k, "chunk_bytes"), f"{problem}{largest + level.link_bytes}"))
            elif not (level.chunk_entries or level.chunk_bytes) and (level.link_bytes or level.static_chunks):
                key = "link_bytes" if level.link_bytes else "static_chunks"
                faults.append((("level", k, key), "belongs to chunks, and the lists of this level have none"))
        if faults:
            raise Faults(*faults)
        return self

    def entry_bytes(self, binning: Binning) -> int:
        """Bytes of an entry."""
        return int(getattr(self.entry, binning))

    def record_bytes(self, binning: Binning) -> tuple[int, int]:
        """Bytes of the record of an item, and of each record that several items may share."""
        r = self.record
        return {"triangle": (r.triangle, r.vertex), "patch": (r.patch, 0), "subpatch": (r.subpatch, r.patch)}[binning]


def queue_model_names() -> tuple[str, ...]:
    """Names of the models that are shipped."""
    return model_names(KIND)


def load_queue_model(source: str) -> QueueModel:
    """A shipped model by name, or a file by its path (ending in .toml). Raises TilerError."""
    return load_model(KIND, source, QueueModel, "queue_model")
