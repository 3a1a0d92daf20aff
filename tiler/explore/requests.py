"""What the page may ask for, and what that means: a scene, a machine and a frame of the scene that the explorer was given.

A request holds the whole state of the page, so the server keeps none: a page that is loaded again asks for the same.
"""

import math
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.bounds import BOUNDS
from tiler.config import Machine
from tiler.errors import TilerError, unknown_name
from tiler.memory import check_picture
from tiler.queue_models import queue_model_names
from tiler.report.maps import MAPS
from tiler.scene.camera import Vector, camera_at, eye_and_target
from tiler.scene.model import CameraKey, CameraPath, Scene, Shading
from tiler.scene.overrides import override_picture, override_tessellation
from tiler.scene.schema import PictureFile, TessellationFile

DRAFT_PIXELS = 320 * 180
MOST_BYTES = 1 << 16  # of a request

Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Part = Annotated[float, Field(ge=0, le=1)]
Plain = bool | int | float | str | None


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class CameraAsk(_Strict):
    """Where the camera stands, world space, instead of the scene's path."""

    eye: Point
    target: Point


class SceneAsk(_Strict):
    """What of the scene to change; None: as it is."""

    factor: Annotated[float, Field(ge=1, le=64)] | None = None
    samples: Literal[1, 4] | None = None
    shading: Shading | None = None


class Ask(_Strict):
    """A request.

    page : name of the page that asks; a newer request of the same page replaces it. full : the picture's whole size, else a
    draft. machine : fields of a Machine that differ from the explorer's. map : a map over the picture, as in reports.
    point : a place in the picture, 0..1 from the left and the top, whose tile is looked into. patches : whose boxes are
    drawn, by `bounds` beside the machine's own.
    """

    page: Annotated[str, Field(pattern=r"^[0-9a-z]{1,32}$")]
    full: bool = True
    frame: Annotated[float, Field(ge=0, le=1e6)] = 0
    camera: CameraAsk | None = None
    scene: SceneAsk = SceneAsk()
    machine: dict[str, Plain | list[str]] = {}
    map: str = ""
    point: tuple[Part, Part] | None = None
    patches: Annotated[list[int], Field(max_length=16)] = []
    bounds: Annotated[list[str], Field(max_length=16)] = []


@dataclass(frozen=True)
class Plan:
    """A request that can be drawn."""

    ask: Ask
    scene: Scene
    machine: Machine

    @property
    def key(self) -> str:
        """Equal for requests of the same frame, whatever is looked at in it."""
        drawn = self.ask.model_dump(include={"full", "frame", "camera", "scene"})
        return f"{drawn} {self.machine!r}"


def read_ask(body: bytes) -> Ask:
    """The request of a JSON text. Raises TilerError with all that is wrong with it."""
    try:
        return Ask.model_validate_json(body)
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc'])) or 'request'}: {e['msg']}" for e in error.errors(include_input=False)]
        raise TilerError("\n".join(lines[:8])) from None


def plan(ask: Ask, scene: Scene, machine: Machine, threads: int) -> Plan:
    """What a request means. scene, machine : those that the explorer was started with. Raises TilerError."""
    if ask.map and ask.map not in MAPS:
        raise TilerError(f"map: {ask.map!r} is unknown; {unknown_name(ask.map, MAPS)}")
    for name in ask.bounds:
        if name not in BOUNDS:
            raise TilerError(f"bounds: {name!r} is unknown; {unknown_name(name, BOUNDS)}")
    for patch in ask.patches:
        if not 0 <= patch < scene.num_patches:
            raise TilerError(f"patches: {patch} is not allowed; allowed: 0 to {scene.num_patches - 1}")
    machine = make_machine(ask, machine)
    scene = change_scene(scene, ask)
    check_picture(scene.picture, machine, threads)
    camera_at(scene.camera, ask.frame, scene.picture.width / scene.picture.height)
    return Plan(ask, scene, machine)


def make_machine(ask: Ask, base: Machine) -> Machine:
    """The machine asked for; a draft is neither verified nor blamed. Files of queue models are read only where the explorer was
    started with them."""
    fields: dict[str, Any] = dict(base) | dict(ask.machine)
    for name, value in fields.items():
        if name not in Machine.model_fields:
            raise TilerError(f"machine.{name}: unknown field; {unknown_name(name, Machine.model_fields)}")
        if isinstance(value, list) and name != "cull":
            raise TilerError(f"machine.{name}: {value!r} is not allowed; allowed: one value")
    model = fields["queue_model"]
    if model != base.queue_model and model not in queue_model_names():
        raise TilerError(f"machine.queue_model: {model!r}; {unknown_name(str(model), queue_model_names())}")
    if not ask.full:
        fields |= {"verify": False, "blame": False}
    return Machine(**fields)


def draft_size(width: int, height: int) -> tuple[int, int]:
    """Size of a picture's draft: of the same shape, at most DRAFT_PIXELS."""
    scale = min(1.0, math.sqrt(DRAFT_PIXELS / (width * height)))
    return max(1, round(scale * width)), max(1, round(scale * height))


def change_scene(scene: Scene, ask: Ask) -> Scene:
    """The scene as it is asked for."""
    picture = scene.picture
    size = (picture.width, picture.height) if ask.full else draft_size(picture.width, picture.height)
    wanted = ask.scene
    tessellation = asdict(scene.tessellation)
    if scene.tessellation.edge_pixels is not None:
        del tessellation["factor"]  # a file says one of the two
    return replace(
        scene,
        picture=override_picture(PictureFile(**asdict(picture)), size, wanted.samples, wanted.shading),
        tessellation=override_tessellation(TessellationFile(**tessellation), wanted.factor, None, None),
        camera=scene.camera if ask.camera is None else move_camera(scene.camera, ask.frame, ask.camera),
    )


def move_camera(path: CameraPath, frame: float, asked: CameraAsk) -> CameraPath:
    """A camera that stands still. The near plane comes closer as the eye does, the far plane goes as far as it goes away."""
    before, now = math.dist(*eye_and_target(path, frame)), math.dist(asked.eye, asked.target)
    near = path.near * min(1.0, max(1e-3, now / before))
    far = path.far + max(0.0, now - before)
    eye: Vector = asked.eye
    return replace(path, keys=(CameraKey(0, eye, asked.target),), near=near, far=far)
