"""Where patches are sampled, and how an adversary changes them."""

from typing import Any

import numpy as np

from pipeline.types import F32, F64, Patches
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


def _shake(rng: np.random.Generator, table: F32, step: F64) -> F32:
    """A table of vectors, float32[n, ...], some of them moved by `step` float64[n] of the row's largest coordinate."""
    rows = (slice(None), *(None,) * (table.ndim - 1))
    size = abs(table).max(axis=tuple(range(1, table.ndim)), initial=0.0).astype(np.float64)
    where = rng.random(table.shape) < 0.1
    with np.errstate(over="ignore"):
        return (table + where * rng.normal(size=table.shape) * (step * size)[rows]).astype(np.float32)


def mutate(batch: Batch, rng: np.random.Generator) -> Batch:
    """Every patch changed a little or a lot: some control points, tangents, inner points, texture coordinates, texels.

    Displaced patches that share normals keep their points: those would no longer belong together.
    """
    old = batch.patches
    n = len(batch.control_points)
    step = 2.0 ** rng.uniform(-24, -1, (n, 1, 1, 1))
    size = abs(batch.control_points).max(axis=(1, 2), keepdims=True).astype(np.float64)
    where = rng.random((n, 4, 4, 4)) < rng.choice([0.02, 0.1, 0.5], (n, 1, 1, 1))
    where[..., 3] &= (batch.control_points[..., 3] != 1.0).any(axis=(1, 2))[:, None, None]  # polynomial patches stay so
    where &= ((old.normal_id < 0) | (old.map_id < 0))[:, None, None, None]
    with np.errstate(over="ignore"):
        cp = (batch.control_points + where * step * rng.normal(size=(n, 4, 4, 4)) * size).astype(np.float32)
    cp[..., 3] = np.where(cp[..., 3] > 0, cp[..., 3], batch.control_points[..., 3])
    move = rng.random((n, 4, 2)) < 0.2
    texcoords = (old.texcoords + move * rng.normal(size=(n, 4, 2)) * step[..., 0]).astype(np.float32)
    maps = []
    for texels, address, scale, bias in batch.maps:
        change = (rng.random(texels.shape) < 0.2) * rng.normal(size=texels.shape) * 2.0 ** rng.uniform(-12, 0)
        maps.append(((texels + change).astype(np.float32), address, scale, bias))
    shaken: dict[str, Any] = {name: _shake(rng, getattr(old, name), step.ravel()) for name in own_tables(old)}
    return batch._replace(patches=old._replace(control_points=cp, texcoords=texcoords, **shaken), maps=maps)


def own_tables(patches: Patches) -> tuple[str, ...]:
    """Tables with a row for each patch, its own and of its number, so that rows can be changed by themselves."""
    if ((patches.normal_id >= 0) & (patches.map_id >= 0)).any():
        return ()
    names = ("tangent_u", "tangent_v", "inner")
    return tuple(name for name in names if len(getattr(patches, name)) == len(patches.control_points))


def take(old: Batch, new: Batch, rows: Any) -> Batch:
    """`old` with these patches of `new`, each with its map."""
    maps = list(old.maps)
    changed: dict[str, Any] = {}
    for name in ("control_points", "texcoords", *own_tables(old.patches)):
        changed[name] = getattr(old.patches, name).copy()
        changed[name][rows] = getattr(new.patches, name)[rows]
    for p in rows:
        if old.patches.map_id[p] >= 0:
            maps[old.patches.map_id[p]] = new.maps[old.patches.map_id[p]]
    return old._replace(patches=old.patches._replace(**changed), maps=maps)
