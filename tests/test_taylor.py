"""Taylor models enclose what they stand for, and the boxes made of them every vertex that float32 makes."""

from itertools import pairwise
from math import comb

import numpy as np
import pytest

from pipeline.bounds import BOUNDS, taylor
from pipeline.bounds import taylor_model as model
from pipeline.hull import make_input
from pipeline.jit import kernel
from tests.naive_domain import NaiveMap
from tests.test_bounds import DISPLACED, PLAIN, VIEWPORT, family_of, grid_points
from tests.test_domain import (
    IDENTITY,
    dome,
    flat_square,
    make_one,
    pack,
    random_map,
    random_points,
    rational_patch,
    shade,
    smooth_patch,
)

U = 2.0**-24
NARROW, WIDE = (6, 6), (11, 11)
BOTH = pytest.mark.parametrize("clamped", [False, True], ids=["taylor", "taylor_clamped"])
by_seed = pytest.mark.parametrize("seed", range(3), ids=lambda s: f"seed{s}")


# The arithmetic, called from Python


@kernel
def _range_of(p, half):
    return model.range_of(p, half)


@kernel
def _wide_range(wide, half):
    return model.wide_range(wide, 0, half)


@kernel
def _multiply(p, p_rest, q, q_rest, q_range, wide, half, out):
    return model.multiply_into(p, p_rest, q, q_rest, q_range, wide, half, out)


@kernel
def _add(p, p_rest, q, q_rest, factor, out):
    rest = model.scale_into(p, p_rest, factor, out)
    return model.add_into(out, rest, q, q_rest, out)


@kernel
def _inverse_length(v, rest, square, y, wide, half, out):
    square_rest, square_range = model.square_length_into(v, rest, wide, half, square)
    return square_rest, square_range, model.rsqrt_into(square, square_rest, square_range, y, wide, half, out)


@kernel
def _tails(r, out):
    for k in range(len(r)):
        out[k] = model.series_tail(r[k])


def scratch():
    return np.full(model.WIDE_SHAPE, np.nan), np.full(model.HALF_SHAPE, np.nan)


def random_polynomial(rng, decay):
    i, j = np.indices(NARROW)
    return rng.normal(size=NARROW) * decay ** (i + j) * 10 ** rng.uniform(-3, 3)


def interval(rng, size):
    return tuple(np.sort(rng.normal(0, size, 2)))


def parameters(rng):
    """Ends, corners, the centre, and points between."""
    ends = np.array([-1.0, 1.0, 0.0, np.nextafter(1, 0), np.nextafter(-1, 0)])
    return np.concatenate([ends, rng.uniform(-1, 1, 20)])


def value(p, s):
    """On the grid s x s, in long double."""
    powers = np.vander(s.astype(np.longdouble), p.shape[-1], increasing=True)
    return powers @ p @ powers.T


def attacks(rest, like, rng):
    """Functions inside a remainder: at its ends everywhere, and jumping between them."""
    lo, hi = rest
    return [np.full(like.shape, lo), np.full(like.shape, hi), rng.choice([lo, hi], like.shape)]


def assert_encloses(rest, difference, context):
    assert rest[0] <= difference.min() and difference.max() <= rest[1], (
        f"{context}: {difference.min()} .. {difference.max()} not in {rest}"
    )


# Models


@pytest.mark.parametrize("degree", [3, 5, 10])
def test_bernstein_tables_are_the_powers(degree):
    """Summed with Bernstein polynomials they give s^i."""
    u = np.linspace(0, 1, 23)
    basis = np.stack([comb(degree, k) * u**k * (1 - u) ** (degree - k) for k in range(degree + 1)])
    powers = np.vander(2 * u - 1, degree + 1, increasing=True).T
    table = model.bernstein_table(degree)
    np.testing.assert_allclose(table @ basis, powers, atol=1e-14)
    assert abs(table).max() == 1


