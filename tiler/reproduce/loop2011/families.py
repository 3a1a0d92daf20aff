"""Patches of the kinds that back-patch tests may stumble over: collapsed edges, lines, points, and uneven weights."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.types import F32, F64
from tiler.scene.bezier_files import bicubic

BUMPS = 0.04  # standard deviation of the control points, of a patch's size

Make = Callable[[np.random.Generator, int], F64]


class Family(NamedTuple):
    """Patches of one kind. What coincides, does so exactly: the same float32 points, weights that are powers of two."""

    name: str
    points: Make  # (rng, n) -> points (n, 4, 4, 3)
    weights: Make | None = None  # (rng, n) -> (n, 4, 4)
    turned: bool = True  # each another way; what lies along axes would not do so exactly afterwards
    surface: bool = True  # lines and points have no normals: there is no right answer but to keep them

    @property
    def smooth(self) -> bool:
        """Whether neither weights nor missing normals trouble a test."""
        return self.weights is None and self.surface


def _sheets(rng: np.random.Generator, n: int) -> F64:
    """Bumpy sheets of size 1 about the origin."""
    i = np.arange(4) / 3 - 0.5
    return np.asarray(
        np.stack(np.broadcast_arrays(i[:, None], i[None, :], 0.0), -1) + rng.normal(0, BUMPS, (n, 4, 4, 3))
    )


def _edge_to_point(rng: np.random.Generator, n: int) -> F64:
    net = _sheets(rng, n)
    net[0::2, :, 3] = net[0::2, :1, 3]
    net[1::2, 0] = net[1::2, 0, :1]
    return net


def _two_edges_to_points(rng: np.random.Generator, n: int) -> F64:
    net = _sheets(rng, n)
    net[:, :, 0] = net[:, 1:2, 0]
    net[:, :, 3] = net[:, 1:2, 3]
    return net


def _corner_stands_still(rng: np.random.Generator, n: int) -> F64:
    """Both tangents of a corner are zero."""
    net = _sheets(rng, n)
    net[:, :2, :2] = net[:, :1, :1]
    return net


def _edge_without_derivative(rng: np.random.Generator, n: int) -> F64:
    """The tangents across an edge are zero all along it."""
    net = _sheets(rng, n)
    net[0::2, 1] = net[0::2, 0]
    net[1::2, :, 1] = net[1::2, :, 0]
    return net


def _line(rng: np.random.Generator, n: int) -> F64:
    """Along the axis x."""
    net = _sheets(rng, n)
    net[..., 1:] = 0.25
    return net


def _point(rng: np.random.Generator, n: int) -> F64:
    net = _sheets(rng, n)
    net[:] = net[:, :1, :1]
    return net


def _up_to(spread: float) -> Make:
    """Weights between 1 and `spread`, even in their logarithm."""
    return lambda rng, n: np.asarray(spread ** rng.uniform(0, 1, (n, 4, 4)))


def _powers_up_to_8(rng: np.random.Generator, n: int) -> F64:
    return np.asarray(2.0 ** rng.integers(0, 4, (n, 4, 4)))


def _octant() -> F64:
    """An eighth of the unit sphere, a rational patch whose edge v = 1 is the pole: (4, 4, 4), homogeneous."""
    r = np.sqrt(0.5)
    arc = np.array([[1.0, 0.0, 1.0], [r, r, r], [0.0, 1.0, 1.0]])  # (x, y) w and w of a quarter circle
    u, v = arc[:, None], arc[None]
    return bicubic(
        np.stack([u[..., 0] * v[..., 0], u[..., 1] * v[..., 0], u[..., 2] * v[..., 1], u[..., 2] * v[..., 2]], -1)
    )


def _octants(rng: np.random.Generator, n: int) -> F64:
    """Stretched along the axes, by powers of two."""
    net = _octant()
    return np.asarray((net[..., :3] / net[..., 3:])[None] * 2.0 ** rng.integers(-1, 2, (n, 1, 1, 3)))


def _octant_weights(rng: np.random.Generator, n: int) -> F64:
    return np.repeat(_octant()[None, ..., 3], n, axis=0)


FAMILIES = (
    Family("ordinary", _sheets),
    Family("an edge is a point", _edge_to_point),
    Family("two edges are points", _two_edges_to_points),
    Family("a corner stands still", _corner_stands_still),
    Family("no derivative across an edge", _edge_without_derivative),
    Family("weights 1 to 2", _sheets, _up_to(2.0)),
    Family("weights 1 to 10", _sheets, _up_to(10.0)),
    Family("weights 1 to 100", _sheets, _up_to(100.0)),
    Family("weights 1 to 8, an edge is a point", _edge_to_point, _powers_up_to_8),
    Family("octants of ellipsoids", _octants, _octant_weights, turned=False),
    Family("lines", _line, turned=False, surface=False),
    Family("points", _point, surface=False),
)
UNEVEN_AND_COLLAPSED = ("weights 1 to 8, an edge is a point", "octants of ellipsoids")


def make_family(family: Family, rng: np.random.Generator, n: int) -> F32:
    """n control nets float32[n, 4, 4, 4] of a family."""
    points = family.points(rng, n)
    if family.turned:
        turn = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        turn[:, :, 0] *= np.sign(np.linalg.det(turn))[:, None]
        points = np.einsum("nijc,ncd->nijd", points, turn)
    points = points.astype(np.float32).astype(np.float64)
    weights = (
        np.ones((n, 4, 4)) if family.weights is None else family.weights(rng, n).astype(np.float32).astype(np.float64)
    )
    return np.ascontiguousarray(np.concatenate([points * weights[..., None], weights[..., None]], -1), np.float32)


def eyes_about(rng: np.random.Generator, n: int) -> F64:
    """Eyes on all sides of patches of size 1 about the origin, from near to far: (n, 3)."""
    ways = rng.normal(size=(n, 3))
    ways /= np.sqrt((ways**2).sum(axis=1, keepdims=True))
    return np.asarray(ways * 10.0 ** rng.uniform(-0.1, 1.3, (n, 1)))
