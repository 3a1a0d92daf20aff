"""The results file of a study: an SQLite database with one long table, `rows`, a row for each finished frame and machine.

Table `columns` defines each column (kind, unit, text); table `meta` says where the numbers come from. While a study runs
the file is in write-ahead mode: a row is safe from the end of its process once it is written, and from the end of the machine a
second later at most, when the log is flushed. A finished file is one plain file again. One process writes at a time.
"""

import contextlib
import fcntl
import json
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, Self

from tiler.counters import DEFINITIONS
from tiler.errors import TilerError
from tiler.provenance import provenance
from tiler.study.plan import Plan, row_key
from tiler.study.rows import Result, sources

FORMAT = "tiler study 1"
FLUSH_EVERY = 1.0  # seconds
DONE, FAILED = "ok", "failed"

# Columns beside axes and counters: kind, unit, text.
_FIXED = {
    "row": ("identity", "", "Number of the row in the study, from 0."),
    "key": ("identity", "", "Digest of the row's full description and of the sources that made it."),
    "seconds": ("time", "seconds", "Wall time of the simulation; depends on the computer, and is never compared."),
    "violations": ("check", "violations", "Wrong bounds and culls that a machine with verify found."),
    "false_culls": ("check", "patches", "Patches wrongly dropped by a test that is right for the smooth surface."),
    "status": ("outcome", "", f"{DONE}, or {FAILED}: see error."),
    "error": ("outcome", "", "What went wrong with a failed row."),
}
_AXES = {
    "scene": "Scene, a built-in name or a file.",
    "view": "View, a table [view.NAME] of the study; path: the scene's own camera path.",
    "frame": "Frame of the camera path, or number of the eye in its view.",
    "machine": "Machine, a table [machine.NAME] of the study or a built-in one; its fields are in meta, machines.",
}
NOT_COMPARED = ("seconds",)  # columns in which two runs of a study may differ


class Tally(NamedTuple):
    """How far a study is."""

    rows: int
    done: int  # failed ones among them
    failed: int


