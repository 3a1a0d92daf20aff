"""Reports: what the page holds equals what was simulated, it asks for nothing from outside, and bad input is told."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import tiler
from tests.report_tools import read_data, unpack
from tests.scenes import flat_patch, patch_scene
from tests.study_tools import run as run_sweep
from tests.study_tools import write_study
from tiler import cli
from tiler.blame import BLAME, waterfall
from tiler.comparison import EVERYTHING, MACHINES, compare
from tiler.counters import DEFINITIONS
from tiler.errors import TilerError
from tiler.frame import Frame
from tiler.heatmaps import depth_complexity_map, heatmap_names, overdraw_map, overlap_map
from tiler.report import collect as collect_module
from tiler.report.collect_study import collect_study
from tiler.report.colors import linear_from_oklab, ramp
from tiler.report.encode import Blobs, encode
from tiler.report.maps import MAPS
from tiler.report.page import SCRIPTS, STYLES, make_page
from tiler.report.patches import look, patch_facts
from tiler.report.waterfall import invocation_steps, patch_steps
from tiler.scene import Scene
from tiler.study.results import Study

SMALL = {"size": (83, 61), "factor": 3}
SVG = "http://www.w3.org/2000/svg"  # the name of a namespace, which nobody fetches


@pytest.fixture(scope="module")
def scene(load) -> Scene:
    return load("waves", **SMALL)


@pytest.fixture(scope="module")
def frames(scene) -> dict[str, Frame]:
    machines = {
        "triangle": tiler.Machine(binning="triangle", cull=(), blame=True),
        "patch": tiler.Machine(tile=16, blame=True),
        "all": tiler.Machine(tile=16, blame=True, verify=True, **EVERYTHING),
    }
    return compare(scene, machines, frame=1).frames


@pytest.fixture(scope="module")
def page(scene, frames, tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("report") / "new folder" / "report.html"
    tiler.write_report(frames, file, scene=scene, command="tiler compare waves --blame")
    return file


def test_it_holds_the_counters_and_the_maps_of_each_machine(scene, frames, page):
    data = read_data(page)
    assert data["kind"] == "frames" and data["title"] == "waves" and data["size"] == [83, 61]
    assert [d["name"] for d in data["definitions"]] == list(DEFINITIONS)
    assert data["provenance"]["command"] == "tiler compare waves --blame"
    for entry, (name, frame) in zip(data["machines"], frames.items(), strict=True):
        assert entry["name"] == name and entry["same"] and entry["tile"] == frame.machine.tile
        assert entry["counters"] == list(frame.counters.values())
        assert entry["fields"] == frame.machine.model_dump(mode="json")
        maps = {m: unpack(data["blobs"][number]) for m, number in entry["maps"].items()}
        for counter, values in frame.tiles.items():
            assert np.array_equal(maps.get(counter, np.zeros(values.size)), values.ravel()), counter
        pixels = (overdraw_map, depth_complexity_map, overlap_map)
        for m, make in zip(("overdraw", "depth_complexity", "bounds_overlap"), pixels, strict=True):
            assert np.array_equal(maps[m], make(scene, frame.machine, 1).ravel()), m
        assert (
            maps["wasted_samples"].sum() == frame.counters["rs_samples_covered"] - frame.counters["om_samples_visible"]
        )
        for reason in BLAME:
            told = maps[f"blame:{reason}"].sum() if f"blame:{reason}" in maps else 0
            assert told == (0 if name == "triangle" else frame.blame.invocations[reason])
        assert maps.keys() <= data["maps"].keys() <= MAPS.keys()
        assert all(values.any() for values in maps.values())
    assert data["machines"][2]["verified"]["violations"] == 0 and data["machines"][1]["verified"] is None
    assert len(data["pictures"]) == 1, "all machines draw the same"


def test_every_map_has_a_place():
    """But the one that shows the same as its neighbour, a little tighter."""
    assert set(heatmap_names()) - set(MAPS) == {"bounds_overlap:hull"}
    assert set(MAPS) - set(heatmap_names()) == {f"blame:{name}" for name in BLAME}


def test_the_patch_under_each_pixel_is_told(scene, frames, page):
    data = read_data(page)
    under = unpack(data["blobs"][data["under"]]).reshape(61, 83)
    assert np.array_equal(under >= 0, frames["patch"].depth < 1.0)
    for entry in data["machines"]:
        facts = {name: unpack(data["blobs"][number]) for name, number in entry["patches"].items()}
        rect = facts["rect"].reshape(-1, 4)
        assert len(rect) == scene.num_patches and (facts["points"][np.unique(under[under >= 0])] == 16).all()
        for y, x in np.argwhere(under >= 0):
            x0, y0, x1, y1 = rect[under[y, x]]
            assert x0 <= x < x1 and y0 <= y < y1, "a patch is seen inside of its bound"


def test_the_patch_in_front_is_the_one_that_is_seen():
    """Patch 1 hides the right half of patch 0, which the camera sees whole; patch 2 is behind both, patch 3 off the picture."""
    patches = [
        flat_patch(-1, -1, 1, 1), flat_patch(0, -1, 1, 1, y=-0.5), flat_patch(-0.5, -0.5, 0.5, 0.5, y=0.5),
        flat_patch(50, 50, 51, 51),
    ]  # fmt: skip
    for samples in (1, 4):
        scene = patch_scene(patches, samples=samples, face_cull="none")
        machine = tiler.Machine(blame=True)
        seen = look(scene, machine, 0)
        assert set(seen.under[:, :19].ravel()) == {-1, 0} and set(seen.under[:, 21:].ravel()) == {-1, 1}
        frame = tiler.simulate(scene, machine)
        assert seen.visible == frame.blame.ideal["ideal_patches"] == 2
        facts = patch_facts(scene, machine, 0)
        assert facts.points.tolist() == [9, 9, 9, 0] and facts.triangles.tolist() == [8, 8, 8, 0]
        assert not facts.rect[3].any() and (facts.rect[:3, 2] > facts.rect[:3, 0]).all()


@pytest.mark.parametrize("name", MACHINES)
def test_waterfalls_are_those_of_blame_and_add_up(name, load):
    scene = load("teapot", **SMALL)
    frame = tiler.simulate(scene, tiler.Machine(blame=True, **MACHINES[name]))
    visible = look(scene, frame.machine, 0).visible
    steps = [*patch_steps(frame.counters, visible), *invocation_steps(frame.counters, frame.blame)]
    sign = {"all": "", "lost": "- ", "left": "= "}
    told = [(sign[step.kind] + step.title.replace("alive, ", ""), step.value) for step in steps]
    assert told == waterfall(frame.counters, frame.blame)
    for fall in (patch_steps(frame.counters, visible), patch_steps(frame.counters, None), steps[7:]):
        first, *lost, left = fall
        assert first.value - sum(step.value for step in lost) == left.value
        assert (first.kind, left.kind, {step.kind for step in lost}) == ("all", "left", {"lost"})


def test_the_file_asks_for_nothing(page):
    text = page.read_text(encoding="utf-8")
    assert set(re.findall(r"(?:https?|wss?|ftp)://[^\s\"'`)<>]*", text)) == {SVG}
    assert not re.search(
        r"""(?:src|href)\s*=\s*["'](?!#)|@import|url\(|fetch\(|XMLHttpRequest|WebSocket|import\(|eval\(""", text
    )
    assert text.count("default-src 'none'") == 1
    assert {*SCRIPTS, *STYLES} == {p.name for p in (Path(tiler.__file__).parent / "report" / "assets").iterdir()}


