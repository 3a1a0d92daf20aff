"""Timelines: the cost model's work and no other, slices that nest and follow each other, files that Perfetto reads."""

import gzip
import json
from collections import defaultdict

import numpy as np
import pytest

import tiler
from tiler.cost_model import cost, load_cost_model
from tiler.errors import TilerError
from tiler.trace.record import record_frame
from tiler.trace.timeline import CORES, FRONT_END, QUEUES, make_groups
from tiler.trace.work import parts_of, share_work, visit_events

MACHINES = {
    "patch": tiler.Machine(tile=16, cores=3),
    "triangle": tiler.Machine(tile=16, binning="triangle", cull=("frustum", "occlusion"), tile_walk="morton"),
    "subpatch": tiler.Machine(
        tile=16, binning="subpatch", cull=("frustum", "occlusion"), domain_cache="lru:4", cores=2
    ),
    "flushes": tiler.Machine(
        tile=16, binning="triangle", queue_model="bins128", queue_pool=8 * 1024, queue_policy="flush"
    ),
}
ALL_COUNTERS = """
title = "everything costs something"
source = "made for a test"
domain_shader_cycles = 7.0
[bound]
cbox = 2.0
[[stage]]
name = "shaders"
units = 3
bounds = true
[stage.cycles]
vs_invocations = 1.5
ds_invocations = 7.0
ps_invocations = 2.0
[[stage]]
name = "caches and tests"
units = 2
[stage.cycles]
dc_lookups = 1.0
dc_hits = 0.5
cz_pairs_tested = 2.0
cz_cells_read = 0.25
c_invocations = 1.0
su_triangles = 1.0
[[stage]]
name = "output"
[stage.cycles]
om_samples_failed = 1.0
om_samples_visible = 0.5
om_spilled_bytes = 0.125
queue_bytes_read = 0.25
queue_bytes_written = 0.25
queue_peak_bytes = 0.01
"""


@pytest.fixture(scope="module")
def scene(load):
    return load("teapot", size=(96, 64), factor=3)


def traced(scene, machine, file, **arguments):
    tiler.write_trace(scene, machine, file, threads=2, **arguments)
    return json.loads(file.read_text())


def slices(trace):
    return [event for event in trace["traceEvents"] if event["ph"] == "X"]


def interval(event):
    return round(event["ts"] * 1e3), round(event["ts"] * 1e3) + round(event["dur"] * 1e3)


def nested(events):
    """(slice, its tile or None) in order; asserts that stages lie in their patch, patches in their tile, and that slices of a
    kind follow each other in time."""
    found = []
    for of in by_thread(events).values():
        tile, patch, ends = None, None, defaultdict(int)
        for event in of:
            kind = "stage" if "stage" in event["args"] else "tile" if "x" in event["args"] else "patch"
            begin, end = interval(event)
            assert ends[kind] <= begin <= end
            ends[kind] = end
            if kind == "tile":
                tile, patch = event, None
            elif tile is not None:
                assert interval(tile)[0] <= begin and end <= interval(tile)[1]
            if kind == "patch":
                patch = event
            elif kind == "stage" and patch is not None and begin < interval(patch)[1]:
                assert end <= interval(patch)[1]
            found.append((event, tile))
    return found


def by_thread(events):
    found = defaultdict(list)
    for event in events:
        found[event["pid"], event["tid"]].append(event)
    return found


@pytest.mark.parametrize("name", MACHINES)
def test_slices_add_up_to_the_work_of_the_cost_model(scene, name, tmp_path):
    trace = traced(scene, MACHINES[name], tmp_path / "t.json")
    simulated = tiler.simulate(scene, MACHINES[name])
    assert trace["otherData"]["counters"] == dict(simulated.counters)  # the second drawing is the first
    report = cost(simulated.counters, MACHINES[name], "wide")
    work, time = defaultdict(float), defaultdict(float)
    for event in slices(trace):
        if "stage" in event["args"]:
            stage = event["args"]["stage"]
            work[stage] += event["args"]["work_cycles"]
            time[stage] += event["dur"] * 1e3 / (MACHINES[name].cores if event["pid"] == CORES else 1)
    for stage in report.stages:
        assert work[stage.name] == pytest.approx(stage.work, rel=1e-12)
        assert time[stage.name] == pytest.approx(stage.cycles, abs=len(slices(trace)))  # each rounded to a nanosecond
    assert set(work) <= {stage.name for stage in report.stages}


