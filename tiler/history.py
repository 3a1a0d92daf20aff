"""What the last frame leaves to a machine that draws in two phases: the depths of its picture, and which patches were seen.

Frame n is simulated by itself, whichever frames were simulated before; so its last frame, n - 1, is drawn for it by the same
machine without occlusion tests, which changes no bit of the picture. Frame 0, and any number below 1, is the first of a run
and has no last frame: its pyramid is that of a cleared depth buffer, and no patch was seen.
"""

from typing import NamedTuple

import numpy as np

from pipeline.types import F32, I64
from tiler.order import PATCH_SHIFT


class History(NamedTuple):
    """The last frame."""

    depth: F32  # (H, W, S)
    seen: I64  # (patches,) 1 where a sample of the patch is seen


def no_history(width: int, height: int, samples: int, num_patches: int) -> History:
    """The history of the first frame of a run."""
    return History(np.ones((height, width, samples), np.float32), np.zeros(num_patches, np.int64))


def seen_patches(order: I64, num_patches: int) -> I64:
    """1 for each patch of which a sample is seen, int64[num_patches]. order : int64[H, W, S] of `tile.Target`."""
    seen = np.zeros(num_patches, np.int64)
    seen[order[order >= 0] >> PATCH_SHIFT] = 1
    return seen
