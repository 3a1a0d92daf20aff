"""The process that compiles the back end's kernels while the first frame compiles the front end's."""

import os
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

import tiler
from pipeline import primitives
from tiler import compile_ahead, tile


@pytest.fixture
def scene(load):
    return load("teapot", size=(48, 32))


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """As in a process that has drawn no frame, on two processors, without kernels; what is started instead leaves a file."""
    monkeypatch.setattr(compile_ahead, "_looked", [])
    monkeypatch.setattr(compile_ahead, "_other", [])
    monkeypatch.setattr(compile_ahead, "available_threads", lambda: 2)
    monkeypatch.setattr(compile_ahead, "_missing", lambda kernel: True)
    leave = f"import os, tempfile; tempfile.mkstemp(dir={str(tmp_path)!r}); raise SystemExit(os.environ['TILER_QUIET'] != '1')"
    monkeypatch.setattr(compile_ahead, "COMMAND", [sys.executable, "-c", leave])
    return lambda: len(list(tmp_path.iterdir()))


def test_it_calls_kernels_as_a_frame_does(scene):
    """Each is compiled for one signature only: what it leaves in the cache is what a frame looks for."""
    compile_ahead.compile_back_end()
    for binning in ("patch", "triangle"):
        tiler.simulate(scene, tiler.Machine(binning=binning, overlap="exact"), threads=1)
    kernels = (*compile_ahead.KERNELS, primitives.project_points, primitives.count_cuts)
    assert [len(kernel.signatures) for kernel in kernels] == [1] * 4
    assert not any(map(compile_ahead._missing, compile_ahead.KERNELS))


def test_a_kernel_is_missing_where_neither_process_nor_disk_has_it(tmp_path):
    def kernel(**overloads):
        stats = SimpleNamespace(cache_path=str(tmp_path))
        return SimpleNamespace(stats=stats, overloads=overloads, py_func=tile.process_tiles.py_func)

    assert compile_ahead._missing(kernel())
    assert not compile_ahead._missing(kernel(some="code"))
    (tmp_path / "tile.other-3.py311.nbi").touch()
    assert compile_ahead._missing(kernel())
    (tmp_path / "tile.process_tiles-443.py311.nbi").touch()
    assert not compile_ahead._missing(kernel())


def test_it_starts_once_and_a_frame_does_not_depend_on_it(fresh, scene):
    alone = tiler.simulate(scene, threads=1)
    assert fresh() == 0  # one thread was asked for
    frames = [tiler.simulate(scene, threads=2) for _ in range(2)]
    assert fresh() == 1 and not compile_ahead._other
    for frame in frames:
        np.testing.assert_array_equal(frame.color, alone.color)
        assert frame.counters == alone.counters


def test_machines_whose_kernel_is_another_do_not_start_it(fresh, scene):
    tiler.simulate(scene, tiler.Machine(binning="triangle"), threads=2)
    assert fresh() == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("available_threads", lambda: 1),
        ("_missing", lambda kernel: kernel is tile.process_tiles),
        ("sys.executable", ""),
        ("sys.frozen", True),
    ],
)
def test_it_does_not_start_without_need_or_a_python(fresh, monkeypatch, name, value):
    monkeypatch.setattr(f"tiler.compile_ahead.{name}", value, raising=False)
    compile_ahead.begin()
    compile_ahead.wait()
    assert fresh() == 0


def test_one_that_cannot_start_or_fails_or_is_stuck_is_done_without(fresh, scene, monkeypatch):
    for command in ("no such program",), (sys.executable, "-c", "raise ValueError"):
        monkeypatch.setattr(compile_ahead, "_looked", [])
        monkeypatch.setattr(compile_ahead, "COMMAND", list(command))
        tiler.simulate(scene, threads=2)
        assert not compile_ahead._other
    monkeypatch.setattr(compile_ahead, "_looked", [])
    monkeypatch.setattr(compile_ahead, "MOST_SECONDS", 0.1)
    monkeypatch.setattr(compile_ahead, "COMMAND", [sys.executable, "-c", "import time; time.sleep(60)"])
    compile_ahead.begin()
    (other,) = compile_ahead._other
    begin = time.monotonic()
    compile_ahead.wait()
    assert time.monotonic() - begin < 30 and other.poll() is not None and not compile_ahead._other


def test_it_ends_when_nobody_waits_for_it_any_more(tmp_path):
    """Its input ends with the process that started it, however that ended; compiling on takes it some twenty seconds."""
    environment = os.environ | {"TILER_CACHE_DIR": str(tmp_path)}
    process = subprocess.Popen(compile_ahead.COMMAND, stdin=subprocess.PIPE, env=environment)
    try:
        until = time.monotonic() + 60
        while not any(tmp_path.rglob("*.nb?")) and time.monotonic() < until:
            assert process.poll() is None
            time.sleep(0.05)
        process.stdin.close()
        begin = time.monotonic()
        assert process.wait(30) == 0 and time.monotonic() - begin < 5
        assert not any(tmp_path.rglob("tile.process_tiles-*.nbi")), "it did not finish its work"
    finally:
        process.kill()
        process.wait()