def test_names_stay_text(frames, tmp_path):
    from dataclasses import replace

    evil = "</script><script>alert(1)</script><!--\u2028&amp;"
    named = replace(frames["patch"], scene=f"{evil}<img src=x onerror=alert(2)>")
    tiler.write_report({evil: named}, tmp_path / "r.html", command=f"tiler render '{evil}'")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.count("</script>") == 2 and "<img" not in text and "<!--" not in text
    assert "<title>&lt;/script&gt;" in text
    data = read_data(text)
    assert data["machines"][0]["name"] == evil and data["title"] == named.scene


def test_two_reports_of_the_same_differ_in_their_provenance_only(scene, frames, page, tmp_path):
    again = compare(scene, {name: frame.machine for name, frame in frames.items()}, frame=1)
    tiler.write_report(again, tmp_path / "again.html", scene=scene)
    first, second = read_data(page), read_data(tmp_path / "again.html")
    assert first.pop("provenance") != second.pop("provenance")
    assert first == second
    assert make_page(first) == make_page(second)


def test_without_the_scene_there_are_no_pixels_to_tell(scene, frames, tmp_path):
    tiler.write_report(frames["patch"], tmp_path / "r.html")
    data = read_data(tmp_path / "r.html")
    assert data["under"] is None and data["machines"][0]["patches"] is None and data["machines"][0]["name"] == "patch"
    assert {info["per"] for info in data["maps"].values()} == {"tile"}
    (again,) = eval(data["provenance"]["command"], {"tiler": tiler, "scene": scene}).values()
    assert again.machine == frames["patch"].machine and again.counters == frames["patch"].counters, (
        "how to make it is told"
    )
    assert data["machines"][0]["waterfalls"]["patches"][-1]["title"] == "visible patches", "blame knows them"


