"""A stopwatch around the stages of a frame, put on from outside: while it is off, the machine runs as if it did not exist.

What is timed is not listed anywhere: it is every function that `render_frame` can call by a global name, of its own
module or of a module of ours that it names, and every entry of a table of functions. So a new stage is timed as soon as
the machine calls it. A function that a timed one calls is part of that one. Compiled kernels are timed beside the stages,
by themselves, on whatever thread they run; what is left of a stage is Python and NumPy.

Kernels must have been compiled for the arguments that are coming (draw the same frame once before): Numba resolves names
when it compiles, and would meet the stopwatch there.
"""

import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FunctionType, ModuleType
from typing import Any
from unittest.mock import patch

from numba.core.registry import CPUDispatcher

from tiler import machine

OURS = ("pipeline", "tiler")
FRAMES = (machine.render_frame, machine.last_frame, machine.draw_frame)  # the stages stand in these


class Stopwatch:
    """Seconds by function, `module.function` or `TABLE[entry]`, summed over calls and, for kernels, over threads."""

    def __init__(self) -> None:
        self.stages: defaultdict[str, float] = defaultdict(float)
        self.kernels: defaultdict[str, float] = defaultdict(float)
        self._lock = threading.Lock()
        self._inside = False

    def stage(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function`, timed, unless another stage calls it. Stages run on the thread of `render_frame` alone."""

        def timed(*arguments: Any, **named: Any) -> Any:
            if self._inside:
                return function(*arguments, **named)
            self._inside = True
            start = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                self.stages[name] += time.perf_counter() - start
                self._inside = False

        return timed

    def kernel(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function`, a compiled kernel, timed on any thread."""

        def timed(*arguments: Any) -> Any:
            start = time.perf_counter()
            try:
                return function(*arguments)
            finally:
                seconds = time.perf_counter() - start
                with self._lock:
                    self.kernels[name] += seconds

        return timed


@contextmanager
def timing() -> Iterator[Stopwatch]:
    """While it lasts, frames are timed; for one frame at a time."""
    watch = Stopwatch()
    with ExitStack() as stack:
        for owner, name, value in _compiled():
            stack.enter_context(patch.object(owner, name, watch.kernel(_short(value.py_func), value)))
        for owner, name, label in _stages():
            if isinstance(owner, dict):
                stack.enter_context(patch.dict(owner, {name: watch.stage(label, owner[name])}))
            else:
                stack.enter_context(patch.object(owner, name, watch.stage(label, getattr(owner, name))))
        yield watch


def _stages() -> list[tuple[Any, str, str]]:
    """Owner, name in it, label: the functions that `render_frame` can call by its global names."""
    found: list[tuple[Any, str, str]] = []
    for name, value in list(vars(machine).items()):
        if _is_ours(value) and isinstance(value, ModuleType):
            functions = [
                (n, f) for n, f in vars(value).items() if isinstance(f, FunctionType) and f.__module__ == value.__name__
            ]
            found += [(value, n, _short(f)) for n, f in functions]
        elif isinstance(value, FunctionType) and _is_ours(value) and value not in FRAMES:
            found.append((machine, name, _short(value)))
        elif isinstance(value, dict) and name.isupper():
            found += [(value, key, f"{name}[{key}]") for key, f in value.items() if callable(f)]
    return found


def _compiled() -> list[tuple[ModuleType, str, Any]]:
    """Owner, name, dispatcher: every compiled function of our loaded modules, wherever a module has it by name."""
    modules = [module for name, module in list(sys.modules.items()) if name.split(".")[0] in OURS]
    return [
        (module, name, value)
        for module in modules
        for name, value in list(vars(module).items())
        if isinstance(value, CPUDispatcher)
    ]


def _is_ours(value: Any) -> bool:
    name = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", "")
    return isinstance(name, str) and name.split(".")[0] in OURS


def _short(function: Callable[..., Any]) -> str:
    return f"{function.__module__.split('.')[-1]}.{function.__name__}"
