"""The cache of compiled kernels: notices an edit anywhere below a kernel, compiles nothing without one, survives a folder
that cannot be written, and says once why the first run takes longer."""

import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from pipeline import jit, jit_lowering

ANNOUNCEMENT = "compiling kernels"

# A package of three modules, named like one of ours: kernels in `stage`, a helper in `arithmetic`, a number in `numbers_of`.
STAGE = """
from pipeline.arithmetic import add
from pipeline.jit import kernel

@kernel
def total(n):
    result = 0
    for i in range(n):
        result = add(result, i)
    return result

@kernel
def double(n):
    return add(n, n)
"""
ARITHMETIC = """
from . import numbers_of
from pipeline.jit import helper

STEP = numbers_of.STEP

@helper
def add(a, b):
    return a + b * STEP
"""
NUMBERS_OF = "STEP = 1\n"
MAIN = "from pipeline.stage import total, double; print(total(5), double(3))"


class Package:
    """A package on disk, and fresh processes that use it."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "source"
        self.temporary = folder / "temporary"
        self.cache = folder / "cache"
        self.temporary.mkdir()
        (self.root / "pipeline").mkdir(parents=True)
        for module in (jit, jit_lowering):
            shutil.copy(str(module.__file__), self.root / "pipeline")
        for name, text in (("__init__", ""), ("stage", STAGE), ("arithmetic", ARITHMETIC), ("numbers_of", NUMBERS_OF)):
            self.write(name, text)

    def write(self, module: str, text: str) -> None:
        (self.root / "pipeline" / f"{module}.py").write_text(text)

    def run(self, **environment: str) -> tuple[str, str]:
        """What a fresh process prints, and what it says on standard error."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("TILER_", "NUMBA_", "XDG_"))}
        done = subprocess.run(
            [sys.executable, "-c", MAIN],
            env=kept | {
                "PYTHONPATH": str(self.root), "TMPDIR": str(self.temporary), "TILER_CACHE_DIR": str(self.cache),
                "PYTHONDONTWRITEBYTECODE": "1",
            } | environment,
            cwd=self.root, capture_output=True, text=True, timeout=60, check=True,
        )  # fmt: skip
        return done.stdout.strip(), done.stderr

    def folders(self) -> list[str]:
        return sorted(folder.name for folder in self.cache.iterdir())


@pytest.fixture
def package(tmp_path) -> Package:
    return Package(tmp_path)


def test_cache_notices_every_edit_and_compiles_nothing_without_one(package):
    first, said = package.run()
    assert first == "10 6"
    assert said.count(ANNOUNCEMENT) == 1, f"two kernels were compiled, one announcement is due: {said!r}"
    assert "first run" in said
    folders = package.folders()

    again, said = package.run()
    assert (again, said) == ("10 6", ""), "compiled again, though nothing changed"
    assert package.folders() == folders

    # The helper in another file; the file of the kernels stays as it is.
    package.write("arithmetic", ARITHMETIC.replace("a + b * STEP", "a + 100 * b * STEP"))
    edited, said = package.run()
    assert edited == "1000 303", "a stale kernel answered"
    assert ANNOUNCEMENT in said

    # A constant two imports away, through a relative import.
    package.write("numbers_of", "STEP = 2\n")
    edited, said = package.run()
    assert edited == "2000 603" and ANNOUNCEMENT in said

    # Back to what it was: the old kernels are still there.
    package.write("arithmetic", ARITHMETIC)
    package.write("numbers_of", NUMBERS_OF)
    assert package.run() == ("10 6", "")


WAYS_TO_BLOCK = ["a file is in its place"] + ["read-only"] * (os.geteuid() != 0)  # root may write anywhere


@pytest.mark.parametrize("blocked", WAYS_TO_BLOCK)
def test_unwritable_cache_folder_falls_back_to_a_temporary_one(blocked, package, tmp_path):
    if blocked == "read-only":
        package.cache.mkdir()
        package.cache.chmod(0o500)
    else:
        package.cache.write_text("not a folder")
    answer, said = package.run(TILER_QUIET="1")
    assert (answer, said) == ("10 6", "")
    assert [folder.name[:14] for folder in package.temporary.iterdir()] == ["tiler-kernels-"]


def test_without_a_home_folder_it_still_runs(package):
    """No TILER_CACHE_DIR, no XDG folder that can be made; and TILER_QUIET silences the announcement."""
    blocked = package.root / "file"
    blocked.write_text("")
    answer, said = package.run(TILER_CACHE_DIR="", XDG_CACHE_HOME=str(blocked), HOME=str(blocked), TILER_QUIET="1")
    assert (answer, said) == ("10 6", "")


# The digest behind it, without compiling.


