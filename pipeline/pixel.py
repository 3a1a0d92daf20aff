"""Pixel shader: a few shadings that show what happens, for the triangle seen at a pixel, at the pixel's centre.

Attributes are interpolated with perspective, float64, from the exact edge values of the snapped triangle, and handed to
the shader as float32 (D3D11.3 functional specification 3.4.1, 15.16.2): a = sum(E_i a_i / w_i) / sum(E_i / w_i).

A run of fragments is interpolated and shaded together. Its rows lie in one scratch array at constant distances, so that the
arithmetic vectorizes (as in `pipeline.domain`); all rows of a run fit into the first level of a processor's cache. Loops go
over whole LANES: the caller pads a run with copies of its last fragment, so that no rest is left to a scalar loop.
"""

from enum import IntEnum

import numpy as np

from pipeline.jit import helper, inlined, unaliased
from pipeline.primitives import BACK_FACE


class Shade(IntEnum):
    """What the pixel shader shows."""

    LAMBERT = 0
    NORMAL = 1
    PATCH = 2
    WIREFRAME = 3
    TILE_GRID = 4  # lambert; the tile machine then draws its grid over it


NORMAL, PATCH, WIREFRAME = int(Shade.NORMAL), int(Shade.PATCH), int(Shade.WIREFRAME)

FRAGMENTS = 512  # most fragments of a run
LANES = 16  # a run is padded to a multiple of this, and FRAGMENTS is one
TRIANGLE, PIXEL = (k * FRAGMENTS for k in range(2))  # int32 rows: the triangle, and where it is seen, x + (y << 16)
A, B, C = (k * FRAGMENTS for k in range(2, 5))  # int32 rows: the triangle's vertices
NUMBERS = 5 * FRAGMENTS  # int32 entries of a run
RED, GREEN, BLUE = (k * FRAGMENTS for k in range(3))  # float32 rows: the surface's colour, 0 .. 1, where it is not CLAY
COLORS = 3 * FRAGMENTS
NX, NY, NZ = (k * FRAGMENTS for k in range(3))  # float32 rows: the normal
NORMALS = 3 * FRAGMENTS
SCRATCH = NUMBERS + COLORS + NORMALS + FRAGMENTS  # float32 entries that the caller provides

ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
BYTE = np.float32(255.0)
CLAY = (np.float32(0.80), np.float32(0.74), np.float32(0.64))
AMBIENT = (np.float32(0.03), np.float32(0.045), np.float32(0.075))  # bluish: shadows are cooler than lit sides
OPAQUE = np.uint32(255 << 24)


@inlined
def whole_lanes(n):
    """n, rounded up to a multiple of LANES."""
    return (n + (LANES - 1)) // LANES * LANES


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


@inlined
def pixel_of(numbers, k):
    """x and y of fragment k."""
    return numbers[PIXEL + k] & 0xFFFF, numbers[PIXEL + k] >> 16


@unaliased
def interpolate(n, numbers, vertex, flags, xs, ys, ws, nx, ny, nz, normals):
    """Normals of n fragments, in whole lanes, turned to the viewer: rows NX, NY, NZ of `normals`, of any length.

    numbers : int32[NUMBERS], of which rows TRIANGLE and PIXEL are given. vertex : int32, three to a triangle, flat; flags :
    uint8, `Triangles.edges`. xs, ys : int32, ws : float32, the window's vertices; nx, ny, nz : float32, their normals.
    normals : float32[NORMALS].

    Corners are taken relative to the pixel's centre: their differences and the edge values, at most 2^49, are exact. All
    that is loaded and stored is at most 32 bits wide, so that as many fragments are worked on at a time as a vector holds.
    Numbers are made unsigned: no index from the end. Vertices are looked up in a loop of their own: in one loop, a processor
    that waits for them from memory looks ahead at too few fragments.
    """
    for k in range(whole_lanes(n)):
        t = np.uint32(numbers[TRIANGLE + k])
        numbers[A + k], numbers[B + k], numbers[C + k] = vertex[3 * t], vertex[3 * t + 1], vertex[3 * t + 2]
    for k in range(whole_lanes(n)):
        t = np.uint32(numbers[TRIANGLE + k])
        a, b, c = np.uint32(numbers[A + k]), np.uint32(numbers[B + k]), np.uint32(numbers[C + k])
        x, y = pixel_of(numbers, k)
        x, y = (x << 8) + 128, (y << 8) + 128
        px, py = np.float64(np.int32(xs[a] - x)), np.float64(np.int32(ys[a] - y))
        qx, qy = np.float64(np.int32(xs[b] - x)), np.float64(np.int32(ys[b] - y))
        rx, ry = np.float64(np.int32(xs[c] - x)), np.float64(np.int32(ys[c] - y))
        e0, e1, e2 = qx * ry - qy * rx, rx * py - ry * px, px * qy - py * qx
        u, v, w = 1.0 / np.float64(ws[a]), 1.0 / np.float64(ws[b]), 1.0 / np.float64(ws[c])
        scale = 1.0 / ((e0 * u + e1 * v) + e2 * w)
        facing = -ONE if flags[t] & BACK_FACE else ONE
        normals[NX + k] = facing * np.float32(((e0 * (nx[a] * u) + e1 * (nx[b] * v)) + e2 * (nx[c] * w)) * scale)
        normals[NY + k] = facing * np.float32(((e0 * (ny[a] * u) + e1 * (ny[b] * v)) + e2 * (ny[c] * w)) * scale)
        normals[NZ + k] = facing * np.float32(((e0 * (nz[a] * u) + e1 * (nz[b] * v)) + e2 * (nz[c] * w)) * scale)


