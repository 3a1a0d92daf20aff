"""Families of triangles that try a rasterizer's snapping, fill rule and block traversal.

Every position is a multiple of 1/4096 pixel, so that it passes through float32 unchanged on targets of up to 4096
pixels and each rasterizer snaps the very same number. Triangles come in both windings, in random proportion. The seed
of a family follows from its name; `make_family` gives the same triangles each time.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

SEED = 20110801
CELL = 64  # pixels; a family's triangles lie within [0, CELL] unless the table says otherwise
ODD_CELL = 37  # no multiple of any block size
LARGE_CELL = 512
FAN_SIZE = 12  # triangles of a fan
MESH_SIDE = 4  # quads along each side of a mesh
MESH_SIZE = 2 * MESH_SIDE**2

LATTICES = (2, 8, 256, 512, 4096)  # points per pixel

Generator = Callable[[np.random.Generator, int], np.ndarray]


@dataclass(frozen=True)
class Family:
    """How to make triangles, on what window, and how many of them to compare with 1 and with 4 samples a pixel."""

    generate: Generator
    count: dict[int, int]
    cell: int = CELL
    tiles_window: int = 0  # n > 0: each n triangles in a row cover each sample of the window exactly once


def make_family(name: str, count: int) -> np.ndarray:
    """`count` triangles of the family: float64[count, 3, 2], window positions in pixels, y down."""
    family = FAMILIES[name]
    rng = np.random.default_rng([SEED, *name.encode()])
    triangles = _to_grid(family.generate(rng, count), 4096)
    flip = rng.random(count) < 0.5
    triangles[flip] = triangles[flip, ::-1]
    return triangles


def _to_grid(positions: np.ndarray, per_pixel: int | np.ndarray) -> np.ndarray:
    return np.rint(positions * per_pixel) / per_pixel


def _any_size(rng: np.random.Generator, count: int, smallest: float = 0.5, cell: float = CELL) -> np.ndarray:
    """Boxes of sides from `smallest` to `cell` pixels, all magnitudes alike, with three random points in each."""
    size = np.exp(rng.uniform(np.log(smallest), np.log(cell), (count, 1, 2)))
    corner = rng.random((count, 1, 2)) * (cell - size)
    return corner + rng.random((count, 3, 2)) * size


def random_sizes(rng: np.random.Generator, count: int) -> np.ndarray:
    return _any_size(rng, count)


def microtriangles(rng: np.random.Generator, count: int) -> np.ndarray:
    """Up to two pixels, around a pixel's centre, on lattices of many kinds: as a tessellator makes at full factors."""
    centre = rng.integers(1, CELL - 1, (count, 1, 2)) + 0.5
    return _to_grid(centre + rng.uniform(-1, 1, (count, 3, 2)), rng.choice(LATTICES, (count, 1, 1)))


def grid_256(rng: np.random.Generator, count: int) -> np.ndarray:
    return _to_grid(_any_size(rng, count, smallest=2), 256)


def grid_512(rng: np.random.Generator, count: int) -> np.ndarray:
    """All coordinates halfway between two multiples of 1/256: only ties."""
    return (np.floor(_any_size(rng, count, smallest=4) * 256).clip(max=256 * CELL - 1) + 0.5) / 256


def grid_4096(rng: np.random.Generator, count: int) -> np.ndarray:
    """Near ties: at most 1/4096 pixel beside them, or on them."""
    return grid_512(rng, count) + rng.integers(-1, 2, (count, 3, 2)) / 4096


def half_pixel(rng: np.random.Generator, count: int) -> np.ndarray:
    """Vertices on pixel centres, corners and the middle of pixel sides; edges through many centres."""
    return _to_grid(_any_size(rng, count, smallest=2), 2)


def eighth_pixel(rng: np.random.Generator, count: int) -> np.ndarray:
    """The lattice that the samples of the 4x pattern lie on."""
    return _to_grid(_any_size(rng, count), 8)


