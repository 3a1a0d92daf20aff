"""Slow twins of pipeline/primitives.py and of the depth test: one triangle, one sample at a time, from spec sections 1 to 6.

Clipping is in float64 from float32 vertices, every cut from the inside vertex; its corners are rounded to float32 once.
"""

from typing import NamedTuple

import numpy as np

from tests.naive import SAMPLE_OFFSETS, naive_snap

F = np.float32
GRID = 256  # 16.8 fixed point


class Corner(NamedTuple):
    values: tuple[float, ...]  # x, y, z, w in clip space, then the attributes
    edge: int | None  # the triangle's edge (number of its first vertex) that leads to the next corner; None: a cut


class WindowVertex(NamedTuple):
    x: int  # 16.8 fixed point
    y: int
    z: np.float32
    w: np.float32
    attributes: tuple[float, ...]


class NaiveTriangle(NamedTuple):
    """A triangle that goes on to binning, clockwise."""

    vertices: tuple[WindowVertex, WindowVertex, WindowVertex]
    box: tuple[int, int, int, int]  # first column, first row, last column, last row with a sample
    edges: tuple[bool, bool, bool]  # whether edge i, opposite vertex i, is one of the tessellation's
    back: bool


def naive_planes(viewport):
    """Functions of (x, y, z, w), inside where >= 0: near, far, left, right, top, bottom guard."""
    left, top, width, height = viewport.left, viewport.top, viewport.width, viewport.height
    to_left, to_right = (-32768 - left) * 2 / width - 1, (32767 - left) * 2 / width - 1
    to_top, to_bottom = 1 - (-32768 - top) * 2 / height, 1 - (32767 - top) * 2 / height
    return [
        lambda x, y, z, w: z,
        lambda x, y, z, w: w - z,
        lambda x, y, z, w: x - to_left * w,
        lambda x, y, z, w: to_right * w - x,
        lambda x, y, z, w: to_top * w - y,
        lambda x, y, z, w: y - to_bottom * w,
    ]


def outside_frustum(x, y, z, w):
    """For each plane of the true frustum, whether the vertex is outside."""
    return [x < -w, x > w, y < -w, y > w, z < 0 or w <= 0, z > w]


def needs_clipping(vertex, planes):
    x, y, z, w = vertex
    return z < 0 or w <= 0 or z > w or any(plane(x, y, z, w) < 0 for plane in planes[2:])


def cut_edge(inside, outside, plane):
    """Where the edge meets the plane, starting from its inside end."""
    d_in, d_out = plane(*inside[:4]), plane(*outside[:4])
    t = d_in / (d_in - d_out)
    return tuple(a + t * (b - a) for a, b in zip(inside, outside, strict=True))


def cut_polygon(polygon, plane):
    result = []
    for k, (values, edge) in enumerate(polygon):
        following = polygon[(k + 1) % len(polygon)].values
        here, there = plane(*values[:4]) >= 0, plane(*following[:4]) >= 0
        if here:
            result.append(Corner(values, edge))
        if here and not there:
            result.append(Corner(cut_edge(values, following, plane), None))
        if there and not here:
            result.append(Corner(cut_edge(following, values, plane), edge))
    return result


def naive_clip(vertices, planes):
    """Corners of the triangle's polygon inside all planes. vertices: three tuples of floats."""
    polygon = [Corner(tuple(float(a) for a in vertex), k) for k, vertex in enumerate(vertices)]
    for plane in planes:
        polygon = cut_polygon(polygon, plane)
    return polygon


def naive_cut_segment(a, b, planes):
    """The ends that clipping leaves of the segment, or None."""
    for plane in planes:
        at_a, at_b = plane(*a[:4]) >= 0, plane(*b[:4]) >= 0
        if not at_a and not at_b:
            return None
        if at_a != at_b:
            a, b = (a, cut_edge(a, b, plane)) if at_a else (cut_edge(b, a, plane), b)
    return a, b


def naive_window(values, viewport):
    """Divide, viewport transform, snap; None where a coordinate is not finite. values: float32."""
    x, y, z, w = (F(a) for a in values[:4])
    x_win = (x / w + F(1)) * F(viewport.width) * F(0.5) + F(viewport.left)
    y_win = (F(1) - y / w) * F(viewport.height) * F(0.5) + F(viewport.top)
    z_win = F(viewport.min_depth) + z / w * (F(viewport.max_depth) - F(viewport.min_depth))
    if not np.isfinite([x_win, y_win, z_win]).all():
        return None
    return WindowVertex(naive_snap(float(x_win)), naive_snap(float(y_win)), z_win, w, tuple(F(a) for a in values[4:]))


def twice_area(a, b, c):
    """Positive where clockwise on the screen (y down)."""
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)


