"""The one decorator that compiles kernels, and where their compiled code is kept between processes.

`kernel` marks a function that Python calls: compiled at its first call, without the GIL held, and cached on disk.
`helper` marks a function that only kernels call: it is compiled into them. `inlined` is a helper that is never a call,
and `unaliased` one whose arrays do not overlap.

Numba's own disk cache looks at the file that holds a kernel and at nothing else: after an edit of a helper in another
file, the stale kernel goes on answering. So each module's kernels are kept in a folder named by a digest of that module
*and of every module of ours that it imports, directly or not*. An edit anywhere below a kernel gives a new folder; an
edit elsewhere compiles nothing again.

`fastmath` is never set: without it LLVM neither reorders sums nor fuses a multiply with an add, so the same input gives
the same bits on every x86-64 machine.
"""

import ast
import functools
import gc
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from pipeline.jit_lowering import OPTIONS, Helper, KernelCompiler, UnaliasedCompiler, make_helper

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("pipeline", "tiler")
KEEP_DAYS = 30


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """All statements of a body, those inside functions, classes and branches too; expressions are not looked into."""
    for node in body:
        yield node
        for block in (node, *getattr(node, "handlers", ()), *getattr(node, "cases", ())):
            for part in ("body", "orelse", "finalbody"):
                yield from _statements(getattr(block, part, []))


def _imports_of(source: bytes, package: str) -> frozenset[str]:
    """Names of the modules of ours that a source imports (a name imported from a package may be a module)."""
    found: set[str] = set()
    for node in _statements(ast.parse(source).body):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:  # a relative import: resolve it against the importing package
                parents = package.split(".")
                base = ".".join(parents[: len(parents) - node.level + 1] + ([base] if base else []))
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names)
    return frozenset(name for name in found if name.split(".")[0] in PACKAGES)


def _file_of(module: str, root: str) -> str | None:
    stem = os.path.join(root, *module.split("."))
    for path in (f"{stem}.py", os.path.join(stem, "__init__.py")):
        if os.path.isfile(path):
            return path
    return None


@functools.cache
def _read(file: str, root: str, version: tuple[int, int]) -> tuple[bytes, tuple[str, ...]]:
    """A module's source, and the files of the modules of ours that it imports. version : time and size, of this reading."""
    source, parent = Path(file).read_bytes(), Path(file).parent
    package = ".".join(parent.relative_to(root).parts) if parent.is_relative_to(root) else ""
    files = (_file_of(name, root) for name in _imports_of(source, package))
    return source, tuple(found for found in files if found is not None)


def source_digest(path: Path, root: Path = ROOT) -> str:
    """Digest of the file at `path`, of all modules of ours that it can reach by imports, and of the Numba version."""
    seen: dict[str, bytes] = {}
    todo = [str(path)]
    while todo:
        file = todo.pop()
        if file not in seen:
            now = os.stat(file)
            seen[file], imported = _read(file, str(root), (now.st_mtime_ns, now.st_size))
            todo.extend(imported)
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for file in sorted(seen):
        digest.update(os.path.basename(file).encode() + b"\0" + seen[file] + b"\0")
    return digest.hexdigest()[:16]


@functools.cache
def cache_root() -> Path:
    """Folder of all compiled kernels: TILER_CACHE_DIR, else the user's cache folder, else a temporary one."""
    chosen = os.environ.get("TILER_CACHE_DIR")
    base = Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "tiler"
    try:
        base.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=base).close()
    except (OSError, RuntimeError):
        base = Path(tempfile.mkdtemp(prefix="tiler-kernels-"))
    _prune(base)
    return base


def _prune(base: Path) -> None:
    """Forget the kernels of sources that nobody has used for KEEP_DAYS."""
    limit = time.time() - KEEP_DAYS * 86400
    for folder in base.iterdir():
        try:
            if folder.is_dir() and len(folder.name) == 16 and folder.stat().st_mtime < limit:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue


@functools.cache
def _folder_of(file: str) -> str:
    folder = cache_root() / source_digest(Path(file).resolve())
    folder.mkdir(exist_ok=True)
    os.utime(folder)  # used today: keeps it from being pruned
    return str(folder)


def _cached(function: Callable[..., Any], signatures: list[Any] | None = None) -> Callable[..., Any]:
    config: Any = numba.config  # Numba asks it for the folder once, when a function is declared
    before = config.CACHE_DIR
    config.CACHE_DIR = _folder_of(function.__code__.co_filename)
    try:
        return numba.njit(signatures, cache=True, pipeline_class=KernelCompiler, **OPTIONS)(function)
    finally:
        config.CACHE_DIR = before


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` at its first call: GIL released, division by zero as IEEE defines it, cached on disk."""
    return _cached(function)


def typed_kernel(signature: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """As `kernel`, for one signature that is compiled at once: only so is a function among the arguments cached on disk.

    For modules that are imported where they are needed. The function that is handed over is compiled by itself.
    """

    return lambda function: _cached(function, [signature])


def compile_for(function: Callable[..., Any], signature: Any) -> Callable[..., Any]:
    """`function`, plain or compiled already, compiled for the arguments of `signature`.

    Raises TypeError, in one line, if that cannot be, or if it returns another type than the signature says.
    """
    compiled: Any = function if hasattr(function, "py_func") else numba.njit(**OPTIONS)(function)
    if isinstance(compiled, Helper):
        compiled = compiled.whole
    if not hasattr(compiled, "py_func"):  # the compiler is switched off
        return compiled
    try:
        compiled.compile(signature.args)
    except (numba.core.errors.NumbaError, TypeError) as error:
        lines = [line for line in str(error).splitlines() if line and "nopython mode pipeline" not in line]
        raise TypeError(lines[0] if lines else str(error)) from None
    returned = compiled.overloads[signature.args].signature.return_type
    if returned != signature.return_type:
        raise TypeError(f"it returns {returned}; allowed: {signature.return_type}")
    return compiled


def helper(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` into the kernels that call it. Not cached by itself: that would gain nothing."""
    return make_helper(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `helper`, and never left as a call, however large: for the body of a loop, which does not vectorize around calls.

    Copied into each of its callers, so a loop over rows sees where these lie in memory.
    """
    return make_helper(function, forceinline=True)


def unaliased(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `helper`, for loops that read arrays at places known only when they run, and write others.

    Such a loop vectorizes only where no write can change what is read later. So the caller promises that no entry that is
    written through one array argument is read or written through another; they may be parts of one array.
    """
    return make_helper(function, UnaliasedCompiler)


class _Announcer(event.Listener):
    """Says, once a process and only when something really compiles, why the first run takes longer; and makes it shorter.

    Numba makes millions of objects and frees few while it compiles. An eighth of its time would go into Python's search for
    cycles among them, so that is done more rarely meanwhile. Numba's lock, which is held here, keeps `_depth` right.
    """

    RARELY = (20_000, 20, 20)  # of `gc.set_threshold`

    def __init__(self) -> None:
        self.compiled = 0
        self._depth = 0  # a helper is compiled within the kernel that calls it
        self._before: tuple[int, int, int] = gc.get_threshold()

    def on_start(self, event: Any) -> None:
        if self.compiled == 0 and not os.environ.get("TILER_QUIET"):
            print("compiling kernels, first run only ...", file=sys.stderr, flush=True)
        self.compiled += 1
        if self._depth == 0:
            self._before = gc.get_threshold()
            if 0 < self._before[0] < self.RARELY[0]:
                gc.set_threshold(*self.RARELY)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            gc.set_threshold(*self._before)


announcer = _Announcer()
event.register("numba:compile", announcer)
