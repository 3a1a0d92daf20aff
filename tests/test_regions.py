"""Frames drawn region by region against the same frames drawn stage by stage: one is the other's twin, to the last counter."""

from dataclasses import replace

import numpy as np
import pytest

import tiler
from pipeline.types import PatchBounds
from tests.scenes import sliced
from tests.test_same_picture import assert_same_counters, assert_same_picture
from tiler import machine as machine_module
from tiler import regions
from tiler.bench.scenes import torus
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.regions import cut_regions, draws_in_regions

MACHINES = (
    Machine(binning="triangle", tile=8, cull=()),
    Machine(binning="triangle", tile=64, cull=("frustum", "backface:tessellation_safe"), vertex_cache=7, cores=3),
    Machine(binning="triangle", tile=128, cull=("frustum",), queue_model="blocks64", tile_walk="morton"),
)


@pytest.fixture
def stage_by_stage(monkeypatch):
    """A function that simulates so, whatever the machine."""

    def simulate(scene, machine, **arguments):
        with monkeypatch.context() as patch:
            patch.setattr(machine_module, "draws_in_regions", lambda machine: False)
            return tiler.simulate(scene, machine, **arguments)

    return simulate


@pytest.fixture
def ends(monkeypatch) -> list[bool]:
    """For each frame that was begun in regions, whether it was ended so."""
    found: list[bool] = []
    draw = machine_module.draw_frame_in_regions

    def watched(*arguments):
        drawn = draw(*arguments)
        found.append(drawn is not None)
        return drawn

    monkeypatch.setattr(machine_module, "draw_frame_in_regions", watched)
    return found


def assert_same_queues(frame, reference):
    mine, other = frame.queues.memory, reference.queues.memory
    for name in mine.__dataclass_fields__:
        a, b = getattr(mine, name), getattr(other, name)
        assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b, name


def assert_same_frame(frame, reference, what):
    assert_same_picture(frame, reference, what)
    assert_same_counters(frame, reference, what)
    assert_same_queues(frame, reference)


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("how", ["camera", "sliced"])
@pytest.mark.parametrize("name", tiler.scene_names())
def test_every_scene(name, how, samples, load, stage_by_stage, ends):
    scene = load(name, size=(203, 117), factor={"colonnade": 3, "creature": 2}.get(name, 5), samples=samples)
    scene = sliced(scene) if how == "sliced" else scene
    for machine in MACHINES:
        reference = stage_by_stage(scene, machine, threads=1)
        for threads in (1, 2):
            frame = tiler.simulate(scene, machine, threads=threads)
            assert_same_frame(frame, reference, (machine, threads))
    assert ends == [True] * 2 * len(MACHINES)


@pytest.mark.parametrize("factor", [1, 3, 8, 21, 64])
@pytest.mark.parametrize("partitioning", ["integer", "fractional_odd"])
def test_triangles_of_every_size(factor, partitioning, stage_by_stage, ends):
    scene = torus(150, factor, (320, 200))
    scene = replace(scene, tessellation=replace(scene.tessellation, partitioning=partitioning))
    reference = stage_by_stage(scene, MACHINES[0])
    assert reference.counters["om_samples_visible"] > 5000
    for threads in (1, 2, 5):
        assert_same_frame(tiler.simulate(scene, MACHINES[0], threads=threads), reference, threads)
    assert ends == [True] * 3


@pytest.mark.parametrize("shading", ["normal", "patch", "wireframe", "tile_grid"])
def test_every_shading(shading, load, stage_by_stage, ends):
    scene = load("teapot", size=(203, 117), factor=5)
    scene = replace(scene, picture=replace(scene.picture, shading=shading), face_cull="none")
    assert_same_frame(
        tiler.simulate(scene, MACHINES[0], threads=2), stage_by_stage(scene, MACHINES[0]), shading
    )  # fmt: skip
    assert ends == [True]


@pytest.mark.parametrize("size", [(1, 1), (7, 300), (1000, 3)])
def test_pictures_of_odd_shapes(size, load, stage_by_stage):
    scene = load("teapot", size=size, factor=5)
    for machine in MACHINES:
        assert_same_frame(tiler.simulate(scene, machine, threads=2), stage_by_stage(scene, machine), size)


def test_batches_and_groups_change_nothing(monkeypatch, stage_by_stage):
    scene = torus(150, 9, (320, 200))
    reference, parts = stage_by_stage(scene, MACHINES[0]), []
    monkeypatch.setattr(regions, "BATCH_POINTS", 1)
    monkeypatch.setattr(regions, "split_batches", lambda live, patterns, most: np.array_split(live, 11))
    frame = tiler.simulate(scene, MACHINES[0], threads=2, progress=parts.append)
    assert_same_frame(frame, reference, "batches")
    assert parts == [(k + 1) / 11 for k in range(11)]


