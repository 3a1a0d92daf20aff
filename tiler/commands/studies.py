"""`tiler sweep` and `tiler reproduce`: many frames."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiler.commands.options import JsonPath, Quiet
from tiler.commands.output import write_result


def sweep(
    study: Path | None = None,
    *,
    out: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    threads: int | None = None,
    csv: Path | None = None,
    parquet: Path | None = None,
    report: Path | None = None,
    status: bool = False,
    merge: Annotated[tuple[Path, ...], Parameter(consume_multiple=True)] = (),
    retry_failed: bool = False,
    yes_run: int | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Run a study: a grid of scenes, views, frames and machines into one table; interrupted, it goes on where it stopped.

    Examples: `tiler sweep bounds.toml --out bounds.db --workers 8 --csv bounds.csv`;
    `tiler sweep --status --out bounds.db`; as job 3 of an array of 64 `tiler sweep bounds.toml --shard 3/64 --out part3.db`,
    and afterwards `tiler sweep bounds.toml --out bounds.db --merge part*.db`.
    The exit status is 1 if rows have failed.

    Parameters
    ----------
    study
        A study file (docs/studies.md); for --status and exports the results file is enough.
    out
        Results file, an SQLite database; by default the study's name with .db.
    workers
        Processes of this computer; by default rows run in this one.
    scheduler
        Address of a Dask scheduler to run on, such as tcp://host:8786.
    shard
        Run part I of N only, as I/N with I from 1 to N.
    threads
        Threads of this computer for each frame; all by default, one in workers.
    csv
        Write the table as CSV too, and a .json beside it with what its columns mean.
    parquet
        Write the table as Parquet too (needs duckdb).
    report
        Write a report too: one .html file with the table, plots of it and what failed.
    status
        Say how far a study is, and run nothing.
    merge
        Take over the rows of other results files of this study, and run nothing.
    retry_failed
        Run failed rows again.
    yes_run
        Confirm a large study by its number of rows.
    json
        Write a summary as JSON to this file; - for standard output and nothing else there.
    quiet
        No summary and no progress.
    """
    from tiler.study.command import SweepRequest, run_command

    request = SweepRequest(
        study, out, workers, scheduler, shard, threads, csv, parquet, status, merge, retry_failed, yes_run, quiet, report
    )  # fmt: skip
    summary = run_command(request)
    if not write_result(summary, json) and not quiet:
        print(summary["text"])
    if summary["failed"]:
        sys.exit(1)


def reproduce(
    paper: str | None = None,
    *,
    table: str | None = None,
    figure: str | None = None,
    item: str | None = None,
    list_items: Annotated[bool, Parameter(name="--list", negative=())] = False,
    models: Path | None = None,
    out: Path = Path("reproduced"),
    page: Path | None = None,
    quick: bool = False,
    again: bool = False,
    seed: int = 0,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Compute the tables and figures of a paper anew, published beside measured, with a verdict against a stated tolerance.

    Examples: `tiler reproduce munkberg2010 --figure 6`; `tiler reproduce loop2011 --models models`;
    `tiler reproduce all --quick`; `tiler reproduce --list`.
    The exit status is 1 if a measured value is beyond its tolerance. Interrupted, it goes on with the first item that
    does not stand yet.

    Parameters
    ----------
    paper
        munkberg2010, sathe2011, loop2011, beyond (what no paper shows), or all.
    table
        Only this table of the paper, by its number.
    figure
        Only this figure.
    item
        Only this item, by the name that --list gives.
    list_items
        List the items, and run nothing.
    models
        Folder of the papers' models (docs/reproduce.md); scenes of ours stand in for those that are not there.
    out
        Folder for the results: figure, numbers and page of each item in a folder for each paper.
    page
        Put rows and figures between the marks of this page, too, pictures into `img` beside it.
    quick
        Fewer views, frames and factors.
    again
        Run items that stand already.
    seed
        Of random views.
    threads
        Threads of this computer to use; all by default. Only times depend on it.
    json
        Write the rows as JSON to this file; - for standard output and nothing else there.
    quiet
        No tables and no progress.
    """
    from tiler.reproduce import command

    request = command.ReproduceRequest(
        paper, table, figure, item, models, out, page, quick, again, seed, threads, quiet
    )
    if list_items:
        found = command.list_items(request)
        if not write_result({"papers": found["papers"]}, json):
            print(found["text"])
        return
    silent = quiet or json == "-"
    result = command.run_command(request, lambda text: None if silent else print(f"{text}\n", flush=True))
    write_result(result, json)
    if result["failed"]:
        sys.exit(1)
