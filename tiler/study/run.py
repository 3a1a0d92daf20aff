"""`sweep`: the public door to studies. Checks all that can be checked, then runs what the results file does not have yet."""

import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

from tiler.config import Machine
from tiler.errors import TilerError
from tiler.study.grid import Shard
from tiler.study.ledger import Ledger
from tiler.study.local import run_local
from tiler.study.plan import Plan
from tiler.study.progress import StudyProgress, say_seconds
from tiler.study.results import Study, load_study
from tiler.study.rows import Job, Result, RowRunner
from tiler.study.schema import make_plan, read_study

MOST_UNASKED = 100_000  # rows of a study that begins without being confirmed
ESTIMATE_SECONDS = 10.0  # spent at most on saying how long a large study would take


def sweep(
    study: str | Path | None = None,
    *,
    scenes: str | Sequence[str] | None = None,
    machines: Machine | Mapping[str, Machine | Mapping[str, Any]] | str | Sequence[str] | None = None,
    frames: Any = None,
    views: Mapping[str, Mapping[str, Any]] | None = None,
    settings: Mapping[str, Any] | None = None,
    name: str = "study",
    seed: int = 0,
    out: str | Path,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    threads: int | None = None,
    yes_run: int | None = None,
    retry_failed: bool = False,
    progress: bool = False,
) -> Study:
    """Simulate a study's frames on its machines into a results file; what the file has already is not run again.

    study : path of a study file; or None, and the study is what the following arguments say.
    scenes : names or paths of scene files, "teapot" by default. machines : one, several by name (a `Machine` or its fields),
    or names of built-in ones. frames : numbers, or a text such as "0..47", of the scenes' camera paths; 0 by default.
    views : instead of frames, tables as in a study file, by name: {"around": {"kind": "orbit", "steps": 36}}.
    settings : lists of values by key, of scenes ("tessellation.factor") and of machines ("machine.tile").
    name, seed : of the study.

    out : path of the results file (SQLite). workers : processes of this machine; by default rows run in this process.
    scheduler : address of a Dask scheduler to run on instead. shard : (i, n) runs part i, from 1, of n.
    threads : host threads of each frame; all by default, one in workers. yes_run : number of rows, to confirm a large study.
    retry_failed : run failed rows again. progress : show it on a terminal.

    A frame that fails is a row with its error. Raises TilerError for bad input, before anything is run, and where the file
    cannot be written on.
    """
    given = {"scenes": scenes, "machines": machines, "frames": frames, "views": views, "settings": settings}
    if study is not None:
        beside = [key for key, value in given.items() if value is not None]
        if beside:
            raise TilerError(f"{beside[0]}: stands beside a study file; allowed: one of the two")
        plan = read_study(Path(study))
    else:
        plan = plan_of(name=name, seed=seed, **given)
    part = check_request(plan, workers, scheduler, shard, threads, yes_run)
    out = Path(out)
    with Ledger(out, plan) as ledger:
        if retry_failed:
            ledger.forget_failed()
        run_rows(plan, ledger, part, workers, scheduler, threads, quiet=not progress)
    return load_study(out)


def plan_of(
    *, scenes: Any = None, machines: Any = None, frames: Any = None, views: Any = None, settings: Any = None,
    name: Any = "study", seed: Any = 0,
) -> Plan:  # fmt: skip
    """The plan of a study given as arguments of `sweep`."""
    table: dict[str, Any] = {str(key): value for key, value in (settings or {}).items()}
    named: dict[str, Any] = {}
    if scenes is not None:
        table["scene"] = [str(s) for s in ([scenes] if isinstance(scenes, str | Path) else scenes)]
    if isinstance(machines, Machine):
        machines = {"machine": machines}
    if isinstance(machines, Mapping):
        named = {str(k): m.model_dump(mode="json") if isinstance(m, Machine) else dict(m) for k, m in machines.items()}
        table["machine"] = list(named)
    elif machines is not None:
        table["machine"] = [machines] if isinstance(machines, str) else list(machines)
    if frames is not None:
        table["frame"] = frames if isinstance(frames, str | range | int | float) else list(frames)
    if views is not None:
        table["view"] = list(views)
    data = {
        "study": {"name": name, "seed": seed},
        "sweep": table,
        "machine": named,
        "view": {str(k): dict(view) for k, view in (views or {}).items()},
    }
    return make_plan(data, _text(data), "sweep", Path.cwd(), {})


