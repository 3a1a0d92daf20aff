"""The machine against its slow twin, which executes what the machine only counts: picture, depth, every counter, exactly."""

import hashlib
import json
import os
import subprocess
import sys
import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest

import tiler
from tests.conftest import TESTS
from tests.naive_machine import simulate_naively
from tests.scenes import flat_patch, looking_along_y, patch_scene, sliced, some_patches
from tiler import back_end
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.front_end import Geometry
from tiler.order import PATCH_SHIFT
from tiler.regions import draws_in_regions
from tiler.scene.model import CameraKey, DisplacementMap, Scene, Tessellation
from tiler.tile import Target

MACHINES = [
    Machine(tile=8, binning="triangle", cores=3),
    Machine(tile=16, binning="triangle", cull=(), cores=1),
    Machine(tile=8, binning="patch", domain_cache="none", cull=(), cores=4),
    Machine(tile=16, binning="patch", domain_cache="none", cull=("frustum", "backface:tessellation_safe"), cores=2),
    Machine(tile=8, binning="patch", domain_cache="frame", cores=7),
    Machine(tile=16, binning="patch", domain_cache="frame", cull=(), cores=2),
    Machine(tile=8, binning="patch", domain_cache="frame", cull=(), queue_pool=100, queue_policy="flush"),
    Machine(tile=8, binning="triangle", cull=(), queue_model="bins128", queue_pool=60_000, queue_policy="flush"),
    Machine(tile=8, binning="triangle", cull=(), queue_model="hierarchy16", queue_pool=1, queue_policy="grow"),
    Machine(tile=16, binning="patch", cull=(), queue_model="blocks29"),
]

CZ = ("frustum", "occlusion")
CZ_ALL = ("occlusion", "occlusion:triangle", "occlusion:block")
FULL_MACHINES = [
    Machine(tile=16, cull=CZ, coarse_z_block=4, cores=3),
    Machine(tile=64, cull=CZ, coarse_z_block=4),
    Machine(tile=32, cull=CZ_ALL, coarse_z_block=4, queue_order="front_to_back", domain_cache="frame"),
    Machine(tile=16, cull=CZ_ALL, coarse_z_update="feed_forward", tile_walk="morton", domain_cache="lru:2", cores=2),
    Machine(tile=16, cull=("occlusion:block",), coarse_z_block=4, queue_order="front_to_back", overlap="exact"),
    Machine(tile=8, cull=CZ, z_feedback="none", overlap="exact", tile_walk="hilbert", domain_cache="lru:3", cores=2),
    Machine(tile=8, binning="triangle", cull=("frustum", *CZ_ALL), coarse_z_block=4, overlap="exact", vertex_cache=4),
    Machine(tile=16, binning="triangle", cull=CZ, coarse_z_update="feed_forward", vertex_cache=13, tile_walk="hilbert"),
    Machine(tile=8, cull=CZ, z_feedback="two_phase", domain_cache="lru:1", cores=2),
    Machine(tile=16, cull=("frustum", *CZ_ALL), z_feedback="two_phase", queue_order="front_to_back", coarse_z_block=4),
    Machine(tile=8, cull=CZ, z_feedback="previous_frame", domain_cache="frame"),
    Machine(tile=16, cull=CZ_ALL, z_feedback="previous_frame", queue_order="front_to_back", overlap="exact"),
    Machine(tile=8, cull=("occlusion:block",), z_feedback="previous_frame"),
    Machine(tile=8, binning="subpatch", subpatch_extent=2.0, subpatch_budget=5, cull=CZ, domain_cache="lru:4", cores=3),
    Machine(tile=8, binning="subpatch", subpatch_extent=6.0, overlap="exact", cull=()),
    Machine(
        tile=8, binning="subpatch", subpatch_extent=1.0, subpatch_budget=64, cull=CZ_ALL, queue_order="front_to_back"
    ),
    Machine(tile=16, binning="subpatch", subpatch_extent=4.0, cull=CZ, z_feedback="two_phase", domain_cache="frame"),
    Machine(tile=8, binning="subpatch", subpatch_extent=4.0, cull=CZ, z_feedback="previous_frame", tile_walk="morton"),
    Machine(tile=8, cull=CZ, domain_cache="lru:3", cores=2, queue_pool=120, queue_policy="flush", tile_walk="hilbert"),
    Machine(tile=8, cull=CZ, z_feedback="two_phase", queue_model="blocks64"),
    Machine(tile=32, cull=CZ, occlusion_area="hull", coarse_z_block=4, bounds="tpatch", domain_cache="frame"),
    Machine(
        tile=64, cull=CZ_ALL, occlusion_area="hull", coarse_z_block=4, queue_order="front_to_back", overlap="exact"
    ),
    Machine(tile=16, cull=("frustum", *CZ_ALL), occlusion_area="hull", coarse_z_update="feed_forward", cores=2),
    Machine(tile=16, cull=CZ, occlusion_area="hull", coarse_z_block=4, z_feedback="two_phase", bounds="tpatch"),
    Machine(tile=8, cull=CZ_ALL, occlusion_area="hull", coarse_z_block=4, z_feedback="previous_frame"),
    Machine(tile=32, binning="subpatch", subpatch_extent=4.0, cull=CZ, occlusion_area="hull", coarse_z_block=4),
    Machine(
        tile=16, binning="subpatch", subpatch_extent=4.0, cull=CZ, occlusion_area="hull", z_feedback="previous_frame"
    ),
    Machine(
        tile=8,
        binning="subpatch",
        subpatch_extent=3.0,
        cull=CZ,
        domain_cache="lru:2",
        queue_pool=150,
        queue_policy="flush",
    ),
]

