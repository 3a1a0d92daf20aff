"""The coarse Z pyramid against its slow twin: sizes that are no powers of two, ties, levels, several samples a pixel."""

import numpy as np
import pytest

import tiler
from pipeline.bounds.project import allocate
from pipeline.types import Viewport
from tests.naive_coarse_z import NaiveCoarseZ
from tests.scenes import flat_patch, looking_along_y, patch_scene
from tiler.coarse_z import build, make_pyramid
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.occlusion import query_units


@pytest.mark.parametrize("width, height", [(1, 1), (8, 8), (37, 21), (64, 32), (65, 33), (7, 130)])
@pytest.mark.parametrize("block, tile, samples", [(4, 8, 1), (8, 8, 4), (8, 64, 1), (16, 32, 4)])
def test_pyramid_and_queries_are_their_slow_twin(width, height, block, tile, samples):
    rng = np.random.default_rng([width, height, block, samples])
    depth = (rng.integers(0, 9, (height, width, samples)) / 8).astype(np.float32)
    depth[: height // 2] *= 0.25
    coarse, naive = make_pyramid(make_grid(width, height, tile), block), NaiveCoarseZ(width, height, block)
    build(coarse, depth)
    naive.read_all(depth)
    for level in range(len(coarse.first)):
        for cy in range(coarse.height[level]):
            for cx in range(coarse.width[level]):
                side = block << level
                part = depth[cy * side : (cy + 1) * side, cx * side : (cx + 1) * side]
                cell = coarse.first[level] + cy * coarse.width[level] + cx
                assert (coarse.farthest[cell], coarse.nearest[cell]) == (part.max(), part.min())
    x, y = np.sort(rng.integers(0, width + 1, (50, 2))), np.sort(rng.integers(0, height + 1, (50, 2)))
    rect = np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1).astype(np.int32)
    z = (rng.integers(0, 10, 50) / 8).astype(np.float32)
    bounds = allocate(50)._replace(rect=rect, z_min=z)
    viewport = Viewport(0, 0, width, height, 0.0, 1.0)
    level, cells, _, _ = query_units(coarse, np.arange(50, dtype=np.int32), bounds, viewport)
    for k, (x0, y0, x1, y1) in enumerate(rect.tolist()):
        if x0 == x1 or y0 == y1:
            assert (level[k], cells[k]) == (-1, 0)
            continue
        expected, read = naive.hidden_at((x0, y0, x1 - 1, y1 - 1), z[k], True, 1 << 20)
        assert (level[k], cells[k]) == (-1 if expected is None else expected, read)
        if level[k] >= 0:
            assert (depth[y0:y1, x0:x1] < z[k]).all()


@pytest.mark.parametrize("feedback", ["tile", "previous_frame", "two_phase"])
def test_a_camera_inside_a_box_sees_its_patch(feedback):
    """The patch bends around the eye: its nearest depth is 0, and it is drawn although a wall stands close."""
    bent = flat_patch(-2, -1, 2, 1, y=-3.0)
    bent[1:3, :, 1] = -6.0
    scene = patch_scene(
        [flat_patch(-0.2, -0.2, 0.2, 0.2, y=-3.2), bent],
        camera=looking_along_y(near=0.1, fov=120),
        factor=8.0,
        face_cull="none",
    )
    plain = tiler.simulate(scene, Machine(binning="triangle", cull=()), frame=1)
    machine = Machine(cull=("frustum", "occlusion"), z_feedback=feedback, queue_order="front_to_back")
    assert np.array_equal(tiler.simulate(scene, machine, frame=1).color, plain.color)
    assert len(np.unique(plain.color.reshape(-1, 4), axis=0)) >= 3  # background and both patches


@pytest.mark.parametrize("binning", ["triangle", "patch", "subpatch"])
def test_hidden_walls_are_not_shaded(binning):
    """Ten equal walls at one place: the first hides the others in submit order, by the tie; not where order is free."""
    scene = patch_scene([flat_patch(-4, -3, 4, 3)] * 10, factor=4.0)
    what = "pairs" if binning == "triangle" else "triangles"
    cull = ("frustum", "occlusion" if binning == "triangle" else "occlusion:triangle")
    machine = Machine(binning=binning, cull=cull, tile=64, coarse_z_block=4, subpatch_extent=65536.0)
    c = tiler.simulate(scene, machine).counters
    tested = c[f"cz_{what}_tested"]
    assert tested >= 100
    assert c[f"cz_{what}_occluded"] == (0 if binning == "subpatch" else tested * 9 // 10)


def test_counters_of_coarse_z_balance(load):
    scene = load("colonnade", size=(104, 60), factor=3)
    for feedback in ("tile", "previous_frame", "two_phase"):
        for binning in ("patch", "subpatch"):
            machine = Machine(
                tile=16, binning=binning, z_feedback=feedback, bounds="tpatch", domain_cache="lru:8",
                cull=("frustum", "occlusion", "occlusion:triangle"),
            )  # fmt: skip
            c = tiler.simulate(scene, machine, frame=5).counters
            worked_on = c["queue_entries"] - c["cz_pairs_occluded"]
            assert c["dc_lookups"] == worked_on
            drawn = c["su_culled_outside_tile"] + c["cz_triangles_occluded"] + c["rs_triangles"]
            assert c["su_triangles"] == drawn
            hits = sum(c[f"cz_hits_level_{n}"] for n in ("0", "1", "2", "3_up"))
            hidden = c["cz_pairs_occluded"] + c["cz_triangles_occluded"] + c["cz_units_occluded"]
            if feedback == "previous_frame":  # rejected in the old pyramid, and tested anew
                hidden += c["cz_units_occluded"] + c["cz_stale_rejects"]
            assert hits == hidden > 0
            if binning == "patch":
                fates = c["bin_patches"] + c["bin_patches_offscreen"] + c["cz_units_occluded"]
                assert fates == c["ts_patches"]
            else:
                fates = c["bin_subpatches"] + c["bin_subpatches_offscreen"] + c["cz_units_occluded"]
                assert fates == c["hs_subpatches"] - c["hs_subpatches_culled_frustum"]
