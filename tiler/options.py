"""Options that several commands share, and how their texts become values."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from tiler.config import Machine
from tiler.errors import TilerError
from tiler.scene import Scene, load_scene

Text = Annotated[str | None, Parameter(allow_leading_hyphen=True)]

TRUTH: dict[str, bool] = {"true": True, "false": False}


@Parameter(name="*")
@dataclass(frozen=True)
class SceneOptions:
    """What of the scene file to change."""

    size: Text = None
    "Width and height of the picture in pixels, such as 1920x1080."
    samples: int | None = None
    "Samples a pixel: 1 or 4."
    shading: Literal["lambert", "normal", "patch", "wireframe", "tile_grid"] | None = None
    "What the pixel shader shows."
    factor: Text = None
    "Tessellation factor, or six: edges u=0, v=0, u=1, v=1, then inside u, v."
    edge_pixels: float | None = None
    "Wished length of an edge's segments on the screen in pixels, instead of a fixed factor."
    partitioning: Literal["integer", "pow2", "fractional_odd", "fractional_even"] | None = None
    "How factors become segments."
    displacement: Text = None
    "Displacement map of a model file, with keys of a scene file's: height.png,channel=a,scale=0.5."


@Parameter(name="*")
@dataclass(frozen=True)
class MachineOptions:
    """What of the default machine, or of another one, to change."""

    machine_preset: Text = None
    "Start from a machine that `tiler machines` lists, such as mali-like."
    machine_file: Path | None = None
    "Start from a machine in a .toml file (`tiler machines NAME --toml` writes one to begin with)."
    tile: int | None = None
    "Side of a tile in pixels, a power of two from 8 to 512."
    binning: Literal["triangle", "patch", "subpatch"] | None = None
    "What the front end puts into the tiles' queues."
    subpatch_budget: int | None = None
    "Most sub-domains of a patch (subpatch binning)."
    subpatch_extent: float | None = None
    "Sub-domains wider or higher than so many pixels are split (subpatch binning)."
    overlap: Literal["rect", "exact"] | None = None
    "Whether an item is queued in all tiles of its rectangle, or only where its outline reaches."
    bounds: Text = None
    "Algorithm that bounds displaced patches."
    cull: Text = None
    "Cull tests, separated by commas; none for no test. Those named occlusion read coarse Z."
    z_feedback: Literal["none", "tile", "previous_frame", "two_phase"] | None = None
    "What the occlusion tests read."
    queue_order: Literal["submit", "front_to_back"] | None = None
    "Order in which a tile works off its queue."
    occlusion_area: Literal["rect", "hull"] | None = None
    "What of a patch or sub-domain is tested against coarse Z: its rectangle, or its hull cell by cell."
    coarse_z_block: int | None = None
    "Side in pixels of the coarse Z pyramid's finest blocks."
    coarse_z_update: Literal["recompute", "feed_forward"] | None = None
    "How a tile keeps its coarse Z up to date."
    domain_cache: Text = None
    "Whether every tile shades a patch again (none), each core keeps the last N (lru:N), or it is shaded once a frame (frame)."
    vertex_cache: int | None = None
    "Entries of the post-tessellation vertex cache (triangle binning); 0: every domain point is shaded once."
    tile_walk: Literal["scanline", "morton", "hilbert"] | None = None
    "Order in which the tiles are worked off."
    cores: int | None = None
    "Simulated cores that the tiles are dealt out to."
    queue_model: Text = None
    "How tile queues lie in memory: a name or a .toml file."
    queue_pool: int | None = None
    "Bytes that the queues may take."
    queue_policy: Literal["grow", "flush", "fail"] | None = None
    "What happens where the queues' memory is full."
    verify: bool | None = None
    "Check every bound and every cull against all patches, shaded, and the picture without culls."
    blame: bool | None = None
    "Say why each wasted domain-shader invocation was not avoided, and what perfect knowledge would have needed."


def open_scene(source: str, options: SceneOptions) -> Scene:
    """The scene with the options applied."""
    from tiler.scene.model_scene import read_displacement

    return load_scene(
        source,
        size=None if options.size is None else parse_size(options.size),
        samples=options.samples,
        shading=options.shading,
        factor=None if options.factor is None else parse_factor(options.factor),
        edge_pixels=options.edge_pixels,
        partitioning=options.partitioning,
        displacement=None if options.displacement is None else read_displacement(options.displacement),
    )


def make_machine(options: MachineOptions, **defaults: object) -> Machine:
    """The machine of `--machine-preset` or `--machine-file` with `defaults`, and with the options applied."""
    given = {name: value for name, value in vars(options).items() if value is not None}
    preset, file = given.pop("machine_preset", None), given.pop("machine_file", None)
    if "cull" in given:
        given["cull"] = parse_cull(given["cull"])
    return Machine(**(_base_fields(preset, file) | defaults | given))


def _base_fields(preset: str | None, file: Path | None) -> dict[str, object]:
    """Fields of a preset or of a machine's file; none of neither."""
    if preset is None and file is None:
        return {}
    from tiler.presets import load_machine_file, load_preset

    if preset is not None and file is not None:
        raise TilerError(f"machine-file: {file} stands beside preset {preset!r}; allowed: one of the two")
    return dict(load_preset(preset).fields if preset is not None else load_machine_file(Path(str(file))).fields)


