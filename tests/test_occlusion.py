"""The test of a bound's hull against coarse Z: its slow twin agrees, it hides nothing that can be seen, and more than the
rectangle's does.
"""

import numpy as np
import pytest

import tiler
from pipeline.types import PatchBounds, Viewport
from tests.naive_coarse_z import NaiveCoarseZ
from tests.naive_near_planes import naive_nearest
from tests.naive_outline import naive_lines, naive_reached
from tests.scenes import flat_patch, patch_scene
from tests.test_near_planes import frame_of
from tiler.coarse_z import build, make_pyramid
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.occlusion import query_units

WIDTH, HEIGHT = 200, 120
VIEWPORT = Viewport(0, 0, WIDTH, HEIGHT, 0.0, 1.0)


def torn_depths(scene, seed: int) -> np.ndarray:
    """What the scene shows, with blocks brought nearer or pushed farther: most bounds are hidden in part."""
    rng = np.random.default_rng(seed)
    depth = tiler.simulate(scene, Machine(cull=("frustum",))).depth_samples.copy()
    for _ in range(60):
        x, y, side = rng.integers(0, WIDTH), rng.integers(0, HEIGHT), rng.integers(3, 40)
        part = depth[y : y + side, x : x + side]
        part[:] = np.float32(1.0) if rng.random() < 0.3 else np.float32(rng.random()) * part
    return depth


@pytest.mark.parametrize(("name", "bound"), [("colonnade", "tpatch"), ("waves", "cbox"), ("teapot", "taylor_clamped")])
def test_hulls_are_their_slow_twin_and_hide_nothing_that_can_be_seen(name, bound, load):
    scene = load(name, size=(WIDTH, HEIGHT), factor=3)
    live, bounds, viewport, geometry = frame_of(scene, 5, bound)
    depth = torn_depths(scene, 3)
    coarse, naive = make_pyramid(make_grid(WIDTH, HEIGHT, 32), 4), NaiveCoarseZ(WIDTH, HEIGHT, 4)
    build(coarse, depth)
    naive.read_all(depth)
    hull = query_units(coarse, live, bounds, viewport, by_hull=True)
    rect = query_units(coarse, live, bounds, viewport)
    assert (hull.level[rect.level >= 0] >= 0).all()  # hides all that the rectangle's test hides
    triangles, window = geometry.triangles, geometry.window
    for k in np.flatnonzero(hull.level >= 0):
        vertices = np.unique(triangles.vertex[triangles.first[k] : triangles.first[k] + triangles.used[k]])
        x, y = window.x[vertices] >> 8, window.y[vertices] >> 8
        inside = (x >= 0) & (x < WIDTH) & (y >= 0) & (y < HEIGHT)
        assert (window.z[vertices][inside] > depth[y[inside], x[inside], 0]).all()
    for k in range(0, len(live), 1 + len(live) // 40):
        row = PatchBounds(*(column[live[k] : live[k] + 1] for column in bounds))
        x0, y0, x1, y1 = (int(c) for c in row.rect[0])
        if x0 == x1:
            assert (hull.level[k], hull.cells[k], hull.outlines[k], hull.misses[k]) == (-1, 0, 0, 0)
            continue
        lines = naive_lines(row, viewport)
        level, *counts = naive.hidden_hull(
            (x0, y0, x1 - 1, y1 - 1), lambda box, row=row: naive_nearest(row, viewport, box),
            None if lines is None else lambda box, lines=lines: naive_reached(lines, box), True, 1 << 20,
        )  # fmt: skip
        assert hull.level[k] == (-1 if level is None else level)
        assert counts == [hull.cells[k], hull.outlines[k], hull.misses[k]]


def test_hulls_hide_more_than_rectangles(load):
    """At the picture's own depths: patches seen at a slant, and such as stand before what their corners' rectangle reaches."""
    scene = load("colonnade", size=(WIDTH, HEIGHT), factor=3)
    live, bounds, viewport, _ = frame_of(scene, 0, "tpatch")
    coarse = make_pyramid(make_grid(WIDTH, HEIGHT, 32), 4)
    build(coarse, tiler.simulate(scene).depth_samples)
    hull, rect = (query_units(coarse, live, bounds, viewport, by_hull=by_hull) for by_hull in (True, False))
    seen_by_rect, seen_by_hull = (rect.level < 0).sum(), (hull.level < 0).sum()
    assert seen_by_hull < 0.95 * seen_by_rect
    assert hull.misses.sum() > 0 and rect.outlines.sum() == rect.misses.sum() == 0


def test_a_diamond_behind_a_cross_is_hidden_by_its_hull_alone():
    """A square on its corner, behind two bars that leave out the corners of its rectangle."""
    bars = [flat_patch(-0.6, -0.4, 0.6, 0.4, y=-1.0), flat_patch(-0.4, -0.6, 0.4, 0.6, y=-1.0)]
    square = flat_patch(-0.6, -0.6, 0.6, 0.6, y=1.0)
    diamond = square.copy()
    diamond[..., 0], diamond[..., 2] = 0.7 * (square[..., 0] - square[..., 2]), 0.7 * (square[..., 0] + square[..., 2])
    scene = patch_scene([*bars, diamond], size=(64, 64), factor=3.0)
    fields = {"tile": 64, "coarse_z_block": 4, "cull": ("frustum", "occlusion"), "bounds": "obbtex"}
    plain = tiler.simulate(scene, Machine(binning="triangle", cull=()))
    frames = {area: tiler.simulate(scene, Machine(**fields, occlusion_area=area)) for area in ("rect", "hull")}
    assert all(np.array_equal(frame.color, plain.color) for frame in frames.values())
    occluded = {area: frame.counters["cz_pairs_occluded"] for area, frame in frames.items()}
    assert occluded == {"rect": 0, "hull": 1}
    assert frames["hull"].counters["cz_outlines_missed"] > 0


def test_a_bound_without_outline_is_asked_cell_by_cell(load):
    """Boxes about the eye, and boxes that are no boxes: their rectangle and z_min alone, down to the blocks."""
    scene = load("colonnade", size=(WIDTH, HEIGHT), factor=2)
    live, bounds, viewport, _ = frame_of(scene, 0, "cbox")
    corners, rect, z_min = bounds.corners.copy(), bounds.rect.copy(), bounds.z_min.copy()
    corners[live[0], :4, 3] *= -1.0
    corners[live[1]] = np.nan
    rect[live[:2]], z_min[live[:2]] = (3, 5, 130, 77), 0.5
    bounds = bounds._replace(corners=corners, rect=rect, z_min=z_min)
    coarse = make_pyramid(make_grid(WIDTH, HEIGHT, 32), 4)
    depth = np.full((HEIGHT, WIDTH, 1), 0.25, np.float32)
    for far, hidden in ((0.25, True), (0.5, False), (0.75, False)):
        depth[60, 100] = far
        build(coarse, depth)
        answers = query_units(coarse, live[:2], bounds, viewport, by_hull=True)
        assert ((answers.level >= 0) == hidden).all()
        assert (answers.outlines == 0).all() and (answers.misses == 0).all()
        assert (answers.cells >= (1 if hidden else 5)).all()
