"""Shading of a tile, after its triangles are rasterized: only what is seen is shaded, once for each pixel and triangle.

The counters say what the modelled machine shades (it does not know what will be hidden); the colours are the same.

The fragments of several rows of pixels are listed first; then each step of the pixel shader runs over the whole list.
"""

import numpy as np

from pipeline import pixel
from pipeline.jit import helper, inlined
from pipeline.pixel import (
    BLUE,
    CLAY,
    FACING,
    FRAGMENTS,
    GREEN,
    NORMALS,
    NUMBERS,
    ONE,
    PATCH,
    PLACE,
    RED,
    TRIANGLE,
    VALUES,
    WIREFRAME,
    A,
    B,
    C,
    X,
    Y,
    interpolate,
    line_darkening,
    patch_color,
    shade_fragments,
    whole_lanes,
)
from pipeline.primitives import BACK_FACE

STRETCH = FRAGMENTS // 2  # most samples that are listed at a time


@inlined
def _shows(visible, begin, end):
    """Whether a triangle is seen at any of these samples. A loop that vectorizes: most rows of a batch show nothing."""
    most = np.int32(-1)
    for k in range(begin, end):
        most = max(most, visible[k])
    return most >= 0


@inlined
def _append(t, place, x, y, vertex, flags, n, numbers, values):
    """List pixel (x, y), number `place` of the picture, where triangle t is seen, as fragment n."""
    k, corner = np.uint32(n), np.uint64(t) * np.uint64(3)  # unsigned: no index from the end
    numbers[A + k] = vertex[corner]
    numbers[B + k] = vertex[corner + np.uint64(1)]
    numbers[C + k] = vertex[corner + np.uint64(2)]
    numbers[X + k], numbers[Y + k] = x, y
    numbers[TRIANGLE + k], numbers[PLACE + k] = t, place
    values[FACING + k] = -ONE if flags[t] & BACK_FACE else ONE


@inlined
def _list(y, x0, x1, width, samples, visible, vertex, flags, n, numbers, values):
    """List the fragments of pixels x0..x1 of row y behind the n that are listed; the number of all.

    A pixel has one for each run of its samples that show the same triangle. visible, vertex : flat.
    """
    row = y * width
    if samples == 1:
        for x in range(x0, x1 + 1):
            t = visible[np.uint32(row + x)]
            if t >= 0:
                _append(t, row + x, x, y, vertex, flags, n, numbers, values)
                n += 1
        return n
    for x in range(x0, x1 + 1):
        before = np.int32(-1)
        for k in range(samples):
            t = visible[(row + x) * samples + k]
            if t >= 0 and t != before:
                _append(t, row + x, x, y, vertex, flags, n, numbers, values)
                n += 1
            before = t
    return n


@helper
def _pad(n, numbers, values):
    """Fill whole lanes with copies of the last fragment, whose vertices are there to be read."""
    for k in range(n, whole_lanes(n)):
        for row in (A, B, C, X, Y):
            numbers[row + k] = numbers[row + n - 1]
        values[FACING + k] = values[FACING + n - 1]
        values[RED + k], values[GREEN + k], values[BLUE + k] = ONE, ONE, ONE


@helper
def _tint(n, shading, triangles, window, numbers, values):
    """The surface's colour at n fragments, where not all are of one: rows RED, GREEN, BLUE."""
    for k in range(n):
        t = numbers[TRIANGLE + k]
        red, green, blue = CLAY
        if shading == PATCH:
            red, green, blue = patch_color(triangles.patch[t])
        line = ONE
        if shading == WIREFRAME:
            a, b, c = numbers[A + k], numbers[B + k], numbers[C + k]
            xa, ya = np.int64(window.x[a]), np.int64(window.y[a])
            xb, yb = np.int64(window.x[b]), np.int64(window.y[b])
            xc, yc = np.int64(window.x[c]), np.int64(window.y[c])
            x, y = (np.int64(numbers[X + k]) << 8) + 128, (np.int64(numbers[Y + k]) << 8) + 128
            e0 = (xc - xb) * (y - yb) - (yc - yb) * (x - xb)
            e1 = (xa - xc) * (y - yc) - (ya - yc) * (x - xc)
            e2 = (xb - xa) * (y - ya) - (yb - ya) * (x - xa)
            sides = (xc - xb, yc - yb), (xa - xc, ya - yc), (xb - xa, yb - ya)
            line = line_darkening(sides, e0, e1, e2, triangles.edges[t])
        values[RED + k], values[GREEN + k], values[BLUE + k] = red * line, green * line, blue * line


@helper
def _store(n, samples, visible, numbers, pixels, color):
    """Store the colours of n fragments in the samples that show them. color : uint32, flat."""
    if samples == 1:
        for k in range(n):
            color[np.uint32(numbers[PLACE + k])] = pixels[k]
        return
    for k in range(n):
        first = np.int64(numbers[PLACE + k]) * samples
        for s in range(first, first + samples):
            if visible[s] == numbers[TRIANGLE + k]:
                color[s] = pixels[k]


@helper
def _shade(n, triangles, window, normal, shading, light, samples, visible, color, numbers, values, normals, pixels):
    """Shade the n fragments that are listed."""
    if shading in (PATCH, WIREFRAME):
        _tint(n, shading, triangles, window, numbers, values)
    _pad(n, numbers, values)
    interpolate(n, numbers, values, window.x, window.y, window.w, normal[0], normal[1], normal[2], normals)
    shade_fragments(n, shading, light, values, normals, pixels)
    _store(n, samples, visible, numbers, pixels, color)


@helper
def shade_tile(rect, triangles, window, normal, shading, light, target, scratch):
    """Shade every pixel of rect = (x0, y0, x1, y1), inclusive, where a triangle of this batch is seen.

    normal : float32[3, V] of the window's vertices. shading : pixel.Shade. light : unit vector to the light, world
    space. scratch : float32[pixel.SCRATCH]. `target.color` is modified in place.
    """
    width, samples = target.visible.shape[1:]
    visible, color = target.visible.ravel(), target.color.view(np.uint32).ravel()
    vertex, flags = triangles.vertex.ravel(), triangles.edges
    numbers, values = scratch[:NUMBERS].view(np.int32), scratch[NUMBERS : NUMBERS + VALUES]
    normals = scratch[NUMBERS + VALUES : NUMBERS + VALUES + NORMALS]
    pixels = scratch[NUMBERS + VALUES + NORMALS : pixel.SCRATCH].view(np.uint32)
    stretch = STRETCH // samples  # pixels
    n = 0
    for y in range(rect[1], rect[3] + 1):
        if not _shows(visible, (y * width + rect[0]) * samples, (y * width + rect[2] + 1) * samples):
            continue
        for x0 in range(rect[0], rect[2] + 1, stretch):
            x1 = min(x0 + stretch - 1, rect[2])
            if n + (x1 - x0 + 1) * samples > FRAGMENTS:
                _shade(
                    n, triangles, window, normal, shading, light, samples, visible, color, numbers, values, normals, pixels
                )  # fmt: skip
                n = 0
            n = _list(y, x0, x1, width, samples, visible, vertex, flags, n, numbers, values)
    if n > 0:
        _shade(n, triangles, window, normal, shading, light, samples, visible, color, numbers, values, normals, pixels)
