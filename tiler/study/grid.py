"""The rows of a study: counted and numbered without being built, so that a grid of a billion rows costs nothing to ask about.

A grid is a list of blocks, one for each scene and view of a table [sweep] or [[run]]; a block is the product of its axes,
the last one running fastest. Consecutive rows so share their scene, then its settings, then the frame.
"""

import bisect
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

SHARD_CHUNK = 16  # rows that stay together when a study is dealt out to shards: they mostly share a scene


class Axis(NamedTuple):
    """One column of the table, and its values in a block."""

    name: str
    values: Sequence[Any]


class Block(NamedTuple):
    """The rows of one scene under one view."""

    scene: str
    view: str
    axes: tuple[Axis, ...]  # settings of the scene, then "frame", then "machine" and fields of the machine

    @property
    def size(self) -> int:
        """Number of rows."""
        return math.prod(len(axis.values) for axis in self.axes)

    def values(self, index: int) -> dict[str, Any]:
        """Values of row `index` of the block, by column."""
        found = {}
        for axis in reversed(self.axes):
            index, place = divmod(index, len(axis.values))
            found[axis.name] = axis.values[place]
        return {"scene": self.scene, "view": self.view} | {axis.name: found[axis.name] for axis in self.axes}


class Grid:
    """All rows of a study, numbered from 0."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = list(blocks)
        self._end = list(itertools.accumulate(block.size for block in self.blocks))

    def __len__(self) -> int:
        return self._end[-1] if self._end else 0

    def values(self, row: int) -> dict[str, Any]:
        """Values of a row by column: scene, view, settings, frame, machine and fields of the machine."""
        b = bisect.bisect_right(self._end, row)
        return self.blocks[b].values(row - (self._end[b] - self.blocks[b].size))

    def columns(self) -> list[str]:
        """All columns: those of every row first, in the order in which rows are nested."""
        names = dict.fromkeys(axis.name for block in self.blocks for axis in block.axes)
        last = [name for name in names if name in ("frame", "machine") or name.startswith("machine.")]
        settings = [name for name in names if name not in last]
        return ["scene", "view", *settings, "frame", "machine", *(n for n in last if n not in ("frame", "machine"))]


class Shard(NamedTuple):
    """Part `number` (from 1) of `of` parts of a study."""

    number: int = 1
    of: int = 1

    def holds(self, row: int, rows: int) -> bool:
        """Whether the row is this part's. Chunks are dealt out in turn, small ones where the study is small."""
        chunk = max(1, min(SHARD_CHUNK, rows // self.of))
        return (row // chunk) % self.of == self.number - 1
