"""Min-max pyramids: every bilinear lookup that the shader makes lies in the range that a query of its footprint gives."""

import numpy as np
import pytest

from pipeline import minmax
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.restrict import texcoord_rect
from pipeline.hull import make_input
from pipeline.minmax import build_pyramids, query_ranges
from pipeline.types import Pyramids, Viewport
from tests.naive_domain import NaiveMap, address
from tests.test_domain import IDENTITY, UNIT_SQUARE, flat_square, make_one, pack, random_points, shade

U = 2.0**-24
VIEWPORT = Viewport(0, 0, 1, 1, 0.0, 1.0)
SEEDS = range(4)
by_seed = pytest.mark.parametrize("seed", SEEDS, ids=lambda s: f"seed{s}")
by_address = pytest.mark.parametrize("mode", ["wrap", "mirror", "clamp"])
SIZES = [(1, 1), (1, 4), (2, 2), (8, 4), (3, 5), (7, 1), (33, 6), (17, 64)]
by_size = pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")


def random_image(rng, mode, size, scale=1.0, bias=0.0):
    """Mostly zero, with single high and low texels: a range that misses one texel is seen."""
    width, height = size
    texels = np.where(rng.random((height, width)) < 0.2, rng.normal(0, 1, (height, width)), 0)
    return NaiveMap(texels.astype(np.float32), mode, scale, bias)


def lookups(images, texcoords, uv):
    """What the shader reads, float64[n, points]: z of flat squares with the normal (0, 0, 1)."""
    n = len(images)
    patches = make_one(np.repeat(flat_square()[None], n, 0), texcoords, np.arange(n))
    clips, _ = shade(patches, uv, images)
    return [clip[:, 2].astype(np.float64) for clip in clips]


def query(images, rects, exact=False):
    maps = pack(images)
    return query_ranges(maps, build_pyramids(maps), np.arange(len(images)), np.asarray(rects, float), exact=exact)


def rect_of(texcoords):
    """(s0, s1, t0, t1) of corners float32[..., 4, 2]."""
    lo, hi = texcoords.min(axis=-2), texcoords.max(axis=-2)
    return np.stack([lo[..., 0], hi[..., 0], lo[..., 1], hi[..., 1]], -1)


def spread_out(rng, size, n):
    """Texture corners: tiny or wide, near or far, some on texel borders, some bow-ties."""
    middle = rng.uniform(-3, 3, (n, 1, 2)) * rng.choice([1, 1, 1000, 1e5], (n, 1, 1))
    wide = 10 ** rng.uniform(-4, 0.7, (n, 1, 1))
    corners = middle + rng.uniform(-1, 1, (n, 4, 2)) * wide
    corners[::3] = np.round(corners[::3] * np.array(size) * 2) / 2 / np.array(size)
    return corners.astype(np.float32)


@by_seed
@by_size
@by_address
def test_a_query_encloses_every_lookup(mode, size, seed):
    rng = np.random.default_rng([seed, *size])
    n = 24
    scales, biases = rng.normal(0, 1, n), rng.choice([0.0, 0.5, -2.0], n)
    images = [random_image(rng, mode, size, s, b) for s, b in zip(scales, biases, strict=True)]
    texcoords = spread_out(rng, size, n)
    ranges = [query(images, rect_of(texcoords), exact) for exact in (False, True)]
    assert (ranges[0][:, 0] <= ranges[1][:, 0]).all() and (ranges[1][:, 1] <= ranges[0][:, 1]).all()
    found = lookups(images, texcoords, [random_points(rng, 200) for _ in range(n)])
    for k, values in enumerate(found):
        lo, hi = ranges[1][k]
        assert lo <= values.min() and values.max() <= hi, f"seed {seed}, {images[k]}, {texcoords[k].tolist()}"


@by_seed
@by_address
def test_sub_domains_enclose_their_lookups(mode, seed):
    rng = np.random.default_rng(100 + seed)
    for size in ((5, 3), (64, 16)):
        texcoords = spread_out(rng, size, 40)
        ends = np.sort(rng.integers(0, 65537, (40, 2, 2)) / 65536.0, axis=-1)
        assert_enclosed(rng, mode, size, texcoords, ends, f"seed {seed}")


@by_seed
@by_address
def test_sub_domains_enclose_lookups_where_large_coordinates_cancel(mode, seed):
    """Texture coordinates near 0 from corners that are far away: the shader is off by many texels."""
    rng = np.random.default_rng(120 + seed)
    ends = np.repeat(rng.integers(1, 65536, (40, 2, 1)) / 65536.0, 2, axis=-1)
    texcoords = rng.uniform(-3e5, 3e5, (40, 4, 2))
    u, v = ends[:, :1, 0], ends[:, 1:, 0]
    rest = (1 - v) * ((1 - u) * texcoords[:, 0] + u * texcoords[:, 1]) + v * (1 - u) * texcoords[:, 2]
    texcoords[:, 3] = -rest / (u * v)
    assert_enclosed(rng, mode, (64, 16), texcoords.astype(np.float32), ends, f"seed {seed}")


