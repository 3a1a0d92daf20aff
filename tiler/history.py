"""What the last frame leaves to a machine that draws in two phases: the depths of its picture, and which patches were seen.

Frame n is simulated by itself, whichever frames were simulated before; so its last frame, n - 1, is drawn for it by the same
machine without occlusion tests, which changes no bit of the picture. Frame 0, and any number below 1, is the first of a run
and has no last frame: its pyramid is that of a cleared depth buffer, and no patch was seen.

Since every machine draws the same picture, depths and submit numbers at equal depths included, a frame that was just drawn with
occlusion tests leaves the same bits. So where frames are drawn one after the other, a `Reel` hands them on.
"""

from typing import NamedTuple

import numpy as np

from pipeline.types import F32, I64
from tiler.config import Machine
from tiler.order import PATCH_SHIFT
from tiler.scene.model import Scene
from tiler.tile import Target


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


class Reel:
    """What the frame that was drawn last leaves to the next one of a run. Its depths must not be written to."""

    def __init__(self) -> None:
        self._of: tuple[float, str, tuple[str, ...]] | None = None
        self._scene: Scene | None = None
        self._history: History | None = None

    def keep(self, scene: Scene, machine: Machine, number: float, target: Target) -> None:
        """A frame was drawn. One that kept no submit numbers leaves nothing."""
        self._history = None
        if target.order.size:
            self._scene, self._of = scene, (number, machine.bounds, machine.hull_cull)
            self._history = History(target.depth, seen_patches(target.order, scene.num_patches))

    def find(self, scene: Scene, machine: Machine, number: float) -> History | None:
        """The history of frame `number`, if the frame before it was drawn last: of this very scene, with these bounds and
        cull tests.
        """
        same = number >= 1 and self._scene is scene and self._of == (number - 1, machine.bounds, machine.hull_cull)
        return self._history if same else None
