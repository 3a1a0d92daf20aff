"""Hull shader, patch-constant phase: factors that neighbours agree on, within their limits; flags; who lives on."""

import math
from itertools import pairwise

import numpy as np
import pytest

from pipeline import hull
from pipeline.culling import CULL_TESTS
from pipeline.displacement import map_ranges
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.tessellator import make_patterns
from pipeline.types import CullFlag, TessFactors, Viewport
from tests.cages import read_model
from tests.naive_domain import NaiveMap
from tests.test_bounds import any_stage, corner_bounds, look, random_camera
from tests.test_domain import make_one, pack, rational_patch, reorient, smooth_patch

VIEWPORT = Viewport(0, 0, 640, 480, 0.0, 1.0)
NEAR = 0.1
by_seed = pytest.mark.parametrize("seed", range(3), ids=lambda s: f"seed{s}")

# Control points of the edges u=0, v=0, u=1, v=1 in the order of SV_TessFactor, along the other parameter.
EDGES = [np.s_[0, :], np.s_[:, 0], np.s_[3, :], np.s_[:, 3]]


def screen_factors(cp, matrix, edge_pixels=8.0, most=64.0, viewport=VIEWPORT):
    cp = np.asarray(cp, np.float32).reshape(-1, 4, 4, 4)
    return hull.screen_factors(cp, np.asarray(matrix, np.float32), viewport, NEAR, edge_pixels, most)


def naive_edge_factor(points, matrix, edge_pixels, most, viewport):
    """Length on the screen of the control polygon, points held `NEAR` in front of the eye, over `edge_pixels`."""
    pixels = []
    for x, y, z, w in points.astype(np.float64):
        clip = matrix.astype(np.float64) @ [x / w, y / w, z / w, 1]
        pixels.append(clip[:2] / max(clip[3], NEAR) * [viewport.width / 2, viewport.height / 2])
    length = sum(math.dist(a, b) for a, b in pairwise(pixels))
    return min(max(length / edge_pixels, 1), most)


def random_patches(rng, n):
    """Half of them rational, of all sizes, each before a camera."""
    for k in range(n):
        cp = (smooth_patch, rational_patch)[k % 2](rng)
        points = cp[..., :3] / cp[..., 3:]
        yield cp, random_camera(rng, points.mean(axis=(0, 1)), np.ptp(points, axis=(0, 1)).max())


# Factors


def test_fixed_factors():
    factors = hull.fixed_factors(3, (1, 2, 3, 4, 5, 6.5))
    assert factors.edge.tolist() == [[1, 2, 3, 4]] * 3 and factors.inside.tolist() == [[5, 6.5]] * 3
    assert factors.edge.dtype == factors.inside.dtype == np.float32
    factors.edge[0] = 0  # the front end does this to culled patches
    assert factors.edge[1].tolist() == [1, 2, 3, 4]
    assert hull.fixed_factors(0, (1,) * 6).edge.shape == (0, 4)


@by_seed
def test_screen_factors_equal_the_control_polygon_on_screen(seed):
    rng = np.random.default_rng(seed)
    limited = free = 0
    for cp, matrix in random_patches(rng, 60):
        edge_pixels, most = float(rng.uniform(1, 20)), float(rng.uniform(2, 64))
        viewport = Viewport(0, 0, int(rng.integers(16, 2000)), int(rng.integers(16, 2000)), 0.0, 1.0)
        factors = screen_factors(cp, matrix, edge_pixels, most, viewport)
        expected = [naive_edge_factor(cp[e], matrix, edge_pixels, most, viewport) for e in EDGES]
        np.testing.assert_allclose(factors.edge[0], expected, rtol=1e-5)
        limited += sum(f in (1, most) for f in expected)
        free += sum(1 < f < most for f in expected)
    assert limited > 10 and free > 10