def assert_enclosed(rng, mode, size, texcoords, ends, context):
    """Lookups of 40 patches over domains float64[40, 2, 2] lie in their ranges."""
    images = [random_image(rng, mode, size, rng.normal()) for _ in range(40)]
    patches = make_one(np.repeat(flat_square()[None], 40, 0), texcoords, np.arange(40))
    stage = make_input(patches, pack(images), IDENTITY, VIEWPORT, domain=np.ascontiguousarray(ends.reshape(40, 4)))
    uv = [np.float32(e[:, 0] + np.round(random_points(rng, 50) * np.ptp(e, axis=1) * 65536) / 65536) for e in ends]
    found = lookups(images, texcoords, uv)
    for exact in (False, True):
        ranges = displacement_ranges(stage, exact=exact)
        for k in range(40):
            lo, hi = ranges[:, k]
            assert lo <= found[k].min() and found[k].max() <= hi, f"{context}, patch {k}, {ends[k].tolist()}"


def brute_force(image, rect):
    """Least and greatest texel that bilinear lookups in a rectangle may read, each texel number addressed by itself."""
    height, width = image.texels.shape
    s0, s1, t0, t1 = rect
    columns = np.arange(np.floor(s0 * width - 0.5), np.floor(s1 * width - 0.5) + 2).astype(int)
    rows = np.arange(np.floor(t0 * height - 0.5), np.floor(t1 * height - 0.5) + 2).astype(int)
    columns = sorted({address(int(i), width, image.address) for i in columns})
    rows = sorted({address(int(j), height, image.address) for j in rows})
    chosen = image.texels[np.ix_(rows, columns)]
    return float(chosen.min()), float(chosen.max())


@by_seed
@by_size
@by_address
def test_the_exact_query_equals_brute_force_and_the_pyramid_encloses_it(mode, size, seed):
    rng = np.random.default_rng([seed, 7, *size])
    n = 150
    image = NaiveMap(rng.normal(0, 1, size[::-1]).astype(np.float32), mode, 1.0, 0.0)
    # Ends away from texel borders, so that rounding cannot decide.
    low = rng.integers(-3 * np.array(size), 4 * np.array(size), (n, 2)) + rng.uniform(0.05, 0.95, (n, 2)) + 0.5
    high = low + np.floor(rng.uniform(0, 2.5, (n, 2)) ** 2 * np.array(size))
    rects = np.stack([low, high], -1).reshape(n, 4) / np.repeat(size, 2)
    expected = np.array([brute_force(image, rect) for rect in rects])
    exact, quick = (query([image] * n, rects, e) for e in (True, False))
    # A mirrored range of more texels than the axis has is answered with the whole axis.
    count = np.floor(rects[:, 1::2] * size - 0.5) - np.floor(rects[:, ::2] * size - 0.5) + 2
    same = (count <= size).all(axis=1) | (mode != "mirror")
    np.testing.assert_allclose(exact[same], expected[same], rtol=0, atol=12 * U * abs(image.texels).max())
    assert (exact[:, 0] <= expected[:, 0]).all() and (expected[:, 1] <= exact[:, 1]).all()
    assert (quick[:, 0] <= exact[:, 0]).all() and (exact[:, 1] <= quick[:, 1]).all()


def test_exact_and_pyramid_agree_on_whole_blocks():
    rng = np.random.default_rng(3)
    image = NaiveMap(rng.normal(0, 1, (16, 16)).astype(np.float32), "clamp", 1.0, 0.0)
    for x, y, k in ((0, 0, 16), (8, 0, 8), (4, 12, 4), (6, 10, 2)):
        rect = [(x + 0.6) / 16, (x + k - 0.6) / 16, (y + 0.6) / 16, (y + k - 0.6) / 16]
        np.testing.assert_array_equal(query([image], [rect], True), query([image], [rect], False))


class Counting:
    """Level-packed values that note how often they are read."""

    def __init__(self, values):
        self.values, self.reads = values, 0

    def __getitem__(self, k):
        self.reads += 1
        return self.values[k]


@by_size
def test_a_piece_reads_at_most_four_texels(size):
    rng = np.random.default_rng(5)
    texels = rng.normal(0, 1, size[::-1]).astype(np.float32)
    pyramids = build_pyramids(pack([NaiveMap(texels, "clamp", 1.0, 0.0)]))
    for _ in range(300):
        (x0, x1), (y0, y1) = (np.sort(rng.integers(0, n, 2)) for n in size)
        lo = Counting(pyramids.lo)
        counted = Pyramids(lo, *pyramids[1:])
        least, most = minmax._level_range.py_func(counted, 0, int(x0), int(x1), int(y0), int(y1))
        assert lo.reads == 4
        part = texels[y0 : y1 + 1, x0 : x1 + 1]
        assert least <= part.min() and part.max() <= most


