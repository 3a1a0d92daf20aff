"""On which line each key of a TOML text stands. The standard library's parser does not tell.

The text is known to be valid TOML (tomllib has read it), so this reader only has to follow along: it skips comments,
white space and values, and keeps the path that it is at.
"""

import re
from typing import Any

Path = tuple[str | int, ...]

_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_PART = re.compile(r"""[ \t]*(?:"((?:[^"\\\n]|\\.)*)"|'([^'\n]*)'|([A-Za-z0-9_-]+))[ \t]*""")
_STRING = re.compile(
    r""""{3}(?:[^\\]|\\.)*?"{3,5}|'{3}.*?'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*\'""",
    re.DOTALL,
)
_PLAIN = re.compile(r"[^,\]}#\r\n]*")


def toml_lines(text: str) -> dict[Path, int]:
    """Line number, from 1, of each key, table header and list entry of a valid TOML text, by path: ("object", 0, "map")."""
    return _Reader(text).read()


class _Reader:
    """A position in the text, and what was found so far."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[Path, int] = {}
        self.lengths: dict[Path, int] = {}  # of arrays of tables

    def read(self) -> dict[Path, int]:
        table: Path = ()
        while self._skip():
            if self.text.startswith("[[", self.at):
                table = self._header(2)
            elif self.text.startswith("[", self.at):
                table = self._header(1)
            else:
                self._key_and_value(table)
        return self.lines

    def _skip(self) -> bool:
        """Move past blanks and comments; whether anything is left."""
        self.at = _BLANK.match(self.text, self.at).end()  # type: ignore[union-attr]
        return self.at < len(self.text)

    def _note(self, path: Path) -> None:
        """Remember the line of `path`, and of the tables around it that were not seen before."""
        line = self.text.count("\n", 0, self.at) + 1
        for depth in range(1, len(path) + 1):
            self.lines.setdefault(path[:depth], line)

    def _header(self, brackets: int) -> Path:
        """`[a.b]` or `[[a.b]]`: the path of the table that it opens."""
        start = self.at
        self.at += brackets
        names = self._names()
        after = self.at + brackets
        path: Path = ()
        for name in names[:-1]:  # a name of an array of tables means its last table
            path += (name,)
            path += (self.lengths[path] - 1,) if path in self.lengths else ()
        path += (names[-1],)
        if brackets == 2:
            self.lengths[path] = self.lengths.get(path, 0) + 1
            path += (self.lengths[path] - 1,)
        self.at = start
        self._note(path)
        self.at = after
        return path

    def _names(self) -> list[str]:
        """The parts of a dotted key."""
        names = []
        while True:
            match: Any = _PART.match(self.text, self.at)
            names.append(next(group for group in match.groups() if group is not None))
            self.at = match.end()
            if not self.text.startswith(".", self.at):
                return names
            self.at += 1

    def _key_and_value(self, table: Path) -> None:
        start = self.at
        path = (*table, *self._names())
        after, self.at = self.at, start
        self._note(path)
        self.at = after + 1  # past "="
        self._value(path)

    def _value(self, path: Path) -> None:
        """Move past a value; entries of lists and keys of inline tables are noted."""
        self._skip()
        opening = self.text[self.at]
        if opening in "[{":
            self.at += 1
            entry = 0
            while self._skip() and self.text[self.at] not in "]}":
                if opening == "{":
                    self._key_and_value(path)
                else:
                    self._note((*path, entry))
                    self._value((*path, entry))
                entry += 1
                self._skip()
                self.at += self.text.startswith(",", self.at)
            self.at += 1
        else:
            pattern = _STRING if opening in "\"'" else _PLAIN
            self.at = pattern.match(self.text, self.at).end()  # type: ignore[union-attr]
