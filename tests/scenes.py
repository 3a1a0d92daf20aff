"""Scenes made for tests: built-in ones looked at in an unusual way, and small ones that provoke rare events."""

import math
from dataclasses import replace

import numpy as np

from tiler.scene.camera import eye_and_target
from tiler.scene.model import CameraKey, CameraPath, DisplacementMap, Picture, Scene, Tessellation

IDENTITY = np.eye(3, 4, dtype=np.float32)[None]


def sliced(scene: Scene) -> Scene:
    """The scene cut open: the near plane goes through the point looked at, the far plane lies close behind it, and the
    view is narrow, so that patches cross the frustum's planes on all sides. Both faces are drawn."""
    eye, target = eye_and_target(scene.camera, 0)
    distance = math.dist(eye, target)
    path = CameraPath((CameraKey(0, eye, target),), scene.camera.up, 0.4 * scene.camera.fov, distance, 1.15 * distance)
    return replace(scene, camera=path, face_cull="none")


def looking_along_y(distance: float = 4.0, fov: float = 40.0, near: float = 0.5, far: float = 20.0) -> CameraPath:
    """A camera on the negative y axis that looks at the origin; x to the right, z up."""
    return CameraPath((CameraKey(0, (0.0, -distance, 0.0), (0.0, 0.0, 0.0)),), fov=fov, near=near, far=far)


def flat_patch(x0: float, z0: float, x1: float, z1: float, y: float = 0.0, w: float = 1.0) -> np.ndarray:
    """Control points (4, 4, 4) of a rectangle that faces `looking_along_y`, u along x and v along z; `w`: all weights."""
    points = np.ones((4, 4, 4))
    points[..., 0] = np.linspace(x0, x1, 4)[:, None]
    points[..., 1] = y
    points[..., 2] = np.linspace(z0, z1, 4)[None, :]
    return points * w


def patch_scene(
    patches: list[np.ndarray],
    *,
    size: tuple[int, int] = (40, 24),
    samples: int = 1,
    factor: float | tuple[float, ...] = 2.0,
    camera: CameraPath | None = None,
    displacement: DisplacementMap | None = None,
    **fields: object,
) -> Scene:
    """A scene of these patches, each control points (4, 4, 4), on the same map if there is one."""
    n = len(patches)
    texcoords = np.broadcast_to(np.array([(0, 0), (1, 0), (0, 1), (1, 1)], np.float32), (n, 4, 2)).copy()
    factors = tuple(factor) if isinstance(factor, tuple) else (factor,) * 6
    made = Scene(
        name="made for a test",
        control_points=np.array(patches, np.float32).reshape(n, 4, 4, 4),
        texcoords=texcoords,
        map_id=np.full(n, 0 if displacement else -1, np.int32),
        object_id=np.zeros(n, np.int32),
        transforms=IDENTITY,
        maps=(displacement,) if displacement else (),
        camera=camera or looking_along_y(),
        picture=Picture(*size, samples=samples, shading="patch"),
        tessellation=Tessellation(factor=factors),
    )
    return replace(made, **fields)


def some_patches(scene: Scene, numbers: list[int]) -> Scene:
    """The scene with these patches only, in this order."""
    return replace(
        scene,
        control_points=scene.control_points[numbers].copy(),
        texcoords=scene.texcoords[numbers].copy(),
        map_id=scene.map_id[numbers].copy(),
        object_id=scene.object_id[numbers].copy(),
    )
