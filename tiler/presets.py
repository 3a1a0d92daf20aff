"""Whole machines as data: TOML files, shipped ones by name (`tiler/_data/machines`) and the user's own.

A file holds fields of `tiler.Machine` by their names, beside `title` and `source`, which are texts, and `extends`: a shipped
machine, or another file beside it, of which it differs. What no file sets is as in `tiler.Machine()`.
"""

import re
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from tiler.config import Machine
from tiler.data_files import FOLDER, model_names
from tiler.errors import TilerError, unknown_name
from tiler.scene.toml_lines import toml_lines

KIND = "machines"
TEXTS = ("title", "source", "extends")
DEEPEST = 16  # files that extend each other


class Preset(NamedTuple):
    """A machine of a file. fields : those that it and what it extends set."""

    name: str
    title: str
    source: str
    fields: dict[str, Any]

    def machine(self) -> Machine:
        """The machine."""
        return Machine(**self.fields)


def preset_names() -> tuple[str, ...]:
    """Names of the machines that are shipped."""
    return model_names(KIND)


def load_machine(source: str | Path, **fields: Any) -> Machine:
    """A shipped machine by name, or one of a file that ends in .toml; fields : what to change of it.

    Raises TilerError with file, line, key, value and what is allowed.
    """
    return Machine(**(load_preset(str(source)).fields | fields))


def load_preset(source: str) -> Preset:
    """A shipped machine by name, or one of a file that ends in .toml, checked. Raises TilerError."""
    if source.endswith(".toml"):
        return load_machine_file(Path(source))
    if source not in preset_names():
        raise TilerError(f"machine: {source!r} is unknown; {unknown_name(source, [*preset_names(), 'FILE.toml'])}")
    return _read(FOLDER / KIND / f"{source}.toml", ())


def load_machine_file(file: Path) -> Preset:
    """The machine of a file, checked. Raises TilerError."""
    return _read(file, ())


def machine_toml(machine: Machine, title: str = "", source: str = "") -> str:
    """A machine as a file that holds all of it."""
    lines = [f"{key} = {_toml(text)}" for key, text in (("title", title), ("source", source)) if text]
    for name, value in machine.model_dump(mode="json").items():
        lines.append(f"# {name}: not set" if value is None else f"{name} = {_toml(value)}")
    return "\n".join(lines) + "\n"


def _read(file: Path, outer: tuple[Path, ...]) -> Preset:
    try:
        text = file.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except OSError as error:
        raise TilerError(f"{file}: cannot be read ({error.strerror}); allowed: a .toml file of a machine") from None
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, nested too deeply
        raise TilerError(f"{file}: is not a TOML file: {error}") from None
    lines = toml_lines(text)
    texts = {key: data.pop(key) for key in TEXTS if key in data}
    for key, value in texts.items():
        if not isinstance(value, str) or not value:
            raise TilerError(f"{_at(file, key, lines)}: {value!r} is not allowed; allowed: a text")
    base: dict[str, Any] = {}
    if "extends" in texts:
        base = _extended(file, texts["extends"], (*outer, file.resolve()), lines)
    fields = base | {key: _value(file, key, value) for key, value in data.items()}
    try:
        Machine(**fields)
    except TilerError as error:
        told = [_place(file, line, lines, [*Machine.model_fields, *TEXTS]) for line in str(error).splitlines()]
        raise TilerError("\n".join(told)) from None
    return Preset(file.stem, texts.get("title", ""), texts.get("source", ""), fields)


def _extended(file: Path, name: str, outer: tuple[Path, ...], lines: dict[Any, int]) -> dict[str, Any]:
    where = _at(file, "extends", lines)
    other = file.parent / name if name.endswith(".toml") else FOLDER / KIND / f"{name}.toml"
    if not name.endswith(".toml") and name not in preset_names():
        raise TilerError(f"{where}: {name!r} is unknown; {unknown_name(name, [*preset_names(), 'FILE.toml'])}")
    if other.resolve() in outer:
        raise TilerError(f"{where}: {name!r} extends this file; allowed: a machine that does not")
    if len(outer) >= DEEPEST:
        raise TilerError(f"{where}: {name!r} is the {DEEPEST + 1}th file; allowed: at most {DEEPEST}")
    return _read(other, outer).fields


def _value(file: Path, key: str, value: Any) -> Any:
    """A value as `Machine` takes it: cull tests may also be one text; a queue model's file lies beside the machine's."""
    if key == "cull" and isinstance(value, str):
        return () if value == "none" else tuple(part.strip() for part in re.split(r"[+,]", value))
    if key == "queue_model" and isinstance(value, str) and value.endswith(".toml"):
        return str(file.parent / value)
    return value


def _place(file: Path, problem: str, lines: dict[Any, int], known: list[str]) -> str:
    """A problem of `Machine` with the file and line that it comes from."""
    key, _, rest = problem.removeprefix("machine.").partition(": ")
    if rest.startswith("unknown field"):
        rest = f"unknown key; {unknown_name(key, known)}"
    return f"{_at(file, key, lines)}: {rest}" if rest else f"{file}: {problem}"


def _at(file: Path, key: str, lines: dict[Any, int]) -> str:
    line = next((lines[path] for path in ((part,) for part in (key, key.split(".")[0])) if path in lines), 0)
    return f"{file}:{line}: {key}" if line else f"{file}: {key}"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(value)