def slivers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Long, and at most half a pixel wide, often less than a snapping step; some along an axis or a diagonal."""
    a, b = rng.random((count, 2)) * CELL, rng.random((count, 2)) * CELL
    kind = rng.integers(0, 5, count)
    b[kind == 0, 0] = a[kind == 0, 0]
    b[kind == 1, 1] = a[kind == 1, 1]
    diagonal = np.flatnonzero(kind == 2)
    b[diagonal, 1] = (a[diagonal, 1] + b[diagonal, 0] - a[diagonal, 0]).clip(0, CELL)
    on_lattice = rng.random(count) < 0.5
    a[on_lattice], b[on_lattice] = _to_grid(a[on_lattice], 2), _to_grid(b[on_lattice], 2)
    thickness = np.exp(rng.uniform(np.log(1 / 1024), np.log(0.5), (count, 1)))
    along = rng.random((count, 1))
    c = (a + along * (b - a) + thickness * rng.uniform(-1, 1, (count, 2))).clip(0, CELL)
    return np.stack([a, b, c], axis=1)[:, rng.permutation(3)]


def degenerate(rng: np.random.Generator, count: int) -> np.ndarray:
    """No area: repeated vertices, three points on a line, or what snapping makes so; and nearly so."""
    triangles = _to_grid(_any_size(rng, count), 8)
    kind = rng.integers(0, 6, count)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        pair = (kind == 0) & (rng.integers(0, 2, count) == 0)
        triangles[pair, i] = triangles[pair, j]
    triangles[kind == 1] = triangles[kind == 1, :1]
    for k, axis in ((2, 0), (3, 1)):
        triangles[kind == k, :, axis] = triangles[kind == k, :1, axis]
    middle = (triangles[:, 0] + triangles[:, 1]) / 2
    triangles[kind == 4, 2] = middle[kind == 4]
    beside = rng.integers(-3, 4, (count, 2)) / 1024
    triangles[kind == 5, 2] = (middle + beside)[kind == 5].clip(0, CELL)
    return triangles


def fans(rng: np.random.Generator, count: int) -> np.ndarray:
    """Fans of FAN_SIZE triangles around one point, each fan exactly covering the window."""
    result = np.empty((count, 3, 2))
    for first in range(0, count, FAN_SIZE):
        per_pixel = rng.choice(LATTICES)
        distance = np.sort(np.append(rng.random(FAN_SIZE - 4) * 4 * CELL, np.arange(4) * CELL))
        along = distance % CELL
        full, none = np.full(FAN_SIZE, CELL), np.zeros(FAN_SIZE)
        side = np.minimum(distance // CELL, 3).astype(int)
        ring = np.stack(
            [
                np.choose(side, [along, full, CELL - along, none]),
                np.choose(side, [none, along, full, CELL - along]),
            ],
            axis=-1,
        )
        ring = _to_grid(ring, per_pixel)
        centre = _to_grid(rng.random(2) * CELL, per_pixel)
        fan = np.stack([np.broadcast_to(centre, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1)
        result[first : first + FAN_SIZE] = fan[: count - first]
    return result


def meshes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Grids of quads with moved inner vertices, each cut along either diagonal; a mesh exactly covers the window."""
    result = np.empty((count, 3, 2))
    step = CELL / MESH_SIDE
    for first in range(0, count, MESH_SIZE):
        per_pixel = rng.choice(LATTICES)
        vertex = np.stack(np.meshgrid(*[np.arange(MESH_SIDE + 1) * step] * 2, indexing="ij"), axis=-1)
        vertex[1:-1, 1:-1] += rng.uniform(-0.24, 0.24, (MESH_SIDE - 1, MESH_SIDE - 1, 2)) * step  # quads stay convex
        vertex = _to_grid(vertex, per_pixel)
        mesh = []
        for i in range(MESH_SIDE):
            for j in range(MESH_SIDE):
                a, b, c, d = vertex[i, j], vertex[i + 1, j], vertex[i + 1, j + 1], vertex[i, j + 1]
                mesh += [(a, b, c), (a, c, d)] if rng.random() < 0.5 else [(a, b, d), (b, c, d)]
        result[first : first + MESH_SIZE] = np.array(mesh)[: count - first]
    return result


def overhanging(rng: np.random.Generator, count: int) -> np.ndarray:
    """Triangles that reach over the sides of a small window of odd size, or miss it."""
    triangles = _any_size(rng, count, smallest=1, cell=ODD_CELL + 40) - 20
    on_lattice = rng.random(count) < 0.5
    triangles[on_lattice] = _to_grid(triangles[on_lattice], 8)
    return triangles


def large(rng: np.random.Generator, count: int) -> np.ndarray:
    """Hundreds of pixels, up to several windows long, on lattices of many kinds; some contain the window."""
    triangles = rng.uniform(-900, LARGE_CELL + 900, (count, 3, 2))
    inside = rng.random(count) < 0.4
    triangles[inside] = rng.uniform(0, LARGE_CELL, (np.count_nonzero(inside), 3, 2))
    return _to_grid(triangles, rng.choice(LATTICES, (count, 1, 1)))


FAMILIES: dict[str, Family] = {
    "random_sizes": Family(random_sizes, {1: 5000, 4: 1000}),
    "microtriangles": Family(microtriangles, {1: 3000, 4: 1000}),
    "grid_256": Family(grid_256, {1: 2500, 4: 600}),
    "grid_512": Family(grid_512, {1: 3000, 4: 800}),
    "grid_4096": Family(grid_4096, {1: 2500, 4: 600}),
    "half_pixel": Family(half_pixel, {1: 4000, 4: 1000}),
    "eighth_pixel": Family(eighth_pixel, {1: 1500, 4: 1500}),
    "slivers": Family(slivers, {1: 2500, 4: 800}),
    "degenerate": Family(degenerate, {1: 1500, 4: 500}),
    "fans": Family(fans, {1: 100 * FAN_SIZE, 4: 40 * FAN_SIZE}, tiles_window=FAN_SIZE),
    "meshes": Family(meshes, {1: 40 * MESH_SIZE, 4: 16 * MESH_SIZE}, tiles_window=MESH_SIZE),
    "overhanging": Family(overhanging, {1: 2000, 4: 600}, cell=ODD_CELL),
    "large": Family(large, {1: 200, 4: 40}, cell=LARGE_CELL),
}
