"""The lists of a queue memory model, entry by entry in the order of writing: which chunks and records each item takes.

An *item* is what is binned: a triangle, a patch, a sub-domain. Its entries, one a tile, are appended in submit order, item
after item, and an item is whole or not at all: where its chunks and records do not fit into the pool any more, the pool
grows (to twice its size, as often as needed), or all queues are worked off first and start empty again (a new *pass*), or
that is the end. Time is linear in the entries, memory 32 bytes a list, whatever the number of entries or passes.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import I64


class Scheme(IntEnum):
    """Which levels' lists an item is written to."""

    FLAT = 0
    CASCADE = 1
    HIERARCHY = 2


class Policy(IntEnum):
    """What happens where the pool is full."""

    GROW = 0
    FLUSH = 1
    FAIL = 2


class Levels(NamedTuple):
    """The lists of all levels, numbered one level after the other; list of a tile's stream s: first + tile * streams + s."""

    shift: I64  # (L,) log2 of the side of a list's square, tiles
    tiles_x: I64  # (L,) squares in a row
    tiles_y: I64  # (L,)
    first: I64  # (L+1,) first list
    chunk_entries: I64  # (L,) 0: lists are as long as they have to be
    chunk_bytes: I64  # (L,)
    link_bytes: I64  # (L,)
    header_bytes: I64  # (L,)
    static_chunks: I64  # (L,) chunks that a list has from the start
    streams: I64  # (L,)
    stream_batch: I64  # (L,)


class Lists(NamedTuple):
    """State of every list. `pass_of`: the pass that `entries` belongs to; an earlier one means that the list is empty."""

    pass_of: I64
    entries: I64  # in that pass
    seen: I64  # the last turn at which an item touched it
    walked: I64  # bytes of entries and links written to it in the frame: what one walk over it reads


class Layout(NamedTuple):
    """Scalars of a model for one kind of item."""

    scheme: int
    spread: int
    policy: int
    tiles_x: int  # of the machine's grid
    tiles_y: int
    entry_bytes: int
    item_bytes: int  # record of an item
    shared_bytes: int  # each record that items share
    block_bytes: int  # 0: records are allocated exactly
    static_bytes: int  # headers and chunks that lists have from the start
    header_read_bytes: int  # headers that the tiles read in a pass
    header_bytes: int
    static_chunks: int


class Sum(IntEnum):
    """Running sums of a frame."""

    ENTRIES = 0  # written to lists, of all levels
    WALKED = 1  # read from lists
    WRITTEN = 2  # bytes
    READ = 3
    ALLOCATED = 4  # bytes given out, of all passes
    PEAK = 5
    CHUNKS = 6
    FLUSHES = 7
    GROWS = 8
    USED = 9  # bytes in use now
    CAPACITY = 10  # bytes of the pool, 0: no limit
    PASS = 11  # number of the pass, from 1
    TURN = 12
    ITEMS = 13  # appended
    ROOM = 14  # bytes left in the open block of records
    FAILED_ITEM = 15  # the item that did not fit, -1
    NEEDED = 16  # bytes that it would have brought the pool to
    PASS_ITEMS = 17  # appended before the pass began


_ENTRIES, _WALKED, _WRITTEN, _READ, _ALLOCATED, _PEAK, _CHUNKS, _FLUSHES, _GROWS, _USED = (
    int(s) for s in list(Sum)[:10]
)
_CAPACITY, _PASS, _TURN, _ITEMS, _ROOM, _FAILED, _NEEDED, _PASS_ITEMS = (int(s) for s in list(Sum)[10:])
_CASCADE, _HIERARCHY = int(Scheme.CASCADE), int(Scheme.HIERARCHY)
_GROW, _FLUSH = int(Policy.GROW), int(Policy.FLUSH)


@kernel
def tiles_of_items(queue_first, queue_item, place, tile_of):
    """Turn tile queues round: the tiles of each item, in rising order. place : int64, where each item's tiles begin; moved."""
    for tile in range(len(queue_first) - 1):
        for q in range(queue_first[tile], queue_first[tile + 1]):
            i = queue_item[q]
            tile_of[place[i]] = tile
            place[i] += 1


