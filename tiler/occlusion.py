"""What the occlusion test of a patch or a sub-domain asks about: an area of the picture, and how near the bound is there.

`rect`: its rectangle, in the tile at hand or in the whole picture, with one nearest depth; all cells must hide that
(`coarse_z.hidden_at`).

`hull`: cell by cell. The bound is as near in a cell as its planes say for the part of the rectangle that lies in the cell
(`near_planes.py`). A cell that does not hide this is still passed if the outline of the bound has nothing of it
(`outline.py`); else its four children are asked, and a block has none: then the bound is not hidden. The cells first asked
are those of the lowest level at which the rectangle spans at most 2x2 (Greene, Kass and Miller 1993: a cube is tested against
the pyramid by its faces; here the cells of one test lie in the outline of all faces).

Both are conservative: samples of the bound lie in its rectangle and in its outline, and behind its planes. `hull` hides all
that `rect` hides: its cells are those, or lie in them, and depths are no nearer there.
"""

from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F64, I32, I64, PatchBounds, Viewport
from tiler.coarse_z import CoarseZ, first_level, hidden_at, hides
from tiler.near_planes import MOST, nearest_in, planes_under
from tiler.outline import NUM_LINES, make_lines, reached

MOST_WAITING = 128  # cells: 4 to begin with, and 3 more for each level of a pyramid


class Sketch(NamedTuple):
    """Scratch of one thread: the outline of the bound at hand, and cells that wait to be asked."""

    corner: F64  # (8, 4)
    line: F64  # (NUM_LINES, 3)
    waiting: I64  # (MOST_WAITING, 3) level, column, row


def make_sketch() -> Sketch:
    """Scratch for `hidden_hull`."""
    return Sketch(np.empty((8, 4)), np.empty((NUM_LINES, 3)), np.empty((MOST_WAITING, 3), np.int64))


@helper
def _push_cells(waiting, n, level, cx0, cy0, cx1, cy1):
    """Put cells on the stack so that they are taken row by row; how many wait then."""
    for cy in range(cy1, cy0 - 1, -1):
        for cx in range(cx1, cx0 - 1, -1):
            waiting[n, 0], waiting[n, 1], waiting[n, 2] = level, cx, cy
            n += 1
    return n


@helper
def hidden_hull(coarse, box, z_min, planes, corners, slack, viewport, strict, top, sketch):
    """Test `hull` of one bound in pixels `box`, inclusive, in the picture.

    planes, corners, slack : of the bound. top : highest level to begin at.
    Returns the finest level that was read, -1 if the bound is not hidden; cells read; cells asked whether the outline reaches
    them; those that it does not reach.
    """
    x0, y0, x1, y1 = box
    log2 = coarse.block_log2
    first = first_level(coarse, x0, y0, x1, y1, top)
    shift = log2 + first
    n = _push_cells(sketch.waiting, 0, first, x0 >> shift, y0 >> shift, x1 >> shift, y1 >> shift)
    finest, cells, asked, missed = first, 0, 0, 0
    drawn, has_lines = False, False
    while n > 0:
        n -= 1
        level, cx, cy = sketch.waiting[n, 0], sketch.waiting[n, 1], sketch.waiting[n, 2]
        finest = min(finest, level)
        shift = log2 + level
        left, top_row = max(x0, cx << shift), max(y0, cy << shift)
        right, bottom = min(x1, ((cx + 1) << shift) - 1), min(y1, ((cy + 1) << shift) - 1)
        cells += 1
        nearest = nearest_in(planes, z_min, left, top_row, right, bottom)
        if hides(coarse.farthest[coarse.first[level] + cy * coarse.width[level] + cx], nearest, strict):
            continue
        if not drawn:
            drawn, has_lines = True, make_lines(corners, slack, viewport, sketch.corner, sketch.line)
        if has_lines:
            asked += 1
            if not reached(sketch.line, left, top_row, right, bottom):
                missed += 1
                continue
        if level == 0:
            return -1, cells, asked, missed
        shift -= 1
        n = _push_cells(sketch.waiting, n, level - 1, left >> shift, top_row >> shift, right >> shift, bottom >> shift)
    return finest, cells, asked, missed


class Answers(NamedTuple):
    """Of tests of whole units: level at which a unit is seen to be hidden, -1 if it is not, and what was done for it."""

    level: I64
    cells: I64
    outlines: I64
    misses: I64


@kernel
def _query_units(coarse, numbers, bounds, planes, viewport, by_hull, sketch, answers):
    top = len(coarse.first) - 1
    for i in range(len(numbers)):
        p = numbers[i]
        x0, y0, x1, y1 = bounds.rect[p]
        answers.level[i], answers.cells[i], answers.outlines[i], answers.misses[i] = -1, 0, 0, 0
        if x0 >= x1 or y0 >= y1:
            continue
        box = (np.int64(x0), np.int64(y0), np.int64(x1) - 1, np.int64(y1) - 1)
        if by_hull:
            answers.level[i], answers.cells[i], answers.outlines[i], answers.misses[i] = hidden_hull(
                coarse, box, bounds.z_min[p], planes[i], bounds.corners[p], bounds.slack[p], viewport, True, top, sketch
            )  # fmt: skip
        else:
            answers.level[i], answers.cells[i] = hidden_at(
                coarse, box[0], box[1], box[2], box[3], bounds.z_min[p], True, top
            )  # fmt: skip


def query_units(
    coarse: CoarseZ, numbers: I32, bounds: PatchBounds, viewport: Viewport, by_hull: bool = False
) -> Answers:
    """Test patches or sub-domains whole against the picture's pyramid, strictly.

    numbers : which rows of bounds. by_hull : test `hull`, else `rect`.
    """
    n = len(numbers)
    planes = planes_under(numbers, bounds, viewport) if by_hull else np.empty((0, MOST, 3))
    answers = Answers(*(np.empty(n, np.int64) for _ in Answers._fields))
    _query_units(coarse, numbers, bounds, planes, viewport, by_hull, make_sketch(), answers)
    return answers
