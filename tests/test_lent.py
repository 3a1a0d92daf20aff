"""Memory of pictures: nobody gets what somebody still holds, and what is given back is used again."""

import gc

import numpy as np

from tiler import lent, simulate
from tiler.config import Machine
from tiler.scene import load_scene


def test_memory_comes_back_with_the_last_view_and_not_before():
    lent._idle.clear()
    first = lent.lend((300, 400), np.float32)
    first[:] = 1.0
    view, place = first[5:].reshape(-1)[::2], first.__array_interface__["data"][0]
    assert place % lent.ALIGNMENT == 0 and first.flags.writeable and type(first) is np.ndarray
    del first
    gc.collect()
    other = lent.lend((300, 400), np.float32)
    other[:] = 2.0
    assert (view == 1.0).all() and not np.shares_memory(view, other)
    del view
    gc.collect()
    again = lent.lend((400, 299), np.int32)
    assert again.__array_interface__["data"][0] == place


def test_little_is_kept(monkeypatch):
    lent._idle.clear()
    monkeypatch.setattr(lent, "MOST_BYTES", 300_000)
    held = [lent.lend((100_000,), np.uint8) for _ in range(5)]
    del held
    gc.collect()
    assert sum(len(pieces) for pieces in lent._idle.values()) <= 2
    large = lent.lend((500_000,), np.uint8)
    del large
    gc.collect()
    assert all(size <= 300_000 for size in lent._idle)
    assert lent.lend((0, 4), np.int64).shape == (0, 4)


def test_frames_that_are_held_stay_as_they_are():
    scene = load_scene("teapot", size=(64, 48))
    machine = Machine(binning="triangle")
    kept = simulate(scene, machine)
    color, depth = kept.color.copy(), kept.depth_samples.copy()
    for frame in (1, 2):
        simulate(scene, machine, frame=frame)
    assert (kept.color == color).all() and (kept.depth_samples == depth).all()
