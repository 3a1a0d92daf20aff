"""Float operations counted in the compiled code: how often each basic block runs, times what stands in it.

A kernel is compiled once more, for the arguments that it is called with. When LLVM has optimized it (inlined, vectorized,
unrolled, shared and moved out of loops what it could), and before machine code is made of it, a counter is put into every
basic block of the optimized IR: a load, an add and a store of an int64 of its own, nothing of which LLVM optimizes any more.
The kernel is run, and what was counted is

    sum over blocks of (times it ran) * (float operations in it),

exactly, with these operations: fadd, fsub, fmul, fdiv, frem, square roots, roundings to whole numbers (floor, ceil, ...),
comparisons (fcmp; min and max as LLVM's own instructions), a fused multiply-add as two. One of N lanes counts N: all lanes
count, also those that a mask leaves out or that only fill a vector up. A reduction of N lanes is N - 1. Signs (negation,
magnitude), conversions, selections, shuffles, memory and integers are not counted. Of single and double precision alike, as
in `costs`.

Of a bound the parts are told apart by the kernel that does them: the lookup's own counts the texture rectangle too, which
the count of the sources has as part of the box.

So the count is of this machine's vectors and this version of the compiler; the count of the sources (`tiler.costs`) is of none.
Kernels are told from the NumPy around them by being compiled; NumPy's few operations a batch are left out.
"""

import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import count
from types import FunctionType
from typing import Any, NamedTuple
from unittest.mock import patch

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core.codegen import CPUCodeLibrary
from numba.core.registry import CPUDispatcher

from pipeline import domain
from pipeline.bounds import BOUNDS
from pipeline.types import I64
from tiler.costs import BOXES, GRID, Operations, sample_patches, shader_call, split_operations

KINDS = {
    "fadd": ("add", 1), "fsub": ("sub", 1), "fmul": ("mul", 1), "fdiv": ("div", 1), "frem": ("div", 1), "fcmp": ("compare", 1),
}  # fmt: skip
INTRINSICS = {
    "sqrt": ("sqrt", 1), "floor": ("round", 1), "ceil": ("round", 1), "trunc": ("round", 1), "rint": ("round", 1),
    "nearbyint": ("round", 1), "round": ("round", 1), "roundeven": ("round", 1), "minnum": ("compare", 1),
    "maxnum": ("compare", 1), "minimum": ("compare", 1), "maximum": ("compare", 1), "fma": ("mul", 2), "fmuladd": ("mul", 2),
}  # fmt: skip
REDUCTIONS = {
    "fadd": "add",
    "fmul": "mul",
    "fmin": "compare",
    "fmax": "compare",
    "fminimum": "compare",
    "fmaximum": "compare",
}

_RESULT = r"^\s+(?:%\S+ = )?"
_FLAGS = r"(?:nnan |ninf |nsz |arcp |contract |afn |reassoc |fast )*"
_OPCODE = re.compile(
    _RESULT + rf"({'|'.join(KINDS)}) {_FLAGS}(?:\w+ )?(?:<(\d+) x (?:float|double)>|(?:float|double)) "
)
_CALL = re.compile(
    _RESULT + r"(?:(?:tail|musttail|notail) )?call .*@llvm\.(vector\.reduce\.)?(\w+)(?:\.v(\d+))?(?:\.?f\d+)?\("
)
_LIBRARY = re.compile(_RESULT + rf"(?:(?:tail|musttail|notail) )?call .*(?:float|double) @({'|'.join(INTRINSICS)})f?\(")
_SHARED = re.compile(r"^define (?:linkonce|linkonce_odr|weak|weak_odr) (?:hidden )?(.*?@)([\w.$]+)\(", re.MULTILINE)
_LABEL = re.compile(r'^(?:[\w.$-]+|"[^"]+"):')

Tally = Counter[str]  # kind of operation, as in `costs` -> how many