def test_a_frame_with_no_patch(tmp_path):
    scene = patch_scene([])
    frame = tiler.simulate(scene, tiler.Machine(blame=True))
    tiler.write_report(frame, tmp_path / "r.html", scene=scene)
    data = read_data(tmp_path / "r.html")
    assert data["machines"][0]["patches"] is None and (unpack(data["blobs"][data["under"]]) == -1).all()
    assert [step["value"] for step in data["machines"][0]["waterfalls"]["patches"]] == [0] * 7


def test_frames_of_an_animation_have_a_picture_each(load, tmp_path):
    scene = load("spikelog", **SMALL)
    frames = {f"frame {k}": tiler.simulate(scene, frame=k) for k in (0, 5)}
    tiler.write_report(frames, tmp_path / "r.html", scene=scene)
    data = read_data(tmp_path / "r.html")
    assert len(data["pictures"]) == 2 and [m["picture"] for m in data["machines"]] == [0, 1]
    assert data["under"] is None, "which patch is seen depends on the frame"
    for entry, frame in zip(data["machines"], frames.values(), strict=True):
        found = unpack(data["blobs"][entry["maps"]["overdraw"]])
        assert np.array_equal(found, overdraw_map(scene, frame.machine, frame.number).ravel())


def test_maps_beyond_the_limit_are_left_out_and_named(scene, frames, page, tmp_path, monkeypatch):
    monkeypatch.setattr(collect_module, "MAP_CHARACTERS", 6_000)
    tiler.write_report(frames, tmp_path / "r.html", scene=scene)
    data = read_data(tmp_path / "r.html")
    place = {info.title: k for k, info in enumerate(MAPS.values())}
    kept, left_out = ([place[title] for title in titles] for titles in (
        [info["title"] for info in data["maps"].values()], data["left_out"],
    ))  # fmt: skip
    assert kept == sorted(kept) and kept[0] == 0 and max(kept) < min(left_out)
    whole = read_data(page)
    assert len(kept) + len(left_out) == len(whole["maps"]) and not whole["left_out"]


@pytest.mark.slow
def test_five_machines_at_full_size_stay_below_five_megabytes(tmp_path):
    scene = tiler.load_scene("colonnade", size=(1920, 1080), factor=16)
    made = compare(scene, {name: tiler.Machine(blame=True, **fields) for name, fields in MACHINES.items()})
    tiler.write_report(made, tmp_path / "r.html", scene=scene)
    assert (tmp_path / "r.html").stat().st_size < 5_000_000
    assert not read_data(tmp_path / "r.html")["left_out"]


