"""Slices and counter tracks of a recorded frame, in the Trace Event Format that Perfetto and chrome://tracing open.

The front end works first, with all units of every stage; then the cores work off their tiles, in the order of the walk, each
with its share of every stage's units, one part of a tile's work after the other. A pass ends when the slowest core has
ended. That is the work of the cost model, laid out in time; nothing of it overlaps within a core, as in a machine whose
tiles hold one unit at a time. A nanosecond of the trace is a cycle.
"""

from typing import Any, NamedTuple

import numpy as np

from pipeline.types import F64, I64
from tiler.trace.record import Recording
from tiler.trace.work import Part, Work, entry_events, share_work

FRONT_END, CORES, QUEUES = 1, 2, 3  # processes
MOST_SLICES = 200_000
SLICES_OF_TILE, SLICES_OF_PATCH = 8, 4  # about: itself and its stages

Event = dict[str, Any]


class Groups(NamedTuple):
    """Runs of entries that are one slice, visit by visit. `more`: how many patches are left unnamed in it, 0 for none."""

    first: I64  # (groups+1,) into the sorted entries
    visit: I64  # (groups,)
    more: I64  # (groups,)


class Timeline:
    """Events in the making, and the clock: cycles, float; they are rounded to nanoseconds where they are written."""

    def __init__(self, parts: tuple[Part, ...], cores: int) -> None:
        self.events: list[Event] = []
        self.parts, self.cores = parts, cores

    def slice(self, pid: int, tid: int, name: str, start: float, end: float, args: Event) -> None:
        """A slice; parents before their children."""
        ts = round(start)
        self.events.append(
            {
                "ph": "X",
                "pid": pid,
                "tid": tid,
                "name": name,
                "ts": ts / 1e3,
                "dur": (round(end) - ts) / 1e3,
                "args": args,
            }
        )

    def counter(self, name: str, time: float, key: str, value: int) -> None:
        """A point of a counter track."""
        self.events.append(
            {"ph": "C", "pid": QUEUES, "tid": 0, "name": name, "ts": round(time) / 1e3, "args": {key: value}}
        )

    def stages(self, pid: int, tid: int, work: F64, start: float) -> float:
        """A slice for each part with work, one after the other; when they end."""
        cores = self.cores if pid == CORES else 1
        for k in np.flatnonzero(work):
            part, cycles = self.parts[k], float(work[k])
            end = start + cycles * cores / part.units
            self.slice(pid, tid, part.name, start, end, {"stage": part.stage, "work_cycles": cycles})
            start = end
        return start

    def span(self, work: F64) -> float:
        """Cycles that a core takes for some work."""
        return float(sum(w * self.cores / part.units for w, part in zip(work, self.parts, strict=True)))


