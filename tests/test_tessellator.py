"""The tessellator against the reference's answers, against its slow twin, and against what must hold of any mesh."""

import threading
from collections import Counter

import numpy as np
import pytest

from pipeline import tess_factors
from pipeline.tess_factors import DOMAINS, NUM_EDGES, NUM_INSIDES, ONE, OUTPUTS, PARTITIONINGS, fix_factors
from pipeline.tessellator import PatternCache, _count, _tessellate, make_patterns, tessellate
from pipeline.types import TessFactors
from tests.naive_tessellator import fix_factors as naive_fix_factors
from tests.naive_tessellator import naive_tessellate
from tests.shared_data import shared_file

MODES = [(domain, partitioning) for domain in DOMAINS for partitioning in PARTITIONINGS]
by_mode = pytest.mark.parametrize(("domain", "partitioning"), MODES)
by_meshed_mode = pytest.mark.parametrize(("domain", "partitioning"), [m for m in MODES if m[0] != "isoline"])


def fixed(points):
    """Float points as the integers they stand for; fails if they stand for none."""
    scaled = points.astype(np.float64) * ONE
    assert np.array_equal(scaled, np.rint(scaled))
    return scaled.astype(np.int64)


def split_factors(domain, factors):
    num_edges, num_insides = (num[DOMAINS.index(domain)] for num in (NUM_EDGES, NUM_INSIDES))
    return factors[:num_edges], factors[num_edges : num_edges + num_insides]


def fix_one(domain, partitioning, factors):
    """Fixed-point factors of one patch, or None if it is culled."""
    edge, inside = split_factors(domain, np.asarray(factors, np.float32))
    keys, of_patch = tess_factors.fix_factors(
        DOMAINS.index(domain), PARTITIONINGS[partitioning], edge[None], inside[None]
    )
    return None if of_patch[0] < 0 else keys[of_patch[0]]


def side_locations(partitioning, factor):
    """Where an edge of this factor has its points: an isoline is nothing but such an edge."""
    return fixed(tessellate("isoline", partitioning, (1, factor), (), "point")[0])[:, 0]


def random_factors(rng, count):
    """Rows of six: small ones, where the corner cases live, any, and some beyond the clamps."""
    high = rng.choice([3.0, 9.0, 20.0, 70.0], (count, 1), p=[0.4, 0.3, 0.2, 0.1])
    rows = rng.uniform(0.5, 1.0, (count, 6)) * rng.uniform(0.5, 1.0, (count, 6)) * high
    return np.where(rng.random((count, 6)) < 0.2, np.rint(rows), rows).astype(np.float32)


# The reference's answers


@pytest.fixture(scope="module")
def reference():
    with np.load(shared_file("data", "tessellator_reference.npz")) as file:
        return dict(file)


def differences(ref, k):
    """What differs from the reference in case k."""
    domain, partitioning, output = (str(ref[name][k]) for name in ("domain", "partitioning", "output"))
    factors = ref["factors_bits"][k].view(np.float32)
    edge, inside = split_factors(domain, factors)
    answer = tessellate if ref["legal"][k] else _tessellate
    points, indices = answer(domain, partitioning, edge, inside, output)
    key = fix_one(domain, partitioning, factors)
    num_factors = len(edge) + len(inside)
    minimal = domain != "isoline" and key is not None and bool((key[:num_factors] == ONE).all())
    points_at = slice(*ref["point_offset"][k : k + 2])
    indices_at = slice(*ref["index_offset"][k : k + 2])
    same = {
        "culled": (key is None) == ref["culled"][k],
        "minimal": minimal == ref["minimal"][k],
        "factors_fx": np.array_equal(np.zeros(6) if key is None else key, ref["factors_fx"][k]),
        "points": points.dtype == np.float32 and np.array_equal(points, ref["points"][points_at]),
        "points_fx": np.array_equal(fixed(points), ref["points_fx"][points_at]),
        "indices": indices.dtype == np.uint32 and np.array_equal(indices, ref["indices"][indices_at]),
    }
    return [name for name, equal in same.items() if not equal]


