"""Random views of one model through the three tests of Loop et al. 2011, on one thread: what is asked of a study of culling.

The model is the torus of exact bicubic patches without displacement, its first VIEW_PATCHES patches; eyes are even over the
sphere on which that paper's rates are reproduced. What does not depend on the eye (cones, control planes) is made once and
counted in. All views are measured, or the first of them, and the report says which.
"""

import time
from typing import NamedTuple

import numpy as np

from tiler.bench.scenes import torus
from tiler.bench.stages import few_patches
from tiler.reproduce.loop2011.eyes import PAPER
from tiler.reproduce.loop2011.models import TESTS
from tiler.reproduce.loop2011.rates import CHUNK, culled, prepare
from tiler.reproduce.plain import ball_of, patches_of, plain_scene
from tiler.scene.model import Scene

VIEWS, VIEW_PATCHES = 10_000, 5_168
QUICK_VIEWS = 1_000


class Views(NamedTuple):
    """What was measured."""

    patches: int
    views: int  # that were measured
    asked: int  # views
    seconds: float  # processor time of one thread, for those that were measured
    culled: dict[str, int]  # (patch, view) that each test culls

    @property
    def whole_seconds(self) -> float:
        """For as many views as asked for."""
        return self.seconds * self.asked / self.views


def view_scene(patches: int = VIEW_PATCHES) -> Scene:
    """The model."""
    scene = torus(patches, 1, (16, 16))
    if scene.num_patches < patches:
        scene = torus(patches + patches // 20, 1, (16, 16))
    return plain_scene(few_patches(scene, patches))


def measure_views(quick: bool = False, patches: int = VIEW_PATCHES, asked: int = VIEWS) -> Views:
    """Time the views, after a few that compile. quick : the first QUICK_VIEWS of them."""
    scene = view_scene(patches)
    eyes = PAPER.draw(np.random.default_rng(0), asked, ball_of(scene))
    eyes = eyes[:QUICK_VIEWS] if quick else eyes
    model = patches_of(scene)
    culled(prepare(model), eyes[:2])
    counts = dict.fromkeys(TESTS, 0)
    start = time.thread_time()
    prepared = prepare(model)
    for first in range(0, len(eyes), CHUNK):
        for name, answer in culled(prepared, eyes[first : first + CHUNK]).items():
            counts[name] += int(np.count_nonzero(answer))
    return Views(scene.num_patches, len(eyes), asked, time.thread_time() - start, counts)
