"""Bad studies: one clear error that names file, line, key, value and what is allowed, before any work."""

import os
import sqlite3
import sys
from pathlib import Path

import pytest

import tiler
from tests.study_tools import run, write_study
from tiler.study.run import check_request, parse_shard, plan_of
from tiler.study.schema import read_study

SMALL = 'picture.size = "32x18"\ntessellation.factor = 2\n'


def error_of(tmp_path: Path, text: str) -> str:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(tiler.TilerError) as caught:
        read_study(file)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("[sweep]\nscenes = ['teapot']", 2, ["sweep.scenes: unknown axis", "machine.tile", "did you mean 'scene'"]),
        ("[sweep]\nmachine.tilee = [8]", 2, ["machine.tilee: unknown axis", "did you mean 'machine.tile'"]),
        ("[sweep]\ntessellation.factr = [8]", 2, ["unknown axis", "did you mean 'tessellation.factor'"]),
        ("[sweep]\nscene = ['teapott']", 2, ["sweep.scene", "'teapott' is unknown", "teapot, waves"]),
        ("[sweep]\nscene = [3]", 2, ["sweep.scene[0]: 3 is not allowed"]),
        ("[sweep]\nscene = ['no.toml']", 2, ["no.toml: no such scene file"]),
        ("[sweep]\nmachine = ['patch', 'pach']", 2, ["machine[1]", '"pach" is not allowed', "did you mean 'patch'"]),
        ("[sweep]\nview = ['walk']", 2, ['"walk" is not allowed; allowed: path']),
        ("[sweep]\nmachine.bounds = ['cbox', 'cbx']", 2, ["'cbx'", "did you mean 'cbox'"]),
        ("[sweep]\nmachine.cull = ['frustum', 'none', 'frustrum']", 2, ["cull", "did you mean 'frustum'"]),
        ("[sweep]\nmachine.tile = [8, 48]", 2, ["48", "power of two"]),
        ("[sweep]\ntessellation.factor = [2,\n65]", 3, ["factor[1]", "65", "at most 64"]),
        ("[sweep]\npicture.size = [640, 360]", 2, ["size[0]", "640", "[width, height]", "a list holds the sizes"]),
        ("[sweep]\npicture.samples = [1, 3]", 2, ["samples[1]", "3 is not allowed; allowed: 1, 4"]),
        ("[sweep]\npicture.shading = ['lambrt']", 2, ["shading[0]", "did you mean 'lambert'"]),
        ("[sweep]\ndisplacement.scale = [0.1]", 2, ["scene 'teapot' has no displacement"]),
        ("[sweep]\ntessellation.factor = []", 2, ["is empty; allowed: at least one value"]),
        ("[sweep]\ntessellation.factor = [2, 3, 2]", 2, ["has 2 twice"]),
        ("[sweep]\nframe = '9..3'", 2, ["9..3", "FIRST..LAST"]),
        ("[sweep]\nframe = [0, nan]", 2, ["frame"]),
        ("[sweep]\nframe = 0\nview = ['path']", 2, ["stands beside view"]),
        ("[sweep]\ntessellation.factor = 2\ntessellation.edge_pixels = 4", 3, ["stands beside tessellation.factor"]),
        ("[study]\nname = 'x'", 0, ["has no rows", "[sweep]", "[[run]]"]),
        ("[sweep]\nframe = 0\n[[run]]\nframe = 1", 3, ["stands beside [sweep]"]),
        ("[[run]]\nframe = [0, 1]\n[[run]]\nframe = 1", 3, ["run[1]", "run[0] has too"]),
        ("[machine.m]\ntiles = 8\n[sweep]\nmachine = ['m']", 2, ["machine.m.tiles: unknown field", "'tile'"]),
        ("[view.v]\nkind = 'randm'\n[sweep]\nview = ['v']", 2, ["kind", "did you mean 'random'"]),
        ("[view.v]\nkind = 'random'\n[sweep]\nview = ['v']", 1, ["view.v.count", "is missing"]),
        (
            "[view.v]\nkind = 'orbit'\nsteps = 3\ncount = 3\n[sweep]\nview = ['v']",
            4,
            ["belongs to views of another kind"],
        ),
        ("[view.v]\nkind = 'random'\ncount = 0\n[sweep]\nview = ['v']", 3, ["count", "0 is not allowed"]),
        ("[view.v]\nkind = 'random'\ncount = 1\ndistance = 1.0\n[sweep]\nview = ['v']", 4, ["distance", "above 1"]),
        ("[study]\nseed = -1\n[sweep]\nframe = 0", 2, ["study.seed", "-1"]),
        ("[stdy]\nname = 'x'\n[sweep]\nframe = 0", 1, ["stdy: unknown key", "did you mean 'study'"]),
        ("[sweep]\nmachine = ['patch']\nmachine.tile = [8]", 3, ["not valid TOML", "machine.name"]),
        ("machine = 3\n[sweep]\nframe = 0", 1, ["machine: 3 is not allowed"]),
        ("[machine]\nm = 3\n[sweep]\nframe = 0", 2, ["machine.m: 3 is not allowed; allowed: a table"]),
        ("[view]\nv = 3\n[sweep]\nframe = 0", 2, ["view.v: 3 is not allowed; allowed: a table"]),
        ("sweep = 3", 1, ["sweep: 3 is not allowed"]),
        ("run = [3]", 1, ["run"]),
        ("[sweep]\nscene = [{ a = 1 }]", 2, ["scene"]),
        ("[sweep\nframe = 0", 1, ["not valid TOML"]),
    ],
)
def test_a_bad_study_file(tmp_path: Path, text: str, line: int, said: list[str]):
    error = error_of(tmp_path, text)
    assert error.startswith(f"{tmp_path / 'bad.toml'}:{line}:" if line else f"{tmp_path / 'bad.toml'}: ")
    for fragment in said:
        assert fragment in error, error


