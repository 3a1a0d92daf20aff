"""Bad and extreme input to `Machine` and `simulate`: one clear error, or a picture without the broken patches; no crash."""

import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import tiler
from tests.scenes import flat_patch, looking_along_y, patch_scene
from tiler import back_end, memory, placement
from tiler import host as host_module
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.host import CHUNKS_PER_THREAD, Host
from tiler.scene.model import DisplacementMap, Picture, Scene, Tessellation
from tiler.tile import NUM_TILE_COUNTS

BOTH = (Machine(tile=8, binning="triangle"), Machine(tile=8, binning="patch"))
VALUES = (np.nan, np.inf, -np.inf)
MAP = DisplacementMap(np.array([[0.0, 0.2], [0.1, 0.3]], np.float32))


@pytest.fixture
def small() -> Scene:
    """Two displaced patches beside each other."""
    return patch_scene([flat_patch(-1, -0.5, 0, 0.5), flat_patch(0, -0.5, 1, 0.5)], displacement=MAP)


# The machine.


@pytest.mark.parametrize(
    "fields, said",
    [
        ({"tiles": 32}, ["machine.tiles", "unknown field", "did you mean 'tile'?"]),
        ({"banana": 1}, ["machine.banana", "unknown field", "allowed: tile, binning"]),
        ({"tile": 33}, ["machine.tile", "33", "power of two"]),
        ({"tile": 0}, ["machine.tile", "0", "power of two"]),
        ({"tile": -8}, ["machine.tile", "-8", "power of two"]),
        ({"tile": 4}, ["machine.tile", "4", "power of two, 8"]),
        ({"tile": 1024}, ["machine.tile", "1024", "512"]),
        ({"tile": "32"}, ["machine.tile", "'32'", "integer"]),
        ({"tile": 32.0}, ["machine.tile", "32.0", "integer"]),
        ({"tile": True}, ["machine.tile", "True", "integer"]),
        ({"tile": None}, ["machine.tile", "None", "integer"]),
        ({"bounds": "cboxes"}, ["machine.bounds", "'cboxes'", "did you mean 'cbox'?"]),
        ({"bounds": ""}, ["machine.bounds", "allowed: cbox"]),
        ({"bounds": 3}, ["machine.bounds", "3", "string"]),
        ({"cull": ("frustrum",)}, ["machine.cull", "frustrum", "did you mean 'frustum'?"]),
        ({"cull": ("frustum", "frustum")}, ["machine.cull", "named twice"]),
        ({"cull": ["frustum", "frustum"]}, ["machine.cull", "named twice"]),
        ({"cull": "frustum"}, ["machine.cull", "'frustum'", "tuple"]),
        ({"cull": (1,)}, ["machine.cull", "1", "string"]),
        ({"binning": "triangles"}, ["machine.binning", "'triangles'", "'triangle', 'patch' or 'subpatch'"]),
        ({"binning": None}, ["machine.binning", "None", "allowed"]),
        ({"domain_cache": "lru"}, ["machine.domain_cache", "'lru'", "'none', 'frame' or 'lru:N'"]),
        ({"domain_cache": "lru:0"}, ["machine.domain_cache", "'lru:0'", "N from 1 to"]),
        ({"domain_cache": "lru:-4"}, ["machine.domain_cache", "'lru:-4'", "N from 1 to"]),
        ({"domain_cache": "lru:99999999999"}, ["machine.domain_cache", "N from 1 to 1048576"]),
        ({"vertex_cache": -1}, ["machine.vertex_cache", "-1", "0 to 4096"]),
        ({"coarse_z_block": 12}, ["machine.coarse_z_block", "12", "power of two"]),
        ({"coarse_z_block": 16, "tile": 8}, ["machine.coarse_z_block", "16", "at most the side of a tile, 8"]),
        ({"coarse_z_update": "lazy"}, ["machine.coarse_z_update", "'lazy'", "'recompute' or 'feed_forward'"]),
        ({"z_feedback": "next_frame"}, ["machine.z_feedback", "'next_frame'", "'two_phase'"]),
        ({"occlusion_area": "box"}, ["machine.occlusion_area", "'box'", "'rect' or 'hull'"]),
        ({"queue_order": "back"}, ["machine.queue_order", "'back'", "'submit' or 'front_to_back'"]),
        ({"overlap": "hull"}, ["machine.overlap", "'hull'", "'rect' or 'exact'"]),
        ({"tile_walk": "peano"}, ["machine.tile_walk", "'peano'", "'hilbert'"]),
        ({"subpatch_budget": 0}, ["machine.subpatch_budget", "0", "1 to 4096"]),
        ({"subpatch_extent": 0.5}, ["machine.subpatch_extent", "0.5", "1 to 65536"]),
        ({"subpatch_extent": float("nan")}, ["machine.subpatch_extent", "nan", "1 to 65536"]),
        ({"cull": ("occlusions",)}, ["machine.cull", "occlusions", "did you mean 'occlusion'?"]),
        (
            {"binning": "triangle", "queue_order": "front_to_back"},
            ["machine.queue_order", "allowed with binning='triangle'"],
        ),
        (
            {"binning": "triangle", "cull": ("occlusion",), "z_feedback": "two_phase"},
            ["machine.z_feedback", "'two_phase'", "allowed with binning='triangle'"],
        ),
        ({"cores": 0}, ["machine.cores", "0", "1 to 65536"]),
        ({"cores": -1}, ["machine.cores", "-1", "1 to 65536"]),
        ({"cores": 65537}, ["machine.cores", "65537"]),
        ({"cores": 2.5}, ["machine.cores", "2.5", "integer"]),
    ],
    ids=str,
)
def test_bad_machine_is_named(fields, said):
    with pytest.raises(TilerError) as caught:
        Machine(**fields)
    message = str(caught.value)
    for words in said:
        assert words in message, message
    assert "\n" not in message and "http" not in message, message


