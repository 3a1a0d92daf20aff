"""Memory for pictures, which comes back when nobody holds the picture any more.

A picture is megabytes. Fresh from the system they are handed over page by page and cleared, for every frame of a study again:
at 1920x1080 that took as long as drawing a hundred thousand small triangles. What comes back waits for the next picture of the
same size, up to MOST_BYTES.
"""

import math
from typing import Any

import numpy as np

MOST_BYTES = 1 << 28  # that are kept idle
ALIGNMENT = 64  # a line of the cache

# Pieces by their size. Single operations of dicts and lists are whole for any thread.
_idle: dict[int, list[bytearray]] = {}


class _Owner(np.ndarray):
    """What arrays in lent memory have as their base: it dies with the last of them."""

    def __del__(self) -> None:
        memory = self.base
        if not isinstance(memory, bytearray) or len(memory) > MOST_BYTES:
            return
        if sum(size * len(pieces) for size, pieces in list(_idle.items())) + len(memory) > MOST_BYTES:
            _idle.clear()  # of sizes that may not come again
        _idle.setdefault(len(memory), []).append(memory)


def _take(size: int) -> bytearray:
    """Idle memory of that size, or new."""
    try:
        return _idle[size].pop()
    except LookupError:
        return bytearray(size)


def lend(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An array whose contents are anything, like `numpy.empty`; a view of memory that others had before."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size == 0:
        return np.empty(shape, dtype)
    owner = _Owner((size + ALIGNMENT,), np.uint8, buffer=_take(size + ALIGNMENT))
    offset = -owner.__array_interface__["data"][0] % ALIGNMENT
    return np.ndarray(shape, dtype, buffer=owner, offset=offset)
