"""Studies: what rows there are, what they hold, and how the table leaves its file."""

import csv
import itertools
import json
import math
import re
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pytest

import tiler
from tests.study_tools import compared, write_study
from tiler.counters import DEFINITIONS
from tiler.scene.camera import camera_at
from tiler.study.grid import Axis, Block, Grid, Shard
from tiler.study.ledger import NOT_COMPARED
from tiler.study.plan import row_key
from tiler.study.progress import StudyProgress, say_seconds
from tiler.study.rows import RowRunner
from tiler.study.run import plan_of
from tiler.study.schema import read_study
from tiler.study.settings import apply_settings, check_setting, setting_names
from tiler.study.views import ViewFile, bounding_sphere, look, random_direction


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> tiler.study.results.Study:
    folder = tmp_path_factory.mktemp("study")
    return tiler.sweep(write_study(folder), out=folder / "tiny.db", threads=1)


# The grid.


def test_rows_are_the_product_of_the_axes_the_last_running_fastest():
    axes = (Axis("a", [1, 2]), Axis("frame", range(3)), Axis("machine", ["x", "y"]))
    grid = Grid([Block("s", "path", axes), Block("t", "path", axes[1:])])
    assert len(grid) == 12 + 6
    rows = [grid.values(row) for row in range(len(grid))]
    assert rows[0] == {"scene": "s", "view": "path", "a": 1, "frame": 0, "machine": "x"}
    assert [row["machine"] for row in rows[:4]] == ["x", "y", "x", "y"]
    assert [row["frame"] for row in rows[:6]] == [0, 0, 1, 1, 2, 2]
    assert rows[12] == {"scene": "t", "view": "path", "frame": 0, "machine": "x"}
    assert len({json.dumps(row) for row in rows}) == 18
    assert grid.columns() == ["scene", "view", "a", "frame", "machine"]


def test_a_billion_rows_are_counted_and_not_built():
    grid = Grid([Block("s", "v", (Axis("frame", range(10**8)), Axis("machine", list("abcdefghij"))))])
    assert len(grid) == 10**9
    assert grid.values(10**9 - 1) == {"scene": "s", "view": "v", "frame": 10**8 - 1, "machine": "j"}


@pytest.mark.parametrize(("rows", "parts"), [(2000, 7), (100, 3), (5, 2), (3, 8), (1, 1)])
def test_each_row_is_in_one_shard(rows: int, parts: int):
    held = [[row for row in range(rows) if Shard(k + 1, parts).holds(row, rows)] for k in range(parts)]
    assert sorted(itertools.chain.from_iterable(held)) == list(range(rows))
    sizes = [len(part) for part in held]
    assert max(sizes) - min(sizes) <= min(16, math.ceil(rows / parts))


# What a study may set.


@pytest.mark.parametrize(
    ("key", "value", "read"),
    [
        ("picture.size", "48x20", lambda s: (s.picture.width, s.picture.height) == (48, 20)),
        ("picture.size", [48, 20], lambda s: (s.picture.width, s.picture.height) == (48, 20)),
        ("picture.samples", 4, lambda s: s.picture.samples == 4),
        ("picture.shading", "patch", lambda s: s.picture.shading == "patch"),
        ("tessellation.factor", 5, lambda s: s.tessellation.factor == (5.0,) * 6),
        ("tessellation.factor", [1, 2, 3, 4, 5, 6], lambda s: s.tessellation.factor == (1, 2, 3, 4, 5, 6)),
        ("tessellation.edge_pixels", 4.0, lambda s: s.tessellation.edge_pixels == 4.0),
        ("tessellation.silhouette", 2.0, lambda s: s.tessellation.silhouette == 2.0),
        ("displacement.scale", 0.25, lambda s: all(m.scale == 0.25 for m in s.maps)),
        ("camera.fov", 60.0, lambda s: s.camera.fov == 60.0),
        ("face_cull", "none", lambda s: s.face_cull == "none"),
    ],
)
def test_settings_reach_the_scene(key: str, value: object, read):
    scene = tiler.load_scene("spikelog")
    assert not read(scene)
    assert read(apply_settings(scene, {key: check_setting(key, value)}))


def test_every_setting_is_a_key_of_scene_files():
    assert {"picture.size", "tessellation.factor", "displacement.scale", "camera.near", "light"} <= set(setting_names())
    assert not {"camera.key", "object", "camera.keys", "maps", "title"} & set(setting_names())


