"""What builders and patch files hand to the loader: the patches of one object."""

from typing import NamedTuple

import numpy as np

from pipeline.types import F32


class Mesh(NamedTuple):
    """Bicubic Bezier patches in object space; du x dv points to the front side."""

    control_points: F32  # (n, 4, 4, 4) homogeneous, [p, i, j]: i along u, j along v
    texcoords: F32  # (n, 4, 2) (s, t) at (u, v) = (0,0) (1,0) (0,1) (1,1)


def mesh_of(points: np.ndarray, texcoords: np.ndarray | None = None) -> Mesh:
    """Mesh of points (n, 4, 4, 3), or homogeneous (n, 4, 4, 4); without texture coordinates each patch gets the unit square."""
    count = len(points)
    control_points = np.ones((count, 4, 4, 4), np.float32)
    control_points[..., : points.shape[3]] = points
    if texcoords is None:
        texcoords = np.broadcast_to(np.array([(0, 0), (1, 0), (0, 1), (1, 1)]), (count, 4, 2))
    return Mesh(control_points, np.ascontiguousarray(texcoords, np.float32))


def grid_texcoords(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Texture corners (m * n, 4, 2) float32 of a grid of m x n patches, patch i * n + j.

    s : (m + 1,) at the knots along u; t : (n + 1,) at the knots along v. Neighbours read the same float32 values.
    """
    corners = np.empty((len(s) - 1, len(t) - 1, 4, 2), np.float32)
    for corner, (du, dv) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
        corners[:, :, corner, 0] = s[du : len(s) - 1 + du, None]
        corners[:, :, corner, 1] = t[None, dv : len(t) - 1 + dv]
    return corners.reshape(-1, 4, 2)
