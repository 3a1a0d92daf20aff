"""Golden pictures and counters of the built-in scenes, exact; and the comparison itself, which must be able to fail."""

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import tiler
from tests.conftest import TESTS, may_update
from tests.golden_images import Golden
from tiler.frame import Frame

SMALL = {"size": (256, 144), "factor": 8}


@dataclass(frozen=True)
class Case:
    """One golden: what is loaded, at which frame, on which machine."""

    scene: str
    load: dict[str, Any]
    machine: dict[str, Any]
    frame: float = 0


CASES = {name: Case(name, SMALL, {}) for name in tiler.scene_names()} | {
    "teapot_normal": Case("teapot", {**SMALL, "shading": "normal"}, {}),
    "teapot_patch": Case("teapot", {**SMALL, "shading": "patch"}, {}),
    "teapot_wireframe": Case("teapot", {**SMALL, "shading": "wireframe", "factor": 4}, {}),
    "teapot_tile_grid": Case("teapot", {**SMALL, "shading": "tile_grid"}, {"tile": 16}),
    "teapot_msaa": Case("teapot", {**SMALL, "samples": 4, "size": (160, 90)}, {}),
    "teapot_frame_60": Case("teapot", SMALL, {"binning": "triangle"}, 60),
    "spikelog_normal": Case("spikelog", {**SMALL, "shading": "normal"}, {}),
    "spikelog_patch_msaa": Case(
        "spikelog", {"size": (200, 120), "shading": "patch", "samples": 4, "factor": 16}, {"tile": 64}
    ),
    "waves_patch": Case("waves", {**SMALL, "shading": "patch"}, {"domain_cache": "frame"}),
    "waves_wireframe_screen_space": Case(
        "waves",
        {"size": (200, 120), "shading": "wireframe", "edge_pixels": 12.0, "partitioning": "fractional_odd"},
        {},
    ),
    "waves_frame_30": Case("waves", {**SMALL, "size": (160, 90)}, {"cull": ()}, 30.5),
    "colonnade_frame_36": Case("colonnade", {**SMALL, "factor": 5}, {"binning": "triangle"}, 36),
}


@pytest.mark.parametrize("name", CASES)
def test_picture_and_counters(name, golden, load):
    case = CASES[name]
    scene = load(case.scene, **case.load)
    golden.check(name, tiler.simulate(scene, tiler.Machine(**case.machine), frame=case.frame))


def test_no_golden_is_left_over(golden):
    files = {file.name for file in golden.folder.iterdir() if not file.name.startswith(".")}
    assert files == {f"{name}{ending}" for name in CASES for ending in (".png", ".counters.txt")}


def test_every_shading_and_scene_has_a_golden():
    shadings = {case.load.get("shading", "lambert") for case in CASES.values()}
    assert shadings == {"lambert", "normal", "patch", "wireframe", "tile_grid"}
    assert {case.scene for case in CASES.values()} == set(tiler.scene_names())


# The comparison itself.


@pytest.fixture(scope="module")
def frame(load) -> Frame:
    return tiler.simulate(load("teapot", size=(64, 36), factor=2), tiler.Machine(tile=16))


@pytest.fixture
def made(tmp_path, frame) -> Golden:
    """A folder with the golden of `frame`, named `pot`."""
    Golden(tmp_path / "golden", tmp_path / "failed", update=True).check("pot", frame)
    return Golden(tmp_path / "golden", tmp_path / "failed")


def changed_frame(frame: Frame, pixels: dict[tuple[int, int], tuple[int, int, int, int]]) -> Frame:
    color = frame.color.copy()
    for (x, y), change in pixels.items():
        color[y, x] = (color[y, x].astype(int) + change).astype(np.uint8)
    return replace(frame, color=color)


def failure(golden: Golden, name: str, frame: Frame) -> str:
    with pytest.raises(pytest.fail.Exception) as caught:
        golden.check(name, frame)
    return str(caught.value)


def test_the_same_frame_passes_and_leaves_nothing(made, frame):
    made.check("pot", frame)
    assert not made.failed.exists()


def test_one_changed_pixel_fails_and_leaves_three_pictures(made, frame):
    actual = changed_frame(frame, {(37, 20): (0, 1, 0, 0)})
    message = failure(made, "pot", actual)
    assert "1 of 2304 pixels differ, in columns 37 to 37 and rows 20 to 20" in message
    assert "largest difference 1 of 255" in message and "of 16 pixels touched: (2, 1)\n" in message
    folder = made.failed / "pot"
    assert str(folder) in message and "--update-golden" in message
    assert np.array_equal(Image.open(folder / "expected.png"), frame.color)
    assert np.array_equal(Image.open(folder / "actual.png"), actual.color)
    seen = np.asarray(Image.open(folder / "difference.png"))[..., :3].any(axis=2)
    assert seen[20, 37] and seen.sum() == 1


def test_difference_names_count_box_tiles_and_size(made, frame):
    message = failure(made, "pot", changed_frame(frame, {(3, 2): (0, 0, 9, 0), (60, 35): (0, 0, 0, -255)}))
    assert "2 of 2304 pixels differ, in columns 3 to 60 and rows 2 to 35" in message
    assert "largest difference 255 of 255" in message and "(0, 0) (3, 2)\n" in message


def test_another_size_fails(made, frame):
    message = failure(made, "pot", replace(frame, color=frame.color[:-1]))
    assert "is 64 x 35 pixels, expected 64 x 36" in message


def test_missing_golden_fails_and_says_how_to_make_it(tmp_path, frame):
    message = failure(Golden(tmp_path / "golden", tmp_path / "failed"), "pot", frame)
    assert "golden picture missing: pot.png" in message and "golden counters missing: pot.counters.txt" in message
    assert "pytest tests/test_golden.py --update-golden" in message
    assert np.array_equal(Image.open(tmp_path / "failed" / "pot" / "actual.png"), frame.color)


def test_changed_counter_fails_with_the_deviation(made, frame):
    file = made.folder / "pot.counters.txt"
    value = frame.counters["ds_invocations"]
    text = file.read_text().replace(f"ds_invocations {value}\n", f"ds_invocations {value - 5}\n")
    file.write_text(text.replace("queue_longest", "queue_oldest"))
    message = failure(made, "pot", frame)
    assert f"ds_invocations: expected {value - 5}, measured {value}, +5" in message
    assert "queue_oldest" in message and "is gone" in message and "queue_longest: expected None" in message
    assert "golden counters pot: 3 differ" in message and "picture" not in message


def test_update_makes_a_wrong_golden_right(made, frame):
    actual = changed_frame(frame, {(0, 0): (1, 1, 1, 0)})
    replace(made, update=True).check("pot", actual)
    made.check("pot", actual)
    assert sorted(file.name for file in made.folder.iterdir()) == ["pot.counters.txt", "pot.png"]
    assert "1 of 2304 pixels differ" in failure(made, "pot", frame)


def test_update_is_refused_in_ci():
    assert may_update({}) and may_update({"CI": ""}) and not may_update({"CI": "true"}) and not may_update({"CI": "1"})


def test_update_option_is_refused_in_ci():
    before = {file: file.stat().st_mtime_ns for file in (TESTS / "golden").iterdir()}
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--update-golden", str(Path(__file__))],
        env=os.environ | {"CI": "true"}, cwd=TESTS.parent, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == pytest.ExitCode.USAGE_ERROR, run.stdout + run.stderr
    assert "--update-golden: refused" in run.stderr
    assert before == {file: file.stat().st_mtime_ns for file in (TESTS / "golden").iterdir()}
