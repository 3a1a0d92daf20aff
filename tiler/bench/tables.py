"""Tables as aligned text, and as Markdown."""

from collections.abc import Sequence
from typing import NamedTuple


class Table(NamedTuple):
    """Text cells, a row of them under a head; the first `words` columns are words and stand on the left."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    note: str = ""


def aligned(table: Table) -> str:
    """The table as text with columns one below the other."""
    lines = [list(table.head), *map(list, table.rows)]
    widths = [max(len(line[c]) for line in lines) for c in range(len(table.head))]
    pad = [str.ljust if c < table.words else str.rjust for c in range(len(table.head))]
    text = ["  ".join(p(cell, w) for p, cell, w in zip(pad, line, widths, strict=True)) for line in lines]
    return "\n".join([table.title, *(line.rstrip() for line in text), *([table.note] if table.note else [])])


def markdown(table: Table) -> str:
    """The table as Markdown, under its title."""
    rule = ["---" if c < table.words else "---:" for c in range(len(table.head))]
    lines = ["| " + " | ".join(line) + " |" for line in (table.head, rule, *table.rows)]
    return "\n".join([f"## {table.title}", "", *([table.note, ""] if table.note else []), *lines, ""])