def naive_set_up(vertices, edges, viewport, reach, cull):
    """Outcome of a window triangle, by name, and the NaiveTriangle where it is SETUP. reach: of the samples, 1/256 pixel."""
    area = twice_area(*vertices)
    if area == 0:
        return "ZERO_AREA", None
    back = area < 0
    if cull == ("BACK" if back else "FRONT"):
        return "FACE", None
    if back:
        a, b, c = vertices
        vertices, edges = (a, c, b), (edges[0], edges[2], edges[1])
    box = []
    for axis in ("x", "y"):
        low, high = (f(getattr(v, axis) for v in vertices) for f in (min, max))
        # A pixel's samples reach from 128 - reach to 128 + reach inside of it.
        box.append((-((128 + reach - low) // GRID), (high - 128 + reach) // GRID))
    (x0, x1), (y0, y1) = box
    if x0 > x1 or y0 > y1:
        return "NO_SAMPLE", None
    x0, x1 = max(x0, viewport.left), min(x1, viewport.left + viewport.width - 1)
    y0, y1 = max(y0, viewport.top), min(y1, viewport.top + viewport.height - 1)
    if x0 > x1 or y0 > y1:
        return "OFFSCREEN", None
    return "SETUP", NaiveTriangle(tuple(vertices), (x0, y0, x1, y1), tuple(edges), back)


def naive_assemble(vertices, viewport, reach, cull):
    """Counts of outcomes by name, and the NaiveTriangles, of a clip-space triangle: three tuples (x y z w, attributes)."""
    counts, triangles = {"C_IN": 1}, []

    def count(name):
        counts[name] = counts.get(name, 0) + 1

    with np.errstate(all="ignore"):
        positions = [tuple(float(F(a)) for a in vertex[:4]) for vertex in vertices]
        planes = naive_planes(viewport)
        if not np.isfinite(positions).all():
            count("INVALID")
            return counts, triangles
        if any(all(outside) for outside in zip(*(outside_frustum(*p) for p in positions), strict=True)):
            count("CLIPPED")
            return counts, triangles
        polygon = [Corner(vertex, k) for k, vertex in enumerate(vertices)]
        if any(needs_clipping(p, planes) for p in positions):
            polygon = naive_clip(vertices, planes)
            if len(polygon) < 3:
                count("CLIPPED")
                return counts, triangles
            count("CUT")
        corners = [naive_window(corner.values, viewport) for corner in polygon]
        if None in corners:
            return {"C_IN": 1, "INVALID": 1}, []
    last = len(polygon) - 1
    for i in range(1, last):
        count("C_OUT")
        edges = (
            polygon[i].edge is not None,
            i + 1 == last and polygon[last].edge is not None,
            i == 1 and polygon[0].edge is not None,
        )
        name, triangle = naive_set_up((corners[0], corners[i], corners[i + 1]), edges, viewport, reach, cull)
        count(name)
        if triangle:
            triangles.append(triangle)
    return counts, triangles


# Coverage and depth


def edge_values(vertices, x, y):
    """E_0, E_1, E_2 at a sample (integers, 1/256 pixel): E_i belongs to the edge opposite vertex i."""
    values = []
    for i in range(3):
        a, b = vertices[(i + 1) % 3], vertices[(i + 2) % 3]
        values.append((b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x))
    return values


def covers(vertices, x, y):
    """Clockwise triangle: inside of all edges, or on a top or a left one."""
    for i, value in enumerate(edge_values(vertices, x, y)):
        a, b = vertices[(i + 1) % 3], vertices[(i + 2) % 3]
        top, left = a.y == b.y and b.x > a.x, b.y < a.y
        if value < 0 or (value == 0 and not (top or left)):
            return False
    return True


def sample_depth(vertices, x, y, depth_range):
    """Linear in screen space, in float64, rounded to float32; clamped to the triangle's range, and that to the viewport's."""
    _, e1, e2 = edge_values(vertices, x, y)
    z0, z1, z2 = (float(v.z) for v in vertices)
    area = twice_area(*vertices)
    z = F(z0 + (e1 * ((z1 - z0) / area) + e2 * ((z2 - z0) / area)))
    near, far = (F(d) for d in depth_range)
    low, high = (min(max(F(end), near), far) for end in (min(z0, z1, z2), max(z0, z1, z2)))
    return min(max(z, low), high)


class NaiveDepth(NamedTuple):
    depth: np.ndarray  # float32[h, w, samples]
    visible: np.ndarray  # int[h, w, samples] number of the triangle seen, -1 for none
    covered: int  # samples
    passed: int  # samples that passed the depth test
    pixels: int  # pairs of a triangle and a pixel where a sample of it passed


def naive_depth_test(triangles, width, height, samples, depth_range):
    """Every triangle at every sample, in order; depth is cleared to 1, the function is LESS."""
    depth, visible = np.ones((height, width, samples), F), np.full((height, width, samples), -1)
    covered = passed = 0
    pixels = set()
    for number, triangle in enumerate(triangles):
        for row in range(height):
            for column in range(width):
                for s, (dx, dy) in enumerate(SAMPLE_OFFSETS[samples]):
                    x, y = GRID * column + 128 + 16 * dx, GRID * row + 128 + 16 * dy
                    if not covers(triangle.vertices, x, y):
                        continue
                    covered += 1
                    z = sample_depth(triangle.vertices, x, y, depth_range)
                    if z < depth[row, column, s]:
                        depth[row, column, s], visible[row, column, s] = z, number
                        passed += 1
                        pixels.add((number, row, column))
    return NaiveDepth(depth, visible, covered, passed, len(pixels))


def exact_attributes(vertices, x, y):
    """Attributes at a sample, with perspective: linear in clip space, so solved there, from the snapped positions."""
    corners = np.array([[v.x, v.y, 1] for v in vertices], np.float64) * np.array([[float(v.w)] for v in vertices])
    weights = np.linalg.solve(corners.T, [x, y, 1])  # of the vertices, up to a factor
    return weights / weights.sum() @ np.array([v.attributes for v in vertices], np.float64)