def operations_of(line: str) -> tuple[str, int]:
    """Kind and number of the float operations of a line of LLVM IR; ("", 0) for none."""
    if found := _OPCODE.match(line):
        kind, amount = KINDS[found[1]]
        return kind, amount * int(found[2] or 1)
    if "@llvm." in line and (found := _CALL.match(line)):
        reduction, name, lanes = found[1], found[2], int(found[3] or 1)
        if reduction and name in REDUCTIONS:
            return REDUCTIONS[name], lanes - (0 if name in ("fadd", "fmul") else 1)
        if not reduction and name in INTRINSICS:
            kind, amount = INTRINSICS[name]
            return kind, amount * lanes
    if found := _LIBRARY.match(line):  # a scalar root is a call of the C library until it becomes an instruction
        return INTRINSICS[found[1]]
    return "", 0


def _is_phi(line: str) -> bool:
    return " = phi " in line


class Blocks(NamedTuple):
    """A module of LLVM IR, cut where counters go."""

    pieces: list[str]  # text between the counters, one more than there are blocks
    operations: list[Tally]  # of each basic block


def cut_blocks(ir: str) -> Blocks:
    """The basic blocks of all functions of a module. A counter goes behind the phis of its block."""
    pieces: list[list[str]] = [[]]
    operations: list[Tally] = []
    inside, begins = False, False  # a function; a block, whose phis may still come
    for line in ir.splitlines():
        if line.startswith("define "):
            inside, begins = True, True
            pieces[-1].append(line)
            continue
        if inside and line.startswith("}"):
            inside = False
        elif inside and _LABEL.match(line):
            begins = True
            pieces[-1].append(line)
            continue
        elif inside and begins and line.strip() and not _is_phi(line):
            begins = False
            operations.append(Counter())
            pieces.append([])
        pieces[-1].append(line)
        if inside and operations and not begins:
            kind, amount = operations_of(line)
            if amount:
                operations[-1][kind] += amount
    return Blocks(["\n".join(piece) for piece in pieces], operations)


def own_functions(ir: str, suffix: str) -> str:
    """The module with functions that it may share with others (helpers) made its own, under names of its own.

    Else the linker would take those that it has, without counters, or give these to others, which have no business there.
    """
    shared = {found[2] for found in _SHARED.finditer(ir)}
    ir = _SHARED.sub(r"define internal \1\2(", ir)
    return re.sub(r"@([\w.$]+)", lambda found: f"@{found[1]}{suffix if found[1] in shared else ''}", ir)


def instrument(blocks: Blocks, address: int) -> str:
    """The module with a counter in every block: int64 number k from `address` on counts block k."""
    text = [blocks.pieces[0]]
    for k, piece in enumerate(blocks.pieces[1:]):
        place = f"ptr inttoptr (i64 {address + 8 * k} to ptr)"
        text += [
            f"  %counter.{k}.before = load i64, {place}, align 8",
            f"  %counter.{k}.after = add i64 %counter.{k}.before, 1",
            f"  store i64 %counter.{k}.after, {place}, align 8",
            piece,
        ]
    return "\n".join(text) + "\n"


_numbers = count()


class Counted(NamedTuple):
    """A kernel compiled with counters."""

    run: Callable[..., Any]
    counts: I64  # (blocks,) how often each ran
    operations: list[Tally]  # of each block

    def take(self) -> Tally:
        """What was counted since the last time."""
        total: Tally = Counter()
        for ran, block in zip(self.counts.tolist(), self.operations, strict=True):
            for kind, amount in block.items() if ran else ():
                total[kind] += ran * amount
        self.counts[:] = 0
        return total


