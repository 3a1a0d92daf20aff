"""What the bench computes: tables add up, its scene is closed, both renderers draw one picture. No test looks at seconds."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pipeline.culling import CLASSIFIERS
from pipeline.culling.backface import Facing
from tests.gl import llvmpipe as gl
from tiler import machine as machine_module
from tiler.bench import facts, peer, report, stages, startup
from tiler.bench.limits import LANES, multiply_add
from tiler.bench.llvmpipe import POINTS, Drawing, Renderer, _split, drawing_of
from tiler.bench.run import Limits, Results
from tiler.bench.scaling import Point, linear_fit, scaling, triangle_fit
from tiler.bench.scenes import bench_scene, torus, with_factor
from tiler.bench.stages import BASELINE, Stage, frame_stages, hull_stage, measure_stages, timed_frame
from tiler.bench.stopwatch import timing
from tiler.bench.tables import Table, aligned, markdown
from tiler.bench.views import QUICK_VIEWS, VIEW_PATCHES, Views, measure_views, view_scene
from tiler.cli import app
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.reproduce.loop2011.eyes import PAPER
from tiler.reproduce.plain import ball_of
from tiler.scene import load_scene
from tiler.simulation import simulate

SIZE = (96, 64)


def test_torus_is_closed_and_seen_whole():
    scene = torus(100, 2, SIZE)
    cp = scene.control_points.reshape(25, 4, 4, 4, 4)
    assert np.array_equal(cp[:, :, 3], np.roll(cp[:, :, 0], -1, axis=0))
    assert np.array_equal(cp[:, :, :, 3], np.roll(cp[:, :, :, 0], -1, axis=1))
    frame = simulate(scene, BASELINE)
    assert frame.counters["c_cut"] == 0 == frame.counters["c_culled_outside"]
    half = frame.counters["su_culled_face"] / frame.counters["ts_triangles"]
    assert 0.3 < half < 0.7, "about half of a closed surface faces away"


@pytest.mark.parametrize("patches", [100, 3753, 20_000])
def test_torus_has_about_as_many_patches_as_asked(patches):
    assert abs(torus(patches, 1, SIZE).num_patches / patches - 1) < 0.05


def test_stopwatch_adds_up_and_leaves_no_trace(monkeypatch):
    monkeypatch.setattr(machine_module, "draws_in_regions", lambda machine: False)
    scene = torus(100, 4, SIZE)
    before = dict(vars(machine_module)), dict(vars(machine_module.front_end)), dict(machine_module.BOUNDS)
    plain = simulate(scene, BASELINE, threads=1)
    with timing() as watch:
        frame = simulate(scene, BASELINE, threads=1)
    assert (vars(machine_module), vars(machine_module.front_end), machine_module.BOUNDS) == before
    assert np.array_equal(frame.color, plain.color) and dict(frame.counters) == dict(plain.counters)
    assert 0 < sum(watch.kernels.values()) < frame.seconds
    assert 0.3 * frame.seconds < sum(watch.stages.values()) <= frame.seconds
    for name in stages.NAMES:
        assert watch.stages[name] > 0, f"{name} is no longer a stage of the frame: its row would vanish"
    assert "BOUNDS[cbox]" in watch.stages and "domain.shade_patches" in watch.kernels


def test_stopwatch_counts_a_stage_inside_a_stage_once():
    from tiler.bench.stopwatch import Stopwatch

    watch = Stopwatch()
    inner = watch.stage("inner", lambda: time.sleep(0.01))
    outer = watch.stage("outer", lambda: inner())
    outer()
    assert watch.stages.keys() == {"outer"}
    inner()
    assert watch.stages["inner"] >= 0.01


def test_stage_rows_are_the_frame_again():
    frame, watch = timed_frame(torus(100, 4, SIZE), BASELINE, 1, 1)
    rows = frame_stages(frame, watch, 1, "here")
    counter = {stage: name for stage, _, name in stages.NAMES.values()}
    total = sum(row.ns * frame.counters.get(counter.get(row.stage.removesuffix(", here"), ""), 1) for row in rows)
    assert 0.9 * frame.seconds < total * 1e-9 <= 1.001 * frame.seconds  # stages of no weight are not listed
    assert rows[-1].stage == "rest, here"


def test_limit_kernel_computes_what_it_counts():
    x = np.linspace(0, 1, LANES).astype(np.float32)
    expected = x.copy()
    for _ in range(16):
        expected = expected * np.float32(0.5) + np.float32(0.25)
    multiply_add(x, np.float32(0.5), np.float32(0.25), 2)
    assert np.array_equal(x, expected)


def test_linear_fit_is_least_squares():
    x = np.array([1.0, 2.0, 4.0, 9.0])
    y = 3.0 + 2.0 * x + np.array([0.5, -0.5, 0.25, 0.0])
    fit = linear_fit(x, y)
    assert (fit.slope, fit.offset) == pytest.approx(tuple(np.polyfit(x, y, 1)))
    assert fit.r2 == pytest.approx(np.corrcoef(x, y)[0, 1] ** 2)


def test_scaling_walks_all_axes(monkeypatch):
    for name, value in (("FACTORS", (1, 2, 4, 8)), ("COUNTS", (100, 1000)), ("SIZES", ((64, 36), (128, 72)))):
        monkeypatch.setattr(f"tiler.bench.scaling.{name}", value)
    monkeypatch.setattr("tiler.bench.scaling.QUICK_LIMIT", 1e3)  # however busy this computer is
    points = scaling(SIZE, 2, quick=True, patches=100)
    by_axis = {axis: [p for p in points if p.axis == axis] for axis in ("factor", "patches", "pixels", "threads")}
    assert [p.threads for p in by_axis["threads"]] == [1, 2]
    assert [p.triangles for p in by_axis["factor"][:4]] == [2 * 100 * f * f for f in (1, 2, 4, 8)]
    assert all(len(axis) >= 2 for axis in by_axis.values())
    assert triangle_fit(points) is not None and triangle_fit(by_axis["pixels"]) is None


def test_a_draw_never_makes_more_points_than_mesa_can_index():
    for factor in (1, 8, 15.5, 63, 64):
        drawing = drawing_of(torus(500, factor, SIZE))
        draws = _split(drawing)
        assert sum(count for _, count, _ in draws) == len(drawing.vertices)
        assert [first for first, _, _ in draws] == list(np.cumsum([0] + [count for _, count, _ in draws[:-1]]))
        assert all(count == 1 or count * (np.ceil(factor) + 1) ** 2 <= POINTS for _, count, _ in draws)


def test_draws_follow_the_maps():
    drawing = drawing_of(torus(100, 8, SIZE))
    map_id = np.repeat([0, -1, 0], [3, 100, 7]).astype(np.int32)
    draws = _split(drawing._replace(map_id=map_id))
    assert {m for _, _, m in draws} == {0, -1}
    assert all((map_id[first : first + count] == m).all() for first, count, m in draws)


def test_what_the_peer_cannot_draw_alike_is_refused():
    with pytest.raises(TilerError, match=r"edge_pixels.*\n.*4 samples.*\n.*shading 'normal'"):
        drawing_of(load_scene("teapot", size=SIZE, samples=4, shading="normal", edge_pixels=8))
    assert isinstance(drawing_of(with_factor(load_scene("teapot", size=SIZE), 8)), Drawing)


def test_a_missing_llvmpipe_is_one_clear_error(tmp_path: Path):
    code = """
