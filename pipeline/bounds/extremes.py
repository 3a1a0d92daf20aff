"""Least and greatest coordinates of a block of patches, straight from their control points; and boxes to where they belong.

A patch is 64 float32 in a row: x, y, z, w of each of 16 points, so four vectors of 16 numbers, and the least of those four is
x, y, z, w of four points still. Of four patches such vectors are halved and joined twice, which leaves x, y, z, w of each.
So nothing is transposed (`transpose`), at the cost of reducing w as well, which then is dropped: x, y, z lie patch after
patch, as in an array [n, 3]. Written as loads and shuffles of vectors, which LLVM does not find by itself.
"""

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from pipeline.bounds.lanes import LANES
from pipeline.bounds.transpose import block_of, data_of, intrinsic
from pipeline.types import F32, F64

LOW, HIGH = 0, 3 * LANES  # where x, y, z of the first patch begin: numbers of float32

_VECTOR = ir.VectorType(ir.FloatType(), 16)
_EIGHT = ir.VectorType(ir.DoubleType(), 8)


def _select(builder: Any, sign: str, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(sign, a, b), a, b)


def _fold(builder: Any, sign: str, a: Any, b: Any, halves: tuple[list[int], list[int]]) -> Any:
    """Quads `halves[0]` of a and b (0 .. 3, 4 .. 7) with quads `halves[1]`, the lesser or the greater of each two numbers."""

    def pick(quads: list[int]) -> Any:
        numbers = [4 * quad + k for quad in quads for k in range(4)]
        return builder.shuffle_vector(a, b, _mask(numbers))

    return _select(builder, sign, pick(halves[0]), pick(halves[1]))


def _reduce4(builder: Any, sign: str, patches: list[list[Any]]) -> Any:
    """x, y, z, w of each of four patches, given as four vectors each."""
    a, b, c, d = (
        _select(builder, sign, _select(builder, sign, p[0], p[1]), _select(builder, sign, p[2], p[3])) for p in patches
    )
    ab, cd = (_fold(builder, sign, *two, ([0, 1, 4, 5], [2, 3, 6, 7])) for two in ((a, b), (c, d)))
    return _fold(builder, sign, ab, cd, ([0, 2, 4, 6], [1, 3, 5, 7]))


def _mask(numbers: list[int]) -> Any:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)


def _drop_w(builder: Any, quads: list[Any]) -> list[Any]:
    """x, y, z of sixteen patches in three vectors, of x, y, z, w of them in four: each takes from two of those."""
    rows = []
    for row in range(3):
        numbers = [4 * (k // 3) + k % 3 - 16 * row for k in range(16 * row, 16 * row + 16)]
        rows.append(builder.shuffle_vector(quads[row], quads[row + 1], _mask(numbers)))
    return rows


@intrinsic
def _find_extremes(typingctx, source, first, tail, s):
    """The same as `find_extremes`, for the compiler. Infinities are told by what they leave in the least or the greatest."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        begin = block_of(context, builder, signature, arguments)
        out = data_of(context, builder, signature.args[3], arguments[3])

        def at(base: Any, number: int) -> Any:
            return builder.bitcast(cgutils.gep(builder, base, number), _VECTOR.as_pointer())

        broken = ir.Constant(ir.VectorType(ir.IntType(1), 16), [0] * 16)
        lows, highs = [], []
        for lane in range(0, LANES, 4):
            patches = [[builder.load(at(begin, 64 * (lane + p) + 16 * k), align=4) for k in range(4)] for p in range(4)]
            low, high = _reduce4(builder, "<", patches), _reduce4(builder, ">", patches)
            lows.append(low)
            highs.append(high)
            for p in patches:
                for a, b in (p[:2], p[2:]):
                    broken = builder.or_(broken, builder.fcmp_unordered("uno", a, b))
            infinite = builder.fcmp_unordered("uno", builder.fsub(low, low), builder.fsub(high, high))
            broken = builder.or_(broken, infinite)
        for begin_of, quads in ((LOW, lows), (HIGH, highs)):
            for k, row in enumerate(_drop_w(builder, quads)):
                builder.store(row, at(out, begin_of + 16 * k), align=4)
        bits = builder.bitcast(broken, ir.IntType(16))
        return builder.icmp_unsigned("==", bits, ir.IntType(16)(0))

    return types.boolean(source, types.intp, tail, s), generate


def find_extremes(source: F32, first: int, tail: F32, s: F32) -> bool:
    """Least and greatest x, y, z of the patches of a block, to s float32; whether all numbers are finite.

    source, first and tail are those of `transpose.transpose_points`. Of lane k they lie at LOW + 3 k and HIGH + 3 k. A number
    that is not finite may be found in w too; if there is one, the least and the greatest mean nothing.
    """
    fine = True
    block = source[first : first + LANES] if first + LANES <= len(source) else tail
    for lane in range(LANES):
        for c in range(3):
            low = high = block[lane, c]
            for k in range(16):
                number = block[lane, 4 * k + c]
                low, high = min(low, number), max(high, number)
                fine &= number == number
            fine &= (low - low == 0.0) & (high - high == 0.0)
            s[LOW + 3 * lane + c], s[HIGH + 3 * lane + c] = low, high
    return fine


@extending.overload(find_extremes)
def _find_extremes_of_vectors(source, first, tail, s):
    return lambda source, first, tail, s: _find_extremes(source, first, tail, s)


@intrinsic
def _put_diagonals(typingctx, numbers, axes, begin):
    """The same as `put_diagonals`, for the compiler: eight numbers of axes at a time."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source = data_of(context, builder, signature.args[0], arguments[0])
        out = cgutils.gep(builder, data_of(context, builder, signature.args[1], arguments[1]), arguments[2])

        def at(base: Any, number: int) -> Any:
            return builder.bitcast(cgutils.gep(builder, base, number), _EIGHT.as_pointer())

        zeros = ir.Constant(_EIGHT, [0.0] * 8)
        for row in range(0, 9 * LANES, 8):
            # Of each patch's nine numbers 0, 4 and 8 are the diagonal: none but every fourth of the row. So at most three.
            places = {k: 3 * (n // 9) + n % 9 // 4 for k in range(8) if (n := row + k) % 9 % 4 == 0}
            base = min(max(min(places.values()), 0), 3 * LANES - 8)
            some = builder.load(at(source, base), align=8)
            picks = [places[k] - base if k in places else 8 for k in range(8)]  # 8: a zero
            builder.store(builder.shuffle_vector(some, zeros, _mask(picks)), at(out, row), align=8)
        return context.get_dummy_value()

    return types.void(numbers, axes, begin), generate


def put_diagonals(numbers: F64, axes: F64, begin: int) -> None:
    """LANES diagonal matrices: three of numbers float64[3 LANES] each, row by row to axes float64[...] from `begin` on."""
    for lane in range(LANES):
        for r in range(3):
            for c in range(3):
                axes[begin + 9 * lane + 3 * r + c] = numbers[3 * lane + r] if r == c else 0.0


@extending.overload(put_diagonals)
def _put_diagonals_of_vectors(numbers, axes, begin):
    return lambda numbers, axes, begin: _put_diagonals(numbers, axes, begin)
