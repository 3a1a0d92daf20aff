"""Surfaces at a grid of points, float64, straight from Bernstein polynomials: the outside reference for back-patch tests.

A patch is truly back-facing where every sampled point has its eye below its tangent plane: what no test can exceed by more
than the grid misses, and what no sound test contradicts.
"""

from math import comb
from typing import NamedTuple

import numpy as np

from pipeline.types import F32, F64

EDGE_ON = 1e-9  # of the eye's distance: below it a point counts as edge-on
NO_NORMAL = 1e-12  # of the patch's longest p_u x p_v: what rounds away from zero where a patch has no normal


class Samples(NamedTuple):
    """S points of each of P patches."""

    points: F64  # (P, S, 3)
    normals: F64  # (P, S, 3) unit, of p_u x p_v; zero where there is none
    area: F64  # (P,) of the surface: the mean of |p_u x p_v|


def sample_surfaces(control_points: F32, cells: int) -> Samples:
    """Surfaces of control points float32[P, 4, 4, 4], weights above 0, at (cells + 1)^2 points each."""
    t = np.arange(cells + 1) / cells
    cubic = np.stack([comb(3, k) * t**k * (1.0 - t) ** (3 - k) for k in range(4)], 1)
    square = np.stack([comb(2, k) * t**k * (1.0 - t) ** (2 - k) for k in range(3)], 1)
    cp = control_points.astype(np.float64)
    s = _evaluate(cubic, cubic, cp)
    u, v = _evaluate(square, cubic, 3.0 * np.diff(cp, axis=1)), _evaluate(cubic, square, 3.0 * np.diff(cp, axis=2))
    w = s[..., 3:]
    points = s[..., :3] / w
    normals = np.cross((u[..., :3] - u[..., 3:] * points) / w, (v[..., :3] - v[..., 3:] * points) / w)
    length = np.sqrt((normals**2).sum(axis=-1, keepdims=True))
    area = length.mean(axis=(1, 2))
    known = length > NO_NORMAL * length.max(axis=1, keepdims=True)
    return Samples(points, np.divide(normals, length, out=np.zeros_like(normals), where=known), area)


def _evaluate(along_u: F64, along_v: F64, net: F64) -> F64:
    """Tensor product of a net (P, m, n, c) with bases (S_u, m), (S_v, n): (P, S_u S_v, c)."""
    rows = np.einsum("ui,pijc->pujc", along_u, net)
    made = np.einsum("vj,pujc->puvc", along_v, rows)
    return made.reshape(len(net), -1, net.shape[-1])


def most_facing(samples: Samples, eyes: F64) -> F64:
    """How far each eye is above the tangent plane that it is highest above: float64[P, eyes]; -inf without normals.

    A patch is truly back-facing, or edge-on, where this is at most EDGE_ON times the eye's distance.
    """
    p, s, _ = samples.points.shape
    level = (samples.normals * samples.points).sum(axis=2)[:, :, None]
    none = (samples.normals == 0.0).all(axis=2, keepdims=True)
    above = (samples.normals.reshape(-1, 3) @ np.ascontiguousarray(eyes.T)).reshape(p, s, len(eyes)) - level
    return np.asarray(np.where(none, -np.inf, above).max(axis=1))


def back_facing(samples: Samples, eyes: F64) -> np.ndarray:
    """Whether each patch is truly back-facing or edge-on to each eye: bool[P, eyes]; of a patch without normals False."""
    distance = np.sqrt(((samples.points[:, :1] - eyes[None]) ** 2).sum(axis=2))
    most = most_facing(samples, eyes)
    return np.asarray((most <= EDGE_ON * distance) & np.isfinite(most))
