"""Binning: items with pixel boxes into one queue a tile, by count, scan and fill, in submit order.

An item is a triangle or a patch; it goes to every tile that its box touches. The input is cut into chunks; each chunk
counts its pairs per tile, a scan over tiles and chunks gives every chunk its own place in every queue, and each fills
it. So the queues are the same for any number of host threads, and in submit order without a sort.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.jit import kernel
from pipeline.types import I32, I64
from tiler.grid import Grid
from tiler.host import Host


class TileQueues(NamedTuple):
    """Queue of tile t: items item[first[t]:first[t+1]], in submit order."""

    first: I64  # (tiles+1,)
    item: I32  # (entries,)


Walk = Callable[[int, int, bool, I64, I32], None]


@kernel
def _count(begin, end, first, count, box, tile_log2, tiles_x, pairs):
    for k in range(begin, end):
        for i in range(first[k], first[k] + count[k]):
            for ty in range(box[i, 1] >> tile_log2, (box[i, 3] >> tile_log2) + 1):
                for tx in range(box[i, 0] >> tile_log2, (box[i, 2] >> tile_log2) + 1):
                    pairs[ty * tiles_x + tx] += 1


@kernel
def _fill(begin, end, first, count, box, tile_log2, tiles_x, place, item):
    for k in range(begin, end):
        for i in range(first[k], first[k] + count[k]):
            for ty in range(box[i, 1] >> tile_log2, (box[i, 3] >> tile_log2) + 1):
                for tx in range(box[i, 0] >> tile_log2, (box[i, 2] >> tile_log2) + 1):
                    tile = ty * tiles_x + tx
                    item[place[tile]] = i
                    place[tile] += 1


def queue_items(num_items: int, walk: Walk, grid: Grid, host: Host) -> TileQueues:
    """Queues of the pairs that `walk` finds. It is called twice for each chunk of items.

    walk(begin, end, fill, place, item) : adds 1 to place[tile] for each pair of items begin .. end-1, in their order; with
    `fill` it first writes the item to item[place[tile]]. place : int64[tiles].
    """
    chunks = host.chunks(num_items)
    pairs = np.zeros((len(chunks), grid.num_tiles), np.int64)
    nothing = np.empty(0, np.int32)
    host.run(lambda c: walk(*chunks[c], False, pairs[c], nothing), len(chunks))
    queue_first = np.zeros(grid.num_tiles + 1, np.int64)
    np.cumsum(pairs.sum(axis=0), out=queue_first[1:])
    place = queue_first[:-1] + np.cumsum(pairs, axis=0) - pairs
    item = np.empty(queue_first[-1], np.int32)
    host.run(lambda c: walk(*chunks[c], True, place[c], item), len(chunks))
    return TileQueues(queue_first, item)


def bin_boxes(first: I64, count: I32, box: np.ndarray, grid: Grid, host: Host) -> TileQueues:
    """Bin items first[k] .. first[k] + count[k] - 1 for k = 0, 1, ... in this order.

    box : int16[items, 4], first column, first row, last column, last row in pixels, inclusive, inside the picture.
    """

    def walk(begin: int, end: int, fill: bool, place: I64, item: I32) -> None:
        if fill:
            _fill(begin, end, first, count, box, grid.tile_log2, grid.tiles_x, place, item)
        else:
            _count(begin, end, first, count, box, grid.tile_log2, grid.tiles_x, place)

    return queue_items(len(count), walk, grid, host)
