"""The modelled machine: everything an architect may turn. Frozen and hashable, checked when it is made."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.errors import TilerError, unknown_name
from tiler.queue_models import MOST_BYTES, Policy, load_queue_model, queue_model_names

TILE_SIZES = (8, 16, 32, 64, 128, 256, 512)


class Machine(BaseModel):
    """A tile-based sort-middle machine.

    tile : side of a tile in pixels, a power of two; 32, or what the named queue model's machine has.
    binning : `triangle` (the front end shades all patches and bins triangles) or `patch` (it bins patches by their bounds;
        each tile tessellates and shades for itself).
    bounds : algorithm that bounds a displaced patch, a name of `pipeline.bounds.BOUNDS`.
    cull : cull tests on whole patches, in order, names of `pipeline.culling.CULL_TESTS`; () for none.
    domain_cache : `patch` binning only; `none`: every tile shades a patch again; `frame`: once a frame.
    cores : simulated cores; tile t is worked off by core t modulo cores, tiles in scanline order.
    queue_model : how tile queues lie in memory, a name of `tiler.queue_models.queue_model_names()` or a .toml file.
    queue_pool : bytes that queues may take; None: the model's own limit, if it has one.
    queue_policy : what happens where the pool is full. `grow`: it is doubled; `flush`: all tiles work off what is queued, and
        the queues start empty again; `fail`: TilerError. None: the model's own.
    verify : check each bound and each cull against all patches, shaded, and the picture without culls (`Frame.violations`);
        the machine draws and counts the same.

    Raises TilerError for an unknown field, name or value.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    tile: int = 32
    binning: Literal["triangle", "patch"] = "patch"
    bounds: str = "cbox"
    cull: tuple[str, ...] = ("frustum",)
    domain_cache: Literal["none", "frame"] = "none"
    cores: int = 4
    queue_model: str = "ideal"
    queue_pool: int | None = None
    queue_policy: Policy | None = None
    verify: bool = False

    def __init__(self, **fields: Any) -> None:
        if isinstance(fields.get("cull"), list):
            fields["cull"] = tuple(fields["cull"])
        if "tile" not in fields and fields.get("queue_model") in queue_model_names():
            fields["tile"] = load_queue_model(fields["queue_model"]).tile
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise TilerError("\n".join(_problem(e) for e in error.errors())) from None

    @field_validator("tile")
    @classmethod
    def _tile(cls, value: int) -> int:
        if value not in TILE_SIZES:
            raise ValueError(f"allowed: a power of two, {', '.join(map(str, TILE_SIZES))}")
        return value

    @field_validator("cores")
    @classmethod
    def _cores(cls, value: int) -> int:
        if not 1 <= value <= 65536:
            raise ValueError("allowed: 1 to 65536")
        return value

    @field_validator("queue_model")
    @classmethod
    def _queue_model(cls, value: str) -> str:
        if not value.endswith(".toml") and value not in queue_model_names():
            raise ValueError(unknown_name(value, [*queue_model_names(), "FILE.toml"]))
        load_queue_model(value)
        return value

    @field_validator("queue_pool")
    @classmethod
    def _queue_pool(cls, value: int | None) -> int | None:
        if value is not None and not 1 <= value <= MOST_BYTES:
            raise ValueError(f"allowed: 1 to {MOST_BYTES} bytes, or None for the model's own limit")
        return value

    @field_validator("bounds")
    @classmethod
    def _bounds(cls, value: str) -> str:
        if value not in BOUNDS:
            raise ValueError(unknown_name(value, BOUNDS))
        return value

    @field_validator("cull")
    @classmethod
    def _cull(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            if name not in CULL_TESTS:
                raise ValueError(unknown_name(name, CULL_TESTS))
        if len(set(value)) != len(value):
            raise ValueError("a test is named twice; allowed: each at most once")
        return value


def _problem(error: Any) -> str:
    """One line for one pydantic error: field, value, what is allowed."""
    field = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return f"machine.{field}: unknown field; {unknown_name(field, Machine.model_fields)}"
    if error["type"] == "literal_error":
        return f"machine.{field}: {error['input']!r} is not allowed; allowed: {error['ctx']['expected']}"
    if error["type"] == "value_error":
        return f"machine.{field}: {error['input']!r}; {error['ctx']['error']}"
    return f"machine.{field}: {error['input']!r} is not allowed; {error['msg']}"
