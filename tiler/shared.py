"""What machines that draw the same frame have in common: results of stages, kept from one machine to the next.

A stage is a function of its arguments, so its result is remembered by the function and these: arrays and scenes by identity,
all else by value. What a stage is given is all that it may depend on; so nothing that matters can be missing in the key, and
a machine that differs where a stage does not look gets what the machine before it got. Results are never written to.

Small arrays that several machines come to on ways of their own (which patches live) are made one by `same`.

Memory is bounded: of all arrays held, arguments and results, each counts once, and so do the objects about them. What finds
no room is not kept, and neither is what follows from it; what neither this machine nor the one before it asked for makes room
first. So a frame that is larger than the bound still shares its first stages, and a study that goes on to other machines
forgets the first.
"""

from collections.abc import Callable, Iterator
from typing import Any, Protocol, TypeVar

import numpy as np

from tiler.config import Machine
from tiler.host import Host
from tiler.memory import available_bytes

Result = TypeVar("Result")

MOST_BYTES = 512 << 20
LEFT = 0.75  # of the bound, after making room: so that it is not done for each result
POINT_BYTES = 112  # of a frame's points, window and triangles, for each domain point
ARRAY_BYTES, RESULT_BYTES = 128, 2048  # of Python's own objects, for each array and each result
PLAIN = frozenset((str, int, float, bool, type(None), Machine))


class Stages(Protocol):
    """How a frame runs its stages."""

    most_bytes: int  # that are kept
    most_points: int  # domain points that are worth keeping for all machines at a time; 0: nothing is kept

    def run(self, stage: Callable[..., Result], *arguments: Any) -> Result:
        """stage(*arguments), or the result that is kept of it."""

    def same(self, array: np.ndarray) -> np.ndarray:
        """`array`, or the first one that was equal to it."""

    def own(self, array: np.ndarray) -> np.ndarray:
        """`array` for a user, who may write to it."""


class Alone:
    """Stages of a frame that has nothing in common with another: they run."""

    most_bytes = most_points = 0

    def run(self, stage: Callable[..., Result], *arguments: Any) -> Result:
        """stage(*arguments)."""
        return stage(*arguments)

    def same(self, array: np.ndarray) -> np.ndarray:
        """`array`."""
        return array

    def own(self, array: np.ndarray) -> np.ndarray:
        """`array`."""
        return array


ALONE = Alone()


class _Kept:
    """A result, with the arguments whose identities stand in its key; `turn`: of the last machine that asked for it."""

    __slots__ = ("arguments", "result", "turn")

    def __init__(self, arguments: tuple[Any, ...], result: Any, turn: int) -> None:
        self.arguments, self.result, self.turn = arguments, result, turn


class Shared:
    """Stages of frames of one scene, drawn one after the other on different machines. Not for several threads at a time.

    most_bytes : of what is kept; by default 512 MiB, or a quarter of the memory available where that is less.
    """

    def __init__(self, most_bytes: int | None = None) -> None:
        self.most_bytes = min(MOST_BYTES, available_bytes() // 4) if most_bytes is None else most_bytes
        self.most_points = self.most_bytes // (2 * POINT_BYTES)
        self.hits = 0
        self.held_bytes = 0
        self._kept: dict[Any, _Kept] = {}
        self._held: dict[int, list[int]] = {}  # of an array's memory, by id: bytes, and how many hold it
        self._results: set[int] = set()  # ids of results that are kept
        self._lost: set[int] = set()  # ids of arrays of this turn's results that found no room
        self._turn = 0

    def begin(self) -> None:
        """A machine's frame begins."""
        self._turn += 1
        self._lost.clear()

    def run(self, stage: Callable[..., Result], *arguments: Any) -> Result:
        """stage(*arguments), or the result that is kept of it."""
        key = (stage, *map(self._name, arguments))
        kept = self._kept.get(key)
        if kept is None:
            result = stage(*arguments)
            self._keep(key, arguments, result)
            return result
        self.hits += 1
        kept.turn = self._turn
        found: Result = kept.result
        return found

    def same(self, array: np.ndarray) -> np.ndarray:
        """`array`, or the first one that was equal to it."""
        key = (array.dtype.str, array.shape, array.tobytes())
        kept = self._kept.get(key)
        if kept is None:
            self._keep(key, (), array)
            return array
        kept.turn = self._turn
        found: np.ndarray = kept.result
        return found

    def own(self, array: np.ndarray) -> np.ndarray:
        """A copy of `array` if it is kept, else the array."""
        return array.copy() if any(id(a) in self._held for a in _arrays(array)) else array

    def _name(self, value: Any) -> Any:
        """What stands for an argument: its value where that is plain, else its identity; of tuples those of their parts."""
        kind = type(value)
        if kind is np.ndarray or id(value) in self._results:
            return id(value)
        if kind in PLAIN:
            return value
        if isinstance(value, tuple):
            return tuple(map(self._name, value))
        if kind is Host or value is self:
            return None  # how a stage runs changes no result
        return id(value)

    def _keep(self, key: Any, arguments: tuple[Any, ...], result: Any) -> None:
        memory = {id(a): a.nbytes + ARRAY_BYTES for a in _arrays((arguments, result))}
        if self._lost.isdisjoint(memory) and self._make_room(memory):
            others = tuple(a for a in arguments if a is not self)  # a cycle would keep all memory until it is found
            self._kept[key] = _Kept(others, result, self._turn)
            self.held_bytes += RESULT_BYTES
            if isinstance(result, tuple) and result:
                self._results.add(id(result))
            for number, size in memory.items():
                held = self._held.setdefault(number, [size, 0])
                held[1] += 1
                self.held_bytes += size if held[1] == 1 else 0
        else:
            self._lost.update(id(a) for a in _arrays(result) if id(a) not in self._held)

    def _make_room(self, memory: dict[int, int]) -> bool:
        """Whether these arrays fit, after forgetting as many of the oldest results as that takes."""
        new = self._size_of(memory)
        if self.held_bytes + new <= self.most_bytes:
            return True
        if new > self.most_bytes:
            return False
        old = [(kept.turn, place, key) for place, (key, kept) in enumerate(self._kept.items())]
        for turn, _, key in sorted(old, key=lambda each: each[:2]):
            if turn >= self._turn - 1 or self.held_bytes + new <= self.most_bytes * LEFT:
                break
            self._forget(key)
            new = self._size_of(memory)
        return self.held_bytes + new <= self.most_bytes

    def _size_of(self, memory: dict[int, int]) -> int:
        """Bytes that one more result takes, with these arrays."""
        return RESULT_BYTES + sum(size for number, size in memory.items() if number not in self._held)

    def _forget(self, key: Any) -> None:
        kept = self._kept.pop(key)
        self.held_bytes -= RESULT_BYTES
        self._results.discard(id(kept.result))
        for number in {id(a) for a in _arrays((kept.arguments, kept.result))}:
            held = self._held[number]
            held[1] -= 1
            if held[1] == 0:
                self.held_bytes -= held[0]
                del self._held[number]


def _arrays(value: Any) -> Iterator[np.ndarray]:
    """The arrays that own the memory of all arrays in nested tuples."""
    if isinstance(value, np.ndarray):
        yield value if value.base is None or not isinstance(value.base, np.ndarray) else value.base
    elif isinstance(value, tuple):
        for part in value:
            yield from _arrays(part)
