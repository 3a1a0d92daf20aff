"""Keeping some entries of rows, side by side: what goes on, of what has been decided in vectors.

Which ones go on is decided by chance, so a branch for each is missed again and again, and moving them one by one takes longer
than the decision. A processor with AVX-512 packs a vector by a mask in one instruction; LLVM does not find that by itself.
Elsewhere the numbers of those that are kept are listed first, without a branch, and then each row is gathered.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.registry import cpu_target

from pipeline.types import I32, I64

intrinsic: Any = extending.intrinsic

BITS = 512  # of a vector

_BOOL, _WORD, _LONG = ir.IntType(1), ir.IntType(32), ir.IntType(64)


def lanes_of(bits: int) -> int:
    """Entries of a vector, each of so many bits."""
    return BITS // bits


def packs_vectors() -> bool:
    """Whether what is compiled may use AVX-512: the features that Numba compiles for, and keys its cache by."""
    features: str = cpu_target.target_context.codegen().magic_tuple()[2]
    return "+avx512f" in features.split(",")


@intrinsic
def _keep(typingctx, values, alive, first, count, to, rows):
    """Pack one vector of each row, from entry `first` to entry `to`: of its first `count` lanes, those alive; how many."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, alive_, first_, count_, to_, rows_ = arguments
        entry = context.get_value_type(signature.args[0].dtype)
        lanes = lanes_of(entry.width)
        vector, mask_type = ir.VectorType(entry, lanes), ir.VectorType(_BOOL, lanes)
        data = context.make_array(signature.args[0])(context, builder, array).data
        zeros = ir.Constant(vector, [0] * lanes)

        def at(row: Any, k: Any) -> Any:
            return builder.bitcast(cgutils.gep(builder, data, builder.add(row, k)), vector.as_pointer())

        def load(row: Any) -> Any:
            found = builder.load(at(row, first_))
            found.align = entry.width // 8
            return found

        counts = ir.VectorType(_LONG, lanes)
        empty = ir.Constant(counts, ir.Undefined)
        spread = builder.shuffle_vector(
            builder.insert_element(empty, count_, _WORD(0)),
            empty,
            ir.Constant(ir.VectorType(_WORD, lanes), [0] * lanes),
        )
        there = builder.icmp_signed("<", ir.Constant(counts, list(range(lanes))), spread)
        mask = builder.and_(builder.icmp_signed("!=", load(alive_), zeros), there)
        kind = ir.FunctionType(vector, [vector, vector, mask_type])
        name = f"llvm.x86.avx512.mask.compress.v{lanes}i{entry.width}"
        pack = cgutils.get_or_insert_function(builder.module, kind, name)
        for k in range(signature.args[5].count):
            row = builder.extract_value(rows_, k)
            builder.store(builder.call(pack, [load(row), zeros, mask]), at(row, to_), align=entry.width // 8)
        return builder.ctpop(builder.zext(builder.bitcast(mask, ir.IntType(lanes)), _LONG))

    return types.int64(values, types.int64, types.int64, types.int64, types.int64, rows), generate


def _compact_packed(values, alive, first, last, to, rows):
    """`compact` by packing vectors."""
    end = np.int64(to)
    for k in range(first, last, BITS // (8 * values.itemsize)):
        end += _keep(values, np.int64(alive), np.int64(k), np.int64(last - k), end, rows)
    return end - to


def _compact_listed(values, alive, first, last, to, rows):
    """`compact` by a list of what is kept. It takes the place of `alive`, which is read before it is overwritten."""
    end = alive + first
    for k in range(first, last):
        goes_on = values[np.uint64(alive + k)] != 0
        values[np.uint64(end)] = k
        end += goes_on
    found = end - (alive + first)
    for row in rows:
        for k in range(found):
            values[np.uint64(row + to + k)] = values[np.uint64(row + values[np.uint64(alive + first + k)])]
    return found


def compact(values: I32 | I64, alive: int, first: int, last: int, to: int, rows: tuple[int, ...]) -> int:
    """In a kernel: keep entries first .. last-1 of each row where `alive` is not 0, in their order; how many.

    values : flat; row r begins at place rows[r], and `alive` is the place of another row. What is kept goes to entries `to`,
    at most `first`, and following ones. Entries up to a vector (BITS) behind `last` must be there; what stands from the
    last kept one on, and in the row `alive`, is anything afterwards.
    """
    return int(_compact_listed(values, alive, first, last, to, rows))


@extending.overload(compact)
def _compact(values, alive, first, last, to, rows):
    return _compact_packed if packs_vectors() else _compact_listed
