"""Where the eyes of a study stand: on the scene's own camera path, or around the scene.

Eyes around the scene stand on a sphere of `distance` bounding radii and look at its centre. Which eye is number k depends
on the seed and k alone: a longer study begins with the eyes of a shorter one. Only + - * / and sqrt, and sines rounded to
a grid: every machine finds the same eyes.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from tiler.scene.model import CameraKey, CameraPath, Scene
from tiler.scene.rounding import cos_turns, sin_turns
from tiler.scene.strict import Faults, NotAllowed, Strict, between, number, whole

FRAMES = 'a number, a list of numbers, or a text "FIRST..LAST" with FIRST <= LAST'
_OWN = {"path": ("frames",), "random": ("count", "distance", "at"), "orbit": ("steps", "distance", "elevation", "at")}
_NEEDED = {"path": (), "random": ("count",), "orbit": ("steps",)}
_MOST = 2**53  # row numbers stay exact in every program that reads them

Vector = tuple[float, float, float]


class Sphere(NamedTuple):
    """A sphere around all that a scene draws, world space."""

    centre: Vector
    radius: float


def frame_sequence(value: Any) -> Sequence[int | float]:
    """Frame numbers of what a study says: 7, [0, 12.5] or "0..47"; long stretches stay ranges."""
    if isinstance(value, str):
        first, dots, last = value.strip().partition("..")
        if not dots or not (first.isdigit() and last.isdigit()) or max(len(first), len(last)) > 15:
            raise NotAllowed
        numbers: Sequence[int | float] = range(int(first), int(last) + 1)
    elif isinstance(value, range):
        numbers = value
    else:
        numbers = list(value) if isinstance(value, list | tuple) else [value]
        for each in numbers:
            if isinstance(each, bool) or not isinstance(each, int | float) or not abs(each) <= 1e6:
                raise NotAllowed
    if not numbers:
        raise NotAllowed
    return numbers


def _frames(value: Any) -> Any:
    return None if value is None else frame_sequence(value)


class ViewFile(Strict):
    """Table [view.NAME]: a family of cameras; each of its eyes is a frame of the study."""

    kind: Literal["path", "random", "orbit"]
    frames: Annotated[Any, BeforeValidator(_frames)] = Field(None, description=FRAMES)
    count: int = whole(1, 1, _MOST, " (eyes, uniform on the sphere)")
    steps: int = whole(1, 1, _MOST, " (eyes, evenly around the scene)")
    distance: float = between(2.5, 1.0, 1e4, " (of the eye from the scene's centre, in radii of its bounding sphere)")
    elevation: float = number(20.0, -89.0, 89.0, " (degrees above the scene's horizon)")
    at: float = number(0.0, -1e6, 1e6, " (frame of the scene's animation)")

    @model_validator(mode="after")
    def _keys_of_its_kind(self) -> "ViewFile":
        given = self.model_fields_set - {"kind"}
        faults = [
            ((key,), f"belongs to views of another kind; a {self.kind} view has {', '.join(_OWN[self.kind])}")
            for key in sorted(given.difference(_OWN[self.kind]))
        ]
        faults += [((key,), "is missing; needed: how many eyes") for key in _NEEDED[self.kind] if key not in given]
        if faults:
            raise Faults(*faults)
        return self

    def frame_numbers(self, scene: Scene) -> Sequence[int | float]:
        """The study's frames under this view."""
        if self.kind == "path":
            return range(scene.frames) if self.frames is None else self.frames
        return range(self.count if self.kind == "random" else self.steps)

    def described(self, seed: str) -> dict[str, Any]:
        """All that the eyes depend on, as plain data for `look`."""
        if self.kind == "path":
            return {"kind": "path"}
        own: dict[str, Any] = {"kind": self.kind, "distance": self.distance, "at": self.at}
        return own | ({"seed": seed} if self.kind == "random" else {"steps": self.steps, "elevation": self.elevation})


