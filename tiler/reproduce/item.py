"""What an item of a paper is: plain data that its module makes, and that the frame checks, draws and writes."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Tolerance(NamedTuple):
    """What a measured value may be, stated before it is measured; every part that is given must hold.

    absolute, relative : how far from the published value, the larger of the two where both are given.
    at_most, at_least : ends of an interval, inclusive; they need no published value.
    """

    absolute: float | None = None
    relative: float | None = None
    at_most: float | None = None
    at_least: float | None = None


def within_factor(published: float, factor: float) -> Tolerance:
    """Between the published value divided by `factor` and that times it."""
    return Tolerance(at_least=published / factor, at_most=published * factor)


class Row(NamedTuple):
    """One line of published beside measured."""

    what: str  # "cbox", "bigguy, tcone: culled"
    published: float | None  # None where the paper gives no number
    measured: float
    unit: str
    tolerance: Tolerance | None  # None: there is nothing to compare with
    note: str = ""  # why it deviates, where it does


class Context(NamedTuple):
    """What an item is run with."""

    models: Path | None  # folder of the papers' models; without it, or without a model in it, scenes of ours stand in
    quick: bool  # fewer views, frames and factors
    threads: int | None
    seed: int
    update: Callable[[float], None]  # progress of this item, 0 to 1


class Result(NamedTuple):
    """What an item has found."""

    rows: tuple[Row, ...]
    table: dict[str, list[Any]]  # the numbers behind the figure, a long table: column -> values; None where missing
    units: dict[str, str]  # column -> unit and definition, for every column
    draw: Callable[["Figure"], None] | None  # draws `table` into an empty figure
    text: str  # Markdown: what ran in place of what, settings, why it deviates


class Item(NamedTuple):
    """A table or figure of a paper."""

    paper: str
    name: str  # "table-1", "figure-6"
    title: str
    run: Callable[[Context], Result]


def row_ok(row: Row) -> bool | None:
    """Whether a row is within its tolerance; None where it has none. A value that is not finite is not."""
    allowed, published = row.tolerance, row.published
    if allowed is None:
        return None
    if not math.isfinite(row.measured):
        return False
    if allowed.at_most is not None and not row.measured <= allowed.at_most:
        return False
    if allowed.at_least is not None and not row.measured >= allowed.at_least:
        return False
    if allowed.absolute is None and allowed.relative is None:
        return True
    if published is None:
        raise ValueError(f"{row.what}: has a tolerance around a published value, and none was published")
    return abs(row.measured - published) <= max(allowed.absolute or 0.0, (allowed.relative or 0.0) * abs(published))


def failures(rows: tuple[Row, ...]) -> int:
    """How many rows are beyond their tolerance."""
    return sum(row_ok(row) is False for row in rows)