def test_fixed_factors_take_the_place_of_wished_lengths():
    scene = apply_settings(tiler.load_scene("teapot"), {"tessellation.edge_pixels": 8.0})
    assert apply_settings(scene, {"tessellation.factor": 4}).tessellation.edge_pixels is None


# Views.


def test_the_sphere_holds_every_control_point_and_displacement():
    for name in tiler.scene_names():
        scene = tiler.load_scene(name)
        centre, radius = bounding_sphere(scene)
        furthest = 0.0
        for point, who in zip(scene.control_points[::7], scene.object_id[::7], strict=True):
            world = scene.transforms[who].astype(float) @ (point.reshape(16, 4) / point.reshape(16, 4)[:, 3:]).T
            furthest = max(furthest, np.linalg.norm(world.T - centre, axis=1).max())
        for mesh in scene.meshes:
            world = mesh.vertices @ scene.transforms[mesh.object_id][:, :3].T + scene.transforms[mesh.object_id][:, 3]
            furthest = max(furthest, np.linalg.norm(world - centre, axis=1).max())
        height = max((abs(m.scale * m.texels + m.bias).max() for m in scene.maps), default=0.0)
        assert furthest + height <= radius * (1 + 1e-6)
        assert radius < 3 * (furthest + height), name


def test_random_eyes_are_uniform_and_the_same_for_a_longer_study():
    directions = np.array([random_direction("1/x", k) for k in range(4000)])
    assert np.allclose((directions**2).sum(axis=1), 1.0, atol=1e-12)
    assert np.abs(directions.mean(axis=0)).max() < 0.03
    assert np.allclose((directions**2).mean(axis=0), 1 / 3, atol=0.02)
    assert random_direction("1/x", 0) == tuple(directions[0])
    assert random_direction("1/x", 0) != random_direction("2/x", 0)


@pytest.mark.parametrize(
    "view",
    [
        {"kind": "random", "distance": 3.0, "at": 0.0, "seed": "5/v"},
        {"kind": "orbit", "distance": 3.0, "at": 0.0, "steps": 9, "elevation": 30.0},
        {"kind": "orbit", "distance": 3.0, "at": 0.0, "steps": 9, "elevation": -89.0},
    ],
)
def test_eyes_look_at_the_whole_scene_from_their_distance(view: dict):
    scene = tiler.load_scene("spikelog")
    sphere = bounding_sphere(scene)
    seen = set()
    for k in range(9):
        looked, frame = look(scene, sphere, view, k)
        camera = camera_at(looked.camera, frame, 1.0)
        seen.add(tuple(camera.eye))
        offset = camera.eye - np.array(sphere.centre)
        assert np.isclose(np.linalg.norm(offset), 3.0 * sphere.radius, rtol=1e-3)
        assert camera.near < 2.0 * sphere.radius < 4.0 * sphere.radius < camera.far
        centre = camera.clip_from_world @ np.array([*sphere.centre, 1.0])
        assert np.abs(centre[:2]).max() < 1e-4 * centre[3]
        if view["kind"] == "orbit":
            assert np.isclose(offset[2], 3.0 * sphere.radius * math.sin(math.radians(view["elevation"])), rtol=1e-2)
    assert len(seen) == 9


def test_a_view_along_up_is_a_view():
    scene = tiler.load_scene("teapot", size=(32, 18), factor=2)
    straight = apply_settings(scene, {"camera.up": [0.0, 0.0, 1.0]})
    k = max(range(5000), key=lambda k: abs(random_direction("7/v", k)[2]))
    assert abs(random_direction("7/v", k)[2]) > 0.999
    looked, _ = look(straight, bounding_sphere(scene), {"kind": "random", "distance": 3.0, "at": 0, "seed": "7/v"}, k)
    assert tiler.simulate(looked).counters["om_samples_visible"] > 0


def test_a_view_has_the_frames_that_it_says():
    scene = tiler.load_scene("teapot")
    assert len(ViewFile(kind="path").frame_numbers(scene)) == scene.frames
    assert list(ViewFile(kind="path", frames=[3, 0.5]).frame_numbers(scene)) == [3, 0.5]
    assert len(ViewFile(kind="random", count=10**9).frame_numbers(scene)) == 10**9


# Rows.


def test_rows_say_what_simulate_says(study):
    scene = tiler.load_scene("teapot", size=(64, 36), factor=3)
    for row in study.rows(view="walk", machine="small", **{"tessellation.factor": 3, "machine.cores": 4}):
        made = tiler.simulate(scene, tiler.Machine(tile=8, binning="patch", cores=4), frame=row["frame"])
        assert {name: row[name] for name in DEFINITIONS} == dict(made.counters)
        assert row["seconds"] > 0 and row["status"] == "ok" and row["error"] is None and row["violations"] is None


