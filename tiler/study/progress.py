"""How a study comes along, on standard error: rows done, rate, time left, failures; nothing where that is no terminal."""

import sys
import time
from types import TracebackType
from typing import Any, Self

SHOW_AFTER = 1.0  # seconds


class StudyProgress:
    """A line that renews itself; a context manager. `quiet` shows nothing."""

    def __init__(self, name: str, rows: int, done: int, failed: int, quiet: bool = False) -> None:
        self._name = name
        self._rows = rows
        self._before = done
        self._done, self._failed = done, failed
        self._shown = not quiet and sys.stderr.isatty()
        self._start = time.monotonic()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def add(self, done: int, failed: int) -> None:
        """Tell of more finished rows, `failed` of them failed."""
        self._done += done
        self._failed += failed
        if not self._shown or time.monotonic() - self._start < SHOW_AFTER:
            return
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn
            from rich.progress import Progress as Bar

            columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[told]}"))
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task(self._name, total=self._rows, told="")
            self._bar.start()
        self._bar.update(self._task, completed=self._done, told=self.line())

    def line(self) -> str:
        """Rows done, rate, time left, and failures if there are any."""
        seconds = max(time.monotonic() - self._start, 1e-9)
        rate = (self._done - self._before) / seconds
        left = say_seconds((self._rows - self._done) / rate) if rate > 0 else "?"
        failed = f", {self._failed:,} failed" if self._failed else ""
        return f"{self._done:,} of {self._rows:,} rows, {rate:,.3g}/s, {left} left{failed}"


def say_seconds(seconds: float) -> str:
    """A stretch of time in the unit that suits it."""
    for unit, length, most in (("s", 1, 100), ("min", 60, 100), ("h", 3600, 72), ("days", 86400, 1000)):
        if seconds / length < most:
            return f"{seconds / length:.2g} {unit}" if seconds / length < 10 else f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400 / 365.25:,.2g} years" if seconds < 3e10 else f"{seconds / 86400 / 365.25:,.0f} years"
