"""What a measurement was made on: processor, versions, load, and how fast the processor was just then."""

import importlib.metadata
import os
import platform
import time
from pathlib import Path
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

    versions = {"tilesim": tiler.__version__, "python": platform.python_version()}
    versions |= {name: importlib.metadata.version(name) for name in SHOWN}
    return {
        "processor": _processor(),
        "system": f"{platform.system()} {platform.machine()}",
        "processors": available_threads(),
        "threads": threads,
        "versions": versions,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    fields = dict(line.split(":", 1) for line in reversed(lines) if ":" in line)
    found = {key.strip(): value.strip() for key, value in fields.items()}
    name = found.get("model name", platform.processor() or "unknown")
    return f"{name}, family {found['cpu family']} model {found['model']}" if "cpu family" in found else name