def test_the_table_is_whole_and_in_order(study):
    rows = study.rows()
    assert len(rows) == len(study) == 2 * (5 + 4 + 3) * 2 * 2
    assert [row["row"] for row in rows] == list(range(96))
    assert len({row["key"] for row in rows}) == 96
    assert study.axes == ["scene", "view", "picture.size", "tessellation.factor", "frame", "machine", "machine.cores"]
    assert [row["machine"] for row in rows[:4]] == ["triangle", "triangle", "small", "small"]
    assert [row["view"] for row in rows[::8]] == ["walk"] * 5 + ["anywhere"] * 4 + ["around"] * 3
    eyes = [row["om_samples_visible"] for row in rows[40:72:4]]
    assert len(set(eyes)) > 2, "each eye sees something else"
    assert "96 of 96 rows, 0 failed" in repr(study)


def test_keys_are_the_same_in_every_run_and_differ_by_description(tmp_path: Path):
    plan, again = read_study(write_study(tmp_path)), read_study(write_study(tmp_path))
    assert plan.identity() == again.identity()
    assert [row_key(plan.job(row)) for row in range(8)] == [row_key(again.job(row)) for row in range(8)]
    other = plan_of(scenes="teapot", settings={"tessellation.factor": 2}, seed=1)
    assert other.identity() != plan_of(scenes="teapot", settings={"tessellation.factor": 2}, seed=2).identity()
    assert json.loads(json.dumps(plan.job(5))) == plan.job(5), "jobs are plain data"


def test_the_same_command_continues_and_repeats_nothing(tmp_path: Path):
    file, out = write_study(tmp_path), tmp_path / "out.db"
    tiler.sweep(file, out=out, shard=(2, 3), threads=1)
    part = tiler.load_study(out).rows()
    assert 0 < len(part) < 96
    whole = tiler.sweep(file, out=out, threads=1)
    assert [row for row in whole.rows() if row["row"] in {r["row"] for r in part}] == part, "seconds too: not run again"
    assert len(whole) == 96
    before = out.read_bytes()
    tiler.sweep(file, out=out, threads=1)
    assert tiler.load_study(out).rows() == whole.rows() and len(before) == out.stat().st_size
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.db", "tiny.toml"], "one plain file is left"


def test_shards_merge_to_the_undisturbed_table(study, tmp_path: Path):
    from tiler.study.ledger import Ledger

    file = write_study(tmp_path)
    parts = [tmp_path / f"part{k}.db" for k in range(3)]
    for k, part in enumerate(parts):
        tiler.sweep(file, out=part, shard=(k + 1, 3), threads=1)
    with Ledger(tmp_path / "all.db", read_study(file)) as ledger:
        for part in [*parts, parts[0]]:
            ledger.merge(part)
    assert compared(tmp_path / "all.db") == compared(study.path)


def test_a_frame_that_fails_is_a_row_with_its_error(tmp_path: Path):
    out = tmp_path / "out.db"
    sizes = ["32x18", "16384x16384", "40x20"]
    settings = {"picture.size": sizes, "picture.samples": 4, "tessellation.factor": 2}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tiler.memory.available_bytes", lambda: 10**8)
        study = tiler.sweep(scenes="teapot", settings=settings, out=out, threads=1)
    assert [row["status"] for row in study.rows()] == ["ok", "failed", "ok"]
    bad = study.rows()[1]
    assert bad["error"].startswith("TilerError: ") and "16384" in bad["error"]
    assert all(bad[name] is None for name in (*DEFINITIONS, "seconds"))
    assert study.tally() == (3, 3, 1)
    again = tiler.sweep(scenes="teapot", settings=settings, out=out, threads=1)
    assert again.rows()[1]["status"] == "failed", "a failed row is finished"


def test_any_exception_is_a_row_and_failed_rows_can_be_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from tiler.study import rows

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of all things")

    arguments = {"settings": {"picture.size": "32x18", "tessellation.factor": 2}, "frames": "0..2", "threads": 1}
    with monkeypatch.context() as patch:
        patch.setattr(rows, "simulate", broken)
        study = tiler.sweep(out=tmp_path / "out.db", **arguments)
    assert {row["error"].split(" (")[0] for row in study.rows()} == {"ZeroDivisionError: of all things"}
    assert "test_study.py" in study.rows()[0]["error"]
    study = tiler.sweep(out=tmp_path / "out.db", retry_failed=True, **arguments)
    assert study.tally() == (3, 3, 0)


