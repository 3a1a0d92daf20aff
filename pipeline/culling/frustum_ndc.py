"""View-frustum cull in normalized device coordinates, as Sathe 2011 describes it. NOT conservative, and in no table.

The box's eight corners are divided by w and compared with the sides of the NDC cube. For a corner with w < 0 the quotient
lies on the wrong side: corners (x, w) = (-2, 1) and (5, -1) are both "left" of -1, while points between them are on the
screen. It stands here to be measured against `frustum`, which needs no division.
"""

import numpy as np

from pipeline.types import U8, CullFlag, HullInput, PatchBounds


def cull_ndc(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches all of whose corners x/w, y/w, z/w lie beyond one side; `flags` uint8[P] modified in place."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ndc = bounds.corners[:, :, :3] / bounds.corners[:, :, 3:]
        below = np.logical_and.reduce(ndc < [-1.0, -1.0, 0.0], axis=1)
        above = np.logical_and.reduce(ndc > 1.0, axis=1)
    flags[(below | above).any(axis=1) & (flags == CullFlag.ALIVE)] = CullFlag.FRUSTUM
