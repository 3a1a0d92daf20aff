"""Planes under bounds: no vertex lies in front of them, the slow twin agrees, and they tell more than the nearest depth."""

import numpy as np
import pytest

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.tessellator import make_patterns
from pipeline.types import Viewport
from tests.naive_near_planes import naive_nearest
from tiler import front_end
from tiler.host import Host
from tiler.near_planes import nearest_in, planes_under
from tiler.scene.camera import camera_at

TILE = 32


def frame_of(scene, number, bound):
    """Live patches with their bounds, and their set-up vertices."""
    viewport = Viewport(0, 0, scene.picture.width, scene.picture.height, 0.0, 1.0)
    camera = camera_at(scene.camera, number, viewport.width / viewport.height)
    patches, packed = front_end.run_vertex_shader(scene, number), front_end.scene_maps(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    bounds, flags = BOUNDS[bound](stage), np.zeros(len(patches.map_id), np.uint8)
    hull.run_cull_tests(("frustum",), stage, bounds, flags)
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    live = hull.live_patches(flags)
    with Host(1) as host:
        points = front_end.shade_domain_points(live, patches, patterns, packed.maps, camera, host)
        geometry = front_end.set_up_triangles(live, points, patterns, viewport, scene, host)
    return live, bounds, viewport, geometry


@pytest.mark.parametrize("bound", ["cbox", "tpatch", "taylor_clamped"])
@pytest.mark.parametrize("name", ["waves", "colonnade", "creature_small", "teapot"])
def test_no_vertex_lies_in_front(name, bound, load):
    live, bounds, viewport, geometry = frame_of(load(name, size=(200, 120), factor=3), 7, bound)
    planes = planes_under(live, bounds, viewport)
    triangles, window = geometry.triangles, geometry.window
    with_planes = 0
    for k in range(len(live)):
        vertices = np.unique(triangles.vertex[triangles.first[k] : triangles.first[k] + triangles.used[k]])
        x, y = window.x[vertices] / 256.0, window.y[vertices] / 256.0
        for a, b, c in planes[k]:
            assert (window.z[vertices] >= a * x + b * y + c).all(), (live[k], a, b, c)
        with_planes += (planes[k, :, 2] != -1.0).any()
    assert with_planes > len(live) / 2


@pytest.mark.parametrize(("name", "share"), [("waves", 0.04), ("colonnade", 0.08), ("creature_small", 0.0)])
def test_nearest_depth_is_that_of_the_slow_twin(name, share, load):
    """And it is farther than the bound's own in some share of the tiles: large patches seen at a slant gain most."""
    live, bounds, viewport, _ = frame_of(load(name, size=(200, 120), factor=2), 0, "tpatch")
    planes = planes_under(live, bounds, viewport)
    pairs = nearer = 0
    for k in range(0, len(live), 1 + len(live) // 150):
        p = live[k]
        row = type(bounds)(*(a[p : p + 1] for a in bounds))
        x0, y0, x1, y1 = (int(c) for c in bounds.rect[p])
        for left in range(x0, x1, TILE):
            for top in range(y0, y1, TILE):
                box = (left, top, min(left + TILE, x1) - 1, min(top + TILE, y1) - 1)
                found, twin = nearest_in(planes[k], bounds.z_min[p], *box), naive_nearest(row, viewport, box)
                assert twin - 2e-6 <= found <= twin + 2.0**-24
                assert found >= bounds.z_min[p]
                pairs, nearer = pairs + 1, nearer + (found > bounds.z_min[p])
    assert nearer >= share * pairs


def test_a_box_about_the_eye_has_no_planes(load):
    """A camera in the middle of a patch's box, and boxes that are no boxes."""
    scene = load("colonnade", size=(64, 40), factor=2)
    live, bounds, viewport, _ = frame_of(scene, 0, "cbox")
    corners = bounds.corners.copy()
    corners[live[0], :4, 3] *= -1.0
    corners[live[1]] = np.nan
    corners[live[2]] = corners[live[2], :1]
    planes = planes_under(live, bounds._replace(corners=corners), viewport)
    for k in range(3):
        assert np.array_equal(planes[k], np.tile([0.0, 0.0, -1.0], (3, 1)))
        assert nearest_in(planes[k], np.float32(0.25), 0, 0, 31, 31) == np.float32(0.25)