def test_an_interrupt_is_no_failed_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    run = RowRunner.run

    def interrupted(self: RowRunner, job: dict) -> dict:
        if job["row"] == 2:
            raise KeyboardInterrupt
        return run(self, job)

    arguments = {"settings": {"picture.size": "32x18", "tessellation.factor": 2}, "frames": "0..4", "threads": 1}
    out = tmp_path / "out.db"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(RowRunner, "run", interrupted)
        tiler.sweep(out=out, **arguments)
    assert [row["status"] for row in tiler.load_study(out).rows()] == ["ok", "ok"]
    assert len(tiler.sweep(out=out, **arguments)) == 5


def test_violations_are_counted_where_a_machine_verifies(tmp_path: Path):
    study = tiler.sweep(
        scenes="teapot",
        machines={"checked": tiler.Machine(verify=True), "default": {}},
        settings={"picture.size": "32x18", "tessellation.factor": 2},
        out=tmp_path / "out.db",
        threads=1,
    )
    assert [row["violations"] for row in study.rows()] == [0, None]


def test_runs_are_a_list_of_small_sweeps(tmp_path: Path):
    file = tmp_path / "list.toml"
    file.write_text(
        """
[[run]]
scene = "teapot"
picture.size = "32x18"
tessellation.factor = 2
frame = [0, 1.5]

[[run]]
scene = "teapot"
picture.size = "32x18"
tessellation.edge_pixels = 6
machine.tile = [8, 16]
"""
    )
    study = tiler.sweep(file, out=tmp_path / "out.db", threads=1)
    rows = study.rows(["tessellation.factor", "tessellation.edge_pixels", "frame", "machine", "machine.tile"])
    assert [tuple(row.values()) for row in rows] == [
        (2, None, 0, "default", None),
        (2, None, 1.5, "default", None),
        (None, 6, 0, "default", 8),
        (None, 6, 0, "default", 16),
    ]


def test_a_scene_file_beside_the_study_is_found(tmp_path: Path):
    text = next(p for p in (Path(tiler.__file__).parents[1] / "scenes").glob("teapot.toml")).read_text()
    (tmp_path / "mine.toml").write_text(text)
    file = tmp_path / "study.toml"
    size = 'picture.size = "32x18"'
    file.write_text(f'[sweep]\nscene = ["mine.toml", "teapot"]\n{size}\ntessellation.factor = 2\n')
    rows = tiler.sweep(file, out=tmp_path / "out.db", threads=1).rows()
    assert [row["scene"] for row in rows] == ["mine.toml", "teapot"]
    assert rows[0]["rs_samples_covered"] == rows[1]["rs_samples_covered"] > 0
    (tmp_path / "mine.toml").write_text(text.replace("fov = 28", "fov = 29"))
    with pytest.raises(tiler.TilerError, match="holds another study"):
        tiler.sweep(file, out=tmp_path / "out.db", threads=1)


# Provenance and export.


def test_the_file_says_where_its_numbers_come_from(study):
    import numba

    meta = study.meta
    assert meta["version"] == tiler.__version__ and meta["seed"] == "3" and meta["rows"] == "96"
    assert meta["python"] == sys.version.split()[0]
    assert meta["numpy"] == np.__version__ and meta["numba"] == numba.__version__
    assert meta["cpu"] and int(meta["cores"]) >= 1 and len(meta["sources"]) == 16
    assert "[view.anywhere]" in meta["study"]
    assert study.machines["small"]["tile"] == 8 and set(study.machines["small"]) == set(tiler.Machine.model_fields)
    if (Path(tiler.__file__).parents[1] / ".git").exists():
        assert len(meta["commit"].removesuffix("+changes")) == 40


def test_every_column_is_defined(study):
    for name, definition in DEFINITIONS.items():
        column = study.columns[name]
        assert (column.kind, column.unit) == ("counter", definition.unit)
        assert column.text.startswith(definition.text)
    assert "D3D11 DSInvocations" in study.columns["ds_invocations"].text
    assert study.columns["seconds"].unit == "seconds" and "never compared" in study.columns["seconds"].text
    assert all(column.text for column in study.columns.values())
    assert NOT_COMPARED == ("seconds",)