@pytest.mark.parametrize("name", MACHINES)
def test_every_counter_can_be_weighed(scene, name, tmp_path):
    """Whatever a model weighs is somewhere, and only once; what a tile knows is not charged to the front end."""
    file = tmp_path / "all.toml"
    file.write_text(ALL_COUNTERS)
    recording = record_frame(scene, MACHINES[name], 0, 1)
    work = share_work(recording, str(file))
    report = cost(recording.counters, MACHINES[name], str(file))
    assert (work.entry >= 0).all() and (work.visit >= 0).all() and (work.once >= -1e-6).all()
    sums = work.once + sum(work.front.values()) + work.visit.sum(axis=0) + work.entry.sum(axis=0)
    for stage in report.stages:
        mine = [k for k, part in enumerate(work.parts) if part.stage == stage.name]
        assert sums[mine].sum() == pytest.approx(stage.work, rel=1e-12)
    failed = visit_events(recording, "om_samples_failed", work.key)
    assert failed.sum() == recording.counters["om_samples_failed"]


@pytest.mark.parametrize("name", MACHINES)
def test_slices_nest_and_cores_have_their_tiles(scene, name, tmp_path):
    machine = MACHINES[name]
    trace = traced(scene, machine, tmp_path / "t.json")
    simulated = tiler.simulate(scene, machine)
    entries, ds = np.zeros_like(simulated.queues.entries), np.zeros_like(simulated.queues.entries)
    inner = defaultdict(int)
    for event, tile in nested(slices(trace)):
        if event["pid"] == FRONT_END:
            assert tile is None and "stage" in event["args"]
        elif event is tile:
            y, x = event["args"]["y"], event["args"]["x"]
            entries[y, x] += event["args"]["entries"]
            ds[y, x] += event["args"].get("ds_invocations", 0)
            inner[id(event)] += event["args"]["entries"]
        elif "stage" not in event["args"]:  # a patch, in its tile
            assert event["name"] == f"patch {event['args']['patch']}"
            inner[id(tile)] -= event["args"]["entries"]
    assert np.array_equal(entries, simulated.queues.entries) and set(inner.values()) == {0}
    if machine.binning != "triangle":
        assert np.array_equal(ds, simulated.tiles["ds_invocations"])
    binned = {event["args"]["stage"]: interval(event)[1] for event in slices(trace) if event["pid"] == FRONT_END}
    if name != "flushes":  # sort-middle: no tile begins before all is binned
        assert min(interval(event)[0] for event in slices(trace) if event["pid"] == CORES) >= max(binned.values())
    assert {event["tid"] for event in slices(trace) if event["pid"] == CORES} <= set(range(1, machine.cores + 1))
    passes = {event["args"]["pass"] for event in slices(trace) if "pass" in event["args"]}
    assert passes == set(range(1, simulated.counters["queue_flushes"] + 2))
    assert (len(passes) > 1) == (name == "flushes")


def test_names_and_counter_tracks(scene, tmp_path):
    machine = MACHINES["flushes"]
    trace = traced(scene, machine, tmp_path / "t.json")
    simulated = tiler.simulate(scene, machine)
    names = {(e["name"], e["pid"], e["tid"]): e["args"] for e in trace["traceEvents"] if e["ph"] == "M"}
    assert names["process_name", FRONT_END, 0] == {"name": "front end"}
    assert names["thread_name", CORES, machine.cores] == {"name": f"core {machine.cores - 1}"}
    used = {(e["pid"], e["tid"]) for e in slices(trace)}
    assert used <= {(pid, tid) for kind, pid, tid in names if kind == "thread_name"}
    tracks = defaultdict(list)
    for event in trace["traceEvents"]:
        if event["ph"] == "C":
            assert event["pid"] == QUEUES
            tracks[event["name"]].append(next(iter(event["args"].values())))
    assert set(tracks) == {"queue entries", "pool bytes", *(f"queue of core {c}" for c in range(machine.cores))}
    for values in tracks.values():
        assert min(values) == 0 and values[-1] == 0 and max(values) > 0
    assert max(tracks["pool bytes"]) <= simulated.counters["queue_peak_bytes"] <= machine.queue_pool
    assert max(v for c in range(machine.cores) for v in tracks[f"queue of core {c}"]) <= simulated.queues.entries.max()
    times = [event["ts"] for event in trace["traceEvents"] if "ts" in event]
    assert times == sorted(times)
    assert "1000 cycles" in trace["otherData"]["clock"] and trace["otherData"]["cost_model"] == "wide"


