"""Pictures, tiles and patches at the limits: drawn right by every kind of machine, or refused with a clear message."""

import numpy as np
import pytest

import tiler
from tests.scenes import flat_patch, patch_scene
from tiler import memory
from tiler.config import Machine
from tiler.memory import picture_bytes
from tiler.scene.model import Scene

EVERYTHING = ("frustum", "occlusion", "occlusion:triangle", "occlusion:block")
KINDS = [
    Machine(binning="triangle", cull=()),
    Machine(binning="triangle", cull=EVERYTHING, overlap="exact"),
    Machine(cull=EVERYTHING, queue_order="front_to_back", overlap="exact", domain_cache="frame", blame=True),
    Machine(cull=EVERYTHING, z_feedback="two_phase", tile_walk="hilbert", domain_cache="lru:2"),
    Machine(binning="subpatch", subpatch_extent=4.0, cull=EVERYTHING, tile_walk="morton", blame=True),
    Machine(binning="subpatch", subpatch_extent=4.0, cull=EVERYTHING, z_feedback="previous_frame"),
]


def with_tile(machine: Machine, tile: int) -> Machine:
    return Machine(**(machine.model_dump() | {"tile": tile}))


def assert_all_the_same(scene: Scene, tiles: tuple[int, ...], frame: float = 1) -> list[tiler.Frame]:
    frames = [tiler.simulate(scene, with_tile(kind, tile), frame=frame) for kind in KINDS for tile in tiles]
    assert frames[0].counters["om_samples_visible"] > 0
    for other in frames[1:]:
        assert np.array_equal(other.color, frames[0].color), other.machine
        assert np.array_equal(other.depth_samples.view(np.uint32), frames[0].depth_samples.view(np.uint32)), (
            other.machine
        )
    for made in frames:
        if made.blame:
            assert sum(made.blame.invocations.values()) == made.counters["ds_invocations"]
    return frames


@pytest.mark.parametrize("samples", [1, 4])
def test_one_pixel(samples):
    scene = patch_scene([flat_patch(-3, -3, 3, 3), flat_patch(-3, -3, 3, 3, y=1)], size=(1, 1), samples=samples)
    for frame in assert_all_the_same(scene, (8, 512)):
        assert frame.color.shape == (1, 1, 4) and frame.queues.entries.shape == (1, 1)


def test_a_tile_larger_than_the_picture():
    scene = patch_scene([flat_patch(-1, -0.6, 1, 0.6), flat_patch(-0.7, -1, 0.3, 1, y=0.5)], size=(41, 23), factor=5.0)
    for frame in assert_all_the_same(scene, (64, 128, 256, 512)):
        assert frame.queues.entries.shape == (1, 1)


@pytest.mark.parametrize("size", [(16384, 1), (1, 16384)])
def test_the_longest_pictures(size):
    assert_all_the_same(
        patch_scene([flat_patch(-900, -900, 900, 900), flat_patch(-1, -1, 1, 1, y=-1)], size=size), (8, 512)
    )


def test_the_largest_picture_is_refused_or_drawn(monkeypatch):
    """What it takes is counted with submit numbers, the pyramid, the last frame and the tables of the tiles."""
    scene = patch_scene([flat_patch(-1, -1, 1, 1)], size=(16384, 16384))
    samples, threads = 16384 * 16384, 1
    plain, reordered = Machine(cull=()), Machine(cull=(), queue_order="front_to_back")
    phased, tested = Machine(cull=EVERYTHING, z_feedback="two_phase"), Machine(cull=EVERYTHING)
    of = {m: picture_bytes(scene.picture, m, threads) for m in (plain, reordered, phased, tested, with_tile(plain, 8))}
    assert of[reordered] - of[plain] == 8 * samples
    assert of[tested] - of[plain] == 8 * -(-4 * samples // 64 // 3)
    assert of[phased] - of[reordered] == 4 * samples + 2 * (of[tested] - of[plain])
    assert of[with_tile(plain, 8)] - of[plain] > 8 * (samples // 64) * 60
    for machine, needed in of.items():
        monkeypatch.setattr(memory, "available_bytes", lambda needed=needed: needed - 1)
        with pytest.raises(
            tiler.TilerError, match=r"picture: 16384 x 16384 with 1 sample\(s\), in tiles of .* GB; allowed"
        ):
            tiler.simulate(scene, machine, threads=threads)


@pytest.mark.slow
def test_the_largest_picture():
    scene = patch_scene([flat_patch(-1, -1, 1, 1)], size=(16384, 16384))
    machine = Machine(tile=512)
    if 2 * picture_bytes(scene.picture, machine, 2) > memory.available_bytes():
        pytest.skip("too little memory here")
    frame = tiler.simulate(scene, machine, threads=2)
    assert frame.counters["om_samples_visible"] > 10**7
    assert frame.color[8192, 8192, 3] == 255 and frame.depth[8192, 8192] < 1 and frame.depth[0, 0] == 1


@pytest.mark.parametrize("patches", [20_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_many_patches_in_one_tile(patches):
    rng = np.random.default_rng(0)
    points = np.tile(flat_patch(-3, -3, 3, 3).astype(np.float32), (patches, 1, 1, 1))
    points[..., 1] += rng.integers(0, 2**16, patches)[:, None, None] * np.float32(2.0**-16)
    scene = patch_scene(points, size=(16, 16), factor=1.0)
    machines = [
        Machine(binning="triangle", cull=()),
        Machine(cull=EVERYTHING, queue_order="front_to_back", domain_cache="frame", queue_model="blocks29"),
        Machine(binning="subpatch", cull=EVERYTHING),
    ]
    frames = [tiler.simulate(scene, machine) for machine in machines]
    for frame in frames[1:]:
        assert frame.counters["queue_longest"] == frame.counters["queue_entries"] == patches
        assert np.array_equal(frame.color, frames[0].color) and np.array_equal(frame.depth, frames[0].depth)
    assert frames[0].counters["queue_longest"] == 2 * patches
    assert frames[1].counters["cz_pairs_occluded"] > 0.9 * patches


def test_one_patch_over_every_tile():
    scene = patch_scene([flat_patch(-90, -90, 90, 90)], size=(300, 200), factor=2.0)
    for frame in assert_all_the_same(scene, (8, 32), frame=0):
        tiles = frame.queues.entries.size
        assert (frame.queues.entries > 0).all()
        if frame.machine.binning == "patch":
            assert frame.counters["bin_patch_tile_pairs"] == tiles
    for policy in ("flush", "grow"):
        small = tiler.simulate(scene, Machine(tile=8, queue_pool=6000, queue_policy=policy))
        assert small.counters["queue_entries"] == 38 * 25


def test_a_pool_that_holds_nothing_is_refused():
    with pytest.raises(tiler.TilerError, match="queue_pool: 0; allowed: 1 to"):
        Machine(queue_pool=0)
    scene = patch_scene([flat_patch(-90, -90, 90, 90)], size=(300, 200))
    with pytest.raises(tiler.TilerError, match="pool"):
        tiler.simulate(scene, Machine(tile=8, queue_pool=1, queue_policy="fail"))