def compile_counted(function: FunctionType, arguments: tuple[Any, ...]) -> Counted:
    """`function`, plain Python as a kernel is written, compiled for these arguments with counters in it."""
    # By a name of its own: the linker would give its code to who asks for the plain kernel, read from the cache.
    twin = FunctionType(function.__code__, function.__globals__, function.__name__, function.__defaults__)
    twin.__module__, twin.__qualname__ = function.__module__, f"{function.__qualname__}_counted"
    names = [*twin.__module__.split("."), *twin.__qualname__.split(".")]
    own = "".join(f"{len(name)}{name}" for name in names if name.isidentifier())  # as symbols have it
    found: list[tuple[I64, list[Tally]]] = []
    optimize = CPUCodeLibrary._optimize_final_module

    def optimize_and_count(library: Any) -> None:
        optimize(library)
        ir = str(library._final_module)
        if re.search(rf"^define .*@_ZN7cpython{re.escape(own)}", ir, re.MULTILINE) is None:
            return  # of a helper, which the kernel has inside already
        blocks = cut_blocks(own_functions(ir, f".counted{next(_numbers)}"))
        counts = np.zeros(len(blocks.operations), np.int64)
        found.append((counts, blocks.operations))
        library._final_module = llvm.parse_assembly(instrument(blocks, counts.ctypes.data))

    compiled: Any = numba.njit(nogil=True, error_model="numpy")(twin)
    with patch.object(CPUCodeLibrary, "_optimize_final_module", optimize_and_count):
        compiled.compile(tuple(map(numba.typeof, arguments)))
    (only,) = found
    return Counted(compiled, *only)


class Recorder:
    """Runs compiled kernels with counters, and adds up what they did, by module."""

    def __init__(self) -> None:
        self.tally: Counter[tuple[str, str]] = Counter()  # (module, kind) -> how many
        self.kernels: dict[Any, Counted] = {}  # by dispatcher and types of arguments

    def _call(self, kernel: Any, arguments: tuple[Any, ...], restore: ExitStack) -> Any:
        key = (kernel, *map(numba.typeof, arguments))
        if key not in self.kernels:
            restore.close()  # Numba looks names up while it compiles
            self.kernels[key] = compile_counted(kernel.py_func, arguments)
            self._put_on(restore)
        counted = self.kernels[key]
        result = counted.run(*arguments)
        for kind, amount in counted.take().items():
            self.tally[kernel.py_func.__module__, kind] += amount
        return result

    def _put_on(self, stack: ExitStack) -> None:
        for name, module in list(sys.modules.items()):
            if name.split(".")[0] == "pipeline":
                for key, value in list(vars(module).items()):
                    if isinstance(value, CPUDispatcher):
                        stack.enter_context(patch.object(module, key, self._wrapped(value, stack)))

    def _wrapped(self, kernel: Any, stack: ExitStack) -> Callable[..., Any]:
        return lambda *arguments: self._call(kernel, arguments, stack)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """While it lasts, calls of kernels of `pipeline` from Python are counted."""
        with ExitStack() as stack:
            self._put_on(stack)
            yield


SAMPLE = 64  # patches: whole blocks of lanes, so that few operations are for lanes that are only filled up


def count_compiled(names: Sequence[str] = tuple(BOXES), num_patches: int = SAMPLE) -> dict[str, Operations]:
    """As `costs.count_operations`, of the compiled code, for some of `BOUNDS`. Takes about a minute, to compile."""
    recorder, counts = Recorder(), {}
    for name, displaced in (("domain shader", False), ("domain shader, map", True)):
        call = shader_call(sample_patches(num_patches, displaced))
        recorder.tally.clear()
        with recorder.recording():
            domain.shade_patches(*call)
        counts[name] = split_operations(recorder.tally, num_patches * (GRID + 1) ** 2)
    stage = sample_patches(num_patches, True)
    for name in names:
        recorder.tally.clear()
        with recorder.recording():
            BOUNDS[name](stage)
        counts[name] = split_operations(recorder.tally, num_patches)
    return counts


def available() -> bool:
    """Whether anything is compiled: NUMBA_DISABLE_JIT is not set."""
    config: Any = numba.config
    return not config.DISABLE_JIT