def test_all_problems_at_once():
    with pytest.raises(TilerError) as caught:
        Machine(tile=5, binning="x", cores=0, tyle=8)
    assert sorted(line.split(":")[0] for line in str(caught.value).splitlines()) == [
        "machine.binning", "machine.cores", "machine.tile", "machine.tyle",
    ]  # fmt: skip


def test_machine_is_frozen_and_a_key():
    machine = Machine(tile=8, cull=["frustum"])
    assert machine.cull == ("frustum",)
    assert {machine: 1}[Machine(tile=8)] == 1 and machine != Machine(tile=16)
    with pytest.raises(ValueError, match="frozen"):
        machine.tile = 16
    assert machine.tile == 8


# Arguments of simulate.


@pytest.mark.parametrize(
    "arguments, said",
    [
        ({"scene": "teapot"}, "scene: 'teapot' is not allowed"),
        ({"scene": None}, "scene: None is not allowed"),
        ({"machine": "patch"}, "machine: 'patch' is not allowed"),
        ({"machine": {"tile": 8}}, "machine: {'tile': 8} is not allowed"),
        ({"threads": 0}, "threads: 0 is not allowed; allowed: 1 to 1024"),
        ({"threads": -2}, "threads: -2 is not allowed"),
        ({"threads": 1025}, "threads: 1025 is not allowed"),
        ({"threads": 1.0}, "threads: 1.0 is not allowed"),
        ({"threads": "2"}, "threads: '2' is not allowed"),
        ({"frame": float("nan")}, "frame: nan is not allowed"),
        ({"frame": float("inf")}, "frame: inf is not allowed"),
        ({"frame": "1"}, "frame: '1' is not allowed"),
        ({"frame": None}, "frame: None is not allowed"),
    ],
    ids=str,
)
def test_bad_argument_is_named(arguments, said, small):
    with pytest.raises(TilerError) as caught:
        tiler.simulate(**({"scene": small} | arguments))
    assert said in str(caught.value)


def test_a_frame_of_any_size_or_fraction_is_fine(small):
    reference = tiler.simulate(small)
    for frame in (-5, 0.25, 1e300, np.float64(3), np.int64(2), True):
        assert np.array_equal(tiler.simulate(small, frame=frame).color, reference.color)


def test_more_threads_than_work_is_fine(small):
    assert np.array_equal(tiler.simulate(small, threads=64).color, tiler.simulate(small, threads=1).color)


