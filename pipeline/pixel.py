"""Pixel shader: a few shadings that show what happens, for the triangle seen at a pixel, at the pixel's centre.

Attributes are interpolated with perspective, float64, from the exact edge values of the snapped triangle, and handed to
the shader as float32 (D3D11.3 functional specification 3.4.1, 15.16.2): a = sum(E_i a_i / w_i) / sum(E_i / w_i).

A run of fragments is interpolated and shaded together. Its rows lie in one scratch array at constant distances, so that the
arithmetic vectorizes (as in `pipeline.domain`); all rows of a run fit into the first level of a processor's cache.
"""

from enum import IntEnum

import numpy as np

from pipeline.jit import helper


class Shade(IntEnum):
    """What the pixel shader shows."""

    LAMBERT = 0
    NORMAL = 1
    PATCH = 2
    WIREFRAME = 3
    TILE_GRID = 4  # lambert; the tile machine then draws its grid over it


NORMAL, PATCH, WIREFRAME = int(Shade.NORMAL), int(Shade.PATCH), int(Shade.WIREFRAME)

FRAGMENTS = 64  # most fragments of a run
NX, NY, NZ, RED, GREEN, BLUE = (k * FRAGMENTS for k in range(6))
WA, WB, WC = (k * FRAGMENTS for k in range(6, 9))  # corners: clip-space w, and normals, component by component
NAX, NAY, NAZ, NBX, NBY, NBZ, NCX, NCY, NCZ = (k * FRAGMENTS for k in range(9, 18))
E0, E1, E2 = (
    k * FRAGMENTS for k in range(9, 12)
)  # edge functions: rows of the scratch's float64 view, behind the others
SCRATCH = 24 * FRAGMENTS  # float32 entries that the caller provides, on an address that is a multiple of 8

ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
BYTE = np.float32(255.0)
CLAY = (np.float32(0.80), np.float32(0.74), np.float32(0.64))
AMBIENT = (np.float32(0.03), np.float32(0.045), np.float32(0.075))  # bluish: shadows are cooler than lit sides


@helper
def _light_shade(byte):
    return np.float32(0.35 + 0.65 / 255.0 * np.float64(byte))


@helper
def patch_color(patch):
    """A light colour, different for neighbouring patch numbers: three bytes of an integer hash."""
    h = ((np.int64(patch) + 1) * 0x9E3779B1) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x45D9F3B) & 0xFFFFFFFF
    h ^= h >> 13
    return _light_shade(h & 255), _light_shade((h >> 8) & 255), _light_shade((h >> 16) & 255)


@helper
def _edge_distance(edge, e):
    """Distance in pixels from a point to an edge, from the edge function's value there."""
    dx, dy = np.float64(edge[0]), np.float64(edge[1])
    return abs(np.float64(e)) / (256.0 * np.sqrt(dx * dx + dy * dy))


@helper
def line_darkening(edges, e0, e1, e2, mask):
    """0.12 on a tessellation edge to 1 from a pixel's distance on. mask : bit i, edge i is the tessellation's."""
    nearest = 1.0
    if mask & 1:
        nearest = min(nearest, _edge_distance(edges[0], e0))
    if mask & 2:
        nearest = min(nearest, _edge_distance(edges[1], e1))
    if mask & 4:
        nearest = min(nearest, _edge_distance(edges[2], e2))
    return np.float32(0.12 + 0.88 * nearest)


@helper
def interpolate(n, s, edges):
    """Normals of n fragments from those of their triangles' corners: rows NX, NY, NZ of scratch s from WA .. NCZ and E0 .. E2.

    edges : the float64 view of s.
    """
    for k in range(n):
        e0, e1, e2 = edges[E0 + k], edges[E1 + k], edges[E2 + k]
        a, b, c = 1.0 / np.float64(s[WA + k]), 1.0 / np.float64(s[WB + k]), 1.0 / np.float64(s[WC + k])
        scale = 1.0 / ((e0 * a + e1 * b) + e2 * c)
        s[NX + k] = ((e0 * (s[NAX + k] * a) + e1 * (s[NBX + k] * b)) + e2 * (s[NCX + k] * c)) * scale
        s[NY + k] = ((e0 * (s[NAY + k] * a) + e1 * (s[NBY + k] * b)) + e2 * (s[NCY + k] * c)) * scale
        s[NZ + k] = ((e0 * (s[NAZ + k] * a) + e1 * (s[NBZ + k] * b)) + e2 * (s[NCZ + k] * c)) * scale


@helper
def _to_bytes(s, row, n):
    """A row of 0 .. 1 as 0.5 .. 255.5: the integer part is the byte."""
    for k in range(n):
        s[row + k] = min(max(s[row + k], ZERO), ONE) * BYTE + HALF


@helper
def _unit_normals(s, n):
    for k in range(n):
        x, y, z = s[NX + k], s[NY + k], s[NZ + k]
        length = np.sqrt((x * x + y * y) + z * z)
        scale = ONE / length if length > ZERO else ZERO
        s[NX + k], s[NY + k], s[NZ + k] = x * scale, y * scale, z * scale


@helper
def _show_normals(s, n):
    for k in range(n):
        s[RED + k] = HALF + HALF * s[NX + k]
        s[GREEN + k] = HALF + HALF * s[NY + k]
        s[BLUE + k] = HALF + HALF * s[NZ + k]


@helper
def _light(light, s, n):
    """Lambert, wrapped half way around and squared so that shadow sides keep their form; stored as the square root of
    linear light (a gamma of 2, which needs no transcendental function)."""
    lx, ly, lz = np.float32(light[0]), np.float32(light[1]), np.float32(light[2])
    for k in range(n):
        wrapped = HALF + HALF * ((s[NX + k] * lx + s[NY + k] * ly) + s[NZ + k] * lz)
        lit = wrapped * wrapped
        s[RED + k] = np.sqrt(s[RED + k] * (AMBIENT[0] + (ONE - AMBIENT[0]) * lit))
        s[GREEN + k] = np.sqrt(s[GREEN + k] * (AMBIENT[1] + (ONE - AMBIENT[1]) * lit))
        s[BLUE + k] = np.sqrt(s[BLUE + k] * (AMBIENT[2] + (ONE - AMBIENT[2]) * lit))


@helper
def shade_fragments(n, shading, light, s):
    """Shade the n fragments of scratch s, in place.

    In: rows NX, NY, NZ, the interpolated normal (any length, turned to the viewer; zero where there is none), and RED,
    GREEN, BLUE, the surface's colour, 0 .. 1. Out: RED, GREEN, BLUE, 0.5 .. 255.5. light : unit vector to the light.
    """
    _unit_normals(s, n)
    if shading == NORMAL:
        _show_normals(s, n)
    else:
        _light(light, s, n)
    _to_bytes(s, RED, n)
    _to_bytes(s, GREEN, n)
    _to_bytes(s, BLUE, n)
