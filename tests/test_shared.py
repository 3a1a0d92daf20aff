"""Machines that share stages: each frame is the one that it is alone, whoever came before; and what runs is less."""

from dataclasses import fields, replace

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from tests.scenes import sliced
from tiler import back_end, front_end
from tiler.config import Machine
from tiler.frame import Frame
from tiler.shared import ARRAY_BYTES, RESULT_BYTES, Shared

OCCLUSION = ("frustum", "occlusion", "occlusion:triangle")
MACHINES = (
    Machine(tile=8, binning="triangle", cull=()),
    Machine(tile=8, binning="triangle", cull=("frustum",), vertex_cache=6, blame=True),
    Machine(tile=8, binning="triangle", cull=("frustum:world", "occlusion", "occlusion:block"), bounds="tpatch"),
    Machine(tile=8, binning="triangle", queue_pool=2_000, queue_policy="flush"),
    Machine(tile=8, binning="patch", cull=()),
    Machine(tile=8, binning="patch", domain_cache="lru:3", cores=2, tile_walk="hilbert"),
    Machine(tile=8, binning="patch", domain_cache="frame", blame=True),
    Machine(tile=32, binning="patch", bounds="tpatch", overlap="exact", verify=True),
    Machine(tile=32, binning="patch", cull=("frustum", "backface:tessellation_safe")),
    Machine(tile=32, binning="patch", cull=("frustum", "backface:ncone"), verify=True),
    Machine(tile=32, binning="patch", queue_order="front_to_back", overlap="exact"),
    Machine(tile=8, binning="patch", cull=OCCLUSION),
    Machine(tile=8, binning="patch", cull=OCCLUSION, domain_cache="frame", tile_walk="morton"),
    Machine(tile=8, binning="patch", cull=OCCLUSION, blame=True, verify=True),
    Machine(tile=8, binning="patch", cull=OCCLUSION, queue_order="front_to_back"),
    Machine(tile=8, binning="patch", cull=("occlusion:block",), coarse_z_update="feed_forward", coarse_z_block=4),
    Machine(tile=32, binning="patch", cull=OCCLUSION, z_feedback="two_phase"),
    Machine(tile=32, binning="patch", cull=OCCLUSION, z_feedback="two_phase", domain_cache="lru:5"),
    Machine(tile=32, binning="patch", cull=OCCLUSION, z_feedback="previous_frame", blame=True),
    Machine(tile=32, binning="patch", cull=OCCLUSION, z_feedback="none"),
    Machine(tile=16, binning="patch", queue_pool=1_000, queue_policy="flush", blame=True),
    Machine(tile=16, binning="subpatch", subpatch_extent=6.0),
    Machine(tile=16, binning="subpatch", subpatch_extent=6.0, domain_cache="frame", overlap="exact"),
    Machine(tile=16, binning="subpatch", subpatch_extent=6.0, cull=OCCLUSION, bounds="tpatch", blame=True, verify=True),
    Machine(tile=16, binning="subpatch", subpatch_extent=6.0, cull=OCCLUSION, z_feedback="previous_frame"),
    Machine(tile=16, binning="subpatch", subpatch_extent=9.0, subpatch_budget=4, queue_order="front_to_back"),
)


def views(load) -> list[tuple[tiler.Scene, float]]:
    """Two scenes: one cut by the frustum on all sides, four samples; one displaced, that moves, with its last frame."""
    return [
        (sliced(load("teapot", size=(70, 45), factor=4, samples=4)), 0),
        (load("creature_small", size=(70, 45), factor=3), 3),
    ]


def assert_same(frame: Frame, alone: Frame) -> None:
    """All that a frame says but the time that it took."""
    for field in fields(Frame):
        if field.name != "seconds":
            assert_equal(getattr(frame, field.name), getattr(alone, field.name), f"{alone.machine}: {field.name}")


def assert_equal(value: object, expected: object, what: str) -> None:
    if isinstance(expected, np.ndarray):
        assert value.dtype == expected.dtype and value.tobytes() == expected.tobytes(), what
    elif hasattr(expected, "__dataclass_fields__"):
        for name in expected.__dataclass_fields__:
            assert_equal(getattr(value, name), getattr(expected, name), f"{what}.{name}")
    elif isinstance(expected, dict) or hasattr(expected, "keys"):
        assert list(value) == list(expected), what
        for name in expected:
            assert_equal(value[name], expected[name], f"{what}[{name}]")
    else:
        assert value == expected or (value != value and expected != expected), f"{what}: {value}, alone {expected}"


@pytest.fixture(scope="module")
def alone(load) -> list[list[Frame]]:
    """Each machine's frame of each view, by itself."""
    return [[tiler.simulate(scene, m, frame=number, threads=1) for m in MACHINES] for scene, number in views(load)]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("order", ["as listed", "backwards", "shuffled", "twice"])
def test_shared_stages_change_no_bit(order, threads, load, alone):
    places = list(range(len(MACHINES)))
    if order == "backwards":
        places.reverse()
    elif order == "shuffled":
        np.random.default_rng(7).shuffle(places)
    elif order == "twice":
        places = [p for p in places for _ in range(2)]
    shared = Shared()  # the same one for both scenes, too
    for v, (scene, number) in enumerate(views(load)):
        for p in places:
            assert_same(tiler.simulate(scene, MACHINES[p], frame=number, threads=threads, shared=shared), alone[v][p])
    assert shared.hits > 10 * len(MACHINES)


