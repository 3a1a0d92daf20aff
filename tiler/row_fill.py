"""Depth test of a few pixels in a row at once, of small triangles and of blocks of large ones: a vector of LANES pixels.

Pixel by pixel, what a triangle covers is decided by branches that no processor foresees: at both ends of each row, and
at the end of the rows. Here a row is one vector, and what it does not cover is masked out of loads and stores. Written as
operations on vectors, as LLVM makes no masked stores of a loop whose length is not known.

Edge values are float64: below 2^53, as all are, their sums are exact, and so the same as those of whole numbers.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from pipeline.types import F32, I32

LANES = 8

intrinsic: Any = extending.intrinsic

_BOOL, _WORD, _LONG = ir.IntType(1), ir.IntType(32), ir.IntType(64)
_SINGLE, _DOUBLE = ir.FloatType(), ir.DoubleType()
_MASK = ir.VectorType(_BOOL, LANES)


def _vector(kind: Any) -> Any:
    return ir.VectorType(kind, LANES)


def _spread(builder: Any, value: Any) -> Any:
    """A vector of one value."""
    empty = ir.Constant(_vector(value.type), ir.Undefined)
    first = builder.insert_element(empty, value, _WORD(0))
    return builder.shuffle_vector(first, empty, ir.Constant(_vector(_WORD), [0] * LANES))


def _number_of(builder: Any, mask: Any) -> Any:
    return builder.zext(builder.bitcast(mask, ir.IntType(LANES)), _LONG)


def _pick(builder: Any, sign: str, a: Any, b: Any) -> Any:
    """a where it compares so with b, else b."""
    return builder.select(builder.fcmp_ordered(sign, a, b), a, b)


@intrinsic
def _test_row(typingctx, depth, visible, place, count, values, steps, biases, plane, t, looks_first):
    """The same as `test_row`, for the compiler."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        depth_, visible_, place_, count_, values_, steps_, biases_, plane_, t_, looks_first_ = arguments
        numbers = ir.Constant(_vector(_DOUBLE), [float(k) for k in range(LANES)])
        counts = ir.Constant(_vector(_LONG), list(range(LANES)))

        def at(kind: Any, array: Any, element: Any) -> Any:
            data = context.make_array(kind)(context, builder, array).data
            return builder.bitcast(cgutils.gep(builder, data, place_), _vector(element).as_pointer())

        def part(of: Any, k: int) -> Any:
            return _spread(builder, builder.extract_value(of, k))

        def masked(name: str, result: Any, *parameters: Any) -> Any:
            """LLVM's masked operation of that name."""
            kind = ir.FunctionType(result, list(parameters))
            return cgutils.get_or_insert_function(builder.module, kind, f"llvm.masked.{name}.p0")

        inside = builder.icmp_signed("<", counts, _spread(builder, count_))
        edges = []
        for k in range(3):
            value = builder.fsub(part(values_, k), builder.fmul(numbers, part(steps_, k)))
            edges.append(value)
            inside = builder.and_(inside, builder.fcmp_ordered(">=", value, part(biases_, k)))
        base, along_1, along_2, low, high = (part(plane_, k) for k in range(5))
        depths, ids = at(signature.args[0], depth_, _SINGLE), at(signature.args[1], visible_, _WORD)
        load = masked(f"load.v{LANES}f32", _vector(_SINGLE), depths.type, _WORD, _MASK, _vector(_SINGLE))
        before = builder.call(load, [depths, _WORD(4), inside, ir.Constant(_vector(_SINGLE), [0.0] * LANES)])
        # No depth of the triangle is nearer than `low`. Where nobody looks first, this is a constant, and no branch is left.
        may_pass = _number_of(builder, builder.and_(inside, builder.fcmp_ordered("<", low, before)))
        goes_on = builder.or_(builder.not_(looks_first_), builder.icmp_unsigned("!=", may_pass, _LONG(0)))
        outside = builder.block
        with builder.if_then(goes_on):
            z = builder.fadd(base, builder.fadd(builder.fmul(edges[1], along_1), builder.fmul(edges[2], along_2)))
            z = builder.fptrunc(z, _vector(_SINGLE))
            z = _pick(builder, "<", high, _pick(builder, ">", low, z))  # as Numba has them: of equal ones the first
            won = builder.and_(inside, builder.fcmp_ordered("<", z, before))
            for name, values, target in (("f32", z, depths), ("i32", _spread(builder, t_), ids)):
                store = masked(f"store.v{LANES}{name}", ir.VoidType(), values.type, target.type, _WORD, _MASK)
                builder.call(store, [values, target, _WORD(4), won])
            bits, tested = _number_of(builder, won), builder.block
        passed = builder.phi(_LONG)
        passed.add_incoming(_LONG(0), outside)
        passed.add_incoming(bits, tested)
        return builder.or_(_number_of(builder, inside), builder.shl(passed, _LONG(LANES)))

    triple = types.UniTuple(types.float64, 3)
    singles = types.Tuple([types.float64] * 3 + [types.float32] * 2)
    signature = types.int64(
        depth, visible, types.int64, types.int64, triple, triple, triple, singles, types.int32, types.boolean
    )
    return signature, generate


def test_row(
    depth: F32, visible: I32, place: int, count: int, values: tuple[float, float, float],
    steps: tuple[float, float, float], biases: tuple[float, float, float],
    plane: tuple[float, float, float, Any, Any], t: int, looks_first: bool,
) -> int:  # fmt: skip
    """Test triangle t at the first LANES of `count` pixels in a row, and write its depth and number where it is nearer.

    depth, visible : flat; the pixels' entries begin at `place`. values : of the three edge functions at the first pixel,
    without bias; steps : what they lose from one pixel to the next; biases : least values that are inside. plane : as in
    `rasterizer._depth`. looks_first : whether it is asked first if a pixel may pass at all; the answer does not depend on it.
    Returns which pixels are covered, bit by bit, plus which passed, times 2^LANES.
    """
    covered, passed = 0, 0
    base, along_1, along_2, low, high = plane
    for k in range(min(count, LANES)):
        e0, e1, e2 = (value - k * step for value, step in zip(values, steps, strict=True))
        if e0 >= biases[0] and e1 >= biases[1] and e2 >= biases[2]:
            covered |= 1 << k
            z = min(max(np.float32(base + (e1 * along_1 + e2 * along_2)), low), high)
            if z < depth[place + k]:
                passed |= 1 << k
                depth[place + k], visible[place + k] = z, t
    return covered | passed << LANES


@extending.overload(test_row)
def _test_row_at_once(depth, visible, place, count, values, steps, biases, plane, t, looks_first):
    def test(depth, visible, place, count, values, steps, biases, plane, t, looks_first):
        return _test_row(depth, visible, place, count, values, steps, biases, plane, np.int32(t), looks_first)

    return test


@intrinsic
def _count_bits(typingctx, bits):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.int64(types.int64), generate


def count_bits(bits: int) -> int:
    """How many bits are set, of an integer that is not negative."""
    return int(bits).bit_count()


@extending.overload(count_bits)
def _count_bits_at_once(bits):
    return lambda bits: _count_bits(np.int64(bits))
