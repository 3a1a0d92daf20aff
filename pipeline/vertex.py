"""Vertex shader: control points from object space to world space, in float32."""

import numpy as np

from pipeline.jit import kernel
from pipeline.types import F32, I32, Patches


@kernel
def _transform(control_points, object_id, transforms, out):
    for p in range(len(control_points)):
        m = transforms[object_id[p]]
        for i in range(4):
            for j in range(4):
                x, y, z, w = control_points[p, i, j]
                for r in range(3):
                    out[p, i, j, r] = ((m[r, 0] * x + m[r, 1] * y) + m[r, 2] * z) + m[r, 3] * w
                out[p, i, j, 3] = w


def transform_control_points(control_points: F32, object_id: I32, transforms: F32) -> F32:
    """World-space control points, float32[P, 4, 4, 4], of homogeneous object-space ones.

    transforms : float32[objects, 3, 4], affine, column vectors: world = A x + t w for the homogeneous (wx, wy, wz, w).
    An exact identity leaves every control point's bits as they are (but for the sign of zero).
    """
    out = np.empty_like(control_points)
    _transform(control_points, object_id, transforms, out)
    return out


@kernel
def _transform_vertices(vertices, m, out):
    for v in range(len(vertices)):
        x, y, z = vertices[v]
        for r in range(3):
            out[v, r] = ((m[r, 0] * x + m[r, 1] * y) + m[r, 2] * z) + m[r, 3]


def transform_vertices(vertices: F32, transform: F32) -> F32:
    """World-space points, float32[V, 3], of object-space ones; transform : float32[3, 4] of their object."""
    out = np.empty_like(vertices)
    _transform_vertices(vertices, transform, out)
    return out


def make_patches(control_points: F32, texcoords: F32, map_id: I32, object_id: I32) -> Patches:
    """Bezier patches from world-space control points; marks the rational ones."""
    rational = (control_points[..., 3] != 1).any(axis=(1, 2)).astype(np.uint8)
    none = np.full(len(control_points), -1, np.int32)
    return Patches(
        control_points=control_points,
        rational=rational,
        texcoords=texcoords,
        map_id=map_id,
        object_id=object_id,
        tangent_id=none,
        gregory_id=none.copy(),
        tangent_u=np.empty((0, 3, 4, 3), np.float32),
        tangent_v=np.empty((0, 4, 3, 3), np.float32),
        inner=np.empty((0, 4, 2, 3), np.float32),
        normal_id=none.copy(),
        edge_row=np.empty((0, 4), np.int32),
        corner_row=np.empty((0, 4), np.int32),
        edge_normals=np.empty((0, 6, 3), np.float32),
        corner_normals=np.empty((0, 3), np.float32),
        normal_slack=np.zeros(len(control_points), np.float32),
        seam_id=none.copy(),
        seam_edges=np.empty((0, 4, 2, 2), np.float32),
        seam_corners=np.empty((0, 4, 2), np.float32),
    )
