"""Ideal and blame: against a slow twin, as sums on every scene, and each reason where it must be."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import tiler
from tests.naive_blame import blame_naively
from tests.scenes import flat_patch, patch_scene, sliced
from tests.test_naive_machine import CZ, CZ_ALL, FULL_MACHINES, MACHINES, SCENES
from tiler.blame import BLAME, IDEAL, waterfall, waterfall_table
from tiler.config import Machine

TWINS = [
    *(MACHINES[k] for k in (0, 2, 3, 4, 6, 7)),
    *FULL_MACHINES,
    Machine(tile=8, binning="subpatch", subpatch_extent=3.0, cull=CZ, queue_pool=150, queue_policy="flush"),
]
NAMES = (
    "layers",
    "uncovered",
    "teapot",
    "bumps",
    "twice-the-same",
    "teapot-sliced",
    "through-the-eye",
    "rare",
    "empty",
)


def blamed(machine: Machine) -> Machine:
    return Machine(**(machine.model_dump() | {"blame": True}))


@pytest.mark.parametrize("number", range(len(TWINS)))
def test_blame_is_its_slow_twin(number, load):
    machine = TWINS[number]
    for k, name in enumerate(NAMES):
        if name not in ("layers", "uncovered") and (k + number) % 7:
            continue
        scene = SCENES[name](load)
        if number % 3 == 2:
            scene = replace(scene, picture=replace(scene.picture, samples=4))
        frame = 1 if machine.phased else 0
        expected = blame_naively(scene, machine, frame)
        blame = tiler.simulate(scene, blamed(machine), frame=frame, threads=2).blame
        assert blame.invocations == expected.invocations, name
        assert blame.ideal == expected.ideal, name
        assert blame.tiles.keys() == expected.tiles.keys()
        for reason, tiles in expected.tiles.items():
            assert np.array_equal(blame.tiles[reason], tiles), (name, reason)


ALL = [
    Machine(binning="triangle", cull=()),
    Machine(binning="triangle", vertex_cache=12, cull=CZ),
    Machine(cull=()),
    Machine(domain_cache="lru:9", cull=CZ, overlap="exact", tile_walk="hilbert"),
    Machine(domain_cache="frame", cull=CZ_ALL, queue_order="front_to_back", bounds="tpatch"),
    Machine(cull=("frustum", *CZ_ALL), coarse_z_update="feed_forward", coarse_z_block=4),
    Machine(cull=CZ, z_feedback="two_phase", tile=16),
    Machine(cull=CZ, occlusion_area="hull", coarse_z_block=4, tile=64, overlap="exact", bounds="tpatch"),
    Machine(cull=CZ, z_feedback="previous_frame", domain_cache="lru:20"),
    Machine(binning="subpatch", tile=16, subpatch_extent=8.0, cull=CZ, domain_cache="frame"),
    Machine(binning="subpatch", tile=16, subpatch_extent=8.0, cull=CZ, z_feedback="two_phase"),
    Machine(queue_pool=3000, queue_policy="flush", domain_cache="lru:3", cull=CZ),
]


@pytest.mark.parametrize("name", tiler.scene_names())
def test_lines_add_up_on_every_scene_and_machine(name, load):
    for scene in (load(name, size=(72, 40), factor=3), sliced(load(name, size=(72, 40), factor=2, samples=4))):
        points = set()
        for machine in ALL:
            plain, frame = (tiler.simulate(scene, m, frame=7, threads=2) for m in (machine, blamed(machine)))
            assert plain.blame is None and dict(plain.counters) == dict(frame.counters)
            assert np.array_equal(plain.color, frame.color)
            blame, c = frame.blame, frame.counters
            assert list(blame.invocations) == list(BLAME) and list(blame.ideal) == list(IDEAL)
            assert all(value >= 0 for value in blame.invocations.values())
            assert sum(blame.invocations.values()) == c["ds_invocations"]
            assert blame.invocations["useful"] == blame.ideal["ideal_domain_points"]
            assert blame.ideal["ideal_domain_points"] <= blame.ideal["ideal_unit_points"]
            assert blame.ideal["ideal_patches"] <= blame.ideal["ideal_units"] <= blame.ideal["ideal_entries"]
            assert blame.ideal["ideal_entries"] <= c["queue_entries"]
            points.add((blame.ideal["ideal_patches"], blame.ideal["ideal_domain_points"]))
            if machine.binning != "triangle":
                tiles = sum(blame.tiles.values())
                assert np.array_equal(tiles, frame.tiles["ds_invocations"])
                assert blame.wasted_domain_points.sum() + blame.ideal["ideal_domain_points"] == c["ds_invocations"]
            if machine.z_feedback == "tile" and machine.coarse_z_update == "recompute":
                assert blame.invocations["occluded_stale"] == 0  # the pyramid is never behind
        assert len(points) == 1, "what is visible does not depend on the machine"


def blame_of(scene, machine: Machine, frame: float = 0) -> dict[str, int]:
    """Lines that are not 0."""
    return {name: n for name, n in tiler.simulate(scene, blamed(machine), frame=frame).blame.invocations.items() if n}


FRONT, BEHIND = flat_patch(-4, -3, 4, 3, y=-1), flat_patch(-0.5, -0.4, 0.5, 0.4, y=1.0)
TESTED = Machine(tile=64, cull=CZ)


def test_a_wall_that_fills_the_picture_is_useful_but_for_its_corners():
    assert blame_of(patch_scene([flat_patch(-0.5, -0.4, 0.5, 0.4)]), Machine(tile=64)) == {"useful": 9}


def test_what_comes_behind_is_occluded_and_what_comes_before_is_too_early():
    hidden = patch_scene([BEHIND, FRONT])
    assert blame_of(hidden, TESTED)["occluded_order"] == 9
    assert "occluded_order" not in blame_of(hidden, TESTED.model_copy(update={"queue_order": "front_to_back"}))
    assert blame_of(patch_scene([FRONT, BEHIND]), Machine(tile=64))["occluded_untested"] == 9
    assert sum(blame_of(patch_scene([FRONT, BEHIND]), TESTED).values()) == 9  # not shaded at all


def test_a_bent_patch_has_a_loose_bound():
    """Its control points reach in front of the wall; its surface does not."""
    bent = BEHIND.copy()
    bent[1:3, 1:3, 1] = -2.2
    bent[1, 1, 1], bent[2, 2, 1] = 1.0, 4.0
    near = flat_patch(-4, -3, 4, 3, y=-0.4)
    machine = Machine(tile=64, cull=CZ)
    assert blame_of(patch_scene([near, bent], factor=4.0), machine).get("occluded_bound") == 25


def test_a_hole_in_the_wall_makes_blocks_too_coarse():
    left, right = flat_patch(-4, -3, -0.6, 3, y=-1), flat_patch(-0.3, -3, 4, 3, y=-1)
    behind = flat_patch(-0.25, -0.2, 0.4, 0.2, y=1.0)
    machine = Machine(tile=64, cull=CZ, coarse_z_block=16)
    assert blame_of(patch_scene([left, right, behind]), machine).get("occluded_coarse") == 9


def test_feed_forward_is_stale():
    """Two triangles cover the picture, neither of them a whole block on the diagonal."""
    machine = Machine(tile=64, cull=CZ, coarse_z_block=64, coarse_z_update="feed_forward")
    assert blame_of(patch_scene([FRONT, BEHIND], factor=1.0), machine).get("occluded_stale") == 4


def test_a_tile_without_a_triangle_and_one_too_many():
    slanted = flat_patch(-1.5, -0.9, 1.5, 0.9)
    slanted[..., 2] = np.linspace(-0.9, 0.8, 4)[:, None] + np.linspace(0, 0.1, 4)[None, :]
    lines = blame_of(patch_scene([slanted]), Machine(tile=8))
    assert lines["no_triangle_in_tile"] > 0 and lines["redundant"] > 0
    cached = blame_of(patch_scene([slanted]), Machine(tile=8, domain_cache="frame"))
    assert set(cached) <= {"useful", "granularity"} and sum(cached.values()) == 9


def test_units_that_reach_no_sample():
    away, back = flat_patch(2.6, -0.4, 3.2, 0.4), flat_patch(0.5, -0.4, -0.5, 0.4)
    thin = flat_patch(-0.5, 0.003, 0.5, 0.004, y=-0.5)
    for patch, reason in ((away, "outside"), (back, "backface"), (thin, "no_sample")):
        assert blame_of(patch_scene([patch]), Machine(binning="triangle", cull=())) == {reason: 9}
    assert blame_of(patch_scene([back]), Machine(tile=64)) == {"backface": 9}


def test_half_a_patch_could_be_culled():
    half = flat_patch(0.0, -0.4, 6.0, 0.4)
    assert blame_of(patch_scene([half]), Machine(tile=64))["granularity"] > 0


def test_sub_domains_share_points():
    machine = Machine(tile=8, binning="subpatch", subpatch_extent=4.0, domain_cache="frame")
    lines = blame_of(patch_scene([flat_patch(-1, -0.6, 1, 0.6)], factor=4.0), machine)
    assert lines["useful"] == 25 and lines["shared_border"] > 0


def test_a_small_vertex_cache_loses_points():
    lines = blame_of(
        patch_scene([flat_patch(-1, -0.6, 1, 0.6)], factor=4.0), Machine(binning="triangle", vertex_cache=3)
    )
    assert lines["useful"] == 25 and lines["vertex_cache"] > 0


def test_every_line_is_defined_and_told(load):
    for reason in BLAME.values():
        assert reason.title and reason.text.endswith((".", ")"))
    scene = load("teapot", size=(104, 60), factor=3)
    frames = {name: tiler.simulate(scene, blamed(m)) for name, m in {"a": ALL[0], "b": ALL[4]}.items()}
    table = waterfall_table({name: (f.counters, f.blame) for name, f in frames.items()})
    for name in IDEAL:
        assert name in table
    lines = waterfall(frames["b"].counters, frames["b"].blame)
    for start, end in (("patches", "= visible patches"), ("domain-shader invocations", "= useful invocations")):
        titles = [title for title, _ in lines]
        part = lines[titles.index(start) : titles.index(end) + 1]
        assert part[0][1] - sum(value for _, value in part[1:-1]) == part[-1][1]


def test_wasted_points_are_a_heat_map(load):
    scene = load("teapot", size=(104, 60), factor=3)
    frame = tiler.simulate(scene, Machine(blame=True))
    assert frame.heatmap("wasted_domain_points").size == (104, 60)
    assert (
        frame.tile_map("wasted_domain_points").sum()
        == frame.counters["ds_invocations"] - frame.blame.invocations["useful"]
    )
    front_end = tiler.simulate(scene, Machine(binning="triangle", blame=True))
    assert not front_end.tile_map("wasted_domain_points").any()
    with pytest.raises(tiler.TilerError, match=r"wasted_domain_points.*blame=True"):
        tiler.simulate(scene, Machine()).heatmap("wasted_domain_points")


def test_results_do_not_depend_on_threads(load):
    for name, machine in product(("colonnade", "waves"), (ALL[3], ALL[9])):
        scene = load(name, size=(104, 60), factor=3)
        one, two = (tiler.simulate(scene, blamed(machine), frame=3, threads=n).blame for n in (1, 2))
        assert one.invocations == two.invocations and one.ideal == two.ideal
        assert all(np.array_equal(one.tiles[n], two.tiles[n]) for n in BLAME)
