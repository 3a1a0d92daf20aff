"""The machine: one frame, stage by stage. `render_frame` is the table of contents of the whole simulator."""

import time
from collections.abc import Callable

import numpy as np

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.types import Viewport
from tiler import back_end, compile_ahead, front_end, verify
from tiler.back_end import NO_ORDER
from tiler.blame import Witness
from tiler.blame_watch import Watch
from tiler.config import Machine
from tiler.domain_cache import vertex_misses
from tiler.frame import Frame
from tiler.grid import make_grid
from tiler.history import History, Reel, no_history, seen_patches
from tiler.host import Host
from tiler.onlooker import Onlooker
from tiler.order import number_triangles
from tiler.phases import UnitTests, first_phase, second_phase
from tiler.queue_memory import QueueMemory, describe_items, make_queue_memory
from tiler.regions import begin_to_clear, draw_frame_in_regions, draws_in_regions
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene
from tiler.shared import ALONE, Stages
from tiler.shared_tiles import Easel
from tiler.subpatch import split_patches, split_rules
from tiler.tally import Tally
from tiler.tile import Target
from tiler.units import front_to_back, whole_patches

TIGHT = "tpatch"  # a bound that takes little longer than `cbox`, and is much tighter where displacement is large


def render_frame(
    scene: Scene,
    machine: Machine,
    number: float,
    host: Host,
    progress: Callable[[float], None],
    reel: Reel | None = None,
    shared: Stages = ALONE,
    onlooker: Onlooker | None = None,
) -> Frame:
    """One frame; arguments as in `tiler.simulate`, already checked.

    reel : of the run that the frame belongs to. shared : how stages run. onlooker : sees it being drawn.
    """
    start = time.perf_counter()
    if host.threads > 1 and not draws_in_regions(machine):
        compile_ahead.begin()
    reel = reel or Reel()
    history = None
    if machine.phased:
        plain = Machine(bounds=machine.bounds, cull=machine.hull_cull)
        history = reel.find(scene, machine, number) or shared.run(last_frame, scene, plain, number, host, shared)
    tally = Tally(scene, machine, make_grid(scene.picture.width, scene.picture.height, machine.tile))
    memory = make_queue_memory(machine, tally.grid, scene.picture.samples)
    witness = None
    if machine.blame:
        watch = Watch(
            tally.grid, scene.picture.samples, machine.coarse_z_block, machine.binning != "triangle", machine.reordered,
            machine.occlusion_area == "hull",
        )  # fmt: skip
        witness = Witness(watch, machine.binning, tally.walk)
    target = draw_frame(
        scene, machine, number, host, history, tally, memory, progress, machine.blame or onlooker is not None, witness,
        shared, onlooker,
    )  # fmt: skip
    reel.keep(scene, machine, number, target)
    queues = memory.report()
    seconds = time.perf_counter() - start
    report = verify.Report((), ())
    if machine.verify:
        report = verify.check_frame(scene, machine, number, host, (target.resolved, target.depth))
    return Frame(
        scene=scene.name,
        machine=machine,
        number=number,
        color=shared.own(target.resolved),
        depth_samples=shared.own(target.depth),
        counters=tally.counters(target, queues.counters()),
        queues=tally.queues(queues),
        tiles=tally.tile_maps(),
        cores=tally.core_sums(),
        seconds=seconds,
        violations=report.violations,
        false_culls=report.false_culls,
        blame=witness.blame if witness else None,
    )


