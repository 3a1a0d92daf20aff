"""The machine: one frame, stage by stage. `render_frame` is the table of contents of the whole simulator."""

import time
from collections.abc import Callable

import numpy as np

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.tessellator import make_patterns
from pipeline.types import I32, I64, Viewport
from tiler import back_end, front_end, verify
from tiler.back_end import NO_ORDER
from tiler.blame import Witness
from tiler.blame_watch import Watch
from tiler.coarse_z import build
from tiler.config import Machine
from tiler.domain_cache import vertex_misses
from tiler.frame import Frame
from tiler.front_end import Geometry
from tiler.grid import make_grid
from tiler.history import History, no_history, seen_patches
from tiler.host import Host
from tiler.onlooker import Onlooker
from tiler.order import number_triangles
from tiler.phases import UnitTests, first_phase, second_phase
from tiler.queue_memory import QueueMemory, describe_items, make_queue_memory
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene
from tiler.subpatch import split_patches
from tiler.tally import Tally
from tiler.tile import Target
from tiler.units import Units, front_to_back, whole_patches


def render_frame(
    scene: Scene,
    machine: Machine,
    number: float,
    host: Host,
    progress: Callable[[float], None],
    onlooker: Onlooker | None = None,
) -> Frame:
    """One frame; arguments as in `tiler.simulate`, already checked. onlooker : sees it being drawn."""
    start = time.perf_counter()
    history = last_frame(scene, machine, number, host) if machine.phased else None
    tally = Tally(scene, machine, make_grid(scene.picture.width, scene.picture.height, machine.tile))
    memory = make_queue_memory(machine, tally.grid, scene.picture.samples)
    witness = None
    if machine.blame:
        watch = Watch(
            tally.grid, scene.picture.samples, machine.coarse_z_block, machine.binning != "triangle", machine.reordered
        )
        witness = Witness(watch, machine.binning, tally.walk)
    target = draw_frame(
        scene, machine, number, host, history, tally, memory, progress, machine.blame or onlooker is not None, witness,
        onlooker,
    )  # fmt: skip
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
        blame=witness.blame if witness else None,
    )


def last_frame(scene: Scene, machine: Machine, number: float, host: Host) -> History:
    """What the frame before `number` leaves: drawn for this purpose, so that no frame depends on what was drawn before."""
    picture = scene.picture
    if number < 1:
        return no_history(picture.width, picture.height, picture.samples, scene.num_patches)
    plain = Machine(tile=machine.tile, bounds=machine.bounds, cull=machine.hull_cull)
    tally = Tally(scene, plain, make_grid(picture.width, picture.height, plain.tile))
    memory = make_queue_memory(plain, tally.grid, picture.samples)
    target = draw_frame(scene, plain, number - 1, host, None, tally, memory, lambda part: None, keep_order=True)
    return History(target.depth, seen_patches(target.order, scene.num_patches))


def draw_frame(
    scene: Scene,
    machine: Machine,
    number: float,
    host: Host,
    history: History | None,
    tally: Tally,
    memory: QueueMemory,
    progress: Callable[[float], None],
    keep_order: bool = False,
    witness: Witness | None = None,
    onlooker: Onlooker | None = None,
) -> Target:
    """Draw a frame, stage by stage, and count in `tally` and `memory`.

    history : for a machine that draws in two phases. keep_order : keep the submit number of what each sample shows.
    witness : notes what blame needs, onlooker : sees the batches; for both submit numbers must be kept.
    """
    width, height = scene.picture.width, scene.picture.height
    camera = camera_at(scene.camera, number, width / height)
    viewport = Viewport(0, 0, width, height, 0.0, 1.0)
    grid = tally.grid
    target = back_end.make_target(scene.picture, machine.reordered or keep_order)
    coarse = back_end.make_coarse_z(machine, grid)
    packed = front_end.scene_maps(scene, number)

    # Per patch: vertex shader, hull shader, tessellator.
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    stage = front_end.raise_silhouettes(scene, stage)
    flags = hull.flag_nonfinite(patches, stage.pyramids.whole)
    bounds = BOUNDS[machine.bounds](stage)
    hull.run_cull_tests(machine.hull_cull, stage, bounds, flags)
    hull.drop_culled(stage.factors, flags)
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    hull.flag_factors(patterns.of_patch, flags)
    live = hull.live_patches(flags)
    tally.count_patches(patches, flags, patterns, live)
    if machine.binning == "subpatch":
        split = split_patches(stage, bounds, patterns, live, machine)
        units, live = split.units, split.live
        tally.count_split(split)
    else:
        units = whole_patches(patches, bounds, patterns)
    if machine.queue_order == "front_to_back":
        live = front_to_back(live, units.bounds)

    # Per triangle and per tile: domain shader, primitives, binning, tile loop; a batch of units after the other.
    tests = UnitTests()
    now, waiting = first_phase(machine, units, live, grid, history, tests)
    for phase in range(2 if machine.phased else 1):
        if phase == 1:
            memory.drain()
            build(coarse, target.depth)
            now = second_phase(machine, units, waiting, coarse, tests)
        rules = back_end.make_rules(machine, phase)
        last_phase = phase == 1 or not machine.phased
        batches = front_end.split_batches(now, units.patterns)
        for b, batch in enumerate(batches):
            points = front_end.shade_domain_points(batch, units.patches, units.patterns, packed.maps, camera, host)
            geometry = front_end.set_up_triangles(batch, points, units.patterns, viewport, scene, host)
            order = _submit_numbers(batch, units, geometry, target)
            bins = back_end.bin_batch(batch, geometry, units.bounds, machine, grid, scene.picture.samples, host)
            tally.count_batch(units, batch, geometry, bins.queue)
            if witness:
                witness.note_front_end(batch, geometry)
            items = describe_items(machine.binning, units.owner[batch], geometry.triangles, len(geometry.window.x))
            passes = back_end.cut_bins(bins, memory.append(bins.queue, items))
            for k, part in enumerate(passes):
                outcome = back_end.run_tiles(
                    part, batch, geometry, order, units.bounds, rules, scene, grid, target, coarse, tally.tiles,
                    phase == b == k == 0, last_phase and b == len(batches) - 1 and k == len(passes) - 1, host,
                )  # fmt: skip
                number_of_pass = memory.passes - (len(passes) - 1 - k)
                tally.count_entries(batch, part.queue, outcome, number_of_pass)
                if onlooker:
                    onlooker.see(number_of_pass, phase, part, batch, units, geometry, order)
                if witness:
                    tested = rules.pairs or _tests_first(machine)
                    witness.watch.draw(number_of_pass, part, batch, units, geometry, order, tested, host)
            progress((b + 1) / len(batches) if last_phase else 0.5 * (b + 1) / len(batches))
    tally.count_units(units, tests)
    if witness:
        misses = vertex_misses(units.patterns, machine.vertex_cache)
        witness.testify(units, patterns, tally.shaded, np.append(misses, 0)[units.patterns.of_patch])
    if onlooker:
        onlooker.end(units, tally.shaded, target)
    return target


def _tests_first(machine: Machine) -> bool:
    """Whether units of the first phase were tested too, against the last frame's pyramid."""
    return machine.z_feedback == "previous_frame" and "occlusion" in machine.occlusion


def _submit_numbers(batch: I32, units: Units, geometry: Geometry, target: Target) -> I64:
    """Submit numbers of the batch's triangles, where anything asks for them."""
    if target.order.size == 0:
        return NO_ORDER
    return number_triangles(batch, units.owner, units.original, units.patterns, geometry.triangles)