class Ledger:
    """A results file opened for writing; a context manager. Raises TilerError where it cannot be, or is another study's."""

    def __init__(self, path: Path, plan: Plan) -> None:
        self.path = path
        self.plan = plan
        self._columns = plan.grid.columns()
        self._lock = _lock(path)
        try:
            with _told(path):
                begun = path.exists() and path.stat().st_size > 0 and _has_tables(path)
            if begun:  # looked at before anything in it is touched
                with contextlib.closing(open_results(path)) as db:
                    check_identity(db, path, plan.identity())
            with _told(path):
                self._db = sqlite3.connect(path, isolation_level=None, timeout=30)
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.execute("PRAGMA synchronous = NORMAL")
                if not begun:
                    self._create()
        except BaseException:
            if hasattr(self, "_db"):
                self._db.close()
            _unlock(self._lock, path)
            raise
        names = ["row", "key", *self._columns, *DEFINITIONS, "seconds", "violations", "false_culls", "status", "error"]
        self._insert = (
            f"INSERT OR IGNORE INTO rows ({', '.join(map(quote, names))}) VALUES ({', '.join('?' * len(names))})"
        )
        self._flushed = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def close(self) -> None:
        """Make one plain file of it again. A reader that holds it open, or a full disk, only puts that off."""
        with contextlib.suppress(sqlite3.Error):
            self._db.execute("PRAGMA busy_timeout = 200")
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()
        _unlock(self._lock, self.path)

    def write(self, results: Iterable[Result]) -> None:
        """Store finished rows, all or none; a row that is there already stays as it is."""
        with _told(self.path), _transaction(self._db):
            self._db.executemany(self._insert, [self._record(result) for result in results])
        if time.monotonic() - self._flushed > FLUSH_EVERY:
            with _told(self.path):
                self._db.execute("PRAGMA wal_checkpoint(PASSIVE)")
            self._flushed = time.monotonic()

    def finished(self) -> set[int]:
        """Numbers of the rows that are there."""
        return {row for (row,) in self._db.execute("SELECT row FROM rows")}

    def forget_failed(self) -> None:
        """Take the failed rows out, so that they are run again."""
        with _told(self.path), _transaction(self._db):
            self._db.execute("DELETE FROM rows WHERE status = ?", (FAILED,))

    def tally(self) -> Tally:
        """How far the study is."""
        return tally(self._db)

    def merge(self, part: Path) -> None:
        """Take over the rows of another results file of the same study; a row that failed here gives way to a good one."""
        names = [name for (_, name, *_) in self._db.execute("PRAGMA table_info(rows)")]
        listed = ", ".join(map(quote, names))
        update = ", ".join(f"{quote(name)} = excluded.{quote(name)}" for name in names if name != "row")
        statement = (
            f"INSERT INTO rows ({listed}) VALUES ({', '.join('?' * len(names))}) ON CONFLICT (row) DO UPDATE SET {update} "
            f"WHERE rows.status = '{FAILED}' AND excluded.status = '{DONE}'"
        )
        with contextlib.closing(open_results(part)) as other:
            check_identity(other, part, self.plan.identity())
            with _told(self.path), _transaction(self._db):
                self._db.executemany(statement, other.execute(f"SELECT {listed} FROM rows ORDER BY row"))

    def _record(self, result: Result) -> list[Any]:
        row = result["row"]
        values = self.plan.grid.values(row)
        counters = result.get("counters") or {}
        return [
            row,
            row_key(self.plan.job(row)),
            *(cell(values.get(name)) for name in self._columns),
            *(counters.get(name) for name in DEFINITIONS),
            *(result.get(name) for name in ("seconds", "violations", "false_culls")),
            FAILED if result["error"] else DONE,
            result["error"],
        ]

    def _create(self) -> None:
        """All tables in one transaction: a file that is interrupted here is still an empty one."""
        described = [("row", *_FIXED["row"]), ("key", *_FIXED["key"])]
        described += [(name, "axis", "", _AXES.get(name, _text_of(name))) for name in self._columns]
        described += [
            (name, "counter", d.unit, f"{d.text} Same as: {d.same_as}." if d.same_as else d.text)
            for name, d in DEFINITIONS.items()
        ]
        described += [(n, *_FIXED[n]) for n in ("seconds", "violations", "false_culls", "status", "error")]
        kinds = {"counter": " INTEGER", "check": " INTEGER", "time": " REAL", "outcome": " TEXT"}
        made = [f"{quote(n)}{kinds.get(k, '')}" for n, k, *_ in described if n not in ("row", "key")]
        with _transaction(self._db):
            self._db.execute(f"CREATE TABLE rows (row INTEGER PRIMARY KEY, key TEXT NOT NULL, {', '.join(made)})")
            self._db.execute("CREATE TABLE columns (name TEXT PRIMARY KEY, kind TEXT, unit TEXT, text TEXT)")
            self._db.execute("CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT)")
            self._db.executemany("INSERT INTO columns VALUES (?, ?, ?, ?)", described)
            self._db.executemany("INSERT INTO meta VALUES (?, ?)", _meta(self.plan).items())


def _meta(plan: Plan) -> dict[str, str]:
    return {
        "format": FORMAT,
        "identity": plan.identity(),
        "name": plan.name,
        "rows": str(len(plan.grid)),
        "seed": str(plan.seed),
        "study": plan.text,
        "machines": json.dumps(plan.machines),
        "scenes": json.dumps({name: scene["digest"] for name, scene in plan.scenes.items()}),
        "sources": sources(),
        "begun": datetime.now(UTC).isoformat(timespec="seconds"),
        **provenance(),
    }


def _text_of(column: str) -> str:
    if column.startswith("machine."):
        return f"Field {column.removeprefix('machine.')} of the machine."
    return f"The scene's {column}, as scene files have it."


def cell(value: Any) -> Any:
    """An axis value as the table holds it: a number or a short text, as the command line writes it."""
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, list):
        if all(isinstance(item, str) for item in value):
            return "+".join(value) or "none"
        return ",".join(f"{item:g}" if isinstance(item, float) else str(item) for item in value)
    return value


