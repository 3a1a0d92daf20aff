"""Numbers of LANES patches side by side: a kernel is written as for one patch, and each operation does all lanes.

A loop over lanes vectorizes only where LLVM proves that no store meets a later load; a chain of interval arithmetic, whose
values are tuples and which loops over control vectors, it leaves as it is. Here the vector is a type of its own: `Wide` is
LANES float64, `Mask` LANES truth values, and +, -, *, /, comparisons, abs and the functions below are one instruction each
(two or four on machines with narrower vectors), whatever stands around them. Plain numbers count as the same in all lanes.
No operation rounds otherwise than its scalar twin, so a lane's bits do not depend on its neighbours.

Rows live in scratch float64[rows, LANES]: `load` and `store`. Uncompiled, a Wide is an array float64[LANES], a Mask one of
bool, and the functions below are as they stand. `lesser`, `greater`, `choose` and `root` take plain numbers too.

Beside `min` and `max`: `lesser(a, b)` is b only where b < a, so a NaN in `a` stays and one in `b` goes, as Numba has it.
"""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

LANES = 8


# As Python


def load(s: Any, row: Any) -> Any:
    """Row `row` of s float64[rows, LANES]."""
    return s[row].copy()


def store(s: Any, row: Any, value: Any) -> None:
    """A Wide into row `row` of s float64[rows, LANES]."""
    s[row] = value


def spread(value: Any) -> Any:
    """The same number in all lanes."""
    return np.full(LANES, value, np.float64)


def lesser(a: Any, b: Any) -> Any:
    """The lesser of two, lane by lane."""
    return np.where(b < a, b, a)


def greater(a: Any, b: Any) -> Any:
    """The greater of two, lane by lane."""
    return np.where(b > a, b, a)


def choose(mask: Any, a: Any, b: Any) -> Any:
    """a where the mask is set, b elsewhere."""
    return np.where(mask, a, b)


def root(a: Any) -> Any:
    """Square root; NaN of what is below zero."""
    with np.errstate(invalid="ignore"):
        return np.sqrt(a)


def floor(a: Any) -> Any:
    """The greatest whole number that is not above."""
    return np.floor(a)


# The types


class WideType(types.Type):
    """LANES float64."""

    def __init__(self) -> None:
        super().__init__(name="Wide")


class MaskType(types.Type):
    """LANES truth values."""

    def __init__(self) -> None:
        super().__init__(name="Mask")


WIDE, MASK = WideType(), MaskType()
_WIDE, _MASK = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(ir.IntType(1), LANES)
_LLVM = {WideType: _WIDE, MaskType: _MASK}


class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _LLVM[type(kind)])


for _kind in (WideType, MaskType):
    register_model(_kind)(_Model)


# Their operations: which types go in and come out, and what is generated

PLAIN = (types.Float, types.Integer)


