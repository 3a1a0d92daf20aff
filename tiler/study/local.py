"""The engine that needs nothing: rows one after the other in this process."""

from collections.abc import Generator, Iterable

from tiler.study.rows import Job, Result, RowRunner


def run_local(jobs: Iterable[Job], threads: int | None) -> Generator[list[Result], None, None]:
    """Finished rows, one at a time. threads : host threads of each frame, all by default."""
    runner = RowRunner(threads)
    for job in jobs:
        yield [runner.run(job)]
