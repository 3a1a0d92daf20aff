"""Where the host's threads run: not on the processor of the thread that waits for them.

A processor that has slept for some milliseconds is not always thought idle, on virtual machines above all. A thread that is
woken then may be put beside the one that wakes it, which goes on working; it waits there for 4 ms and more, until the system
evens out. Where the system lets a program choose, that place is therefore left out.
"""

import ctypes
import os
from collections.abc import Callable, Iterable


def _find_here() -> Callable[[], int] | None:
    """A function that tells the processor of the thread that calls, where there is one."""
    if not hasattr(os, "sched_setaffinity"):
        return None
    try:
        return ctypes.CDLL(None).sched_getcpu
    except (AttributeError, OSError, TypeError):
        return None


_here = _find_here()


def here() -> int:
    """The number of the processor that the calling thread is on; -1 where nobody tells."""
    return _here() if _here else -1


def keep_off(cpu: int, threads: Iterable[int]) -> None:
    """Let threads, by their numbers in the system, run where the calling one may, but for processor `cpu`. Best effort."""
    if not hasattr(os, "sched_setaffinity") or cpu < 0:
        return
    others = os.sched_getaffinity(0) - {cpu}
    if not others:
        return
    for thread in threads:
        try:
            os.sched_setaffinity(thread, others)
        except OSError:  # it has ended, or a sandbox forbids it
            return
