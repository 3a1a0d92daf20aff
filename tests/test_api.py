"""The public surface: light to import, as documented, annotated; and the rules about who may import whom."""

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

import pipeline
import tiler
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS, FLAG_OF
from pipeline.tessellator import tessellate
from tests.conftest import TESTS

ROOT = TESTS.parent
PACKAGES = (pipeline, tiler)
HEAVY = ("numba", "numpy", "pydantic", "PIL", "trimesh", "cyclopts", "rich", "moderngl")


def run_python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.strip()


def modules() -> list[str]:
    names = [package.__name__ for package in PACKAGES]
    for package in PACKAGES:
        names += [m.name for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
    return [name for name in names if not name.endswith("__main__")]


# Importing.


def test_import_is_light():
    code = f"""
import sys, time
before = time.process_time()
import tiler
dir(tiler), tiler.__version__
seconds = time.process_time() - before
print([name for name in {HEAVY} if name in sys.modules], seconds)
"""
    loaded, seconds = run_python(code).rsplit(" ", 1)
    assert loaded == "[]"
    assert float(seconds) < 0.5


def test_importing_the_machine_compiles_nothing():
    """A helper that is called while a module is imported would be compiled by every process: helpers are not cached."""
    code = "import tiler.machine, tiler.simulation\nfrom pipeline.jit import announcer\nprint(announcer.compiled)"
    assert run_python(code) == "0"


def test_scenes_need_no_mesh_library():
    """trimesh is loaded where a mesh file is read, and nowhere else."""
    assert run_python("import sys, tiler; tiler.load_scene('teapot'); print('trimesh' in sys.modules)") == "False"


def test_public_names_are_complete_and_documented():
    assert set(tiler.__all__) == {
        "Frame",
        "Machine",
        "Scene",
        "Shared",
        "TilerError",
        "__version__",
        "export_glb",
        "load_machine",
        "load_scene",
        "load_study",
        "register_bound",
        "register_cull_test",
        "scene_names",
        "simulate",
        "sweep",
        "unregister",
        "write_report",
        "write_trace",
    }
    assert dir(tiler) == sorted(tiler.__all__)
    for name in tiler.__all__:
        value = getattr(tiler, name)
        assert name == "__version__" or len(value.__doc__) > 20, name
    with pytest.raises(AttributeError, match="module 'tiler' has no attribute 'banana'"):
        tiler.banana  # noqa: B018 - the access is the test
    with pytest.raises(ImportError):
        from tiler import banana  # noqa: F401


# What users call, as the design says it.


@pytest.fixture(scope="module")
def frame() -> tiler.Frame:
    scene = tiler.load_scene("teapot", size=(100, 60), factor=4)
    machine = tiler.Machine(tile=32, binning="patch", bounds="cbox", cull=("frustum",))
    return tiler.simulate(scene, machine)


def test_picture_and_depth(frame):
    assert frame.color.shape == (60, 100, 4) and frame.color.dtype == np.uint8
    assert frame.depth.shape == (60, 100) and frame.depth.dtype == np.float32
    assert (frame.color[..., 3] == 255).all()
    assert np.array_equal(frame.image(), frame.color)
    assert 0 < np.count_nonzero(frame.depth < 1) < frame.depth.size and frame.depth.min() >= 0
    assert frame.seconds > 0 and frame.number == 0 and frame.scene == "teapot"
    assert "teapot" in repr(frame) and "100x60" in repr(frame) and len(repr(frame)) < 100


def test_depth_is_that_of_sample_0():
    frame = tiler.simulate(tiler.load_scene("teapot", size=(40, 24), factor=2, samples=4))
    assert frame.color.shape == (24, 40, 4) and frame.depth.shape == (24, 40)
    assert frame.depth_samples.shape == (24, 40, 4) and frame.depth_samples.dtype == np.float32
    assert np.array_equal(frame.depth, frame.depth_samples[:, :, 0])
    assert not np.array_equal(frame.depth, frame.depth_samples[:, :, 1])


def test_counters(frame):
    assert isinstance(frame.counters, Mapping)
    assert type(frame.counters["ds_invocations"]) is int and frame.counters["ds_invocations"] > 0
    table = frame.counters.table()
    assert isinstance(table, str) and "ds_invocations" in table and f"{frame.counters['ds_invocations']:,}" in table


def test_queues(frame):
    assert frame.queues.entries.shape == (2, 4) and frame.queues.entries.dtype == np.int64
    assert frame.queues.bytes == frame.counters["queue_bytes"]


def test_heatmap(frame, tmp_path):
    assert len(frame.tiles) > 3
    for name in frame.tiles:
        frame.heatmap(name).save(tmp_path / f"{name}.png")
        picture = np.asarray(Image.open(tmp_path / f"{name}.png"))
        assert picture.shape == (60, 100, 3)
        for y in range(2):
            for x in range(4):  # one colour a tile, equal values equal colours
                of_tile = picture[32 * y : 32 * y + 32, 32 * x : 32 * x + 32].reshape(-1, 3)
                assert (of_tile == of_tile[0]).all()
                same = frame.tiles[name] == frame.tiles[name][y, x]
                assert all((picture[32 * j, 32 * i] == of_tile[0]).all() for j, i in np.argwhere(same))
    most = np.unravel_index(frame.queues.entries.argmax(), (2, 4))
    picture = np.asarray(frame.heatmap("queue_entries")).astype(int)
    assert picture[32 * most[0], 32 * most[1]].sum() == picture.sum(axis=2).max()
    dimmer = np.asarray(frame.heatmap("queue_entries", scale=10.0 * frame.queues.entries.max())).astype(int)
    assert dimmer.sum() < picture.sum()


def test_heatmap_names_what_it_knows(frame):
    with pytest.raises(tiler.TilerError, match="did you mean 'queue_entries'"):
        frame.heatmap("queue_entrys")


def test_default_machine(frame):
    scene = tiler.load_scene("teapot", size=(100, 60), factor=4)
    by_default = tiler.simulate(scene)
    assert by_default.machine == tiler.Machine() and np.array_equal(by_default.color, frame.color)


def test_same_input_same_bits(frame):
    scene = tiler.load_scene("teapot", size=(100, 60), factor=4)
    again = tiler.simulate(scene, frame.machine)
    assert np.array_equal(again.color, frame.color) and np.array_equal(again.depth, frame.depth)
    assert dict(again.counters) == dict(frame.counters)


def test_errors_are_value_errors():
    assert issubclass(tiler.TilerError, ValueError)


def test_stages_can_be_called_alone():
    points, indices = tessellate("quad", "fractional_odd", edge=(3, 4.5, 2, 7), inside=(5, 5), output="triangle_cw")
    assert points.dtype == np.float32 and points.shape[1] == 2
    assert indices.dtype == np.uint32 and indices.ndim == 1 and len(indices) % 3 == 0
    assert "cbox" in BOUNDS and all(map(callable, BOUNDS.values()))
    assert "frustum" in CULL_TESTS and set(FLAG_OF) == set(CULL_TESTS)


# House rules.


def public_functions(module: ModuleType) -> list[tuple[str, object]]:
    """Functions and methods that a user may call; kernels and helpers are dispatchers, not functions, and not among them."""
    found = []
    for name, value in vars(module).items():
        if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
            continue
        if inspect.isfunction(value):
            found.append((f"{module.__name__}.{name}", value))
        elif inspect.isclass(value):
            for method, member in vars(value).items():
                function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
                if (
                    not method.startswith("_")
                    and inspect.isfunction(function)
                    and function.__module__ == module.__name__
                ):
                    found.append((f"{module.__name__}.{name}.{method}", function))
    return found


def test_public_functions_are_annotated():
    functions = [f for name in modules() for f in public_functions(importlib.import_module(name))]
    assert len(functions) > 60
    bare = []
    for name, function in functions:
        signature = inspect.signature(function)
        parameters = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
        if signature.return_annotation is signature.empty or any(p.annotation is p.empty for p in parameters):
            bare.append(name)
    assert not bare, bare


def imports_of(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def importers(folder: str, banned: tuple[str, ...]) -> list[str]:
    return [
        f"{file.relative_to(ROOT)} imports {name}"
        for file in sorted((ROOT / folder).rglob("*.py"))
        for name in sorted(imports_of(file))
        if any(name == b or name.startswith(b + ".") for b in banned)
    ]


def test_pipeline_knows_nothing_of_tiles():
    assert importers("pipeline", ("tiler", "tests")) == []
    assert importers("tiler", ("pipeline",)), "the search finds nothing at all"


def test_packages_do_not_import_the_tests():
    assert importers("tiler", ("tests",)) == []


def test_machine_does_not_know_the_command_line():
    machine = (
        "machine",
        "tile",
        "back_end",
        "front_end",
        "binning",
        "rasterizer",
        "tally",
        "frame",
        "simulation",
        "config",
    )
    for name in machine:
        file = ROOT / "tiler" / f"{name}.py"
        assert not imports_of(file) & {"tiler.cli", "tiler.options", "tiler.progress", "cyclopts", "rich"}, name


def test_no_pickle_is_loaded():
    assert (
        importers("pipeline", ("pickle", "shelve", "marshal")) + importers("tiler", ("pickle", "shelve", "marshal"))
        == []
    )


def test_scenes_are_data():
    files = [file for file in (ROOT / "scenes").rglob("*") if file.is_file()]
    assert {file.suffix for file in files} <= {".toml", ".npz", ".npy", ".png", ".obj", ".md"}
    assert {file.stem for file in files if file.suffix == ".toml"} == set(tiler.scene_names())
    assert not any(file.stat().st_mode & 0o111 for file in files)


def test_no_fastmath():
    for package in PACKAGES:
        for file in Path(package.__path__[0]).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.keyword):
                    assert node.arg not in ("fastmath", "parallel"), file
