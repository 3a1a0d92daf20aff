"""The animation of Table 2 and Figure 11: a character walks by, then the camera zooms in, so that part of it is outside.

Four machines of `triangle` binning, as that paper's GPU has it: without culling, and with each bound. The paper's SubD11 has
a constant displacement, and so has the creature here: TPATCH drops back-facing patches as well, by the cone of its normals.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiler.config import Machine
from tiler.cost_model import cost
from tiler.reproduce.item import Context
from tiler.scene import load_scene
from tiler.scene.model import CameraKey, Scene
from tiler.simulation import simulate

SIZE, QUICK_SIZE = (1280, 720), (480, 270)
FACTORS, QUICK_FACTORS = (4, 8, 16, 32), (4, 16)
FRAMES, QUICK_FRAMES = tuple(range(0, 97, 8)), (0, 64, 96)
REPEATS = 2
DISPLACEMENT = 0.03  # world units, constant; the creature is 11 units long
MODEL = "munkberg2010"

MACHINES = {
    "none": Machine(binning="triangle", cull=()),
    "cbox": Machine(binning="triangle", cull=("frustum",), bounds="cbox"),
    "obbtex": Machine(binning="triangle", cull=("frustum",), bounds="obbtex"),
    "tpatch": Machine(binning="triangle", cull=("frustum", "backface:tcone"), bounds="tpatch"),
}
UNITS = {
    "factor": "tessellation factor, all six of every patch",
    "frame": "of the animation",
    "machine": "bound; none: no culling",
    "frame_ms": f"processor time of the frame on one thread, ms; the smaller of {REPEATS} runs",
    "ds_invocations": "domain-shader invocations",
    "culled": "patches culled, by the frustum or as back-facing",
    "equivalents": f"domain-shader invocations and the bounds' cost in invocations (model {MODEL})",
}


def animation(size: tuple[int, int], factor: float) -> Scene:
    """`creature`, displaced by a constant; the camera comes nearer to the head than in the scene's own path, and stays there.

    So near that over all frames the frustum culls a fifth of the patches; in the paper it saves a quarter of the time.
    """
    scene = load_scene("creature", size=size, factor=factor)
    flat = tuple(replace(m, texels=np.ones((1, 1), np.float32), scale=DISPLACEMENT, bias=0.0) for m in scene.maps)
    walk = tuple(key for key in scene.camera.keys if key.frame <= 48)
    zoom = (
        CameraKey(56.0, (8.0, -4.2, 4.2), (4.6, 0.0, 3.0)),
        CameraKey(68.0, (7.6, -2.1, 3.8), (5.5, 0.0, 3.4)),
        CameraKey(96.0, (8.3, -1.6, 3.8), (6.3, 0.0, 3.55)),
    )
    return replace(scene, maps=flat, camera=replace(scene.camera, keys=(*walk, *zoom)))


def settings(context: Context) -> tuple[tuple[int, int], tuple[int, ...], tuple[int, ...]]:
    """Size, factors and frames of a run."""
    if context.quick:
        return QUICK_SIZE, QUICK_FACTORS, QUICK_FRAMES
    return SIZE, FACTORS, FRAMES


_MEASURED: dict[
    bool, dict[str, list[Any]]
] = {}  # by `quick`: two items tell of the same frames, measured once in a process


def measure(context: Context) -> dict[str, list[Any]]:
    """A row for each factor, frame and machine; columns as in `UNITS`."""
    if context.quick not in _MEASURED:
        rows = _run(context)
        _MEASURED[context.quick] = {name: [row[k] for row in rows] for k, name in enumerate(UNITS)}
    return _MEASURED[context.quick]


def _run(context: Context) -> list[tuple[Any, ...]]:
    size, factors, frames = settings(context)
    rows: list[tuple[Any, ...]] = []
    total = len(factors) * len(frames) * len(MACHINES)
    for factor in factors:
        scene = animation(size, factor)
        for machine in MACHINES.values():
            simulate(scene, machine, frame=frames[0], threads=1)  # its kernels are loaded
        for number in frames:
            for name, machine in MACHINES.items():
                rows.append((factor, number, name, *_timed(scene, machine, number)))
                context.update(len(rows) / total)
    return rows


def _timed(scene: Scene, machine: Machine, number: int) -> tuple[float, int, int, float]:
    """ms, domain-shader invocations, patches culled, equivalents."""
    least = float("inf")
    for _ in range(REPEATS):
        start = time.process_time()
        frame = simulate(scene, machine, frame=number, threads=1)
        least = min(least, time.process_time() - start)
    counters = frame.counters
    culled = counters["hs_culled_frustum"] + counters["hs_culled_backface"]
    charged = cost(counters, machine, MODEL).domain_shader_equivalents
    return round(least * 1e3, 3), counters["ds_invocations"], culled, charged


def means(table: dict[str, list[Any]], column: str, factor: int) -> dict[str, float]:
    """Mean over the animation at a factor, by machine."""
    rows = list(zip(table["factor"], table["machine"], table[column], strict=True))
    return {name: float(np.mean([v for f, m, v in rows if (f, m) == (factor, name)])) for name in MACHINES}


def relative(table: dict[str, list[Any]], column: str, factors: Sequence[int]) -> dict[str, list[float]]:
    """Mean of each bound over that of no culling, one for each factor."""
    found = [means(table, column, factor) for factor in factors]
    return {name: [mean[name] / mean["none"] for mean in found] for name in MACHINES if name != "none"}