def test_screen_factors_by_hand():
    """An edge of 3 / 4 of the picture's width, straight in front, in segments of 10 pixels."""
    matrix = np.diag([1, 1, 0, 0]).astype(np.float32)
    matrix[3, 3] = 1
    cp = np.ones((4, 4, 4))
    cp[..., 0] = np.linspace(-0.75, 0.75, 4)[:, None]
    cp[..., 1] = np.linspace(0, 0.25, 4)
    cp[..., 2] = 0
    factors = screen_factors(cp, matrix, 10.0)
    np.testing.assert_allclose(factors.edge, [[6, 48, 6, 48]], rtol=1e-6)
    np.testing.assert_allclose(factors.inside, [[48, 6]], rtol=1e-6)


@by_seed
def test_both_sides_of_an_edge_have_the_same_factor(seed):
    """The same bits, whichever of its four edges each patch has there, whichever way it runs, whatever else it is."""
    rng = np.random.default_rng(100 + seed)
    for cp, matrix in random_patches(rng, 40):
        for k, edge in enumerate(EDGES):
            for backwards in (False, True):
                other = (smooth_patch, rational_patch)[rng.integers(2)](rng)
                place = int(rng.integers(4))
                other[EDGES[place]] = cp[edge][::-1] if backwards else cp[edge]
                most = 1e9
                one, two = (screen_factors(p, matrix, 0.37, most).edge[0] for p in (cp, other))
                assert one[k].tobytes() == two[place].tobytes(), f"seed {seed}, edges {k} and {place}"


def test_both_sides_agree_where_the_last_bit_of_the_length_decides():
    """Lengths that depend on the order of addition, and segments so long that the factor is a tie between two float32."""
    rng = np.random.default_rng(5)
    one, decided = np.ones((4, 4, 4)), 0
    for _ in range(400):
        points = rng.normal(size=(4, 2)).astype(np.float32)
        one[:, 0, :2] = points
        steps = np.diff(points.astype(np.float64) * [VIEWPORT.width / 2, VIEWPORT.height / 2], axis=0)
        a, b, c = np.sqrt(steps[:, 0] * steps[:, 0] + steps[:, 1] * steps[:, 1])
        forwards, backwards = (a + b) + c, (c + b) + a
        factor = np.float32(rng.uniform(1, 64))
        tie = (float(factor) + float(np.nextafter(factor, np.float32(np.inf)))) / 2
        for edge_pixels in (forwards / tie, backwards / tie, (a + c + b) / tie):
            decided += np.float32(forwards / edge_pixels) != np.float32(backwards / edge_pixels)
            same, turned = (screen_factors(p, np.eye(4), edge_pixels, 1e9).edge[0, 1] for p in (one, one[::-1]))
            assert same.tobytes() == turned.tobytes(), f"{points}, {edge_pixels!r}"
    assert decided > 20


@by_seed
@pytest.mark.parametrize("orientation", range(8))
def test_factors_turn_with_the_patch(orientation, seed):
    rng = np.random.default_rng(200 + seed)
    (cp, matrix), *_ = random_patches(rng, 1)
    one, two = screen_factors(cp, matrix, most=1e9), screen_factors(reorient(cp, orientation), matrix, most=1e9)
    order = np.arange(4)
    order = order[[2, 1, 0, 3]] if orientation & 1 else order
    order = order[[0, 3, 2, 1]] if orientation & 2 else order
    order = order[[1, 0, 3, 2]] if orientation & 4 else order
    np.testing.assert_array_equal(two.edge, one.edge[:, order])
    np.testing.assert_array_equal(two.inside, one.inside[:, ::-1] if orientation & 4 else one.inside)


@by_seed
def test_inside_factors_are_the_larger_of_the_edges_along_them(seed):
    rng = np.random.default_rng(300 + seed)
    for cp, matrix in random_patches(rng, 20):
        (edge,), (inside,) = screen_factors(cp, matrix)
        assert inside.tolist() == [max(edge[1], edge[3]), max(edge[0], edge[2])]