@by_seed
def test_ranges_enclose(seed):
    rng = np.random.default_rng(seed)
    wide, half = scratch()
    for _ in range(200):
        p, s = random_polynomial(rng, rng.uniform(0.2, 1)), parameters(rng)
        assert_encloses(_range_of(p, half), value(p, s), f"seed {seed}")
        wide[:] = rng.normal(size=WIDE)
        lo, hi = _wide_range(wide, half)
        pad = model.ROUND * abs(wide).sum()
        assert_encloses((lo - pad, hi + pad), value(wide, s), f"seed {seed}, wide")


def test_ranges_are_exact_for_bilinear_polynomials():
    rng = np.random.default_rng(3)
    _, half = scratch()
    for _ in range(100):
        p = np.zeros(NARROW)
        p[:2, :2] = rng.normal(size=(2, 2))
        corners = value(p, np.array([-1.0, 1.0]))
        assert _range_of(p, half) == pytest.approx((corners.min(), corners.max()), abs=1e-12)


@by_seed
def test_products_and_sums_enclose(seed):
    rng = np.random.default_rng(10 + seed)
    wide, half = scratch()
    for trial in range(150):
        decay = rng.uniform(0.2, 1)
        p, q, s = random_polynomial(rng, decay), random_polynomial(rng, decay), parameters(rng)
        p_rest, q_rest = (interval(rng, size) for size in 10 ** rng.uniform(-6, 1, 2))
        q_range = tuple(np.add(_range_of(q, half), q_rest))
        product, total, factor = np.empty(NARROW), np.empty(NARROW), rng.normal()
        product_rest = _multiply(p, p_rest, q, q_rest, q_range, wide, half, product)
        total_rest = _add(p, p_rest, q, q_rest, factor, total)
        for f in attacks(p_rest, value(p, s), rng):
            for g in attacks(q_rest, value(q, s), rng):
                f_all, g_all = value(p, s) + f, value(q, s) + g
                context = f"seed {seed}, trial {trial}"
                assert_encloses(product_rest, f_all * g_all - value(product, s), context)
                assert_encloses(total_rest, factor * f_all + g_all - value(total, s), context)


def test_products_of_low_degree_are_exact():
    """Nothing exceeds bi-degree (5, 5): the remainder is rounding."""
    rng = np.random.default_rng(4)
    wide, half = scratch()
    p, q, out = np.zeros(NARROW), np.zeros(NARROW), np.empty(NARROW)
    p[:3, :4], q[:4, :3] = rng.normal(size=(3, 4)), rng.normal(size=(4, 3))
    lo, hi = _multiply(p, (0.0, 0.0), q, (0.0, 0.0), _range_of(q, half), wide, half, out)
    assert -1e-11 < lo <= 0 <= hi < 1e-11
    expected = sum(p[i, j] * np.pad(q, ((i, 0), (j, 0)))[:6, :6] for i in range(3) for j in range(4))
    np.testing.assert_allclose(out, expected, atol=1e-14)


def test_a_product_may_overwrite_a_factor():
    rng = np.random.default_rng(5)
    wide, half = scratch()
    p, q, out = random_polynomial(rng, 0.5), random_polynomial(rng, 0.5), np.empty(NARROW)
    q_range = _range_of(q, half)
    rest = _multiply(p, (0.0, 1.0), q, (-1.0, 0.0), q_range, wide, half, out)
    assert _multiply(p, (0.0, 1.0), q, (-1.0, 0.0), q_range, wide, half, p) == rest
    np.testing.assert_array_equal(p, out)


