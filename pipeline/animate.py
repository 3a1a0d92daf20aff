"""Vertex shader, first half: where the points of an object are at a frame. Keyframes and linear blend skinning.

All in float64 and rounded to float32 once, with + - * / only. Between keys values run linearly, or along the Hermite curve
whose tangent at a key is the slope from the key before to the key after (Catmull-Rom where keys are evenly spaced, as the
camera's); before the first key and after the last they stand still. Matrices are interpolated entry by entry.
"""

from typing import Literal, NamedTuple

import numpy as np

from pipeline.jit import kernel
from pipeline.types import F32, F64, I32

Interpolation = Literal["linear", "catmull_rom"]


class Motion(NamedTuple):
    """How one object moves; K keys, V vertices, J bones. What is None stands still."""

    frames: F64  # (K,) of the keys, rising
    interpolation: Interpolation = "linear"
    points: F32 | None = None  # (K, V, 3) control points, object space
    transforms: F32 | None = None  # (K, 3, 4) object to world
    bone_index: I32 | None = None  # (V, B) bones that each vertex follows
    bone_weight: F32 | None = None  # (V, B) their weights, of sum 1
    bones: F32 | None = None  # (K, J, 3, 4) from the object as modelled to the object as posed


def interpolate(motion: Motion, values: F32, frame: float) -> F64:
    """Values (K, ...) of the keys at a frame: float64[...]. At a key, that key's values exactly."""
    times = motion.frames
    last = len(times) - 1
    k = int(np.clip(np.searchsorted(times, frame, side="right") - 1, 0, last))
    if k == last or frame <= times[k]:
        return values[k].astype(np.float64)
    span = times[k + 1] - times[k]
    x = (frame - times[k]) / span
    p, q = values[k].astype(np.float64), values[k + 1].astype(np.float64)
    if motion.interpolation == "linear":
        return (1.0 - x) * p + x * q
    h1 = x * x * (3.0 - 2.0 * x)
    g0 = x * (1.0 - x) * (1.0 - x) * span
    g1 = x * x * (x - 1.0) * span
    return ((1.0 - h1) * p + h1 * q) + (g0 * _slope(times, values, k) + g1 * _slope(times, values, k + 1))


def _slope(times: F64, values: F32, k: int) -> F64:
    before, after = max(k - 1, 0), min(k + 1, len(times) - 1)
    return (values[after].astype(np.float64) - values[before]) / (times[after] - times[before])


@kernel
def _skin(points, index, weight, bones, out):
    for v in range(len(points)):
        x, y, z = points[v]
        for r in range(3):
            total = 0.0
            for b in range(index.shape[1]):
                m = bones[index[v, b], r]
                total += weight[v, b] * (((m[0] * x + m[1] * y) + m[2] * z) + m[3])
            out[v, r] = total


def pose(vertices: F32, motion: Motion | None, frame: float) -> F32:
    """Object-space points float32[V, 3] at a frame: keyframed, then moved by their bones."""
    if motion is None or (motion.points is None and motion.bones is None):
        return vertices
    points = vertices.astype(np.float64) if motion.points is None else interpolate(motion, motion.points, frame)
    if motion.bones is not None:
        out = np.empty_like(points)
        _skin(points, motion.bone_index, motion.bone_weight, interpolate(motion, motion.bones, frame), out)
        points = out
    return points.astype(np.float32)


def transform_at(standing: F32, motion: Motion | None, frame: float) -> F32:
    """Object-to-world matrix float32[3, 4] at a frame; `standing` where the object does not move."""
    if motion is None or motion.transforms is None:
        return standing
    return interpolate(motion, motion.transforms, frame).astype(np.float32)
