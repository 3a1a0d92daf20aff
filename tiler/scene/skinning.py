"""Linear blend skinning data: which bones move a vertex, and where the bones are at each key."""

from typing import NamedTuple

import numpy as np

from pipeline.types import F32, F64, I32
from tiler.scene.rounding import STEP


class Skinning(NamedTuple):
    """A vertex moves to the sum over its bones of weight * (transform @ (position, 1)); a row of weights adds up to 1.

    Transforms take object space at rest to object space as posed. Between keys they are blended entry by entry.
    """

    bone_index: I32  # (V, 4)
    bone_weight: F32  # (V, 4), multiples of 2^-16, largest first
    bone_transform: F32  # (K, bones, 3, 4) column vectors
    key_frame: F32  # (K,) rising


def strongest_four(weights: F64) -> tuple[I32, F32]:
    """Indices and weights (V, 4) of each vertex's four strongest bones; weights : (V, bones), at least four."""
    index = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    chosen = np.maximum(np.take_along_axis(weights, index, axis=1), 0.0)
    total = chosen[:, 0] + chosen[:, 1] + chosen[:, 2] + chosen[:, 3]
    units = np.rint(chosen / total[:, None] / STEP).astype(np.int64)
    units[:, 0] += round(1 / STEP) - units.sum(axis=1)  # what rounding left over
    return index.astype(np.int32), (units * STEP).astype(np.float32)