def test_camera_without_a_view_is_named(small):
    for camera in (
        replace(small.camera, up=(0.0, 1.0, 0.0)),
        replace(small.camera, keys=(replace(small.camera.keys[0], eye=(0.0, 0.0, 0.0)),)),
        replace(small.camera, keys=(replace(small.camera.keys[0], eye=(np.nan, 0.0, 0.0)),)),
    ):
        with pytest.raises(TilerError, match="camera"):
            tiler.simulate(replace(small, camera=camera))


# Memory.


def test_picture_larger_than_memory_is_refused_before_allocation(small, monkeypatch):
    def must_not_run(picture: Picture) -> None:
        raise AssertionError("the render target was about to be allocated")

    monkeypatch.setattr(back_end, "make_target", must_not_run)
    monkeypatch.setattr(memory, "available_bytes", lambda: 10_000_000)
    threads = threading.active_count()
    tracemalloc.start()
    try:
        with pytest.raises(
            TilerError, match=r"picture: 2000 x 1000 with 4 sample.* takes 0\.1 GB; allowed: .* 0\.0 GB"
        ):
            tiler.simulate(replace(small, picture=Picture(2000, 1000, 4)))
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
    assert threading.active_count() == threads


def test_memory_limit_is_where_it_should_be(small, monkeypatch):
    """12 bytes a sample, 8 more with submit numbers, and 4 a pixel where samples are resolved; beside that the tiles'."""
    for samples, ordered, pixel in ((1, False, 12), (4, False, 52), (1, True, 20), (4, True, 84)):
        machine = Machine(queue_order="front_to_back" if ordered else "submit")
        scene = replace(small, picture=replace(small.picture, samples=samples))
        tables = 2 * 1 * 8 * (2 * NUM_TILE_COUNTS + 3 * CHUNKS_PER_THREAD)
        needed = 40 * 24 * pixel + tables
        monkeypatch.setattr(memory, "available_bytes", lambda needed=needed: needed)
        target = back_end.make_target(scene.picture, ordered)
        shared = 0 if samples > 1 else target.resolved.nbytes  # a view of `color`
        assert sum(a.nbytes for a in target) - shared == needed - tables
        tiler.simulate(scene, machine, threads=1)
        monkeypatch.setattr(memory, "available_bytes", lambda needed=needed: needed - 1)
        with pytest.raises(TilerError, match="picture"):
            tiler.simulate(scene, machine, threads=1)


def test_absurd_picture_is_refused_on_any_machine(small):
    with pytest.raises(TilerError, match="picture"):
        tiler.simulate(replace(small, picture=Picture(10**9, 10**9, 4)))


def test_available_memory_is_a_sane_number():
    assert 1 << 20 < memory.available_bytes() < 1 << 50


# NaN, infinity, and numbers that overflow on the way.


def plant(array: np.ndarray, place: tuple[int, ...], value: float) -> np.ndarray:
    changed = array.copy()
    changed[place] = value
    return changed


def lone_second_patch(scene: Scene) -> Scene:
    """The scene with its first patch moved out of view."""
    points = scene.control_points.copy()
    points[0, ..., 0] += 1000 * points[0, ..., 3]
    return replace(scene, control_points=points)


def assert_first_patch_is_dropped(broken: Scene, whole: Scene) -> None:
    reference = tiler.simulate(lone_second_patch(whole))
    assert reference.counters["om_samples_visible"] > 0
    for machine in BOTH:
        frame = tiler.simulate(broken, machine, threads=2)
        assert frame.counters["hs_culled_nonfinite"] == 1
        assert frame.counters["ts_patches"] == 1
        assert np.array_equal(frame.color, reference.color)
        assert np.array_equal(frame.depth_samples, reference.depth_samples)


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("place", [(0, 0, 0, 0), (0, 3, 3, 1), (0, 1, 2, 2), (0, 2, 1, 3)])
def test_nonfinite_control_point_drops_its_patch(place, value, small):
    assert_first_patch_is_dropped(replace(small, control_points=plant(small.control_points, place, value)), small)


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("place", [(0, 0, 0), (0, 3, 1)])
def test_nonfinite_texture_coordinate_drops_its_patch(place, value, small):
    assert_first_patch_is_dropped(replace(small, texcoords=plant(small.texcoords, place, value)), small)


