"""Measures what docs/decisions/host-threads.md states: a parallel loop of Numba's against plain threads over a kernel.

Run it from the repository's root: `python docs/decisions/measure_host_threads.py`.
"""

import time

import numpy as np
from numba import njit, prange

import tiler
from pipeline import domain
from pipeline.jit import announcer
from pipeline.tessellator import make_patterns
from pipeline.types import DomainPoints
from tiler import front_end
from tiler.host import Host
from tiler.scene.camera import camera_at


@njit(parallel=True, error_model="numpy")
def drive(n, live, patches, patterns, maps, matrix, points, scratch):
    """The domain stage as a parallel loop over n chunks."""
    for c in prange(n):
        begin, end = len(live) * c // n, len(live) * (c + 1) // n
        domain.shade_patches(begin, end, live, patches, patterns, maps, matrix, points, scratch[c])


def best_of(work, times=20):
    """Least seconds of several runs."""
    seconds = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def main():
    """Print the figures."""
    scene = tiler.load_scene("waves")
    camera = camera_at(scene.camera, 0, 16 / 9)
    maps, patches = front_end.scene_maps(scene, 0).maps, front_end.run_vertex_shader(scene, 0)
    live = np.arange(scene.num_patches, dtype=np.int32)
    factors = front_end.hull.fixed_factors(scene.num_patches, scene.tessellation.factor)
    patterns = make_patterns(factors, "integer", front_end.WINDING)
    with Host(2) as host:
        points = front_end.shade_domain_points(live, patches, patterns, maps, camera, host)
        host_ms = best_of(lambda: front_end.shade_domain_points(live, patches, patterns, maps, camera, host)) * 1e3
        overhead = best_of(lambda: host.run(lambda c: None, 16), 200) * 1e6
    scratch = np.empty((16, domain.SCRATCH), np.float32)
    target = DomainPoints(points.first, np.empty_like(points.clip), np.empty_like(points.normal))
    arguments = (16, live, patches, patterns, maps, camera.clip_from_world, target, scratch)
    before = announcer.compiled
    start = time.perf_counter()
    drive(*arguments)
    compiling = time.perf_counter() - start
    same = np.array_equal(target.clip, points.clip)
    print(
        f"threads over the kernel : {host_ms:.1f} ms, {overhead:.0f} us to hand out 16 chunks, nothing more to compile"
    )
    print(f"parallel loop over it   : {best_of(lambda: drive(*arguments)) * 1e3:.1f} ms, {compiling:.1f} s to compile")
    print(f"same bits: {same}; functions compiled for the loop: {announcer.compiled - before}")


if __name__ == "__main__":
    main()