@by_mode
def test_equals_the_reference(reference, domain, partitioning):
    cases = np.flatnonzero((reference["domain"] == domain) & (reference["partitioning"] == partitioning))
    assert cases.size > 20
    assert {int(k): names for k in cases if (names := differences(reference, k))} == {}


def test_reference_is_complete(reference):
    assert len(reference["domain"]) == 1031
    assert set(zip(reference["domain"], reference["partitioning"], strict=True)) == set(MODES)
    assert reference["culled"].any() and reference["minimal"].any() and not reference["legal"].all()


# The slow twin


def agrees_with_twin(domain, partitioning, factors):
    edge, inside = split_factors(domain, factors)
    expected_points, expected_indices = naive_tessellate(domain, partitioning, edge.tolist(), inside.tolist())
    for output in OUTPUTS:
        points, indices = _tessellate(domain, partitioning, edge, inside, output)
        if fixed(points).tolist() != [list(p) for p in expected_points] or indices.tolist() != expected_indices[output]:
            return False
    return True


@by_mode
def test_equals_the_slow_twin_on_random_factors(domain, partitioning):
    seed = MODES.index((domain, partitioning))
    rows = random_factors(np.random.default_rng(seed), 200)
    assert [row.tolist() for row in rows if not agrees_with_twin(domain, partitioning, row)] == []


def special_values():
    around = [np.nextafter(np.float32(x), np.float32(x + d)) for x in (1, 2) for d in (-1, 1)]
    ties = [1 + 2.0**-17, 1 + 2.0**-16, 1 + 3 * 2.0**-17]
    crossing = [6 + d * 2.0**-16 for d in (1, 6, 7, 22, 23)] + [30 + d * 2.0**-16 for d in (1, 414, 415, 478, 479)]
    strange = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-40, -1e-40, 1e-20, -3.0, 63.5, 64.5, 1e30]
    return np.array([1, 2, 3, 64] + around + ties + crossing + strange, np.float32)


@by_mode
def test_equals_the_slow_twin_on_special_values(domain, partitioning):
    rng = np.random.default_rng(7)
    num_factors = sum(len(part) for part in split_factors(domain, np.zeros(6)))
    rows = []
    for value in special_values():
        rows.append(np.full(6, value, np.float32))
        rows.append(np.ones(6, np.float32))
        rows[-1][rng.integers(num_factors)] = value
        for slot in range(num_factors):
            rows.append(rng.uniform(1, 5, 6).astype(np.float32))
            rows[-1][slot] = value
    assert [row.tolist() for row in rows if not agrees_with_twin(domain, partitioning, row)] == []


@by_mode
def test_fixed_factors_equal_the_slow_twin(domain, partitioning):
    rng = np.random.default_rng(11)
    rows = np.where(rng.random((2000, 6)) < 0.5, random_factors(rng, 2000), rng.choice(special_values(), (2000, 6)))
    edge, inside = split_factors(domain, rows.T)
    edge, inside = np.ascontiguousarray(edge.T), np.ascontiguousarray(inside.T)
    keys, of_patch = tess_factors.fix_factors(DOMAINS.index(domain), PARTITIONINGS[partitioning], edge, inside)
    assert len(np.unique(keys, axis=0)) == len(keys)  # each once
    for p in range(len(rows)):
        expected = naive_fix_factors(domain, partitioning, edge[p].tolist(), inside[p].tolist())
        found = None if of_patch[p] < 0 else keys[of_patch[p]][: edge.shape[1] + inside.shape[1]].tolist()
        assert found == expected, (edge[p], inside[p])


# Worked examples, by hand


def test_point_locations_of_single_sides():
    assert side_locations("fractional_even", 2).tolist() == [0, 32768, 65536]
    assert side_locations("fractional_odd", 3).tolist() == [0, 21845, 43691, 65536]
    assert side_locations("fractional_odd", 4).tolist() == [0, 17476, 24030, 41506, 48060, 65536]
    assert side_locations("fractional_even", 5).tolist() == [0, 13654, 19115, 32768, 46421, 51882, 65536]
    folded = [0, 10923, 21846, 32769, 32768, 32767, 43690, 54613, 65536]  # crosses its middle, as the reference does
    assert side_locations("fractional_even", 393219 / ONE).tolist() == folded