def test_nonfinite_texture_coordinate_of_a_smooth_patch_does_not_matter(small):
    smooth = replace(small, map_id=np.full_like(small.map_id, -1))
    broken = replace(smooth, texcoords=plant(smooth.texcoords, (0, 1, 0), np.nan))
    assert np.array_equal(tiler.simulate(broken).color, tiler.simulate(smooth).color)
    assert tiler.simulate(broken).counters["hs_culled_nonfinite"] == 0


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("what", ["texel", "scale", "bias"])
def test_nonfinite_map_drops_its_patches(what, value, small):
    broken = replace(MAP, texels=plant(MAP.texels, (1, 0), value)) if what == "texel" else replace(MAP, **{what: value})
    two_maps = replace(small, maps=(broken, MAP), map_id=np.array([0, 1], np.int32))
    assert_first_patch_is_dropped(two_maps, replace(two_maps, maps=(MAP, MAP)))


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("place", [(0, 0, 0), (0, 2, 3), (0, 1, 1)])
def test_nonfinite_transform_drops_its_patches(place, value, small):
    two = replace(small, transforms=np.repeat(small.transforms, 2, axis=0), object_id=np.array([0, 1], np.int32))
    assert_first_patch_is_dropped(replace(two, transforms=plant(two.transforms, place, value)), two)


@pytest.mark.parametrize("factor", [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30, 1e-40])
@pytest.mark.parametrize("slot", [0, 3, 5])
def test_any_tessellation_factor_gives_a_frame(slot, factor, small):
    factors = [2.0] * 6
    factors[slot] = factor
    for partitioning in ("integer", "fractional_odd"):
        frame = tiler.simulate(replace(small, tessellation=Tessellation(partitioning, tuple(factors))))
        culled = slot < 4 and not factor > 0
        assert frame.counters["ts_culled_factor"] == (2 if culled else 0)
        assert (frame.counters["om_samples_visible"] == 0) == culled


@pytest.mark.parametrize("edge_pixels", [1e-30, 1e30, np.nan, np.inf])
def test_any_edge_length_gives_a_frame(edge_pixels, small):
    frame = tiler.simulate(replace(small, tessellation=Tessellation(edge_pixels=edge_pixels, max_factor=8.0)))
    assert frame.counters["om_samples_visible"] > 0
    assert frame.counters["ts_triangles"] in (2 * 2, 2 * 128)


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("size", [1e10, 1e20, 1e30, 1e38, 3.4e38])
@pytest.mark.parametrize("what", ["x", "y", "z", "all", "one corner", "weight"])
def test_huge_control_points_never_crash(what, size, samples, small):
    """Finite in float32, infinite somewhere on the way; beside an ordinary patch that must stay."""
    points = small.control_points.copy()
    axis = {"x": 0, "y": 1, "z": 2, "weight": 3}.get(what)
    with np.errstate(over="ignore"):
        if what == "one corner":
            points[0, 0, 0, :3] = size
        elif axis is None:
            points[0, ..., :3] *= np.float32(size)
        else:
            points[0, ..., axis] = np.where(points[0, ..., axis] < 0, -size, size)
    scene = replace(small, control_points=points, face_cull="none", picture=replace(small.picture, samples=samples))
    lone = tiler.simulate(replace(lone_second_patch(small), face_cull="none", picture=scene.picture))
    frames = [tiler.simulate(scene, machine, threads=2) for machine in BOTH]
    for frame in frames:
        assert np.isfinite(frame.depth_samples).all()
        assert frame.depth_samples.min() >= 0 and frame.depth_samples.max() <= 1
        # Nothing hides more than the ordinary patch plus what the huge one covers; it is never lost.
        assert (frame.depth_samples <= lone.depth_samples).all()
    assert np.array_equal(frames[0].color, frames[1].color)
    assert np.array_equal(frames[0].depth_samples, frames[1].depth_samples)


def test_huge_displacement_never_crashes(small):
    for scale in (1e20, 1e38, -3e38):
        for texel in (1.0, 1e30, -3e38):
            huge = replace(MAP, texels=np.full((2, 2), texel, np.float32), scale=scale)
            scene = replace(small, maps=(huge,))
            a, b = (tiler.simulate(scene, machine) for machine in BOTH)
            assert np.array_equal(a.color, b.color)


