"""Sub-domains, exact overlap, tile walks and caches, each against a slow way of saying the same."""

from collections import OrderedDict
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from pipeline.tessellator import make_patterns, tessellate
from pipeline.types import TessFactors
from tests.naive_machine import naive_hilbert, naive_morton
from tests.scenes import flat_patch, patch_scene
from tiler import front_end
from tiler.config import Machine
from tiler.domain_cache import Events, replay_shading, vertex_misses
from tiler.grid import make_grid
from tiler.host import Host
from tiler.overlap import bin_hulls
from tiler.subpatch import part_patterns
from tiler.tile import NUM_TILE_COUNTS, TileCount
from tiler.tile_walk import walk_tiles

PATTERNS = [
    ("integer", (4,) * 6),
    ("fractional_odd", (2.2, 7.5, 1, 4.1, 5.6, 3.3)),
    ("fractional_even", (6.1, 6.1, 9, 2, 6.3, 6.2)),
    ("pow2", (8, 1, 2, 16, 8, 4)),
    ("integer", (1,) * 6),
]


@pytest.mark.parametrize("partitioning, factors", PATTERNS)
@pytest.mark.parametrize("cut", [1, 2, 3])
def test_each_triangle_has_one_owner(partitioning, factors, cut):
    """The cells of a cut share out the pattern's triangles, corners and winding unchanged, points only those touched."""
    six = np.array([factors], np.float32)
    patterns = make_patterns(TessFactors(six[:, :4], six[:, 4:]), partitioning, "triangle_ccw")
    uv, indices = tessellate("quad", partitioning, factors[:4], factors[4:], "triangle_ccw")
    ends = np.linspace(0, 1, (1 << cut) + 1)
    cells = [(a, b, c, d) for a, b in pairwise(ends) for c, d in pairwise(ends)]
    parts, original = part_patterns(patterns, np.zeros(len(cells), np.int32), np.array(cells))
    seen = []
    for k, (u0, u1, v0, v1) in enumerate(cells):
        part = parts.of_patch[k]
        points = parts.uv[:, parts.first_point[part] : parts.first_point[part + 1]].T
        used = set()
        for t in range(parts.first_triangle[part], parts.first_triangle[part + 1]):
            corners = points[parts.indices[3 * t : 3 * t + 3]]
            used.update(parts.indices[3 * t : 3 * t + 3].tolist())
            number = int(original[t])
            assert np.array_equal(corners, uv[indices[3 * number : 3 * number + 3]])
            u, v = (sum(Fraction(float(c)) for c in column) / 3 for column in corners.T)
            assert u0 <= u <= u1 and v0 <= v <= v1
            seen.append(number)
        assert len(used) == len(points) == len(np.unique(points, axis=0))
    assert sorted(seen) == list(range(len(indices) // 3))


@pytest.mark.parametrize("budget", [1, 2, 7, 64])
def test_the_budget_of_sub_domains_is_kept(budget, load):
    scene = load("waves", size=(200, 120), factor=8)
    c = tiler.simulate(scene, Machine(binning="subpatch", tile=8, subpatch_extent=1.0, subpatch_budget=budget)).counters
    assert c["hs_subpatches"] <= budget * c["ts_patches"]
    assert (c["hs_subpatches"] == c["ts_patches"]) == (budget == 1)
    assert c["hs_bounds_evaluated"] >= c["ia_primitives"] + 2 * (c["hs_subpatches"] - c["ts_patches"]) * (budget > 1)


def cut_polygon(polygon, inside, cross):
    """Sutherland and Hodgman, one side."""
    kept = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if inside(a):
            kept.append(a)
        if inside(a) != inside(b):
            kept.append(cross(a, b))
    return kept


def hull_touches(points, x0, y0, x1, y1):
    """Whether the convex hull of the points (monotone chain) has a part in the rectangle."""
    points = sorted(map(tuple, points))

    def chain(sequence):
        made = []
        for p in sequence:
            while len(made) > 1 and (made[-1][0] - made[-2][0]) * (p[1] - made[-2][1]) <= (
                made[-1][1] - made[-2][1]
            ) * (p[0] - made[-2][0]):
                made.pop()
            made.append(p)
        return made[:-1]

    polygon = chain(points) + chain(points[::-1])
    for axis, limit, sign in ((0, x0, 1), (0, x1, -1), (1, y0, 1), (1, y1, -1)):

        def cross(a, b, axis=axis, limit=limit):
            t = (limit - a[axis]) / (b[axis] - a[axis])
            return tuple(p + t * (q - p) for p, q in zip(a, b, strict=True))

        polygon = cut_polygon(
            polygon, lambda p, axis=axis, limit=limit, sign=sign: sign * (p[axis] - limit) >= 0, cross
        )
        if not polygon:
            return False
    return True


@pytest.mark.parametrize("name", ["teapot", "waves", "colonnade"])
def test_hulls_go_to_the_tiles_that_they_touch(name, load):
    """All tiles that the hull of the corners touches, and none farther than the widening; fewer than the rectangle has."""
    scene = load(name, size=(150, 90), factor=2)
    from pipeline.types import Viewport
    from tiler.scene.camera import camera_at

    camera, viewport = camera_at(scene.camera, 0, 150 / 90), Viewport(0, 0, 150, 90, 0.0, 1.0)
    patches = front_end.run_vertex_shader(scene, 0)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, front_end.scene_maps(scene, 0), factors, camera, viewport)
    bounds, grid = BOUNDS["tpatch"](stage), make_grid(150, 90, 8)
    live = np.arange(min(len(bounds.rect), 300), dtype=np.int32)
    with Host(1) as host:
        queues = bin_hulls(live, bounds, grid, host)
    pairs = set(
        zip(np.repeat(np.arange(grid.num_tiles), np.diff(queues.first)).tolist(), queues.item.tolist(), strict=True)
    )
    left_out = checked = 0
    for k in live.tolist():
        x0, y0, x1, y1 = bounds.rect[k].tolist()
        corners = bounds.corners[k]
        in_front = bool((corners[:, 3] > 1e-3).all() and (corners[:, 2] > 1e-3).all())
        if in_front:
            xs, ys = (corners[:, 0] / corners[:, 3] + 1) * 75, (1 - corners[:, 1] / corners[:, 3]) * 45
        for tile in range(grid.num_tiles):
            tx, ty = tile % grid.tiles_x * 8, tile // grid.tiles_x * 8
            box = (max(tx, x0), max(ty, y0), min(tx + 8, x1), min(ty + 8, y1))
            if box[0] >= box[2] or box[1] >= box[3]:
                assert (tile, k) not in pairs
            elif in_front:
                checked += 1
                if hull_touches(list(zip(xs, ys, strict=True)), *box):
                    assert (tile, k) in pairs
                elif not hull_touches(
                    list(zip(xs, ys, strict=True)), box[0] - 0.05, box[1] - 0.05, box[2] + 0.05, box[3] + 0.05
                ):
                    assert (tile, k) not in pairs
                    left_out += 1
            else:
                assert (tile, k) in pairs
    assert checked > 100 and left_out > 5


@pytest.mark.parametrize("walk, curve", [("morton", naive_morton), ("hilbert", naive_hilbert)])
@pytest.mark.parametrize("size", [(8, 8), (64, 64), (100, 30), (17, 130)])
def test_tile_walks(walk, curve, size):
    grid = make_grid(*size, 8)
    order = walk_tiles(grid, walk)
    side = 1
    while side < max(grid.tiles_x, grid.tiles_y):
        side *= 2
    wanted = [y * grid.tiles_x + x for x, y in curve(side) if x < grid.tiles_x and y < grid.tiles_y]
    assert order.tolist() == wanted
    if walk == "hilbert" and size == (64, 64):
        y, x = np.divmod(order, 8)
        assert (np.abs(np.diff(x)) + np.abs(np.diff(y)) == 1).all()


@pytest.mark.parametrize("cache", ["none", "lru:1", "lru:3", "lru:100", "frame"])
@pytest.mark.parametrize("cores", [1, 3, 20])
def test_domain_caches_replay_what_happened(cache, cores):
    rng = np.random.default_rng([cores, len(cache)])
    walk, points = rng.permutation(12), rng.integers(1, 50, 9)
    events = []
    for number in (0, 0, 1):
        first = np.concatenate([[0], np.cumsum(rng.integers(0, 7, 12))])
        events.append(
            Events(number, first, rng.integers(0, 9, first[-1]), rng.integers(0, 2, first[-1]).astype(np.uint8))
        )
    counts = np.zeros((12, NUM_TILE_COUNTS), np.int64)
    replay_shading(events, points, walk, cores, cache, counts)
    expected = np.zeros((12, 3), np.int64)
    room = {"none": 0, "frame": 99}.get(cache, int(cache[4:]) if cache.startswith("lru") else 0)
    held: dict[int, OrderedDict] = {}
    for number in (0, 1):
        for place, tile in enumerate(walk):
            own = held.setdefault(0 if cache == "frame" else place % cores, OrderedDict())
            for event in (e for e in events if e.number == number):
                for q in range(event.first[tile], event.first[tile + 1]):
                    unit = int(event.unit[q])
                    if event.outcome[q]:
                        continue
                    expected[tile, 1] += room > 0
                    expected[tile, 2] += unit in own
                    expected[tile, 0] += 0 if unit in own else points[unit]
                    if room:
                        own[unit] = True
                        own.move_to_end(unit)
                        if len(own) > room:
                            own.popitem(last=False)
    columns = [TileCount.DS_INVOCATIONS, TileCount.CACHE_LOOKUPS, TileCount.CACHE_HITS]
    assert np.array_equal(counts[:, columns], expected)


@pytest.mark.parametrize("entries", [1, 3, 16, 4096])
def test_vertex_cache_is_first_in_first_out(entries):
    six = np.array([(5, 3, 4, 6, 5, 4), (16,) * 6], np.float32)
    patterns = make_patterns(TessFactors(six[:, :4], six[:, 4:]), "integer", "triangle_ccw")
    misses = vertex_misses(patterns, entries)
    for p in range(2):
        fifo, expected = [], 0
        for i in patterns.indices[3 * patterns.first_triangle[p] : 3 * patterns.first_triangle[p + 1]]:
            if i not in fifo:
                expected += 1
                fifo = [*fifo, i][-entries:]
        assert misses[p] == expected
    if entries == 4096:
        assert np.array_equal(misses, vertex_misses(patterns, 0))


@pytest.mark.parametrize("binning", ["triangle", "patch", "subpatch"])
@pytest.mark.parametrize("size, tile", [((1, 1), 512), ((70, 45), 512), ((45, 1), 8)])
def test_tiles_larger_than_the_picture_and_a_patch_over_every_tile(binning, size, tile):
    wall = flat_patch(-80, -9, 80, 9)
    scene = patch_scene([wall, flat_patch(-0.5, -0.5, 0.5, 0.5, y=-1)], size=size, factor=9.0)
    machine = Machine(binning=binning, tile=tile, cull=("frustum", "occlusion", "occlusion:block"), coarse_z_block=8,
                      overlap="exact", subpatch_extent=1.0)  # fmt: skip
    plain = tiler.simulate(replace(scene), Machine(binning="triangle", cull=()))
    frame = tiler.simulate(scene, machine)
    assert np.array_equal(frame.color, plain.color)
    if binning == "patch":
        assert frame.queues.entries.min() >= 1