def test_pow2_does_not_round_to_powers_of_two():
    assert side_locations("pow2", 5.0).size == 6


def test_whole_factors_round_up_before_conversion():
    above_two = np.nextafter(np.float32(2), np.float32(3))
    assert side_locations("integer", above_two).size == 4
    assert side_locations("fractional_even", above_two).size == 3


def test_inside_of_one_has_a_centre_point():
    points, indices = tessellate("quad", "integer", (1, 1, 1, 2), (1, 1), "triangle_cw")
    assert points[-1].tolist() == [0.5, 0.5]
    assert (len(points), len(indices)) == (6, 15)


def test_tri_rings_are_not_quite_symmetric():
    points, _ = tessellate("tri", "integer", (3, 3, 3), (3,), "triangle_cw")
    assert fixed(points)[9:].tolist() == [[14563, 36409], [14563, 14563], [36409, 14564]]
    points, _ = tessellate("tri", "integer", (2, 2, 2), (2,), "triangle_cw")
    assert fixed(points)[-1].tolist() == [21845, 21845]


def test_counter_clockwise_swaps_the_last_two_corners():
    factors = {"edge": (3, 4.5, 2, 7), "inside": (5, 5)}
    _, cw = tessellate("quad", "fractional_odd", **factors, output="triangle_cw")
    _, ccw = tessellate("quad", "fractional_odd", **factors, output="triangle_ccw")
    assert np.array_equal(cw.reshape(-1, 3)[:, [0, 2, 1]], ccw.reshape(-1, 3))


def test_largest_patch():
    points, indices = tessellate("quad", "integer", [1e9] * 4, [np.inf] * 2, "triangle_cw")
    assert (len(points), len(indices)) == (4225, 3 * 8192)


@pytest.mark.parametrize("bad", [0.0, -0.0, -1.0, np.nan, -np.inf])
@by_mode
def test_edge_factor_culls(domain, partitioning, bad):
    for e in range(NUM_EDGES[DOMAINS.index(domain)]):
        edge, inside = split_factors(domain, np.full(6, 3.0))
        edge[e] = bad
        points, indices = tessellate(domain, partitioning, edge, inside, "point")
        assert points.shape == (0, 2) and indices.shape == (0,)


@by_meshed_mode
def test_inside_factor_does_not_cull(domain, partitioning):
    edge, inside = split_factors(domain, np.full(6, 3.0))
    for bad in (0.0, -1.0, np.nan, -np.inf):
        assert len(tessellate(domain, partitioning, edge, np.full_like(inside, bad), "point")[0]) > 8


# What must hold of any mesh


@pytest.mark.parametrize("n", range(1, 65))
def test_counts_of_uniform_whole_factors(n):
    points, indices = tessellate("quad", "integer", [n] * 4, [n] * 2, "triangle_cw")
    assert (len(points), len(indices)) == ((n + 1) ** 2, 6 * n * n)
    points, indices = tessellate("tri", "integer", [n] * 3, [n], "triangle_cw")
    k, odd = divmod(n, 2)
    num_points = 3 * n + (3 * k * k if odd else 3 * k * (k - 1) + 1)
    num_triangles = 6 * k * (k + 1) + 1 if odd else 6 * k * k
    assert (len(points), len(indices)) == (num_points, 3 * num_triangles)
    points, indices = tessellate("isoline", "integer", [n, 65 - n], [], "line")
    assert (len(points), len(indices)) == (n * (66 - n), 2 * n * (65 - n))


def meshes(domain, partitioning, count=40):
    rng = np.random.default_rng(23)
    for row in np.maximum(random_factors(rng, count), np.float32(0.1)):
        yield split_factors(domain, row)