BUMPS = DisplacementMap(
    np.array([[0.0, 0.4, 0.1], [0.9, 0.2, 0.5], [0.3, 0.8, 0.6], [0.7, 0.0, 0.4]], np.float32), "mirror", 0.5, -0.1
)


def seen_by(scene: Scene, **camera: object) -> Scene:
    return replace(scene, camera=replace(scene.camera, **camera))


def teapot(load) -> Scene:
    """Six patches: rim, body, handle, spout, lid and bottom, some with collapsed edges."""
    return some_patches(load("teapot", size=(40, 24), factor=3, shading="patch"), [1, 6, 13, 17, 23, 30])


def waves(load) -> Scene:
    """Six displaced patches, neighbours, from the side."""
    scene = some_patches(load("waves", size=(40, 24), factor=4, shading="patch"), [10, 11, 42, 43, 74, 75])
    middle = scene.control_points[..., :3].mean(axis=(0, 1, 2)).tolist()
    eye = (middle[0] + 1.0, middle[1] - 4.0, middle[2] + 1.5)
    return seen_by(scene, keys=(CameraKey(0, eye, tuple(middle)),))


def bumps(load) -> Scene:
    """Displaced, fractional and uneven factors, a rational patch among them."""
    bent = flat_patch(-0.9, -0.2, 0.9, 0.8, y=0.4)
    bent[1:3, :, :] *= 0.7
    return patch_scene(
        [flat_patch(-1.5, -1, 0, 0.2), bent, flat_patch(0.1, -0.8, 1.6, 0.1, y=-0.5)],
        displacement=BUMPS,
        tessellation=Tessellation("fractional_odd", (2.2, 3.7, 1.0, 4.1, 2.6, 3.3)),
    )


def through_the_eye(load) -> Scene:
    """Patches that cross the near plane, the far plane, w = 0 and the guard band."""
    away = flat_patch(-0.4, -0.6, 0.4, -0.5)
    away[..., 1] = np.linspace(-5, 30, 4)[None, :]
    wall = flat_patch(-3, -3, 3, 3)
    wall[..., 1] = np.linspace(-4.5, 3, 4)[:, None]
    wide = flat_patch(-120, 0.002, 120, 0.004, y=-3.985)  # its middle third reaches 55,000 pixels to each side
    near = looking_along_y(near=2.0**-7, far=12.0, fov=60)
    return patch_scene([away, wall, wide, flat_patch(-1, -1, 1, 1)], factor=3.0, camera=near, face_cull="none")