def quote(name: str) -> str:
    """A column's name as SQL writes it."""
    return '"' + name.replace('"', '""') + '"'


def open_results(path: Path) -> sqlite3.Connection:
    """A results file for reading, finished or not. Raises TilerError for anything else."""
    if not path.is_file():
        raise TilerError(f"results: {path} does not exist; allowed: a results file of tiler sweep")
    for mode in ("rw", "ro"):  # a log that a killed process left is worked in, where that is allowed
        db = None
        try:
            db = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=30)
            if read_meta(db).get("format") == FORMAT:
                return db
        except sqlite3.Error:
            pass
        if db is not None:
            db.close()
    raise TilerError(f"results: {path} is not a results file of a study; allowed: a file that tiler sweep has made")


def read_meta(db: sqlite3.Connection) -> dict[str, str]:
    """Table `meta`."""
    return dict(db.execute("SELECT name, value FROM meta"))


def tally(db: sqlite3.Connection) -> Tally:
    """How far the study of a results file is."""
    done, failed = db.execute("SELECT count(*), count(*) FILTER (WHERE status = ?) FROM rows", (FAILED,)).fetchone()
    return Tally(int(read_meta(db)["rows"]), done, failed)


def check_identity(db: sqlite3.Connection, path: Path, identity: str) -> None:
    """Raise TilerError unless the results file belongs to the study."""
    meta = read_meta(db)
    if meta["identity"] == identity:
        return
    if meta["sources"] != sources():
        raise TilerError(
            f"out: {path} was begun by other sources ({meta['version']}, {meta['sources']}; here {sources()}), and rows of "
            "two do not mix; allowed: the sources that began it, or a new file"
        )
    raise TilerError(
        f"out: {path} holds another study ({meta['name']!r}, {int(meta['rows']):,} rows, begun {meta['begun']}); "
        "allowed: the study that it was begun with, unchanged, or a new file"
    )


def _has_tables(path: Path) -> bool:
    """Whether anything was put into a database; one that was interrupted at its very beginning is still a new one."""
    with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=rw", uri=True)) as db:
        return bool(db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])


@contextlib.contextmanager
def _transaction(db: sqlite3.Connection) -> Iterator[None]:
    """All of it or nothing, an interrupt included."""
    db.execute("BEGIN IMMEDIATE")
    try:
        yield
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                db.execute("ROLLBACK")
        raise


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """SQLite's and the system's errors as ours."""
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        if "not a database" in str(error):
            raise TilerError(
                f"out: {path} is not a results file of a study; allowed: such a file, or a new one"
            ) from None
        raise TilerError(
            f"out: cannot write {path} ({error}); the rows before are safe in it, and the same command goes on with the rest"
        ) from None


def _lock(path: Path) -> int:
    """A descriptor that holds the file's lock, which ends with this process however it ends."""
    if path.is_dir():
        raise TilerError(f"out: {path} is a folder; allowed: the path of a results file, such as results.db")
    beside = path.with_name(path.name + ".lock")
    while True:
        try:
            held = os.open(beside, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise TilerError(
                f"out: {path} is not allowed; allowed: a file in a folder that can be written ({error.strerror})"
            ) from None
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.exists(beside) and os.path.samestat(os.fstat(held), os.stat(beside)):
                return held
        except BlockingIOError:
            os.close(held)
            raise TilerError(
                f"out: another process is writing {path}; allowed: one at a time, and a file of its own for each shard"
            ) from None
        except FileNotFoundError:
            pass
        os.close(held)  # its owner took it away between our two calls


def _unlock(held: int, path: Path) -> None:
    with contextlib.suppress(OSError):
        os.unlink(path.with_name(path.name + ".lock"))
    os.close(held)


def select(db: sqlite3.Connection, columns: Sequence[str]) -> sqlite3.Cursor:
    """These columns of all rows, in the order of the study."""
    return db.execute(f"SELECT {', '.join(map(quote, columns))} FROM rows ORDER BY row")
