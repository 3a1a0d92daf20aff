"""The modelled machine: everything an architect may turn. Frozen and hashable, checked when it is made."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator, model_validator

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.errors import TilerError, unknown_name
from tiler.extensions import load_plugins
from tiler.queue_models import MOST_BYTES, Policy, load_queue_model, queue_model_names

TILE_SIZES = (8, 16, 32, 64, 128, 256, 512)
BLOCK_SIZES = (4, 8, 16, 32, 64)
# Tests against the coarse Z pyramid, by name in `Machine.cull`; they run in the tile loop, not in the hull stage.
OCCLUSION_TESTS = ("occlusion", "occlusion:triangle", "occlusion:block")
MOST_UNITS = 1 << 20  # of a domain cache


class Machine(BaseModel):
    """A tile-based sort-middle machine.

    tile : side of a tile in pixels, a power of two; 32, or what the named queue model's machine has.
    binning : `triangle` (the front end shades all patches and bins triangles), `patch` (it bins patches by their bounds;
        each tile tessellates and shades for itself) or `subpatch` (patches are cut into parametric sub-domains that are
        bounded, culled and binned by themselves).
    subpatch_budget, subpatch_extent : `subpatch` binning: most sub-domains of a patch; a sub-domain is split while its
        rectangle is wider or higher than so many pixels and touches more than one tile.
    overlap : `rect` (an item goes to the tiles that its pixel box touches) or `exact` (to those of them that its triangle
        or the projected hull of its bound touches).
    bounds : algorithm that bounds a displaced patch, a name of `pipeline.bounds.BOUNDS`.
    cull : cull tests in order; () for none. Names of `pipeline.culling.CULL_TESTS` run in the hull stage. `occlusion` tests
        queue entries against coarse Z, `occlusion:triangle` the triangles of patches and sub-domains, `occlusion:block` each
        block that a triangle's box touches.
    z_feedback : what the occlusion tests read: `tile` (the tile's own pyramid, kept up to date while its queue is worked
        off), `previous_frame` or `two_phase` (docs/coarse-z.md), `none` (no such test is made).
    queue_order : `submit`, or `front_to_back` by the nearest depth of the bound.
    occlusion_area : what test `occlusion` asks about of a patch or a sub-domain: its `rect`, with one nearest depth in it,
        or its `hull` on the screen, with a nearest depth for each cell of the pyramid (docs/coarse-z.md).
    coarse_z_block : side in pixels of the pyramid's finest blocks, a power of two, at most a tile.
    coarse_z_update : with feedback `tile`: `recompute` touched blocks after each queue entry, or `feed_forward`: lower a
        block's farthest depth when one triangle covers all of it.
    domain_cache : `patch` and `subpatch` binning; `none`: every tile shades a patch again; `lru:N`: each core keeps the last N
        shaded patches or sub-domains; `frame`: once a frame.
    vertex_cache : `triangle` binning: entries of a post-tessellation vertex cache, first in first out, in index order, that
        is emptied for each patch; 0: every domain point is shaded once.
    tile_walk : order in which tiles are worked off: `scanline`, `morton` or `hilbert`.
    cores : simulated cores; the tile of place r in the walk is worked off by core r modulo cores.
    queue_model : how tile queues lie in memory, a name of `tiler.queue_models.queue_model_names()` or a .toml file.
    queue_pool : bytes that queues may take; None: the model's own limit, if it has one.
    queue_policy : what happens where the pool is full. `grow`: it is doubled; `flush`: all tiles work off what is queued, and
        the queues start empty again; `fail`: TilerError. None: the model's own.
    verify : check each bound and each cull against all patches, shaded, and the picture without culls (`Frame.violations`);
        the machine draws and counts the same.
    blame : say what perfect knowledge would have needed, and why each other domain-shader invocation was not avoided
        (`Frame.blame`, tiler/blame.py); the machine draws and counts the same.

    Raises TilerError for an unknown field, name or value.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    tile: int = 32
    binning: Literal["triangle", "patch", "subpatch"] = "patch"
    subpatch_budget: int = 16
    subpatch_extent: float = 32.0
    overlap: Literal["rect", "exact"] = "rect"
    bounds: str = "cbox"
    cull: tuple[str, ...] = ("frustum",)
    z_feedback: Literal["none", "tile", "previous_frame", "two_phase"] = "tile"
    queue_order: Literal["submit", "front_to_back"] = "submit"
    occlusion_area: Literal["rect", "hull"] = "rect"
    coarse_z_block: int = 8
    coarse_z_update: Literal["recompute", "feed_forward"] = "recompute"
    domain_cache: str = "none"
    vertex_cache: int = 0
    tile_walk: Literal["scanline", "morton", "hilbert"] = "scanline"
    cores: int = 4
    queue_model: str = "ideal"
    queue_pool: int | None = None
    queue_policy: Policy | None = None
    verify: bool = False
    blame: bool = False

    @property
    def hull_cull(self) -> tuple[str, ...]:
        """The cull tests of the hull stage."""
        return tuple(name for name in self.cull if name in CULL_TESTS)

    @property
    def occlusion(self) -> tuple[str, ...]:
        """The tests against coarse Z that are made."""
        return () if self.z_feedback == "none" else tuple(name for name in self.cull if name in OCCLUSION_TESTS)

    @property
    def phased(self) -> bool:
        """Whether the frame is drawn in two phases, with a pyramid of the whole picture between them."""
        return bool(self.occlusion) and self.z_feedback in ("previous_frame", "two_phase")

    @property
    def reordered(self) -> bool:
        """Whether triangles may be drawn out of submit order, so that the depth test must know their numbers."""
        return self.queue_order != "submit" or self.binning == "subpatch" or self.phased

    @property
    def cached_units(self) -> int:
        """Patches or sub-domains that a core's domain cache holds; 0 unless `domain_cache` is lru:N."""
        return int(self.domain_cache[4:]) if self.domain_cache.startswith("lru:") else 0

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

    @field_validator("coarse_z_block")
    @classmethod
    def _block(cls, value: int) -> int:
        if value not in BLOCK_SIZES:
            raise ValueError(f"allowed: a power of two, {', '.join(map(str, BLOCK_SIZES))}")
        return value

    @field_validator("vertex_cache")
    @classmethod
    def _vertex_cache(cls, value: int) -> int:
        if not 0 <= value <= 4096:
            raise ValueError("allowed: 0 to 4096")
        return value

    @field_validator("subpatch_budget")
    @classmethod
    def _budget(cls, value: int) -> int:
        if not 1 <= value <= 4096:
            raise ValueError("allowed: 1 to 4096")
        return value

    @field_validator("subpatch_extent")
    @classmethod
    def _extent(cls, value: float) -> float:
        if not 1.0 <= value <= 65536.0:
            raise ValueError("allowed: 1 to 65536")
        return value

    @field_validator("domain_cache")
    @classmethod
    def _domain_cache(cls, value: str) -> str:
        units = value[4:]
        fits = value.startswith("lru:") and units.isascii() and units.isdigit() and len(units) < 9
        if value not in ("none", "frame") and not (fits and 1 <= int(units) <= MOST_UNITS):
            raise ValueError(f"allowed: 'none', 'frame' or 'lru:N', N from 1 to {MOST_UNITS}")
        return value

    @field_validator("bounds")
    @classmethod
    def _bounds(cls, value: str) -> str:
        if value not in BOUNDS:
            load_plugins()
        if value not in BOUNDS:
            raise ValueError(unknown_name(value, BOUNDS))
        return value

    @field_validator("cull")
    @classmethod
    def _cull(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if not all(name in CULL_TESTS or name in OCCLUSION_TESTS for name in value):
            load_plugins()
        for name in value:
            if name not in CULL_TESTS and name not in OCCLUSION_TESTS:
                raise ValueError(unknown_name(name, [*CULL_TESTS, *OCCLUSION_TESTS]))
        if len(set(value)) != len(value):
            raise ValueError("a test is named twice; allowed: each at most once")
        return value

    @model_validator(mode="after")
    def _together(self) -> "Machine":
        if self.coarse_z_block > self.tile:
            raise ValueError(f"coarse_z_block: {self.coarse_z_block}; allowed: at most the side of a tile, {self.tile}")
        if self.binning == "triangle" and self.queue_order != "submit":
            raise ValueError("queue_order: 'front_to_back'; allowed with binning='triangle': 'submit'")
        if self.binning == "triangle" and self.phased:
            raise ValueError(
                f"z_feedback: {self.z_feedback!r}; allowed with binning='triangle' and occlusion tests: 'tile', 'none'"
            )
        return self


def _problem(error: Any) -> str:
    """One line for one pydantic error: field, value, what is allowed."""
    field = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return f"machine.{field}: unknown field; {unknown_name(field, Machine.model_fields)}"
    if error["type"] == "literal_error":
        return f"machine.{field}: {error['input']!r} is not allowed; allowed: {error['ctx']['expected']}"
    if error["type"] == "value_error" and not field:
        return f"machine.{error['ctx']['error']}"
    if error["type"] == "value_error":
        return f"machine.{field}: {error['input']!r}; {error['ctx']['error']}"
    return f"machine.{field}: {error['input']!r} is not allowed; {error['msg']}"
