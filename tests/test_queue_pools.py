"""Queue models in the machine: same picture with any model, pool and policy; counters that follow; clear errors."""

from pathlib import Path

import numpy as np
import pytest

import tiler
from tests.test_same_picture import assert_same_picture, bits
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.queue_models import load_queue_model, queue_model_names

QUEUE_COUNTERS = {
    "queue_bytes_written", "queue_bytes_read", "queue_peak_bytes", "queue_chunks", "queue_wasted_bytes", "queue_flushes",
    "queue_grows", "queue_tile_passes", "om_spilled_bytes",
}  # fmt: skip


@pytest.mark.parametrize("binning", ["triangle", "patch"])
@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("name", ["teapot", "waves"])
def test_a_full_pool_changes_no_pixel(name, samples, binning, load):
    scene = load(name, size=(104, 60), factor=5, samples=samples)
    reference = tiler.simulate(scene, Machine(binning=binning, tile=16))
    pool = reference.counters["queue_peak_bytes"] // 5
    for policy in ("flush", "grow"):
        machine = Machine(binning=binning, tile=16, queue_pool=pool, queue_policy=policy)
        one, two = (tiler.simulate(scene, machine, threads=n) for n in (1, 2))
        assert_same_picture(one, reference, machine)
        assert one.counters == two.counters
        for counter, value in reference.counters.items():
            assert one.counters[counter] == value or counter in QUEUE_COUNTERS, (counter, policy)
        c = one.counters
        if policy == "flush":
            assert c["queue_flushes"] >= 4 and c["queue_grows"] == 0
            assert c["queue_peak_bytes"] <= pool and c["queue_tile_passes"] > reference.counters["queue_tile_passes"]
            assert c["om_spilled_bytes"] > 0
        else:
            assert c["queue_grows"] == 3 and c["queue_flushes"] == c["om_spilled_bytes"] == 0
            assert c["queue_peak_bytes"] == reference.counters["queue_peak_bytes"]


@pytest.mark.parametrize("binning", ["triangle", "patch"])
@pytest.mark.parametrize("model", queue_model_names())
def test_models_count_and_draw_the_same(model, binning, load):
    scene = load("spikelog", size=(104, 60), factor=5)
    machine = Machine(binning=binning, queue_model=model)
    assert machine.tile == load_queue_model(model).tile and Machine(queue_model=model, tile=128).tile == 128
    frame, ideal = tiler.simulate(scene, machine), tiler.simulate(scene, Machine(binning=binning, tile=machine.tile))
    assert np.array_equal(frame.color, ideal.color) and np.array_equal(bits(frame.depth), bits(ideal.depth))
    c, least = frame.counters, ideal.counters
    assert c["queue_bytes"] == least["queue_bytes"] == least["queue_peak_bytes"] == least["queue_bytes_written"]
    assert c["queue_peak_bytes"] == c["queue_bytes_written"] + c["queue_wasted_bytes"]
    assert (c["queue_wasted_bytes"] > 0) == (model != "ideal")
    memory = frame.queues.memory
    assert memory.model == model and memory.tile_bytes.shape == frame.queues.entries.shape
    assert memory.tile_passes.sum() == np.count_nonzero(frame.queues.entries) == c["queue_tile_passes"]
    tiles_x = frame.queues.entries.shape[1]
    assert frame.queues.entries[divmod(memory.longest_tile, tiles_x)] == c["queue_longest"]


def test_a_pool_that_may_not_overflow_names_the_patch(load):
    scene = load("teapot", size=(104, 60), factor=5)
    needed = tiler.simulate(scene).counters["queue_peak_bytes"]
    tiler.simulate(scene, Machine(queue_pool=needed, queue_policy="fail"))
    said = rf"machine.queue_pool: {needed - 1} is full at patch 31: with it the queues need {needed} bytes; allowed: a larger"
    with pytest.raises(TilerError, match=said):
        tiler.simulate(scene, Machine(queue_pool=needed - 1, queue_policy="fail"))


@pytest.mark.parametrize(
    "fields, said",
    [
        ({"queue_pool": 0}, ["machine.queue_pool", "0", "allowed: 1 to"]),
        ({"queue_pool": -5}, ["machine.queue_pool", "-5"]),
        ({"queue_pool": 2**40 + 1}, ["machine.queue_pool", "1099511627777"]),
        ({"queue_pool": 1.5}, ["machine.queue_pool", "1.5", "integer"]),
        ({"queue_policy": "flsh"}, ["machine.queue_policy", "'flsh'", "'grow', 'flush' or 'fail'"]),
        ({"queue_model": "blocks"}, ["machine.queue_model", "'blocks'", "did you mean 'blocks"]),
        ({"queue_model": None}, ["machine.queue_model", "None"]),
        ({"queue_model": "absent.toml"}, ["machine.queue_model", "absent.toml", "cannot be read"]),
    ],
    ids=str,
)
def test_bad_fields_are_named(fields, said):
    with pytest.raises(TilerError) as caught:
        Machine(**fields)
    for words in said:
        assert words in str(caught.value)


BAD_FILES = {
    "nothing": ("", ["title: is missing", "level"]),
    "not TOML": ("[[level]\n", ["is not a TOML file"]),
    "unknown key": ("{}[[level]]\nsid = 1\n", [":4: level[0].sid: unknown key", "side"]),
    "two sizes": (
        "{}[[level]]\nchunk_bytes = 64\nchunk_entries = 8\n",
        ["level[0].chunk_bytes", "allowed: one of the two"],
    ),
    "no room": (
        "{}[[level]]\nchunk_bytes = 8\nlink_bytes = 1\n",
        ["level[0].chunk_bytes: 8 has no room", "at least 9"],
    ),
    "links of nothing": ("{}[[level]]\nlink_bytes = 1\n", ["level[0].link_bytes", "belongs to chunks"]),
    "two flat levels": ("{}[[level]]\n[[level]]\nside = 2\n", ["level", "one with scheme = flat"]),
    "sides": ('{}scheme = "cascade"\n[[level]]\n[[level]]\nside = 1\n', ["level[1].side: 1", "at least 2"]),
    "not a power of two": (
        '{}scheme = "cascade"\n[[level]]\n[[level]]\nside = 6\n',
        ["level[1].side: 6", "power of two"],
    ),
    "coarse alone": ("{}[[level]]\nside = 2\n", ["level[0].side: 2", "1 for the first level"]),
    "tile": ("{}tile = 48\n[[level]]\n", ["tile: 48", "power of two"]),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_say_where(name, tmp_path: Path):
    text, said = BAD_FILES[name]
    file = tmp_path / "model.toml"
    file.write_text(text.replace("{}", 'title = "t"\nsource = "s"\n'))
    with pytest.raises(TilerError) as caught:
        load_queue_model(str(file))
    for words in [*said, "model.toml"]:
        assert words in str(caught.value), str(caught.value)


def test_a_file_of_ones_own(tmp_path: Path, load):
    file = tmp_path / "mine.toml"
    file.write_text('title = "mine"\nsource = "invented"\n[[level]]\nchunk_entries = 10\n')
    scene = load("teapot", size=(104, 60), factor=5)
    c = tiler.simulate(scene, Machine(queue_model=str(file))).counters
    assert c["queue_chunks"] > 0 and c["queue_peak_bytes"] == 40 * c["queue_chunks"]


def test_every_preset_states_its_source():
    assert set(queue_model_names()) == {"ideal", "blocks29", "blocks64", "bins128", "hierarchy16"}
    for name in queue_model_names():
        model = load_queue_model(name)
        assert len(model.source) > 40 and model.title