def trace_events(recording: Recording, model: str, most: int = MOST_SLICES) -> list[Event]:
    """All events by time, names first. most : about how many slices there may be; then patches, at last tiles, share one."""
    work = share_work(recording, model)
    machine, entries, tiles = recording.machine, recording.entries, recording.grid.num_tiles
    line = Timeline(work.parts, machine.cores)
    place = np.empty(tiles, np.int64)
    place[recording.walk] = np.arange(tiles)
    number, tile = np.divmod(work.key, tiles)
    core = place[tile] % machine.cores
    order = np.lexsort((place[tile], core, number))  # of the visits
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    visit_of = rank[np.searchsorted(work.key, entries.pass_number * tiles + entries.tile)]
    by_visit = np.argsort(visit_of, kind="stable")
    groups = make_groups(visit_of[by_visit], entries.unit[by_visit], most)
    first_group = np.searchsorted(groups.visit, np.arange(len(order) + 1))
    merged = -(-len(order) * SLICES_OF_TILE // most) if len(order) * SLICES_OF_TILE > most else 1
    notes = {
        name: found
        for name in ("ds_invocations", "c_invocations", "su_triangles", "rs_triangles")
        if (found := entry_events(recording, name)) is not None
    }
    now = line.stages(FRONT_END, 1, work.once, 0.0)
    waiting, ends = 0, []
    line.counter("queue entries", 0.0, "entries", 0)
    for p in sorted(work.front):
        begin = now
        now = line.stages(FRONT_END, 1, work.front[p], now)
        _count_pool(line, [used for q, used in recording.pool if q == p], begin, now)
        begin, free = now, now
        for c in range(machine.cores):
            mine = order[(number[order] == p) & (core[order] == c)]
            clock = begin
            for at in range(0, len(mine), merged):
                visits = rank[mine[at : at + merged]]
                clock = _tile_slice(
                    line, recording, work, groups, first_group, by_visit, notes, order, visits, c, clock
                )
                held = int(sum(groups.first[first_group[v + 1]] - groups.first[first_group[v]] for v in visits))
                ends.append((clock, held))
            free = max(free, clock)
        waiting = int(np.count_nonzero(entries.pass_number == p))
        line.counter("queue entries", begin, "entries", waiting)
        for end, held in sorted(ends):
            waiting -= held
            line.counter("queue entries", end, "entries", waiting)
        ends.clear()
        now = free
        line.counter("pool bytes", now, "bytes", 0)
    line.events.sort(key=lambda event: event["ts"])  # stable: parents stay before their children
    return _names(recording, line.events) + line.events


def make_groups(visit: I64, unit: I64, most: int) -> Groups:
    """Entries that follow each other in a tile's queue and are of one unit are a group; above `most` slices the last of a
    tile's groups are one, so many that all tiles keep equally many."""
    starts = (
        np.flatnonzero(np.append(True, (visit[1:] != visit[:-1]) | (unit[1:] != unit[:-1]))) if len(visit) else visit
    )
    of, visits = visit[starts], int(visit[-1]) + 1 if len(visit) else 0
    count = np.bincount(of, minlength=visits)
    room = max(0, most - SLICES_OF_TILE * visits) // SLICES_OF_PATCH
    keep, high = 0, int(count.max(initial=0))
    while keep < high:  # the largest `keep` that fits
        middle = (keep + high + 1) // 2
        keep, high = (middle, high) if np.minimum(count, middle).sum() <= room else (keep, middle - 1)
    turn = np.arange(len(of)) - (np.cumsum(count) - count)[of]
    named = (turn < keep - 1) | (count[of] <= keep)
    heads = named | (turn == max(keep - 1, 0))
    more = np.where(named, 0, count[of] - max(keep - 1, 0))
    return Groups(np.append(starts[heads], len(visit)), of[heads], more[heads])


def _tile_slice(
    line: Timeline, recording: Recording, work: Work, groups: Groups, first_group: I64, by_visit: I64,
    notes: dict[str, F64], order: I64, visits: I64, core: int, start: float,
) -> float:  # fmt: skip
    """One slice for some visits that follow each other on a core, most often one; when it ends."""
    entries, grid = recording.entries, recording.grid
    runs = np.concatenate([np.arange(first_group[v], first_group[v + 1]) for v in visits])
    members = by_visit[groups.first[runs[0]] : groups.first[runs[-1] + 1]]
    tile = int(work.key[order[visits[0]]] % grid.num_tiles)
    own = work.visit[order[visits]].sum(axis=0)
    y, x = divmod(tile, grid.tiles_x)
    alone = len(visits) == 1
    args = {"x": x, "y": y} if alone else {"tiles": len(visits)}
    args |= {"pass": int(entries.pass_number[members[0]])} | _args(entries.hidden, notes, members)
    whole = work.entry[members].sum(axis=0)
    end = start + line.span(whole) + line.span(own)
    place = len(line.events)
    line.slice(CORES, core + 1, f"tile {x},{y}" if alone else f"{len(visits)} tiles", start, end, args)
    line.counter(f"queue of core {core}", start, "entries", len(members))
    clock = start
    for g in runs if alone else ():
        of = by_visit[groups.first[g] : groups.first[g + 1]]
        cycles = work.entry[of].sum(axis=0)
        unit = int(entries.unit[of[0]])
        patch = int(recording.owner[unit])
        label = f"patch {patch}"
        told: Event = {"patch": patch} if recording.machine.binning != "subpatch" else {"patch": patch, "unit": unit}
        if groups.more[g]:
            label, told = f"{groups.more[g]} more patches", {"patches": int(groups.more[g])}
        told |= _args(entries.hidden, notes, of)
        at = len(line.events)
        line.slice(CORES, core + 1, label, clock, clock + line.span(cycles), told)
        clock = _close(line, at, line.stages(CORES, core + 1, cycles, clock))
    if not alone:
        clock = line.stages(CORES, core + 1, whole, clock)
    clock = _close(line, place, line.stages(CORES, core + 1, own, clock))
    line.counter(f"queue of core {core}", clock, "entries", 0)
    return clock


def _close(line: Timeline, at: int, end: float) -> float:
    """Let slice `at` end exactly where its last part does: sums in another order differ in the last bit."""
    event = line.events[at]
    event["dur"] = (round(end) - round(event["ts"] * 1e3)) / 1e3
    return end


def _args(hidden: Any, notes: dict[str, F64], members: I64) -> Event:
    sums = {name: int(values[members].sum()) for name, values in notes.items()}
    return {"entries": len(members), "occluded": int(hidden[members].sum())} | sums


def _count_pool(line: Timeline, used: list[int], begin: float, end: float) -> None:
    """Bytes in use after each batch, spread evenly over the front end's part of the pass."""
    for k, value in enumerate(used):
        line.counter("pool bytes", begin + (end - begin) * (k + 1) / len(used), "bytes", value)


def _names(recording: Recording, events: list[Event]) -> list[Event]:
    """Names of processes and threads."""
    processes = {FRONT_END: "front end", CORES: "simulated cores", QUEUES: "queues"}
    names = [("process_name", pid, 0, name) for pid, name in processes.items()]
    names.append(("thread_name", FRONT_END, 1, "all stages"))
    names += [("thread_name", CORES, c + 1, f"core {c}") for c in range(recording.machine.cores)]
    made = [{"ph": "M", "pid": pid, "tid": tid, "name": kind, "args": {"name": name}} for kind, pid, tid, name in names]
    return made + [
        {"ph": "M", "pid": pid, "tid": 0, "name": "process_sort_index", "args": {"sort_index": pid}}
        for pid in processes
    ]