def test_series_tail_is_reached_at_the_lower_end_and_never_passed():
    r = np.concatenate([np.linspace(0, 0.999, 400), 1 - 2.0 ** -np.arange(10, 40)])
    tails = np.empty(len(r))
    _tails(r, tails)
    for sign in (-1, 1):
        for part in (1, 0.999, 0.5, 0.01):
            y = (sign * part * r).astype(np.longdouble)
            series = sum(np.longdouble(c) * y**k for k, c in enumerate(model.SERIES))
            truth = 1 / np.sqrt(1 + y) - series
            assert (truth <= tails).all() and (truth >= -model.ROUND).all()
            if sign * part == -1:
                np.testing.assert_allclose(np.float64(truth), tails, rtol=1e-9, atol=1e-12)
    _tails(np.array([1.0, 1.5]), tails)
    assert np.isinf(tails[:2]).all()


@by_seed
def test_inverse_lengths_enclose(seed):
    """Of vectors whose remainders are attacked at their ends; also close to the ranges' lower end 0."""
    rng = np.random.default_rng(20 + seed)
    wide, half = scratch()
    square, y, inverse = np.empty(NARROW), np.empty(NARROW), np.empty(NARROW)
    valid = 0
    for trial in range(150):
        v = np.stack([random_polynomial(rng, 0.4) for _ in range(3)]) * rng.choice([0.003, 0.03, 0.1])
        v /= abs(v).max()
        v[2, 0, 0] += rng.uniform(0.5, 3)
        rest, s = interval(rng, rng.choice([1e-9, 1e-3])), parameters(rng)
        square_rest, (lo, hi), inverse_rest = _inverse_length(v, rest, square, y, wide, half, inverse)
        valid += lo > 0
        for attack in range(3):
            length = sum((value(v[r], s) + attacks(rest, np.empty((25, 25)), rng)[attack]) ** 2 for r in range(3))
            assert_encloses(square_rest, length - value(square, s), f"seed {seed}, trial {trial}")
            assert_encloses((lo, hi), length, f"seed {seed}, trial {trial}")
            if lo > 0:
                truth = 1 / np.sqrt(length)
                assert_encloses(inverse_rest, truth - value(inverse, s), f"seed {seed}, trial {trial}")
    assert valid > 30


# Boxes


def random_domains(rng, n):
    """Whole patches, parts of any size down to 2^-16, points and lines: float64[n, 4]."""
    ends = np.sort(rng.integers(0, 65537, (n, 2, 2)), axis=2) / 65536.0
    ends[0::6] = [0, 1]
    small = ends[1::6]
    small[..., 1] = np.minimum(small[..., 0] + rng.integers(0, 64, small.shape[:2]) / 65536.0, 1)
    ends[2::6, 0, 1] = ends[2::6, 0, 0]
    return ends.reshape(n, 4)


def points_in(domain, uv):
    """Domain points of the tessellator inside the domain, its ends included."""
    (u0, u1, v0, v1), uv = domain, uv.astype(np.float64)
    scaled = np.stack([u0 + uv[:, 0] * (u1 - u0), v0 + uv[:, 1] * (v1 - v0)], -1) * 65536
    inside = np.clip(np.round(scaled), np.array([u0, v0]) * 65536, np.array([u1, v1]) * 65536)
    return (inside / 65536).astype(np.float32)


def assert_contains(bounds, patches, maps, domains, rng, context, uv=None):
    uv = np.concatenate([grid_points(1), grid_points(8), random_points(rng, 80)]) if uv is None else uv
    clips, _ = shade(patches, [points_in(domain, uv) for domain in domains], maps)
    for k, clip in enumerate(clips):
        axes = bounds.axes[k]
        along = abs((clip[:, :3] - bounds.center[k]) @ axes.T)
        reach = (axes * axes).sum(axis=1) * (1 + 2.0**-50) + 2.0**-50 * abs(axes) @ abs(bounds.center[k])
        assert (along <= reach).all(), f"{context}, patch {k}, domain {domains[k]}: {(along / reach).max()}"


def stage_of(patches, maps, domain=None):
    return make_input(patches, pack(maps), IDENTITY, VIEWPORT, domain=domain)


