"""Bounds and cull tests of users: the documented example, registered, drawn with, validated, and found wrong when wrong."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numba import njit

import tiler
from pipeline.bounds import BOUNDS
from pipeline.culling import CLASSIFIERS, CULL_TESTS, FLAG_OF, TRIANGLE_SAFE
from pipeline.types import CullFlag
from tiler.errors import TilerError
from tiler.extensions import load_plugins, registered
from tiler.validation import validate_bounds

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "docs" / "examples" / "diagonal.py"


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    """What a test registers is gone after it: other tests loop over the tables."""
    tables = [BOUNDS, CULL_TESTS, FLAG_OF, CLASSIFIERS]
    kept, safe = [dict(table) for table in tables], set(TRIANGLE_SAFE)
    yield
    for name in list(registered()):
        tiler.unregister(name)
    assert [dict(table) for table in tables] == kept
    assert safe == TRIANGLE_SAFE


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """The example's names."""
    names: dict[str, object] = {"__name__": "example"}
    exec(compile(EXAMPLE.read_text(), EXAMPLE, "exec"), names)
    return names


def run(*arguments: str, cwd: Path, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tiler", *arguments], cwd=cwd, capture_output=True, text=True, timeout=300, check=False,
        env=os.environ | env,
    )  # fmt: skip


def test_the_example_draws_the_same_picture_and_bounds_tighter_than_cbox(example: dict[str, object]) -> None:
    scene = tiler.load_scene("spikelog", size=(96, 64))
    frames = [
        tiler.simulate(scene, tiler.Machine(bounds=name, overlap="exact", cull=cull))
        for name, cull in (
            ("cbox", ()),
            ("cbox", ("frustum",)),
            ("diagonal", ("frustum", "backface:all_products")),
        )
    ]
    assert all(np.array_equal(frame.color, frames[0].color) for frame in frames)
    teapot = tiler.load_scene("teapot", size=(96, 64))
    counts = {
        cull: tiler.simulate(teapot, tiler.Machine(cull=cull)).counters["hs_culled_backface"]
        for cull in ((), ("backface:all_products",), ("backface:tangent_plane",))
    }
    assert 0 < counts["backface:all_products",] <= counts["backface:tangent_plane",]


def test_the_example_is_found_right(example: dict[str, object]) -> None:
    result = validate_bounds(200_000, names=["diagonal"], threads=2)
    assert result["failed"] == 0
    rows = {row["algorithm"]: row for row in result["details"]}
    assert rows["diagonal"]["samples"] >= 200_000
    assert rows["backface:all_products"]["cases"] > 0


@pytest.mark.parametrize(("old", "new"), [("+ reach", "+ 0.97 * reach"), ("k in range(1, 16)", "k in range(1, 15)")])
def test_a_wrong_bound_is_found_wrong(old: str, new: str) -> None:
    source = EXAMPLE.read_text()
    assert old in source
    exec(compile(source.replace(old, new, 1), "wrong.py", "exec"), {"__name__": "wrong"})
    result = validate_bounds(100_000, names=["diagonal"], threads=2)
    assert result["failed"] > 0
    (row,) = (row for row in result["details"] if row["algorithm"] == "diagonal")
    assert row["violations"], "which patch, where, and by how much"


def test_a_wrong_back_patch_test_drops_what_is_seen_and_is_named(example: dict[str, object]) -> None:
    source = EXAMPLE.read_text().replace("2 if greatest < -noise", "2 if least < -noise", 1)
    exec(compile(source, "wrong.py", "exec"), {"__name__": "wrong"})
    frame = tiler.simulate(
        tiler.load_scene("teapot", size=(96, 64)), tiler.Machine(cull=("backface:all_products",), verify=True)
    )
    assert any(found.algorithm == "backface:all_products" for found in frame.violations)


def test_boxes_that_are_no_boxes_are_still_conservative() -> None:
    """Axes in the wrong angles, of length 0, NaN: the Cartesian box around them, or nothing known."""

    def skewed(points, reach, center, axes):  # type: ignore[no-untyped-def]
        for c in range(3):
            low, high = points[:, c].min() - reach, points[:, c].max() + reach
            center[c] = 0.5 * (low + high)
            axes[c, c] = 0.25 * (high - low)
            axes[(c + 1) % 3, c] = 0.25 * (high - low)

    def unknown(points, reach, center, axes):  # type: ignore[no-untyped-def]
        center[0] = np.nan

    tiler.register_bound("skewed", box=skewed)
    tiler.register_bound("unknown", box=unknown)
    assert validate_bounds(60_000, names=["skewed", "unknown"], threads=2)["failed"] == 0
    scene = tiler.load_scene("teapot", size=(96, 64))
    frame = tiler.simulate(scene, tiler.Machine(bounds="unknown", cull=("frustum",)))
    assert frame.counters["hs_culled_frustum"] == 0


