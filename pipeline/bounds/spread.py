"""Rows of a block, one lane a patch, to arrays that hold a few float64 a patch, and from them.

Four rows of four lanes are a 4 x 4 matrix, whose transpose is what four patches have in those four rows; a vector of eight
lanes holds two of them. Written as loads, shuffles and stores of vectors, which LLVM does not find by itself, and which whoever
reads the rows next as vectors need not wait for (`rows`).
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from pipeline.bounds.lanes import LANES
from pipeline.bounds.transpose import data_of, intrinsic
from pipeline.jit import helper, inlined
from pipeline.types import F64

_ONE, _FOUR, _EIGHT = ir.DoubleType(), ir.VectorType(ir.DoubleType(), 4), ir.VectorType(ir.DoubleType(), 8)


class _Places:
    """Where the numbers of a block begin: its row `row` in s, and its patch `first` in an array of `width` numbers a patch."""

    def __init__(self, context: Any, builder: Any, signature: Any, arguments: Any, width: int) -> None:
        self.builder = builder
        s, array = (data_of(context, builder, signature.args[k], arguments[k]) for k in (0, 3))
        self.rows = cgutils.gep(builder, s, builder.mul(arguments[1], arguments[1].type(LANES)))
        self.patches = cgutils.gep(builder, array, builder.mul(arguments[2], arguments[2].type(width)))

    def at(self, base: Any, number: int, kind: Any) -> Any:
        """Pointer to that number."""
        return self.builder.bitcast(cgutils.gep(self.builder, base, number), kind.as_pointer())


def _shuffle(builder: Any, a: Any, b: Any, numbers: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers))


def _transpose(builder: Any, a: Any, b: Any, c: Any, d: Any) -> list[Any]:
    """Both halves of four vectors of eight as 4 x 4 matrices, transposed."""

    def pick(a: Any, b: Any, picks: tuple[int, int, int, int]) -> Any:
        """In each half of the result numbers `picks` of the halves of a (0 .. 3) and b (4 .. 7)."""
        return _shuffle(builder, a, b, [4 * half + k + (4 if k > 3 else 0) for half in range(2) for k in picks])

    low, high = pick(a, b, (0, 4, 2, 6)), pick(a, b, (1, 5, 3, 7))
    low2, high2 = pick(c, d, (0, 4, 2, 6)), pick(c, d, (1, 5, 3, 7))
    return [
        pick(low, low2, (0, 1, 4, 5)), pick(high, high2, (0, 1, 4, 5)),
        pick(low, low2, (2, 3, 6, 7)), pick(high, high2, (2, 3, 6, 7)),
    ]  # fmt: skip


def _columns(builder: Any, vectors: list[Any]) -> list[Any]:
    """What each of eight lanes has in four or in eight vectors."""
    parts = [_transpose(builder, *vectors[k : k + 4]) for k in range(0, len(vectors), 4)]
    halves = [(part, list(range(begin, begin + 4))) for begin in (0, 4) for part in zip(*parts, strict=True)]
    return [
        _shuffle(builder, part[0], part[-1], half + [8 + k for k in half] * (len(part) - 1)) for part, half in halves
    ]


def _spreader(width: int, size: int) -> Any:
    """`spread` of `_storing`, for the compiler: eight lanes and `size` rows at a time, and a row that is left by itself."""

    @intrinsic
    def spread(typingctx, s, row, first, target):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            places = _Places(context, builder, signature, arguments, width)
            rows, out, at, kind = places.rows, places.patches, places.at, {4: _FOUR, 8: _EIGHT}[size]
            for lane in range(0, LANES, 8):
                for r in range(0, width - (width % size == 1), size):
                    m = min(size, width - r)
                    columns = _columns(
                        builder,
                        [
                            builder.load(at(rows, (r + min(k, m - 1)) * LANES + lane, _EIGHT), align=8)
                            for k in range(size)
                        ],
                    )
                    for k, column in enumerate(columns):
                        begin = (lane + k) * width + r
                        if begin + size <= LANES * width:  # what is too much the next lane overwrites
                            builder.store(column, at(out, begin, kind), align=8)
                        else:
                            for i in range(m):
                                value = builder.extract_element(column, ir.IntType(32)(i))
                                builder.store(value, at(out, begin + i, _ONE))
            if width % size == 1:
                for lane in range(LANES):
                    value = builder.load(at(rows, (width - 1) * LANES + lane, _ONE))
                    builder.store(value, at(out, (lane + 1) * width - 1, _ONE))
            return context.get_dummy_value()

        return types.void(s, types.intp, types.intp, target), generate

    return spread


def _gatherer(width: int) -> Any:
    """`gather` of `_loading`, for the compiler."""

    @intrinsic
    def gather(typingctx, s, row, first, source):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            places = _Places(context, builder, signature, arguments, width)
            rows, begin, at = places.rows, places.patches, places.at
            for lane in range(0, LANES, 8):
                for r in range(0, width, 4):
                    low, high = (
                        [builder.load(at(begin, (lane + half + k) * width + r, _FOUR), align=8) for k in range(4)]
                        for half in (0, 4)
                    )
                    both = (_shuffle(builder, a, b, list(range(8))) for a, b in zip(low, high, strict=True))
                    for k, numbers in enumerate(_transpose(builder, *both)[: width - r]):
                        builder.store(numbers, at(rows, (r + k) * LANES + lane, _EIGHT), align=8)
            return context.get_dummy_value()

        return types.void(s, types.intp, types.intp, source), generate

    return gather


def _storing(width: int, size: int = 4) -> Callable[[F64, int, int, F64], None]:
    """The helper that stores `width` rows, four or eight of them at a time."""
    compiled = _spreader(width, size)

    def spread(s: F64, row: int, first: int, target: F64) -> None:
        target.reshape(-1, width)[first : first + LANES] = (
            s[row * LANES : (row + width) * LANES].reshape(width, LANES).T
        )

    @extending.overload(spread)
    def spread_vectors(s, row, first, target):
        return lambda s, row, first, target: compiled(s, row, first, target)

    @helper
    def spread_tail(s, row, first, target):
        flat = target.reshape(-1)
        for lane in range(len(target) - first):
            for c in range(width):
                flat[(first + lane) * width + c] = s[(row + c) * LANES + lane]

    @inlined
    def store(s, row, first, target):
        """Rows `row` .. of s to patches first .. of target float64[n, ...], as many as there are."""
        if first + LANES <= len(target):
            spread(s, row, first, target)
        else:
            spread_tail(s, row, first, target)

    return store


def _loading(width: int) -> Callable[[F64, int, int, F64], None]:
    """The helper that loads `width` rows."""
    compiled = _gatherer(width)

    def gather(s: F64, row: int, first: int, source: F64) -> None:
        s[row * LANES : (row + width) * LANES].reshape(width, LANES)[:] = source.reshape(-1, width)[
            first : first + LANES
        ].T

    @extending.overload(gather)
    def gather_vectors(s, row, first, source):
        return lambda s, row, first, source: compiled(s, row, first, source)

    @helper
    def gather_tail(s, row, first, source):
        flat = source.reshape(-1)
        for lane in range(LANES):
            p = min(first + lane, len(source) - 1)
            for c in range(width):
                s[(row + c) * LANES + lane] = flat[p * width + c]

    @inlined
    def load(s, row, first, source):
        """Rows `row` .. of s from patches first .. of source float64[n, ...]; the last block is filled up with its last one."""
        if first + LANES < len(source):  # four numbers are loaded at a time, the last of them from the next patch
            gather(s, row, first, source)
        else:
            gather_tail(s, row, first, source)

    return load


load3, load9 = _loading(3), _loading(9)
store3, store4, store32 = _storing(3), _storing(4), _storing(32)
store9 = _storing(
    9, 8
)  # half as many stores; of 32 numbers a patch that takes longer, as vectors of eight lie across lines
