"""Identities of the counters of sub-domains, coarse Z, domain caches and queues; each of them moves here."""

from collections import Counter
from itertools import product

import pytest

import tiler
from tests.scenes import sliced
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.frame import Frame

CZ = ("frustum", "occlusion")
ALL = (*CZ, "occlusion:triangle", "occlusion:block")
MACHINES = [
    Machine(tile=16, cull=ALL, coarse_z_block=4, domain_cache="frame"),
    Machine(tile=64, cull=ALL, coarse_z_block=4, queue_order="front_to_back", domain_cache="lru:50"),
    Machine(tile=16, cull=ALL, coarse_z_update="feed_forward"),
    Machine(tile=8, cull=CZ, z_feedback="two_phase", bounds="tpatch", domain_cache="lru:3"),
    Machine(tile=8, cull=ALL, z_feedback="previous_frame", bounds="tpatch"),
    Machine(tile=8, binning="subpatch", subpatch_extent=2.0, bounds="tpatch", cull=CZ, domain_cache="frame"),
    Machine(tile=8, binning="subpatch", subpatch_extent=2.0, bounds="tpatch", cull=CZ, z_feedback="two_phase"),
    Machine(tile=8, binning="subpatch", subpatch_extent=2.0, cull=CZ, z_feedback="previous_frame"),
    Machine(tile=8, binning="subpatch", subpatch_extent=2.0, cull=(), queue_pool=4000, queue_policy="flush"),
    Machine(tile=64, cull=CZ, occlusion_area="hull", coarse_z_block=4, queue_order="front_to_back"),
    Machine(tile=16, cull=ALL, occlusion_area="hull", z_feedback="previous_frame", bounds="tpatch"),
    Machine(tile=16, binning="triangle", cull=ALL, queue_model="blocks29", vertex_cache=8),
    Machine(tile=16, queue_model="bins128", queue_pool=10_000, queue_policy="grow"),
]


@pytest.fixture(scope="module")
def frames(load) -> list[Frame]:
    scenes = (
        load("colonnade", size=(104, 60), factor=3),
        load("teapot", size=(104, 60), factor=5),
        sliced(load("waves", size=(104, 60), factor=3)),
    )
    return [tiler.simulate(scene, machine, frame=9, threads=1) for scene, machine in product(scenes, MACHINES)]


def test_sub_domains_have_one_fate_each(frames):
    for frame in frames:
        c = frame.counters
        if frame.machine.binning != "subpatch":
            assert c["hs_subpatches"] == c["bin_subpatches"] == c["bin_subpatch_tile_pairs"] == 0
            continue
        queued = c["bin_subpatches"] + c["bin_subpatches_offscreen"] + c["cz_units_occluded"]
        assert c["hs_subpatches"] == c["hs_subpatches_culled_frustum"] + queued
        assert c["ts_patches"] <= c["hs_subpatches"] <= 16 * c["ts_patches"]
        assert c["hs_bounds_evaluated"] >= c["hs_invocations"] + c["hs_subpatches"] - c["ts_patches"]
        assert c["bin_patches"] <= c["bin_subpatches"] <= c["bin_subpatch_tile_pairs"] == c["queue_entries"]


def test_whole_units_are_tested_once_against_each_pyramid(frames):
    for frame in frames:
        c, machine = frame.counters, frame.machine
        waiting = c["cz_units_occluded"] + c["cz_stale_rejects"]
        if machine.z_feedback == "previous_frame":
            units = c["ts_patches"]
            if machine.binning == "subpatch":
                units = c["hs_subpatches"] - c["hs_subpatches_culled_frustum"]
            assert c["cz_units_tested"] == units + waiting
        elif machine.z_feedback == "two_phase":
            assert c["cz_units_tested"] >= c["cz_units_occluded"] and c["cz_stale_rejects"] == 0
        else:
            assert c["cz_units_tested"] == waiting == 0


def test_hits_are_what_is_hidden(frames):
    for frame in frames:
        c = frame.counters
        units = c["cz_units_occluded"]
        if frame.machine.z_feedback == "previous_frame":
            units += c["cz_units_occluded"] + c["cz_stale_rejects"]  # hidden in the old pyramid
        hits = sum(c[name] for name in DEFINITIONS if name.startswith("cz_hits_level_"))
        assert hits == units + c["cz_pairs_occluded"] + c["cz_triangles_occluded"]
        if frame.machine.binning == "patch":  # of a unit off the picture no cell is read
            assert c["cz_cells_read"] >= hits


