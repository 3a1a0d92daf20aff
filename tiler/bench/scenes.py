"""What is measured: a displaced torus of exact bicubic patches, of any number, seen whole; or a scene by its name.

The torus is closed: half of its patches face away and its near side hides part of its far side, so that every cull test
has something to find, and the clipper nothing to do.
"""

import math
from dataclasses import replace

import numpy as np

from pipeline.types import F32
from tiler.scene import load_scene
from tiler.scene.bspline import bezier_patches, on_grid
from tiler.scene.maps import sea
from tiler.scene.mesh import grid_texcoords, mesh_of
from tiler.scene.model import CameraKey, CameraPath, DisplacementMap, Picture, Scene, Tessellation
from tiler.scene.rounding import cos_turns, sin_turns

TORUS = "torus"
PATCHES = 3753  # of the torus that is compared: 139 x 27
MAJOR, MINOR = 2.0, 0.75  # radii of the torus, world units
AMPLITUDE = 0.03  # largest displacement, world units
REPEATS = 4  # of the map around the hole; around the tube it lies once

ASPECT = 139 / 27  # patches around the hole to patches around the tube


def torus(patches: int, factor: float, size: tuple[int, int]) -> Scene:
    """The torus with about `patches` patches, on a picture of size (width, height)."""
    rows = max(4, round(math.sqrt(patches / ASPECT)))
    columns = max(4, round(patches / rows))
    tube, ring = _circle(rows), _circle(columns)
    net = np.empty((columns, rows, 3))
    reach = MAJOR + MINOR * tube[:, 0]
    net[..., 0] = ring[:, :1] * reach
    net[..., 1] = ring[:, 1:] * reach
    net[..., 2] = MINOR * tube[:, 1]
    points = bezier_patches(on_grid(net), periodic_u=True, periodic_v=True)
    texcoords = grid_texcoords(REPEATS * np.arange(columns + 1) / columns, np.arange(rows + 1) / rows)
    mesh = mesh_of(points, texcoords)
    n = len(points)
    return Scene(
        name=TORUS,
        control_points=mesh.control_points,
        texcoords=mesh.texcoords,
        map_id=np.zeros(n, np.int32),
        object_id=np.zeros(n, np.int32),
        transforms=np.eye(3, 4, dtype=np.float32)[None],
        maps=(DisplacementMap(_map(), scale=AMPLITUDE),),
        camera=CameraPath((CameraKey(0, (0.0, -6.0, 4.2), (0.0, -0.2, -0.1)),), fov=40.0, near=0.5, far=20.0),
        picture=Picture(*size),
        tessellation=Tessellation(factor=(factor,) * 6),
        title="A displaced torus",
    )


def bench_scene(name: str, factor: float, size: tuple[int, int]) -> Scene:
    """The torus, or the built-in scene or scene file of that name."""
    if name == TORUS:
        return torus(PATCHES, factor, size)
    return load_scene(name, size=size, factor=factor)


def with_factor(scene: Scene, factor: float) -> Scene:
    """The scene with all factors fixed at `factor`."""
    return replace(scene, tessellation=replace(scene.tessellation, factor=(factor,) * 6, edge_pixels=None))


def _circle(n: int) -> np.ndarray:
    """n points of the unit circle, (n, 2)."""
    return np.array([(cos_turns(k / n), sin_turns(k / n)) for k in range(n)])


_maps: list[F32] = []


def _map() -> F32:
    """One map for all, so that the machine packs it once."""
    if not _maps:
        _maps.append(sea(1024, 1))
    return _maps[0]