def test_a_bound_that_is_too_tight_changes_no_picture(load, monkeypatch, stage_by_stage, ends):
    """A patch that leaves its bounds is found, and the frame is drawn stage by stage, where triangles need no bound."""
    scene = load("teapot", size=(203, 117), factor=5)
    reference = stage_by_stage(scene, MACHINES[0])
    bound = machine_module.BOUNDS["cbox"]

    def too_tight(*arguments) -> PatchBounds:
        bounds = bound(*arguments)
        bounds.rect[:, 2] = np.maximum(bounds.rect[:, 2] - 8, bounds.rect[:, 0])
        return bounds

    monkeypatch.setitem(machine_module.BOUNDS, "cbox", too_tight)
    assert_same_frame(tiler.simulate(scene, MACHINES[0], threads=2), reference, "too tight")
    assert ends == [False]


def test_machines_whose_tiles_wait_for_each_other_are_left_out():
    assert draws_in_regions(Machine(binning="triangle"))
    for fields in (
        {"binning": "patch"},
        {"binning": "subpatch"},
        {"overlap": "exact"},
        {"cull": ("occlusion",)},
        {"cull": ("occlusion:block",)},
    ):
        assert not draws_in_regions(Machine(**{"binning": "triangle"} | fields)), fields


@pytest.mark.parametrize("most", [1, 2, 3, 8, 64])
@pytest.mark.parametrize("seed", range(4))
def test_regions_are_the_picture_cut_at_tiles(most, seed):
    rng = np.random.default_rng(seed)
    grid = make_grid(int(rng.integers(1, 400)), int(rng.integers(1, 400)), 16)
    corner = rng.integers(0, 400, (50, 2))
    rect = np.concatenate([corner, corner + rng.integers(0, 90, (50, 2))], axis=1)
    rect = np.minimum(rect, [grid.width, grid.height] * 2).astype(np.int32)
    found = cut_regions(rect, rng.uniform(1, 99, 50), grid, most, rng.uniform(0, 2))
    assert 1 <= len(found) <= most
    seen = np.zeros((grid.height, grid.width), np.int64)
    for x0, y0, x1, y1 in found:
        assert x0 % 16 == 0 and y0 % 16 == 0 and x0 <= x1 and y0 <= y1
        assert (x1 + 1) % 16 == 0 or x1 == grid.width - 1
        assert (y1 + 1) % 16 == 0 or y1 == grid.height - 1
        seen[y0 : y1 + 1, x0 : x1 + 1] += 1
    assert (seen == 1).all()


def test_regions_have_like_weights():
    """A quarter of the picture that holds all patches is cut, not the empty rest."""
    grid = make_grid(1024, 1024, 32)
    corner = np.random.default_rng(1).integers(0, 500, (1000, 2))
    rect = np.concatenate([corner, corner + 10], axis=1).astype(np.int32)
    found = cut_regions(rect, np.ones(1000), grid, 8)
    middle = (rect[:, :2] + rect[:, 2:]) // 2
    shares = [
        ((middle[:, 0] >= x0) & (middle[:, 0] <= x1) & (middle[:, 1] >= y0) & (middle[:, 1] <= y1)).mean()
        for x0, y0, x1, y1 in found
    ]
    assert len(found) == 8 and max(shares) < 0.2


def test_tiles_without_patches_weigh_too():
    """Of 64 tiles and 12 patches the left half has 13 columns of 2 tiles and all patches."""
    grid = make_grid(1024, 64, 32)
    rect = np.tile(np.array([[0, 0, 10, 10]], np.int32), (12, 1))
    assert cut_regions(rect, np.ones(12), grid, 2, tile_weight=1.0) == [(0, 0, 415, 63), (416, 0, 1023, 63)]


def test_patches_in_many_regions_are_bounded_more_tightly(monkeypatch):
    scene = tiler.load_scene(
        "spikelog", size=(320, 180), factor=6
    )  # its map displaces far: boxes by the whole map's range are large
    machine = Machine(binning="triangle", bounds="cbox")  # by the range of the whole map, which is wide
    alone = tiler.simulate(scene, machine, threads=1)
    asked: list[int] = []
    intersect = regions.intersect
    monkeypatch.setattr(regions, "intersect", lambda a, b: asked.append(len(a)) or intersect(a, b))
    several = tiler.simulate(scene, machine, threads=4)
    assert asked
    assert_same_frame(several, alone, "four threads")
    a = np.array([[0, 0, 10, 10], [0, 0, 4, 4], [3, 3, 3, 3]], np.int32)
    b = np.array([[5, 2, 20, 8], [6, 6, 9, 9], [0, 0, 9, 9]], np.int32)
    assert intersect(a, b).tolist() == [[5, 2, 10, 8], [6, 6, 6, 6], [3, 3, 3, 3]]