@inlined
def _unit(normals, k):
    """The normal of fragment k, unit; zero where there is none."""
    x, y, z = normals[NX + k], normals[NY + k], normals[NZ + k]
    length = np.sqrt((x * x + y * y) + z * z)
    scale = ONE / length if length > ZERO else ZERO
    return x * scale, y * scale, z * scale


@inlined
def _lit(normals, k, light):
    """Lambert, wrapped half way around and squared so that shadow sides keep their form."""
    x, y, z = _unit(normals, k)
    wrapped = HALF + HALF * ((x * light[0] + y * light[1]) + z * light[2])
    return wrapped * wrapped


@inlined
def _display(color, ambient, lit):
    """A channel as the square root of linear light (a gamma of 2, which needs no transcendental function)."""
    return np.sqrt(color * (ambient + (ONE - ambient) * lit))


@inlined
def _byte(channel):
    """0 .. 1 as 0 .. 255, rounded half up."""
    return np.uint32(np.int32(min(max(channel, ZERO), ONE) * BYTE + HALF))


@inlined
def _pixel(red, green, blue):
    """Channels 0 .. 1 as the four bytes RGBA of memory, lowest first."""
    return _byte(red) | (_byte(green) << np.uint32(8)) | (_byte(blue) << np.uint32(16)) | OPAQUE


@unaliased
def _show_normals(n, normals, pixels):
    for k in range(whole_lanes(n)):
        x, y, z = _unit(normals, k)
        pixels[k] = _pixel(HALF + HALF * x, HALF + HALF * y, HALF + HALF * z)


@unaliased
def _light_clay(n, light, normals, pixels):
    """As `_light`, where all is of one colour."""
    for k in range(whole_lanes(n)):
        lit = _lit(normals, k, light)
        red, green = _display(CLAY[0], AMBIENT[0], lit), _display(CLAY[1], AMBIENT[1], lit)
        pixels[k] = _pixel(red, green, _display(CLAY[2], AMBIENT[2], lit))


@unaliased
def _light(n, light, colors, normals, pixels):
    for k in range(whole_lanes(n)):
        lit = _lit(normals, k, light)
        red, green = _display(colors[RED + k], AMBIENT[0], lit), _display(colors[GREEN + k], AMBIENT[1], lit)
        pixels[k] = _pixel(red, green, _display(colors[BLUE + k], AMBIENT[2], lit))


@helper
def shade_fragments(n, shading, light, colors, normals, pixels):
    """Shade n fragments, in whole lanes: pixels, uint32[FRAGMENTS], RGBA.

    normals : as `interpolate` leaves them (any length; zero where there is none). colors : rows RED, GREEN, BLUE, read where
    `shading` is PATCH or WIREFRAME. light : unit vector to the light.
    """
    towards = (np.float32(light[0]), np.float32(light[1]), np.float32(light[2]))
    if shading == NORMAL:
        _show_normals(n, normals, pixels)
    elif shading in (PATCH, WIREFRAME):
        _light(n, towards, colors, normals, pixels)
    else:
        _light_clay(n, towards, normals, pixels)
