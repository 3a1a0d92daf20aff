"""Pixel shader: a few shadings that show what happens, evaluated for the visible triangle at a pixel's centre.

Attributes are interpolated with perspective, float64, from the exact edge values of the snapped triangle
(D3D11.3 functional specification 3.4.1, 15.16.2): a = sum(E_i a_i / w_i) / sum(E_i / w_i).
"""

from enum import IntEnum

import numpy as np

from pipeline.jit import helper
from pipeline.primitives import BACK_FACE


class Shade(IntEnum):
    """What the pixel shader shows."""

    LAMBERT = 0
    NORMAL = 1
    PATCH = 2
    WIREFRAME = 3
    TILE_GRID = 4  # lambert; the tile machine then draws its grid over it


NORMAL, PATCH, WIREFRAME = int(Shade.NORMAL), int(Shade.PATCH), int(Shade.WIREFRAME)


@helper
def _to_byte(value):
    return np.uint8(min(max(value, 0.0), 1.0) * 255.0 + 0.5)


@helper
def _lit(nx, ny, nz, light):
    """Lambert, wrapped half way around so that shadow sides keep their form: 0.08 .. 1, linear."""
    wrapped = 0.5 + 0.5 * (nx * light[0] + ny * light[1] + nz * light[2])
    return 0.08 + 0.92 * wrapped * wrapped


@helper
def _patch_color(patch):
    """A light colour, different for neighbouring patch numbers: three bytes of an integer hash."""
    h = (np.uint32(patch) + np.uint32(1)) * np.uint32(2654435761)
    h ^= h >> np.uint32(15)
    h *= np.uint32(2246822519)
    h ^= h >> np.uint32(13)
    return (
        0.35 + 0.65 * np.float64(h & np.uint32(255)) / 255.0,
        0.35 + 0.65 * np.float64((h >> np.uint32(8)) & np.uint32(255)) / 255.0,
        0.35 + 0.65 * np.float64((h >> np.uint32(16)) & np.uint32(255)) / 255.0,
    )


@helper
def _line_distance(edges, e0, e1, e2, mask):
    """Distance in pixels from the pixel centre to the nearest tessellation edge of its triangle, at most 1."""
    nearest = 1.0
    for i in range(3):
        if mask & (1 << i):
            e = e0 if i == 0 else (e1 if i == 1 else e2)
            dx = np.float64(edges[i][0])
            dy = np.float64(edges[i][1])
            nearest = min(nearest, abs(np.float64(e)) / (256.0 * np.sqrt(dx * dx + dy * dy)))
    return nearest


@helper
def interpolate_normal(t, e0, e1, e2, triangles, window, normal):
    """Unit normal at edge values e0, e1, e2 of triangle t, turned to the viewer; zero where the surface has none."""
    a, b, c = triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2]
    q0 = np.float64(e0) / np.float64(window.w[a])
    q1 = np.float64(e1) / np.float64(window.w[b])
    q2 = np.float64(e2) / np.float64(window.w[c])
    q = q0 + q1 + q2
    x = (q0 * normal[0, a] + q1 * normal[0, b] + q2 * normal[0, c]) / q
    y = (q0 * normal[1, a] + q1 * normal[1, b] + q2 * normal[1, c]) / q
    z = (q0 * normal[2, a] + q1 * normal[2, b] + q2 * normal[2, c]) / q
    length = np.sqrt(x * x + y * y + z * z)
    if not (length > 0.0 and length < np.inf):
        return 0.0, 0.0, 0.0
    if triangles.edges[t] & BACK_FACE:
        length = -length
    return x / length, y / length, z / length


@helper
def shade(t, edges, e0, e1, e2, triangles, window, normal, shading, light):
    """Colour of triangle t at the pixel centre where its edge functions are e0, e1, e2: three bytes.

    edges : its edge functions as the rasterizer makes them, each beginning (dx, dy). light : unit vector to the light.
    Linear light is stored as its square root (a gamma of 2, which needs no transcendental function).
    """
    nx, ny, nz = interpolate_normal(t, e0, e1, e2, triangles, window, normal)
    if shading == NORMAL:
        return _to_byte(0.5 + 0.5 * nx), _to_byte(0.5 + 0.5 * ny), _to_byte(0.5 + 0.5 * nz)
    lit = _lit(nx, ny, nz, light)
    r, g, b = 0.82, 0.78, 0.71
    if shading == PATCH:
        r, g, b = _patch_color(triangles.patch[t])
    elif shading == WIREFRAME:
        lit *= 0.12 + 0.88 * _line_distance(edges, e0, e1, e2, triangles.edges[t])
    return _to_byte(np.sqrt(r * lit)), _to_byte(np.sqrt(g * lit)), _to_byte(np.sqrt(b * lit))
