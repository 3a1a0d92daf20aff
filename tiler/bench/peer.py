"""Side by side with llvmpipe: the same scene, picture and threads, in alternation frame by frame.

A shared computer changes its pace by a factor of two from one second to the next. So the programs take turns, the ratio is
the median of the turns' ratios, and each frame stands between two runs of a fixed loop, whose time is reported.
"""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiler.bench.facts import spin
from tiler.bench.llvmpipe import Picture, Renderer, drawing_of
from tiler.bench.scenes import bench_scene
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.frame import Frame
from tiler.scene.model import Scene
from tiler.simulation import simulate

FACTORS = (8, 16, 32, 64)
CULLS = ("frustum", "backface:tessellation_safe")  # that change no picture, and need nothing of the tiles


def machines() -> dict[str, Machine]:
    """The machines that are compared: what exists, and the one with culls of whole patches that is simulated fastest.

    That one bins triangles, too: its tiles wait for nothing, so it is drawn by `tiler/regions.py`.
    """
    return {
        "triangle": Machine(binning="triangle", cull=()),
        "culling": Machine(binning="triangle", bounds="tpatch", cull=_known(CULLS)),
    }


def _known(names: Sequence[str]) -> tuple[str, ...]:
    found: list[str] = []
    for name in names:
        try:
            Machine(cull=(name,))
        except TilerError:
            continue
        found.append(name)
    return tuple(found)


def lp_threads(threads: int) -> int:
    """LP_NUM_THREADS: 0 draws all on the calling thread; n > 0 adds n threads for the tiles, so the peer has one more than
    the machine."""
    return 0 if threads == 1 else threads


def compare_with_llvmpipe(
    names: Sequence[str],
    factors: Sequence[float],
    size: tuple[int, int],
    threads: int,
    rounds: int,
    chosen: Mapping[str, Machine] | None = None,
    scenes: Callable[[str, float, tuple[int, int]], Scene] = bench_scene,
    out: Path | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> tuple[str, list[dict[str, Any]]]:
    """llvmpipe's name, and a row for each scene, factor and machine. out : folder for both pictures of each.

    Row: scene, factor, machine, seconds and peer_seconds (medians), ratio (median of peer / machine), the fastest of both,
    the medians of processor time of all threads (cpu_...), spin (median seconds), ds_invocations and the peer's, covered
    (pixels), covered_by_one, depth_median and depth_most (difference where both cover). Raises TilerError where llvmpipe is
    not installed.
    """
    rows = []
    with Renderer(lp_threads(threads)) as peer:
        for done, (name, factor) in enumerate((n, f) for n in names for f in factors):
            scene = scenes(name, factor, size)
            peer.load(drawing_of(scene))
            rows += _take_turns(scene, factor, peer, chosen or machines(), threads, rounds, out)
            progress(done + 1)
        return peer.name, rows


def _take_turns(
    scene: Scene,
    factor: float,
    peer: Renderer,
    chosen: Mapping[str, Machine],
    threads: int,
    rounds: int,
    out: Path | None,
) -> list[dict[str, Any]]:
    picture = peer.read()
    frames = {name: simulate(scene, machine, threads=threads) for name, machine in chosen.items()}
    turns: dict[str, list[tuple[float, ...]]] = {name: [] for name in chosen}
    for _ in range(rounds):
        spins = [spin()]
        peer_seconds, peer_cpu = peer.draw()
        spins.append(spin())
        for name, machine in chosen.items():
            start, cpu = time.perf_counter(), time.process_time()
            simulate(scene, machine, threads=threads)
            seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
            spins.append(spin())
            turns[name].append((seconds, peer_seconds, cpu, peer_cpu, statistics.median(spins)))
    if out is not None:
        _save(out / f"{scene.name}_{factor:g}", picture, next(iter(frames.values())))
    return [_row(scene, factor, name, turns[name], picture, frame) for name, frame in frames.items()]


def _row(
    scene: Scene, factor: float, name: str, turns: list[tuple[float, ...]], picture: Picture, frame: Frame
) -> dict[str, Any]:
    seconds, peer_seconds, cpu, peer_cpu, spins = (statistics.median(column) for column in zip(*turns, strict=True))
    return {
        "scene": scene.name,
        "factor": factor,
        "machine": name,
        "seconds": seconds,
        "peer_seconds": peer_seconds,
        "ratio": statistics.median(peer / ours for ours, peer, *_ in turns),
        "fastest": min(ours for ours, *_ in turns),
        "peer_fastest": min(peer for _, peer, *_ in turns),
        "cpu_seconds": cpu,
        "peer_cpu_seconds": peer_cpu,
        "cpu_ratio": statistics.median(peer / ours for _, _, ours, peer, _ in turns),
        "spin": spins,
        "ds_invocations": frame.counters["ds_invocations"],
        "peer_ds_invocations": picture.counters["ds_invocations"],
        **picture_difference(picture, frame),
    }


def picture_difference(picture: Picture, frame: Frame) -> dict[str, Any]:
    """How far two renderers' pictures are apart: pixels that only one covers, and depth where both do."""
    theirs, ours = picture.depth < 1, frame.depth < 1
    difference = np.abs(picture.depth - frame.depth)[theirs & ours]
    return {
        "covered": int(ours.sum()),
        "covered_by_one": int((theirs != ours).sum()),
        "depth_median": float(np.median(difference)) if len(difference) else 0.0,
        "depth_most": float(difference.max()) if len(difference) else 0.0,
    }


def _save(stem: Path, picture: Picture, frame: Frame) -> None:
    from PIL import Image

    from tiler.files import make_folder, write_png

    make_folder(stem.parent)
    write_png(stem.with_name(f"{stem.name}_llvmpipe.png"), Image.fromarray(picture.color))
    write_png(stem.with_name(f"{stem.name}_tilesim.png"), frame.image())
