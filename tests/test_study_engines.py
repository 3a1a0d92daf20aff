"""Studies survive: in this process, on workers, killed, interrupted, on a full disk, on a cluster: the same table."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import tiler
from tests.study_tools import command, compared, run, write_study
from tiler.study.ledger import Ledger, open_results
from tiler.study.schema import read_study

POISON = Path(__file__).parent / "poison"
LAST = 92  # of the frames: 800 rows, enough to be interrupted in the middle


def wait_until(what: Callable[[], bool], seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def rows_in(out: Path) -> int:
    try:
        return len(tiler.load_study(out))
    except tiler.TilerError:
        return 0


def children(pid: int) -> list[int]:
    """Process ids of a process's children, from /proc."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
            except OSError:
                continue
            if int(stat.rpartition(")")[2].split()[1]) == pid:
                found.append(int(entry.name))
    return found


def is_alive(pid: int) -> bool:
    try:
        state = (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a study file of 800 rows and its undisturbed table."""
    folder = tmp_path_factory.mktemp("engines")
    tiler.sweep(write_study(folder, LAST), out=folder / "whole.db", threads=1)
    return folder


def is_whole(folder: Path, out: Path) -> bool:
    return compared(out) == compared(folder / "whole.db")


@contextmanager
def running(*arguments: object, env: dict[str, str] | None = None) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        command(*arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ, **(env or {})),
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def test_two_workers(folder: Path, tmp_path: Path):
    done = run(folder / "tiny.toml", "--out", tmp_path / "out.db", "--workers", 2, "--json", "-")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["done"] == 800
    assert "row" not in done.stderr, "quiet where there is no terminal"
    assert is_whole(folder, tmp_path / "out.db")


def test_a_killed_worker_loses_nothing(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    with running(folder / "tiny.toml", "--out", out, "--workers", 2) as process:
        wait_until(lambda: rows_in(out) > 20)
        victims = children(process.pid)
        assert len(victims) == 2
        os.kill(victims[0], signal.SIGKILL)
        _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert is_whole(folder, out)


@pytest.mark.slow
def test_a_row_that_kills_its_worker_once_is_tried_again(folder: Path, tmp_path: Path):
    env = {
        "PYTHONPATH": f"{POISON}:{os.environ.get('PYTHONPATH', '')}",
        "TILER_TEST_ROW": f"77:{tmp_path / 'was-here'}",
    }
    done = run(folder / "tiny.toml", "--out", tmp_path / "out.db", "--workers", 2, env=env)
    assert done.returncode == 0 and (tmp_path / "was-here").exists()
    assert is_whole(folder, tmp_path / "out.db")


@pytest.mark.slow
def test_a_row_that_always_kills_its_worker_fails_alone(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    env = {"PYTHONPATH": f"{POISON}:{os.environ.get('PYTHONPATH', '')}", "TILER_TEST_ROW": "77:kill"}
    done = run(folder / "tiny.toml", "--out", out, "--workers", 2, env=env)
    assert done.returncode == 1
    assert "row 77: WorkerDied: the worker was ended by SIGKILL, 2 times at this row" in done.stdout
    table, whole = tiler.load_study(out).rows(), tiler.load_study(folder / "whole.db").rows()
    assert [row["row"] for row in table if row["status"] == "failed"] == [77]
    assert len(table) == 800 and table[76]["key"] == whole[76]["key"]
    assert [r["ds_invocations"] for r in table if r["row"] != 77] == [
        r["ds_invocations"] for r in whole if r["row"] != 77
    ]
    assert run(folder / "tiny.toml", "--out", out, "--retry-failed", "-q").returncode == 0
    assert is_whole(folder, out)


@pytest.mark.parametrize("engine", [("--threads", 1), ("--workers", 2)], ids=["in-process", "workers"])
def test_interrupted_and_continued(folder: Path, tmp_path: Path, engine: tuple[object, ...]):
    out = tmp_path / "out.db"
    with running(folder / "tiny.toml", "--out", out, *engine) as process:
        wait_until(lambda: rows_in(out) > 20)
        workers = children(process.pid)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in said and said.strip().splitlines()[-1] == "interrupted"
    assert "of 800 rows are in" in said and "the same command goes on" in said
    assert not any(map(is_alive, workers))
    before = {row["row"]: row for row in tiler.load_study(out).rows()}
    assert 20 < len(before) < 800
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.db"]
    assert run(folder / "tiny.toml", "--out", out, *engine).returncode == 0
    assert is_whole(folder, out)
    after = {row["row"]: row["seconds"] for row in tiler.load_study(out).rows()}
    assert all(after[row] == values["seconds"] for row, values in before.items()), "finished rows are not run again"


@pytest.mark.slow
def test_a_killed_parent_leaves_no_process_and_loses_no_finished_row(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    with running(folder / "tiny.toml", "--out", out, "--workers", 2) as process:
        wait_until(lambda: rows_in(out) > 20)
        workers = children(process.pid)
        seen = rows_in(out)
        process.kill()
        process.wait()
    wait_until(lambda: not any(map(is_alive, workers)), 20)
    assert len(workers) == 2 and seen <= rows_in(out) < 800
    assert run(folder / "tiny.toml", "--out", out, "--workers", 2).returncode == 0
    assert is_whole(folder, out)


@pytest.mark.slow
def test_a_full_disk_is_told_and_loses_nothing(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    limit = 96 * 1024  # of a file's size: the log cannot grow beyond it

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    environment = dict(os.environ)
    done = subprocess.run(
        command(folder / "tiny.toml", "--out", out, "--workers", 2, "--quiet"),
        capture_output=True, text=True, timeout=120, check=False, preexec_fn=limited, env=environment,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: out: cannot write {out} (") and "the same command goes on" in done.stderr
    assert "Traceback" not in done.stderr
    assert 0 < rows_in(out) < 800
    assert run(folder / "tiny.toml", "--out", out, "--workers", 2).returncode == 0
    assert is_whole(folder, out)


def test_a_database_that_is_full_keeps_its_rows(tmp_path: Path):
    plan = read_study(write_study(tmp_path))
    results = [{"row": row, "error": "x" * 500} for row in range(96)]
    with Ledger(tmp_path / "out.db", plan) as ledger:
        ledger.write(results[:4])
        (pages,) = ledger._db.execute("PRAGMA page_count").fetchone()
        ledger._db.execute(f"PRAGMA max_page_count = {pages + 1}")
        with pytest.raises(tiler.TilerError, match=r"out: cannot write .*full.*goes on"):
            ledger.write(results[4:])
        assert ledger.finished() == {0, 1, 2, 3}, "all of a write or nothing"


def test_one_process_writes_at_a_time(tmp_path: Path):
    plan = read_study(write_study(tmp_path))
    with (
        Ledger(tmp_path / "out.db", plan),
        pytest.raises(tiler.TilerError, match="another process is writing"),
        Ledger(tmp_path / "out.db", plan),
    ):
        pass
    with Ledger(tmp_path / "out.db", plan) as ledger:
        assert ledger.finished() == set()


def test_a_row_is_never_stored_twice(tmp_path: Path):
    with Ledger(tmp_path / "out.db", read_study(write_study(tmp_path))) as ledger:
        ledger.write([{"row": 3, "error": "first"}])
        ledger.write([{"row": 3, "error": "second"}, {"row": 4, "error": None}])
        assert ledger.tally() == (96, 2, 1)
        assert open_results(ledger.path).execute("SELECT error FROM rows WHERE row = 3").fetchall() == [("first",)]


@pytest.mark.slow
def test_a_running_study_can_be_read(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    with running(folder / "tiny.toml", "--out", out, "--workers", 1) as process:
        wait_until(lambda: rows_in(out) > 20)
        told = json.loads(run("--status", "--out", out, "--json", "-").stdout)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert told["rows"] == 800 and told["done"] > 20 and told["failed"] == 0


@pytest.mark.slow
def test_shards_of_an_array_job_merge(folder: Path, tmp_path: Path):
    parts = [tmp_path / f"part{k}.db" for k in (1, 2, 3)]
    for k, part in enumerate(parts):
        assert run(folder / "tiny.toml", "--shard", f"{k + 1}/3", "--out", part, "--threads", 1).returncode == 0
    out = tmp_path / "all.db"
    done = run(folder / "tiny.toml", "--out", out, "--merge", *parts[:2])
    assert done.returncode == 0 and " of 800 rows" in done.stdout and "800 of" not in done.stdout
    assert run(folder / "tiny.toml", "--out", out, "--merge", parts[2]).returncode == 0
    assert is_whole(folder, out)


# On a cluster of two workers, each a process of its own.


@contextmanager
def cluster(env: dict[str, str] | None = None) -> Iterator[tuple[str, subprocess.Popen[bytes], list[int]]]:
    """Address and process of a scheduler, and the process ids of its workers, each of which a nanny starts again."""
    pytest.importorskip("distributed")
    script = Path(__file__).with_name("dask_cluster.py")
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=dict(os.environ, **(env or {})),
    ) as process:
        try:
            told = json.loads(process.stdout.readline())  # type: ignore[union-attr]
            yield told["address"], process, told["workers"]
        finally:
            process.stdin.close()  # type: ignore[union-attr]
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.mark.slow
def test_cluster_with_a_killed_worker(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    with (
        cluster() as (address, _, workers),
        running(folder / "tiny.toml", "--out", out, "--scheduler", address) as sweep,
    ):
        wait_until(lambda: rows_in(out) > 20)
        os.kill(workers[0], signal.SIGKILL)
        _, said = sweep.communicate(timeout=120)
        assert sweep.returncode == 0, said
    assert is_whole(folder, out)


@pytest.mark.slow
def test_cluster_whose_scheduler_is_killed(folder: Path, tmp_path: Path):
    out = tmp_path / "out.db"
    with (
        cluster() as (address, process, _),
        running(folder / "tiny.toml", "--out", out, "--scheduler", address) as sweep,
    ):
        wait_until(lambda: rows_in(out) > 20)
        process.kill()
        _, said = sweep.communicate(timeout=120)
    assert sweep.returncode == 2 and "Traceback" not in said
    assert said.startswith(f"error: scheduler: {address}") and "the same command goes on" in said
    assert 20 < rows_in(out) < 800
    with cluster() as (address, _, _):
        assert run(folder / "tiny.toml", "--out", out, "--scheduler", address).returncode == 0
    assert is_whole(folder, out)


@pytest.mark.slow
def test_no_cluster_is_one_clear_error(folder: Path, tmp_path: Path):
    pytest.importorskip("distributed")
    done = run(
        folder / "tiny.toml",
        "--out",
        tmp_path / "out.db",
        "--scheduler",
        "tcp://127.0.0.1:9",
    )
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "scheduler: tcp://127.0.0.1:9 does not answer" in done.stderr
