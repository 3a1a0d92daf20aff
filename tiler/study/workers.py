"""The engine on processes of this machine: a small pool over pipes that expects its workers to be killed.

A worker is `python -m tiler.study.worker`; jobs and results are JSON lines. A worker that dies closes its pipe: the row
that it was at is tried once more elsewhere, and failed if that one dies of it too; rows that only waited are handed out
again. Why not an engine from elsewhere: docs/decisions/study-engine.md.
"""

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from typing import Any

from pipeline.jit import ROOT, cache_root
from tiler.errors import TilerError
from tiler.study.rows import Job, Result, sources

TRIES = 2  # of a row whose worker dies
STARTS = 3  # workers that may die in a row before any of them has answered
AHEAD_SECONDS = 0.25  # work that a worker has waiting, so that it never waits for us
MOST_AHEAD = 32  # rows; their text fits into a pipe, so that handing them out never blocks


class _Worker:
    """A process, what it was sent and has not answered, and the piece of an answer that came so far."""

    def __init__(self, threads: int, is_first: bool) -> None:
        environment = dict(os.environ, TILER_CACHE_DIR=str(cache_root()), NUMBA_NUM_THREADS="1")
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        if not is_first:
            environment["TILER_QUIET"] = "1"
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "tiler.study.worker", str(threads)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            process_group=0,  # Ctrl-C is the parent's alone
        )
        self.sent: deque[Job] = deque()
        self.is_ready = False
        self.window = 1
        self.mean = 0.0  # seconds a row, as the parent sees it
        self.last = time.monotonic()
        self._rest = b""

    @property
    def output(self) -> int:
        return self.process.stdout.fileno()  # type: ignore[union-attr]

    def send(self, message: dict[str, Any]) -> None:
        """Hand a message over. A worker that is gone is noticed when its output ends."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write((json.dumps(message) + "\n").encode())  # type: ignore[union-attr]
            self.process.stdin.flush()  # type: ignore[union-attr]

    def receive(self) -> list[dict[str, Any]] | None:
        """Whole messages that have come; None where the worker is gone."""
        data = os.read(self.output, 1 << 18)
        if not data:
            return None
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def answered(self, rows: int) -> None:
        """Learn how long a row takes, and so how many to send ahead."""
        now = time.monotonic()
        seconds = (now - self.last) / rows
        self.last = now
        self.mean = seconds if self.mean == 0.0 else 0.7 * self.mean + 0.3 * seconds
        self.window = max(2, min(MOST_AHEAD, int(AHEAD_SECONDS / max(self.mean, 1e-6))))

    def kill(self) -> int:
        """End the process; its exit status."""
        self.process.kill()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()  # type: ignore[union-attr]
        return self.process.wait()


class Pool:
    """Workers and the rows that are on their way; a context manager that leaves no process behind."""

    def __init__(self, workers: int, machines: Sequence[dict[str, Any]], threads: int = 1) -> None:
        self._count = workers
        self._machines = list(machines)
        self._threads = threads
        self._selector = selectors.DefaultSelector()
        self._workers: list[_Worker] = []
        self._again: deque[Job] = deque()
        self._deaths: Counter[int] = Counter()  # by row
        self._failed_starts = 0
        self._warm = False  # whether the disk cache has all kernels
        self._warming: _Worker | None = None
        self._dry = False  # whether all jobs were taken

    def __enter__(self) -> "Pool":
        return self

    def __exit__(self, *_: Any) -> None:
        for worker in self._workers:
            worker.kill()
        self._selector.close()

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [worker.process.pid for worker in self._workers]

    def run(self, jobs: Iterable[Job]) -> Generator[list[Result], None, None]:
        """Finished rows, as they come; in any order."""
        source = iter(jobs)
        for k in range(self._count):
            self._start(is_first=k == 0)
        while True:
            for worker in self._workers:
                self._fill(worker, source)
            if not self._has_work() and not any(worker.sent for worker in self._workers):
                return
            for key, _ in self._selector.select():
                worker = key.data
                messages = worker.receive()
                results = self._bury(worker) if messages is None else self._hear(worker, messages)
                if results:
                    yield results

    def _start(self, is_first: bool = False) -> None:
        worker = _Worker(self._threads, is_first)
        self._workers.append(worker)
        self._selector.register(worker.output, selectors.EVENT_READ, worker)

    def _fill(self, worker: _Worker, source: Iterator[Job]) -> None:
        """Send rows ahead. The first worker compiles what the disk cache has not; the others wait for that."""
        if not self._warm:
            if self._warming is None and worker.is_ready:
                self._warming = worker
                worker.send({"warm": self._machines})
            return
        if not worker.is_ready or len(worker.sent) > worker.window // 2:
            return
        if not worker.sent:
            worker.last = time.monotonic()
        while len(worker.sent) < worker.window:
            job = self._again.popleft() if self._again else next(source, None)
            if job is None:
                self._dry = True
                return
            worker.sent.append(job)
            worker.send(job)

    def _has_work(self) -> bool:
        """Whether rows wait to be handed out."""
        return bool(self._again) or not self._dry

    def _hear(self, worker: _Worker, messages: list[dict[str, Any]]) -> list[Result]:
        results: list[Result] = []
        for message in messages:
            if "ready" in message:
                if message["ready"] != sources():
                    raise TilerError("workers: the sources were edited while the study runs; give the command again")
                worker.is_ready = True
            elif "warm" in message:
                self._warm = True
                self._failed_starts = 0
            else:
                worker.sent.popleft()
                results.append(message)
        if results:
            self._failed_starts = 0
            worker.answered(len(results))
        return results

    def _bury(self, worker: _Worker) -> list[Result]:
        """Take a dead worker's rows back, and start another; a row that has killed its workers is failed."""
        self._selector.unregister(worker.output)
        self._workers.remove(worker)
        status = worker.kill()
        if self._warming is worker:
            self._warming = None
        results: list[Result] = []
        if worker.sent:
            row = worker.sent[0]["row"]
            self._deaths[row] += 1
            if self._deaths[row] >= TRIES:
                worker.sent.popleft()
                results.append({"row": row, "error": f"WorkerDied: {_cause(status)}, {TRIES} times at this row"})
            self._again.extendleft(reversed(worker.sent))
        else:
            self._failed_starts += 1
            if self._failed_starts >= STARTS:
                raise TilerError(
                    f"workers: {STARTS} workers in a row ended before they did anything ({_cause(status)})"
                )
        if self._has_work():
            self._start()
        return results


def run_pool(
    jobs: Iterable[Job], workers: int, machines: Sequence[dict[str, Any]], threads: int
) -> Generator[list[Result], None, None]:
    """Finished rows of `workers` processes, as they come."""
    with Pool(workers, machines, threads) as pool:
        yield from pool.run(jobs)


def _cause(status: int) -> str:
    if status < 0:
        with contextlib.suppress(ValueError):
            return f"the worker was ended by {signal.Signals(-status).name}"
    return f"the worker ended with status {status}"
