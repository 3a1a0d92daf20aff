"""The host's threads: runs the chunks of a stage, on one thread or several, and lets the user interrupt between them.

Kernels release the GIL, so plain Python threads run them side by side. Numba's own parallel loops are not used: each
costs seconds of compiling (docs/decisions/host-threads.md has the measurement), one of them aborts the process when two
Python threads enter it, and a chunk is a good place to stop for Ctrl-C or to report progress. Which thread runs a chunk
changes no result: each chunk writes to places of its own.
"""

import os
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from itertools import count
from typing import Any, Self

CHUNKS_PER_THREAD = 8  # small enough to even out unequal chunks, large enough that a call's overhead does not count


def available_threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


# Threads that no host has, by their number: to start and end them for every frame would take a millisecond of each. Single
# operations of a dict are whole for any thread.
_idle: dict[int, ThreadPoolExecutor] = {}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # a child has none of them


class Host:
    """A fixed number of threads for one simulation; a context manager.

    Threads wait for the next host with as many, unless something went wrong: then they end with this one.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._failed = False
        self._pool = None
        if threads > 1:
            self._pool = _idle.pop(threads, None) or ThreadPoolExecutor(threads)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: Any, *_: Any) -> None:
        if self._pool is None:
            return
        if self._failed or kind is not None or _idle.setdefault(self.threads, self._pool) is not self._pool:
            self._pool.shutdown(cancel_futures=True)

    def chunks(self, items: int, least: int = 1) -> list[tuple[int, int]]:
        """Cut 0 .. items into even ranges (begin, end), of `least` items or more where there are so many."""
        n = min(-(-items // least), self.threads * CHUNKS_PER_THREAD)
        return [(items * c // n, items * (c + 1) // n) for c in range(n)]

    def run(self, work: Callable[[int], Any], n: int) -> None:
        """Call work(0) .. work(n-1), each once, in any order; an exception in one of them stops the rest."""
        if self._pool is None or n < 2:
            for c in range(n):
                work(c)
            return
        numbers = count()

        def worker() -> None:
            while (c := next(numbers)) < n:  # next() on a C iterator is atomic
                work(c)

        futures = []
        failed_before, self._failed = self._failed, True  # until all is done
        try:
            for _ in range(min(self.threads, n)):
                futures.append(self._pool.submit(worker))
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            for _ in range(n):
                next(numbers)  # after an interrupt the workers find nothing left to do
        for future in futures:
            future.result()
        self._failed = failed_before