def rare(load) -> Scene:
    """Each kind of patch that is dropped on the way; among them numbers that overflow."""
    broken = flat_patch(-1, -1, 1, 1)
    broken[2, 1, 0] = np.nan
    return patch_scene(
        [
            flat_patch(-0.5, 0.003, 0.5, 0.004, y=-0.5), flat_patch(-0.5, 0.25, 0.5, 0.25, y=-0.5), broken,
            flat_patch(1, -0.5, -1, 0.5, y=0.3), flat_patch(9, -0.5, 9.5, 0.5), flat_patch(2.5e38, 2.5e38, 3e38, 3e38),
            flat_patch(1.2, -0.5, 3.9, 0.5, y=-0.8), flat_patch(-1, -0.5, 1, 0.5), flat_patch(-0.3, -0.2, 0.4, 0.9, y=3e38),
        ],
    )  # fmt: skip


def twice_the_same(load) -> Scene:
    """Equal depth: of two equal patches the first stays; a third cuts through both."""
    slanted = flat_patch(-1, -0.6, 1, 0.6)
    slanted[..., 1] = np.linspace(-0.3, 0.3, 4)[:, None]
    return patch_scene([flat_patch(-1, -0.5, 1, 0.5), flat_patch(-1, -0.5, 1, 0.5), slanted], factor=3.0)


def layers(load) -> Scene:
    """Walls behind each other, the last ones first, two of them at the same place; the camera moves to the side."""
    walls = [
        flat_patch(-1.2 + 0.1 * k, -0.6, 0.9 + 0.1 * k, 0.6, y=y) for k, y in enumerate((2.0, 1.5, 0.0, 1.0, -0.5, 0.5))
    ]
    small = [
        flat_patch(-0.2 + dx, -0.2, 0.2 + dx, 0.2, y=y) for dx, y in ((0.0, 1.7), (0.4, 0.2), (-0.5, 2.5), (1.3, 1.0))
    ]
    keys = tuple(CameraKey(k, (0.6 * k, -4.0 + 0.1 * k, 0.1), (0.2 * k, 0.0, 0.0)) for k in range(4))
    scene = patch_scene([*walls, walls[2], *small, walls[4]], factor=3.0)
    return seen_by(scene, keys=keys)


def covered(load) -> Scene:
    """A wall over the whole picture, and one behind it."""
    return patch_scene([flat_patch(-4, -3, 4, 3, y=-1), flat_patch(-2.4, -1.3, 2.4, 1.3, y=1.0)], factor=2.0)


def uncovered(load) -> Scene:
    """What a small wall hides in frame 0 is seen in frame 1, at the same place of the picture."""
    keys = tuple(CameraKey(k, (1.5 * k, -4.0, 0.0), (0.0, 1.0, 0.0)) for k in range(2))
    small = [flat_patch(-0.5, -0.5, 0.5, 0.5, y=-1.5), flat_patch(-0.3, -0.3, 0.3, 0.3, y=1.0)]
    return seen_by(patch_scene(small, factor=3.0), keys=keys)


SCENES = {
    "layers": layers,
    "covered": covered,
    "uncovered": uncovered,
    "teapot": teapot,
    "waves": waves,
    "bumps": bumps,
    "through-the-eye": through_the_eye,
    "rare": rare,
    "twice-the-same": twice_the_same,
    "teapot-sliced": lambda load: seen_by(sliced(teapot(load)), fov=20.0, near=9.0, far=11.0),
    "teapot-screen-space": lambda load: replace(teapot(load), tessellation=Tessellation("fractional_even", edge_pixels=6.0)),
    "teapot-front-culled": lambda load: replace(teapot(load), face_cull="front"),
    "culled-by-factor": lambda load: replace(teapot(load), tessellation=Tessellation(factor=(3.0, 0.0) + (3.0,) * 4)),
    "moved": lambda load: replace(
        twice_the_same(load), transforms=np.array([[[0.7, 0.3, 0, 0.2], [-0.3, 0.9, 0, 0.1], [0, 0.1, 1.2, -0.3]]], np.float32)
    ),
    "one-pixel": lambda load: patch_scene([flat_patch(-1, -1, 1, 1)], size=(1, 1)),
    "empty": lambda load: patch_scene([]),
}  # fmt: skip