@by_size
def test_levels_hold_their_blocks_extremes(size):
    rng = np.random.default_rng(6)
    texels = rng.normal(0, 1, size[::-1]).astype(np.float32)
    pyramids = build_pyramids(pack([NaiveMap(texels, "wrap", 1.0, 0.0)]))
    level = 0
    while True:
        width, height = pyramids.size[0, level]
        assert (width, height) == tuple(-(-n // 2**level) for n in size)
        for y, x in np.ndindex(height, width):
            block = texels[y << level : (y + 1) << level, x << level : (x + 1) << level]
            k = pyramids.first[0, level] + y * width + x
            assert (pyramids.lo[k], pyramids.hi[k]) == (block.min(), block.max())
        if width == height == 1:
            break
        level += 1


def test_ranges_that_reach_the_whole_map_give_the_whole_range():
    rng = np.random.default_rng(8)
    for mode in ("wrap", "mirror"):
        image = random_image(rng, mode, (7, 5), -0.7, 0.2)
        whole = build_pyramids(pack([image])).whole[0]
        for reach in (1.0, 3.7, 1e9, 1e30):
            np.testing.assert_allclose(query([image], [[-reach, reach, -reach, reach]], True)[0], whole, rtol=1e-15)


def far_corners(where):
    return np.float32(where) + UNIT_SQUARE * np.float32(0.1)


@pytest.mark.parametrize("where", [2.0**21, -(2.0**22), 2.0**28, -1e9, 1e12, 1e30, [0.3, 1e12], [-1e12, 0.3]], ids=str)
@by_address
def test_far_away_coordinates_are_enclosed(mode, where):
    """Beyond 2^30 texels the shader reads texel (0, 0), whatever the other coordinate."""
    rng = np.random.default_rng(9)
    image = NaiveMap(rng.normal(0, 1, (6, 10)).astype(np.float32), mode, 1.0, 0.0)
    texcoords = far_corners(where)
    patches = make_one(flat_square(), texcoords, 0)
    stage = make_input(patches, pack([image]), IDENTITY, VIEWPORT)
    (found,) = lookups([image], texcoords[None], [random_points(rng, 100)])
    lo, hi = displacement_ranges(stage, exact=True)[:, 0]
    assert lo <= found.min() and found.max() <= hi


def test_a_broken_map_has_no_range():
    image = NaiveMap(np.array([[0, np.nan, 1, 1]], np.float32), "clamp", 1.0, 0.0)
    stage = make_input(
        make_one(flat_square(), UNIT_SQUARE * 0.1, 0),
        pack([image]),
        IDENTITY,
        VIEWPORT,
    )
    assert np.isnan(displacement_ranges(stage)).all()


def test_the_rectangle_holds_what_the_outline_misses():
    """Erratum of Sathe 2011: the texture region is the hull of the corners, not the quad that they outline."""
    corners = np.array([[0, 0], [1, 0], [0, 1], [0.1, 0.1]], np.float32)  # concave at the last one
    u = v = 0.5
    s, t = ((1 - v) * ((1 - u) * corners[0] + u * corners[1]) + v * ((1 - u) * corners[2] + u * corners[3])).tolist()
    outline = corners[[0, 1, 3, 2]]
    assert not inside_polygon(outline, s, t)
    s0, s1, t0, t1 = texcoord_rect(corners, 0.0, 1.0, 0.0, 1.0)
    assert s0 <= s <= s1 and t0 <= t <= t1
    texels = np.zeros((40, 40), np.float32)
    texels[int(t * 40), int(s * 40)] = 1  # outside the outline, with the filter's reach
    (found,) = lookups([NaiveMap(texels, "clamp", 1.0, 0.0)], corners[None], [np.array([[u, v]], np.float32)])
    assert found[0] > 0 and not any(
        inside_polygon(outline, (i + di) / 40, (j + dj) / 40)
        for j, i in np.argwhere(texels > 0)
        for di in (-0.5, 0.5, 1.5)
        for dj in (-0.5, 0.5, 1.5)
    )


def inside_polygon(corners, x, y):
    inside = False
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            inside = not inside
    return inside


def test_texels_without_the_filters_footprint_miss_lookups():
    """Erratum of both papers: texels floor(s0 N) .. floor(s1 N) alone do not bound bilinear lookups between s0 and s1."""
    rng = np.random.default_rng(11)
    missed = 0
    for _ in range(200):
        image = NaiveMap(rng.normal(0, 1, (1, 16)).astype(np.float32), "clamp", 1.0, 0.0)
        s0, s1 = np.sort(rng.uniform(0, 1, 2)).astype(np.float32)
        texcoords = np.array([[s0, 0.5], [s1, 0.5], [s0, 0.5], [s1, 0.5]], np.float32)
        (found,) = lookups([image], texcoords[None], [random_points(rng, 40)])
        printed = image.texels[0, int(s0 * 16) : int(s1 * 16) + 1]
        missed += found.min() < printed.min() or found.max() > printed.max()
        ((lo, hi),) = query([image], [rect_of(texcoords)])
        assert lo <= found.min() and found.max() <= hi
    assert missed > 20
