"""Patches of subdivision surfaces for the batches: random tangent patches and Gregory points, and small displaced meshes.

Of the first two nothing agrees with anything, as no mesh would give them; of the meshes everything does: they are control
meshes of all kinds of vertices, made into patches by the hull stage itself, with the normals that they share on edges.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline import hull
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.subdivision.topology import Cage
from pipeline.types import F32, F64, Patches

BOX = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6))
INNER = ((1, 1), (2, 1), (2, 2), (1, 2))  # control points of the corners in the order of `Patches.inner`


def with_tangents(rng: np.random.Generator, patches: Patches) -> Patches:
    """ACC patches of these Bezier patches; in turn their own derivatives, nearly those, another patch's, and with zeros."""
    cp = patches.control_points[..., :3].astype(np.float64)
    n = len(cp)
    other = rng.permutation(n)
    nets = []
    for axis in (1, 2):
        own = 3.0 * np.diff(cp, axis=axis)
        size = abs(own).max(axis=(1, 2, 3), keepdims=True)
        net = own + 0.2 * size * rng.normal(size=own.shape)
        net[0::4] = own[0::4]
        net[2::4] = own[other][2::4] * rng.choice([1e-3, 1.0, 30.0], (len(net[2::4]), 1, 1, 1))
        net[3::4] *= rng.random((len(net[3::4]), *net.shape[1:3], 1)) < 0.7
        nets.append(net.astype(np.float32))
    return patches._replace(tangent_id=np.arange(n, dtype=np.int32), tangent_u=nets[0], tangent_v=nets[1])


def with_inner_points(rng: np.random.Generator, patches: Patches) -> Patches:
    """Gregory patches about these Bezier patches, f+ and f- near each other or far apart; some corners have one point."""
    cp = patches.control_points.copy()
    n = len(cp)
    size = np.ptp(cp[..., :3].astype(np.float64), axis=(1, 2)).max(axis=1)[:, None, None, None]
    middle = np.stack([cp[:, i, j, :3] for i, j in INNER], 1)[:, :, None]
    apart = rng.choice([1e-6, 0.03, 0.5], (n, 1, 1, 1)) * rng.integers(0, 2, (n, 4, 1, 1))
    inner = (middle + apart * size * rng.normal(size=(n, 4, 2, 3))).astype(np.float32)
    for k, (i, j) in enumerate(INNER):
        cp[:, i, j, :3] = inner[:, k].astype(np.float64).mean(axis=1)
    return patches._replace(control_points=cp, gregory_id=np.arange(n, dtype=np.int32), inner=inner)


class Shape(NamedTuple):
    """A small control mesh of quads about the origin."""

    points: F64  # (V, 3)
    faces: tuple[tuple[int, ...], ...]
    creases: tuple[tuple[int, int], ...] = ()


def _grid(n: int, closed: bool) -> Shape:
    """n x n quads: a sheet with a boundary, or a torus."""
    m = n if closed else n + 1
    i, j = np.divmod(np.arange(m * m), m)
    a, b = 2.0 * np.pi * i / n, 2.0 * np.pi * j / n
    torus = np.stack([(1.0 + 0.5 * np.cos(b)) * np.cos(a), (1.0 + 0.5 * np.cos(b)) * np.sin(a), 0.5 * np.sin(b)], 1)
    sheet = np.stack([2.0 * i / n - 1.0, 2.0 * j / n - 1.0, 0.0 * i], 1)
    faces = tuple(
        tuple((x % m) * m + y % m for x, y in ((p, q), (p + 1, q), (p + 1, q + 1), (p, q + 1)))
        for p in range(n)
        for q in range(n)
    )
    return Shape(torus if closed else sheet, faces)


def _box(faces: int = 6, creases: tuple[tuple[int, int], ...] = ()) -> Shape:
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float64)
    return Shape(corners, BOX[:faces], creases)


SHAPES = (_box(), _box(5), _grid(4, True), _grid(3, False), _box(creases=((4, 5), (5, 7), (7, 6), (6, 4))))


def mesh_patches(rng: np.random.Generator, n: int, basis: Basis, scale: float) -> Patches:
    """The first n patches of small meshes, each shaken and turned by itself, displaced by map 0."""
    vertices: list[F64] = []
    faces: list[F64] = []
    creases: list[F64] = []
    num_vertices = num_faces = 0
    while num_faces < n:
        shape = SHAPES[len(vertices) % len(SHAPES)]
        shaken = shape.points + rng.choice([0.0, 0.02, 0.1, 0.4]) * rng.normal(size=shape.points.shape)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)  # no mirror
        vertices.append(0.5 * shaken @ turn + rng.uniform(-1.5, 1.5, 3))
        faces.append(np.array(shape.faces) + num_vertices)
        creases.append(np.array(shape.creases, int).reshape(-1, 2) + num_vertices)
        num_vertices, num_faces = num_vertices + len(shape.points), num_faces + len(shape.faces)
    sharp = np.concatenate(creases).astype(np.int32)
    cage = Cage(
        num_vertices,
        np.arange(0, 4 * num_faces + 1, 4, dtype=np.int32),
        np.concatenate(faces).astype(np.int32).ravel(),
        np.zeros((4 * num_faces, 2), np.float32),
        sharp,
        np.full(len(sharp), 10.0, np.float32),
        np.zeros(0, np.int32),
        np.zeros(0, np.float32),
        True,
    )
    surface, _ = make_surface(cage, basis)
    points: F32 = (np.concatenate(vertices) * scale).astype(np.float32)
    return hull.surface_patches(surface, points, 0, 0).take(np.arange(n, dtype=np.int32))


Change = Callable[[np.random.Generator, Patches], Patches]
NETS: dict[str, Change] = {"ACC": with_tangents, "Gregory": with_inner_points}
MESHES: dict[str, Basis] = {"ACC mesh": Basis.ACC, "Gregory mesh": Basis.GREGORY}
