"""The engine on a Dask cluster: `--scheduler ADDRESS`. A thin adapter with guards of its own.

Rows go out in small groups, a few for each of the cluster's threads, and come back as they finish. Dask retries what a dead
worker had; a group that it gives up on is cut into single rows, and a row that it gives up on twice is a failed row. A
cluster without workers, or a scheduler that is gone, ends the study with an error instead of waiting for good: what was
finished is in the ledger, and the same command goes on. Why Dask: docs/decisions/study-engine.md.
"""

import contextlib
import logging
import queue
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from itertools import islice
from typing import Any

from tiler.errors import TilerError
from tiler.study.rows import Job, Result, RowRunner, sources

TRIES = 2  # of a row alone that Dask gives up on
GROUP = 8  # rows of a task
TASKS_PER_THREAD = 2
CONNECT_SECONDS = 20.0
WORKERLESS_SECONDS = 120.0  # a cluster may take that long to start a worker

_own = threading.local()  # of a worker's threads
_warm = threading.Lock()
_warmed: set[str] = set()


def run_group(jobs: Sequence[Job], expected: str, machines: Sequence[dict[str, Any]], threads: int) -> list[Result]:
    """The rows of a group; runs on a worker. expected : digest of the sources that the study was begun with."""
    if sources() != expected:
        raise TilerError(f"cluster: a worker has other sources ({sources()}) than the study ({expected})")
    with _warm:  # the threads of a worker wait while the first of them compiles
        if expected not in _warmed:
            from tiler.config import Machine
            from tiler.shared import Shared
            from tiler.warmup import warm_up

            warm_up([Machine(**fields) for fields in machines], Shared())
            _warmed.add(expected)
    if getattr(_own, "threads", None) != threads:
        _own.runner, _own.threads = RowRunner(threads), threads
    return [_own.runner.run(job) for job in jobs]


def run_cluster(
    jobs: Iterable[Job], address: str, machines: Sequence[dict[str, Any]], threads: int
) -> Generator[list[Result], None, None]:
    """Finished rows of the cluster's workers, as they come."""
    with _connected(address) as client:
        yield from _Cluster(client, address, machines, threads).run(iter(jobs))


class _Cluster:
    """The groups that are on their way."""

    def __init__(self, client: Any, address: str, machines: Sequence[dict[str, Any]], threads: int) -> None:
        self._client = client
        self._address = address
        self._arguments = (sources(), list(machines), threads)
        self._futures: dict[Any, list[Job]] = {}  # by key
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._again: deque[Job] = deque()  # rows of groups that Dask gave up on, to be run alone
        self._given_up: Counter[int] = Counter()
        self._seen_worker = time.monotonic()
        self._is_warm = False  # the first group compiles what the disk cache has not; the others wait for it

    def run(self, jobs: Iterator[Job]) -> Iterator[list[Result]]:
        """Finished rows; in any order."""
        while True:
            room = max(2, TASKS_PER_THREAD * self._threads_there()) if self._is_warm else 1
            while len(self._futures) < room:
                group = [self._again.popleft()] if self._again else list(islice(jobs, GROUP))
                if not group:
                    break
                self._submit(group)
            if not self._futures:
                return
            try:
                future = self._answers.get(timeout=1.0)
            except queue.Empty:
                continue
            group = self._futures.pop(future.key)
            results = self._take(future, group)
            future.release()
            if results:
                yield results

    def _submit(self, group: list[Job]) -> None:
        key = f"tiler-{group[0]['row']}-{uuid.uuid4().hex}"
        future = self._client.submit(run_group, group, *self._arguments, key=key, pure=False)
        self._futures[key] = group
        future.add_done_callback(self._answers.put)

    def _take(self, future: Any, group: list[Job]) -> list[Result]:
        """Results of a group that is done; rows to try again if Dask gave it up."""
        try:
            results = list(future.result(timeout=CONNECT_SECONDS))
            self._is_warm = True
            return results
        except TilerError:
            raise
        except Exception as error:
            self._threads_there()  # raises where the scheduler is gone
            if len(group) > 1:
                self._again.extend(group)
                return []
            row = group[0]["row"]
            self._given_up[row] += 1
            if self._given_up[row] < TRIES:
                self._again.extend(group)
                return []
            return [{"row": row, "error": f"WorkerDied: {type(error).__name__}, {TRIES} times at this row"}]

    def _threads_there(self) -> int:
        """Threads of the cluster's workers. Raises TilerError where there is no scheduler, or for long no worker."""
        if self._client.status != "running":
            raise TilerError(
                f"scheduler: {self._address} is gone; the rows before are safe, and the same command goes on with the rest"
            )
        try:
            there = sum(self._client.nthreads().values())
        except Exception as error:
            raise TilerError(
                f"scheduler: {self._address} does not answer ({type(error).__name__}); the rows before are safe, and the "
                "same command goes on with the rest"
            ) from None
        now = time.monotonic()
        if there:
            self._seen_worker = now
        elif now - self._seen_worker > WORKERLESS_SECONDS:
            raise TilerError(
                f"scheduler: {self._address} has had no worker for {WORKERLESS_SECONDS:.0f} seconds; the rows before are "
                "safe, and the same command goes on with the rest"
            )
        return int(there)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError:
        raise TilerError(
            "scheduler: distributed is not installed; allowed: after `pip install 'tilesim[cluster]'`, or --workers"
        ) from None
    for name in ("distributed", "distributed.client", "distributed.core", "distributed.comm", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # a lost scheduler is told once, by us
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise TilerError(
            f"scheduler: {address} does not answer ({type(error).__name__}); allowed: the address of a running Dask "
            "scheduler, such as tcp://host:8786"
        ) from None
    try:
        yield client
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=5)
