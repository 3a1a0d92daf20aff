"""What a measurement was made on: processor, versions, load, and how fast the processor was just then."""

import importlib.metadata
import os
import platform
import time
from typing import Any

SPIN_STEPS = 30_000
SHOWN = ("numpy", "numba", "llvmlite")


def spin() -> float:
    """Seconds of a fixed loop of Python: on a shared machine it tells a slow moment from a slow program."""
    start, total = time.perf_counter(), 0
    for k in range(SPIN_STEPS):
        total += k
    return time.perf_counter() - start


def load_average() -> float | None:
    """Processes that wanted to run in the last minute, averaged; None where the system does not say."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def host_facts(threads: int) -> dict[str, Any]:
    """Facts of this computer and installation; `threads` is what the measurements use at most."""
    import tiler
    from tiler.host import available_threads
    from tiler.provenance import cpu_model

    versions = {"tilesim": tiler.__version__, "python": platform.python_version()}
    versions |= {name: importlib.metadata.version(name) for name in SHOWN}
    return {
        "processor": cpu_model(),
        "system": f"{platform.system()} {platform.machine()}",
        "processors": available_threads(),
        "threads": threads,
        "versions": versions,
    }
