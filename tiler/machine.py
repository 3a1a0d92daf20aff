"""The machine: one frame, stage by stage. `render_frame` is the table of contents of the whole simulator."""

import time
from collections.abc import Callable

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.tessellator import make_patterns
from pipeline.types import Viewport
from tiler import back_end, front_end, verify
from tiler.config import Machine
from tiler.frame import Frame
from tiler.grid import make_grid
from tiler.host import Host
from tiler.queue_memory import describe_items, make_queue_memory
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene
from tiler.tally import Tally


def render_frame(scene: Scene, machine: Machine, number: float, host: Host, progress: Callable[[float], None]) -> Frame:
    """One frame; arguments as in `tiler.simulate`, already checked."""
    start = time.perf_counter()
    width, height = scene.picture.width, scene.picture.height
    camera = camera_at(scene.camera, number, width / height)
    viewport = Viewport(0, 0, width, height, 0.0, 1.0)
    grid = make_grid(width, height, machine.tile)
    target = back_end.make_target(scene.picture)
    packed = front_end.scene_maps(scene, number)
    tally = Tally(scene, machine, grid)
    memory = make_queue_memory(machine, grid, scene.picture.samples)

    # Per patch: vertex shader, hull shader, tessellator.
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    stage = front_end.raise_silhouettes(scene, stage)
    flags = hull.flag_nonfinite(patches, stage.pyramids.whole)
    bounds = BOUNDS[machine.bounds](stage)
    hull.run_cull_tests(machine.cull, stage, bounds, flags)
    hull.drop_culled(stage.factors, flags)
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    hull.flag_factors(patterns.of_patch, flags)
    live = hull.live_patches(flags)
    tally.count_patches(patches, flags, patterns, live)

    # Per triangle and per tile: domain shader, primitives, binning, tile loop; a batch of patches after the other.
    batches = front_end.split_batches(live, patterns)
    for b, batch in enumerate(batches):
        points = front_end.shade_domain_points(batch, patches, patterns, packed.maps, camera, host)
        geometry = front_end.set_up_triangles(batch, points, patterns, viewport, scene, host)
        bins = back_end.bin_batch(batch, geometry, bounds, machine, grid, host)
        items = describe_items(machine.binning, batch, geometry.triangles, len(geometry.window.x))
        passes = back_end.cut_bins(bins, memory.append(bins.queue, items))
        for k, part in enumerate(passes):
            first, last = b == k == 0, b == len(batches) - 1 and k == len(passes) - 1
            back_end.run_tiles(part, batch, geometry, scene, machine, grid, target, tally.tiles, first, last, host)
        tally.count_batch(geometry, bins.queue)
        progress((b + 1) / len(batches))

    queues = memory.report()
    seconds = time.perf_counter() - start
    report = verify.Report((), ())
    if machine.verify:
        report = verify.check_frame(scene, machine, number, host, (target.resolved, target.depth))
    return Frame(
        scene=scene.name,
        machine=machine,
        number=number,
        color=target.resolved,
        depth_samples=target.depth,
        counters=tally.counters(target, queues.counters()),
        queues=tally.queues(queues),
        tiles=tally.tile_maps(),
        cores=tally.core_sums(),
        seconds=seconds,
        violations=report.violations,
        false_culls=report.false_culls,
    )
