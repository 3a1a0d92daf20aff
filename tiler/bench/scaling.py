"""How the time of a frame grows: with factor, patches, picture and threads; and the memory of a million patches."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiler.bench.facts import spin
from tiler.bench.scenes import PATCHES, torus
from tiler.bench.stages import BASELINE
from tiler.errors import TilerError
from tiler.scene.model import Scene
from tiler.simulation import simulate

FACTORS = (1, 2, 4, 8, 16, 32, 64)
COUNTS = (100, 1_000, 10_000, 100_000, 1_000_000)
SIZES = ((480, 270), (960, 540), (1920, 1080), (3840, 2160))
LIMIT, QUICK_LIMIT = 60.0, 2.0  # seconds of a frame
MILLION = (1_000_000, 16, (3840, 2160))  # patches, factor, picture


class Point(NamedTuple):
    """One frame of a scaling table."""

    axis: str  # factor, patches, pixels or threads
    value: int
    patches: int
    factor: float
    size: tuple[int, int]
    threads: int
    triangles: int  # tessellated
    seconds: float  # fastest frame
    cpu_seconds: float  # of all threads in that frame
    spin: float  # seconds of the fixed loop, mean of before and after


class Fit(NamedTuple):
    """seconds = offset + slope * triangles, least squares."""

    slope: float
    offset: float
    r2: float


def linear_fit(x: Sequence[float], y: Sequence[float]) -> Fit:
    """Least-squares line through the points, and the part of the variance of y that it explains."""
    a, b = np.asarray(x, np.float64), np.asarray(y, np.float64)
    slope = float(((a - a.mean()) * (b - b.mean())).sum() / ((a - a.mean()) ** 2).sum())
    offset = float(b.mean() - slope * a.mean())
    left = float(((b - offset - slope * a) ** 2).sum())
    total = float(((b - b.mean()) ** 2).sum())
    return Fit(slope, offset, 1.0 - left / total if total > 0 else 1.0)


def measure(axis: str, value: int, scene: Scene, threads: int, repeats: int) -> Point:
    """A point of a table: the fastest of `repeats` frames of the triangle machine."""
    best = (np.inf, 0.0, 0.0)
    frame = None
    for _ in range(repeats):
        before, start, cpu = spin(), time.perf_counter(), time.process_time()
        frame = simulate(scene, BASELINE, threads=threads)
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        best = min(best, (seconds, cpu, (before + spin()) / 2))
    assert frame is not None
    size = (scene.picture.width, scene.picture.height)
    triangles = frame.counters["ts_triangles"]
    return Point(
        axis, value, scene.num_patches, scene.tessellation.factor[0], size, threads, triangles, *best
    )  # fmt: skip


def scaling(size: tuple[int, int], threads: int, quick: bool, patches: int = PATCHES) -> list[Point]:
    """The four tables, one after the other. An axis ends early where its next frame would take more than some seconds."""
    limit = QUICK_LIMIT if quick else LIMIT
    axes: list[Iterator[tuple[str, int, Callable[[], Scene], int]]] = [
        (("factor", f, lambda f=f: torus(patches, f, size), threads) for f in FACTORS),  # type: ignore[misc]
        (("patches", n, lambda n=n: torus(n, 16, size), threads) for n in COUNTS),  # type: ignore[misc]
        (("pixels", s[0] * s[1], lambda s=s: torus(patches, 16, s), threads) for s in SIZES),  # type: ignore[misc]
        (("threads", n, lambda: torus(patches, 16, size), n) for n in range(1, threads + 1)),
    ]
    points: list[Point] = []
    simulate(torus(patches, 1, size), BASELINE, threads=threads)
    for axis in axes:
        before: Point | None = None
        for name, value, make, n in axis:
            if before is not None and name != "threads":
                growth = (value / before.value) ** (2 if name == "factor" else 1)
                if before.seconds * growth > limit:
                    break
            slow = before is not None and before.seconds > 2.0
            before = measure(name, value, make(), n, 1 if quick or slow else 3)
            points.append(before)
    return points


def triangle_fit(points: Sequence[Point]) -> Fit | None:
    """Frame time over triangles along the factor axis; None for fewer than three points."""
    chosen = [p for p in points if p.axis == "factor"]
    return linear_fit([p.triangles for p in chosen], [p.seconds for p in chosen]) if len(chosen) > 2 else None


class Memory(NamedTuple):
    """A frame in a process of its own."""

    patches: int
    factor: float
    size: tuple[int, int]
    threads: int
    seconds: float
    peak_bytes: int  # largest resident set of the process, scene included


def million_patches(threads: int, patches: int = MILLION[0], size: tuple[int, int] = MILLION[2]) -> Memory:
    """The large run: its time and the peak memory of its process."""
    command = [sys.executable, "-m", "tiler.bench.scaling", str(patches), str(size[0]), str(size[1]), str(threads)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TilerError(f"bench: the run of {patches:,} patches failed: {done.stderr.strip()[-300:]}")
    found = json.loads(done.stdout)
    return Memory(found["patches"], MILLION[1], size, threads, found["seconds"], found["peak_bytes"])


def _large_run(patches: int, width: int, height: int, threads: int) -> None:
    scene = torus(patches, MILLION[1], (width, height))
    start = time.perf_counter()
    simulate(scene, BASELINE, threads=threads)
    seconds = time.perf_counter() - start
    print(json.dumps({"patches": scene.num_patches, "seconds": seconds, "peak_bytes": _peak_bytes()}))


def _peak_bytes() -> int:
    """Largest resident set of this process. Not from getrusage: there a child starts at its parent's peak."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        raise TilerError("bench: peak memory is known on Linux only") from None
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


if __name__ == "__main__":
    _large_run(*map(int, sys.argv[1:5]))