def look(scene: Scene, sphere: Sphere | None, view: dict[str, Any], frame: float) -> tuple[Scene, float]:
    """The scene with the camera of a view's frame, and the frame to simulate. sphere : of the scene; unused by paths."""
    if view["kind"] == "path" or sphere is None:
        return scene, frame
    up = scene.camera.up
    if view["kind"] == "random":
        direction = random_direction(view["seed"], int(frame))
    else:
        direction = _orbit_direction(up, int(frame), view["steps"], view["elevation"])
    if abs(_dot(direction, up)) > 0.999 * math.sqrt(_dot(up, up)):
        up = _cross_axis(direction)
    distance, radius = view["distance"], sphere.radius
    reach = distance * radius
    eye = _add(sphere.centre, direction, reach)
    key = CameraKey(view["at"], eye, sphere.centre)
    near = max(0.9 * (distance - 1.0), 0.01) * radius
    camera = CameraPath((key,), up, scene.camera.fov, near, reach + 1.1 * radius)
    return replace(scene, camera=camera), view["at"]


def bounding_sphere(scene: Scene) -> Sphere:
    """Sphere around all control points with a positive weight, wider by the largest displacement."""
    points = [scene.control_points.astype(np.float64).reshape(-1, 4)]
    objects = [np.repeat(scene.object_id, 16)]
    for mesh in scene.meshes:  # a subdivision surface lies inside the hull of its vertices, too
        points.append(np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]).astype(np.float64))
        objects.append(np.full(len(mesh.vertices), mesh.object_id))
    point = np.concatenate(points)
    rows = scene.transforms.astype(np.float64)[np.concatenate(objects)]  # (N, 3, 4)
    with np.errstate(all="ignore"):
        x, y, z = (sum(rows[:, axis, k] * point[:, k] for k in range(4)) / point[:, 3] for axis in range(3))
        used = np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & (point[:, 3] > 0)
        if not used.any():
            return Sphere((0.0, 0.0, 0.0), 1.0)
        x, y, z = x[used], y[used], z[used]
        middle = tuple(float(0.5 * (each.min() + each.max())) for each in (x, y, z))
        radius = math.sqrt(float(((x - middle[0]) ** 2 + (y - middle[1]) ** 2 + (z - middle[2]) ** 2).max()))
        for each in scene.maps:
            height = np.abs(each.scale * each.texels.astype(np.float64) + each.bias)
            if height.ndim == 3:
                height = np.sqrt((height**2).sum(axis=2))
            radius += max(0.0, float(height[np.isfinite(height)].max(initial=0.0)))
    return Sphere((middle[0], middle[1], middle[2]), radius if 0 < radius < math.inf else 1.0)


def random_direction(seed: str, k: int) -> Vector:
    """Direction k of those that `seed` gives: uniform on the unit sphere, by rejection from the cube."""
    numbers = random.Random(f"{seed}/{k}")
    while True:
        x, y, z = (2.0 * numbers.random() - 1.0 for _ in range(3))
        square = x * x + y * y + z * z
        if 1e-4 < square <= 1.0:
            length = math.sqrt(square)
            return x / length, y / length, z / length


def _orbit_direction(up: Vector, k: int, steps: int, elevation: float) -> Vector:
    """Direction k of `steps` evenly around the axis `up`."""
    length = math.sqrt(_dot(up, up))
    axis = (up[0] / length, up[1] / length, up[2] / length)
    first = _cross(axis, _cross_axis(axis))
    size = math.sqrt(_dot(first, first))
    first = (first[0] / size, first[1] / size, first[2] / size)
    second = _cross(axis, first)
    high, wide = sin_turns(elevation / 360.0), cos_turns(elevation / 360.0)
    ahead, aside = wide * cos_turns(k / steps), wide * sin_turns(k / steps)
    x, y, z = (high * axis[c] + ahead * first[c] + aside * second[c] for c in range(3))
    return x, y, z


def _cross_axis(direction: Vector) -> Vector:
    """The axis of the world that lies farthest from `direction`."""
    least = min(range(3), key=lambda c: abs(direction[c]))
    return (float(least == 0), float(least == 1), float(least == 2))


def _add(a: Vector, b: Vector, scale: float) -> Vector:
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