def parse_machine(text: str, options: MachineOptions) -> Machine:
    """A machine from text such as `preset=mali-like,tile=16,cull=frustum`; tests of cull are joined by +."""
    fields: dict[str, object] = {}
    base: dict[str, str] = {}
    for part in text.split(","):
        key, found, value = part.strip().partition("=")
        if not found or not key or not value:
            raise TilerError(
                f"machine: {text!r} is not allowed; allowed: key=value pairs, such as binning=patch,tile=16"
            )
        if key in ("preset", "file"):
            base[key] = value
        elif key == "cull":
            fields[key] = parse_cull(value.replace("+", ","))
        else:
            fields[key] = _parse_value(value)
    own = _base_fields(base.get("preset"), Path(base["file"]) if "file" in base else None)
    return make_machine(replace(options, machine_preset=None, machine_file=None) if base else options, **(own | fields))


def _parse_value(text: str) -> object:
    if text.lstrip("-").isdigit():
        return int(text)
    try:
        return float(text)
    except ValueError:
        return TRUTH.get(text, text)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height from 1920x1080."""
    width, found, height = text.lower().partition("x")
    if not (found and width.lstrip("-").isdigit() and height.lstrip("-").isdigit()):
        raise TilerError(f"size: {text!r} is not allowed; allowed: WIDTHxHEIGHT in pixels, such as 1920x1080")
    return int(width), int(height)


def parse_factor(text: str) -> float | tuple[float, ...]:
    """One factor or six."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in (1, 6):
        raise TilerError(f"factor: {text!r} is not allowed; allowed: one number, or six separated by commas")
    return values[0] if len(values) == 1 else values


def parse_factors(text: str) -> list[float]:
    """Factors to measure at, from 8,16,32."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(1 <= value <= 64 for value in values):
        raise TilerError(f"factors: {text!r} is not allowed; allowed: numbers from 1 to 64, separated by commas")
    return values


def parse_cull(text: str) -> tuple[str, ...]:
    """Names of cull tests."""
    return () if text == "none" else tuple(part.strip() for part in text.split(","))


def parse_frames(text: str) -> list[int]:
    """Frame numbers from 0..47 or a list such as 0,12,24."""
    return parse_numbers(text, "frames")


def parse_numbers(text: str, what: str) -> list[int]:
    """Numbers from 0..47 or a list such as 0,12,24; `what` they are, in plural, for errors."""
    numbers: list[int] = []
    for part in text.split(","):
        first, found, last = part.strip().partition("..")
        if not (first.isdigit() and (not found or last.isdigit())):
            raise TilerError(f"{what}: {text!r} is not allowed; allowed: FIRST..LAST or numbers separated by commas")
        numbers.extend(range(int(first), int(last if found else first) + 1))
    if not numbers or len(set(numbers)) != len(numbers):
        raise TilerError(f"{what}: {text!r} names none, or one twice; allowed: FIRST..LAST with FIRST <= LAST")
    return numbers