def last_frame(scene: Scene, plain: Machine, number: float, host: Host, shared: Stages = ALONE) -> History:
    """What the frame before `number` leaves: drawn for this purpose, so that no frame depends on what was drawn before.

    plain : the machine without occlusion tests.
    """
    picture = scene.picture
    if number < 1:
        return no_history(picture.width, picture.height, picture.samples, scene.num_patches)
    tally = Tally(scene, plain, make_grid(picture.width, picture.height, plain.tile))
    memory = make_queue_memory(plain, tally.grid, picture.samples)
    target = draw_frame(scene, plain, number - 1, host, None, tally, memory, lambda part: None, True, None, shared)
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
    shared: Stages = ALONE,
    onlooker: Onlooker | None = None,
) -> Target:
    """Draw a frame, stage by stage, and count in `tally` and `memory`.

    history : for a machine that draws in two phases. keep_order : keep the submit number of what each sample shows.
    witness : notes what blame needs, onlooker : sees the batches; for both submit numbers must be kept. shared : how stages
    run: `run(stage, ...)` is stage(...), or the result that another machine's frame has left.
    """
    run, picture = shared.run, scene.picture
    viewport = Viewport(0, 0, picture.width, picture.height, 0.0, 1.0)
    grid, ordered = tally.grid, machine.reordered or keep_order
    easel = Easel(scene, grid, ordered, machine.coarse_z_block if machine.occlusion else 0, host, shared)

    # Where nothing waits in a queue for what another tile does, all is drawn patch by patch, on a picture that is clear.
    alone = shared.most_points == 0 and not keep_order and onlooker is None
    in_regions = alone and draws_in_regions(machine) and memory.order_decides_nothing
    cleared = begin_to_clear(easel.canvas.target, picture.background, host) if in_regions else None

    # Per patch: vertex shader, hull shader, tessellator.
    camera = run(camera_at, scene.camera, number, picture.width / picture.height)
    packed = run(front_end.scene_maps, scene, number)
    patches = run(front_end.run_vertex_shader, scene, number)
    factors = run(front_end.tess_factors, scene.tessellation, patches, camera, viewport)
    stage = run(front_end.hull_input, scene, patches, packed, factors, camera, viewport)
    stage = run(front_end.raise_silhouettes, scene, stage)
    flags = broken = run(hull.flag_nonfinite, patches, stage.pyramids.whole)
    bounds = run(BOUNDS[machine.bounds], stage)
    for name in machine.hull_cull:
        flags = shared.same(run(front_end.cull, name, stage, bounds, flags, host))
    dropped = broken if shared.most_points else flags
    patterns = run(front_end.tessellate, scene.tessellation, stage.factors, dropped)
    flags, live = front_end.live_patches(patterns, flags)
    live = shared.same(live)
    tally.count_patches(patches, flags, patterns, live)
    at_once = None
    if machine.binning == "subpatch":
        split = run(split_patches, stage, bounds, patterns, live, split_rules(machine))
        units, live = split.units, split.live
        tally.count_split(split)
    else:
        units = run(whole_patches, patches, bounds, patterns)
        at_once = run(front_end.patches_at_once, patterns, shared.most_points)
    if machine.queue_order == "front_to_back":
        live = shared.same(front_to_back(live, units.bounds))

    # Patch by patch, all that follows at once.
    if cleared:
        tighter = None if machine.bounds == TIGHT else lambda: run(BOUNDS[TIGHT], stage).rect
        drawn = draw_frame_in_regions(
            scene, live, bounds.rect, tighter, patches, patterns, packed.maps, camera, viewport, grid, easel.canvas.target,
            cleared, tally.tiles, host, progress,
        )  # fmt: skip
        if drawn is not None:
            tally.count_drawn(units, live, drawn)
            memory.append_drawn(drawn)
            return easel.canvas.target

    # Per triangle and per tile: domain shader, primitives, binning, tile loop; a batch of units after the other.
    tests = UnitTests(viewport, machine.occlusion_area == "hull")
    now, waiting = first_phase(machine, units, live, grid, history, tests)
    for phase in range(2 if machine.phased else 1):
        if phase == 1:
            memory.drain()
            easel.build_pyramid()
            now = second_phase(machine, units, waiting, easel.canvas.coarse, tests)
        rules = back_end.make_rules(machine, phase)
        last_phase = phase == 1 or not machine.phased
        batches = front_end.split_batches(shared.same(now), units.patterns, shared.most_points)
        for b, batch in enumerate(batches):
            shaded = batch if at_once is None else at_once
            points = run(
                front_end.shade_domain_points, shaded, units.patches, units.patterns, packed.maps, camera, host
            )  # fmt: skip
            compile_ahead.wait()
            geometry = run(front_end.set_up_triangles, shaded, points, units.patterns, viewport, scene, host)
            if at_once is not None:
                geometry = run(front_end.pick_units, geometry, at_once, batch, shared)
            order = NO_ORDER
            if ordered:
                order = run(
                    number_triangles, batch, units.owner, units.original, units.patterns, geometry.triangles
                )  # fmt: skip
            by_triangle = run(
                back_end.bin_drawn, geometry.drawn, geometry.window, machine.overlap, grid, picture.samples, host
            )  # fmt: skip
            queue = by_triangle
            if machine.binning != "triangle":
                queue = run(back_end.bin_units, batch, units.bounds, machine.overlap, grid, host)
            bins = back_end.Bins(queue, by_triangle)
            tally.count_batch(units, batch, geometry, queue)
            if witness:
                witness.note_front_end(batch, geometry)
            items = describe_items(machine.binning, machine.overlap, units.owner[batch], geometry)
            passes = back_end.cut_bins(bins, memory.append(queue, items))
            for k, part in enumerate(passes):
                last = last_phase and b == len(batches) - 1 and k == len(passes) - 1
                whole = len(batches) == len(passes) == 1
                outcome = easel.draw(part, batch, geometry, order, units.bounds, rules, tally.tiles, last, whole)
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
        onlooker.end(units, tally.shaded, easel.canvas.target)
    return easel.canvas.target


def _tests_first(machine: Machine) -> bool:
    """Whether units of the first phase were tested too, against the last frame's pyramid."""
    return machine.z_feedback == "previous_frame" and "occlusion" in machine.occlusion
