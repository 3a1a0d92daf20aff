"""`load_study`: a results file as users get it."""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tiler.errors import TilerError, unknown_name
from tiler.study.ledger import DONE, Tally, open_results, read_meta, select, tally

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


class Column(NamedTuple):
    """What a column holds. kind : identity, axis, counter, time, check or outcome."""

    kind: str
    unit: str
    text: str


class Study:
    """The table of a study, read from its file at each call: it may still be growing.

    meta : where the numbers come from, by name: version, commit, seed, python, numpy, numba, cpu, cores, the study's text.
    columns : what each column holds.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with contextlib.closing(open_results(self.path)) as db:
            self.meta = read_meta(db)
            described = db.execute("SELECT name, kind, unit, text FROM columns")
            self.columns = {name: Column(kind, unit, text) for name, kind, unit, text in described}

    @property
    def name(self) -> str:
        """The study's name."""
        return self.meta["name"]

    @property
    def axes(self) -> list[str]:
        """Names of the columns that say what was simulated."""
        return [name for name, column in self.columns.items() if column.kind == "axis"]

    @property
    def machines(self) -> dict[str, dict[str, Any]]:
        """All fields of each named machine."""
        return dict(json.loads(self.meta["machines"]))

    def tally(self) -> Tally:
        """How many rows there are to be, how many are there, and how many of those failed."""
        with contextlib.closing(open_results(self.path)) as db:
            return tally(db)

    def rows(self, columns: Sequence[str] | None = None, **where: Any) -> list[dict[str, Any]]:
        """Rows as dictionaries in the order of the study; failed ones too.

        columns : all by default. where : values that columns must have, such as machine="patch".
        """
        return list(self._rows(columns, where))

    def head(self, count: int, columns: Sequence[str] | None = None) -> list[dict[str, Any]]:
        """The first rows that there are; columns : all by default."""
        return list(islice(self._rows(columns, {}), count))

    def to_dict(self, columns: Sequence[str] | None = None, **where: Any) -> dict[str, list[Any]]:
        """Lists of values by column."""
        names = self._known(columns)
        rows = self.rows(names, **where)
        return {name: [row[name] for row in rows] for name in names}

    def to_dataframe(self) -> "pandas.DataFrame":
        """The table as a pandas DataFrame, with `meta` in its `attrs`. Raises TilerError where pandas is not installed."""
        from tiler.notebook import pandas_for

        pandas = pandas_for("to_dataframe", "rows() and to_dict()")
        frame = pandas.DataFrame(self.to_dict())
        frame.attrs = dict(self.meta)
        return frame

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV, and beside it a .json with what its columns mean and where the numbers come from."""
        from tiler.study.export import write_csv

        write_csv(self, Path(path))

    def to_parquet(self, path: str | Path) -> None:
        """Write the table as Parquet, with the same in its metadata. Raises TilerError where duckdb is not installed."""
        from tiler.study.export import write_parquet

        write_parquet(self, Path(path))

    def plot(
        self, x: str, y: str, by: str | Sequence[str] | None = None, *, file: str | Path | None = None, **where: Any
    ) -> "Axes":
        """Lines of the mean of column y over column x, one for each value of `by`, as matplotlib axes.

        file : picture to write, such as bounds.png. where : values that columns must have. Failed rows are left out.
        Raises TilerError for an unknown column, and where matplotlib is not installed.
        """
        from tiler.study.plots import plot

        return plot(self, x, y, by, Path(file) if file is not None else None, where)

    def _repr_html_(self) -> str:
        from tiler.notebook import study_html

        return study_html(self)

    def __len__(self) -> int:
        return self.tally().done

    def __repr__(self) -> str:
        rows, done, failed = self.tally()
        return f"<Study {self.name!r}, {done:,} of {rows:,} rows, {failed:,} failed>"

    def _rows(self, columns: Sequence[str] | None, where: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        names = self._known(columns)
        self._known(list(where))
        read = list(dict.fromkeys([*names, *where]))
        with contextlib.closing(open_results(self.path)) as db:
            for record in select(db, read):
                row = dict(zip(read, record, strict=True))
                if all(row[name] == value for name, value in where.items()):
                    yield {name: row[name] for name in names}

    def _known(self, columns: Sequence[str] | None) -> list[str]:
        for name in columns or ():
            if name not in self.columns:
                raise TilerError(f"column: {name!r} is unknown; {unknown_name(str(name), self.columns)}")
        return list(self.columns if columns is None else columns)


def load_study(path: str | Path) -> Study:
    """The study in a results file, finished or still running. Raises TilerError for any other file."""
    return Study(path)


def finished_rows(study: Study, columns: Sequence[str], where: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows that did not fail."""
    return study.rows(columns, **(dict(where) | {"status": DONE}))
