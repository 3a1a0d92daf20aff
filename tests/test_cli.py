"""The command `tiler`, as a user runs it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tiler import cli, validation
from tiler.animation import render_to_folder
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.errors import TilerError
from tiler.scene import load_scene

SMALL = ("--size", "96x64", "--factor", "4")


def tiler(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tiler", *arguments], cwd=cwd, capture_output=True, text=True, timeout=300, check=False
    )


def test_scenes_lists_every_scene(tmp_path: Path) -> None:
    done = tiler("scenes", "--json", "-", cwd=tmp_path)
    assert done.returncode == 0
    found = {scene["name"]: scene for scene in json.loads(done.stdout)["scenes"]}
    assert found["teapot"]["patches"] == 32
    assert found["spikelog"]["patches"] == 96
    assert found["waves"]["patches"] == 1024
    assert "colonnade" in found


def test_render_leaves_picture_depth_and_counters(tmp_path: Path) -> None:
    done = tiler("render", "teapot", *SMALL, "--heatmap", "queue_entries,ds_invocations", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {
        "color.png", "depth.npy", "counters.json", "queue_entries.png", "ds_invocations.png",
    }  # fmt: skip
    assert Image.open(out / "color.png").size == (96, 64)
    assert np.load(out / "depth.npy", allow_pickle=False).shape == (64, 96)
    result = json.loads((out / "counters.json").read_text())
    assert result["provenance"]["version"] and result["provenance"]["numba"] != "unknown"
    frame = result["frames"][0]
    assert frame["counters"]["ia_primitives"] == 32
    for name in DEFINITIONS:
        assert name in done.stdout


def test_json_on_standard_output_is_one_object_and_nothing_else(tmp_path: Path) -> None:
    done = tiler("render", "teapot", *SMALL, "--json", "-", cwd=tmp_path)
    result = json.loads(done.stdout)
    assert result.keys() == {"scene", "machine", "frames"}
    assert result["scene"] == "teapot"
    assert result["machine"]["tile"] == 32
    assert result["frames"][0].keys() == {"frame", "counters", "seconds"}
    assert result["frames"][0]["counters"].keys() == DEFINITIONS.keys()


def test_counters_prints_every_definition(tmp_path: Path) -> None:
    told = json.loads(tiler("counters", "--json", "-", cwd=tmp_path).stdout)["counters"]
    assert [row["name"] for row in told] == list(DEFINITIONS)
    assert all(row["unit"] and row["stage"] and row["text"] for row in told)
    lines = tiler("counters", cwd=tmp_path).stdout.splitlines()
    assert len(lines) == len(DEFINITIONS)
    assert any(line.startswith("ds_invocations ") and "D3D11 DSInvocations" in line for line in lines)


def test_a_reader_that_has_enough_is_no_error(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "tiler", "counters"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        assert child.stdout
        child.stdout.close()  # long before the interpreter has started
        assert child.wait(timeout=60) == 141
        assert child.stderr and child.stderr.read() == b""


def test_json_to_a_file_keeps_the_table(tmp_path: Path) -> None:
    done = tiler("render", "teapot", *SMALL, "--json", "result.json", cwd=tmp_path)
    assert "ds_invocations" in done.stdout
    assert json.loads((tmp_path / "result.json").read_text())["scene"] == "teapot"


def test_compare_puts_the_baseline_first(tmp_path: Path) -> None:
    done = tiler("compare", "teapot", *SMALL, "--json", "-", cwd=tmp_path)
    machines = json.loads(done.stdout)["machines"]
    assert [machine["name"] for machine in machines] == [
        "triangle", "patch", "patch, frame cache", "patch, all", "subpatch, all",
    ]  # fmt: skip
    assert all(machine["same_picture"] for machine in machines)
    assert machines[0]["machine"]["binning"] == "triangle"
    assert machines[1]["counters"]["queue_entries"] < machines[0]["counters"]["queue_entries"]
    text = tiler("compare", "teapot", *SMALL, cwd=tmp_path).stdout
    assert "pictures: bit-identical" in text
    row = next(line.split() for line in text.splitlines() if line.startswith("queue_entries"))
    entries = [machine["counters"]["queue_entries"] for machine in machines]
    assert row[1:4] == [f"{entries[0]:,}", f"{entries[1]:,}", f"x{entries[1] / entries[0]:.3g}"]


def test_compare_takes_machines(tmp_path: Path) -> None:
    arguments = ("--machine", "binning=patch,tile=16,cull=none", "--machine", "tile=64", "--cores", "3")
    done = tiler("compare", "teapot", *SMALL, *arguments, "--json", "-", cwd=tmp_path)
    first, second = json.loads(done.stdout)["machines"]
    assert (first["machine"]["tile"], first["machine"]["cull"], first["machine"]["cores"]) == (16, [], 3)
    assert (second["machine"]["tile"], second["machine"]["cull"], second["machine"]["cores"]) == (64, ["frustum"], 3)


def test_compare_fails_when_pictures_differ(tmp_path: Path) -> None:
    # The grid is drawn at tile borders: two tile sizes draw two pictures, on purpose.
    arguments = ("--shading", "tile_grid", "--machine", "tile=16", "--machine", "tile=32")
    done = tiler("compare", "teapot", *SMALL, *arguments, cwd=tmp_path)
    assert done.returncode == 1
    assert "pictures: DIFFERENT" in done.stdout


def test_frames_resume_where_they_stopped(tmp_path: Path) -> None:
    command = ("render", "teapot", *SMALL, "--frames", "0..3", "-q")
    assert tiler(*command, cwd=tmp_path).returncode == 0
    out = tmp_path / "out"
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert {
        "color_0000.png",
        "color_0003.png",
        "depth_0002.npy",
        "counters_0001.json",
        "counters.json",
    } <= before.keys()
    pictures = [(out / f"color_000{k}.png").read_bytes() for k in range(4)]
    assert len(set(pictures)) == 4, "the camera moves"
    (out / "color_0002.png").unlink()
    assert tiler(*command, cwd=tmp_path).returncode == 0
    after = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    drawn = {name for name in before if after[name] != before[name]}
    assert drawn == {"color_0002.png", "depth_0002.npy", "counters_0002.json", "counters.json"}
    assert (out / "color_0002.png").read_bytes() == pictures[2]
    frames = json.loads((out / "counters.json").read_text())["frames"]
    assert [frame["frame"] for frame in frames] == [0, 1, 2, 3]
    # Another machine is another result: nothing is taken over.
    assert tiler(*command, "--tile", "64", cwd=tmp_path).returncode == 0
    assert all(path.stat().st_mtime_ns != after[path.name] for path in out.iterdir())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("render", "teapott"), ["teapott", "teapot", "waves"]),
        (("render", "nothing.toml"), ["nothing.toml"]),
        (("render", "teapot", "--size", "0x64"), ["size", "0", "1", "16384"]),
        (("render", "teapot", "--size", "64"), ["size", "'64'", "WIDTHxHEIGHT"]),
        (("render", "teapot", "--tile", "48"), ["tile", "48", "power of two"]),
        (("render", "teapot", "--bounds", "cbx"), ["bounds", "'cbx'", "did you mean 'cbox'"]),
        (("render", "teapot", "--cull", "frustrum"), ["cull", "did you mean 'frustum'"]),
        (("render", "teapot", "--factor", "65"), ["factor", "65", "64"]),
        (("render", "teapot", "--factor", "nan"), ["factor", "nan"]),
        (("render", "teapot", "--factor", "1,2"), ["factor", "'1,2'", "six"]),
        (("render", "teapot", "--frames", "9..3"), ["frames", "9..3"]),
        (("render", "teapot", "--heatmap", "queue"), ["heatmap", "'queue'", "queue_entries"]),
        (("render", "teapot", "--samples", "3"), ["samples", "3", "4"]),
        (("render", "teapot", "--threads", "0"), ["threads", "0", "1 to 1024"]),
        (("render", "teapot", "--out", "a-file/sub"), ["out", "a-file"]),
        (("compare", "teapot", "--machine", "tiles=16"), ["tiles", "did you mean 'tile'"]),
        (("compare", "teapot", "--machine", "16"), ["machine", "'16'", "key=value"]),
    ],
)
def test_bad_input_is_one_clear_error(tmp_path: Path, arguments: tuple[str, ...], said: list[str]) -> None:
    (tmp_path / "a-file").write_text("in the way")
    done = tiler(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for fragment in said:
        assert fragment in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a-file"], "nothing half-written is left"


@pytest.mark.parametrize("option", ["--tile-size", "--binnin"])
def test_an_unknown_option_is_refused(tmp_path: Path, option: str) -> None:
    done = tiler("render", "teapot", option, "16", cwd=tmp_path)
    assert done.returncode == 2
    assert option in done.stderr + done.stdout
    assert not (tmp_path / "out").exists()


def test_blame_is_told_as_a_waterfall_and_in_json(tmp_path: Path) -> None:
    done = tiler("render", "teapot", "--size", "96x64", "--factor", "3", "--blame", "--heatmap", "wasted_domain_points",
                 cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "= useful invocations" in done.stdout and "ideal_patches" in done.stdout
    assert (tmp_path / "out" / "wasted_domain_points.png").exists()
    record = json.loads((tmp_path / "out" / "counters.json").read_text())["frames"][0]
    assert sum(record["blame"]["invocations"].values()) == record["counters"]["ds_invocations"]
    machines = ("--machine", "binning=triangle", "--machine", "binning=patch")
    done = tiler("compare", "teapot", "--size", "96x64", "--factor", "3", "--blame", *machines, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("= useful invocations")]
    once, again = line.split()[-2:]
    assert once == again, "what is useful does not depend on the machine"
    done = tiler(
        "compare", "teapot", "--size", "96x64", "--factor", "3", "--blame", *machines, "--json", "-", cwd=tmp_path
    )
    for made in json.loads(done.stdout)["machines"]:
        assert sum(made["blame"]["invocations"].values()) == made["counters"]["ds_invocations"]
        assert made["blame"]["ideal"]["ideal_patches"] > 0


def test_a_picture_larger_than_memory_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiler.memory.available_bytes", lambda: 10**9)
    scene = load_scene("teapot", size=(16384, 16384))
    with pytest.raises(TilerError, match=r"16384 x 16384 .* 3\.4 GB; .* 1\.0 GB"):
        render_to_folder(scene, Machine(), [0], tmp_path / "out", threads=1)
    assert not (tmp_path / "out").exists()


def test_interrupt_leaves_whole_files_only(tmp_path: Path) -> None:
    arguments = ["render", "teapot", "--size", "640x360", "--frames", "0..500", "-q"]
    with subprocess.Popen([sys.executable, "-m", "tiler", *arguments], cwd=tmp_path, stderr=subprocess.PIPE) as process:
        out = tmp_path / "out"
        deadline = time.monotonic() + 240
        while process.poll() is None and len(list(out.glob("counters_*.json"))) < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
        os.kill(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.decode().strip().splitlines()[-1] == "interrupted"
    assert not (out / "counters.json").exists()
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    for path in out.glob("color_*.png"):
        Image.open(path).load()
    for path in out.glob("depth_*.npy"):
        assert np.load(path, allow_pickle=False).shape == (360, 640)


def test_doctor_and_version(tmp_path: Path) -> None:
    done = tiler("doctor", cwd=tmp_path)
    assert "numba" in done.stdout
    assert "scenes" in done.stdout
    assert tiler("--version", cwd=tmp_path).stdout.strip()


def test_validate_bounds_gets_its_samples(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """`--samples` of `validate` are shaded points, not those of a pixel."""
    asked = []

    def check(samples: int, **options: object) -> dict[str, object]:
        asked.append((samples, options["seed"], options["names"]))
        return {"what": "bounds", "cases": 0, "failed": 0, "details": []}

    monkeypatch.setattr(validation, "validate_bounds", check)
    cli.app(
        ["validate", "bounds", "--samples", "40000000", "--seed", "7", "--bounds", "cbox", "-q"],
        result_action="return_value",
    )
    assert asked == [(40_000_000, 7, ["cbox"])]