def smooth_family(rng, n, bumps, size=1.0, reach=0.3):
    """Sheets about a unit wide, times size, each with a map of displacements of about `reach` of that."""
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    sheet = np.stack([i, j, 0 * i], -1) / 3 + rng.normal(0, bumps, (n, 4, 4, 3))
    turn = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    points = np.einsum("pijc,pcd->pijd", sheet, turn) * size + rng.normal(0, size, (n, 1, 1, 3))
    cp = np.concatenate([points, np.ones((n, 4, 4, 1))], -1)
    maps = []
    for _ in range(n):
        texels = rng.uniform(-1, 1, rng.integers(1, 9, 2)).astype(np.float32)
        maps.append(NaiveMap(texels, "wrap", size * reach, size * rng.normal(0, reach)))
    return make_one(cp, rng.uniform(-1, 2, (n, 4, 2)), np.arange(n)), maps


@by_seed
@pytest.mark.parametrize("kind", PLAIN + list(DISPLACED))
@BOTH
def test_boxes_over_domains_contain_the_surface(clamped, kind, seed):
    rng = np.random.default_rng([seed, *kind.encode()])
    patches, maps, _, _ = family_of(kind, rng)
    domains = random_domains(rng, 16)
    bounds, _ = taylor.bound_and_validity(stage_of(patches, maps, domains), clamped)
    assert_contains(bounds, patches, maps, domains, rng, f"seed {seed}")


@by_seed
@pytest.mark.parametrize("bumps", [0.0, 0.01, 0.05, 0.1])
@BOTH
def test_boxes_of_normalizable_patches_contain_the_surface(clamped, bumps, seed):
    """From coordinates of 1e-20 to 1e15: in float32, and where the shader resorts to float64."""
    for size in (1e-20, 1e-6, 1.0, 1e7, 1e15):
        rng = np.random.default_rng([30, seed, int(bumps * 100)])
        patches, maps = smooth_family(rng, 24, bumps, size)
        domains = random_domains(rng, 24)
        bounds, valid = taylor.bound_and_validity(stage_of(patches, maps, domains), clamped)
        assert valid.mean() > 0.7
        assert_contains(bounds, patches, maps, domains, rng, f"seed {seed}, size {size}")


def tight_family(rng, n):
    """Patches with control points of either of two heights, maps of two texels: the surface reaches its bounds."""
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    height = rng.choice([-0.06, 0.06], (n, 4, 4)) * rng.choice([0, 1e-6, 0.3, 1], (n, 1, 1))
    points = np.stack([np.broadcast_to(i / 3, height.shape), np.broadcast_to(j / 3, height.shape), height], -1)
    cp = np.concatenate([points + rng.choice([0, 1, 1000], (n, 1, 1, 1)), np.ones((n, 4, 4, 1))], -1)
    maps = [NaiveMap(np.full((1, 1), rng.choice([-2, 0.5, 1e3]), np.float32), "clamp", 1.0, 0.0) for _ in range(n)]
    return make_one(cp, map_id=np.arange(n)), maps


@by_seed
@BOTH
def test_boxes_hold_where_constant_displacement_reaches_them(clamped, seed):
    """With one displacement everywhere the models are all there is; float32 rounds most for great displacements."""
    rng = np.random.default_rng(40 + seed)
    patches, maps = tight_family(rng, 200)
    whole = np.tile([0.0, 1.0, 0.0, 1.0], (200, 1))
    bounds, valid = taylor.bound_and_validity(stage_of(patches, maps), clamped)
    assert valid.mean() > 0.5
    assert_contains(bounds, patches, maps, whole, rng, f"seed {seed}", grid_points(16))


def sheared_family(rng, n):
    """Flat parallelograms of whole-number control points, u and v nearly parallel; and their exact normals."""
    a = rng.integers(500, 1000, (n, 3))
    b = a + rng.choice([-2, -1, 1, 2], (n, 3)) * rng.integers(1, 40, (n, 1))
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    cp = np.ones((n, 4, 4, 4))
    cp[..., :3] = i[..., None] * a[:, None, None] + j[..., None] * b[:, None, None]
    normal = np.cross(a, b).astype(float)
    length = np.linalg.norm(normal, axis=1)
    return cp[length > 0], (normal[length > 0].T / length[length > 0]).T