import os, sys
os.environ["PYTHONPATH"] = sys.argv[1] + os.pathsep + os.environ.get("PYTHONPATH", "")
from tiler.cli import main
if __name__ == "__main__":
    sys.argv[1:] = ["bench", "--peer", "llvmpipe", "--no-stages", "--no-scaling", "-q"]
    main()
"""
    (tmp_path / "moderngl.py").write_text("raise ImportError('not here')\n")
    (tmp_path / "run.py").write_text(code)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "run.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: peer: llvmpipe is not available; it takes apt-get install")
    assert done.stderr.endswith("ImportError: not here\n")
    assert len(done.stderr.splitlines()) == 1


def _need_llvmpipe() -> None:
    if (reason := gl.available()) is not None:
        if os.environ.get("CI"):
            pytest.fail(f"{reason} (a failure because CI is set)")
        pytest.skip(reason)


@pytest.mark.gl
def test_both_renderers_draw_one_picture(tmp_path: Path):
    _need_llvmpipe()
    size = (192, 128)

    def scenes(name, factor, size):
        return torus(100, factor, size) if name == "torus" else bench_scene(name, factor, size)

    name, rows = peer.compare_with_llvmpipe(
        ("torus", "teapot", "colonnade"), (5,), size, 1, 2, scenes=scenes, out=tmp_path
    )
    assert name.startswith("llvmpipe")
    assert [(row["scene"], row["machine"]) for row in rows] == [
        (scene, made) for scene in ("torus", "teapot", "colonnade") for made in ("triangle", "culling")
    ]
    for row in rows:
        assert row["covered"] > 2000
        assert row["covered_by_one"] <= 0.002 * row["covered"], "vertices may round to another 1/256 pixel, no more"
        assert row["depth_median"] < 1e-6
        assert row["ratio"] > 0 and row["spin"] > 0
    assert rows[0]["ds_invocations"] == rows[0]["peer_ds_invocations"] == 100 * 36
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{scene}_5_{who}.png" for scene in ("torus", "teapot", "colonnade") for who in ("llvmpipe", "tilesim")
    }


@pytest.mark.gl
def test_colours_are_those_of_our_pixel_shader():
    _need_llvmpipe()
    scene = torus(100, 8, (192, 128))
    frame = simulate(scene, BASELINE)
    with Renderer(0) as renderer:
        renderer.load(drawing_of(scene))
        picture = renderer.read()
    both = (picture.depth < 1) & (frame.depth < 1)
    apart = np.abs(picture.color.astype(int) - frame.color)[both].max(axis=1)
    assert (apart <= 1).mean() > 0.99 and np.array_equal(picture.color[~both & (frame.depth == 1)][:, 3].min(), 255)


def test_machines_beside_the_peer_draw_the_same_picture():
    scene = torus(100, 4, SIZE)
    first, *others = [simulate(scene, made) for made in peer.machines().values()]
    assert all(np.array_equal(first.color, other.color) for other in others)


def results() -> Results:
    point = Point("factor", 8, 100, 8.0, SIZE, 1, 1000, 0.5, 0.4, 0.001)
    row = {
        "scene": "torus", "factor": 8.0, "machine": "triangle", "seconds": 0.1, "peer_seconds": 0.6, "ratio": 6.0,
        "fastest": 0.1, "peer_fastest": 0.5, "cpu_seconds": 0.2, "peer_cpu_seconds": 0.8, "cpu_ratio": 4.0, "spin": 0.001,
        "ds_invocations": 7, "peer_ds_invocations": 7, "covered": 9, "covered_by_one": 0, "depth_median": 0.0,
        "depth_most": 0.0,
    }  # fmt: skip
    return Results(
        facts.host_facts(1),
        Limits(50e9, 10e9, 600.0, 12),
        [Stage("domain shader, factor 8", 24.0, "invocation", 1), Stage("bound cbox", 500.0, "patch", 1)],
        [point, point._replace(value=16, triangles=4000), point._replace(value=32, triangles=16000)],
        None,
        [startup.Wait("import tiler", 0.7, 0.1)],
        "llvmpipe",
        [row],
        Views(100, 50, 200, 2.0, {"tcone": 2000, "tangent_plane": 2500}),
    )


def test_report_says_what_was_asked_and_reached():
    asked = {row[0]: row[1:] for row in report.tables(results())[1].rows}
    assert asked["domain shader, factor 8: ns an invocation, one thread"] == ["24.0", "<= 25", "yes"]
    assert asked["domain shader, factor 8: times the arithmetic limit"] == ["2.0", "<= 3", "yes"]
    assert asked["torus, factor 8, triangle: times faster than llvmpipe"] == ["6.0", ">= 5", "yes"]
    assert asked["import tiler: s (0.1 s of processors)"] == ["0.70", "<= 0.5", "no"]
    assert asked["200 views of 100 patches through tcone, tangent_plane, one thread: s"] == ["8.0", "<= 60", "yes"]


def test_report_says_how_many_views_were_measured():
    (table,) = (table for table in report.tables(results()) if table.title == "Many views")
    assert "50 of 200 views measured, in 2.00 s" in table.note and "400000.0 ns a patch and view" in table.note
    assert table.rows == [["tcone", "2,000", "40.0"], ["tangent_plane", "2,500", "50.0"]]
    assert report.as_json(results())["views"]["whole_seconds"] == 8.0
    assert "Many views" not in report.as_text(results()._replace(views=None))


def test_views_are_those_of_the_tests_one_by_one():
    """The model has as many patches as asked for, and of each eye the tests answer as they do alone."""
    found = measure_views(patches=70, asked=6)
    assert (found.patches, found.views, found.asked) == (70, 6, 6) and found.seconds >= 0
    scene = view_scene(70)
    everyone, alone = np.arange(70), dict.fromkeys(found.culled, 0)
    for eye in PAPER.draw(np.random.default_rng(0), 6, ball_of(scene)):
        stage = hull_stage(scene)._replace(eye=eye)
        for name in alone:
            alone[name] += int(np.count_nonzero(CLASSIFIERS[f"backface:{name}"](stage, everyone) == Facing.BACK))
    assert found.culled == alone and min(alone.values()) > 0
    assert measure_views(True, 70, 2000).views == QUICK_VIEWS
    assert view_scene().num_patches == VIEW_PATCHES


def test_json_has_the_agreed_keys():
    found = json.loads(json.dumps(report.as_json(results())))
    assert {"host", "stages", "peer"} <= found.keys()
    assert found["stages"][0].keys() == {"stage", "ns", "per", "threads"}
    assert {"scene", "factor", "machine", "seconds", "peer_seconds", "ratio"} <= found["peer"][0].keys()


def test_page_and_text_hold_the_same_cells():
    page, text = report.as_page(results()), report.as_text(results())
    assert page.startswith("# Where the time goes")
    for table in report.tables(results()):
        assert table.title in text and f"## {table.title}" in page
        for row in table.rows:
            assert "| " + " | ".join(row) + " |" in page


def test_tables_are_aligned():
    table = Table("title", ["a", "number"], [["x", "1"], ["longer", "12"]])
    assert aligned(table) == "title\na       number\nx            1\nlonger      12"
    assert markdown(table).splitlines()[2:4] == ["| a | number |", "| --- | ---: |"]


def test_stage_table_names_every_bound_and_test():
    from pipeline.bounds import BOUNDS
    from pipeline.culling import CULL_TESTS

    rows = measure_stages(SIZE, 1, quick=True, patches=20)
    assert {f"bound {name}" for name in BOUNDS} | {f"cull {name}" for name in CULL_TESTS} <= {row.stage for row in rows}
    assert all(row.ns >= 0 for row in rows)


def test_command_checks_its_options():
    for option, text in (("--factors", "0"), ("--rounds", "0"), ("--threads", "0"), ("--size", "9")):
        with pytest.raises(TilerError, match=f"^{option[2:]}: "):
            app(["bench", option, text], exit_on_error=False)


def test_culling_machine_takes_what_exists():
    assert peer.machines()["triangle"] == Machine(binning="triangle", cull=())
    assert set(peer.machines()["culling"].cull) <= set(peer.CULLS) and "frustum" in peer.machines()["culling"].cull
    assert (peer.lp_threads(1), peer.lp_threads(2)) == (0, 2)