@pytest.fixture
def sources(tmp_path) -> Path:
    for name, text in {
        "pipeline/__init__.py": "", "tiler/__init__.py": "", "tiler/deep/__init__.py": "", "pipeline/used.py": "A = 1\n",
        "pipeline/unused.py": "B = 1\n", "tiler/deep/inner.py": "from pipeline.used import A\n",
    }.items():  # fmt: skip
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True, parents=True)
        file.write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    "where, statement",
    [
        ("pipeline/a.py", "from pipeline.used import A"),
        ("pipeline/a.py", "from pipeline import used"),
        ("pipeline/a.py", "import pipeline.used"),
        ("pipeline/a.py", "import pipeline.used as u"),
        ("pipeline/a.py", "from .used import A"),
        ("pipeline/a.py", "from . import used"),
        ("tiler/deep/a.py", "from .inner import A"),
        ("tiler/deep/a.py", "from tiler.deep import inner"),
        ("tiler/a.py", "from .deep.inner import A"),
        ("tiler/a.py", "def f():\n    from pipeline.used import A\n    return A"),
    ],
)
def test_digest_follows_every_kind_of_import(where, statement, sources):
    file = sources / where
    file.write_text(statement + "\n")
    before = jit.source_digest(file, sources)
    assert jit.source_digest(file, sources) == before and len(before) == 16
    (sources / "pipeline/unused.py").write_text("B = 2\n")
    assert jit.source_digest(file, sources) == before, "an edit that cannot matter changed the digest"
    (sources / "pipeline/used.py").write_text("A = 2\n")
    after = jit.source_digest(file, sources)
    assert after != before
    file.write_text(statement + "  # edited\n")
    assert jit.source_digest(file, sources) not in (before, after)


def test_digest_of_modules_that_import_each_other(sources):
    one, two = sources / "pipeline/one.py", sources / "pipeline/two.py"
    one.write_text("from pipeline import two\n")
    two.write_text("from pipeline import one\n")
    before = jit.source_digest(one, sources)
    two.write_text("from pipeline import one  # edited\n")
    assert jit.source_digest(one, sources) != before


def test_old_folders_are_forgotten_and_others_left_alone(tmp_path):
    old, used, foreign = (tmp_path / name for name in ("0123456789abcdef", "fedcba9876543210", "something else"))
    for folder in (old, used, foreign):
        folder.mkdir()
        (folder / "kernel.nbc").write_text("x")
    for folder in (old, foreign):
        os.utime(folder, (0, 0))
    jit._prune(tmp_path)
    assert not old.exists() and used.exists() and foreign.exists()


@jit.inlined
def _squared(x):
    return x * x


@jit.unaliased
def _fill(source, target):
    for i in range(len(source)):
        target[i] = _squared(source[i])


@numba.njit
def _sum_of_squares(source):
    target = np.empty_like(source)
    _fill(source, target)
    return target.sum()


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the compiler is switched off")
def test_helpers_end_as_parts_of_kernels_and_python_calls_a_whole():
    numbers = np.arange(10.0)
    assert _sum_of_squares(numbers) == 285.0
    (part,) = _fill.overloads.values()
    assert not callable(part.entry_point)
    assert part.library.get_pointer_to_function(part.fndesc.llvm_func_name) == 0  # no machine code
    target = np.zeros(10)
    _fill(numbers, target)
    assert (target == numbers**2).all() and len(_fill.whole.overloads) == 1


def test_a_helper_that_cannot_be_compiled_says_so_in_the_kernel():
    @jit.helper
    def broken(x):
        return x.nothing

    @numba.njit
    def caller(x):
        return broken(x)

    with pytest.raises(numba.errors.TypingError, match="nothing"):
        caller(1.0)


def test_compiling_leaves_the_garbage_collector_as_it_was():
    @numba.njit
    def fails(x):
        return x.nothing

    before = gc.get_threshold()
    gc.set_threshold(701, 11, 12)
    try:
        assert _sum_of_squares(np.arange(3, dtype=np.float32)) == 5.0
        with pytest.raises(numba.errors.TypingError):
            fails(1.0)
        assert gc.get_threshold() == (701, 11, 12)
    finally:
        gc.set_threshold(*before)


@jit.helper
def _first_half(numbers):
    return numbers[: len(numbers) // 2]


@jit.kernel
def _halve(numbers, pair):
    made = np.arange(2 * len(numbers)) + pair[0][0]
    half = _first_half(made)
    rest = _first_half(np.ones(6))
    return half.sum() + rest.sum() + pair[1].sum(), half


@jit.kernel
def _same(numbers):
    return numbers


def test_arguments_are_borrowed_and_what_is_returned_is_owned():
    numbers = np.arange(1000)
    pair = (numbers, np.arange(3.0))
    before = sys.getrefcount(numbers)
    for _ in range(100):
        total, half = _halve(numbers, pair)
        assert total == 999 * 500 + 3 + 3.0 and half.base is not None and half.sum() == 999 * 500
        again = _same(numbers)
        assert again is numbers or again.base is not None  # not memory without an owner
    del again, half
    assert sys.getrefcount(numbers) == before