def test_tiny_and_zero_control_points_never_crash(small):
    for size in (0.0, 1e-45, 1e-38, 1e-20):
        points = small.control_points.copy()
        points[0, ..., :3] *= np.float32(size)
        a, b = (tiler.simulate(replace(small, control_points=points), machine) for machine in BOTH)
        assert np.array_equal(a.color, b.color)


def test_weights_of_zero_or_below_never_crash(small):
    for weight in (0.0, -1.0, -1e-30):
        for place in ((0, slice(None), slice(None), 3), (0, 1, 1, 3)):
            scene = replace(small, control_points=plant(small.control_points, place, weight), face_cull="none")
            a, b = (tiler.simulate(scene, machine) for machine in BOTH)
            assert np.array_equal(a.color, b.color)


def test_random_bits_never_crash():
    """Control points, texcoords and texels of random bits: NaN, infinities, denormals, everything."""
    rng = np.random.default_rng(5)

    def bits(*shape: int) -> np.ndarray:
        return rng.integers(0, 2**32, shape, np.uint32).view(np.float32)

    for trial in range(25):
        scene = patch_scene(
            [flat_patch(0, 0, 1, 1)] * 20, displacement=replace(MAP, texels=bits(3, 4)), face_cull="none"
        )
        points, texcoords = bits(20, 4, 4, 4), bits(20, 4, 2)
        if trial % 2:  # all finite, most of them far too large
            points = np.where(np.isfinite(points), points, np.float32(1))
            texcoords = np.where(np.isfinite(texcoords), texcoords, np.float32(1))
            points[..., 3] = np.abs(points[..., 3])
            scene = replace(scene, maps=(MAP,))
        scene = replace(scene, control_points=points, texcoords=texcoords)
        a, b = (tiler.simulate(scene, machine, threads=2) for machine in BOTH)
        assert np.array_equal(a.color, b.color), f"trial {trial}"
        assert np.array_equal(a.depth_samples, b.depth_samples), f"trial {trial}"