@by_meshed_mode
def test_mesh_is_a_disc(domain, partitioning):
    for edge, inside in [*meshes(domain, partitioning), split_factors(domain, np.ones(6))]:
        points, indices = tessellate(domain, partitioning, edge, inside, "triangle_cw")
        num_border = sum(side_locations(partitioning, x).size - 1 for x in edge)
        corners = indices.reshape(-1, 3).tolist()
        assert len(corners) == 2 * len(points) - 2 - num_border
        assert set(indices.tolist()) == set(range(len(points)))
        uses = Counter((t[i], t[(i + 1) % 3]) for t in corners for i in range(3))
        assert set(uses.values()) == {1}
        border = {(a, b) for a, b in uses if (b, a) not in uses}
        assert border == {(k, (k + 1) % num_border) for k in range(num_border)}  # the outer ring, clockwise


@by_meshed_mode
def test_signed_areas_sum_to_the_domain(domain, partitioning):
    for output, sign in (("triangle_cw", 1), ("triangle_ccw", -1)):
        for edge, inside in [*meshes(domain, partitioning), split_factors(domain, np.full(6, 6 + 3 * 2.0**-16))]:
            points, indices = tessellate(domain, partitioning, edge, inside, output)
            a, b, c = (fixed(points)[indices[i::3]] for i in range(3))
            cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
            assert cross.sum() == sign * ONE * ONE * (2 if domain == "quad" else 1)


@by_meshed_mode
def test_sides_depend_on_their_own_factor_alone(domain, partitioning):
    for edge, inside in meshes(domain, partitioning):
        points = fixed(tessellate(domain, partitioning, edge, inside, "point")[0])
        lengths = [side_locations(partitioning, x).size - 1 for x in edge]
        if domain == "quad" and len(points) == 4:
            points = np.roll(points, 1, axis=0)  # the minimal quad alone starts at another corner
        ring = np.vstack([points[: sum(lengths)], points[:1]])
        start = 0
        for e, length in enumerate(lengths):
            side = ring[start : start + length + 1]
            start += length
            along = 1 if e in (0, 2) and not (domain == "tri" and e == 2) else 0
            expected = side_locations(partitioning, edge[e])
            rising = side[0, along] == 0
            assert np.array_equal(side[:, along], expected if rising else expected[::-1])
            assert np.array_equal(expected, ONE - expected[::-1])
            across = side[:, 1 - along]
            if domain == "tri" and e == 2:
                assert np.array_equal(across, ONE - side[:, along])
            else:
                assert (across == (0 if e < 2 else ONE)).all()


# Patterns of a frame


def patch_factors(rows):
    rows = np.asarray(rows, np.float32)
    return TessFactors(edge=rows[:, :4], inside=rows[:, 4:])


def num_border_points(partitioning, edge, inside):
    """Points on the four sides of a quad."""
    keys, _ = fix_factors(tess_factors.QUAD, PARTITIONINGS[partitioning], edge[None], inside[None])
    n, first = np.empty(keys.shape, np.int64), np.zeros((2, 2), np.int64)
    _count(tess_factors.QUAD, PARTITIONINGS[partitioning], 0, keys, n, *first)
    return int(n[0, :4].sum()) - 4


def check_rows(uv, indices, listed, listed_indices, border):
    """The same triangles of the same points, of which those inside the border are numbered anew: in rows."""
    number = np.full(len(listed), -1)
    number[listed_indices] = indices
    assert np.array_equal(np.sort(number), np.arange(len(uv)))  # each point has one number, and another has not
    assert np.array_equal(number[listed_indices], indices)
    assert np.array_equal(uv[number], listed)
    assert np.array_equal(number[:border], np.arange(border))
    u, v = uv[border:].T
    assert (np.diff(v) >= 0).all()
    columns = int(np.count_nonzero(v == v[0])) if len(v) else 1
    if len(np.unique(v)) * columns == len(v):  # no two rows coincide
        assert (u.reshape(-1, columns) == u[:columns]).all() and (np.diff(u[:columns]) >= 0).all()


