"""What is wrong with a scene file, in one message: file, line, key, value, what is allowed, and a guess at what was meant."""

import difflib
import typing
from collections.abc import Iterable
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from tiler.errors import TilerError
from tiler.scene.strict import Faults, NotAllowed, UnknownName

Path = tuple[str | int, ...]  # keys and list positions from the top of the file


class Problem(NamedTuple):
    """One fault: where, and what."""

    path: Path
    text: str


def problems_of(error: ValidationError, model: type[BaseModel], below: Path = ()) -> list[Problem]:
    """The faults that pydantic found in a table read as `model`; `below` is the table's own path."""
    found = []
    for detail in error.errors(include_url=False):
        for path, text in _explain(detail, model):
            found.append(Problem(below + path, text))
    return list(dict.fromkeys(found))


def error_of(file: str, problems: Iterable[Problem], lines: dict[Path, int]) -> TilerError:
    """One error for all problems, in the order of the file's lines. lines : line number of each path, see `toml_lines`."""
    placed = sorted(((_line_of(problem.path, lines), problem) for problem in problems), key=lambda item: item[0])
    return TilerError("\n".join(f"{file}:{line}: {_told(p)}" if line else f"{file}: {_told(p)}" for line, p in placed))


def key_text(path: Path) -> str:
    """A path as people write it: camera.key[2].eye."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """`; did you mean 'x'?` for the closest of the choices, or nothing where none is close."""
    close = difflib.get_close_matches(name.lower(), list(choices), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


def shown(value: Any) -> str:
    """A value as a scene file writes it, cut short where it is long."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, str):
        text = '"' + value + '"'
    elif isinstance(value, dict):
        text = "a table"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(shown(item) for item in value[:9]) + "]"
    elif isinstance(value, int) and abs(value) > 10**15:
        text = "a very large whole number"  # its decimal digits may be more than Python agrees to print
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _told(problem: Problem) -> str:
    return f"{key_text(problem.path)}: {problem.text}" if problem.path else problem.text


def _line_of(path: Path, lines: dict[Path, int]) -> int:
    """Line of the key, else of the nearest table around it; 0 where the file does not have even that."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 0)


def _explain(detail: ErrorDetails, model: type[BaseModel]) -> list[tuple[Path, str]]:
    """Our words for one of pydantic's errors."""
    path, kind, value = tuple(detail["loc"]), detail["type"], detail["input"]
    cause = detail.get("ctx", {}).get("error")
    if isinstance(cause, Faults):
        return [(path + key, text) for key, text in cause.faults]
    if kind == "extra_forbidden":
        known = list(_model_at(model, path[:-1]).model_fields)
        allowed = f"; allowed: {', '.join(known)}" if known else "; allowed: no key"
        return [(path, "unknown key" + (did_you_mean(str(path[-1]), known) or allowed))]
    if kind == "missing" and isinstance(path[-1], int):  # a list that is too short: the fault is the list's
        path, value = path[:-1], None
    elif kind == "missing":
        return [(path, f"is missing; needed: {_allowed(model, path)}")]
    if isinstance(cause, UnknownName):
        return [(path, _unknown(value, cause.choices))]
    choices = _choices(model, path)
    if choices is not None:
        return [(path, _unknown(value, choices))]
    if isinstance(cause, NotAllowed) or cause is None:
        what = "has too few entries" if value is None else f"{shown(value)} is not allowed"
        return [(path, f"{what}; allowed: {_allowed(model, path)}")]
    return [(path, str(cause))]


def _unknown(value: Any, choices: list[Any]) -> str:
    names = ", ".join(str(choice) for choice in choices)
    hint = did_you_mean(value, [c for c in choices if isinstance(c, str)]) if isinstance(value, str) else ""
    return f"{shown(value)} is not allowed; allowed: {names}{hint}"


def _allowed(model: type[BaseModel], path: Path) -> str:
    """What the field at (or around) `path` allows, in words."""
    names = _field_path(path)
    field = _model_at(model, names[:-1]).model_fields[str(names[-1])]
    if field.description:
        return field.description
    return {bool: "true or false", str: "a text"}.get(field.annotation, "another value")  # type: ignore[arg-type]


def _choices(model: type[BaseModel], path: Path) -> list[Any] | None:
    """The values of a field that is one of a few literals; None for other fields."""
    names = _field_path(path)
    if not names:
        return None
    annotation = _model_at(model, names[:-1]).model_fields[str(names[-1])].annotation
    return list(typing.get_args(annotation)) if typing.get_origin(annotation) is typing.Literal else None


def _field_path(path: Path) -> Path:
    """The path without positions in a list at its end."""
    while path and isinstance(path[-1], int):
        path = path[:-1]
    return path


def _model_at(model: type[BaseModel], path: Path) -> type[BaseModel]:
    """The class that describes the table at `path`."""
    for part in path:
        if isinstance(part, str):
            model = _model_inside(model.model_fields[part].annotation) or model
    return model


def _model_inside(annotation: Any) -> type[BaseModel] | None:
    """The table class in an annotation such as `list[KeyFile]` or `DisplacementFile | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_inside, typing.get_args(annotation))), None)
