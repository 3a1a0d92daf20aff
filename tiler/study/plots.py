"""A plot by one line: means of one column over another, a line for each value of a third."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.errors import TilerError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tiler.study.results import Study


def plot(
    study: "Study", x: str, y: str, by: str | Sequence[str] | None, file: Path | None, where: Mapping[str, Any]
) -> "Axes":
    """See `Study.plot`."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise TilerError("plot: matplotlib is not installed; allowed: after `pip install 'tilesim[plot]'`") from None
    lines = series(study, x, y, by, where)
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    axes: Axes = figure.subplots()
    for label, (places, values) in lines.items():
        axes.plot(places, values, marker="o", markersize=4, label=label)
    axes.set_xlabel(_label(study, x))
    axes.set_ylabel(_label(study, y))
    axes.set_title(study.name)
    axes.grid(alpha=0.3)
    if by is not None:
        axes.legend(title=by if isinstance(by, str) else ", ".join(by))
    if file is not None:
        try:
            figure.savefig(file, dpi=150)
        except (OSError, ValueError) as error:
            raise TilerError(f"file: cannot write {file} ({error})") from None
    return axes


def series(
    study: "Study", x: str, y: str, by: str | Sequence[str] | None, where: Mapping[str, Any]
) -> dict[str, tuple[list[Any], list[float]]]:
    """Values of x, in rising order where they are numbers, and the mean of y over all other axes, for each value of `by`."""
    from tiler.study.results import finished_rows

    groups = [] if by is None else [by] if isinstance(by, str) else list(by)
    found: dict[str, dict[Any, list[float]]] = {}
    for row in finished_rows(study, [x, y, *groups], where):
        value = row[y]
        if isinstance(value, str):
            raise TilerError(f"y: {y!r} is not a column of numbers; allowed: a counter, or seconds")
        if value is not None and row[x] is not None:
            label = ", ".join(str(row[name]) for name in groups)
            found.setdefault(label, {}).setdefault(row[x], []).append(value)
    if not found:
        raise TilerError(f"plot: no finished row has {x!r} and {y!r} under these conditions")
    lines = {}
    for label, by_x in found.items():
        numeric = all(isinstance(place, int | float) for place in by_x)
        places = sorted(by_x) if numeric else list(by_x)
        lines[label] = (places, [math.fsum(by_x[place]) / len(by_x[place]) for place in places])
    return lines


def _label(study: "Study", column: str) -> str:
    unit = study.columns[column].unit
    return f"{column} ({unit})" if unit and column != unit else column
