"""Models that are data: TOML files in `tiler/_data`, one folder a kind, each file read and checked against a schema."""

import tomllib
from functools import cache
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from tiler.errors import TilerError, unknown_name
from tiler.scene import problems
from tiler.scene.toml_lines import toml_lines

FOLDER = Path(__file__).resolve().parent / "_data"

Schema = TypeVar("Schema", bound=BaseModel)


@cache
def model_names(kind: str) -> tuple[str, ...]:
    """Names of the models of a kind (a folder of `tiler/_data`), sorted."""
    return tuple(sorted(file.stem for file in (FOLDER / kind).glob("*.toml")))


def load_model(kind: str, source: str, schema: type[Schema], field: str) -> Schema:
    """A shipped model by name, or the file that a text ending in .toml names. Raises TilerError; `field` is who asks."""
    if source.endswith(".toml"):
        return read_model(Path(source), schema)
    if source not in model_names(kind):
        raise TilerError(f"{field}: {source!r} is unknown; {unknown_name(source, [*model_names(kind), 'FILE.toml'])}")
    return _shipped(FOLDER / kind / f"{source}.toml", schema)


@cache
def _shipped(file: Path, schema: type[Schema]) -> Schema:
    return read_model(file, schema)


def read_model(file: Path, schema: type[Schema]) -> Schema:
    """Read and check a file. Raises TilerError with file, line, key, value and what is allowed."""
    try:
        text = file.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except OSError as error:
        raise TilerError(f"{file}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, nested too deeply
        raise TilerError(f"{file}: is not a TOML file: {error}") from None
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise problems.error_of(str(file), problems.problems_of(error, schema), toml_lines(text)) from None