def assert_equal_counters(measured: dict[str, int], expected: dict[str, int]) -> None:
    lines = [
        f"{name}: expected {expected[name]}, measured {measured[name]}, {measured[name] - expected[name]:+}"
        for name in DEFINITIONS
        if measured[name] != expected[name]
    ]
    assert not lines, "\n".join(lines)


@dataclass
class Seen:
    """What the production machine hands to the shading of its last batch."""

    target: Target
    geometry: Geometry

    @property
    def patch(self) -> np.ndarray:
        """The patch seen at each sample, -1 for none; of a frame of one batch, or of a machine that keeps submit numbers."""
        if self.target.order.size:
            return self.target.order >> PATCH_SHIFT
        visible = self.target.visible
        return np.where(visible < 0, -1, np.append(self.geometry.triangles.patch, -1)[visible])


@pytest.fixture
def watched(monkeypatch) -> list[Seen]:
    """Filled by `tiler.simulate`: an entry for each batch."""
    seen = []
    run_tiles = back_end.run_tiles

    def run_and_watch(*arguments):
        outcome = run_tiles(*arguments)
        found = {type(a): a for a in arguments}
        seen.append(Seen(found[Target], found[Geometry]))
        return outcome

    monkeypatch.setattr(back_end, "run_tiles", run_and_watch)
    return seen


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize(
    "machine",
    MACHINES,
    ids=lambda m: f"{m.binning}-{m.tile}-{m.domain_cache}-{len(m.cull)}-{m.queue_model}-{m.queue_policy}",
)
@pytest.mark.parametrize("name", SCENES)
def test_machine_is_its_slow_twin(name, machine, samples, load, watched):
    scene = SCENES[name](load)
    scene = replace(scene, picture=replace(scene.picture, samples=samples))
    assert_twins(scene, machine, 0, watched)


def assert_twins(scene: Scene, machine: Machine, number: float, watched: list[Seen]) -> dict[str, int]:
    """Picture, depth and every counter of both; the counters."""
    watched.clear()
    expected, frame = simulate_naively(scene, machine, number), tiler.simulate(scene, machine, frame=number, threads=2)
    assert watched or draws_in_regions(machine)
    assert_equal_counters(dict(frame.counters), expected.counters)
    assert np.array_equal(frame.depth_samples.view(np.uint32), expected.depth.view(np.uint32))
    if watched and (frame.counters["queue_flushes"] == 0 or machine.reordered):
        assert np.array_equal(watched[-1].patch, expected.patch)
    assert frame.tiles.keys() == expected.tiles.keys()
    for counter, tiles in expected.tiles.items():
        assert np.array_equal(frame.tiles[counter], tiles), counter
        assert frame.cores[counter].tolist() == expected.cores[counter], counter
    assert np.array_equal(frame.queues.entries, expected.tiles["queue_entries"])
    return expected.counters


FULL_SCENES = (
    "layers",
    "covered",
    "uncovered",
    "teapot",
    "bumps",
    "through-the-eye",
    "twice-the-same",
    "teapot-sliced",
    "rare",
    "empty",
)


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("number", range(len(FULL_MACHINES)))
def test_machine_with_everything_is_its_slow_twin(number, samples, load, watched):
    machine = FULL_MACHINES[number]
    for name in FULL_SCENES[:: 1 if samples == 1 else 3]:
        scene = SCENES[name](load)
        scene = replace(scene, picture=replace(scene.picture, samples=samples))
        for frame in (0, 1) if machine.phased and name in ("layers", "uncovered") else (0,):
            assert_twins(scene, machine, frame, watched)


