"""Silhouette-aware factors: one value for each shared edge, raised where a patch shows its outline."""

from dataclasses import replace

import numpy as np
import pytest

import tiler
from pipeline.silhouette import raise_factors, shared_edges
from pipeline.types import TessFactors
from tests.test_domain import reorient

# Both patches of a pair share the edge u = 1 of the first and u = 0 of the second; then the second is turned.


def grid(n: int, m: int) -> np.ndarray:
    """n x m bicubic patches over a plane with a bump, sharing edges bit for bit."""
    u, v = np.meshgrid(np.arange(3 * n + 1), np.arange(3 * m + 1), indexing="ij")
    points = np.stack([u, v, (u * v) % 5, np.ones_like(u)], axis=-1).astype(np.float32)
    return np.stack([points[3 * i : 3 * i + 4, 3 * j : 3 * j + 4] for i in range(n) for j in range(m)])


def test_a_grid_has_as_many_edges_as_it_should() -> None:
    edge = shared_edges(grid(3, 5))
    assert len(np.unique(edge)) == 4 * 5 + 3 * 6
    edge = edge.reshape(3, 5, 4)
    assert (edge[:-1, :, 2] == edge[1:, :, 0]).all(), "u = 1 of one is u = 0 of the next"
    assert (edge[:, :-1, 3] == edge[:, 1:, 1]).all(), "v = 1 of one is v = 0 of the next"


@pytest.mark.parametrize("orientation", range(8))
def test_edges_are_shared_whichever_way_a_neighbour_is_turned(orientation: int) -> None:
    patches = grid(2, 1)
    before = shared_edges(patches)
    patches[1] = reorient(patches[1], orientation)
    after = shared_edges(patches)
    assert len(np.unique(after)) == len(np.unique(before)) == 7
    assert (after[0, 2] == after[1]).sum() == 1


def test_minus_zero_is_zero() -> None:
    patches = grid(2, 1)
    patches[1][patches[1] == 0] = -0.0
    assert len(np.unique(shared_edges(patches))) == 7


def test_marked_patches_and_their_edges_are_raised() -> None:
    rng = np.random.default_rng(0)
    patches = grid(6, 6)
    edge = shared_edges(patches)
    common = rng.uniform(1, 20, edge.max() + 1).astype(np.float32)
    factors = TessFactors(common[edge], rng.uniform(1, 20, (36, 2)).astype(np.float32))
    marked = (rng.random(36) < 0.3).astype(np.uint8)
    raised = raise_factors(factors, edge, marked, 2.0, 24.0)
    for number in range(edge.max() + 1):
        sides = raised.edge[edge == number]
        assert len(set(sides.tolist())) == 1, "one value for a shared edge"
        touches = marked[np.argwhere(edge == number)[:, 0]].any()
        assert sides[0] == (min(np.float32(2) * common[number], np.float32(24)) if touches else common[number])
    assert (raised.inside[marked == 0] == factors.inside[marked == 0]).all()
    assert (raised.inside[marked == 1] == np.minimum(2 * factors.inside[marked == 1], np.float32(24))).all()


def test_a_limit_lowers_nothing() -> None:
    factors = TessFactors(np.full((1, 4), 40, np.float32), np.full((1, 2), 40, np.float32))
    raised = raise_factors(factors, shared_edges(grid(1, 1)), np.ones(1, np.uint8), 2.0, 24.0)
    assert (raised.edge == 40).all() and (raised.inside == 40).all()


def test_built_in_scenes_share_their_edges() -> None:
    edge = shared_edges(tiler.load_scene("waves").control_points)
    assert len(np.unique(edge)) == 2 * 32 * 33


def test_outlines_get_finer_and_nothing_else() -> None:
    scene = tiler.load_scene("teapot", size=(160, 90), factor=4)
    finer = replace(scene, tessellation=replace(scene.tessellation, silhouette=4.0))
    plain, raised = tiler.simulate(scene), tiler.simulate(finer)
    all_fine = tiler.simulate(replace(scene, tessellation=replace(scene.tessellation, factor=(16.0,) * 6)))
    points = [frame.counters["ts_domain_points"] for frame in (plain, raised, all_fine)]
    assert points[0] < points[1] < points[2]
    # Closer to the picture of 16 everywhere, at fewer points.
    outline = [((frame.depth < 1) != (all_fine.depth < 1)).sum() for frame in (plain, raised)]
    assert outline[1] < outline[0] / 3


def test_factors_of_silhouettes_do_not_depend_on_the_machine() -> None:
    scene = tiler.load_scene("teapot", size=(160, 90), factor=4)
    scene = replace(scene, tessellation=replace(scene.tessellation, silhouette=3.0))
    frames = [
        tiler.simulate(scene, machine)
        for machine in (tiler.Machine(binning="triangle", cull=()), tiler.Machine(tile=8), tiler.Machine(tile=128))
    ]
    for frame in frames[1:]:
        assert np.array_equal(frame.color, frames[0].color) and np.array_equal(frame.depth, frames[0].depth)


def test_the_verifier_knows_of_raised_factors() -> None:
    scene = tiler.load_scene("teapot", size=(160, 90), factor=4)
    scene = replace(scene, tessellation=replace(scene.tessellation, silhouette=3.0))
    assert tiler.simulate(scene, tiler.Machine(verify=True)).violations == ()