def check_table(patterns, factors, partitioning, output="triangle_cw"):
    """The table says of every patch what `tessellate` says of it."""
    for p in range(len(factors.edge)):
        points, indices = tessellate("quad", partitioning, factors.edge[p], factors.inside[p], output)
        k = patterns.of_patch[p]
        if k < 0:
            assert len(points) == 0
            continue
        first, end = 3 * patterns.first_triangle[k : k + 2]
        uv = patterns.uv[:, patterns.first_point[k] : patterns.first_point[k + 1]].T
        border = num_border_points(partitioning, factors.edge[p], factors.inside[p])
        check_rows(uv, patterns.indices[first:end], points, indices, border)
    assert patterns.uv.shape == (2, patterns.first_point[-1])
    assert patterns.indices.shape == (3 * patterns.first_triangle[-1],)
    types = [a.dtype.name for a in patterns]
    assert types == ["int32", "float32", "int64", "uint16", "int64"]


@pytest.mark.parametrize("output", ["triangle_cw", "triangle_ccw"])
@pytest.mark.parametrize("partitioning", PARTITIONINGS)
def test_table_equals_tessellate(partitioning, output):
    rng = np.random.default_rng(31)
    rows = random_factors(rng, 12)[rng.integers(0, 12, 50)]  # repeated, in no order
    rows[[3, 17]] = np.nan
    rows[5, 2] = 0
    factors = patch_factors(rows)
    patterns = make_patterns(factors, partitioning, output, cache=PatternCache())
    assert (patterns.of_patch[[3, 5, 17]] == -1).all()
    assert len(patterns.first_point) - 1 == patterns.of_patch.max() + 1 <= 12
    check_table(patterns, factors, partitioning, output)


def test_equal_factors_share_one_pattern():
    patterns = make_patterns(patch_factors(np.full((1000, 6), 4.5)), "fractional_even", cache=PatternCache())
    assert (patterns.of_patch == 0).all() and len(patterns.first_point) == 2


def test_factors_equal_after_clamping_share_one_pattern():
    rows = [[64] * 6, [99, 64, 70, np.inf, 64.5, np.inf], [63.5] * 6, [62] * 6]
    patterns = make_patterns(patch_factors(rows), "pow2", cache=PatternCache())
    assert patterns.of_patch.tolist() == [0, 0, 0, 1]
    rows = [[1] * 6, [0.5, 1, 1e-40, 1 + 2.0**-17, np.nan, -7]]
    patterns = make_patterns(patch_factors(rows), "fractional_odd", cache=PatternCache())
    assert patterns.of_patch.tolist() == [0, 0]


@pytest.mark.parametrize("slot", range(6))
def test_neighbours_that_differ_in_one_factor_have_their_own_pattern(slot):
    rows = np.full((3, 6), 5.0)
    rows[1, slot] = 6.0
    patterns = make_patterns(patch_factors(rows), "integer", cache=PatternCache())
    assert patterns.of_patch.tolist() == [0, 1, 0]


@pytest.mark.parametrize("num_patches", [0, 3])
def test_no_live_patch_gives_an_empty_table(num_patches):
    patterns = make_patterns(patch_factors(np.full((num_patches, 6), -1)), "integer", cache=PatternCache())
    assert patterns.of_patch.tolist() == [-1] * num_patches
    assert patterns.uv.shape == (2, 0) and patterns.indices.shape == (0,)
    assert patterns.first_point.tolist() == patterns.first_triangle.tolist() == [0]


def test_repeated_patterns_come_from_the_cache():
    cache = PatternCache()
    factors = patch_factors(random_factors(np.random.default_rng(5), 30))
    first = make_patterns(factors, "fractional_odd", cache=cache)
    assert (cache.hits, cache.misses) == (0, 30)
    again = make_patterns(factors, "fractional_odd", cache=cache)
    assert (cache.hits, cache.misses) == (30, 30)
    assert again.uv is first.uv and again.indices is first.indices  # not even copied
    mixed = patch_factors(
        np.vstack([factors.edge[:0:-2, [0, 1, 2, 3, 0, 0]], random_factors(np.random.default_rng(6), 9)])
    )
    mixed.inside[:15] = factors.inside[:0:-2]
    check_table(make_patterns(mixed, "fractional_odd", cache=cache), mixed, "fractional_odd")
    assert (cache.hits, cache.misses) == (45, 39)  # 15 old, 9 new


