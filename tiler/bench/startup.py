"""What a newcomer waits for: the first frame with its compile, the next process, and the import; each in its own process."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from tiler.errors import TilerError

ASKED = {"first frame": 45.0, "second process": 2.5, "import tiler": 0.5}  # seconds, no more
SCENE = "teapot"


class Wait(NamedTuple):
    """From command to end: seconds, and processor seconds, which a busy computer changes less."""

    what: str  # of ASKED
    seconds: float
    cpu_seconds: float


def measure_startup(scene: str = SCENE, repeats: int = 3) -> list[Wait]:
    """`tiler render` with an empty kernel cache, `tiler render` again, and `import tiler`; the fastest of several but for the
    first."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"TILER_CACHE_DIR": str(Path(folder) / "kernels"), "TILER_QUIET": "1"}
        render = [sys.executable, "-m", "tiler", "render", scene, "--quiet", "--out", str(Path(folder) / "out")]
        light = [sys.executable, "-c", "import tiler"]
        runs = [(render, 1), (render, repeats), (light, repeats)]
        times = [min(_times(command, environment) for _ in range(n)) for command, n in runs]
    return [Wait(what, *time) for what, time in zip(ASKED, times, strict=True)]


def _times(command: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Seconds and processor seconds of a process."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise TilerError(f"bench: {' '.join(command[1:])} failed: {done.stderr.strip()[-300:]}")
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
