"""What a scene file may say: one class for each of its tables, one field for each of its keys.

A field's description says in words what is allowed; the error message for a wrong value is made of it.
"""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from tiler.scene import map_files, mesh_files
from tiler.scene.builders import ALL_BUILDERS, MESH_BUILDERS
from tiler.scene.camera import view_axes
from tiler.scene.maps import MAPS
from tiler.scene.model import AddressMode, CullMode, Partitioning, Seams, Shading, VectorSpace
from tiler.scene.strict import (
    VECTOR_WORDS,
    Direction,
    Faults,
    NotAllowed,
    Rgb,
    Strict,
    UnknownName,
    Vector,
    between,
    number,
    whole,
)

SIX_FACTORS = "a number above 0 and at most 64, or six of them (edges u=0, v=0, u=1, v=1, inside u, v)"
SCALE = "a number above 0 and at most 1e+06, or three of them"
MAP_NAMES = ", ".join(MAPS)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _repeated(count: int, most: float) -> BeforeValidator:
    """Reads one number, or `count` of them, as a tuple of `count`; each above 0 and at most `most`."""

    def read(value: Any) -> Any:
        numbers = list(value) if isinstance(value, list | tuple) else [value] * count
        if len(numbers) != count or not all(_is_number(x) and 0 < x <= most for x in numbers):
            raise NotAllowed
        return tuple(float(x) for x in numbers)

    return BeforeValidator(read)


def _known_builder(name: str) -> str:
    if name not in ALL_BUILDERS:
        raise UnknownName(ALL_BUILDERS)
    return name


def is_map_file(name: str) -> bool:
    """Whether a displacement's `map` names a file; all other names are procedural maps."""
    return name.lower().endswith(map_files.SUFFIXES)


def _known_map(name: str) -> str:
    if not is_map_file(name) and name not in MAPS:
        raise UnknownName([*MAPS, *(f"FILE{suffix}" for suffix in map_files.SUFFIXES)])
    return name


def _patch_file(name: str) -> str:
    if not name.lower().endswith(mesh_files.PATCH_SUFFIXES):
        raise NotAllowed
    return name


def _mesh_file(name: str) -> str:
    if not name.lower().endswith(mesh_files.MESH_SUFFIXES):
        raise NotAllowed
    return name


def _motion_file(name: str) -> str:
    if not name.lower().endswith(".npz"):
        raise NotAllowed
    return name


Factors = Annotated[tuple[float, float, float, float, float, float], _repeated(6, 64.0)]
Scale = Annotated[Vector, _repeated(3, 1e6)]


class PictureFile(Strict):
    """Table [picture]: the render target."""

    width: int = whole(1280, 1, 16384, " (pixels)")
    height: int = whole(720, 1, 16384, " (pixels)")
    samples: Literal[1, 4] = 1
    shading: Shading = "lambert"
    background: Rgb = Field((24, 27, 34), description="three whole numbers [red, green, blue], each from 0 to 255")


class TessellationFile(Strict):
    """Table [tessellation]: where tessellation factors come from. Either `factor` or `edge_pixels`."""

    partitioning: Partitioning = "integer"
    factor: Factors = Field((16.0,) * 6, description=SIX_FACTORS)
    edge_pixels: float | None = between(None, 0.0, 16384.0, " (pixels)")
    max_factor: float = number(64.0, 1.0, 64.0)
    silhouette: float = number(1.0, 1.0, 64.0, " (times the factors, on patches that may show an outline)")

    @model_validator(mode="after")
    def _one_policy(self) -> "TessellationFile":
        if self.edge_pixels is not None and "factor" in self.model_fields_set:
            raise Faults((("edge_pixels",), "stands beside factor; allowed: one of the two keys"))
        return self


class KeyFile(Strict):
    """Table [[camera.key]]: where the camera is at one frame, and the point that it looks at."""

    frame: float = Field(ge=-1e6, le=1e6, description="a number from -1e+06 to 1e+06")
    eye: Vector = Field(description=VECTOR_WORDS)
    target: Vector = Field(description=VECTOR_WORDS)


class CameraFile(Strict):
    """Table [camera]: a perspective camera and its path."""

    up: Direction = Field((0.0, 0.0, 1.0), description=VECTOR_WORDS + ", not all 0")
    fov: float = between(45.0, 1.0, 170.0, " (degrees, bottom to top of the picture)", below=True)
    near: float = between(0.1, 0.0, 1e6, " (world units)")
    far: float = between(100.0, 0.0, 1e6, " (world units)")
    key: list[KeyFile] = Field(min_length=1, description="one or more tables [[camera.key]] with frame, eye and target")

    @model_validator(mode="after")
    def _has_a_view(self) -> "CameraFile":
        faults: list[tuple[tuple[str | int, ...], str]] = []
        if not self.near < self.far:
            faults.append((("far",), f"{self.far:g} is not beyond near = {self.near:g}; allowed: near < far"))
        for k, key in enumerate(self.key):
            if k and not self.key[k - 1].frame < key.frame:
                problem = f"{key.frame:g} does not follow {self.key[k - 1].frame:g}; allowed: frames in rising order"
                faults.append((("key", k, "frame"), problem))
            if key.eye == key.target:
                faults.append((("key", k, "target"), "is where eye is; allowed: a point away from it"))
            elif view_axes(key.eye, key.target, self.up) is None:
                problem = f"lies straight along up = {list(self.up)} from eye; allowed: a view in another direction"
                faults.append((("key", k, "target"), problem))
        if faults:
            raise Faults(*faults)
        return self