def test_cache_keeps_modes_apart():
    cache = PatternCache()
    factors = patch_factors([[3, 4, 5, 6, 7, 8]])
    for partitioning in ("integer", "fractional_odd", "fractional_even"):
        for output in ("triangle_cw", "triangle_ccw"):
            check_table(make_patterns(factors, partitioning, output, cache), factors, partitioning, output)
    assert (cache.hits, cache.misses) == (0, 6)
    check_table(make_patterns(factors, "pow2", cache=cache), factors, "pow2")
    assert (cache.hits, cache.misses) == (1, 6)  # pow2 is integer


def test_cache_forgets_the_oldest():
    cache = PatternCache(max_points=200)
    for n in (5, 6, 7, 8, 64, 9):
        factors = patch_factors([[n] * 6, [5] * 6])
        check_table(make_patterns(factors, "integer", cache=cache), factors, "integer")
        assert cache.num_points <= 200
    misses = cache.misses
    make_patterns(patch_factors([[9] * 6]), "integer", cache=cache)
    assert cache.misses == misses  # the newest is still there
    make_patterns(patch_factors([[7] * 6]), "integer", cache=cache)
    assert cache.misses == misses + 1


def test_threads_share_a_cache():
    cache = PatternCache()
    rows = np.random.default_rng(41).uniform(3, 20, (60, 6)).astype(np.float32)
    rounds = 12
    failures = []

    def work(seed):
        rng = np.random.default_rng(seed)
        try:
            for _ in range(rounds):
                factors = patch_factors(rows[rng.choice(60, 10, replace=False)])
                check_table(make_patterns(factors, "fractional_even", cache=cache), factors, "fractional_even")
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert cache.misses == 60  # none was generated twice
    assert cache.hits + cache.misses == 4 * rounds * 10


# Bad input

QUAD = {"domain": "quad", "partitioning": "integer", "edge": (2, 2, 2, 2), "inside": (2, 2), "output": "triangle_cw"}
ISOLINE = {"domain": "isoline", "partitioning": "integer", "edge": (2, 2), "inside": (), "output": "line"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (QUAD | {"domain": "quads"}, ["domain", "'quads'", "quad, tri, isoline"]),
        (QUAD | {"partitioning": "odd"}, ["partitioning", "'odd'", "fractional_odd"]),
        (QUAD | {"output": "strip"}, ["output", "'strip'", "triangle_ccw"]),
        (QUAD | {"output": "line"}, ["output", "'line'", "point, triangle_cw, triangle_ccw"]),
        (QUAD | {"domain": "tri", "output": "line"}, ["output", "'tri'", "'line'"]),
        (ISOLINE | {"output": "triangle_cw"}, ["output", "'triangle_cw'", "point, line"]),
        (QUAD | {"edge": (2, 2, 2)}, ["edge", "(2, 2, 2)", "4"]),
        (QUAD | {"inside": ()}, ["inside", "()", "2"]),
        (QUAD | {"inside": 2.0}, ["inside", "2.0", "2"]),
        (QUAD | {"edge": (2, 2, 2, "x")}, ["edge", "'x'", "4"]),
        (QUAD | {"edge": (2, 2, 2, None, 1)}, ["edge", "None", "4"]),
        (ISOLINE | {"inside": (1,)}, ["inside", "(1,)", "0"]),
    ],
)
def test_bad_arguments_are_named(arguments, words):
    with pytest.raises(ValueError) as error:
        tessellate(**arguments)
    assert [word for word in words if word not in str(error.value)] == []


def test_bad_frames_are_named():
    good = patch_factors(np.full((3, 6), 2))
    with pytest.raises(ValueError, match=r"partitioning = 'even'.*fractional_even"):
        make_patterns(good, "even")
    with pytest.raises(ValueError, match=r"output.*'line'.*triangle_cw"):
        make_patterns(good, "integer", "line")
    with pytest.raises(ValueError, match=r"factors.edge.*\(3, 3\).*\(P, 4\)"):
        make_patterns(good._replace(edge=good.edge[:, :3]), "integer")
    with pytest.raises(ValueError, match=r"factors.inside.*\(2, 2\).*\(3, 2\)"):
        make_patterns(good._replace(inside=good.inside[:2]), "integer")