def test_csv_holds_the_table(study, tmp_path: Path):
    study.to_csv(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert [{k: None if v is None else str(v) for k, v in row.items()} for row in study.rows()] == [
        {k: v or None for k, v in row.items()} for row in read
    ]
    told = json.loads((tmp_path / "t.csv.json").read_text())
    assert told["meta"] == study.meta
    assert told["columns"]["queue_bytes"]["unit"] == "bytes"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.csv", "t.csv.json"]


def test_parquet_holds_the_table_with_types_and_metadata(tmp_path: Path):
    duckdb = pytest.importorskip("duckdb")
    settings = {"picture.size": ["32x18"], "tessellation.factor": [2, [1, 2, 3, 4, 5, 6]]}
    study = tiler.sweep(settings=settings, frames=[0, 1.5], out=tmp_path / "o.db", threads=1, name='it\'s "quoted"')
    target = tmp_path / "it's.parquet"
    study.to_parquet(target)
    with duckdb.connect() as db:
        table = db.execute("SELECT * FROM read_parquet(?) ORDER BY row", [str(target)])
        names = [column[0] for column in table.description]
        types = {column[0]: str(column[1]) for column in table.description}
        read = [dict(zip(names, record, strict=True)) for record in table.fetchall()]
        pairs = db.execute("SELECT key, value FROM parquet_kv_metadata(?)", [str(target)]).fetchall()
    expected = [row | {"tessellation.factor": str(row["tessellation.factor"])} for row in study.rows()]
    assert read == expected
    assert types["ds_invocations"] == "BIGINT" and types["frame"] == "DOUBLE" and types["seconds"] == "DOUBLE"
    told = {bytes(key).decode(): json.loads(bytes(value)) for key, value in pairs}
    assert told["tiler.meta"] == study.meta and told["tiler.meta"]["name"] == 'it\'s "quoted"'
    assert told["tiler.columns"]["ds_invocations"]["unit"] == "domain points"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["it's.parquet", "o.db"]


def test_the_file_is_plain_sqlite(study):
    db = sqlite3.connect(study.path)
    total = db.execute(
        'SELECT sum(ds_invocations) FROM rows WHERE machine = ? AND "tessellation.factor" = 3', ["small"]
    )
    assert total.fetchone()[0] == sum(study.to_dict(machine="small", **{"tessellation.factor": 3})["ds_invocations"])
    assert db.execute("SELECT unit FROM columns WHERE name = 'queue_bytes'").fetchone() == ("bytes",)


def test_a_dataframe_or_a_clear_message(study, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(tiler.TilerError, match=r"pandas is not installed.*rows"):
        study.to_dataframe()


def test_plots_by_one_line(study, tmp_path: Path):
    pytest.importorskip("matplotlib")
    axes = study.plot("tessellation.factor", "ds_invocations", by="machine", file=tmp_path / "p.png", view="walk")
    assert (tmp_path / "p.png").stat().st_size > 5000
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert set(lines) == {"triangle", "small"}
    chosen = study.rows(view="walk", machine="small", **{"tessellation.factor": 2})
    mean = sum(row["ds_invocations"] for row in chosen) / len(chosen)
    assert list(lines["small"].get_xdata()) == [2, 3]
    assert lines["small"].get_ydata()[0] == pytest.approx(mean, rel=1e-12)
    assert axes.get_ylabel() == "ds_invocations (domain points)"
    with pytest.raises(tiler.TilerError, match="did you mean 'ds_invocations'"):
        study.plot("frame", "ds_invocation")
    with pytest.raises(tiler.TilerError, match="not a column of numbers"):
        study.plot("frame", "machine")
    with pytest.raises(tiler.TilerError, match="no finished row"):
        study.plot("frame", "ds_invocations", view="nowhere")


# Progress.


def test_progress_tells_rate_and_time_left(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    now = [0.0]
    monkeypatch.setattr("tiler.study.progress.time.monotonic", lambda: now[0])
    with StudyProgress("s", 1000, 100, 0) as bar:
        now[0] = 10.0
        bar.add(50, 2)
        assert bar.line() == "150 of 1,000 rows, 5/s, 2.8 min left, 2 failed"
    assert capsys.readouterr() == ("", ""), "not a terminal"
    assert [say_seconds(s) for s in (0.5, 59, 7200, 9e5, 1e10)] == ["0.5 s", "59 s", "2 h", "10 days", "3.2e+02 years"]


# The page.


def test_the_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("matplotlib")
    page = (Path(__file__).parents[1] / "docs" / "studies.md").read_text()
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    (tmp_path / "bounds.toml").write_text(text)
    assert len(read_study(tmp_path / "bounds.toml").grid) == 2 * 3 * (24 + 100) * 3 * 2
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
    exec(code, {})
    assert len(tiler.load_study("factors.db")) == 2 * 4 * 2
    assert (tmp_path / "factors.png").exists()
