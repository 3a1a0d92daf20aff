"""The table in files that other programs read: CSV by the standard library, Parquet by DuckDB."""

import csv
import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.errors import TilerError
from tiler.files import check_target, write_json
from tiler.study.ledger import open_results, quote, select

if TYPE_CHECKING:
    from tiler.study.results import Study


def import_duckdb() -> Any:
    """The module. Raises TilerError where it is not installed."""
    try:
        import duckdb
    except ImportError:
        raise TilerError(
            "parquet: duckdb is not installed; allowed: after `pip install 'tilesim[data]'`, or CSV"
        ) from None
    return duckdb


def description(study: "Study") -> dict[str, Any]:
    """What the table means and where it comes from, as plain data."""
    columns = {name: column._asdict() for name, column in study.columns.items()}
    return {"meta": study.meta, "columns": columns}


def write_csv(study: "Study", path: Path) -> None:
    """Write `path`, and `path` with .json appended; both appear whole. Missing values are empty."""
    check_target(path, "csv")
    _write_table(study, path)
    write_json(path.with_name(path.name + ".json"), description(study))


def write_parquet(study: "Study", path: Path) -> None:
    """Write `path`; metadata `tiler.meta` and `tiler.columns` hold JSON. Goes through CSV: DuckDB reads no SQLite offline."""
    import_duckdb()
    check_target(path, "parquet")
    with tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=".tiler-") as folder:
        table = Path(folder) / "rows.csv"
        _write_table(study, table)
        table_to_parquet(table, _types(study), description(study), path)


def table_to_parquet(table: Path, types: Mapping[str, str], told: Mapping[str, Any], path: Path) -> None:
    """Write a CSV file as Parquet. types : DuckDB's, of each column; told : metadata, as JSON under `tiler.` and its name."""
    duckdb = import_duckdb()
    columns = ", ".join(f"{_text(name)}: {_text(kind)}" for name, kind in types.items())
    pairs = ", ".join(f"{quote('tiler.' + name)}: {_text(json.dumps(value))}" for name, value in told.items())
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with duckdb.connect() as db:
            db.execute(
                f"COPY (SELECT * FROM read_csv({_text(str(table))}, header = true, auto_detect = false, delim = ',', "
                f"quote = '\"', escape = '\"', nullstr = '', columns = {{{columns}}})) "
                f"TO {_text(str(beside))} (FORMAT parquet, KV_METADATA {{{pairs}}})"
            )
        beside.replace(path)
    except (duckdb.Error, OSError) as error:
        raise TilerError(f"parquet: cannot write {path} ({error})") from None
    finally:
        beside.unlink(missing_ok=True)


def _write_table(study: "Study", path: Path) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with closing(open_results(study.path)) as db, beside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(study.columns)
            writer.writerows(select(db, list(study.columns)))
        beside.replace(path)
    except OSError as error:
        raise TilerError(f"csv: cannot write {path} ({error.strerror})") from None
    finally:
        beside.unlink(missing_ok=True)


def _types(study: "Study") -> dict[str, str]:
    """DuckDB's type of each column: what all its values fit into."""
    found = {}
    with closing(open_results(study.path)) as db:
        for name in study.columns:
            kinds = {kind for (kind,) in db.execute(f"SELECT DISTINCT typeof({quote(name)}) FROM rows")} - {"null"}
            whole = kinds == {"integer"} or (not kinds and study.columns[name].kind in ("counter", "check"))
            found[name] = "BIGINT" if whole else "DOUBLE" if kinds and kinds <= {"integer", "real"} else "VARCHAR"
    return found


def _text(value: str) -> str:
    """A text as SQL writes it."""
    return "'" + value.replace("'", "''") + "'"
