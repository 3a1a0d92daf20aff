"""Heat maps: each against a slow loop, sums against the counters, and the pictures' scale."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tiler
from tests.naive import naive_coverage
from tests.scenes import flat_patch, looking_along_y, patch_scene, sliced
from tests.test_cli import tiler as run_tiler
from tiler import heatmaps
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.heatmaps import (
    FALSE_COLORS,
    check_heatmaps,
    depth_complexity_map,
    heatmap_names,
    heatmap_picture,
    heatmap_values,
    live_patches,
    live_triangles,
    overdraw_map,
    overlap_map,
    wasted_samples,
    window_corners,
    with_scale,
)
from tiler.host import Host

SMALL = {"size": (61, 37), "factor": 3}


@pytest.fixture(params=["teapot", "waves", "spikelog", "teapot-sliced"])
def scene(request, load):
    name, _, how = request.param.partition("-")
    return sliced(load(name, **SMALL)) if how else load(name, **SMALL)


def test_overlap_is_that_of_a_slow_loop(scene):
    machine = Machine(cull=("frustum", "backface:tessellation_safe"))
    alive = live_patches(scene, machine, 0)
    expected = np.zeros((37, 61), int)
    for x0, y0, x1, y1 in alive.bounds.rect[alive.live].tolist():
        for y in range(y0, y1):
            for x in range(x0, x1):
                expected[y, x] += 1
    found = overlap_map(scene, machine)
    assert found.dtype == np.int32 and np.array_equal(found, expected) and found.max() > 1
    counters = tiler.simulate(scene, machine).counters
    assert counters["bin_patches"] + counters["bin_patches_offscreen"] == len(alive.live)


def in_hull(points: np.ndarray, x: float, y: float) -> bool:
    """Whether a point is in the hull of points: no line through two of them has all of them strictly on its other side."""
    for i in range(len(points)):
        for j in range(len(points)):
            if i != j:
                (ax, ay), (bx, by) = points[i], points[j]
                sides = [(bx - ax) * (py - ay) - (by - ay) * (px - ax) for px, py in points]
                if all(side >= 0 for side in sides) and (bx - ax) * (y - ay) - (by - ay) * (x - ax) < 0:
                    return False
    return True


def test_hull_overlap_is_that_of_a_slow_loop(load):
    for scene in (load("teapot", **SMALL), sliced(load("teapot", **SMALL))):
        alive = live_patches(scene, Machine(), 0)
        corners, rects = window_corners(alive.bounds, alive.live, alive.viewport), alive.bounds.rect[alive.live]
        expected = np.zeros((37, 61), int)
        for points, (x0, y0, x1, y1) in zip(corners, rects.tolist(), strict=True):
            known = bool(np.isfinite(points).all())
            for y in range(y0, y1):
                for x in range(x0, x1):
                    expected[y, x] += not known or in_hull(points, x + 0.5, y + 0.5)
        found = overlap_map(scene, Machine(), exact=True)
        assert np.array_equal(found, expected)
        assert (found <= overlap_map(scene, Machine())).all() and found.sum() < overlap_map(scene, Machine()).sum()
        assert found.sum() >= 0.3 * overlap_map(scene, Machine()).sum()


def test_a_box_across_the_near_plane_counts_as_its_rectangle():
    patch = flat_patch(-1, -1, 1, 1)
    patch[..., 1] = np.linspace(-5, 3, 4)[:, None]
    scene = patch_scene([patch], camera=looking_along_y(4.0, near=0.5), face_cull="none")
    assert np.array_equal(overlap_map(scene, Machine(), exact=True), overlap_map(scene, Machine()))


@pytest.mark.parametrize("samples", [1, 4])
def test_overdraw_is_that_of_a_slow_loop(samples, load):
    for made in (load("teapot", **SMALL, samples=samples), sliced(load("waves", **SMALL, samples=samples))):
        machine = Machine(binning="triangle")
        expected = np.zeros((37, 61), int)
        with Host(1) as host:
            for geometry in live_triangles(made, live_patches(made, machine, 0), host):
                t = geometry.triangles
                for k in range(len(t.used)):
                    for vertices in t.vertex[t.first[k] : t.first[k] + t.used[k]]:
                        x, y = geometry.window.x[vertices], geometry.window.y[vertices]
                        expected += naive_coverage(x / 256, y / 256, 61, 37, samples).sum(axis=2)
        found = overdraw_map(made, machine)
        assert np.array_equal(found, expected) and found.max() > samples
        for threads in (1, 2):
            assert np.array_equal(overdraw_map(made, Machine(tile=8), threads=threads), found)


def test_sums_are_the_counters(scene):
    for machine in (
        Machine(blame=True),
        Machine(tile=8, binning="triangle", cull=(), blame=True),
        Machine(queue_model="hierarchy16", blame=True),
    ):
        frame = tiler.simulate(scene, machine, frame=1)
        c = frame.counters
        assert overdraw_map(scene, machine, 1).sum() == c["rs_samples_covered"]
        assert wasted_samples(frame).sum() == c["rs_samples_covered"] - c["om_samples_visible"]
        assert (wasted_samples(frame) >= 0).all()
        memory = frame.queues.memory
        assert memory.tile_passes.sum() == c["queue_tile_passes"]
        if machine.queue_model == "ideal":
            assert memory.tile_bytes.sum() == 4 * c["queue_entries"]
        for name in heatmap_names():
            assert heatmap_values(scene, frame, name).shape == (37, 61)


def test_depth_complexity_does_not_depend_on_the_machine(scene):
    """What a machine that culls nothing covers of the scene with both faces."""
    from dataclasses import replace

    found = depth_complexity_map(scene, Machine(cull=("frustum", "backface:tessellation_safe")))
    open_scene = replace(scene, face_cull="none")
    assert found.sum() == tiler.simulate(open_scene, Machine(cull=())).counters["rs_samples_covered"]
    assert (found >= overdraw_map(scene, Machine())).all()


def test_batches_change_no_map(load, monkeypatch):
    from tiler import front_end

    scene = load("waves", **SMALL)
    whole = overdraw_map(scene, Machine())
    monkeypatch.setattr(front_end, "BATCH_POINTS", 100)
    assert np.array_equal(overdraw_map(scene, Machine()), whole)


def test_an_empty_scene_has_black_maps():
    scene = patch_scene([])
    frame = tiler.simulate(scene, Machine(blame=True))
    for name in heatmap_names():
        values = heatmap_values(scene, frame, name)
        assert values.shape == (24, 40) and not values.any(), name
        assert heatmap_picture(scene, frame, name).width >= 40


def test_the_scale_says_what_the_colours_mean(load):
    scene = load("teapot", **SMALL)
    frame = tiler.simulate(scene)
    image = np.asarray(heatmap_picture(scene, frame, "bounds_overlap"))
    values = overlap_map(scene, frame.machine)
    assert image.shape[0] == 37 + 2 * heatmaps.BAR
    for value, color in ((0, FALSE_COLORS[0]), (values.max(), FALSE_COLORS[-1])):
        assert (image[:37, :61][values == value] == color).all()
    bar = image[37 + heatmaps.BAR + 8]
    inside = np.flatnonzero((bar == FALSE_COLORS[-1]).all(axis=1))
    assert inside.size and (bar == (0, 0, 0)).all(axis=1).any(), "both ends of the bar are there"
    tall = np.asarray(with_scale(Image.new("RGB", (400, 10)), "a label", 0, 2_500_000))
    assert tall.shape == (10 + 2 * heatmaps.BAR, 400, 3)
    other = np.asarray(with_scale(Image.new("RGB", (400, 10)), "a label", 0, 7))
    assert not np.array_equal(tall, other), "the numbers are printed"


def test_unknown_maps_are_named():
    assert check_heatmaps(["queue_bytes", "overdraw"]) == ["queue_bytes", "overdraw"]
    with pytest.raises(TilerError, match=r"heatmap: 'overdrew' is unknown; did you mean 'overdraw'\?"):
        check_heatmaps(["overdrew"])


def test_render_draws_them(tmp_path: Path):
    names = "bounds_overlap,bounds_overlap:hull,overdraw,queue_bytes,rs_triangles"
    done = run_tiler("render", "teapot", "--size", "96x64", "--factor", "4", "--heatmap", names, "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = {path.name for path in (tmp_path / "out").iterdir()}
    maps = {f"{name.replace(':', '_')}.png" for name in names.split(",")}
    assert found == {"color.png", "depth.npy", "counters.json"} | maps
    assert all(Image.open(tmp_path / "out" / name).size == (160, 64 + 2 * heatmaps.BAR) for name in maps)
    assert json.loads((tmp_path / "out" / "counters.json").read_text())["scene"] == "teapot"
