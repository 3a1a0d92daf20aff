"""How wide the vectors are that the compiler makes of loops."""

from typing import Any

from numba import extending, types

intrinsic: Any = extending.intrinsic


@intrinsic
def _prefer_wide(typingctx):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # llvmlite lists no attributes with values
        return context.get_dummy_value()

    return types.void(), generate


def prefer_wide() -> None:
    """In a kernel: loops use vectors of 512 bits where the machine has them, which LLVM by itself does on few.

    The same bits come out. A fifth of the time of the bounds' kernels, whose blocks are 16 lanes whatever the width; nothing of
    the domain shader's, whose loops wait for other things.
    """


@extending.overload(prefer_wide, inline="always")
def _prefer_wide_vectors():
    return lambda: _prefer_wide()