def test_factors_lie_in_their_limits():
    """Also for edges without length, behind the eye, through it, huge, tiny, and with points that are not numbers."""
    rng = np.random.default_rng(3)
    cp = np.stack([smooth_patch(rng) for _ in range(400)])
    cp[..., :3] *= 10.0 ** rng.integers(-20, 20, (400, 1, 1, 1))
    cp[:20] = cp[:20, :1, :1]
    cp[20:40, 0] = cp[20:40, :1, 0]
    bad = rng.random(cp.shape) < 0.02
    cp[300:][bad[300:]] = rng.choice([np.nan, np.inf, -np.inf, 0], bad[300:].sum())
    matrix = look([0, 0, 3], [0, 0, 0])
    for most in (1.0, 7.5, 64.0):
        for edge_pixels in (1e-3, 8.0, 1e6):
            factors = screen_factors(cp, matrix, edge_pixels, most)
            for values in factors:
                assert values.dtype == np.float32 and ((values >= 1) & (values <= most)).all()
    assert (screen_factors(cp[:20], matrix, 1e-3).edge == 1).all()


def test_points_behind_the_eye_are_taken_to_be_before_it():
    """So an edge that runs past the eye is long, and one wholly behind it has a factor like any other."""
    matrix = look([0, 0, 0], [0, 0, -1], near=NEAR)
    t = np.linspace(0, 1, 4)
    past = np.ones((4, 4, 4))
    past[..., 0] = 1 + t
    past[..., 1], past[..., 2] = 0.2, (2 - 4 * t)[:, None]
    (edge,) = screen_factors(past, matrix, 8.0, 1e9).edge
    assert np.isfinite(edge).all() and edge[1] > 64
    for k, e in enumerate(EDGES):
        assert edge[k] == pytest.approx(naive_edge_factor(past[e], matrix, 8.0, 1e9, VIEWPORT), rel=1e-5)
    behind = past.copy()
    behind[..., 2] = 5
    (edge,) = screen_factors(behind, matrix, 8.0, 1e9).edge
    # 1 unit long at the near distance: 1 / NEAR of the half height's slope, 480 / 2 pixels / 0.6, by 8 pixels.
    assert edge[0] == pytest.approx(240 / 0.6 / NEAR / 8, rel=1e-4)


