"""Shading of a tile, after its triangles are rasterized: only what is seen is shaded, once for each pixel and triangle.

The counters say what the modelled machine shades (it does not know what will be hidden); the colours are the same.

The fragments of several rows of pixels are listed first; then each step of the pixel shader runs over the whole list.
"""

import numpy as np

from pipeline import pixel
from pipeline.compact import compact, lanes_of
from pipeline.jit import helper, inlined
from pipeline.pixel import (
    BLUE,
    CLAY,
    COLORS,
    FRAGMENTS,
    GREEN,
    NORMALS,
    NUMBERS,
    ONE,
    PATCH,
    PIXEL,
    RED,
    TRIANGLE,
    WIREFRAME,
    A,
    interpolate,
    line_darkening,
    patch_color,
    pixel_of,
    shade_fragments,
    whole_lanes,
)

STRETCH = FRAGMENTS // 2  # most samples that are listed at a time
VECTOR = lanes_of(32)
SEEN = A  # row of a list in the making: whether a pixel shows something


@inlined
def _shows(visible, begin, end):
    """Whether a triangle is seen at any of these samples. A loop that vectorizes: most rows of a batch show nothing."""
    most, row = np.int32(-1), visible[begin:end]  # of a part, no index is from the end
    for k in range(len(row)):
        most = max(most, row[k])
    return most >= 0


@inlined
def _list(y, x0, x1, width, samples, visible, n, numbers):
    """List the fragments of pixels x0..x1 of row y behind the n that are listed; the number of all.

    A pixel has one for each run of its samples that show the same triangle. With one sample all pixels are written, and those
    kept that show something. With more each sample is written, and the next over it if it shows nothing new: without a branch,
    which would be foreseen badly at outlines.
    """
    row, high = y * width, y << 16
    if samples == 1:
        shown, end = visible[row + x0 : row + x1 + 1], n + (x1 - x0 + 1)
        triangle, pixel, seen = (
            numbers[TRIANGLE + n : TRIANGLE + end], numbers[PIXEL + n : PIXEL + end], numbers[SEEN + n : SEEN + end],
        )  # fmt: skip
        for k in range(len(shown)):
            triangle[k], pixel[k], seen[k] = shown[k], high + x0 + k, np.int32(shown[k] >= 0)
        return n + compact(numbers, SEEN, n, end, n, (TRIANGLE, PIXEL))
    place = np.uint32(n)  # unsigned: no index from the end
    for x in range(x0, x1 + 1):
        before = np.int32(-1)
        for s in range(samples):
            t = visible[(row + x) * samples + s]
            numbers[TRIANGLE + place], numbers[PIXEL + place] = t, high + x
            place = np.uint32(place + (t >= 0 and t != before))
            before = t
    return np.int64(place)


@helper
def _pad(n, numbers):
    """Fill whole lanes with copies of the last fragment, whose vertices are there to be read."""
    for k in range(n, whole_lanes(n)):
        numbers[TRIANGLE + k], numbers[PIXEL + k] = numbers[TRIANGLE + n - 1], numbers[PIXEL + n - 1]


@helper
def _tint(n, shading, triangles, window, numbers, colors):
    """The surface's colour at n fragments, where not all are of one: rows RED, GREEN, BLUE."""
    for k in range(n):
        t = numbers[TRIANGLE + k]
        red, green, blue = CLAY
        if shading == PATCH:
            red, green, blue = patch_color(triangles.patch[t])
        line = ONE
        if shading == WIREFRAME:
            a, b, c = triangles.vertex[t, 0], triangles.vertex[t, 1], triangles.vertex[t, 2]
            xa, ya = np.int64(window.x[a]), np.int64(window.y[a])
            xb, yb = np.int64(window.x[b]), np.int64(window.y[b])
            xc, yc = np.int64(window.x[c]), np.int64(window.y[c])
            x, y = pixel_of(numbers, k)
            x, y = (np.int64(x) << 8) + 128, (np.int64(y) << 8) + 128
            e0 = (xc - xb) * (y - yb) - (yc - yb) * (x - xb)
            e1 = (xa - xc) * (y - yc) - (ya - yc) * (x - xc)
            e2 = (xb - xa) * (y - ya) - (yb - ya) * (x - xa)
            sides = (xc - xb, yc - yb), (xa - xc, ya - yc), (xb - xa, yb - ya)
            line = line_darkening(sides, e0, e1, e2, triangles.edges[t])
        colors[RED + k], colors[GREEN + k], colors[BLUE + k] = red * line, green * line, blue * line


@helper
def _store(n, width, samples, visible, numbers, pixels, color):
    """Store the colours of n fragments in the samples that show them. color : uint32, flat."""
    for k in range(n):
        x, y = pixel_of(numbers, k)
        if samples == 1:
            color[np.uint32(y * width + x)] = pixels[k]
            continue
        first = (y * width + x) * samples
        for s in range(first, first + samples):
            if visible[s] == numbers[TRIANGLE + k]:
                color[s] = pixels[k]


@helper
def _shade(
    n, triangles, vertex, window, normal, shading, light, width, samples, visible, color, numbers, colors, normals, pixels
):  # fmt: skip
    """Shade the n fragments that are listed."""
    _pad(n, numbers)
    if shading in (PATCH, WIREFRAME):
        _tint(whole_lanes(n), shading, triangles, window, numbers, colors)
    interpolate(
        n, numbers, vertex, triangles.edges, window.x, window.y, window.w, normal[0], normal[1], normal[2], normals
    )  # fmt: skip
    shade_fragments(n, shading, light, colors, normals, pixels)
    _store(n, width, samples, visible, numbers, pixels, color)


@helper
def shade_tile(rect, triangles, window, normal, shading, light, target, scratch):
    """Shade every pixel of rect = (x0, y0, x1, y1), inclusive, where a triangle of this batch is seen.

    normal : float32[3, V] of the window's vertices. shading : pixel.Shade. light : unit vector to the light, world
    space. scratch : float32[pixel.SCRATCH]. `target.color` is modified in place.
    """
    width, samples = target.visible.shape[1:]
    visible, color = target.visible.ravel(), target.color.view(np.uint32).ravel()
    vertex = triangles.vertex.ravel()
    numbers, colors = scratch[:NUMBERS].view(np.int32), scratch[NUMBERS : NUMBERS + COLORS]
    normals = scratch[NUMBERS + COLORS : NUMBERS + COLORS + NORMALS]
    pixels = scratch[NUMBERS + COLORS + NORMALS : pixel.SCRATCH].view(np.uint32)
    stretch = STRETCH // samples  # pixels
    n = 0
    for y in range(rect[1], rect[3] + 1):
        if not _shows(visible, (y * width + rect[0]) * samples, (y * width + rect[2] + 1) * samples):
            continue
        for x0 in range(rect[0], rect[2] + 1, stretch):
            x1 = min(x0 + stretch - 1, rect[2])
            if n + (x1 - x0 + 1) * samples + VECTOR > FRAGMENTS:  # a vector may be written behind the last
                _shade(
                    n, triangles, vertex, window, normal, shading, light, width, samples, visible, color, numbers, colors,
                    normals, pixels,
                )  # fmt: skip
                n = 0
            n = _list(y, x0, x1, width, samples, visible, n, numbers)
    if n > 0:
        _shade(
            n, triangles, vertex, window, normal, shading, light, width, samples, visible, color, numbers, colors, normals,
            pixels,
        )  # fmt: skip
