"""What each stage costs, in nanoseconds for one of what it works on."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS, CullTest
from pipeline.types import HullInput, PatchBounds, Viewport
from tiler import front_end
from tiler import machine as machine_module
from tiler.bench.limits import best_seconds
from tiler.bench.scenes import PATCHES, torus, with_factor
from tiler.bench.stopwatch import Stopwatch, timing
from tiler.config import Machine
from tiler.frame import Frame
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene
from tiler.simulation import simulate

BASELINE = Machine(binning="triangle", cull=())
NAMES = {  # of what `render_frame` calls: the stage, what it works on, the counter that says how many
    "front_end.run_vertex_shader": ("vertex shader", "vertex", "vs_invocations"),
    "front_end.tessellate": ("tessellator", "patch", "ts_patches"),
    "front_end.shade_domain_points": ("domain shader", "invocation", "ds_invocations"),
    "front_end.set_up_triangles": ("project, clip, set up", "triangle", "c_invocations"),
    "back_end.bin_drawn": ("binning", "triangle binned", "su_triangles"),
    "back_end.run_tiles": ("tile loop", "triangle and tile", "rs_triangles"),
}
SHARE = 0.002  # of a frame's time: stages below are not listed


class Stage(NamedTuple):
    """A row of the stage table."""

    stage: str
    ns: float
    per: str
    threads: int


def _none_in_regions(machine: Machine) -> bool:
    return False


def timed_frame(scene: Scene, machine: Machine, threads: int, repeats: int) -> tuple[Frame, Stopwatch]:
    """The fastest of several frames, with its times, after one that is not timed. All are drawn stage by stage."""
    with patch.object(machine_module, "draws_in_regions", _none_in_regions):
        simulate(scene, machine, threads=threads)
        best: tuple[Frame, Stopwatch] | None = None
        for _ in range(repeats):
            with timing() as watch:
                frame = simulate(scene, machine, threads=threads)
            if best is None or frame.seconds < best[0].seconds:
                best = frame, watch
    assert best is not None
    return best


def at_once(scene: Scene, threads: int, repeats: int, where: str) -> Stage:
    """The baseline's frame where the same is done patch by patch (`tiler/regions.py`)."""
    frame = simulate(scene, BASELINE, threads=threads)
    seconds = best_seconds(lambda: simulate(scene, BASELINE, threads=threads), repeats)
    return Stage(
        f"whole frame, by regions, {where}", seconds / frame.counters["c_invocations"] * 1e9, "triangle", threads
    )


def frame_stages(frame: Frame, watch: Stopwatch, threads: int, where: str) -> list[Stage]:
    """The stages of a frame by falling time, and what is left of it."""
    rows = []
    for name, seconds in sorted(watch.stages.items(), key=lambda item: -item[1]):
        stage, per, counter = NAMES.get(name, (name, "frame", ""))
        count = frame.counters[counter] if counter else 1
        if seconds >= SHARE * frame.seconds and count:
            rows.append(Stage(f"{stage}, {where}", seconds / count * 1e9, per, threads))
    rest = frame.seconds - sum(watch.stages.values())
    return [*rows, Stage(f"rest, {where}", rest * 1e9, "frame", threads)]


def tile_loop_stages(scene: Scene, threads: int, repeats: int) -> list[Stage]:
    """The tile loop taken apart by frames in which one part prevails: empty, large triangles, micro-triangles."""

    def tile_loop(drawn: Scene) -> tuple[float, Mapping[str, int]]:
        frame, watch = timed_frame(drawn, BASELINE, threads, repeats)
        return watch.stages["back_end.run_tiles"], frame.counters

    pixels = scene.picture.width * scene.picture.height
    empty, _ = tile_loop(with_factor(few_patches(scene, 1), 1))
    large, counts = tile_loop(with_factor(scene, 1))
    per_pixel = max(large - empty, 0.0) / max(counts["om_samples_passed"], 1)
    small, counts = tile_loop(with_factor(scene, 64))
    per_triangle = max(small - empty - per_pixel * counts["om_samples_visible"], 0.0) / max(counts["rs_triangles"], 1)
    return [
        Stage("clear and tile overhead", empty / pixels * 1e9, "pixel of the picture", threads),
        Stage("rasterize and shade, large triangles", per_pixel * 1e9, "sample passed", threads),
        Stage("rasterize, micro-triangles", per_triangle * 1e9, "triangle and tile", threads),
    ]


def hull_stage(scene: Scene) -> HullInput:
    """What bounds and cull tests see of a scene's first frame."""
    viewport = Viewport(0, 0, scene.picture.width, scene.picture.height, 0.0, 1.0)
    camera = camera_at(scene.camera, 0, viewport.width / viewport.height)
    patches = front_end.run_vertex_shader(scene, 0)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    return front_end.hull_input(scene, patches, front_end.scene_maps(scene, 0), factors, camera, viewport)


def hull_stages(scene: Scene, repeats: int) -> list[Stage]:
    """Each of BOUNDS on the displaced patches, each of CULL_TESTS on the same without displacement; all patches alive."""
    displaced = hull_stage(scene)
    plain = hull_stage(replace(scene, map_id=np.full_like(scene.map_id, -1)))
    n = scene.num_patches
    rows = []
    for name, bound in BOUNDS.items():
        seconds = best_seconds(partial(bound, displaced), repeats)
        rows.append(Stage(f"bound {name}", seconds / n * 1e9, "patch", 1))
    bounds = BOUNDS["cbox"](plain)
    for name, cull in CULL_TESTS.items():
        seconds = best_seconds(partial(_cull_all, cull, plain, bounds), repeats)
        rows.append(Stage(f"cull {name}", seconds / n * 1e9, "patch", 1))
    return rows


def _cull_all(cull: CullTest, stage: HullInput, bounds: PatchBounds) -> None:
    cull(stage, bounds, np.zeros(len(stage.patches.map_id), np.uint8))


def few_patches(scene: Scene, n: int) -> Scene:
    """The scene's first n patches."""
    return replace(
        scene,
        control_points=scene.control_points[:n],
        texcoords=scene.texcoords[:n],
        map_id=scene.map_id[:n],
        object_id=scene.object_id[:n],
    )


def fixed_cost(threads: int, repeats: int) -> Stage:
    """A frame of one patch on a picture of 16 x 16 pixels."""
    scene = with_factor(few_patches(torus(100, 1, (16, 16)), 1), 1)
    seconds = best_seconds(lambda: simulate(scene, BASELINE, threads=threads), repeats * 5)
    return Stage("fixed cost", seconds * 1e9, "frame", threads)


def measure_stages(size: tuple[int, int], threads: int, quick: bool, patches: int = PATCHES) -> list[Stage]:
    """The stage table. size : of the picture. threads : most that are used; all stages are timed on one thread too."""
    repeats = 2 if quick else 5
    rows = []
    for factor in (16,) if quick else (8, 16, 32):
        scene = torus(patches, factor, size)
        for n in dict.fromkeys((1, threads)) if factor == 16 else (1,):
            rows += frame_stages(*timed_frame(scene, BASELINE, n, repeats), n, f"factor {factor}")
            rows.append(at_once(scene, n, repeats, f"factor {factor}"))
    rows += tile_loop_stages(torus(patches, 16, size), 1, 1 if quick else 3)
    rows += hull_stages(torus(patches, 16, size), repeats)
    return [*rows, *(fixed_cost(n, repeats) for n in dict.fromkeys((1, threads)))]