def test_all_faults_come_at_once(tmp_path: Path):
    error = error_of(tmp_path, "[sweep]\nscenes = ['x']\npicture.samples = [3]\ntessellation.factor = []\nframe = 'x'")
    lines = [line.removeprefix(f"{tmp_path / 'bad.toml'}:").partition(":") for line in error.splitlines()]
    assert [line for line, _, _ in lines] == ["2", "3", "4", "5"]
    assert [text.split(":")[0].strip() for _, _, text in lines] == [
        "sweep.scenes", "sweep.picture.samples[0]", "sweep.tessellation.factor", "sweep.frame",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"scenes": "nothing"}, "'nothing' is unknown"),
        ({"scenes": []}, "is empty"),
        ({"machines": {}}, "is empty"),
        ({"machines": {"m": {"tile": 7}}}, "power of two"),
        ({"machines": ["tringle"]}, "did you mean 'triangle'"),
        ({"frames": []}, "FIRST..LAST"),
        ({"views": {"v": {"kind": "random", "count": 2}}, "frames": 3}, "stands beside view"),
        ({"settings": {"tessellation.factor": [2, "three"]}}, "three"),
        ({"settings": {"nonsense": 3}}, "unknown axis"),
        ({"seed": 1.5}, "study.seed"),
        ({"name": ""}, "study.name"),
    ],
)
def test_bad_arguments(arguments: dict, said: str):
    with pytest.raises(tiler.TilerError) as caught:
        plan_of(**arguments)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"workers": 0}, "workers: 0 is not allowed; allowed: 1 to 1024"),
        ({"threads": 0}, "threads: 0"),
        ({"shard": (3, 2)}, "shard: 3/2 is not allowed"),
        ({"shard": (0, 2)}, "shard: 0/2 is not allowed"),
        ({"workers": 2, "scheduler": "tcp://x"}, "scheduler: stands beside workers"),
        ({"yes_run": 5}, "not the number of rows of the study, which is 1"),
    ],
)
def test_bad_requests(arguments: dict, said: str):
    whole = dict.fromkeys(("workers", "scheduler", "shard", "threads", "yes_run")) | arguments
    with pytest.raises(tiler.TilerError) as caught:
        check_request(plan_of(), **whole)
    assert said in str(caught.value)
    with pytest.raises(tiler.TilerError, match="shard: 'x' is not allowed; allowed: I/N"):
        parse_shard("x")


