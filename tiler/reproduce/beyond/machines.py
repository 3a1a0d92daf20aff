"""The machines of these figures, what is counted of them, and the ideal that they are measured against.

`triangle` is the sort-middle machine that exists: it shades every patch and bins triangles. `patch` and `subpatch` have
everything on, as `tiler compare` has it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tiler.comparison import MACHINES
from tiler.config import Machine
from tiler.frame import Frame
from tiler.queues import queue_bytes
from tiler.reproduce.item import Context
from tiler.scene.model import Scene
from tiler.simulation import simulate

MODES = {"triangle": MACHINES["triangle"], "patch": MACHINES["patch, all"], "subpatch": MACHINES["subpatch, all"]}
IDEAL, FLOOR = "ideal", "ideal, triangles"

CZ_TESTS = ("cz_units_tested", "cz_pairs_tested", "cz_triangles_tested", "cz_blocks_tested")
METRICS = {
    "ds_invocations": "domain-shader invocations",
    "queue_bytes": "queue bytes",
    "cz_tests": "coarse-Z tests",
}
UNITS = {
    "machine": "binning mode, everything on but for `triangle`; `ideal`: patches with a visible sample, whole; "
    "`ideal, triangles`: triangles with a visible sample",
    "ds_invocations": "domain points shaded in the frame",
    "queue_bytes": "bytes of all tile queues and the records that their entries refer to; of the ideal: visible pairs of a "
    "patch and a tile",
    "cz_tests": "tests of patches, sub-domains, queue entries and triangles against coarse Z; none where nothing is tested",
    "queue_entries": "entries of all tile queues",
}


def machine_of(mode: str, **changes: Any) -> Machine:
    """The machine of a binning mode; fields of `Machine` change it."""
    return Machine(**{**MODES[mode], **changes})


def measures(frame: Frame) -> dict[str, int | None]:
    """The columns of a machine's frame; a machine that tests nothing has None for its tests."""
    counters = frame.counters
    return {
        "ds_invocations": counters["ds_invocations"],
        "queue_bytes": counters["queue_bytes"],
        "cz_tests": sum(counters[name] for name in CZ_TESTS) or None,
        "queue_entries": counters["queue_entries"],
    }


def ideal_measures(frame: Frame) -> dict[str, dict[str, int | None]]:
    """The columns of the ideal, from a frame of `patch` binning with blame: visible patches whole, visible triangles only."""
    if frame.blame is None or frame.machine.binning != "patch":
        raise ValueError("the ideal is told by a machine with patch binning and blame")
    ideal = frame.blame.ideal
    entries = ideal["ideal_entries"]
    queued = {"queue_bytes": queue_bytes(entries, 0, 0, ideal["ideal_patches"], 0), "queue_entries": entries}
    return {
        IDEAL: {"ds_invocations": ideal["ideal_unit_points"], "cz_tests": None, **queued},
        FLOOR: {
            "ds_invocations": ideal["ideal_domain_points"],
            "cz_tests": None,
            "queue_bytes": None,
            "queue_entries": None,
        },
    }


class Step(NamedTuple):
    """A place on the axis of a figure: its columns, and what is simulated there."""

    columns: dict[str, Any]
    scene: Scene
    frame: float
    changes: dict[str, Any]  # fields of every machine


def run_steps(
    context: Context, steps: Sequence[Step], done: Callable[[Frame], None] = lambda frame: None
) -> dict[str, list[Any]]:
    """Every mode at every step, and the ideal, as a long table: the steps' columns, `machine`, and those of `measures`."""
    rows: list[dict[str, Any]] = []
    for k, step in enumerate(steps):
        for m, mode in enumerate(MODES):
            machine = machine_of(mode, blame=mode == "patch", **step.changes)
            frame = simulate(step.scene, machine, frame=step.frame, threads=context.threads)
            rows.append({**step.columns, "machine": mode, **measures(frame)})
            if machine.blame:
                rows += [{**step.columns, "machine": name, **values} for name, values in ideal_measures(frame).items()]
            done(frame)
            context.update((k + (m + 1) / len(MODES)) / len(steps))
    return {column: [row[column] for row in rows] for column in rows[0]}


def value_of(table: dict[str, list[Any]], column: str, **where: Any) -> Any:
    """The one value of a column in the row where other columns are as given."""
    places = range(len(table[column]))
    found = [k for k in places if all(table[name][k] == value for name, value in where.items())]
    if len(found) != 1:
        raise ValueError(f"{len(found)} rows have {where}; one is wanted")
    return table[column][found[0]]