@pytest.mark.parametrize(
    "values",
    [
        np.arange(300), np.array([], np.int64), np.array([-1, 5, 70_000]), np.array([0, 1 << 31]), np.array([0, 1 << 40, -3]),
        np.array([True, False, True]), np.arange(60, dtype=np.int32).reshape(5, 12) ** 3, np.array([255, 0, 255, 1]),
        np.array([0.5, np.nan, -1e300]), np.zeros((0, 7), np.int32), np.full((4, 4), -9),
    ],
    ids=lambda values: f"{values.dtype}{values.shape}",
)  # fmt: skip
def test_arrays_come_back(values):
    blob = encode(values)
    assert np.array_equal(unpack(blob), values.ravel().astype(float), equal_nan=True)
    blobs = Blobs()
    assert [blobs.add(values), blobs.add(values.copy()), blobs.add(np.array([77]))] == [0, 0, 1]
    assert blobs.size() == sum(len(b["data"]) for b in blobs.stored)


def test_neighbours_that_are_alike_take_little_room():
    y, x = np.mgrid[0:200, 0:300]
    assert len(encode((x // 7) * 40 + (y // 9) * 1000)["data"]) < 1500
    rows = np.random.default_rng(1).integers(0, 1 << 16, 300)[None].repeat(200, axis=0)
    assert encode(rows)["stride"] == 300, "the row above says all"


# Machado, Oliveira, Fernandes 2009, A Physiologically-based Model for Simulation of Color Vision Deficiency, severity 1.
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": np.array([(0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)]),
    "deuteranopia": np.array([(0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.01182, 0.04294, 0.968881)]),
    "tritanopia": np.array([(1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)]),
}  # fmt: skip


@pytest.mark.parametrize("blindness", BLINDNESS)
def test_every_step_of_the_colours_is_seen_by_everyone(blindness):
    linear = np.vectorize(lambda c: c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4)(ramp() / 255.0)
    seen = np.clip(linear @ BLINDNESS[blindness].T, 0.0, 1.0)
    luminance = seen @ np.array([0.2126, 0.7152, 0.0722])
    lightness = 116.0 * np.cbrt(luminance)  # CIE L* + 16, but in the darkest part, which is not reached
    steps = np.diff(lightness[::15])
    assert (steps > 0).all() and steps.max() / steps.min() < (1.6 if blindness == "none" else 2.5)
    assert lightness[-1] - lightness[0] > 70


def test_the_colours_are_even_steps_in_oklab():
    lightness = np.linspace(0.1, 0.9, 5)
    grey = linear_from_oklab(np.stack([lightness, 0 * lightness, 0 * lightness], axis=-1))
    assert np.allclose(grey, lightness[:, None] ** 3, rtol=1e-6), "no chroma is grey; lightness is its cube root"
    assert ramp().shape == (256, 3) and len(np.unique(ramp(), axis=0)) == 256


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Study:
    folder = tmp_path_factory.mktemp("study")
    text = (
        write_study(folder, 1).read_text()
        + '\n[machine.full]\nbinning = "triangle"\nqueue_pool = 5000\nqueue_policy = "fail"\n'
    )
    text = text.replace('["triangle", "small"]', '["triangle", "small", "full"]').replace('"tiny"', '"<tiny>"')
    (folder / "s.toml").write_text(text)
    done = run_sweep(folder / "s.toml", "--out", folder / "s.db", "--report", folder / "made" / "s.html", "-q")
    assert done.returncode == 1, done.stderr
    return tiler.load_study(folder / "s.db")


def test_a_study_holds_its_table(study):
    data = read_data(study.path.parent / "made" / "s.html")
    table = study.to_dict()
    rows, done, failed = study.tally()
    assert (data["rows"], data["done"], data["failed"]) == (rows, done, failed) and 0 < failed < rows
    assert [column["name"] for column in data["columns"]] == [name for name in table if name != "key"]
    for column in data["columns"]:
        values = unpack(data["blobs"][column["values"]])
        absent = unpack(data["blobs"][column["missing"]]) if "missing" in column else np.zeros(len(values))
        texts = column.get("texts")
        found = [None if a else texts[int(v)] if texts is not None else v for v, a in zip(values, absent, strict=True)]
        assert found == table[column["name"]], column["name"]
    assert sum(failure["rows"] for failure in data["failures"]) == failed
    assert len(data["failures"]) == 1 and data["failures"][0]["differ"], "they differ in numbers only"
    assert data["failures"][0]["error"] == study.rows(["error"], status="failed")[0]["error"]
    assert "tiler sweep" in data["provenance"]["command"] and data["provenance"]["versions"]["seed"] == "3"


def test_a_report_of_a_study_that_is_there_runs_nothing(study, tmp_path):
    done = run_sweep("--out", study.path, "--report", tmp_path / "r.html", "-q")
    assert done.returncode == 1, "rows have failed"
    first, second = (read_data(file) for file in (study.path.parent / "made" / "s.html", tmp_path / "r.html"))
    assert first.pop("provenance") != second.pop("provenance")
    assert first == second
    assert collect_study(study, Blobs(), None)["columns"] == first["columns"]


def test_the_python_in_the_docs_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (Path(tiler.__file__).parent.parent / "docs" / "report.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
    exec(code.replace("(640, 360)", "(64, 36), factor=2"), {})
    assert [machine["name"] for machine in read_data(tmp_path / "waves.html")["machines"]] == ["triangle", "patch"]


def test_bad_input_is_told(scene, frames, tmp_path, load):
    patch = frames["patch"]
    for shown, scenes, what in (
        ({}, None, "no frame is given"),
        ({"a": patch, "b": tiler.simulate(load("teapot", size=(40, 30), factor=2))}, None, "a: 83x61, b: 40x30"),
        (patch, load("teapot", size=(40, 30), factor=2), "its picture is 40x30, that of the frames 83x61"),
        ("waves", None, "report: str is not allowed"),
    ):
        with pytest.raises(TilerError, match=what):
            tiler.write_report(shown, tmp_path / "r.html", scene=scenes)
    (tmp_path / "file").touch()
    for target in (tmp_path, tmp_path / "file" / "r.html"):
        with pytest.raises(
            TilerError, match=r"report: .* is not allowed; allowed: a file in a folder that can be written"
        ):
            tiler.write_report(patch, target)
    assert [path.name for path in tmp_path.iterdir()] == ["file"], "nothing was begun"


def test_an_old_report_stays_where_a_new_one_cannot_be_made(frames, tmp_path, monkeypatch):
    file = tmp_path / "r.html"
    file.write_text("old")
    monkeypatch.setattr(collect_module, "picture_uri", lambda color: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        tiler.write_report(frames["patch"], file)
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


def command(monkeypatch, *arguments: str) -> None:
    """The command in this process."""
    monkeypatch.setattr(sys, "argv", ["tiler", *arguments])
    cli.app(arguments, exit_on_error=False, result_action="return_value")


def test_render_and_compare_write_reports(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    small = ("--size", "64x48", "--factor", "2")
    command(monkeypatch, "render", "teapot", *small, "--out", "o", "--report", "o/a report.html", "-q")
    data = read_data(tmp_path / "o" / "a report.html")
    assert (
        data["provenance"]["command"]
        == "tiler render teapot --size 64x48 --factor 2 --out o --report 'o/a report.html' -q"
    )
    machines = ("--machine", "binning=triangle", "--machine", "tile=16")
    command(monkeypatch, "compare", "teapot", *small, *machines, "--report", "c.html", "--json", "-")
    assert [m["name"] for m in read_data(tmp_path / "c.html")["machines"]] == ["binning=triangle", "tile=16"]
    assert json.loads(capsys.readouterr().out)["scene"] == "teapot", "standard output holds the JSON and nothing else"
    with pytest.raises(TilerError, match="report: 3 frames are asked for; allowed: one"):
        command(monkeypatch, "render", "teapot", "--frames", "0..2", "--report", "r.html")
    with pytest.raises(TilerError, match=r"report: \. is not allowed"):
        command(monkeypatch, "compare", "teapot", "--report", ".")
