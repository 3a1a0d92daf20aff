"""Memory for pictures and for a batch's points and triangles, which comes back when nobody holds them any more.

They are megabytes. Fresh from the system they are handed over page by page and cleared, for every frame of a study again:
at 1920x1080 that took as long as drawing a hundred thousand small triangles. What comes back waits for the next that needs as
much, up to MOST_BYTES.
"""

import math
from typing import Any

import numpy as np

MOST_BYTES = 1 << 28  # that are kept idle
LEAST_BYTES = 1 << 16  # less is the memory allocator's own business
ALIGNMENT = 64  # a line of the cache


class _Memory(np.ndarray):
    """Bytes of NumPy's, which asks for huge pages where there are megabytes.

    A type of its own, and `_Owner` another: an array made in another's memory has as its base not that one but the last in a
    row of one type.
    """


# Pieces by their size. Single operations of dicts and lists are whole for any thread.
_idle: dict[int, list[_Memory]] = {}


class _Owner(np.ndarray):
    """What arrays in lent memory have as their base: it dies with the last of them."""

    def __del__(self) -> None:
        memory = self.base
        if not isinstance(memory, _Memory) or len(memory) > MOST_BYTES:
            return
        if sum(size * len(pieces) for size, pieces in list(_idle.items())) + len(memory) > MOST_BYTES:
            _idle.clear()  # of sizes that may not come again
        _idle.setdefault(len(memory), []).append(memory)


def _take(size: int) -> _Memory:
    """Idle memory of that size, or new."""
    try:
        return _idle[size].pop()
    except LookupError:
        return np.empty(size, np.uint8).view(_Memory)


def _rounded(size: int) -> int:
    """At least `size`, by at most an eighth: so that batches of nearly the same size use the same memory."""
    step = 1 << max(size.bit_length() - 4, 0)
    return -(-size // step) * step


def lend(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An array whose contents are anything, like `numpy.empty`; a view of memory that others had before, if it is large."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < LEAST_BYTES:
        return np.empty(shape, dtype)
    room = _rounded(size + ALIGNMENT)
    owner = _Owner((room,), np.uint8, buffer=_take(room))
    offset = -owner.__array_interface__["data"][0] % ALIGNMENT
    return np.ndarray(shape, dtype, buffer=owner, offset=offset)