@by_seed
@BOTH
def test_boxes_hold_where_tangents_are_nearly_parallel(clamped, seed):
    """Cross products cancel there: the shader's normals are off by many times the rounding of a unit vector."""
    rng = np.random.default_rng(45 + seed)
    cp, normal = sheared_family(rng, 100)
    maps, uv = [NaiveMap(np.full((1, 1), 1e6, np.float32), "clamp", 1.0, 0.0)], random_points(rng, 200)
    patches, whole = make_one(cp, map_id=0), np.tile([0.0, 1.0, 0.0, 1.0], (len(cp), 1))
    bounds, valid = taylor.bound_and_validity(stage_of(patches, maps), clamped)
    assert valid.all()
    assert_contains(bounds, patches, maps, whole, rng, f"seed {seed}", uv)
    _, shaded = shade(make_one(cp), [uv] * len(cp))
    assert max(abs(found - exact).max() for found, exact in zip(shaded, normal, strict=True)) > 100 * U


@by_seed
@BOTH
def test_boxes_of_displaced_patches_without_a_normal(clamped, seed):
    """Collapsed edges, folds, lines and points: the shader takes a nudged normal, or none."""
    rng = np.random.default_rng(50 + seed)
    cp = []
    for _ in range(8):
        folded, line, wedge = smooth_patch(rng), flat_square(), smooth_patch(rng, 0.05)
        folded[2:] = folded[1::-1]
        line[..., 1] = 2.5
        wedge[0] = wedge[0, 0]
        cp += [dome(), folded, line, wedge, np.broadcast_to(wedge[1, 1], (4, 4, 4))]
    n = len(cp)
    maps = [random_map(rng) for _ in range(n)]
    patches = make_one(cp, rng.uniform(-1, 2, (n, 4, 2)), np.arange(n))
    domains = random_domains(rng, n)
    domains[1::2, 0] = 0  # the ends where edges collapse
    bounds, valid = taylor.bound_and_validity(stage_of(patches, maps, domains), clamped)
    assert not valid[[k for k in range(n) if k % 5 in (2, 4)]].any()
    assert_contains(bounds, patches, maps, domains, rng, f"seed {seed}")


def volumes(bounds):
    return 8 * abs(np.linalg.det(bounds.axes))


def half_extents(bounds):
    return np.linalg.norm(bounds.axes, axis=2)


def share_axes(bounds, others):
    """Where both boxes have the same frame, up to rounding."""
    a, b = (x.axes / half_extents(x)[..., None] for x in (bounds, others))
    return (abs(np.einsum("prc,prc->pr", a, b)) > 1 - 1e-9).all(axis=1)


@by_seed
@pytest.mark.parametrize("bumps", [0.03, 0.1, 0.3])
def test_clamped_boxes_lie_inside_those_of_unit_normals(bumps, seed):
    """taylor_clamped inside taylor, and inside obbtex where that stands."""
    rng = np.random.default_rng(60 + seed)
    patches, maps = smooth_family(rng, 100, bumps)
    stage = stage_of(patches, maps, random_domains(rng, 100))
    plain, clamped = BOUNDS["taylor"](stage), BOUNDS["taylor_clamped"](stage)
    others = {"taylor": plain}
    if "obbtex" in BOUNDS:
        others["obbtex"] = BOUNDS["obbtex"](stage)
    for name, other in others.items():
        same = share_axes(clamped, other)
        assert same.sum() > 70, name
        shift = abs(np.einsum("prc,pc->pr", clamped.axes, clamped.center - other.center)) / half_extents(clamped)
        inside = shift + half_extents(clamped) <= half_extents(other) * (1 + 1e-5) + 1e-5
        assert inside[same].all(), name


