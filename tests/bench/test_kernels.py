"""Seconds of the kernels: `python -m pytest -m timing tests/bench`. Nothing is asserted about them here; `tiler bench` says
what is asked. Compare with `--benchmark-save` and `--benchmark-compare`."""

import numpy as np
import pytest

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from pipeline.tessellator import make_patterns
from pipeline.types import Viewport
from tiler import back_end, front_end
from tiler.bench.scenes import torus
from tiler.bench.stages import BASELINE, hull_stage
from tiler.grid import make_grid
from tiler.host import Host
from tiler.scene.camera import camera_at
from tiler.simulation import simulate

pytestmark = pytest.mark.timing
SIZE = (960, 540)


@pytest.fixture(scope="module")
def scene():
    return torus(1000, 16, SIZE)


@pytest.fixture(scope="module")
def stage(scene):
    return hull_stage(scene)


@pytest.fixture(scope="module")
def front(scene, stage):
    """Camera, live patches, patterns, viewport and a host of one thread."""
    camera = camera_at(scene.camera, 0, SIZE[0] / SIZE[1])
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    live = np.arange(scene.num_patches, dtype=np.int32)
    return camera, live, patterns, Viewport(0, 0, *SIZE, 0.0, 1.0), Host(1)


@pytest.fixture(scope="module")
def points(stage, front):
    camera, live, patterns, _, host = front
    return front_end.shade_domain_points(live, stage.patches, patterns, stage.maps, camera, host)


@pytest.fixture(scope="module")
def geometry(scene, front, points):
    _, live, patterns, viewport, host = front
    return front_end.set_up_triangles(live, points, patterns, viewport, scene, host)


@pytest.mark.parametrize("name", BOUNDS)
def test_bound(benchmark, stage, name):
    benchmark(BOUNDS[name], stage)


@pytest.mark.parametrize("name", CULL_TESTS)
def test_cull(benchmark, stage, name):
    patches = stage.patches._replace(map_id=np.full_like(stage.patches.map_id, -1))
    plain = stage._replace(patches=patches)
    bounds = BOUNDS["cbox"](plain)
    benchmark(lambda: CULL_TESTS[name](plain, bounds, np.zeros(len(patches.map_id), np.uint8)))


def test_domain_shader(benchmark, stage, front):
    camera, live, patterns, _, host = front
    benchmark(front_end.shade_domain_points, live, stage.patches, patterns, stage.maps, camera, host)


def test_set_up(benchmark, scene, front, points):
    _, live, patterns, viewport, host = front
    benchmark(front_end.set_up_triangles, live, points, patterns, viewport, scene, host)


def test_binning(benchmark, stage, front, geometry):
    _, live, _, _, host = front
    grid, bounds = make_grid(*SIZE, BASELINE.tile), BOUNDS["cbox"](stage)
    benchmark(back_end.bin_batch, live, geometry, bounds, BASELINE, grid, host)


def test_frame(benchmark, scene):
    simulate(scene, BASELINE, threads=1)
    benchmark(simulate, scene, BASELINE, threads=1)
