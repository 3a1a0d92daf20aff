"""Rule 1 of the design: how the machine works changes what it counts, never what it draws. Compared bit for bit."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from tests.scenes import sliced
from tiler import back_end, front_end, regions
from tiler.config import Machine
from tiler.frame import Frame
from tiler.scene.model import Scene
from tiler.shared import Shared

TILES = (8, 16, 32, 64, 128)
BINNING = (("triangle", "none"), ("patch", "none"), ("patch", "frame"))
CULL = ((), ("frustum",))
THREADS = (1, 2)
SIMPLEST = Machine(tile=8, binning="triangle", cull=(), cores=1)

# What happens at a sample does not depend on the tile that it happens in.
INVARIANT = ("rs_samples_covered", "om_samples_passed", "om_samples_failed", "om_samples_visible", "ps_invocations")

SCENES = tiler.scene_names()
VIEWS = ("camera", "sliced")


@pytest.fixture
def view(load, request) -> Scene:
    name, how, samples = request.param
    factor = {"colonnade": 3, "creature": 2}.get(name, 5)
    scene = load(name, size=(104, 60), factor=factor, samples=samples)
    return sliced(scene) if how == "sliced" else scene


def on_views(*samples: int) -> pytest.MarkDecorator:
    cases = [(name, how, s) for name in SCENES for how in VIEWS for s in samples]
    return pytest.mark.parametrize("view", cases, indirect=True, ids=lambda c: f"{c[0]}-{c[1]}-{c[2]}x")


def bits(depth: np.ndarray) -> np.ndarray:
    return depth.view(np.uint32)


def assert_same_picture(frame: Frame, reference: Frame, what: object) -> None:
    color = (frame.color != reference.color).any(axis=2)
    assert not color.any(), f"{what}: {color.sum()} pixels differ, first (y, x) {np.argwhere(color)[0]}"
    depth = (bits(frame.depth_samples) != bits(reference.depth_samples)).any(axis=2)
    assert not depth.any(), f"{what}: depth of {depth.sum()} pixels differs, first (y, x) {np.argwhere(depth)[0]}"
    for name in INVARIANT:
        expected, measured = reference.counters[name], frame.counters[name]
        assert measured == expected, f"{what}: {name} expected {expected}, measured {measured}, {measured - expected:+}"


def assert_same_counters(frame: Frame, reference: Frame, what: object) -> None:
    assert dict(frame.counters) == dict(reference.counters), what
    assert np.array_equal(frame.queues.entries, reference.queues.entries), what
    assert frame.queues.bytes == reference.queues.bytes, what
    for mine, other in ((frame.tiles, reference.tiles), (frame.cores, reference.cores)):
        assert mine.keys() == other.keys()
        for name in mine:
            assert np.array_equal(mine[name], other[name]), f"{what}: {name} by tile or core"


def all_machines() -> list[Machine]:
    """Every tile size, binning, domain cache and cull set; the number of cores changes along the way."""
    return [
        Machine(tile=tile, binning=binning, domain_cache=cache, cull=cull, cores=(1, 3, 4, 64)[i % 4])
        for i, (tile, (binning, cache), cull) in enumerate(product(TILES, BINNING, CULL))
    ]


@on_views(1, 4)
def test_any_machine_draws_the_same_picture(view):
    reference = tiler.simulate(view, SIMPLEST, threads=1)
    assert reference.counters["om_samples_visible"] > 0, "an empty picture proves nothing"
    for machine in all_machines():
        one, two = (tiler.simulate(view, machine, threads=threads) for threads in THREADS)
        assert_same_picture(one, reference, machine)
        assert_same_picture(two, reference, (machine, "two threads"))
        assert_same_counters(two, one, (machine, "two threads"))


# The whole cross product of what a machine may be, as far as its fields go together. Of the back-patch tests only the one that
# is right for every triangle: the others may drop a front-facing triangle of a coarse tessellation.
CULL_SETS = (
    (),
    ("frustum", "occlusion"),
    ("occlusion", "occlusion:triangle", "occlusion:block"),
    ("frustum:world", "backface:tessellation_safe", "occlusion", "occlusion:triangle"),
    ("frustum:object", "occlusion:block"),
)
FIELDS = {  # the last runs fastest: neighbours draw alike
    "bounds": tuple(BOUNDS),
    "cull": CULL_SETS,
    "binning": ("triangle", "patch", "subpatch"),
    "tile": (8, 32, 128),
    "overlap": ("rect", "exact"),
    "z_feedback": ("none", "tile", "previous_frame", "two_phase"),
    "queue_order": ("submit", "front_to_back"),
    "occlusion_area": ("rect", "hull"),
    "coarse_z_update": ("recompute", "feed_forward"),
    "domain_cache": ("none", "lru:5", "frame"),
}
WALKS = ("scanline", "morton", "hilbert")  # what an LRU cache holds hangs on them, and nothing else does
NUM_PRODUCT = 52_992  # machines of the product
PRODUCT_FRAMES = (0, 5)  # the first of a run, which has no last frame, and one that has


def machine_of(choice: dict) -> Machine | None:
    """The machine of a choice of FIELDS; None where its fields do not go together."""
    try:
        return Machine(**choice, subpatch_extent=6.0, vertex_cache=7, coarse_z_block=8, cores=3)
    except tiler.TilerError:
        return None


def sampled_machines(number: int, seed: int) -> list[Machine]:
    """So many machines of the product, seeded."""
    rng = np.random.default_rng(seed)
    machines: list[Machine] = []
    while len(machines) < number:
        fields = FIELDS | {"tile_walk": WALKS}
        machine = machine_of({name: values[rng.integers(len(values))] for name, values in fields.items()})
        machines += [machine] if machine else []
    return machines


def product_scene(load, name: str) -> Scene:
    """A built-in scene with all its patches, small: no side of the picture is a multiple of a tile's."""
    factor = 1 if name in ("colonnade", "creature") else 2
    return load(name, size=(70, 45), factor=factor, samples=4 if name == "teapot" else 1)


