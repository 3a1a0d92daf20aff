"""A forest of columns whose depth is a parameter: rows behind each other, made of the parts of `colonnade`."""

from dataclasses import replace

import numpy as np

from tiler.scene import load_scene
from tiler.scene.colonnade import Columns, build_columns
from tiler.scene.model import CameraKey, CameraPath, Scene

PARTS = {"base": 3, "shaft": 4, "capital": 5}  # objects of the scene, for their maps
COLUMNS = 12  # of a row
SPACING = 3.0  # between rows, and between the columns of a row
# Each row is moved along itself by another part of the spacing, so that no lane stays open: multiples of the golden
# section, which leave no gap for long, on a grid of 1/64.
GOLDEN = 0.6180339887


def forest(rows: int, size: tuple[int, int], factor: float) -> Scene:
    """`rows` rows of 12 columns, seen from far before the first row; nothing else. One object for a part of a row.

    The view is narrow, so that the last of many rows is not much smaller in the picture than the first.
    """
    base = load_scene("colonnade", size=size, factor=factor)
    points, texcoords, map_id, object_id = [], [], [], []
    transforms: list[list[tuple[float, ...]]] = []
    for part, source in PARTS.items():
        mesh = build_columns(Columns.model_validate({"part": part, "along": COLUMNS, "across": 1, "nave": -1}))
        found = int(base.map_id[base.object_id == source][0])
        for row in range(rows):
            count = len(mesh.control_points)
            points.append(mesh.control_points)
            texcoords.append(mesh.texcoords)
            map_id.append(np.full(count, found, np.int32))
            object_id.append(np.full(count, len(transforms), np.int32))
            shift = round((GOLDEN * row % 1.0) * 64 * SPACING) / 64
            transforms.append([(1, 0, 0, shift), (0, 1, 0, SPACING * row), (0, 0, 1, 0)])
    view = CameraKey(0.0, (0.0, -140.0, 3.9), (0.5, 10.0, 3.7))
    return replace(
        base,
        name="forest",
        control_points=np.concatenate(points),
        texcoords=np.concatenate(texcoords),
        map_id=np.concatenate(map_id),
        object_id=np.concatenate(object_id),
        transforms=np.array(transforms, np.float32),
        camera=CameraPath((view,), fov=3.0, near=100.0, far=400.0),
        frames=1,
        title=f"{rows} rows of {COLUMNS} columns",
    )