# Flags


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_every_non_finite_number_is_flagged(bad):
    rng = np.random.default_rng(4)
    maps = [
        NaiveMap(np.ones((2, 2), np.float32), "wrap", 1.0, 0.0),
        NaiveMap(np.full((1, 1), bad, np.float32), "wrap", 1.0, 0),
    ]
    maps.append(NaiveMap(np.ones((2, 2), np.float32), "wrap", bad, 0.0))
    maps.append(NaiveMap(np.ones((2, 2), np.float32), "wrap", 1.0, bad))
    with np.errstate(invalid="ignore"):
        ranges = map_ranges(pack(maps))
    cp = np.stack([smooth_patch(rng) for _ in range(64)])
    fine = make_one(cp)
    assert (hull.flag_nonfinite(fine, ranges) == CullFlag.ALIVE).all()
    for k in range(64):
        cp[k, k // 16, k // 4 % 4, k % 4] = bad
    assert (hull.flag_nonfinite(make_one(cp), ranges) == CullFlag.NONFINITE).all()

    # Texture coordinates and maps count where the patch is displaced, and then its own map only.
    good = smooth_patch(rng)
    patches = make_one(np.stack([good] * 11), map_id=[0] * 8 + [-1, -1, 0])
    for k in range(8):
        patches.texcoords[k, k // 2, k % 2] = bad
    patches.texcoords[8] = bad
    expected = [CullFlag.NONFINITE] * 8 + [CullFlag.ALIVE] * 3
    assert hull.flag_nonfinite(patches, ranges).tolist() == expected
    patches = make_one(np.stack([good] * 5), map_id=[0, 1, 2, 3, -1])
    expected = [CullFlag.ALIVE] + [CullFlag.NONFINITE] * 3 + [CullFlag.ALIVE]
    flags = hull.flag_nonfinite(patches, ranges)
    assert flags.dtype == np.uint8 and flags.tolist() == expected


TABLES = ("tangent_u", "tangent_v", "inner", "edge_normals", "corner_normals")


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_tables_count_for_the_patches_that_use_them(table, bad):
    basis = Basis.GREGORY if table == "inner" else Basis.ACC
    surface, _ = make_surface(read_model("subdbox")[1], basis)
    patches = hull.surface_patches(surface, read_model("subdbox")[0], 0, 0)
    ranges = np.zeros((1, 2))
    assert (hull.flag_nonfinite(patches, ranges) == CullFlag.ALIVE).all()
    rows = getattr(patches, table).copy()
    rows[7].flat[1] = bad
    broken = patches._replace(**{table: rows})
    uses = {
        "tangent_u": patches.tangent_id == 7,
        "tangent_v": patches.tangent_id == 7,
        "inner": patches.gregory_id == 7,
        "edge_normals": ((patches.edge_row == 7) | (patches.edge_row == ~7)).any(axis=1),
        "corner_normals": (patches.corner_row == 7).any(axis=1),
    }[table]
    assert 1 <= uses.sum() <= 7
    np.testing.assert_array_equal(hull.flag_nonfinite(broken, ranges) == CullFlag.NONFINITE, uses)
    if table.endswith("normals"):  # nobody reads them where nothing is displaced
        still = broken._replace(map_id=np.full_like(patches.map_id, -1))
        assert (hull.flag_nonfinite(still, ranges) == CullFlag.ALIVE).all()
        one = np.array([np.flatnonzero(uses)[0]])
        assert hull.flag_nonfinite(broken.take(one), ranges).tolist() == [CullFlag.NONFINITE]


@pytest.mark.parametrize("table", ["tangent_id", "gregory_id"])
def test_rational_surface_patches_are_refused(table):
    cp = np.stack([smooth_patch(np.random.default_rng(0), 0.1), rational_patch(np.random.default_rng(0), 0.1)])
    patches = make_one(cp)
    rows = np.array([-1, 0], np.int32)
    with pytest.raises(
        ValueError, match="rational: patch 1 is rational and an ACC or Gregory patch; allowed: weights 1"
    ):
        hull.make_input(patches._replace(**{table: rows}), pack([]), np.eye(4, dtype=np.float32), VIEWPORT)
    hull.make_input(patches._replace(**{table: rows[::-1]}), pack([]), np.eye(4, dtype=np.float32), VIEWPORT)


def test_flags_without_maps_and_without_patches():
    none = np.zeros((0, 2))
    assert hull.flag_nonfinite(make_one(np.ones((1, 4, 4, 4))), none).tolist() == [CullFlag.ALIVE]
    assert hull.flag_nonfinite(make_one(np.ones((0, 4, 4, 4))), none).shape == (0,)


def test_the_first_reason_counts():
    outside = corner_bounds(np.tile([5.0, 0, 0.5, 1], (4, 8, 1)))
    flags = np.array([CullFlag.ALIVE, CullFlag.NONFINITE, CullFlag.FACTOR, CullFlag.ALIVE], np.uint8)
    hull.run_cull_tests([], any_stage(4), outside, flags)
    assert flags.tolist() == [0, 1, 2, 0]
    hull.run_cull_tests(list(CULL_TESTS), any_stage(4), outside, flags)
    assert flags.tolist() == [CullFlag.FRUSTUM, CullFlag.NONFINITE, CullFlag.FACTOR, CullFlag.FRUSTUM]
    with pytest.raises(KeyError):
        hull.run_cull_tests(["no such test"], any_stage(4), outside, flags)


def test_factors_that_cull():
    factors = TessFactors(np.full((5, 4), 3, np.float32), np.full((5, 2), 3, np.float32))
    factors.edge[1, 2], factors.edge[2, 0], factors.inside[3] = 0, np.nan, -1
    flags = np.array([0, 0, 0, 0, CullFlag.FRUSTUM], np.uint8)
    factors.edge[4] = 0
    patterns = make_patterns(factors, "integer")
    hull.flag_factors(patterns.of_patch, flags)
    assert flags.tolist() == [CullFlag.ALIVE, CullFlag.FACTOR, CullFlag.FACTOR, CullFlag.ALIVE, CullFlag.FRUSTUM]
    live = hull.live_patches(flags)
    assert live.dtype == np.int32 and live.tolist() == [0, 3]