def check_machines(scene: Scene, number: float, machines: Iterable[Machine], two: Shared, one: Shared | None) -> int:
    """Every machine draws what the simplest draws, on one thread and on two with the same counters; the number of frames.

    two : stages that frames on two threads share; one : those on one thread; None: each of these runs all its stages.
    """
    frames = 0
    reference = tiler.simulate(scene, SIMPLEST, frame=number, threads=1)
    assert reference.counters["om_samples_visible"] > 0, "an empty picture proves nothing"
    for machine in machines:
        serial, parallel = (
            tiler.simulate(scene, machine, frame=number, threads=threads, shared=shared)
            for threads, shared in ((1, one), (2, two))
        )
        for frame in (serial, parallel):
            assert np.array_equal(frame.color, reference.color), (scene.name, number, machine)
            assert np.array_equal(bits(frame.depth_samples), bits(reference.depth_samples)), (
                scene.name,
                number,
                machine,
            )
        assert dict(serial.counters) == dict(parallel.counters), (scene.name, number, machine)
        assert np.array_equal(serial.queues.entries, parallel.queues.entries), (scene.name, number, machine)
        frames += 2
    return frames


def test_a_sample_of_all_machines_draws_the_same_picture(load):
    machines = sampled_machines(24, 1)
    for name, number in product(SCENES, PRODUCT_FRAMES):
        assert check_machines(product_scene(load, name), number, machines, Shared(), None) == 2 * len(machines)


@pytest.fixture
def tile_loops(monkeypatch) -> list[int]:
    """How often the tile loop ran."""
    runs, run_tiles = [0], back_end.run_tiles

    def count(*arguments):
        runs[0] += 1
        return run_tiles(*arguments)

    monkeypatch.setattr(back_end, "run_tiles", count)
    return runs


@pytest.mark.slow
@pytest.mark.parametrize("number", PRODUCT_FRAMES)
@pytest.mark.parametrize("name", SCENES)
def test_the_whole_product_draws_the_same_picture(name, number, load, tile_loops):
    """Each machine of the whole product, on one thread and on two; prints how many frames were compared.

    Frames of as many threads share their stages, which changes no bit of them (tests/test_shared.py): the tile loop runs
    once for all machines that hand the same queues to it by the same rules, and how often it ran is printed, too.
    """
    choices = (dict(zip(FIELDS, values, strict=True)) for values in product(*FIELDS.values()))
    machines = (machine for choice in choices if (machine := machine_of(choice)))
    frames = check_machines(product_scene(load, name), number, machines, Shared(), Shared())
    assert frames == 2 * NUM_PRODUCT
    print(f"{name}, frame {number}: {frames:,} frames; the tile loop ran {tile_loops[0]:,} times")


@pytest.mark.parametrize("name", SCENES)
def test_sliced_view_is_what_it_should_be(name, load):
    """Patches cross the near and the far plane and the sides, and some are outside of each cull test's reach."""
    frame = tiler.simulate(sliced(load(name, size=(104, 60), factor=3)), Machine(cull=(), binning="triangle"))
    assert frame.counters["c_cut"] > 0 and frame.counters["c_culled_outside"] > 0
    assert frame.counters["su_culled_offscreen"] > 0, "nothing crosses the sides"


def test_frustum_cull_culls_in_these_tests(load):
    culled = [
        tiler.simulate(sliced(load(name, size=(104, 60), factor=3))).counters["hs_culled_frustum"] for name in SCENES
    ]
    assert all(culled), dict(zip(SCENES, culled, strict=True))