def _splat(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """`value` of type `kind`, a Wide or a plain number, as a vector."""
    if isinstance(kind, WideType):
        return value
    number = context.cast(builder, value, kind, types.float64)
    first = builder.insert_element(ir.Constant(_WIDE, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def _is_number(kind: Any) -> bool:
    return isinstance(kind, (WideType, *PLAIN))


def _is_plain(kind: Any) -> bool:
    return isinstance(kind, PLAIN)


def _typed(function: Any, check: Callable[[tuple[Any, ...]], Any]) -> None:
    """Tell the compiler what `function` returns: check(types of the arguments), None where it is none of ours."""

    class Template(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: Any) -> Any:
            result = None if kws else check(args)
            return None if result is None else signature(result, *(types.unliteral(a) for a in args))

    infer_global(function)(Template)


def _two_numbers(result: Any) -> Callable[[tuple[Any, ...]], Any]:
    def check(args: tuple[Any, ...]) -> Any:
        fits = len(args) == 2 and all(map(_is_number, args)) and any(isinstance(a, WideType) for a in args)
        return result if fits else None

    return check


def _lower_two(function: Any, generate: Callable[[Any, Any, Any], Any]) -> None:
    """Code of a function of two Wides, or of one and a plain number."""

    def lower(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        a, b = (_splat(context, builder, kind, value) for kind, value in zip(sig.args, arguments, strict=True))
        return generate(builder, a, b)

    for kinds in ((WideType, WideType), *((WideType, k) for k in PLAIN), *((k, WideType) for k in PLAIN)):
        lower_builtin(function, *kinds)(lower)


def _arithmetic(name: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: getattr(builder, name)(a, b)


def _comparison(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


for _operator, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _typed(_operator, _two_numbers(WIDE))
    _lower_two(_operator, _arithmetic(_name))

for _operator, _name in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _typed(_operator, _two_numbers(MASK))
    _lower_two(_operator, _comparison(_name))


def _extreme(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(sign, b, a), b, a)


def _plain_extreme(sign: str) -> Callable[..., Any]:
    def lower(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        a, b = (context.cast(builder, v, k, types.float64) for k, v in zip(sig.args, arguments, strict=True))
        return _extreme(sign)(builder, a, b)

    return lower


for _function, _sign in ((lesser, "<"), (greater, ">")):
    _typed(_function, _two_numbers(WIDE))
    _typed(_function, lambda args: types.float64 if len(args) == 2 and all(map(_is_plain, args)) else None)
    _lower_two(_function, _extreme(_sign))
    for _a in PLAIN:
        for _b in PLAIN:
            lower_builtin(_function, _a, _b)(_plain_extreme(_sign))


def _lower_masks(function: Any, name: str) -> None:
    @lower_builtin(function, MaskType, MaskType)
    def lower(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        return getattr(builder, name)(*arguments)

    _typed(function, lambda args: MASK if len(args) == 2 and all(isinstance(a, MaskType) for a in args) else None)


_lower_masks(operator.and_, "and_")
_lower_masks(operator.or_, "or_")


def _one_wide(args: tuple[Any, ...]) -> Any:
    return WIDE if len(args) == 1 and isinstance(args[0], WideType) else None


def _lower_one(function: Any, intrinsic: str) -> None:
    @lower_builtin(function, WideType)
    def lower(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(_WIDE, [_WIDE])
        called = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{intrinsic}.v{LANES}f64")
        return builder.call(called, arguments)

    _typed(function, _one_wide)


_lower_one(abs, "fabs")
_lower_one(root, "sqrt")
_lower_one(floor, "floor")


@lower_builtin(operator.neg, WideType)
def _negate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    return builder.fneg(arguments[0])


_typed(operator.neg, _one_wide)


@lower_builtin(operator.invert, MaskType)
def _invert(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    return builder.not_(arguments[0])


_typed(operator.invert, lambda args: MASK if len(args) == 1 and isinstance(args[0], MaskType) else None)


@lower_builtin(choose, MaskType, types.Any, types.Any)
def _choose(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    a, b = (_splat(context, builder, kind, value) for kind, value in zip(sig.args[1:], arguments[1:], strict=True))
    return builder.select(arguments[0], a, b)


@lower_builtin(choose, types.Boolean, types.Any, types.Any)
def _choose_plain(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    a, b = (context.cast(builder, v, k, types.float64) for k, v in zip(sig.args[1:], arguments[1:], strict=True))
    return builder.select(arguments[0], a, b)


_typed(
    choose,
    lambda args: types.float64 if isinstance(args[0], types.Boolean) and all(map(_is_plain, args[1:])) else None,
)
_typed(choose, lambda args: WIDE if isinstance(args[0], MaskType) and all(map(_is_number, args[1:])) else None)


@lower_builtin(spread, types.Any)
def _spread(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    return _splat(context, builder, sig.args[0], arguments[0])


_typed(spread, lambda args: WIDE if len(args) == 1 and _is_number(args[0]) else None)


def _is_scratch(kind: Any) -> bool:
    return isinstance(kind, types.Array) and kind.ndim == 2 and kind.dtype == types.float64 and kind.layout == "C"


def _row_pointer(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    """Pointer to the vector that begins row arguments[1] of the scratch arguments[0]."""
    data = context.make_array(sig.args[0])(context, builder, arguments[0]).data
    row = context.cast(builder, arguments[1], sig.args[1], types.intp)
    first = cgutils.gep(builder, data, builder.mul(row, row.type(LANES)))
    return builder.bitcast(first, _WIDE.as_pointer())


@lower_builtin(load, types.Array, types.Integer)
def _load(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    return builder.load(_row_pointer(context, builder, sig, arguments), align=8)


@lower_builtin(store, types.Array, types.Integer, types.Any)
def _store(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
    value = _splat(context, builder, sig.args[2], arguments[2])
    builder.store(value, _row_pointer(context, builder, sig, arguments), align=8)
    return context.get_dummy_value()


def _row_of(args: tuple[Any, ...]) -> bool:
    return _is_scratch(args[0]) and isinstance(args[1], types.Integer)


_typed(load, lambda args: WIDE if len(args) == 2 and _row_of(args) else None)
_typed(store, lambda args: types.none if len(args) == 3 and _row_of(args) and _is_number(args[2]) else None)
