"""Shading of a tile, after its triangles are rasterized: only what is seen is shaded, once for each pixel and triangle.

The counters say what the modelled machine shades (it does not know what will be hidden); the colours are the same.
"""

import numpy as np

from pipeline import pixel
from pipeline.jit import helper
from pipeline.pixel import BLUE, GREEN, NX, NY, NZ, PATCH, RED, WIREFRAME, line_darkening, patch_color, shade_fragments
from pipeline.primitives import BACK_FACE
from tiler.rasterizer import triangle_edges


@helper
def _weighted_normal(t, corner, sign, triangles, window, normal):
    """Normal of a corner of triangle t over its w, and 1 / w: what perspective interpolation adds up."""
    v = triangles.vertex[t, corner]
    over_w = 1.0 / np.float64(window.w[v])
    scale = sign * over_w
    return normal[0, v] * scale, normal[1, v] * scale, normal[2, v] * scale, over_w


@helper
def _gather_row(y, x0, x1, triangles, window, normal, shading, target, s):
    """Interpolate the attributes of every fragment of row y into scratch s; their number."""
    n = 0
    last = np.int32(-1)
    none = (np.int64(0), np.int64(0), np.int64(0), np.int64(0))
    edges = (none, none, none)
    a = b = c = (0.0, 0.0, 0.0, 0.0)
    red, green, blue = pixel.CLAY
    for x in range(x0, x1 + 1):
        before = np.int32(-1)
        for k in range(target.visible.shape[2]):
            t = target.visible[y, x, k]
            if t < 0 or t == before:
                before = t
                continue
            before = t
            if t != last:
                last = t
                edges = triangle_edges(window, triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2])[
                    0
                ]
                sign = -1.0 if triangles.edges[t] & BACK_FACE else 1.0
                a = _weighted_normal(t, 0, sign, triangles, window, normal)
                b = _weighted_normal(t, 1, sign, triangles, window, normal)
                c = _weighted_normal(t, 2, sign, triangles, window, normal)
                if shading == PATCH:
                    red, green, blue = patch_color(triangles.patch[t])
            e0 = edges[0][2] + ((edges[0][0] * y - edges[0][1] * x) << 8)
            e1 = edges[1][2] + ((edges[1][0] * y - edges[1][1] * x) << 8)
            e2 = edges[2][2] + ((edges[2][0] * y - edges[2][1] * x) << 8)
            f0, f1, f2 = np.float64(e0), np.float64(e1), np.float64(e2)
            scale = 1.0 / ((f0 * a[3] + f1 * b[3]) + f2 * c[3])
            s[NX + n] = ((f0 * a[0] + f1 * b[0]) + f2 * c[0]) * scale
            s[NY + n] = ((f0 * a[1] + f1 * b[1]) + f2 * c[1]) * scale
            s[NZ + n] = ((f0 * a[2] + f1 * b[2]) + f2 * c[2]) * scale
            line = line_darkening(edges, e0, e1, e2, triangles.edges[t]) if shading == WIREFRAME else pixel.ONE
            s[RED + n], s[GREEN + n], s[BLUE + n] = red * line, green * line, blue * line
            n += 1
    return n


@helper
def _scatter_row(y, x0, x1, target, s):
    """Store the colours of row y's fragments in the samples that show them, in the order of `_gather_row`."""
    n = -1
    for x in range(x0, x1 + 1):
        before = np.int32(-1)
        for k in range(target.visible.shape[2]):
            t = target.visible[y, x, k]
            if t >= 0:
                if t != before:
                    n += 1
                target.color[y, x, k, 0] = np.uint8(s[RED + n])
                target.color[y, x, k, 1] = np.uint8(s[GREEN + n])
                target.color[y, x, k, 2] = np.uint8(s[BLUE + n])
            before = t


@helper
def shade_tile(rect, triangles, window, normal, shading, light, target, scratch):
    """Shade every pixel of rect = (x0, y0, x1, y1), inclusive, where a triangle of this batch is seen.

    normal : float32[3, V] of the window's vertices. shading : pixel.Shade. light : unit vector to the light, world
    space. scratch : float32[pixel.SCRATCH]. `target.color` is modified in place.
    """
    for y in range(rect[1], rect[3] + 1):
        n = _gather_row(y, rect[0], rect[2], triangles, window, normal, shading, target, scratch)
        if n > 0:
            shade_fragments(n, shading, light, scratch)
            _scatter_row(y, rect[0], rect[2], target, scratch)
