"""What `tiler sweep` does: run, tell how far a study is, merge, export."""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from tiler.errors import TilerError
from tiler.files import check_target
from tiler.report.command import check_report, command_line
from tiler.study.export import import_duckdb
from tiler.study.ledger import Ledger
from tiler.study.plan import Plan
from tiler.study.results import Study, load_study
from tiler.study.run import check_request, parse_shard, run_rows
from tiler.study.schema import read_study


class SweepRequest(NamedTuple):
    """The command's arguments."""

    study: Path | None
    out: Path | None
    workers: int | None
    scheduler: str | None
    shard: str | None
    threads: int | None
    csv: Path | None
    parquet: Path | None
    status: bool
    merge: tuple[Path, ...]
    retry_failed: bool
    yes_run: int | None
    quiet: bool
    report: Path | None = None


def run_command(request: SweepRequest) -> dict[str, Any]:
    """Do it; a summary for `--json`, with the same as `text`."""
    out = _results_file(request)
    for path, option in ((request.csv, "csv"), (request.parquet, "parquet")):
        if path is not None:
            check_target(path, option)
    if request.report is not None:
        check_report(request.report)
    if request.parquet is not None:
        import_duckdb()
    start = time.monotonic()
    if not request.status and request.study is not None:
        plan = read_study(request.study)
        if request.merge:
            _merge(plan, out, request.merge)
        else:
            _run(plan, out, request)
    study = load_study(out)
    if request.csv is not None:
        study.to_csv(request.csv)
    if request.parquet is not None:
        study.to_parquet(request.parquet)
    if request.report is not None:
        from tiler.report.write import write_report

        write_report(study, request.report, command=command_line())
    return summary(study, time.monotonic() - start)


def summary(study: Study, seconds: float) -> dict[str, Any]:
    """How far a study is."""
    rows, done, failed = study.tally()
    failures = study.rows(["row", "error"], status="failed") if failed else []
    lines = [f"{study.name}: {done:,} of {rows:,} rows in {study.path}, {failed:,} failed"]
    lines += [f"row {failure['row']}: {failure['error']}" for failure in failures[:5]]
    lines += [f"{failed - 5:,} more failed rows"] if failed > 5 else []
    return {
        "study": study.name,
        "out": str(study.path),
        "rows": rows,
        "done": done,
        "failed": failed,
        "seconds": round(seconds, 3),
        "text": "\n".join(lines),
    }


def _results_file(request: SweepRequest) -> Path:
    if request.out is not None:
        out = request.out
    elif request.study is not None:
        out = Path(request.study.stem + ".db")
    else:
        raise TilerError("study: missing; allowed: the path of a study file, or --out with a results file to look at")
    exported = request.csv or request.parquet or request.report
    if request.study is None and (request.merge or not (request.status or exported)):
        raise TilerError(
            "study: missing; allowed: the path of a study file (--status, --csv, --parquet and --report need none)"
        )
    if request.status and request.merge:
        raise TilerError("merge: stands beside --status; allowed: one of the two")
    return out


def _merge(plan: Plan, out: Path, parts: tuple[Path, ...]) -> None:
    with Ledger(out, plan) as ledger:
        for part in parts:
            ledger.merge(part)


def _run(plan: Plan, out: Path, request: SweepRequest) -> None:
    part = None if request.shard is None else parse_shard(request.shard)
    shard = check_request(plan, request.workers, request.scheduler, part, request.threads, request.yes_run)
    with Ledger(out, plan) as ledger:
        if request.retry_failed:
            ledger.forget_failed()
        try:
            run_rows(plan, ledger, shard, request.workers, request.scheduler, request.threads, request.quiet)
        except KeyboardInterrupt:
            rows, done, _ = ledger.tally()
            print(f"{done:,} of {rows:,} rows are in {out}; the same command goes on with the rest", file=sys.stderr)
            raise