@helper
def begin_pass(sums, layout):
    """Every list is empty again; headers are written, and read by every tile."""
    sums[_PASS] += 1
    sums[_USED] = layout.static_bytes
    sums[_ROOM] = 0
    sums[_PASS_ITEMS] = sums[_ITEMS]
    sums[_ALLOCATED] += layout.static_bytes
    sums[_CHUNKS] += layout.static_chunks
    sums[_WRITTEN] += layout.header_bytes
    sums[_READ] += layout.header_read_bytes
    sums[_PEAK] = max(sums[_PEAK], sums[_USED])


@kernel
def start(sums, layout):
    """Begin a pass."""
    begin_pass(sums, layout)


@helper
def _level_range(begin, end, tile_of, layout, levels):
    """Levels first .. last-1 whose lists an item on tiles tile_of[begin:end] is written to."""
    if layout.scheme == _CASCADE:
        return 0, len(levels.shift)
    if layout.scheme != _HIERARCHY:
        return 0, 1
    x0, x1, y0, y1 = layout.tiles_x, -1, layout.tiles_y, -1
    for q in range(begin, end):
        tile = tile_of[q]
        y, x = tile // layout.tiles_x, tile % layout.tiles_x
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    for level in range(len(levels.shift)):
        s = levels.shift[level]
        if (x1 >> s) - (x0 >> s) < layout.spread and (y1 >> s) - (y0 >> s) < layout.spread:
            return level, level + 1
    return len(levels.shift) - 1, len(levels.shift)


