"""`tiler.write_trace`: a frame's timeline as a file."""

import gzip
import json
from pathlib import Path
from typing import Any

from tiler import __version__
from tiler.config import Machine
from tiler.cost_model import bound_cost, load_cost_model
from tiler.errors import TilerError
from tiler.files import check_target, write_bytes
from tiler.host import available_threads
from tiler.scene.model import Scene
from tiler.simulation import check_request
from tiler.trace.record import record_frame
from tiler.trace.timeline import MOST_SLICES, trace_events

CLOCK = "1 ns is 1 cycle of the cost model: 1 us is 1000 cycles"
LEAST_SLICES = 100


def write_trace(
    scene: Scene,
    machine: Machine | None,
    file: str | Path,
    *,
    frame: float = 0,
    model: str = "wide",
    most: int = MOST_SLICES,
    threads: int | None = None,
) -> None:
    """Draw a frame and write its timeline for Perfetto (https://ui.perfetto.dev) or chrome://tracing.

    scene, machine, frame, threads : as of `tiler.simulate`. file : ends in .json or .json.gz. model : the cost model that
    the cycles are from, a name or a .toml file. most : about how many slices the file may have; above that the last
    patches of each tile share a slice, then tiles do. Raises TilerError.
    """
    file, machine = Path(file), Machine() if machine is None else machine
    check_trace(file, machine, model)
    if not isinstance(most, int) or most < LEAST_SLICES:
        raise TilerError(f"most: {most!r} is not allowed; allowed: a whole number from {LEAST_SLICES}")
    threads = available_threads() if threads is None else threads
    check_request(scene, machine, threads, frame)
    recording = record_frame(scene, machine, frame, threads)
    about: dict[str, Any] = {
        "clock": CLOCK,
        "cost_model": model,
        "scene": recording.scene,
        "frame": frame,
        "machine": machine.model_dump(mode="json"),
        "counters": dict(recording.counters),
        "version": __version__,
    }
    made = {"displayTimeUnit": "ns", "otherData": about, "traceEvents": trace_events(recording, model, most)}
    content = json.dumps(made, separators=(",", ":")).encode()
    write_bytes(file, gzip.compress(content, mtime=0) if file.suffix == ".gz" else content)


def check_trace(file: Path, machine: Machine, model: str = "wide") -> None:
    """Raise TilerError where a trace cannot be written so, before anything is drawn."""
    if not file.name.endswith((".json", ".json.gz")):
        raise TilerError(f"trace: {str(file)!r} is not allowed; allowed: a file that ends in .json or .json.gz")
    check_target(file, "trace")
    bound_cost(load_cost_model(model), machine, model)