@pytest.mark.parametrize("most_bytes", [0, 100_000, 400_000, 1_500_000, 6_000_000])
def test_memory_is_bounded_and_changes_no_bit(most_bytes, load, alone, monkeypatch):
    monkeypatch.setattr(front_end, "BATCH_POINTS", 500)  # where points are not worth keeping, several batches
    shared = Shared(most_bytes)
    for v, (scene, number) in enumerate(views(load)):
        for machine, expected in zip(MACHINES, alone[v], strict=True):
            assert_same(tiler.simulate(scene, machine, frame=number, threads=1, shared=shared), expected)
            memory = held_memory(shared)
            objects = ARRAY_BYTES * len(memory) + RESULT_BYTES * len(shared._kept)
            assert sum(memory.values()) + objects == shared.held_bytes <= most_bytes
    assert most_bytes == 0 or shared.held_bytes > 0.3 * most_bytes


def held_memory(shared: Shared) -> dict[int, int]:
    """Bytes of each array that owns memory held by results and their arguments, found by walking them."""
    found: dict[int, int] = {}
    todo: list[object] = [(kept.arguments, kept.result) for kept in shared._kept.values()]
    while todo:
        value = todo.pop()
        if isinstance(value, tuple):
            todo.extend(value)
        elif isinstance(value, np.ndarray):
            owner = value if value.base is None else value.base
            found[id(owner)] = owner.nbytes
    return found


@pytest.fixture
def runs(monkeypatch) -> dict[str, int]:
    """How often stages ran."""
    counts: dict[str, int] = {}

    def count(module, name):
        stage = getattr(module, name)
        counts[name] = 0

        def counted(*arguments):
            counts[name] += 1
            return stage(*arguments)

        monkeypatch.setattr(module, name, counted)

    for name in ("run_vertex_shader", "shade_domain_points", "set_up_triangles"):
        count(front_end, name)
    for name in ("bin_drawn", "run_tiles"):
        count(back_end, name)
    return counts


def test_what_machines_have_in_common_runs_once(load, runs):
    scene, shared = sliced(load("teapot", size=(70, 45), factor=4)), Shared()

    def ran(**settings: object) -> dict[str, int]:
        before = dict(runs)
        tiler.simulate(scene, Machine(**({"tile": 16} | settings)), threads=1, shared=shared)
        return {name: runs[name] - before[name] for name in runs if runs[name] > before[name]}

    first = {"run_vertex_shader": 1, "shade_domain_points": 1, "set_up_triangles": 1, "bin_drawn": 1, "run_tiles": 1}
    assert ran(cull=()) == first
    for cache in ("lru:3", "frame"):
        assert ran(cull=(), domain_cache=cache) == {}
    assert ran(cull=(), cores=7, tile_walk="hilbert", queue_model="blocks64") == {}
    assert ran(binning="triangle", cull=()) == {}, "patches and triangles in submit order draw alike"
    assert ran(cull=("frustum",), bounds="tpatch") == {}, "what a frustum test drops has no triangle"
    assert ran(tile=32) == {"bin_drawn": 1, "run_tiles": 1}
    assert ran(cull=("frustum", "occlusion")) == {"run_tiles": 1}
    assert ran(cull=("frustum", "occlusion"), domain_cache="frame") == {}
    assert ran(cull=("frustum", "occlusion"), queue_order="front_to_back") == {"bin_drawn": 1, "run_tiles": 1}


def test_scenes_and_frames_are_told_apart(load):
    shared = Shared()
    scene = load("creature_small", size=(70, 45), factor=2)
    other = replace(scene, tessellation=replace(scene.tessellation, factor=(3.0,) * 6))
    for number in (0, 2, 0):
        for drawn in (scene, other):
            expected = tiler.simulate(drawn, frame=number, threads=1)
            assert_same(tiler.simulate(drawn, frame=number, threads=1, shared=shared), expected)


def test_a_bound_that_is_too_tight_still_shows(load, monkeypatch):
    """A patch machine may be drawn as a triangle machine only if its queues hold all units; else the tile lacks them."""
    scene, bound = load("teapot", size=(104, 60), factor=5), BOUNDS["cbox"]

    def too_tight(*arguments):
        bounds = bound(*arguments)
        bounds.rect[:, 2] = np.maximum(bounds.rect[:, 2] - 8, bounds.rect[:, 0])
        return bounds

    monkeypatch.setitem(BOUNDS, "cbox", too_tight)
    shared, machine = Shared(), Machine(tile=8)
    right = tiler.simulate(scene, Machine(tile=8, binning="triangle"), shared=shared)
    wrong = tiler.simulate(scene, machine, shared=shared)
    assert (wrong.color != right.color).any()
    assert_same(wrong, tiler.simulate(scene, machine))


def test_frames_do_not_share_memory_that_users_get(load):
    scene, shared, machine = load("teapot", size=(70, 45), factor=2), Shared(), Machine()
    first = tiler.simulate(scene, machine, shared=shared)
    kept = first.color.copy(), first.depth_samples.copy()
    first.color[...] = 7
    first.depth_samples[...] = 0.5
    again = tiler.simulate(scene, machine, shared=shared)
    assert np.array_equal(again.color, kept[0]) and np.array_equal(again.depth_samples, kept[1])
