"""Where patches are sampled, and how an adversary changes them."""

from typing import Any

import numpy as np

from pipeline.types import F32, F64
from tiler.validation.families import Batch


def attack_points(domain: F64, m: int, rng: np.random.Generator) -> F32:
    """m points in each domain, multiples of 2^-16, float32[2, P, m]; corners first, then many on edges."""
    ends = np.rint(domain * 65536.0)
    uv = np.empty((2, len(domain), m), np.float32)
    for c in range(2):
        lo, hi = ends[:, 2 * c, None], ends[:, 2 * c + 1, None]
        r = rng.random((len(domain), m), np.float32).astype(np.float64)
        r = np.clip(1.25 * r - 0.125, 0.0, 1.0)  # a fifth on the ends
        r[:, :4] = [[0, 1, 0, 1], [0, 0, 1, 1]][c]
        uv[c] = np.rint(lo + r * (hi - lo)) / 65536.0
    return uv


def gather_around(uv: F32, center: F64, domain: F64, rng: np.random.Generator) -> None:
    """Move the second half of the points, in place, close to the worst point so far, at all distances."""
    half = uv.shape[2] // 2
    for c in range(2):
        lo, hi = domain[:, 2 * c, None], domain[:, 2 * c + 1, None]
        step = rng.normal(size=(uv.shape[1], half)) * 2.0 ** rng.uniform(-16, -2, (uv.shape[1], half)) * (hi - lo)
        near = np.rint(np.clip(center[c][:, None] + step, lo, hi) * 65536.0) / 65536.0
        uv[c, :, half:] = near
    inside = (center[0] >= domain[:, 0]) & (center[0] <= domain[:, 1])
    inside &= (center[1] >= domain[:, 2]) & (center[1] <= domain[:, 3])
    uv[:, inside, half] = center[:, inside]


def mutate(batch: Batch, rng: np.random.Generator) -> Batch:
    """Every patch changed a little or a lot: some control points, texture coordinates, texels."""
    n = len(batch.control_points)
    step = 2.0 ** rng.uniform(-24, -1, (n, 1, 1, 1))
    size = abs(batch.control_points).max(axis=(1, 2), keepdims=True).astype(np.float64)
    where = rng.random((n, 4, 4, 4)) < rng.choice([0.02, 0.1, 0.5], (n, 1, 1, 1))
    where[..., 3] &= (batch.control_points[..., 3] != 1.0).any(axis=(1, 2))[:, None, None]  # polynomial patches stay so
    with np.errstate(over="ignore"):
        cp = (batch.control_points + where * step * rng.normal(size=(n, 4, 4, 4)) * size).astype(np.float32)
    cp[..., 3] = np.where(cp[..., 3] > 0, cp[..., 3], batch.control_points[..., 3])
    move = rng.random((n, 4, 2)) < 0.2
    texcoords = (batch.texcoords + move * rng.normal(size=(n, 4, 2)) * step[..., 0]).astype(np.float32)
    maps = []
    for texels, address, scale, bias in batch.maps:
        change = (rng.random(texels.shape) < 0.2) * rng.normal(size=texels.shape) * 2.0 ** rng.uniform(-12, 0)
        maps.append(((texels + change).astype(np.float32), address, scale, bias))
    return batch._replace(control_points=cp, texcoords=texcoords, maps=maps)


def take(old: Batch, new: Batch, rows: Any) -> Batch:
    """`old` with these patches of `new`, each with its map."""
    cp, texcoords, maps = old.control_points.copy(), old.texcoords.copy(), list(old.maps)
    cp[rows], texcoords[rows] = new.control_points[rows], new.texcoords[rows]
    for p in rows:
        if old.map_id[p] >= 0:
            maps[old.map_id[p]] = new.maps[old.map_id[p]]
    return old._replace(control_points=cp, texcoords=texcoords, maps=maps)
