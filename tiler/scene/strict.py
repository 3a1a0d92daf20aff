"""The kinds of value that a scene file may hold. Each field says in words what it allows; error messages quote it."""

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field


class Strict(BaseModel):
    """A table of a scene file: unknown keys, strings for numbers, NaN and infinity are refused."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class Faults(ValueError):
    """Faults of a table as a whole, each told at one of its keys: (path below the table, problem)."""

    def __init__(self, *faults: tuple[tuple[str | int, ...], str]) -> None:
        super().__init__("; ".join(problem for _, problem in faults))
        self.faults = faults


class UnknownName(ValueError):
    """A name that is not in a table of ours."""

    def __init__(self, choices: Iterable[str]) -> None:
        super().__init__("unknown name")
        self.choices = list(choices)


class NotAllowed(ValueError):
    """A value that the field's description rules out."""

    def __init__(self) -> None:
        super().__init__("not allowed")


COORDINATE_LIMIT = 1e6


def whole(default: Any, least: int, most: int, what: str = "") -> Any:
    """A field for a whole number from `least` to `most`."""
    return Field(default, ge=least, le=most, description=f"a whole number from {least} to {most}{what}")


def number(default: Any, least: float, most: float, what: str = "") -> Any:
    """A field for a number from `least` to `most`."""
    return Field(default, ge=least, le=most, description=f"a number from {least:g} to {most:g}{what}")


def between(default: Any, above: float, most: float, what: str = "", *, below: bool = False) -> Any:
    """A field for a number above `above` and at most `most` (less than `most` where `below`)."""
    limit: dict[str, Any] = {"lt": most} if below else {"le": most}
    words = f"a number above {above:g} and {'below' if below else 'at most'} {most:g}{what}"
    return Field(default, gt=above, description=words, **limit)


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _not_null(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise NotAllowed
    return vector


Coordinate = Annotated[float, Field(ge=-COORDINATE_LIMIT, le=COORDINATE_LIMIT)]
Vector = Annotated[tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(_as_tuple)]
Direction = Annotated[Vector, AfterValidator(_not_null)]
Byte = Annotated[int, Field(ge=0, le=255)]
Rgb = Annotated[tuple[Byte, Byte, Byte], BeforeValidator(_as_tuple)]

VECTOR_WORDS = f"three numbers [x, y, z], each from {-COORDINATE_LIMIT:g} to {COORDINATE_LIMIT:g}"