def check_request(
    plan: Plan,
    workers: int | None,
    scheduler: str | None,
    shard: tuple[int, int] | None,
    threads: int | None,
    yes_run: int | None,
) -> Shard:
    """The shard to run. Raises TilerError if a study cannot be run so."""
    if workers is not None and not (isinstance(workers, int) and 1 <= workers <= 1024):
        raise TilerError(f"workers: {workers!r} is not allowed; allowed: 1 to 1024")
    if threads is not None and not (isinstance(threads, int) and 1 <= threads <= 1024):
        raise TilerError(f"threads: {threads!r} is not allowed; allowed: 1 to 1024")
    if workers is not None and scheduler is not None:
        raise TilerError("scheduler: stands beside workers; allowed: one of the two")
    if shard is not None and not 1 <= shard[0] <= shard[1]:
        raise TilerError(f"shard: {shard[0]}/{shard[1]} is not allowed; allowed: I/N with I from 1 to N")
    rows = len(plan.grid)
    if yes_run is not None and yes_run != rows:
        raise TilerError(f"yes-run: {yes_run:,} is not the number of rows of the study, which is {rows:,}")
    if rows > MOST_UNASKED and yes_run is None:
        raise TilerError(
            f"study: {plan.name!r} has {rows:,} rows, about {say_seconds(estimate_seconds(plan))} in one process; "
            f"to run it, confirm the number: --yes-run {rows} (yes_run={rows})"
        )
    return Shard() if shard is None else Shard(*shard)


def estimate_seconds(plan: Plan) -> float:
    """How long all rows would take in this process, by a few that are spread over the study."""
    runner = RowRunner()
    rows = len(plan.grid)
    start = time.perf_counter()
    spent = []
    for row in dict.fromkeys((0, rows // 2, rows - 1)):
        job = plan.job(row)
        runner.run(job)  # compiles, loads
        before = time.perf_counter()
        runner.run(job)
        spent.append(time.perf_counter() - before)
        if time.perf_counter() - start > ESTIMATE_SECONDS:
            break
    return sum(spent) / len(spent) * rows


def run_rows(
    plan: Plan,
    ledger: Ledger,
    shard: Shard,
    workers: int | None,
    scheduler: str | None,
    threads: int | None,
    quiet: bool,
) -> None:
    """Run the rows of a shard that the ledger does not have, each written as soon as it is finished."""
    rows = len(plan.grid)
    finished = ledger.finished()
    todo = (row for row in range(rows) if row not in finished and shard.holds(row, rows))
    first = list(islice(todo, 1))
    if not first:
        return
    jobs: Iterable[Job] = (plan.job(row) for row in chain(first, todo))
    before = ledger.tally()
    engine = _engine(plan, jobs, workers, scheduler, threads)
    try:
        with StudyProgress(plan.name, rows, before.done, before.failed, quiet) as bar:
            for results in engine:
                ledger.write(results)
                bar.add(len(results), sum(result["error"] is not None for result in results))
    finally:
        engine.close()  # ends its processes


def parse_shard(text: str) -> tuple[int, int]:
    """Part and number of parts from 3/64."""
    number, slash, of = text.partition("/")
    if not slash or not number.isdigit() or not of.isdigit():
        raise TilerError(f"shard: {text!r} is not allowed; allowed: I/N, such as 3/64, with I from 1 to N")
    return int(number), int(of)


def _engine(
    plan: Plan, jobs: Iterable[Job], workers: int | None, scheduler: str | None, threads: int | None
) -> Generator[list[Result], None, None]:
    machines = list(plan.machines.values())
    if scheduler is not None:
        from tiler.study.cluster import run_cluster

        return run_cluster(jobs, scheduler, machines, threads or 1)
    if workers is not None:
        from tiler.study.workers import run_pool

        return run_pool(jobs, workers, machines, threads or 1)
    return run_local(jobs, threads)


def _text(data: Mapping[str, Any]) -> str:
    import json

    try:
        return json.dumps(data, default=_plain)
    except (TypeError, ValueError):
        return repr(data)


def _plain(value: Any) -> Any:
    from tiler.study.settings import plain

    if isinstance(value, range):
        return [value.start, value.stop]
    changed = plain(value)
    if changed is value:
        raise TypeError(f"{value!r} is not plain")
    return changed