@pytest.mark.parametrize("most", [100, 300])
def test_size_is_bounded_and_the_sums_stay(scene, tmp_path, most):
    """With few slices allowed patches, then tiles, share one; the work is the same."""
    machine = MACHINES["patch"]
    whole, small = (traced(scene, machine, tmp_path / f"{m}.json", most=m) for m in (200_000, most))
    assert len(slices(small)) < min(len(slices(whole)), 1.5 * most)

    def work(trace):
        return sum(e["args"]["work_cycles"] for e in slices(trace) if "stage" in e["args"])

    assert work(small) == pytest.approx(work(whole), rel=1e-12)
    assert any("more patches" in e["name"] or "tiles" in e["name"] for e in slices(small))


def test_groups_by_hand():
    visit = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1])
    unit = np.array([5, 5, 7, 7, 7, 8, 7, 9, 9])
    every = make_groups(visit, unit, 10_000)
    assert (
        list(every.first) == [0, 2, 4, 5, 6, 7, 9] and list(every.visit) == [0, 0, 1, 1, 1, 1] and not every.more.any()
    )
    few = make_groups(visit, unit, 16 + 4 * 4)  # room for four groups: two of each visit
    assert list(few.first) == [0, 2, 4, 5, 9] and list(few.more) == [0, 0, 0, 3]
    assert list(make_groups(visit, unit, 16).more) == [2, 4]
    assert list(make_groups(visit[:0], unit[:0], 16).first) == [0]


def test_compressed_and_repeatable(scene, tmp_path):
    one, two, plain = tmp_path / "a.json.gz", tmp_path / "b.json.gz", tmp_path / "c.json"
    for file, threads in ((one, 1), (two, 2), (plain, 1)):
        tiler.write_trace(scene, MACHINES["patch"], file, threads=threads)
    assert one.read_bytes() == two.read_bytes() and gzip.decompress(one.read_bytes()) == plain.read_bytes()


def test_a_frame_without_a_patch(load, tmp_path):
    from tests.scenes import flat_patch, patch_scene

    away = patch_scene([flat_patch(50.0, 50.0, 51.0, 51.0)])
    trace = traced(away, tiler.Machine(), tmp_path / "t.json")
    assert {e["pid"] for e in slices(trace)} == {FRONT_END}


def test_parts_are_named_in_pipeline_order():
    names = [part.name for part in parts_of(load_cost_model("wide"))]
    assert names == [
        "vertex shader", "hull shader", "bounds", "binning", "memory", "domain shader", "tessellator", "clip and set-up",
        "rasterizer", "output merger", "pixel shader",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"file": "t.txt"}, r"trace: 't.txt' is not allowed; allowed: a file that ends in .json or .json.gz"),
        ({"file": "no/such/folder/t.json"}, "a file in a folder that can be written"),
        ({"model": "wyde"}, "did you mean 'wide'"),
        ({"most": 3}, "most: 3 is not allowed; allowed: a whole number from 100"),
        ({"frame": float("nan")}, "frame: nan is not allowed"),
    ],
)
def test_refused(scene, arguments, words):
    file = arguments.pop("file", "t.json")
    with pytest.raises(TilerError, match=words):
        tiler.write_trace(scene, None, file, **arguments)


def test_command(tmp_path):
    from tests.test_cli import SMALL
    from tests.test_cli import tiler as run_tiler

    done = run_tiler("render", "teapot", *SMALL, "--trace", "t.json.gz", "--trace-model", "munkberg2010", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    trace = json.loads(gzip.decompress((tmp_path / "t.json.gz").read_bytes()))
    assert trace["otherData"]["cost_model"] == "munkberg2010" and slices(trace)
    refused = run_tiler("render", "teapot", "--frames", "0..3", "--trace", "t.json", cwd=tmp_path)
    assert refused.returncode == 2 and "trace: 4 frames are asked for; allowed: one" in refused.stderr
