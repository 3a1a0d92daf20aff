"""A model file as a scene of its own: one object before a camera on the model's bounding sphere, at factor 8.

Which way is up USD files say; else it is y for control meshes and glTF, as modellers write them, z for patch sets and other
triangle meshes. The scene's title says which. The camera stands three quarters to the front, a little above, and sees the
sphere about all keys of the model with some room; the picture is 1280 x 720. Frames are those of the model's keys.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from pipeline.types import F64
from tiler.errors import TilerError
from tiler.scene import problems, schema
from tiler.scene.arrays import ArrayFault
from tiler.scene.loader import Checked, build_scene
from tiler.scene.mesh_files import MESH_SUFFIXES, PATCH_SUFFIXES, USD_SUFFIXES
from tiler.scene.model import CameraKey, CameraPath, Scene
from tiler.scene.usd import up_axis

SUFFIXES = (*MESH_SUFFIXES, *PATCH_SUFFIXES)
Y_UP = (*MESH_SUFFIXES, ".glb", ".gltf")
FOV = 30.0  # degrees
# The sine of half the angle that the sphere is seen under, with a tenth to spare: tan(FOV / 2) / sqrt(1 + tan^2) / 1.1.
SEEN = 0.2588190451025207 / 1.1
TOWARDS = {"y": (0.5, 0.35, 0.8), "z": (0.5, -0.8, 0.35)}  # from the model to the camera


def is_model(path: Path) -> bool:
    """Whether a path names a model, by its end."""
    return path.suffix.lower() in SUFFIXES


def model_scene(file: Path, displacement: Mapping[str, Any] | None = None) -> Scene:
    """The scene of a model file. displacement : keys of a scene file's table object.displacement. Raises TilerError."""
    source = "mesh" if file.suffix.lower() in MESH_SUFFIXES else "patches"
    described: dict[str, Any] = {source: file.name}
    if displacement is not None:
        name = str(displacement.get("map", ""))
        is_file = schema.is_map_file(name)
        described["displacement"] = {**displacement, "map": str(Path(name).absolute()) if is_file else name}
    up = _up_of(file)
    data = {
        "title": f"{file.name}, {up} up",
        "light": [0.35, 0.8, 0.5] if up == "y" else [0.35, -0.5, 0.8],
        "tessellation": {"factor": 8},
        "camera": {"key": [{"frame": 0, "eye": [1, 0, 0], "target": [0, 0, 0]}]},
        "object": [described],
    }
    try:
        scene = schema.SceneFile.model_validate(data)
    except ValidationError as error:
        raise problems.error_of(str(file), problems.problems_of(error, schema.SceneFile), {}) from None
    made = build_scene(Checked(file, scene, [None], {}), file.stem)
    last = max((float(motion.frames[-1]) for motion in made.motions if motion is not None), default=0.0)
    return replace(made, camera=_camera(_points(made), up, file), frames=int(min(max(last, 0.0), 999_999.0)) + 1)


def _up_of(file: Path) -> str:
    """The axis that points upwards, y or z."""
    if file.suffix.lower() in USD_SUFFIXES:
        try:
            return up_axis(file)
        except ArrayFault as fault:
            raise TilerError(f"{file}: {fault}") from None
    return "y" if file.suffix.lower() in Y_UP else "z"


def read_displacement(text: str) -> dict[str, Any]:
    """Keys of object.displacement from `height.png` or `height.png,channel=a,scale=0.5`. Raises TilerError."""
    name, *parts = (part.strip() for part in text.split(","))
    found: dict[str, Any] = {"map": name}
    for part in parts:
        key, equals, value = part.partition("=")
        if not equals or not key or not value:
            raise TilerError(
                f"displacement: {text!r} is not allowed; allowed: a map, then key=value pairs, such as height.png,scale=0.5"
            )
        if re.fullmatch(r"[+-]?\d+", value):
            found[key] = int(value)
        else:
            try:
                found[key] = float(value)
            except ValueError:
                found[key] = value
    return found


def _points(scene: Scene) -> F64:
    """Finite control points, those of all keys where the model moves, world space, (n, 3)."""
    with np.errstate(all="ignore"):
        parts = [(scene.control_points[..., :3].astype(np.float64) / scene.control_points[..., 3:]).reshape(-1, 3)]
    parts += [mesh.vertices.astype(np.float64) for mesh in scene.meshes]
    moved = [motion.points for motion in scene.motions if motion is not None and motion.points is not None]
    parts += [points.reshape(-1, 3).astype(np.float64) for points in moved]
    points = np.concatenate(parts)
    return points[np.isfinite(points).all(axis=1)]


def _camera(points: F64, up: str, file: Path) -> CameraPath:
    """On the line to the middle of the bounding box, so far that the sphere about it is seen whole."""
    if not len(points):
        raise TilerError(f"{file}: has no finite point; allowed: a model with one at least")
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.sqrt(((points - middle) ** 2).sum(axis=1).max())) or 1.0
    towards = np.array(TOWARDS[up])
    towards /= np.sqrt((towards**2).sum())
    distance = radius / SEEN
    eye = middle + distance * towards
    key = CameraKey(0, tuple(map(float, eye)), tuple(map(float, middle)))  # type: ignore[arg-type]
    axis = (0.0, 1.0, 0.0) if up == "y" else (0.0, 0.0, 1.0)
    return CameraPath((key,), axis, FOV, 0.5 * (distance - radius), 2.0 * (distance + radius))