def control_point_box(cp):
    """Volume of the control points' box in the patch's own frame (section 3.1.1), float64."""
    corner = {(i, j): cp[i, j, :3].astype(float) for i in (0, 3) for j in (0, 3)}
    t = corner[3, 0] - corner[0, 0] + corner[3, 3] - corner[0, 3]
    b = corner[0, 3] - corner[0, 0] + corner[3, 3] - corner[3, 0]
    x, z = t / np.linalg.norm(t), np.cross(t, b) / np.linalg.norm(np.cross(t, b))
    return np.ptp(cp[..., :3].reshape(16, 3) @ np.stack([x, np.cross(z, x), z]).T, axis=0).prod()


@BOTH
def test_without_displacement_at_least_as_tight_as_the_control_points(clamped):
    rng = np.random.default_rng(70)
    cp = np.stack([smooth_patch(rng, 0.15) for _ in range(100)])
    found = volumes(taylor.bound_and_validity(stage_of(make_one(cp), []), clamped)[0])
    expected = np.array([control_point_box(patch) for patch in cp])
    assert (found <= expected * (1 + 1e-3)).all()
    assert (found / expected).mean() < 0.9


def split(domains):
    """Four quarters of each domain."""
    u0, u1, v0, v1 = domains.T
    u, v = (u0 + u1) / 2, (v0 + v1) / 2
    quarters = [(u0, u, v0, v), (u, u1, v0, v), (u0, u, v, v1), (u, u1, v, v1)]
    return np.concatenate([np.stack(q, -1) for q in quarters])


def repeated(patches, times):
    return type(patches)(*(np.concatenate([a] * times) for a in patches))


@pytest.mark.parametrize("displaced", [False, True], ids=["smooth", "constant displacement"])
@BOTH
def test_volume_falls_by_splitting(clamped, displaced):
    """Summed over the quarters, level by level, to a few per cent: Munkberg et al. 2010, figure 9."""
    rng = np.random.default_rng(80)
    patches, _ = smooth_family(rng, 60, 0.06)
    maps = [NaiveMap(np.full((1, 1), 0.3, np.float32), "clamp", 1.0, 0.0)]
    patches.map_id[:] = 0 if displaced else -1
    domains, sums = np.tile([0.0, 1.0, 0.0, 1.0], (60, 1)), []
    for level in range(4):
        stage = stage_of(repeated(patches, 4**level), maps, domains)
        sums.append(volumes(taylor.bound_and_validity(stage, clamped)[0]).sum())
        domains = split(domains)
    assert all(after < 0.75 * before for before, after in pairwise(sums[1:])), sums
    assert sums[-1] < 0.12 * sums[0], sums


def test_most_smooth_patches_can_be_normalized():
    """Specification: 97 %, expanded about the centre with Bernstein ranges. Printed with -rP, by the size of the bumps."""
    rng = np.random.default_rng(90)
    share = {}
    for bumps in (0.02, 0.05, 0.08, 0.1, 0.15):
        patches, maps = smooth_family(rng, 400, bumps)
        share[bumps] = taylor.bound_and_validity(stage_of(patches, maps), True)[1].mean()
    print("share of patches with a model of their normals:", share)
    assert share[0.02] == 1 and share[0.05] > 0.97 and share[0.1] > 0.6


def test_rational_patches_get_the_box_of_unit_normals():
    rng = np.random.default_rng(95)
    cp = np.stack([rational_patch(rng) for _ in range(20)])
    maps = [NaiveMap(np.full((1, 1), 0.5, np.float32), "clamp", 1.0, 0.0)]
    bounds, valid = taylor.bound_and_validity(stage_of(make_one(cp, map_id=0), maps), False)
    plain, _ = taylor.bound_and_validity(stage_of(make_one(cp), maps), False)
    assert not valid.any()
    np.testing.assert_allclose(half_extents(bounds), half_extents(plain) + 0.5, rtol=1e-4)