@on_views(1, 4)
@pytest.mark.parametrize("binning, cache", BINNING)
def test_batches_change_nothing(view, binning, cache, monkeypatch):
    machine = Machine(tile=16, binning=binning, domain_cache=cache)
    whole, parts = [], []
    reference = tiler.simulate(view, machine, threads=2, progress=whole.append)
    points = reference.counters["ts_domain_points"]
    for module in (front_end, regions):
        monkeypatch.setattr(module, "BATCH_POINTS", max(1, points // 7))
    frame = tiler.simulate(view, machine, threads=2, progress=parts.append)
    assert len(whole) == 1 and 6 <= len(parts) <= 8 and parts[-1] == 1.0
    assert_same_picture(frame, reference, "batches")
    assert_same_counters(frame, reference, "batches")


def test_a_batch_for_every_patch_changes_nothing(load, monkeypatch):
    scene = load("teapot", size=(104, 60), factor=5, samples=4)
    reference = tiler.simulate(scene)
    monkeypatch.setattr(front_end, "BATCH_POINTS", 1)
    parts = []
    frame = tiler.simulate(scene, progress=parts.append)
    assert len(parts) == reference.counters["ts_patches"] == 32
    assert_same_picture(frame, reference, "a batch for every patch")
    assert_same_counters(frame, reference, "a batch for every patch")


@pytest.mark.parametrize("shading", ["normal", "patch", "wireframe"])
def test_shading_does_not_depend_on_the_machine(shading, load):
    """`tile_grid` does, by its purpose: it shows the tiles."""
    scene = sliced(load("spikelog", size=(104, 60), factor=5, samples=4))
    scene = replace(scene, picture=replace(scene.picture, shading=shading))
    reference = tiler.simulate(scene, SIMPLEST, threads=1)
    for tile, (binning, cache) in product(TILES, BINNING):
        machine = Machine(tile=tile, binning=binning, domain_cache=cache)
        assert_same_picture(tiler.simulate(scene, machine, threads=2), reference, machine)


@pytest.mark.parametrize("samples", [1, 4])
def test_of_two_equal_surfaces_the_first_stays(samples, load):
    """LESS fails on equal depth; so drawing every patch twice changes no pixel and fails twice as often."""
    scene = load("teapot", size=(104, 60), factor=5, shading="patch", samples=samples)
    twice = {
        field: np.concatenate([getattr(scene, field)] * 2)
        for field in ("control_points", "texcoords", "map_id", "object_id")
    }
    for binning, cache in BINNING:
        machine = Machine(tile=16, binning=binning, domain_cache=cache)
        once, doubled = tiler.simulate(scene, machine), tiler.simulate(replace(scene, **twice), machine)
        assert np.array_equal(once.color, doubled.color)
        assert np.array_equal(bits(once.depth_samples), bits(doubled.depth_samples))
        assert doubled.counters["rs_samples_covered"] == 2 * once.counters["rs_samples_covered"]
        assert doubled.counters["om_samples_passed"] == once.counters["om_samples_passed"]


SAFE_CULLS = ((), ("frustum",), ("frustum:world",), ("frustum:object", "backface:tessellation_safe"))


@pytest.mark.parametrize("how", VIEWS)
@pytest.mark.parametrize(("name", "factor"), [("creature_small", 7), ("creature", 2)])
def test_displaced_surfaces_draw_the_same_with_every_bound_and_cull(name, factor, how, load):
    """ACC patches and exact ones, displaced along normals that they share on their edges; the face cull is on."""
    scene = load(name, size=(104, 60), factor=factor)
    scene = replace(sliced(scene) if how == "sliced" else scene, face_cull="back")
    reference = tiler.simulate(scene, SIMPLEST, threads=1)
    assert reference.counters["om_samples_visible"] > 400
    culled = 0
    for k, (bound, cull) in enumerate(product(BOUNDS, SAFE_CULLS)):
        binning, cache = BINNING[k % 3]
        machine = Machine(tile=TILES[k % 5], binning=binning, domain_cache=cache, bounds=bound, cull=cull)
        frame = tiler.simulate(scene, machine, threads=1 + k % 2)
        assert_same_picture(frame, reference, machine)
        culled += frame.counters["hs_culled_backface"] if name == "creature" else frame.counters["hs_culled_frustum"]
    assert culled > 0 or (name, how) == ("creature_small", "camera")


def test_a_bound_that_is_too_tight_shows(load, monkeypatch):
    """The tests above can fail: where a patch's rectangle is cut by a tile, the tile lacks what the patch would draw."""
    scene = load("teapot", size=(104, 60), factor=5)
    reference = tiler.simulate(scene, SIMPLEST)
    bound = BOUNDS["cbox"]

    def too_tight(*arguments):
        bounds = bound(*arguments)
        bounds.rect[:, 2] = np.maximum(bounds.rect[:, 2] - 8, bounds.rect[:, 0])
        return bounds

    monkeypatch.setitem(BOUNDS, "cbox", too_tight)
    frame = tiler.simulate(scene, Machine(tile=8, binning="patch"))
    with pytest.raises(AssertionError, match="pixels differ"):
        assert_same_picture(frame, reference, "too tight")
