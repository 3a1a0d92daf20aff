"""What a cost model makes of a recording: cycles of the front end, of each tile's visit, and of each entry of its queue.

A counter's cycles go to the queue entry that made them, where that is known; else to the tile; else to the front end. So
the parts of each stage add up to its work in `tiler.cost_model.cost`.
"""

from typing import NamedTuple

import numpy as np

from pipeline.types import F64, I64
from tiler.cost_model import BOUNDED, CostModel, bound_cost, load_cost_model, needed_bound
from tiler.counters import DEFINITIONS
from tiler.tally import OUTCOME_COUNTERS
from tiler.trace.record import Recording, tile_columns

FRONT_END_LAST = ("queue_entries", "queue_bytes_written")  # with every pass again


class Part(NamedTuple):
    """A part of a cost model's stage. cycles : of an event of each counter; empty for bounds."""

    name: str
    stage: str
    units: float
    cycles: dict[str, float]


class Work(NamedTuple):
    """Cycles of work, a column a part; units that work side by side are not yet counted.

    once : before the first pass. front : by pass. visit : (tile, pass) pairs with an entry, sorted as keys pass * tiles +
    tile in `key`; what is known of the tile alone. entry : of each entry.
    """

    parts: tuple[Part, ...]
    once: F64  # (parts,)
    front: dict[int, F64]  # (parts,) each
    key: I64  # (visits,)
    visit: F64  # (visits, parts)
    entry: F64  # (entries, parts)


def parts_of(model: CostModel) -> tuple[Part, ...]:
    """A stage is one part; that of the shaders has one for each kind of shader, and one for bounds."""
    parts = []
    for stage in model.stage:
        if not stage.bounds:
            parts.append(Part(stage.name, stage.name, stage.units, {k: float(v) for k, v in stage.cycles.items()}))
            continue
        for kind in dict.fromkeys(DEFINITIONS[name].stage for name in stage.cycles):
            cycles = {k: float(v) for k, v in stage.cycles.items() if DEFINITIONS[k].stage == kind}
            parts.append(Part(kind, stage.name, stage.units, cycles))
        parts.append(Part("bounds", stage.name, stage.units, {}))
    return tuple(sorted(parts, key=_place))


def share_work(recording: Recording, model_name: str) -> Work:
    """The cycles of a recording by a cost model. Raises TilerError where the model has no cost for the machine's bound."""
    model = load_cost_model(model_name)
    machine, counters, entries = recording.machine, recording.counters, recording.entries
    bounding = bound_cost(model, machine, model_name) * model.domain_shader_cycles
    parts, tiles = parts_of(model), recording.grid.num_tiles
    key = np.unique(entries.pass_number * tiles + entries.tile)
    n, v = len(entries.tile), len(key)
    once, visit, entry = np.zeros(len(parts)), np.zeros((v, len(parts))), np.zeros((n, len(parts)))
    front = {number: np.zeros(len(parts)) for number in np.unique(entries.pass_number).tolist()}
    of_pass = {number: int(np.count_nonzero(entries.pass_number == number)) for number in front}
    for k, part in enumerate(parts):
        if part.name == "bounds" and not part.cycles:
            once[k] = counters[BOUNDED] * bounding if needed_bound(machine) else 0.0
        for name, cycles in part.cycles.items():
            by_entry, by_visit = entry_events(recording, name), visit_events(recording, name, key)
            if by_entry is not None:
                entry[:, k] += cycles * by_entry
            elif by_visit is not None:
                visit[:, k] += cycles * by_visit
            known = by_entry if by_entry is not None else by_visit
            rest = counters[name] - (float(known.sum()) if known is not None else 0.0)
            if name in FRONT_END_LAST and n:
                for number in front:
                    front[number][k] += cycles * rest * of_pass[number] / n
            else:
                once[k] += cycles * rest
    return Work(parts, once, front, key, visit, entry)


def entry_events(recording: Recording, name: str) -> F64 | None:
    """Events of a counter for each queue entry, float64[entries]; None where only the tile's sum, or less, is known."""
    machine, entries = recording.machine, recording.entries
    worked = (entries.hidden == 0).astype(np.float64)
    n = len(worked)
    if name == "queue_bytes_read":  # walked with the list; shared records make them uneven, which is not kept
        return np.full(n, recording.counters[name] / n) if n else None
    if machine.binning == "triangle":
        return worked if name == "rs_triangles" else None
    if name == "ds_invocations":
        return (recording.points[entries.unit] * entries.shaded).astype(np.float64)
    if name in ("dc_lookups", "dc_hits"):
        if machine.domain_cache == "none":
            return np.zeros(n)
        return worked if name == "dc_lookups" else worked * (entries.shaded == 0)
    if name in OUTCOME_COUNTERS:
        return recording.outcomes[entries.unit, int(OUTCOME_COUNTERS[name])] * worked
    return None


def visit_events(recording: Recording, name: str, key: I64) -> F64 | None:
    """Events of a counter for each visit of a tile, float64[visits]; None where tiles do not know it."""
    tile = key % recording.grid.num_tiles
    if name == "om_spilled_bytes":  # what a tile writes back and reads again, at each visit but its first
        later = np.ones(len(key))
        later[np.unique(tile, return_index=True)[1]] = 0.0
        weight = later * _tile_pixels(recording)[tile]
        return weight * (recording.counters[name] / weight.sum()) if weight.any() else None
    if name == "om_samples_failed":
        covered, passed = (visit_events(recording, other, key) for other in ("rs_samples_covered", "om_samples_passed"))
        return None if covered is None or passed is None else covered - passed
    columns = tile_columns(recording.machine)
    if name not in columns:
        return None
    found = np.zeros(len(key))
    keys, rows = recording.visits
    np.add.at(found, np.searchsorted(key, keys), rows[:, columns[name]])  # who counts something has an entry
    return found


def _tile_pixels(recording: Recording) -> I64:
    grid = recording.grid
    side = 1 << grid.tile_log2
    wide = np.minimum(side, grid.width - side * np.arange(grid.tiles_x))
    high = np.minimum(side, grid.height - side * np.arange(grid.tiles_y))
    return np.outer(high, wide).ravel()


def _place(part: Part) -> int:
    """Place of a part in the pipeline, by the first of its counters; bounds stand behind the hull shader."""
    names = list(DEFINITIONS)
    if not part.cycles:
        return names.index("hs_culled_nonfinite") if part.name == "bounds" else len(names)
    return min(names.index(name) for name in part.cycles)
