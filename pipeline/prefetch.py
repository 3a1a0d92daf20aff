"""Asking for memory before it is needed."""

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

intrinsic: Any = extending.intrinsic

_TO_WRITE, _KEEP, _DATA = 1, 3, 1  # of LLVM's prefetch: what for, how long it is wanted, which cache


@intrinsic
def _prefetch(typingctx, array, k):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.bitcast(cgutils.gep(builder, data, arguments[1]), cgutils.voidptr_t)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [place, number(_TO_WRITE), number(_KEEP), number(_DATA)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


def prefetch(array: Any, k: int) -> None:
    """In a kernel: entry k of a flat array will soon be read and written. Changes nothing; k may lie anywhere."""


@extending.overload(prefetch)
def _prefetch_entry(array, k):
    return lambda array, k: _prefetch(array, k)