def test_the_scenes_above_provoke_what_is_rare(load):
    """Every counter moves under the slow twin too, and several patches are seen, so that order and depth matter."""
    moved, seen = set(), {}
    for name, make in SCENES.items():
        for machine in (MACHINES[1], MACHINES[2], MACHINES[3], *MACHINES[6:]):
            frame = simulate_naively(make(load), machine)
            moved |= {counter for counter, value in frame.counters.items() if value}
            seen[name] = len(np.unique(frame.patch[frame.patch >= 0]))
    for machine in FULL_MACHINES:
        for name, number in (("layers", 2), ("covered", 0), ("uncovered", 1), ("through-the-eye", 0), ("rare", 0)):
            frame = simulate_naively(SCENES[name](load), machine, number)
            moved |= {counter for counter, value in frame.counters.items() if value}
    assert set(DEFINITIONS) - moved == set()
    assert seen["teapot"] >= 4 and seen["waves"] >= 4 and seen["bumps"] == 3 and seen["twice-the-same"] == 2
    assert seen["through-the-eye"] >= 3 and seen["teapot-sliced"] >= 2


def test_guard_band_is_cut(load):
    """The wide patch lies between near and far plane; only the guard band cuts it."""
    c = tiler.simulate(some_patches(through_the_eye(load), [2]), MACHINES[1]).counters
    assert c["c_cut"] > 0 and c["om_samples_visible"] > 0


# The same sources without the compiler: a second implementation, with the bounds of every array checked.

UNCOMPILED = [(name, shading, samples) for name in ("bumps", "rare", "through-the-eye", "teapot", "empty", "culled-by-factor")
              for shading in ("lambert", "normal", "patch", "wireframe", "tile_grid") for samples in (1, 4)]  # fmt: skip


def digest_of(name: str, shading: str, samples: int) -> str:
    """Digest of everything that a frame holds, or the error that took its place."""
    scene = SCENES[name](tiler.load_scene)
    scene = replace(scene, picture=replace(scene.picture, shading=shading, samples=samples))
    try:
        frame = tiler.simulate(scene, MACHINES[2], threads=1)
    except Exception as error:
        return repr(error)
    content = [frame.color.tobytes(), frame.depth_samples.tobytes(), repr(dict(frame.counters)).encode()]
    content += [tiles.tobytes() for tiles in frame.tiles.values()]
    return hashlib.sha256(b"".join(content)).hexdigest()


def print_digests() -> None:
    """Run in a process of its own."""
    warnings.simplefilter("ignore")  # NumPy warns of overflow where compiled code does not
    print(json.dumps([digest_of(*case) for case in UNCOMPILED]))


@pytest.fixture(scope="module")
def uncompiled() -> dict[tuple[str, str, int], str]:
    run = subprocess.run(
        [sys.executable, "-c", "from tests.test_naive_machine import print_digests; print_digests()"],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, cwd=TESTS.parent, capture_output=True, text=True, timeout=120,
        check=True,
    )  # fmt: skip
    return dict(zip(UNCOMPILED, json.loads(run.stdout), strict=True))


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("shading", ["lambert", "normal", "patch", "wireframe", "tile_grid"])
def test_uncompiled_machine_gives_the_same_bits(shading, samples, uncompiled):
    cases = [
        case for case in UNCOMPILED if case[1:] == (shading, samples) and case[0] not in ("empty", "culled-by-factor")
    ]
    for case in cases:
        assert uncompiled[case] == digest_of(*case), case[0]


@pytest.mark.parametrize("name", ["empty", "culled-by-factor"])
def test_uncompiled_machine_reads_nothing_out_of_bounds_where_no_patch_lives(name, uncompiled):
    for case in UNCOMPILED:
        if case[0] == name:
            assert uncompiled[case] == digest_of(*case), case
