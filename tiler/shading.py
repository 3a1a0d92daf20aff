"""Shading of a tile, after its triangles are rasterized: only what is seen is shaded, once for each pixel and triangle.

The counters say what the modelled machine shades (it does not know what will be hidden); the colours are the same.
"""

import numpy as np

from pipeline import pixel
from pipeline.jit import helper, inlined
from pipeline.pixel import (
    BLUE,
    E0,
    E1,
    E2,
    FRAGMENTS,
    GREEN,
    NAX,
    NAY,
    NAZ,
    NBX,
    NBY,
    NBZ,
    NCX,
    NCY,
    NCZ,
    PATCH,
    RED,
    WA,
    WB,
    WC,
    WIREFRAME,
    interpolate,
    line_darkening,
    patch_color,
    shade_fragments,
)
from pipeline.primitives import BACK_FACE


@inlined
def _gather(y, x0, x1, triangles, window, normal, shading, target, s, edges):
    """Put what the fragments of pixels x0..x1 of row y are interpolated from into scratch s; their number.

    The normals of a back face are turned to the viewer. edges : the float64 view of s.
    """
    visible, vertex, flags = target.visible, triangles.vertex, triangles.edges
    xs, ys, ws = window.x, window.y, window.w
    n = 0
    last = np.int32(-1)
    red, green, blue = pixel.CLAY
    line = pixel.ONE
    xa = ya = xb = yb = xc = yc = np.int64(0)
    wa = wb = wc = nax = nay = naz = nbx = nby = nbz = ncx = ncy = ncz = pixel.ZERO
    cy = (np.int64(y) << 8) + 128
    for x in range(x0, x1 + 1):
        cx = (np.int64(x) << 8) + 128
        before = np.int32(-1)
        for k in range(visible.shape[2]):
            t = visible[y, x, k]
            if t < 0 or t == before:
                before = t
                continue
            before = t
            if t != last:
                last = t
                a, b, c = (
                    np.uint32(vertex[t, 0]),
                    np.uint32(vertex[t, 1]),
                    np.uint32(vertex[t, 2]),
                )  # no index from the end
                xa, ya, wa = np.int64(xs[a]), np.int64(ys[a]), ws[a]
                xb, yb, wb = np.int64(xs[b]), np.int64(ys[b]), ws[b]
                xc, yc, wc = np.int64(xs[c]), np.int64(ys[c]), ws[c]
                sign = -pixel.ONE if flags[t] & BACK_FACE else pixel.ONE
                nax, nay, naz = sign * normal[0, a], sign * normal[1, a], sign * normal[2, a]
                nbx, nby, nbz = sign * normal[0, b], sign * normal[1, b], sign * normal[2, b]
                ncx, ncy, ncz = sign * normal[0, c], sign * normal[1, c], sign * normal[2, c]
                if shading == PATCH:
                    red, green, blue = patch_color(triangles.patch[t])
            e0 = (xc - xb) * (cy - yb) - (yc - yb) * (cx - xb)
            e1 = (xa - xc) * (cy - yc) - (ya - yc) * (cx - xc)
            e2 = (xb - xa) * (cy - ya) - (yb - ya) * (cx - xa)
            edges[E0 + n], edges[E1 + n], edges[E2 + n] = e0, e1, e2
            s[WA + n], s[WB + n], s[WC + n] = wa, wb, wc
            s[NAX + n], s[NAY + n], s[NAZ + n] = nax, nay, naz
            s[NBX + n], s[NBY + n], s[NBZ + n] = nbx, nby, nbz
            s[NCX + n], s[NCY + n], s[NCZ + n] = ncx, ncy, ncz
            if shading == WIREFRAME:
                sides = (xc - xb, yc - yb), (xa - xc, ya - yc), (xb - xa, yb - ya)
                line = line_darkening(sides, e0, e1, e2, flags[t])
            s[RED + n], s[GREEN + n], s[BLUE + n] = red * line, green * line, blue * line
            n += 1
    return n


@inlined
def _scatter(y, x0, x1, target, s):
    """Store the colours of these pixels' fragments in the samples that show them, in the order of `_gather`."""
    visible, color = target.visible, target.color
    n = -1
    for x in range(x0, x1 + 1):
        before = np.int32(-1)
        for k in range(visible.shape[2]):
            t = visible[y, x, k]
            if t >= 0:
                if t != before:
                    n += 1
                color[y, x, k, 0] = np.uint8(s[RED + n])
                color[y, x, k, 1] = np.uint8(s[GREEN + n])
                color[y, x, k, 2] = np.uint8(s[BLUE + n])
            before = t


@helper
def shade_tile(rect, triangles, window, normal, shading, light, target, scratch):
    """Shade every pixel of rect = (x0, y0, x1, y1), inclusive, where a triangle of this batch is seen.

    normal : float32[3, V] of the window's vertices. shading : pixel.Shade. light : unit vector to the light, world
    space. scratch : float32[pixel.SCRATCH]. `target.color` is modified in place.
    """
    edges = scratch.view(np.float64)
    run = FRAGMENTS // target.visible.shape[2]  # pixels
    for y in range(rect[1], rect[3] + 1):
        for x0 in range(rect[0], rect[2] + 1, run):
            x1 = min(x0 + run - 1, rect[2])
            n = _gather(y, x0, x1, triangles, window, normal, shading, target, scratch, edges)
            if n > 0:
                interpolate(n, scratch, edges)
                shade_fragments(n, shading, light, scratch)
                _scatter(y, x0, x1, target, scratch)
