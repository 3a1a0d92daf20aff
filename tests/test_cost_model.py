"""The cost model: by hand, identities, monotonicity, break-even, and files that are refused."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

import tiler
from tests.test_cli import tiler as run_tiler
from tiler.config import Machine
from tiler.cost_model import break_even, cost, cost_model_names, crossing, load_cost_model, needed_bound
from tiler.counters import DEFINITIONS
from tiler.errors import TilerError

HEAD = 'title = "t"\nsource = "s"\n'
SMALL = """
domain_shader_cycles = 10.0
[bound]
cbox = 1.5
[[stage]]
name = "shaders"
units = 4
bounds = true
[stage.cycles]
ds_invocations = 10.0
ps_invocations = 2.0
[[stage]]
name = "binning"
[stage.cycles]
queue_entries = 3.0
"""


def counted(**values: int) -> dict[str, int]:
    return dict.fromkeys(DEFINITIONS, 0) | values


@pytest.fixture
def small(tmp_path: Path) -> str:
    file = tmp_path / "small.toml"
    file.write_text(HEAD + SMALL)
    return str(file)


def test_a_frame_by_hand(small):
    """Shaders: 100 x 10 + 50 x 2 + 8 bounds of 15, over 4 units; binning: 70 x 3 on one."""
    c = counted(ds_invocations=100, ps_invocations=50, hs_bounds_evaluated=8, queue_entries=70)
    report = cost(c, Machine(), small)
    shaders, binning = report.stages
    assert (shaders.events, shaders.work, shaders.cycles) == (158, 1220, 305)
    assert (binning.events, binning.work, binning.cycles) == (70, 210, 210)
    assert (report.bottleneck, report.frame_cycles, report.total_cycles) == ("shaders", 305, 515)
    assert shaders.share == 305 / 515 and binning.share == 210 / 515
    assert (report.domain_shader_equivalents, report.bounding_equivalents) == (112, 12)
    baseline = cost(c, Machine(binning="triangle", cull=()), small)  # bounds nothing
    assert (baseline.stages[0].events, baseline.stages[0].work, baseline.domain_shader_equivalents) == (150, 1100, 100)
    assert cost(counted(), Machine(), small).total_cycles == 0
    assert all(stage.share == 0 for stage in cost(counted(), Machine(), small).stages)


def test_published_weights():
    """Munkberg et al. 2010, Table 1."""
    assert dict(load_cost_model("munkberg2010").bound) == {
        "cbox": 1.5, "obbtex": 2.7, "tpatch": 4.5, "npatch": 11.0, "taylor": 275.0,
    }  # fmt: skip
    report = cost(counted(ds_invocations=1000, hs_bounds_evaluated=10), Machine(bounds="tpatch"))
    assert report.domain_shader_equivalents == 1045 == report.total_cycles


def test_which_machines_bound():
    assert needed_bound(Machine(binning="triangle", cull=())) is None
    assert needed_bound(Machine(binning="triangle", cull=("backface:tessellation_safe",))) is None
    assert needed_bound(Machine(binning="triangle", cull=("frustum",), bounds="tpatch")) == "tpatch"
    assert needed_bound(Machine(cull=())) == "cbox"


@pytest.mark.parametrize("name", cost_model_names())
def test_shares_and_monotonicity(name):
    model = load_cost_model(name)
    rng = np.random.default_rng(3)
    for _ in range(50):
        c = counted(**{counter: int(rng.integers(0, 10_000)) for counter in DEFINITIONS})
        report = cost(c, Machine(), name)
        assert sum(stage.share for stage in report.stages) == pytest.approx(1, abs=1e-12)
        assert report.total_cycles == pytest.approx(sum(stage.cycles for stage in report.stages))
        assert report.frame_cycles == max(stage.cycles for stage in report.stages)
        assert report.bottleneck in [s.name for s in report.stages if s.cycles == report.frame_cycles]
        for stage in model.stage:
            for counter in stage.cycles:
                more = cost(c | {counter: c[counter] + 1000}, Machine(), name)
                assert more.total_cycles > report.total_cycles and more.frame_cycles >= report.frame_cycles
    assert len(model.source) > 40


def test_every_bound_has_a_cost_in_a_model():
    from pipeline.bounds import BOUNDS

    assert set(load_cost_model("wide").bound) == set(BOUNDS)


def test_wide_agrees_with_the_counted_operations():
    from tiler import costs

    counts = costs.count_operations(1)
    shader = counts["domain shader, map"].total
    for name, invocations in load_cost_model("wide").bound.items():
        assert counts[name].total / shader == pytest.approx(invocations, rel=0.05), name


def test_crossing_by_hand():
    assert crossing([2, 4, 8], [10, 20, 40], [14, 20, 30]) == 4
    assert crossing([2, 4, 8], [10, 20, 40], [14, 22, 36]) == 4 + 4 * 2 / 6
    assert crossing([2, 4, 8], [10, 20, 40], [9, 19, 39]) == 2
    assert crossing([2, 4, 8], [10, 20, 40], [9, 19, 40]) is None
    assert crossing([2, 4, 8], [10, 20, 40], [9, 21, 39]) == 4 + 4 * 1 / 2  # where it stays below
    assert crossing([4], [1], [0]) == 4 and crossing([4], [1], [1]) is None


def test_break_even_is_what_the_frames_say(load):
    scene = load("waves", size=(104, 60), edge_pixels=9.0)  # replaced by fixed factors
    machines = {
        "baseline": Machine(binning="triangle", cull=()),
        "frame": Machine(domain_cache="frame"),
        "again": Machine(tile=8),
    }
    done = []
    found = break_even(scene, machines, (1, 2, 4), progress=done.append)
    assert done == list(range(1, 10)) and found.factor["baseline"] is None and found.factor["again"] is None
    for k, factor in enumerate((1, 2, 4)):
        fixed = load("waves", size=(104, 60), factor=factor)
        for name, machine in machines.items():
            assert found.reports[name][k] == cost(tiler.simulate(fixed, machine).counters, machine)
    base, frame = found.costs("baseline"), found.costs("frame")
    assert frame[0] > base[0] and frame[2] < base[2]
    pays = found.factor["frame"]
    k = next(k for k, (a, b) in enumerate(itertools.pairwise((1, 2, 4))) if a <= pays < b)
    part = (pays - (1, 2, 4)[k]) / ((1, 2, 4)[k + 1] - (1, 2, 4)[k])
    mix = [values[k] * (1 - part) + values[k + 1] * part for values in (base, frame)]
    assert mix[0] == pytest.approx(mix[1])


@pytest.mark.parametrize("factors", [(), (0,), (65,), (4, 2), (2, 2), (float("nan"),)], ids=str)
def test_bad_factors_are_named(factors, load):
    with pytest.raises(TilerError, match=r"factors: .* is not allowed; allowed: rising numbers above 0"):
        break_even(load("teapot", size=(32, 32)), {"a": Machine()}, factors)


def test_a_bound_without_a_cost_is_named_before_anything_is_drawn(load):
    with pytest.raises(
        TilerError, match=r"cost: model 'munkberg2010' has no cost for bounds 'max_displacement'; .*cbox"
    ):
        break_even(load("teapot", size=(32, 32)), {"a": Machine(bounds="max_displacement")}, (1, 2))


BAD = {
    "counter": (
        SMALL.replace("queue_entries", "queue_entry"),
        ["stage[1].cycles.queue_entry: unknown counter", "entries"],
    ),
    "bound": (SMALL.replace("cbox", "cbx"), ["bound.cbx: unknown bound", "did you mean 'cbox'"]),
    "negative": (SMALL.replace("3.0", "-3.0"), ["stage[1].cycles.queue_entries: -3", "from 0 to 1e+09"]),
    "no units": (SMALL.replace("units = 4", "units = 0"), ["stage[0].units: 0", "above 0"]),
    "twice": (SMALL.replace('"binning"', '"shaders"'), ["stage[1].name: 'shaders' is named twice"]),
    "no bounds": (SMALL.replace("bounds = true", "bounds = false"), ["stage: bounds must be true in one stage"]),
    "unknown key": (SMALL.replace("units", "unit"), ["stage[0].unit: unknown key", "units"]),
    "NaN": (SMALL.replace("3.0", "nan"), ["stage[1].cycles.queue_entries: nan is not allowed"]),
    "text": (SMALL.replace("1.5", '"1.5"'), ['bound.cbox: "1.5" is not allowed']),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_say_where(name, tmp_path: Path):
    text, said = BAD[name]
    file = tmp_path / "bad.toml"
    file.write_text(HEAD + text)
    with pytest.raises(TilerError) as caught:
        cost(counted(), Machine(), str(file))
    for words in [*said, "bad.toml"]:
        assert words in str(caught.value), str(caught.value)
    with pytest.raises(TilerError, match=r"cost: 'munkberg' is unknown; did you mean 'munkberg2010'\?"):
        cost(counted(), Machine(), "munkberg")


def test_commands(tmp_path: Path):
    options = (
        "waves",
        "--size",
        "96x64",
        "--machine",
        "binning=triangle,cull=none",
        "--machine",
        "bounds=npatch,domain_cache=frame",
    )
    done = run_tiler("cost", *options, "--factors", "1,4", "--json", "-", cwd=tmp_path)
    result = json.loads(done.stdout)
    assert result.keys() == {"scene", "model", "measure", "factors", "machines"}
    first, second = result["machines"]
    assert first["break_even"] is None and 1 < second["break_even"] < 4
    assert [len(entry["cost"]) for entry in (first, second)] == [2, 2]
    text = run_tiler("cost", *options, "--factors", "1,4", "-q", cwd=tmp_path).stdout
    assert f"{second['break_even']:.2f}" in text.splitlines()[-1]
    done = run_tiler("compare", *options, "--factor", "4", "--cost", "wide", "--json", "-", cwd=tmp_path)
    for entry in json.loads(done.stdout)["machines"]:
        assert sum(stage["share"] for stage in entry["cost"]["stages"]) == pytest.approx(1)
    assert "bottleneck" in run_tiler("compare", *options, "--factor", "4", "--cost", "wide", cwd=tmp_path).stdout
    done = run_tiler("compare", *options, "--cost", "narrow", cwd=tmp_path)
    assert done.returncode == 2 and "'narrow' is unknown" in done.stderr and done.stdout == ""
