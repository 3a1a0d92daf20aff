"""Rows of a block from arrays and to them, as whole vectors.

Sixteen numbers are so few that LLVM takes the loop apart before it looks for vectors, and copies them one by one. What reads
the row next, as a vector, then waits until the last of these stores has left the processor: 2 ns a patch.
"""

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from pipeline.bounds.lanes import LANES
from pipeline.bounds.transpose import data_of, intrinsic
from pipeline.jit import inlined
from pipeline.types import F32, F64

_ROW, _NARROW_ROW = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(ir.FloatType(), LANES)


def _copier(narrow: bool) -> Any:
    """`copy_lanes`, or `narrow_lanes`, for the compiler."""

    @intrinsic
    def copy(typingctx, source, i, target, j):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            def at(array: int, row: Any) -> Any:
                data = data_of(context, builder, signature.args[array], arguments[array])
                return builder.bitcast(cgutils.gep(builder, data, arguments[array + 1]), row.as_pointer())

            numbers = builder.load(at(0, _ROW), align=8)
            if narrow:
                builder.store(builder.fptrunc(numbers, _NARROW_ROW), at(2, _NARROW_ROW), align=4)
            else:
                builder.store(numbers, at(2, _ROW), align=8)
            return context.get_dummy_value()

        return types.void(source, types.intp, target, types.intp), generate

    return copy


_copy_lanes, _narrow_lanes = _copier(False), _copier(True)


def copy_lanes(source: F64, i: int, target: F64, j: int) -> None:
    """LANES numbers of source float64[...], from number i on, to target float64[...] from number j on."""
    target.reshape(-1)[j : j + LANES] = source.reshape(-1)[i : i + LANES]


@extending.overload(copy_lanes)
def _copy_lanes_of_vectors(source, i, target, j):
    return lambda source, i, target, j: _copy_lanes(source, i, target, j)


def narrow_lanes(source: F64, i: int, target: F32, j: int) -> None:
    """The same to target float32[...], rounded.

    A loop would do it in halves, as it takes no more lanes at a time than it has float64 in a vector; and to read as a whole
    what was written in halves takes as long as to read what was written one by one.
    """
    target.reshape(-1)[j : j + LANES] = source.reshape(-1)[i : i + LANES]


@extending.overload(narrow_lanes)
def _narrow_lanes_of_vectors(source, i, target, j):
    return lambda source, i, target, j: _narrow_lanes(source, i, target, j)


@inlined
def load_rows(s, k, rows, source, first):
    """Rows k .. from a block of source float64[rows, columns]."""
    for i in range(rows):
        copy_lanes(source, i * source.shape[1] + first, s, (k + i) * LANES)


@inlined
def store_rows(s, k, rows, target, first):
    """Rows k .. to a block of target float64[rows, columns]."""
    for i in range(rows):
        copy_lanes(s, (k + i) * LANES, target, i * target.shape[1] + first)
