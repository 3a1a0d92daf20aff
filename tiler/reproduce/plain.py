"""Scenes without displacement, as patches of their own: what the back-patch tests of the paper take, and pictures count."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pipeline.types import F64, Patches
from tiler import front_end
from tiler.scene.model import CameraKey, CameraPath, Picture, Scene

FOV = 30.0  # degrees, of `view_from`
HALF_SINE = 0.2588190451025207  # of FOV / 2: the camera sees a sphere of radius r whole from r / HALF_SINE on


class Ball(NamedTuple):
    """The sphere about the middle of the box of a scene's control points, and that box."""

    center: F64  # (3,) world space
    radius: float
    half: F64  # (3,) half the sides of the box


def plain_scene(scene: Scene, frame: float = 0) -> Scene:
    """The patches of a scene at a frame, world space, without displacement and motion; numbers of patches stay.

    ACC patches without displacement are the surface of their 16 points, so nothing of their tangents is needed.
    """
    bare = replace(
        scene,
        map_id=np.full_like(scene.map_id, -1),
        meshes=tuple(replace(mesh, map_id=-1, seams="keep") for mesh in scene.meshes),
        maps=(),
    )
    patches = front_end.run_vertex_shader(bare, frame)
    n = len(patches.control_points)
    return replace(
        bare,
        control_points=patches.control_points,
        texcoords=patches.texcoords,
        map_id=patches.map_id,
        object_id=np.zeros(n, np.int32),
        transforms=np.eye(3, 4, dtype=np.float32)[None],
        meshes=(),
        motions=(),
        frames=1,
    )


def patches_of(scene: Scene) -> Patches:
    """World-space patches of a scene at its first frame."""
    return front_end.run_vertex_shader(scene, 0)


def ball_of(scene: Scene) -> Ball:
    """The ball of a plain scene's control points."""
    points = (scene.control_points[..., :3].astype(np.float64) / scene.control_points[..., 3:]).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    center = 0.5 * (low + high)
    return Ball(center, float(np.sqrt(((points - center) ** 2).sum(axis=1).max())), 0.5 * (high - low))


def view_from(scene: Scene, eye: F64, target: F64, up: tuple[float, float, float], size: tuple[int, int]) -> Scene:
    """The scene as a camera at `eye` sees it that looks at `target`, in a picture of size (width, height)."""
    ball = ball_of(scene) if not scene.meshes else ball_of(plain_scene(scene))
    distance = float(np.sqrt(((eye - ball.center) ** 2).sum()))
    near = max(distance - 1.2 * ball.radius, 0.02 * ball.radius)
    key = CameraKey(0, tuple(map(float, eye)), tuple(map(float, target)))  # type: ignore[arg-type]
    camera = CameraPath((key,), up, FOV, near, distance + 1.2 * ball.radius)
    return replace(scene, camera=camera, picture=Picture(*size, background=(255, 255, 255)))
