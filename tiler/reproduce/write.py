"""The files of an item: figure, numbers, record and page, each written beside its place and renamed into it.

ITEM.json is the record: what `run` needs to know an item again, to tell its rows and to make the page anew. It is written
last but for the pages, so that an item whose record stands is complete.
"""

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tiler.errors import TilerError
from tiler.files import write_bytes, write_json
from tiler.reproduce import page
from tiler.reproduce.item import Result, Row, Tolerance
from tiler.reproduce.style import figure_files
from tiler.study.export import table_to_parquet

SUFFIXES = (".json", ".md", ".png", ".svg", ".csv", ".parquet")


def write_item(folder: Path, record: dict[str, Any], result: Result) -> dict[str, Any]:
    """Write all files of an item; its record, completed."""
    check_table(result)
    name = record["item"]
    for suffix in SUFFIXES:  # what an earlier run left must not be taken for this one's; the record goes first
        (folder / f"{name}{suffix}").unlink(missing_ok=True)
    files: dict[str, bytes] = {}
    if result.draw is not None:
        files[f"{name}.png"], files[f"{name}.svg"] = figure_files(result.draw)
    files[f"{name}.csv"] = table_csv(result.table)
    for file, content in files.items():
        write_bytes(folder / file, content)
    names = list(files)
    if _write_parquet(folder, name, record, result):
        names.append(f"{name}.parquet")
    record = record | {
        "text": result.text,
        "units": result.units,
        "files": names,
        "rows": list(map(_plain, result.rows)),
    }
    write_json(folder / f"{name}.json", record)
    write_page(folder, record)
    return record


def write_page(folder: Path, record: dict[str, Any]) -> None:
    """Write an item's page from its record."""
    write_bytes(folder / f"{record['item']}.md", page.item_page(record, rows_of(record)).encode())


def read_record(folder: Path, name: str) -> dict[str, Any] | None:
    """The record of an item; None where it does not stand complete."""
    try:
        record = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        rows_of(record)
        whole = record["item"] == name and all((folder / file).is_file() for file in record["files"])
        page.item_page(record, rows_of(record))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return record if whole else None


def rows_of(record: dict[str, Any]) -> tuple[Row, ...]:
    """The rows that a record holds."""
    rows = []
    for row in record["rows"]:
        allowed = None if row["tolerance"] is None else Tolerance(**row["tolerance"])
        measured = math.nan if row["measured"] is None else float(row["measured"])
        rows.append(Row(row["what"], row["published"], measured, row["unit"], allowed, row["note"]))
    return tuple(rows)


def _plain(row: Row) -> dict[str, Any]:
    """A row as plain data; a number that is not finite is None."""
    allowed = None if row.tolerance is None else {k: v for k, v in row.tolerance._asdict().items() if v is not None}
    measured = float(row.measured) if math.isfinite(row.measured) else None
    return row._asdict() | {"tolerance": allowed, "measured": measured}


def check_table(result: Result) -> None:
    """Raise ValueError for columns of unequal length, without a definition, or with a number that is not finite."""
    lengths = {name: len(column) for name, column in result.table.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"table: columns of unequal length: {lengths}")
    if set(lengths) != set(result.units):
        raise ValueError(f"units: {sorted(result.units)} are not the columns {sorted(lengths)}")
    for name, column in result.table.items():
        if any(isinstance(value, float) and not math.isfinite(value) for value in column):
            raise ValueError(f"table: {name} holds a number that is not finite; None is what is missing")


def table_csv(table: dict[str, list[Any]]) -> bytes:
    """A table as CSV; what is missing is empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*table.values(), strict=True))
    return text.getvalue().encode()


def _write_parquet(folder: Path, name: str, record: dict[str, Any], result: Result) -> bool:
    """Write the numbers as Parquet too, where duckdb is installed."""
    try:
        import duckdb  # noqa: F401
    except ImportError:
        return False
    told = {"meta": record, "columns": result.units}
    types = {column: _type(values) for column, values in result.table.items()}
    table_to_parquet(folder / f"{name}.csv", types, told, folder / f"{name}.parquet")
    return True


def _type(values: Sequence[Any]) -> str:
    """DuckDB's type that holds a column."""
    kinds = {type(value) for value in values if value is not None}
    if kinds and kinds <= {bool}:
        return "BOOLEAN"
    if kinds and kinds <= {int}:
        return "BIGINT"
    return "DOUBLE" if kinds and kinds <= {int, float} else "VARCHAR"


def replace_block(path: Path, name: str, text: str) -> None:
    """Put text between the marks `<!-- begin NAME -->` and `<!-- end NAME -->` of a page. Raises TilerError without them."""
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    try:
        before = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise TilerError(f"page: {path} cannot be read ({error})") from None
    head, found, rest = before.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise TilerError(f"page: {path} is not allowed; allowed: a page with the lines {begin.strip()} and {end}")
    write_bytes(path, f"{head}{begin}{text}\n{end}{tail}".encode())
