"""Vertex shader: control points from object space to world space, in float32."""

import numpy as np

from pipeline.jit import inlined, kernel, unaliased
from pipeline.types import F32, I32, Patches

ONE, TWO, THREE = np.uint64(1), np.uint64(2), np.uint64(3)


@inlined
def _matrix_rows(m):
    """float32[3, 4] as tuples."""
    return (
        (m[0, 0], m[0, 1], m[0, 2], m[0, 3]), (m[1, 0], m[1, 1], m[1, 2], m[1, 3]), (m[2, 0], m[2, 1], m[2, 2], m[2, 3]),
    )  # fmt: skip


@unaliased
def _transform_points(begin, end, m, points, out):
    """Homogeneous points begin .. end - 1 of flat arrays. Numbers are made unsigned: an index from the end costs a test."""
    (m00, m01, m02, m03), (m10, m11, m12, m13), (m20, m21, m22, m23) = _matrix_rows(m)
    for i in range(begin, end):
        k = np.uint64(4) * np.uint64(i)
        x, y, z, w = points[k], points[k + ONE], points[k + TWO], points[k + THREE]
        out[k] = ((m00 * x + m01 * y) + m02 * z) + m03 * w
        out[k + ONE] = ((m10 * x + m11 * y) + m12 * z) + m13 * w
        out[k + TWO] = ((m20 * x + m21 * y) + m22 * z) + m23 * w
        out[k + THREE] = w


@kernel
def _transform(control_points, object_id, transforms, out):
    begin, n = 0, len(object_id)
    while begin < n:  # the patches of an object follow each other
        end = begin + 1
        while end < n and object_id[end] == object_id[begin]:
            end += 1
        _transform_points(16 * begin, 16 * end, transforms[object_id[begin]], control_points, out)
        begin = end


def transform_control_points(control_points: F32, object_id: I32, transforms: F32) -> F32:
    """World-space control points, float32[P, 4, 4, 4], of homogeneous object-space ones.

    transforms : float32[objects, 3, 4], affine, column vectors: world = A x + t w for the homogeneous (wx, wy, wz, w).
    An exact identity leaves every control point's bits as they are (but for the sign of zero).
    """
    out = np.empty_like(control_points)
    _transform(control_points.reshape(-1), object_id, transforms, out.reshape(-1))
    return out


@kernel
def _find_rational(points, rational):
    for p in range(len(rational)):
        found = False
        for k in range(16):
            found |= points[p, 4 * k + 3] != 1
        rational[p] = found


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
    n = len(control_points)
    rational, none = np.empty(n, np.uint8), np.full(n, -1, np.int32)
    _find_rational(control_points.reshape(n, 64), rational)
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
        normal_slack=np.zeros(n, np.float32),
        seam_id=none.copy(),
        seam_edges=np.empty((0, 4, 2, 2), np.float32),
        seam_corners=np.empty((0, 4, 2), np.float32),
    )
