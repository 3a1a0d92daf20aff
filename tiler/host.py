"""The host's threads: runs the chunks of a stage, on one thread or several, and lets the user interrupt between them.

Kernels release the GIL, so plain Python threads run them side by side. Numba's own parallel loops are not used: each
costs seconds of compiling (docs/decisions/host-threads.md has the measurement), one of them aborts the process when two
Python threads enter it, and a chunk is a good place to stop for Ctrl-C or to report progress. Which thread runs a chunk
changes no result: each chunk writes to places of its own.

The thread that calls is one of them, and looks again and again for a while before it sleeps until the others are done: to wake
a processor takes up to half a millisecond, of frames that take ten.
"""

import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import count
from threading import get_native_id
from typing import Any, NamedTuple, Self

from tiler.placement import here, keep_off

CHUNKS_PER_THREAD = 8  # small enough to even out unequal chunks, large enough that a call's overhead does not count
AWAKE = 1e-3  # seconds that a thread looks for the end of what it waits for, before it sleeps


def available_threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


class _Pool(NamedTuple):
    """Threads beside the one that calls."""

    executor: ThreadPoolExecutor
    numbers: list[int]  # that the system gives them, of those that have begun


def _make_pool(threads: int) -> _Pool:
    numbers: list[int] = []
    return _Pool(ThreadPoolExecutor(threads, initializer=lambda: numbers.append(get_native_id())), numbers)


# Pools that no host has, by the number of its threads: to start and end them for every frame would take a millisecond of each.
# Single operations of a dict are whole for any thread.
_idle: dict[int, _Pool] = {}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # a child has none of them


class Host:
    """A fixed number of threads for one simulation; a context manager.

    Threads wait for the next host with as many, unless something went wrong: then they end with this one.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._failed = False
        self._kept_off = (-1, 0)  # a processor, and how many threads may not run there
        self._pool = None
        if threads > 1:
            self._pool = _idle.pop(threads, None) or _make_pool(threads - 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: Any, *_: Any) -> None:
        if self._pool is None:
            return
        if self._failed or kind is not None or _idle.setdefault(self.threads, self._pool) is not self._pool:
            self._pool.executor.shutdown(cancel_futures=True)

    def chunks(self, items: int, least: int = 1) -> list[tuple[int, int]]:
        """Cut 0 .. items into even ranges (begin, end), of `least` items or more where there are so many."""
        n = min(-(-items // least), self.threads * CHUNKS_PER_THREAD)
        return [(items * c // n, items * (c + 1) // n) for c in range(n)]

    def beside(self, work: Callable[[], Any]) -> Callable[[], Any]:
        """Begin work() on another thread, if there is one, else do it now. Call what is returned to wait for the result."""
        if self._pool is None:
            done = work()
            return lambda: done
        future = self._submit(self._pool, work)

        def result() -> Any:
            _await([future])
            return future.result()

        return result

    def _submit(self, pool: _Pool, work: Callable[[], Any]) -> "Future[Any]":
        kept_off = here(), len(pool.numbers)
        if kept_off != self._kept_off:
            self._kept_off = kept_off
            keep_off(kept_off[0], pool.numbers)
        return pool.executor.submit(work)

    def run(self, work: Callable[[int], Any], n: int) -> None:
        """Call work(0) .. work(n-1), each once, in any order; an exception in one of them stops the rest."""
        if self._pool is None or n < 2:
            for c in range(n):
                work(c)
            return
        numbers = count()

        def stop() -> None:
            for _ in range(n):
                next(numbers)  # others find nothing left to do

        def worker() -> None:
            try:
                while (c := next(numbers)) < n:  # next() on a C iterator is atomic
                    work(c)
            except BaseException:
                stop()
                raise

        futures = []
        failed_before, self._failed = self._failed, True  # until all is done
        try:
            for _ in range(min(self.threads, n) - 1):
                futures.append(self._submit(self._pool, worker))
            worker()
            futures = [future for future in futures if not future.cancel()]  # of those not begun nothing is left to do
            _await(futures)
        finally:
            stop()
        for future in futures:
            future.result()
        self._failed = failed_before


def _await(futures: "list[Future[Any]]") -> None:
    """Until all are done, whatever came of them."""
    until = time.perf_counter() + AWAKE
    while not all(future.done() for future in futures):
        if time.perf_counter() > until:
            wait(futures)
        time.sleep(0)  # lets others have the interpreter