# Sizes at the ends.


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("machine", BOTH, ids=lambda m: m.binning)
def test_empty_scene_is_an_empty_picture(machine, samples):
    scene = patch_scene([], samples=samples)
    assert scene.num_patches == 0
    frame = tiler.simulate(scene, machine, threads=2)
    assert all(value == 0 for value in frame.counters.values())
    assert (frame.color == (*scene.picture.background, 255)).all()
    assert (frame.depth == 1).all() and frame.queues.bytes == 0 and not frame.queues.entries.any()


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (1, 40), (40, 1), (7, 8), (9, 8)])
def test_pictures_smaller_than_a_tile(size, samples):
    scene = patch_scene([flat_patch(-100, -2, 100, 2)], size=size, samples=samples)
    for tile in (8, 512):
        for binning in ("triangle", "patch"):
            frame = tiler.simulate(scene, Machine(tile=tile, binning=binning), threads=2)
            width, height = size
            assert frame.color.shape == (height, width, 4)
            assert frame.depth_samples.shape == (height, width, samples)
            assert frame.queues.entries.shape == (-(-height // tile), -(-width // tile))
            assert (frame.depth_samples < 1).all()
            assert frame.counters["om_samples_visible"] == frame.depth_samples.size


def test_face_culled_scene_of_no_triangles_is_empty():
    frame = tiler.simulate(patch_scene([flat_patch(1, -1, -1, 1)]))
    assert frame.counters["su_triangles"] == 0 and (frame.depth == 1).all()


def test_everything_behind_the_camera():
    for cull in ((), ("frustum",)):
        scene = patch_scene([flat_patch(-1, -1, 1, 1, y=-10)], camera=looking_along_y())
        frame = tiler.simulate(scene, Machine(cull=cull))
        assert frame.counters["queue_entries"] == 0 and (frame.depth == 1).all()


# Stopping.


class Stop(Exception):
    """Raised by the caller's own progress function."""


def count_threads() -> int:
    """How many threads there are, once those that wait for another host have ended: a test's own can come from nowhere else."""
    while host_module._idle:
        host_module._idle.popitem()[1].executor.shutdown()
    return threading.active_count()


@pytest.mark.parametrize("error", [Stop, KeyboardInterrupt])
@pytest.mark.parametrize("threads", [1, 2])
def test_exception_of_progress_stops_and_leaves_simulate_usable(error, threads, small, monkeypatch):
    monkeypatch.setattr("tiler.front_end.BATCH_POINTS", 1)  # a batch for each patch
    reference, before, calls = tiler.simulate(small), count_threads(), []

    def stop_at_once(part: float) -> None:
        calls.append(part)
        raise error

    with pytest.raises(error):
        tiler.simulate(small, threads=threads, progress=stop_at_once)
    assert calls == [0.5]
    assert threading.active_count() == before
    assert np.array_equal(tiler.simulate(small, threads=threads).color, reference.color)


def test_progress_reaches_one(small, monkeypatch):
    monkeypatch.setattr("tiler.front_end.BATCH_POINTS", 1)
    parts = []
    tiler.simulate(small, progress=parts.append)
    assert parts == [0.5, 1.0]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
@pytest.mark.parametrize("threads", [1, 3])
def test_exception_in_a_worker_propagates_and_ends_the_threads(error, threads):
    before, done = count_threads(), []

    def work(c: int) -> None:
        if c == 4:
            raise error("stop")
        time.sleep(0.002)
        done.append(c)

    with Host(threads) as host:
        with pytest.raises(error):
            host.run(work, 500)
        assert len(done) < 100, "the chunks after the error were worked off"
        after = []
        host.run(after.append, 20)  # usable again
        assert sorted(after) == list(range(20))
    assert threading.active_count() == before


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals cannot be sent to a thread")
def test_interrupt_of_the_main_thread_stops_the_workers():
    """Ctrl-C while the main thread waits: chunks under way end, no other begins, the threads go."""
    before, started = count_threads(), []
    interrupted = threading.Event()

    def work(c: int) -> None:
        started.append(c)
        if c == 0:
            time.sleep(0.1)  # until the main thread waits
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        interrupted.wait(5)

    began = time.perf_counter()
    with Host(2) as host:
        with pytest.raises(KeyboardInterrupt):
            host.run(work, 100)
        seconds = time.perf_counter() - began
        interrupted.set()
    assert seconds < 4, "the interrupt waited for the chunks"
    assert len(started) <= 4
    assert threading.active_count() == before


def test_interrupt_while_the_workers_are_being_started(monkeypatch):
    """Ctrl-C may come at any instruction; here after the first of the workers was started."""
    done = []

    def work(c: int) -> None:
        time.sleep(0.002)
        done.append(c)

    with pytest.raises(KeyboardInterrupt), Host(2) as host:
        submit = host._pool.executor.submit

        def submit_and_stop(worker):
            submit(worker)
            raise KeyboardInterrupt

        monkeypatch.setattr(host._pool.executor, "submit", submit_and_stop)
        host.run(work, 500)
    assert len(done) < 100, "the worker went on after the interrupt"


def test_each_chunk_runs_once_on_any_number_of_threads():
    for threads in (1, 2, 5):
        with Host(threads) as host:
            for n in (0, 1, 2, 7, 100):
                ran = []
                host.run(ran.append, n)
                assert sorted(ran) == list(range(n))
            for items in (0, 1, 3, 1000):
                chunks = host.chunks(items)
                assert [i for begin, end in chunks for i in range(begin, end)] == list(range(items))


def threads_of(host: Host, n: int) -> set[int]:
    """The threads that work on n chunks which wait for each other; by the numbers that the system gives them."""
    numbers, all_here = [], threading.Barrier(n)

    def work(c: int) -> None:
        all_here.wait(10)
        numbers.append(threading.get_native_id())

    host.run(work, n)
    assert len(numbers) == n
    return set(numbers)


def test_the_thread_that_calls_is_one_of_them():
    mine = threading.get_native_id()
    for threads in (2, 3):
        with Host(threads) as host:
            found = threads_of(host, threads)
            assert len(found) == threads and mine in found


def test_threads_wait_for_the_next_host_with_as_many():
    mine = {threading.get_native_id()}
    with Host(2) as host:
        first = threads_of(host, 2)
    with Host(2) as host, Host(2) as other:
        assert threads_of(host, 2) == first and threads_of(other, 2) & first == mine
    with Host(3), Host(2) as host:
        assert threads_of(host, 2) - mine <= {thread.native_id for thread in threading.enumerate()}


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_work_beside(threads):
    """It is done on another thread if there is one; what it returns or raises comes where it is waited for."""
    with Host(threads) as host:
        done = [host.beside(lambda k=k: (k, threading.get_native_id())) for k in range(5)]
        found = [wait() for wait in done]
        assert [k for k, _ in found] == list(range(5))
        assert all((thread == threading.get_native_id()) == (threads == 1) for _, thread in found)

        def fail():
            raise Stop

        with pytest.raises(Stop):
            host.beside(fail)()
        slow = host.beside(lambda: time.sleep(20 * host_module.AWAKE) or "slept")
        assert slow() == slow() == "slept"


def test_chunks_do_not_wait_for_work_beside():
    """The only other thread is busy; the one that calls does all of them and waits for nobody."""
    go_on = threading.Event()
    with Host(2) as host:
        wait = host.beside(lambda: go_on.wait(10))
        done = []
        host.run(done.append, 9)
        assert sorted(done) == list(range(9)) and not go_on.is_set()
        go_on.set()
        assert wait()


def test_work_beside_ends_before_the_host_does():
    begun, done = threading.Event(), []
    with pytest.raises(Stop), Host(2) as host:
        host.beside(lambda: (begun.set(), time.sleep(0.05), done.append(True)))
        assert begun.wait(10)
        raise Stop
    assert done == [True]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux lets a program choose where a thread runs")
def test_threads_keep_off_the_processor_of_the_one_that_calls(monkeypatch):
    mine = os.sched_getaffinity(0)
    assert placement.here() in mine
    count_threads()
    with Host(2) as host:
        (number,) = threads_of(host, 2) - {threading.get_native_id()}
        for cpu in sorted(mine)[:2]:
            monkeypatch.setattr(host_module, "here", lambda cpu=cpu: cpu)
            host.run(lambda c: None, 2)
            assert os.sched_getaffinity(number) == (mine - {cpu} or mine)
    assert os.sched_getaffinity(0) == mine, "where the caller may run is the caller's business"


def test_placement_does_nothing_where_it_cannot(monkeypatch):
    mine = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    placement.keep_off(-1, [threading.get_native_id()])
    placement.keep_off(1 << 20, [(1 << 30) - 1])  # no such thread
    if mine is not None:
        assert os.sched_getaffinity(0) == mine
        monkeypatch.setattr(os, "sched_getaffinity", lambda thread: {3})
        monkeypatch.setattr(os, "sched_setaffinity", lambda *arguments: pytest.fail("there is no other processor"))
        placement.keep_off(3, [threading.get_native_id()])
    monkeypatch.delattr(os, "sched_setaffinity", raising=False)
    assert placement._find_here() is None
    placement.keep_off(0, [1])
    monkeypatch.setattr(placement, "_here", None)
    assert placement.here() == -1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked")
def test_a_forked_process_has_threads_of_its_own():
    with Host(2) as host:
        host.run(lambda c: None, 2)
    program = (
        "import os, sys, warnings; warnings.simplefilter('ignore')\n"
        "from tiler.host import Host\n"
        "def draw():\n"
        "    done = []\n"
        "    with Host(2) as host: host.run(done.append, 9)\n"
        "    return len(done)\n"
        "draw()\n"
        "child = os.fork()\n"
        "if child == 0: os._exit(draw())\n"
        "sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == 0


def test_scene_arrays_are_left_alone(small):
    """`simulate` writes to none of its input: read-only arrays would do."""
    fields = {field.name: getattr(small, field.name) for field in dataclasses.fields(small)}
    before = {name: value.copy() for name, value in fields.items() if isinstance(value, np.ndarray)}
    assert len(before) == 5
    texels = MAP.texels.copy()
    for machine in BOTH:
        tiler.simulate(small, machine)
    for name, array in before.items():
        assert np.array_equal(getattr(small, name), array), name
    assert np.array_equal(MAP.texels, texels)
