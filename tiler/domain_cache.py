"""Domain caches: what shading costs the tiles of a machine, replayed from the events of the frame.

The tile loop notes for each queue entry whether the tile worked on it or coarse Z hid it. Here every simulated core goes once
more through its tiles, in the order of the walk, pass by pass, and looks each unit that it worked on up in its cache; a
miss is charged to the tile. So the counts do not depend on the host's threads. `none`: there is nothing to hit. `lru:N`: the
last N units that the core shaded or found. `frame`: a unit is shaded once in the frame, in the first tile of the walk that
works on it.

The post-tessellation vertex cache of `triangle` binning works on the index lists of the patterns alone.
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import I64, U8, Patterns
from tiler.binning import TileQueues
from tiler.tile import TileCount

_DS, _LOOKUPS, _HITS = int(TileCount.DS_INVOCATIONS), int(TileCount.CACHE_LOOKUPS), int(TileCount.CACHE_HITS)


class Events(NamedTuple):
    """What became of a batch's queue entries. `unit`: number of the unit of each entry; `number`: of the pass."""

    number: int
    first: I64  # (tiles+1,)
    unit: I64  # (entries,)
    outcome: U8  # (entries,) 1: hidden by coarse Z


def note_events(number: int, queue: TileQueues, live: np.ndarray, outcome: U8) -> Events:
    """The events of a batch of units `live` in pass `number`; passes do not fall."""
    return Events(number, queue.first, live[queue.item].astype(np.int64), outcome)


@helper
def _unlink(unit, before, after):
    before[after[unit]] = before[unit]
    after[before[unit]] = after[unit]


@helper
def _link_first(unit, root, before, after):
    after[unit], before[unit] = after[root], root
    before[after[root]] = unit
    after[root] = unit


@helper
def _is_hit(unit, root, room, before, after, held):
    """Look a unit up in the list of what is held, most recent first, and put it there; held[root] is their number."""
    hit = held[unit] == 1
    if hit:
        _unlink(unit, before, after)
    elif held[root] == room:
        last = before[root]
        _unlink(last, before, after)
        held[last] = 0
    else:
        held[root] += 1
    held[unit] = 1
    _link_first(unit, root, before, after)
    return hit


@kernel
def _replay(core, cores, walk, batch_pass, first, unit, outcome, points, room, before, after, held, counts, shaded):
    root = len(points)
    before[root], after[root], held[root] = root, root, 0
    end = 0
    while end < len(batch_pass):
        begin = end
        while end < len(batch_pass) and batch_pass[end] == batch_pass[begin]:
            end += 1
        for place in range(core, len(walk), cores):
            tile = walk[place]
            for b in range(begin, end):
                for q in range(first[b, tile], first[b, tile + 1]):
                    if outcome[q]:
                        continue
                    hit = False
                    if room > 0:
                        counts[tile, _LOOKUPS] += 1
                        hit = _is_hit(unit[q], root, room, before, after, held)
                        counts[tile, _HITS] += hit
                    if not hit:
                        shaded[q] = 1
                        counts[tile, _DS] += points[unit[q]]
    while after[root] != root:  # leave nothing to the next core
        held[after[root]] = 0
        _unlink(after[root], before, after)


def replay_shading(events: list[Events], points: I64, walk: I64, cores: int, cache: str, counts: I64) -> U8:
    """Charge the domain-shader invocations of a frame to its tiles.

    points : int64[units], domain points of each. walk : the tiles in order. cache : as `Machine.domain_cache`.
    counts : int64[tiles, NUM_TILE_COUNTS], modified in place. Returns 1 for each entry, batch by batch, whose unit was shaded.
    """
    room, walkers = 0, cores
    if cache == "frame":  # one cache for all cores, and room for everything
        room, walkers = max(1, len(points)), 1
    elif cache != "none":
        room = int(cache[4:])
    offsets = np.cumsum([0] + [len(e.unit) for e in events])
    first = np.stack([e.first + offset for e, offset in zip(events, offsets[:-1], strict=True)])
    unit, outcome = np.concatenate([e.unit for e in events]), np.concatenate([e.outcome for e in events])
    batch_pass = np.array([e.number for e in events])
    shaded = np.zeros(len(unit), np.uint8)
    n = len(points) + 1
    before, after, held = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    for core in range(min(walkers, len(walk))):
        _replay(
            core,
            walkers,
            walk,
            batch_pass,
            first,
            unit,
            outcome,
            points,
            room,
            before,
            after,
            held,
            counts,
            shaded,
        )
    return shaded


@kernel
def _vertex_misses(patterns, room, misses, slot, ring):
    for p in range(len(misses)):
        slot[:] = -1
        ring[:] = -1
        misses[p], oldest = 0, 0
        for i in range(3 * patterns.first_triangle[p], 3 * patterns.first_triangle[p + 1]):
            point = patterns.indices[i]
            if slot[point] < 0:
                misses[p] += 1
                if ring[oldest] >= 0:
                    slot[ring[oldest]] = -1
                ring[oldest], slot[point] = point, oldest
                oldest = oldest + 1 if oldest + 1 < room else 0


def vertex_misses(patterns: Patterns, entries: int) -> I64:
    """Domain points that each pattern has shaded through a vertex cache, first in first out; int64[K].

    entries : its size; 0: every point of the pattern is shaded once.
    """
    if entries == 0:
        return np.diff(patterns.first_point)
    misses = np.empty(len(patterns.first_point) - 1, np.int64)
    most = int(np.diff(patterns.first_point).max(initial=0))
    _vertex_misses(patterns, entries, misses, np.empty(most, np.int64), np.empty(entries, np.int64))
    return misses