class DisplacementFile(Strict):
    """Table [object.displacement]: displacement `scale * map + bias`, a number along the normal in world units, or a vector."""

    map: Annotated[str, AfterValidator(_known_map)] = Field(
        description=f"a file name ending in {', '.join(map_files.SUFFIXES)}, or one of {MAP_NAMES}"
    )
    kind: Literal["scalar", "vector"] = "scalar"
    space: VectorSpace = "object"
    seams: Seams = "keep"
    channel: map_files.Channel | None = Field(None, description="one of grey, r, g, b, a (of a map file)")
    size: int = whole(512, 16, 4096, " (texels along a side of a procedural map)")
    seed: int = whole(1, 0, 2**31 - 1, " (of a procedural map)")
    address: AddressMode = "wrap"
    scale: float = number(1.0, -1e6, 1e6, " (world units)")
    bias: float = number(0.0, -1e6, 1e6, " (world units)")

    @model_validator(mode="after")
    def _only_procedural_maps_have_sizes(self) -> "DisplacementFile":
        given = [key for key in ("size", "seed") if key in self.model_fields_set]
        if is_map_file(self.map) and given:
            raise Faults(*(((key,), "belongs to procedural maps, and map names a file") for key in given))
        if not is_map_file(self.map) and self.channel is not None:
            raise Faults((("channel",), f"belongs to map files, and {self.map} is a procedural map"))
        if self.kind == "vector" and not is_map_file(self.map):
            raise Faults((("kind",), f"is vector, and {self.map} is a procedural map; allowed: a map file"))
        if self.kind == "vector" and self.channel is not None:
            raise Faults((("channel",), "belongs to scalar maps, and this one has the components r, g and b"))
        if self.kind == "scalar" and "space" in self.model_fields_set:
            raise Faults((("space",), "belongs to maps of vectors, and kind is scalar"))
        return self


class ObjectFile(Strict):
    """Table [[object]]: patches or a control mesh, where they stand, how they move, and their displacement."""

    builder: Annotated[str, AfterValidator(_known_builder)] | None = Field(
        None, description="one of " + ", ".join(ALL_BUILDERS)
    )
    parameters: dict[str, Any] = Field({}, description="a table of the builder's parameters")
    patches: Annotated[str, AfterValidator(_patch_file)] | None = Field(
        None, description=f"a file name ending in {', '.join(mesh_files.PATCH_SUFFIXES)}"
    )
    mesh: Annotated[str, AfterValidator(_mesh_file)] | None = Field(
        None, description=f"a file name ending in {', '.join(mesh_files.MESH_SUFFIXES)}"
    )
    basis: Literal["acc", "gregory"] = "acc"
    refine: Literal["none", "uniform", "adaptive"] = "none"
    animation: Annotated[str, AfterValidator(_motion_file)] | None = Field(
        None, description="a file name ending in .npz"
    )
    translate: Vector = Field((0.0, 0.0, 0.0), description=VECTOR_WORDS)
    rotate: Vector = Field((0.0, 0.0, 0.0), description=VECTOR_WORDS + " (degrees)")
    scale: Scale = Field((1.0, 1.0, 1.0), description=SCALE)
    displacement: DisplacementFile | None = Field(None, description="a table with the key map")

    @model_validator(mode="after")
    def _has_one_source(self) -> "ObjectFile":
        given = [key for key in ("builder", "patches", "mesh") if getattr(self, key) is not None]
        if len(given) != 1:
            words = "none of builder, patches and mesh is" if not given else f"{' and '.join(given)} are"
            raise Faults(((), f"{words} given; allowed: exactly one of them"))
        wrong = [
            key
            for key in ("basis", "refine")
            if key in self.model_fields_set and self.mesh is None and self.builder not in MESH_BUILDERS
        ]
        if (
            self.displacement is not None
            and self.displacement.seams != "keep"
            and self.mesh is None
            and self.builder not in MESH_BUILDERS
        ):
            problem = "belongs to a mesh, and this object is made of patches"
            raise Faults((("displacement", "seams"), problem))
        if wrong:
            raise Faults(*(((key,), "belongs to a mesh, and this object is made of patches") for key in wrong))
        if self.builder is None and "parameters" in self.model_fields_set:
            raise Faults((("parameters",), "belongs to builders, and this object is read from a file"))
        return self


class SceneFile(Strict):
    """A whole scene file."""

    title: str = Field("", description="a text")
    frames: int = whole(1, 1, 1_000_000)
    face_cull: CullMode = "back"
    light: Direction = Field((0.35, -0.5, 0.8), description=VECTOR_WORDS + ", not all 0")
    picture: PictureFile = Field(PictureFile(), description="a table")
    tessellation: TessellationFile = Field(TessellationFile(), description="a table")
    camera: CameraFile = Field(description="a table [camera] with at least one [[camera.key]]")
    object: list[ObjectFile] = Field(
        min_length=1, description="one or more tables [[object]] with a builder, patches or a mesh"
    )
