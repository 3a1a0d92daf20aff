"""A progress bar on standard error, for calls that take longer than a moment; nothing where that is no terminal."""

import sys
import time
from types import TracebackType
from typing import Any, Self

SHOW_AFTER = 1.0  # seconds


class Progress:
    """A bar over `total` steps of work; a context manager. `quiet` shows nothing."""

    def __init__(self, what: str, total: int, quiet: bool = False) -> None:
        self._what = what
        self._total = total
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

    def update(self, done: float) -> None:
        """Tell that `done` of the total steps are done; parts of a step count."""
        if not self._shown:
            return
        if self._bar is None:
            if time.monotonic() - self._start < SHOW_AFTER or done >= self._total:
                return
            from rich.console import Console
            from rich.progress import Progress as Bar

            self._bar = Bar(console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task(self._what, total=self._total)
            self._bar.start()
        self._bar.update(self._task, completed=done)