def test_outlines_are_asked_where_a_cell_does_not_hide_a_hull(frames):
    moved = 0
    for frame in frames:
        c = frame.counters
        assert c["cz_outlines_missed"] <= c["cz_outlines_tested"] <= c["cz_cells_read"]
        assert c["cz_outlines_tested"] == 0 or frame.machine.occlusion_area == "hull"
        moved += c["cz_outlines_missed"] > 0
    assert moved >= 4


def test_pairs_triangles_and_blocks_have_one_fate_each(frames):
    for frame in frames:
        c, machine = frame.counters, frame.machine
        tests = machine.occlusion
        if tests and not machine.phased:
            assert c["cz_pairs_tested"] == c["queue_entries"]
        assert c["cz_pairs_occluded"] <= c["cz_pairs_tested"] <= c["queue_entries"]
        assert c["cz_blocks_occluded"] + c["cz_blocks_accepted"] <= c["cz_blocks_tested"]
        if machine.binning == "triangle":
            assert c["rs_triangles"] == c["queue_entries"] - c["cz_pairs_occluded"] and c["cz_triangles_tested"] == 0
            continue
        reached = c["su_triangles"] - c["su_culled_outside_tile"]
        assert c["rs_triangles"] == reached - c["cz_triangles_occluded"]
        if "occlusion:triangle" in tests and not machine.phased:
            assert c["cz_triangles_tested"] == reached
        if not tests:
            assert not any(value for name, value in c.items() if name.startswith("cz_"))


def test_what_is_not_hidden_is_looked_up(frames):
    for frame in frames:
        c, machine = frame.counters, frame.machine
        if machine.domain_cache == "none" or machine.binning == "triangle":
            assert c["dc_lookups"] == c["dc_hits"] == 0
            continue
        assert c["dc_lookups"] == c["queue_entries"] - c["cz_pairs_occluded"] >= c["dc_hits"]
        if machine.binning == "patch":
            shaded, rest = divmod(c["ds_invocations"], c["ts_domain_points"] // c["ts_patches"])
            assert rest == 0 and shaded == c["dc_lookups"] - c["dc_hits"]
        if machine.domain_cache == "frame" and machine.binning == "patch":
            assert c["ds_invocations"] <= c["ts_domain_points"]


def test_queue_memory_is_given_out_whole(frames):
    for frame in frames:
        c, memory = frame.counters, frame.queues.memory
        assert c["queue_bytes_written"] + c["queue_wasted_bytes"] == memory.allocated_bytes
        assert c["queue_entries"] == frame.queues.entries.sum() and c["queue_longest"] == frame.queues.entries.max()
        if c["queue_flushes"] == 0 and not frame.machine.phased:
            assert c["queue_peak_bytes"] == memory.allocated_bytes
        assert c["queue_tile_passes"] <= (1 + c["queue_flushes"] + frame.machine.phased) * frame.queues.entries.size
        spilled = 2 * 8 * frame.depth_samples.size
        assert c["om_spilled_bytes"] <= (c["queue_flushes"] + frame.machine.phased) * spilled


def test_each_of_them_moves(frames):
    moved = Counter()
    for frame in frames:
        moved.update({name: int(value > 0) for name, value in frame.counters.items()})
    ours = [name for name in DEFINITIONS if name.startswith(("cz_", "dc_", "queue_", "hs_subpatches", "bin_subpatch"))]
    assert len(ours) > 30 and not [name for name in ours if not moved[name]]


@pytest.mark.parametrize("cull", [("frustum",), CZ])
def test_queue_bytes_of_patches_do_not_grow_with_the_factor(cull, load):
    machine = Machine(cull=cull)
    of = [tiler.simulate(load("teapot", size=(160, 90), factor=f), machine).counters for f in (4, 8, 16, 32, 64)]
    for name in ("queue_bytes", "queue_entries", "queue_bytes_written", "queue_peak_bytes"):
        assert len({c[name] for c in of}) == 1 and of[0][name] > 0
    assert of[-1]["ts_domain_points"] > 100 * of[0]["ts_domain_points"]
