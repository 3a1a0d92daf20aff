"""What a frame leaves to the next one: drawn for the purpose or handed on by a run, the same bits."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tiler
from tests.scenes import sliced
from tiler import machine as machine_module
from tiler.animation import render_to_folder
from tiler.config import Machine
from tiler.history import Reel
from tiler.host import Host
from tiler.machine import last_frame

CZ = ("frustum", "occlusion")
ALL = (*CZ, "occlusion:triangle", "occlusion:block")
PHASED = [
    Machine(tile=16, cull=CZ, z_feedback="two_phase"),
    Machine(tile=16, cull=ALL, z_feedback="previous_frame", occlusion_area="hull", coarse_z_block=4, overlap="exact"),
    Machine(tile=32, cull=CZ, z_feedback="previous_frame", queue_order="front_to_back", bounds="tpatch"),
    Machine(tile=8, binning="subpatch", subpatch_extent=4.0, cull=ALL, z_feedback="two_phase", domain_cache="frame"),
    Machine(tile=8, binning="subpatch", subpatch_extent=4.0, cull=CZ, z_feedback="previous_frame"),
    Machine(
        tile=16, cull=("backface:ncone", "occlusion"), z_feedback="two_phase", queue_pool=900, queue_policy="flush"
    ),
]


@pytest.fixture
def drawn(monkeypatch) -> list[float]:
    """Filled with the numbers of the frames for which the last one is drawn."""
    numbers: list[float] = []

    def draw(scene, plain, number, host, shared):
        numbers.append(number)
        return last_frame(scene, plain, number, host, shared)

    monkeypatch.setattr(machine_module, "last_frame", draw)
    return numbers


@pytest.mark.parametrize("k", range(len(PHASED)))
def test_a_run_is_its_frames_one_by_one(k, load, drawn):
    machine = PHASED[k]
    other = (
        sliced(load("waves", size=(70, 45), factor=3, samples=4))
        if k % 2
        else load("creature_small", size=(70, 45), factor=2)
    )
    for scene in (load("colonnade", size=(70, 45), factor=2), other):
        reel = Reel()
        for number in (0, 1, 2, 3.5, 4.5):
            drawn.clear()
            frame = tiler.simulate(scene, machine, frame=number, threads=2, reel=reel)
            assert drawn == ([number] if number in (0, 3.5) else [])
            alone = tiler.simulate(scene, machine, frame=number, threads=1)
            assert dict(frame.counters) == dict(alone.counters)
            assert np.array_equal(frame.color, alone.color)
            for name, tiles in alone.tiles.items():
                assert np.array_equal(frame.tiles[name], tiles), name
            kept = reel.find(scene, machine, number + 1)
            assert kept is not None
            with Host(1) as host:
                plain = Machine(bounds=machine.bounds, cull=machine.hull_cull)
                expected = last_frame(scene, plain, number + 1, host)
            assert np.array_equal(kept.depth.view(np.uint32), expected.depth.view(np.uint32))
            assert np.array_equal(kept.seen, expected.seen) and kept.seen.any()


def test_nothing_else_is_handed_on(load):
    scene, machine = load("teapot", size=(40, 24), factor=2), PHASED[0]
    reel = Reel()
    assert reel.find(scene, machine, 0) is None and reel.find(scene, machine, 1) is None
    tiler.simulate(scene, machine, frame=4, reel=reel)
    assert reel.find(scene, machine, 5) is not None
    for number in (0, 3, 4, 4.5, 6):
        assert reel.find(scene, machine, number) is None
    assert reel.find(replace(scene, name="another"), machine, 5) is None
    assert reel.find(scene, Machine(bounds="tpatch", cull=CZ, z_feedback="two_phase"), 5) is None
    assert reel.find(scene, Machine(cull=("occlusion",), z_feedback="two_phase"), 5) is None
    tiler.simulate(scene, machine, frame=-0.5, reel=reel)
    assert reel.find(scene, machine, 0.5) is None  # a number below 1 is the first of a run
    tiler.simulate(scene, Machine(), frame=5, reel=reel)  # keeps no submit numbers
    assert reel.find(scene, machine, 6) is None


def test_an_animation_draws_no_frame_twice(load, drawn, tmp_path):
    scene, machine = load("colonnade", size=(70, 45), factor=2), PHASED[1]
    records = render_to_folder(scene, machine, [3, 4, 5, 7, 8], tmp_path, threads=1)
    assert drawn == [3, 7]
    drawn.clear()
    for number in (3, 5, 8):
        alone = tiler.simulate(scene, machine, frame=number, threads=1)
        assert records[(3, 4, 5, 7, 8).index(number)]["counters"] == dict(alone.counters)
    drawn.clear()
    (tmp_path / "counters_0005.json").unlink()  # an interrupted run: its last frame is on disk, not in memory
    again = render_to_folder(scene, machine, [3, 4, 5, 7, 8], tmp_path, threads=1)
    assert drawn == [5]
    same = [json.dumps(record["counters"]) for record in records]
    assert [json.dumps(record["counters"]) for record in again] == same