@helper
def _list_of(tile, level, layout, levels, ordinal):
    s, streams = levels.shift[level], levels.streams[level]
    square = np.int64(tile)
    if s > 0:
        square = (tile // layout.tiles_x >> s) * levels.tiles_x[level] + (tile % layout.tiles_x >> s)
    if streams == 1:
        return levels.first[level] + square
    return levels.first[level] + square * streams + ordinal // levels.stream_batch[level] % streams


@helper
def _takes_chunk(size, level, levels):
    """Whether the next entry of a list with `size` entries takes a chunk from the pool."""
    n = levels.chunk_entries[level]
    return n > 0 and size >= levels.static_chunks[level] * n and size % n == 0


@helper
def _record_bytes(i, shared, shared_pass, sums, layout):
    """Bytes of records to be stored with an item: its own, and those shared ones that this pass does not have yet."""
    stored = layout.item_bytes
    for j in range(shared.shape[1]):
        fresh = shared_pass[shared[i, j]] != sums[_PASS]
        for k in range(j):
            fresh = fresh and shared[i, k] != shared[i, j]
        if fresh:
            stored += layout.shared_bytes
    return stored


@helper
def _blocks_for(stored, sums, layout):
    """Bytes that the pool gives for `stored` bytes of records."""
    if layout.block_bytes == 0:
        return stored
    if stored <= sums[_ROOM]:
        return 0
    return -(-stored // layout.block_bytes) * layout.block_bytes


@helper
def _needed(i, begin, end, tile_of, shared, shared_pass, sums, layout, levels, lists):
    """Bytes that appending an item would take from the pool."""
    sums[_TURN] += 1
    turn = sums[_TURN]
    need = _blocks_for(_record_bytes(i, shared, shared_pass, sums, layout), sums, layout)
    first_level, end_level = _level_range(begin, end, tile_of, layout, levels)
    for level in range(first_level, end_level):
        for q in range(begin, end):
            k = _list_of(tile_of[q], level, layout, levels, sums[_ITEMS])
            if levels.shift[level] > 0:  # several of the item's tiles may lie in one square
                if lists.seen[k] == turn:
                    continue
                lists.seen[k] = turn
            size = lists.entries[k] if lists.pass_of[k] == sums[_PASS] else 0
            if levels.chunk_entries[level] == 0:
                need += layout.entry_bytes
            elif _takes_chunk(size, level, levels):
                need += levels.chunk_bytes[level]
    return need


@helper
def _readers(k, level, layout, levels):
    """How many walk over list k: in a hierarchy every tile below it, else one."""
    s = levels.shift[level]
    if layout.scheme != _HIERARCHY or s == 0:
        return 1
    square = (k - levels.first[level]) // levels.streams[level]
    y, x = square // levels.tiles_x[level], square % levels.tiles_x[level]
    wide = min((x + 1) << s, layout.tiles_x) - (x << s)
    return wide * (min((y + 1) << s, layout.tiles_y) - (y << s))


@helper
def _append_item(i, begin, end, tile_of, shared, shared_pass, sums, layout, levels, lists):
    """Write an item's record and entries; what it takes from the pool is counted."""
    before = sums[_USED]
    stored = _record_bytes(i, shared, shared_pass, sums, layout)
    given = _blocks_for(stored, sums, layout)
    if layout.block_bytes > 0:
        sums[_ROOM] = (given if given > 0 else sums[_ROOM]) - stored
    for j in range(shared.shape[1]):
        shared_pass[shared[i, j]] = sums[_PASS]
    sums[_USED] += given
    sums[_WRITTEN] += stored
    fetched = layout.entry_bytes + layout.item_bytes + shared.shape[1] * layout.shared_bytes
    sums[_TURN] += 1
    turn = sums[_TURN]
    first_level, end_level = _level_range(begin, end, tile_of, layout, levels)
    for level in range(first_level, end_level):
        for q in range(begin, end):
            k = _list_of(tile_of[q], level, layout, levels, sums[_ITEMS])
            if levels.shift[level] > 0:  # several of the item's tiles may lie in one square
                if lists.seen[k] == turn:
                    continue
                lists.seen[k] = turn
            size = lists.entries[k] if lists.pass_of[k] == sums[_PASS] else 0
            readers = _readers(k, level, layout, levels)
            written = layout.entry_bytes
            if levels.chunk_entries[level] == 0:
                sums[_USED] += layout.entry_bytes
            elif size % levels.chunk_entries[level] == 0:
                written += levels.link_bytes[level]
                if _takes_chunk(size, level, levels):
                    sums[_USED] += levels.chunk_bytes[level]
                    sums[_CHUNKS] += 1
            sums[_ENTRIES] += 1
            sums[_WALKED] += readers
            sums[_WRITTEN] += written
            sums[_READ] += readers * (written - layout.entry_bytes + fetched)
            lists.walked[k] += written
            lists.entries[k] = size + 1
            lists.pass_of[k] = sums[_PASS]
    sums[_ITEMS] += 1
    sums[_ALLOCATED] += sums[_USED] - before
    sums[_PEAK] = max(sums[_PEAK], sums[_USED])


@kernel
def append_items(first, tile_of, shared, shared_pass, sums, layout, levels, lists, tile_pass, tile_passes, cuts):
    """Append items in order. The tiles of item i are tile_of[first[i]:first[i+1]]; an item without a tile takes nothing.

    shared : int32[items, K], the shared records that each refers to. shared_pass : int64, the pass that stored each; 0 at
    first. tile_pass, tile_passes : int64[tiles], the last pass in which a tile had an entry, and how many such passes there
    were. cuts : int64[items], filled with the items that began a new pass. Returns the number of cuts; where an item does
    not fit, stops with `Sum.FAILED_ITEM` set. All arrays of state are modified in place.
    """
    num_cuts = 0
    for i in range(len(first) - 1):
        begin, end = first[i], first[i + 1]
        if begin == end:
            continue
        if sums[_CAPACITY] > 0:
            need = _needed(i, begin, end, tile_of, shared, shared_pass, sums, layout, levels, lists)
            full = sums[_USED] + need > sums[_CAPACITY]
            if full and layout.policy == _FLUSH and sums[_ITEMS] > sums[_PASS_ITEMS]:
                begin_pass(sums, layout)
                sums[_FLUSHES] += 1
                cuts[num_cuts] = i
                num_cuts += 1
                need = _needed(i, begin, end, tile_of, shared, shared_pass, sums, layout, levels, lists)
            if sums[_USED] + need > sums[_CAPACITY]:
                if layout.policy != _GROW:
                    sums[_FAILED], sums[_NEEDED] = i, sums[_USED] + need
                    return num_cuts
                while sums[_USED] + need > sums[_CAPACITY]:
                    sums[_CAPACITY] *= 2
                    sums[_GROWS] += 1
        _append_item(i, begin, end, tile_of, shared, shared_pass, sums, layout, levels, lists)
        for q in range(begin, end):
            tile = tile_of[q]
            if tile_pass[tile] != sums[_PASS]:
                tile_pass[tile] = sums[_PASS]
                tile_passes[tile] += 1
    return num_cuts


@kernel
def count_stored(queue_first, queue_item, shared, shared_pass, stored):
    """How many items have an entry, and how many shared records these store that no batch before did.

    shared : as in `append_items`. shared_pass : int64, 1 for records that are stored. stored : uint8[items], 0 at first. Both
    are modified in place.
    """
    items, records = 0, 0
    for q in range(queue_first[0], queue_first[-1]):
        i = queue_item[q]
        if stored[i] == 0:
            stored[i] = 1
            items += 1
            for j in range(shared.shape[1]):
                v = shared[i, j]
                records += shared_pass[v] == 0
                shared_pass[v] = 1
    return items, records


@kernel
def append_flat(
    queue_first, items, records, num_shared, sums, layout, chunk_entries, chunk_bytes, link_bytes, static_chunks, entries,
    walked, tile_pass, tile_passes,
):  # fmt: skip
    """`append_items` for lists of tiles alone in one pass, where the order of items decides nothing: tile by tile.

    items, records : how many items and shared records are stored. num_shared : of an item. All arrays of state are modified
    in place.
    """
    chunks, links = 0, 0
    for tile in range(len(queue_first) - 1):
        begin, end = queue_first[tile], queue_first[tile + 1]
        if begin == end:
            continue
        tile_pass[tile], tile_passes[tile] = 1, 1
        if chunk_entries > 0:
            before = -(-entries[tile] // chunk_entries)
            after = -(-(entries[tile] + end - begin) // chunk_entries)
            chunks += max(after, static_chunks) - max(before, static_chunks)
            links += after - before
            walked[tile] += (after - before) * link_bytes
        entries[tile] += end - begin
        walked[tile] += (end - begin) * layout.entry_bytes
    count = queue_first[-1] - queue_first[0]
    record_bytes = items * layout.item_bytes + records * layout.shared_bytes
    written = count * layout.entry_bytes + links * link_bytes
    taken = record_bytes + (chunks * chunk_bytes if chunk_entries > 0 else count * layout.entry_bytes)
    sums[_ENTRIES] += count
    sums[_WALKED] += count
    sums[_WRITTEN] += written + record_bytes
    sums[_READ] += written + count * (layout.item_bytes + num_shared * layout.shared_bytes)
    sums[_CHUNKS] += chunks
    sums[_ITEMS] += items
    sums[_USED] += taken
    sums[_ALLOCATED] += taken
    sums[_PEAK] = sums[_USED]


@kernel
def count_owners(queue_item, owner, spread):
    """Add 1 to spread[patch] for each queue entry of one of its items. owner : int32[items]."""
    for q in range(len(queue_item)):
        spread[owner[queue_item[q]]] += 1


@kernel
def rank_owners(queue_first, queue_item, owner, spread, most):
    """Find the patch that fills each tile's queue most. most : int64[tiles, 3], entries, spread and number of the best yet.

    owner : int32[items], the patch of each item. spread : int64[patches], entries of each patch in all queues. A patch is
    better with more entries in the queue, then with more entries in all; of equal ones the earlier stays.
    """
    for tile in range(len(queue_first) - 1):
        q, end = queue_first[tile], queue_first[tile + 1]
        while q < end:
            patch, begin = owner[queue_item[q]], q
            while q < end and owner[queue_item[q]] == patch:
                q += 1
            n = q - begin
            if n > most[tile, 0] or (n == most[tile, 0] and spread[patch] > most[tile, 1]):
                most[tile, 0], most[tile, 1], most[tile, 2] = n, spread[patch], patch
