"""What Numba makes of kernels and helpers for us: functions that borrow their arguments, and helpers within kernels only.

Numba makes of every compiled function a whole of its own: wrappers for calls from Python and from C, each with code that takes
apart every tuple of arrays among the arguments, all of LLVM's passes, machine code. A helper needs nothing of that, being
linked into the kernels that call it and optimized there once more. It was half of what a first run waited for. So here a helper
ends as the module that its callers link, cleaned up function by function and no more. Where Python calls one all the same, as
tests do, Numba compiles it for that by itself (`whole`).
"""

import functools
from typing import Any

import numba
from numba.core import cgutils, compiler, lowering, typed_passes, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}  # of everything that is compiled


def _parts(kind: Any) -> list[Any]:
    """Types of what a tuple holds."""
    members: Any = kind if isinstance(kind, types.BaseTuple) else ()
    return list(members)


def _holds_arrays(kind: Any) -> bool:
    """Whether a value of this type is, or may hold, an array."""
    if isinstance(kind, types.BaseTuple):
        return any(map(_holds_arrays, _parts(kind)))
    return isinstance(kind, (types.Buffer, types.Optional, types.Container, types.ListType, types.DictType))


def _borrow(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The same value, with arrays that own nothing."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        return array._getvalue()
    for k, part in enumerate(_parts(kind)):
        if _holds_arrays(part):
            borrowed = _borrow(context, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, borrowed, k)
    return value


class _BorrowingLower(lowering.Lower):
    """Lowering of a function whose arguments stay alive while it runs, because its caller holds them.

    Numba counts references to every array of every tuple at each call: atomic operations, some hundreds for a patch, on
    counters that all threads share. An array that owns nothing needs none. A function that returns arrays may return one of its
    arguments, and counts.
    """

    def extract_function_arguments(self) -> Any:
        """The function's arguments, borrowed."""
        values = super().extract_function_arguments()
        if not _holds_arrays(self.fndesc.restype):
            self.fnargs = [
                _borrow(self.context, self.builder, *pair) for pair in zip(self.fndesc.argtypes, values, strict=True)
            ]
        return self.fnargs


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.NativeLowering):
    """Lowering that borrows arguments, without a wrapper for calls from C: nobody takes a kernel's address."""

    _name = "borrowing_lowering"

    @property
    def lowering_class(self) -> Any:
        """Ours."""
        return _BorrowingLower

    def run_pass(self, state: Any) -> bool:
        state.flags.no_cfunc_wrapper = True
        return super().run_pass(state)


class _Part(JITCodeLibrary):
    """A library that is only linked into others: they optimize it and make its machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class _Entry:
    """What Numba knows a compiled helper by: where others have a function that Python can call."""


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(_Lowering):
    """Lowering to a `_Part`, without wrappers."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        flags, context = state.flags, state.targetctx
        flags.no_compile = flags.no_cpython_wrapper = True
        state.library = _Part(context.codegen(), state.func_id.func_qualname)
        super().run_pass(state)
        entry = _Entry()
        context.insert_user_function(entry, state.cr.fndesc, [state.library])
        if hasattr(state.library, "_reload_init"):  # not in older Numba
            state.reload_init.extend(state.library._reload_init)
        state.cr = state.cr._replace(cfunc=entry)
        return True


class KernelCompiler(compiler.Compiler):
    """Numba's compiler, of functions that borrow their arguments."""

    lowering: Any = _Lowering

    def define_pipelines(self) -> Any:
        """Numba's steps, with our lowering."""
        (passes,) = super().define_pipelines()
        passes.passes = [
            (self.lowering if step is typed_passes.NativeLowering else step, why) for step, why in passes.passes
        ]
        passes.finalize()
        return [passes]


class PartCompiler(KernelCompiler):
    """The same up to what callers link."""

    lowering = _PartLowering


class UnaliasedCompiler(PartCompiler):
    """As `PartCompiler`, told that what one array argument points to is reached through no other."""

    def define_pipelines(self) -> Any:
        """The steps of `PartCompiler`, once that is promised."""
        self.state.flags.noalias = True
        return super().define_pipelines()


class Helper(CPUDispatcher):
    """A function that kernels call."""

    def __init__(
        self, py_func: Any, locals: Any = None, targetoptions: Any = None, pipeline_class: Any = PartCompiler
    ) -> None:
        super().__init__(py_func, locals or {}, targetoptions or {}, pipeline_class)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a call returns. Whole numbers count by type, not by value: else a helper would be compiled for each of them."""
        plain = tuple(types.unliteral(a) if isinstance(a, types.IntegerLiteral) else a for a in args)
        return super().get_call_template(plain, kws)

    def add_overload(self, cres: Any) -> None:
        """Keep what was compiled for kernels, and not where calls from Python look."""
        self.overloads[tuple(cres.signature.args)] = cres

    @functools.cached_property
    def whole(self) -> Any:
        """The same function compiled by itself, for Python to call."""
        return numba.njit(**{k: v for k, v in self.targetoptions.items() if k != "nopython"})(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        """Call the whole."""
        return self.whole(*arguments)


def make_helper(function: Any, pipeline: Any = PartCompiler, **options: Any) -> Any:
    """`function` as a helper; itself where the compiler is switched off."""
    config: Any = numba.config
    if config.DISABLE_JIT:
        return function
    targetoptions = {**OPTIONS, "nopython": True, "boundscheck": None, **options}
    return Helper(function, targetoptions=targetoptions, pipeline_class=pipeline)