def test_whole_functions_and_tests_that_answer_for_triangles() -> None:
    tiler.register_bound("again", BOUNDS["cbox"])
    tiler.register_cull_test("frustum:never", lambda stage, bounds, flags: None)
    tiler.register_cull_test("backface:safe", CULL_TESTS["backface:tessellation_safe"], triangle_safe=True)
    assert "backface:safe" in TRIANGLE_SAFE
    assert (FLAG_OF["frustum:never"], FLAG_OF["backface:safe"]) == (CullFlag.FRUSTUM, CullFlag.BACKFACE)
    scene = tiler.load_scene("teapot", size=(96, 64))
    first, second = (
        tiler.simulate(scene, tiler.Machine(bounds=bounds, cull=cull)).counters
        for bounds, cull in (
            ("cbox", ("frustum", "backface:tessellation_safe")),
            ("again", ("frustum:never", "frustum", "backface:safe")),
        )
    )
    assert dict(first) == dict(second)


def test_a_name_of_ones_own_can_be_replaced_and_forgotten() -> None:
    tiler.register_bound("mine", BOUNDS["cbox"])
    tiler.register_bound("mine", BOUNDS["obbtex"])
    assert BOUNDS["mine"] is BOUNDS["obbtex"]
    tiler.unregister("mine")
    with pytest.raises(TilerError, match="allowed: cbox"):
        tiler.Machine(bounds="mine")
    with pytest.raises(TilerError, match="'mine' is not registered"):
        tiler.unregister("mine")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tiler.register_bound("cbox", BOUNDS["cbox"]), "'cbox' is built in"),
        (lambda: tiler.register_bound("My Bound", BOUNDS["cbox"]), "'My Bound' is not allowed; allowed: lower-case"),
        (lambda: tiler.register_bound("mine"), "0 functions; allowed: one of bound and box"),
        (lambda: tiler.register_bound("mine", BOUNDS["cbox"], box=len), "2 functions"),
        (lambda: tiler.register_bound("mine", box=3), "box is int; allowed: a function"),
        (lambda: tiler.register_bound("mine", box=lambda points: None), "box cannot be compiled: .*argument"),
        (lambda: tiler.register_bound("mine", box=lambda p, r, c, a: p.colour), "box cannot be compiled: .*colour"),
        (lambda: tiler.register_bound("mine", box=njit(lambda p, r, c, a: 1)), "it returns .*; allowed: none"),
        (lambda: tiler.register_cull_test("mine", CULL_TESTS["frustum"]), "allowed: frustum:NAME or backface:NAME"),
        (lambda: tiler.register_cull_test("frustum:world", CULL_TESTS["frustum"]), "is built in"),
        (lambda: tiler.register_cull_test("frustum:mine", facing=lambda p, e: 0), "has a facing; allowed: of backface"),
        (lambda: tiler.register_cull_test("backface:mine", facing=lambda p, e: "no"), "it returns"),
    ],
)  # fmt: skip
def test_bad_registrations_are_told(call: object, message: str) -> None:
    with pytest.raises(TilerError, match=message):
        call()  # type: ignore[operator]
    assert not registered()


def test_the_command_line_takes_a_plug_in(tmp_path: Path) -> None:
    small = ("--size", "96x64", "--factor", "4", "--json", "-")
    machines = ("--machine", "bounds=cbox", "--machine", "bounds=diagonal,cull=frustum+backface:all_products")
    done = run("compare", "teapot", *small, *machines, "--plugin", str(EXAMPLE), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    _, second = json.loads(done.stdout)["machines"]
    assert second["same_picture"] and second["counters"]["hs_culled_backface"] > 0
    study = tmp_path / "study.toml"
    study.write_text(
        '[sweep]\nscene = "teapot"\npicture.size = "64x48"\nframe = 0\nmachine.bounds = ["cbox", "diagonal"]\n'
    )
    done = run("sweep", "study.toml", "--workers", "1", "--json", "-", cwd=tmp_path, TILER_PLUGINS=str(EXAMPLE))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["done"] == 2


@pytest.mark.parametrize(
    ("plugin", "message"),
    [
        ("nowhere.py", "is not there; allowed: the path of a .py file, or a module's name"),
        ("no_such_module", "cannot be imported: ModuleNotFoundError"),
        ("broken.py", "cannot be imported: ZeroDivisionError"),
    ],
)
def test_a_plug_in_that_cannot_be_loaded_is_one_error(tmp_path: Path, plugin: str, message: str) -> None:
    (tmp_path / "broken.py").write_text("1 / 0\n")
    done = run("scenes", "--plugin", plugin, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ") and message in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_an_entry_point_is_loaded_when_its_name_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "their_bound.py").write_text(
        "import tiler\nfrom pipeline.bounds import BOUNDS\ntiler.register_bound('theirs', BOUNDS['cbox'])\n"
    )
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tilesim.plugins]\ntheirs = their_bound\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert tiler.Machine(bounds="theirs").bounds == "theirs"
    load_plugins()  # a second time imports nothing again
    assert registered() == {"theirs": "pipeline.bounds.cbox"}
