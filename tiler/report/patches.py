"""Which patch is seen at each pixel, and what there is to say of a patch: drawn once more for the report."""

from typing import NamedTuple

import numpy as np

from pipeline.types import I32, I64
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.heatmaps import live_patches
from tiler.host import Host, available_threads
from tiler.machine import draw_frame
from tiler.order import PATCH_SHIFT
from tiler.queue_memory import make_queue_memory
from tiler.scene.model import Scene
from tiler.tally import Tally


class Seen(NamedTuple):
    """under : patch seen at the pixel's first sample that shows one, -1 for none. visible : patches seen at any sample."""

    under: I32  # (H, W)
    visible: int


class PatchFacts(NamedTuple):
    """What a machine's hull stage says of each patch; 0 of those that it culls."""

    points: I64  # (P,) domain points
    triangles: I64  # (P,)
    object_id: I32  # (P,)
    rect: I32  # (P, 4) bound on the screen, pixels x0 y0 x1 y1, ends exclusive


def look(scene: Scene, machine: Machine, number: float, threads: int | None = None) -> Seen:
    """Draw the frame with the machine's bounds and hull-stage culls, and keep the patch that each sample shows."""
    picture = scene.picture
    plain = Machine(tile=machine.tile, bounds=machine.bounds, cull=machine.hull_cull)
    tally = Tally(scene, plain, make_grid(picture.width, picture.height, plain.tile))
    memory = make_queue_memory(plain, tally.grid, picture.samples)
    with Host(threads or available_threads()) as host:
        target = draw_frame(scene, plain, number, host, None, tally, memory, lambda part: None, keep_order=True)
    patch = np.where(target.order >= 0, target.order >> PATCH_SHIFT, -1).astype(np.int32)
    first = (patch >= 0).argmax(axis=2)
    under = np.take_along_axis(patch, first[..., None], axis=2)[..., 0]
    return Seen(under, len(np.unique(patch[patch >= 0])))


def patch_facts(scene: Scene, machine: Machine, number: float) -> PatchFacts:
    """Look at the patches as the machine's hull stage leaves them."""
    alive = live_patches(scene, machine, number)
    n = scene.num_patches
    points, triangles, rect = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros((n, 4), np.int32)
    pattern = alive.patterns.of_patch[alive.live]
    points[alive.live] = np.diff(alive.patterns.first_point)[pattern]
    triangles[alive.live] = np.diff(alive.patterns.first_triangle)[pattern]
    rect[alive.live] = alive.bounds.rect[alive.live]
    return PatchFacts(points, triangles, alive.patches.object_id, rect)