def test_a_grid_of_a_billion_rows_asks_first(tmp_path: Path):
    file = tmp_path / "huge.toml"
    file.write_text(
        f"[sweep]\n{SMALL}frame = '0..99999999'\nmachine.tile = [8, 16, 32, 64, 128]\nmachine.cores = [1, 2]"
    )
    with pytest.raises(tiler.TilerError) as caught:
        tiler.sweep(file, out=tmp_path / "out.db")
    said = str(caught.value)
    assert "has 1,000,000,000 rows, about" in said and "--yes-run 1000000000" in said
    assert any(unit in said for unit in ("days", "years"))
    with pytest.raises(tiler.TilerError, match="not the number of rows"):
        tiler.sweep(file, out=tmp_path / "out.db", yes_run=10**6)
    assert [path.name for path in tmp_path.iterdir()] == ["huge.toml"], "nothing was begun"


def test_a_results_file_of_another_study(tmp_path: Path):
    out = tmp_path / "out.db"
    small = {"picture.size": "32x18", "tessellation.factor": 2}
    tiler.sweep(settings=small, out=out, name="first", threads=1)
    before = out.read_bytes()
    with pytest.raises(tiler.TilerError, match="holds another study \\('first', 1 rows, begun 2"):
        tiler.sweep(settings=small | {"tessellation.factor": 3}, out=out, name="first")
    assert out.read_bytes() == before
    with sqlite3.connect(out) as db:
        db.execute("UPDATE meta SET value = 'older' WHERE name = 'sources'")
        db.execute("UPDATE meta SET value = 'older' WHERE name = 'identity'")
    with pytest.raises(tiler.TilerError, match="begun by other sources"):
        tiler.sweep(settings=small, out=out, name="first")


def test_files_that_are_no_results(tmp_path: Path):
    text, other = tmp_path / "text.db", tmp_path / "other.db"
    text.write_text("nothing of the kind, and long enough to be read as a database header " * 20)
    with sqlite3.connect(other) as db:
        db.execute("CREATE TABLE rows (a)")
    db.close()
    for path in (text, other):
        before = path.read_bytes()
        with pytest.raises(tiler.TilerError, match="is not a results file of a study"):
            tiler.sweep(settings={"picture.size": "32x18"}, out=path)
        with pytest.raises(tiler.TilerError, match="is not a results file of a study"):
            tiler.load_study(path)
        assert path.read_bytes() == before
    with pytest.raises(tiler.TilerError, match="does not exist"):
        tiler.load_study(tmp_path / "none.db")


def test_places_that_cannot_be_written(tmp_path: Path):
    file = write_study(tmp_path)
    for out, said in ((tmp_path, "is a folder"), (tmp_path / "none" / "out.db", "can be written")):
        with pytest.raises(tiler.TilerError, match=said):
            tiler.sweep(file, out=out)
    if os.geteuid() != 0:
        locked = tmp_path / "locked"
        locked.mkdir(mode=0o500)
        with pytest.raises(tiler.TilerError, match="can be written"):
            tiler.sweep(file, out=locked / "out.db")
    done = run(file, "--out", tmp_path / "out.db", "--csv", tmp_path / "none" / "t.csv")
    assert done.returncode == 2 and "csv: " in done.stderr and not (tmp_path / "out.db").exists()


def test_a_missing_library_is_told_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from tiler.study.command import SweepRequest, run_command

    monkeypatch.setitem(sys.modules, "duckdb", None)
    request = SweepRequest(
        write_study(tmp_path), tmp_path / "out.db", None, None, None, 1, None, tmp_path / "t.parquet", False, (), False,
        None, True,
    )  # fmt: skip
    with pytest.raises(tiler.TilerError, match=r"duckdb is not installed.*tilesim\[data\]"):
        run_command(request)
    assert not (tmp_path / "out.db").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "study: missing"),
        (("--out", "x.db"), "study: missing"),
        (("none.toml",), "study: none.toml cannot be read"),
        (("--status", "--out", "none.db"), "none.db does not exist"),
    ],
)
def test_bad_commands(arguments: tuple[str, ...], said: str):
    done = run(*arguments)
    assert done.returncode == 2 and done.stdout == "" and "Traceback" not in done.stderr
    assert said in done.stderr
