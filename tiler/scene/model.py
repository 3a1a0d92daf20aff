"""What is drawn: a Scene is plain data, complete and checked. The loader and the builders make it; the machine reads it."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pipeline.animate import Motion
from pipeline.subdivision.surface import Surface
from pipeline.types import F32, I32

Shading = Literal["lambert", "normal", "patch", "wireframe", "tile_grid"]
Partitioning = Literal["integer", "pow2", "fractional_odd", "fractional_even"]
AddressMode = Literal["wrap", "mirror", "clamp"]
CullMode = Literal["none", "front", "back"]
VectorSpace = Literal["object", "world"]
Seams = Literal["keep", "lower_face"]


@dataclass(frozen=True)
class Picture:
    """The render target. Width and height in pixels, samples 1 or 4 (the standard pattern)."""

    width: int = 1280
    height: int = 720
    samples: int = 1
    shading: Shading = "lambert"
    background: tuple[int, int, int] = (24, 27, 34)  # 8-bit RGB as stored in the picture


@dataclass(frozen=True)
class Tessellation:
    """The hull shader's policy for factors: fixed ones, or edges cut to a length on the screen.

    factor : edge factors u=0, v=0, u=1, v=1, then inside u, v; used where edge_pixels is None.
    edge_pixels : wished length of a segment on the screen in pixels; factors then come from the control polygon of
        each edge, the same on both sides of a shared edge, and never exceed max_factor.
    silhouette : factors are multiplied by this on patches that are neither wholly front- nor wholly back-facing, and on
        the edges that they share; up to max_factor. 1: factors do not depend on silhouettes.
    """

    partitioning: Partitioning = "integer"
    factor: tuple[float, float, float, float, float, float] = (16.0,) * 6
    edge_pixels: float | None = None
    max_factor: float = 64.0
    silhouette: float = 1.0


@dataclass(frozen=True)
class DisplacementMap:
    """Displacement `scale * bilinear(texels, s, t) + bias`: along the unit normal in world units, or, of vectors, as it is.

    space : of vectors, whose axes and units they have: the object's or the world's. A map in object space has one object.
    """

    texels: F32  # (height, width), or (height, width, 3) for vectors; row 0 at t = 0
    address: AddressMode = "wrap"
    scale: float = 1.0
    bias: float = 0.0
    space: VectorSpace = "world"


@dataclass(frozen=True)
class CameraKey:
    """Where the camera stands at one frame, world space, right-handed; it looks from `eye` to `target`."""

    frame: float
    eye: tuple[float, float, float]
    target: tuple[float, float, float]


@dataclass(frozen=True)
class CameraPath:
    """Keys in rising order of frame; between them eye and target follow a Catmull-Rom spline, outside they stand still."""

    keys: tuple[CameraKey, ...]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov: float = 45.0  # vertical, degrees
    near: float = 0.1
    far: float = 100.0


@dataclass(frozen=True)
class SceneMesh:
    """An object that is a subdivision surface: what the hull shader makes patches of, made once."""

    surface: Surface
    vertices: F32  # (V, 3) of the control mesh, object space, where the object does not move
    object_id: int
    map_id: int = -1
    seams: Seams = "keep"


@dataclass(frozen=True)
class Scene:
    """All that a frame needs. Arrays are C-contiguous and never written after the scene is made.

    Patches are numbered in the order of objects: those of `control_points`, and those of `meshes` where their object
    comes. Without meshes they keep the order of `control_points`.
    """

    name: str
    control_points: F32  # (P, 4, 4, 4) homogeneous, object space, [p, i, j]: i along u, j along v
    texcoords: F32  # (P, 4, 2) at (u, v) = (0,0) (1,0) (0,1) (1,1)
    map_id: I32  # (P,) index into maps, -1 = not displaced
    object_id: I32  # (P,) index into transforms
    transforms: np.ndarray  # (objects, 3, 4) float32, object to world, column vectors
    maps: tuple[DisplacementMap, ...]
    camera: CameraPath
    picture: Picture = field(default_factory=Picture)
    tessellation: Tessellation = field(default_factory=Tessellation)
    face_cull: CullMode = "back"
    light: tuple[float, float, float] = (0.35, -0.5, 0.8)  # towards the light, world space, any length
    frames: int = 1  # length of the animation
    title: str = ""
    meshes: tuple[SceneMesh, ...] = ()
    motions: tuple[Motion | None, ...] = ()  # of each object; empty where none moves

    @property
    def num_patches(self) -> int:
        """Number of patches that the input assembler reads."""
        return len(self.control_points) + sum(mesh.surface.num_patches for mesh in self.meshes)

    @property
    def num_vertices(self) -> int:
        """Number of control points that the vertex shader runs on: 16 a patch, a mesh's vertices once each."""
        return 16 * len(self.control_points) + sum(mesh.surface.used_vertices for mesh in self.meshes)
