"""Control points of a block of patches into rows, one lane a patch, without going through memory one number at a time.

A patch is 64 float32 in a row: x, y, z, w of each of 16 points. Of four patches, one point's four quadruples are a 4 x 4
matrix whose transpose is four lanes of x, of y, of z and of w; sixteen patches are four of those side by side in a vector.
Written as loads and shuffles of vectors, which LLVM does not find by itself: 4 ns a patch, where loads and stores of single
numbers take 17. The w are left out.
"""

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from pipeline.bounds.lanes import LANES
from pipeline.jit import inlined
from pipeline.types import F32

intrinsic: Any = extending.intrinsic


_QUADS = 4  # vectors of four lanes in a block's row


def _join(builder: Any, parts: list[Any]) -> Any:
    """Vectors of the same length, one after the other."""
    while len(parts) > 1:
        size = parts[0].type.count
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 2 * size), list(range(2 * size)))
        parts = [builder.shuffle_vector(a, b, mask) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def _in_quads(builder: Any, a: Any, b: Any, picks: tuple[int, int, int, int]) -> Any:
    """In each quad of the result numbers `picks` of the quads of a (0 .. 3) and b (4 .. 7)."""
    numbers = [4 * q + k if k < 4 else 4 * (_QUADS + q) + k - 4 for q in range(_QUADS) for k in picks]
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), 4 * _QUADS), numbers))


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Pointer to the first number of an array."""
    return context.make_array(kind)(context, builder, array).data


def block_of(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Pointer to the points of a block, given control points, number of the first patch, and tail, as `transpose_points`."""
    points = context.make_array(signature.args[0])(context, builder, arguments[0])
    first, number = arguments[1], arguments[1].type
    tail = data_of(context, builder, signature.args[2], arguments[2])
    inside = cgutils.gep(builder, points.data, builder.mul(first, number(64)))
    n = builder.extract_value(points.shape, 0)
    return builder.select(builder.icmp_signed("<=", builder.add(first, number(LANES)), n), inside, tail)


@intrinsic
def _transpose(typingctx, source, first, tail, s):
    """The same as `transpose_points`, for the compiler."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        quad, row = ir.VectorType(ir.FloatType(), 4), ir.VectorType(ir.FloatType(), 4 * _QUADS)
        begin = block_of(context, builder, signature, arguments)
        out = data_of(context, builder, signature.args[3], arguments[3])

        def at(base: Any, number: int, kind: Any) -> Any:
            return builder.bitcast(cgutils.gep(builder, base, number), kind.as_pointer())

        for k in range(16):
            a, b, c, d = (
                _join(
                    builder, [builder.load(at(begin, (4 * q + r) * 64 + 4 * k, quad), align=4) for q in range(_QUADS)]
                )
                for r in range(4)
            )
            ab, cd = _in_quads(builder, a, b, (0, 4, 1, 5)), _in_quads(builder, c, d, (0, 4, 1, 5))
            rows = [_in_quads(builder, ab, cd, (0, 1, 4, 5)), _in_quads(builder, ab, cd, (2, 3, 6, 7))]
            ab, cd = _in_quads(builder, a, b, (2, 6, 3, 7)), _in_quads(builder, c, d, (2, 6, 3, 7))
            rows.append(_in_quads(builder, ab, cd, (0, 1, 4, 5)))
            for c in range(3):
                builder.store(rows[c], at(out, (16 * c + k) * LANES, row), align=4)
        return context.get_dummy_value()

    return types.void(source, types.intp, tail, s), generate


def transpose_points(source: F32, first: int, tail: F32, s: F32) -> None:
    """x, y, z of rows first .. of source float32[n, 64] to rows 0, 16 and 32 .. of s float32, one row a control point 4 i + j.

    Of a block that source has not whole, those of tail float32[LANES, 64] (`fill_tail`).
    """
    block = source[first : first + LANES] if first + LANES <= len(source) else tail
    for lane in range(LANES):
        for k in range(16):
            for c in range(3):
                s[(16 * c + k) * LANES + lane] = block[lane, 4 * k + c]


@extending.overload(transpose_points)
def _transpose_points(source, first, tail, s):
    return lambda source, first, tail, s: _transpose(source, first, tail, s)


@inlined
def fill_tail(control_points, first, tail):
    """Where the block from row `first` of float32[n, 64] on is the last and not whole: to tail, filled up with its last row.

    No array is cut out, here and below: that would count references to it, with locks, for every block.
    """
    n = len(control_points)
    if first + LANES > n:
        for lane in range(LANES):
            p = min(first + lane, n - 1)
            for k in range(64):
                tail[lane, k] = control_points[p, k]


@inlined
def load_block(control_points, first, tail, s):
    """Points of a block of float32[n, 64] as `transpose_points`; tail float32[LANES, 64] is for the last one."""
    fill_tail(control_points, first, tail)
    transpose_points(control_points, first, tail, s)
