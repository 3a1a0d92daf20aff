"""An item's page and a paper's index as Markdown: published beside measured, the deviation, the tolerance, a verdict."""

from collections.abc import Sequence
from typing import Any

from tiler.reproduce.item import Row, Tolerance, row_ok

HEAD = ("", "published", "measured", "unit", "deviation", "allowed", "verdict", "")
VERDICTS = {True: "holds", False: "**fails**", None: ""}


def say_number(value: float | None) -> str:
    """Three to four digits, none where there is no value."""
    if value is None:
        return ""
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.4g}" if abs(value) >= 100 else f"{value:.3g}"


def say_tolerance(allowed: Tolerance | None) -> str:
    """A tolerance in words."""
    if allowed is None:
        return ""
    parts = []
    if allowed.relative is not None:
        parts.append(f"±{100 * allowed.relative:.4g} %")
    if allowed.absolute is not None:
        parts.append(f"±{say_number(allowed.absolute)}")
    around = " or ".join(parts)
    ends = []
    if allowed.at_least is not None:
        ends.append(f"at least {say_number(allowed.at_least)}")
    if allowed.at_most is not None:
        ends.append(f"at most {say_number(allowed.at_most)}")
    return ", ".join([around, *ends] if around else ends)


def say_deviation(row: Row) -> str:
    """Measured relative to published; the difference where the published value is 0."""
    if row.published is None:
        return ""
    if row.published == 0:
        return f"{row.measured:+.3g}"
    return f"{100 * (row.measured / row.published - 1):+.1f} %"


def table_of(heads: Sequence[str], lines: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table in Markdown; the columns `numbers` are set to the right."""
    rule = ["---:" if k in numbers else "---" for k in range(len(heads))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [heads, rule, *lines])


def _cells(row: Row) -> list[str]:
    measured = say_number(row.measured)
    return [
        row.what, say_number(row.published), measured, row.unit, say_deviation(row), say_tolerance(row.tolerance),
        VERDICTS[row_ok(row)], row.note,
    ]  # fmt: skip


def rows_table(rows: Sequence[Row]) -> str:
    """Published beside measured; without the columns that are empty."""
    return _table([_cells(row) for row in rows], HEAD, (1, 2, 4))


def items_table(items: Sequence[tuple[str, str, Sequence[Row]]]) -> str:
    """The same for several items: (name, where its page is or "", rows)."""
    lines = []
    for name, link, rows in items:
        for k, row in enumerate(rows):
            title = f"[{name}]({link})" if link else name
            lines.append([title if k == 0 else "", *_cells(row)])
    return _table(lines, ("item", *HEAD), (2, 3, 5))


def digest(items: Sequence[tuple[dict[str, Any], Sequence[Row]]]) -> str:
    """What a page of several papers shows: rows with a published value and rows that fail; the others as one line an item."""
    lines = []
    for record, rows in items:
        shown = [row for row in rows if row.published is not None or row_ok(row) is False]
        rest = [row for row in rows if row not in shown and row_ok(row)]
        title = record["item"]
        for row in shown:
            lines.append([title, *_cells(row)])
            title = ""
        if rest:
            checks = f"{'other ' if shown else ''}check{'' if len(rest) == 1 else 's'}"
            more = f"{len(rest)} {checks} of what has no printed value"
            lines.append([title, more, *[""] * 5, VERDICTS[True], ""])
        elif not shown:
            lines.append([title, record["title"], *[""] * 7])
    return _table(lines, ("item", *HEAD), (2, 3, 5))


def _table(lines: list[list[str]], heads: Sequence[str], numbers: Sequence[int]) -> str:
    kept = [k for k in range(len(heads)) if heads[k] in ("item", "measured") or any(line[k] for line in lines)]
    cells = [[line[k] for k in kept] for line in lines]
    return table_of([heads[k] for k in kept], cells, [kept.index(k) for k in numbers if k in kept])


def verdict(rows: Sequence[Row]) -> str:
    """How many of the rows that have a tolerance hold."""
    said = [ok for ok in map(row_ok, rows) if ok is not None]
    if not said:
        return "nothing to compare with"
    return f"{sum(said)} of {len(said)} hold" if not all(said) else f"all {len(said)} hold"


def item_page(record: dict[str, Any], rows: Sequence[Row]) -> str:
    """The page of an item. record : what `run` keeps of it."""
    name = record["item"]
    parts = [f"# {record['paper']}, {name}: {record['title']}", record["text"].strip(), rows_table(rows)]
    parts.append(f"Verdict: {verdict(rows)}.")
    if f"{name}.png" in record["files"]:
        parts.append(f"![{record['title']}]({name}.png)\n\n[as SVG]({name}.svg)")
    columns = [[f"`{column}`", unit] for column, unit in record["units"].items()]
    data = " and ".join(f"[{file}]({file})" for file in record["files"] if file.endswith((".csv", ".parquet")))
    parts.append(f"## Numbers\n\n{data}:\n\n" + table_of(["column", "what"], columns))
    made = {"command": f"`{record['command']}`", "seconds": f"{record['seconds']:.1f}"} | record["provenance"]
    parts.append("## Made by\n\n" + table_of(["", ""], [[key, str(value)] for key, value in made.items() if value]))
    return "\n\n".join(parts) + "\n"


def paper_page(title: str, items: Sequence[tuple[dict[str, Any], Sequence[Row]]]) -> str:
    """The index of a paper: all rows of its items, and their figures."""
    lines = [
        [f"[{record['item']}]({record['item']}.md)", record["title"], verdict(rows), f"{record['seconds']:.1f}"]
        for record, rows in items
    ]
    parts = [f"# {title}", table_of(["item", "", "verdict", "seconds"], lines, [3])]
    parts.append(items_table([(record["item"], f"{record['item']}.md", rows) for record, rows in items]))
    for record, _ in items:
        if f"{record['item']}.png" in record["files"]:
            parts.append(f"![{record['title']}]({record['item']}.png)\n\n*{record['item']}: {record['title']}*")
    return "\n\n".join(parts) + "\n"
