"""Which units a frame draws in which phase, and which it never draws because coarse Z of the whole picture hides them.

`tile` and `none`: one phase, all units.

`two_phase`: first the units of patches that the last frame saw, without a test. Then the pyramid of what they drew is built,
and all others are tested against it; what is not hidden is drawn in the second phase.

`previous_frame`: first every unit is tested against the pyramid of the last frame, and what is not hidden in it is drawn. The
camera and the objects have moved since, so to be hidden there proves nothing: those units are tested again against the
pyramid of what this frame has drawn. What is not hidden in that was rejected because the old pyramid was stale; it is drawn
in the second phase.

So both are exact. They differ in what the first phase draws: `two_phase` asks for the patch by its number, and draws all of a
patch that moved behind another; `previous_frame` asks where the patch is now, and draws all of what comes into view where
the last frame saw something far.

Both test a unit whole, by its rectangle or its hull on the screen; in the second phase its tiles test again, by the part that
they hold. The pyramid does not change within a phase. All tests are strict: the order of drawing is not that of submit.
"""

from dataclasses import dataclass, field

import numpy as np

from pipeline.types import I32, I64, Viewport
from tiler.coarse_z import CoarseZ, build, make_pyramid
from tiler.config import Machine
from tiler.grid import Grid
from tiler.history import History
from tiler.occlusion import query_units
from tiler.units import Units


@dataclass
class UnitTests:
    """Tests of whole units against the pyramid of the picture; by_hull : area `hull` (`tiler/occlusion.py`)."""

    viewport: Viewport
    by_hull: bool
    tested: int = 0
    occluded: int = 0  # for good
    stale: int = 0  # hidden in the last frame's pyramid, not in this frame's
    cells: int = 0
    outlines: int = 0  # cells asked whether the outline reaches them
    misses: int = 0  # those that it does not reach
    hits: I64 = field(default_factory=lambda: np.zeros(4, np.int64))  # hidden at level 0, 1, 2, 3 or above

    def query(self, coarse: CoarseZ, numbers: I32, units: Units) -> np.ndarray:
        """Whether each unit is hidden, bool[len(numbers)]; counted."""
        answers = query_units(coarse, numbers, units.bounds, self.viewport, self.by_hull)
        level = answers.level
        self.tested += len(numbers)
        self.cells += int(answers.cells.sum())
        self.outlines += int(answers.outlines.sum())
        self.misses += int(answers.misses.sum())
        self.hits += np.bincount(np.minimum(level[level >= 0], 3), minlength=4)
        return level >= 0


def first_phase(
    machine: Machine, units: Units, live: I32, grid: Grid, history: History | None, tests: UnitTests
) -> tuple[I32, I32]:
    """Units that the first phase draws, and those that wait for the second, in the order of `live`."""
    if history is None:
        return live, live[:0]
    if machine.z_feedback == "two_phase" or "occlusion" not in machine.occlusion:
        now = history.seen[units.owner[live]] == 1
    else:
        old = make_pyramid(grid, machine.coarse_z_block)
        build(old, history.depth)
        now = ~tests.query(old, live, units)
    return live[now], live[~now]


def second_phase(machine: Machine, units: Units, waiting: I32, coarse: CoarseZ, tests: UnitTests) -> I32:
    """Those of the waiting units that the first phase's picture does not hide. `coarse` : the pyramid of it."""
    if "occlusion" not in machine.occlusion:
        return waiting
    hidden = tests.query(coarse, waiting, units)
    tests.occluded += int(hidden.sum())
    if machine.z_feedback == "previous_frame":
        tests.stale += int((~hidden).sum())
    return waiting[~hidden]
