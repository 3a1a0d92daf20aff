"""What a newcomer waits for: the first frame with its compile, the next process, and the import; each in its own process."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tiler.errors import TilerError

ASKED = {"first frame": 45.0, "second process": 2.5, "import tiler": 0.5}  # seconds, no more
SCENE = "teapot"


def measure_startup(scene: str = SCENE, repeats: int = 3) -> dict[str, float]:
    """Seconds from command to end: `tiler render` with an empty kernel cache, again, and `import tiler`; best of several
    but for the first."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"TILER_CACHE_DIR": str(Path(folder) / "kernels"), "TILER_QUIET": "1"}
        render = [sys.executable, "-m", "tiler", "render", scene, "--quiet", "--out", str(Path(folder) / "out")]
        first = _seconds(render, environment)
        second = min(_seconds(render, environment) for _ in range(repeats))
        light = min(_seconds([sys.executable, "-c", "import tiler"], environment) for _ in range(repeats))
    return dict(zip(ASKED, (first, second, light), strict=True))


def _seconds(command: list[str], environment: dict[str, str]) -> float:
    start = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TilerError(f"bench: {' '.join(command[1:])} failed: {done.stderr.strip()[-300:]}")
    return time.perf_counter() - start
