"""A first frame's kernels, compiled by two processes: while this one compiles what comes first, another what comes last.

Numba compiles on one thread. On a computer with several processors a second process, started where the back end's kernels are
not in the disk cache yet, calls them for a unit without triangles and so leaves them there. Whoever needs them waits for
it (`wait`), and compiles them himself if it failed: it changes nothing but the time of a first run.

Run as `python -m tiler.compile_ahead`, this module is that other process. It ends when its input ends, at once and
whatever it is at: one whose parent was interrupted or killed does not go on.
"""

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numba
import numpy as np

from pipeline import primitives
from pipeline.bounds.project import allocate
from pipeline.jit import ROOT, cache_root
from pipeline.types import DomainPoints, Patterns, Viewport
from tiler import back_end, front_end, tile
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.host import Host, available_threads
from tiler.scene import load_scene

KERNELS = (primitives.assemble, tile.process_tiles)  # those that take longest, of what the other process compiles
COMMAND = [sys.executable, "-m", "tiler.compile_ahead"]
MOST_SECONDS = 300.0  # that it may take; then it is stuck

_lock = threading.Lock()
_other: list[subprocess.Popen[bytes]] = []  # the process, if there is one
_looked: list[bool] = []  # something, once it is known whether there is anything to compile


def _missing(kernel: Any) -> bool:
    """Whether a kernel is compiled neither in this process nor on disk."""
    folder = Path(kernel.stats.cache_path)
    return not kernel.overloads and not any(folder.glob(f"*.{kernel.py_func.__name__}-*.nbi"))


def _can_start() -> bool:
    """Whether something is compiled at all, and a Python is known that can run this module: in a bundled program none is."""
    config: Any = numba.config
    return bool(sys.executable) and not getattr(sys, "frozen", False) and not config.DISABLE_JIT


def begin() -> None:
    """Start the other process if it has something to do, and a processor to do it on. Does nothing the second time."""
    with _lock:
        if _looked:
            return
        _looked.append(True)
        if not _can_start() or available_threads() < 2 or not all(map(_missing, KERNELS)):
            return
        environment = os.environ | {"TILER_CACHE_DIR": str(cache_root()), "TILER_QUIET": "1"}
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        try:
            other = subprocess.Popen(COMMAND, cwd=ROOT, env=environment, stdin=pipe, stdout=nothing, stderr=nothing)
        except OSError:
            return
        _other.append(other)


def wait() -> None:
    """Until the other process has ended, if there is one: what it compiled is then in the disk cache."""
    for other in list(_other):
        try:
            other.wait(MOST_SECONDS)
        except subprocess.TimeoutExpired:
            other.kill()
            other.wait()
        with _lock:
            if other in _other:
                _other.remove(other)
                if other.stdin is not None:
                    other.stdin.close()


def compile_back_end() -> None:
    """Call every kernel from the domain points to the picture, for one unit without triangles."""
    scene, machine = load_scene("teapot", size=(16, 16)), Machine()
    picture = scene.picture
    grid, viewport = make_grid(16, 16, machine.tile), Viewport(0, 0, 16, 16, 0.0, 1.0)
    live, ends = np.zeros(1, np.int32), np.array([0, 1])
    patterns = Patterns(live, np.zeros((2, 1), np.float32), ends, np.zeros(0, np.uint16), np.zeros(2, np.int64))
    points = DomainPoints(ends, np.ones((4, 1), np.float32), np.ones((3, 1), np.float32))
    bounds = allocate(1)
    bounds.rect[:], bounds.z_min[:] = 0, 0
    canvas = back_end.make_canvas(picture, False, 0, grid)
    counts = np.zeros((grid.num_tiles, tile.NUM_TILE_COUNTS), np.int64)
    with Host(1) as host:
        geometry = front_end.set_up_triangles(live, points, patterns, viewport, scene, host)
        bins = back_end.bin_batch(live, geometry, bounds, machine, grid, picture.samples, host)
        back_end.run_tiles(
            bins, live, geometry, back_end.NO_ORDER, bounds, back_end.make_rules(machine), scene, grid, canvas.target,
            canvas.coarse, counts, True, True, host,
        )  # fmt: skip


def _end_with_input() -> None:
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_end_with_input, daemon=True).start()
    compile_back_end()
    os._exit(0)  # the usual end may find the input held by that thread
