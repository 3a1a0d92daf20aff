"""Boxes and normal cones of Munkberg et al. 2010 and Sathe 2011: what must hold, and where the papers' print does not."""

from math import comb

import numpy as np
import pytest

from pipeline.bounds import BOUNDS, cones, general, scalar_normals, tangents
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.obb_frame import make_frame
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.hull import make_input
from pipeline.types import Patches
from tests.naive_domain import NaiveMap, exact_surface
from tests.test_bounds import VIEWPORT, attack_points, family_of, one_bound, quad, shade_with
from tests.test_domain import (
    IDENTITY,
    UNIT_SQUARE,
    dome,
    flat_square,
    make_one,
    pack,
    random_map,
    random_points,
    rational_patch,
    reorient,
    shade,
    smooth_patch,
)
from tiler.quality import measure, quality_table, scene_stage, split_domains

U = 2.0**-24
NAMES = ["cbox", "max_displacement", "obbtex", "tpatch", "tpatch_tight", "npatch"]
SEEDS = range(3)
by_seed = pytest.mark.parametrize("seed", SEEDS, ids=lambda s: f"seed{s}")
by_name = pytest.mark.parametrize("name", NAMES)
KINDS = ["polynomial", "rational", "degenerate", "flat", "tiny", "huge", "far away", "needle", "sheets", "collapsed"]
by_kind = pytest.mark.parametrize("kind", KINDS)


# Patches, sub-domains, and their boxes


def gentle(rng, bumps=0.08):
    """A sheet whose normals have a cone."""
    cp = smooth_patch(rng, bumps)
    if rng.random() < 0.4:
        weights = rng.uniform(0.8, 1.25, (4, 4, 1))
        cp = np.concatenate([cp[..., :3] * weights, weights], -1).astype(np.float32)
    return cp


def collapsed(rng):
    """A dome, or a gentle sheet, with an edge, a corner or a face of its control net drawn together."""
    cp = dome() if rng.random() < 0.3 else gentle(rng)
    what = rng.integers(4)
    if what == 0:
        cp[0] = cp[0, :1]
    elif what == 1:
        cp[0, 1], cp[1, 0] = cp[0, 0], cp[0, 0]
    elif what == 2:
        cp[0], cp[3] = cp[0, :1], cp[3, :1]
    return reorient(cp, rng.integers(8))


def patches_of(kind, rng, n=12):
    if kind == "sheets":
        return make_one([gentle(rng) for _ in range(n)])
    if kind == "collapsed":
        return make_one([collapsed(rng) for _ in range(n)])
    return family_of(kind, rng, n)[0]


def size_of(cp):
    points = cp[..., :3] / cp[..., 3:]
    return float(np.ptp(points.reshape(16, 3), axis=0).max()) or 1.0


def random_domain(rng):
    """All of the patch, a cell of a split, a strip at an edge, a speck, a point, or anything; multiples of 2^-16."""
    kind = rng.integers(6)
    if kind == 0:
        return np.array([0.0, 1.0, 0.0, 1.0])
    if kind == 1:
        parts = 2 ** rng.integers(1, 5)
        i, j = rng.integers(0, parts, 2) if rng.random() < 0.5 else rng.choice([0, parts - 1], 2)
        return np.array([i, i + 1, j, j + 1]) / parts
    ends = np.sort(rng.integers(0, 65537, (2, 2)), axis=1)
    if kind == 2:
        ends[rng.integers(2)] = (0, 1) if rng.random() < 0.5 else (65535, 65536)
    elif kind == 3:
        ends = np.minimum(ends[:, :1], 65536 - 8) + [0, 8]
    elif kind == 4:
        ends = np.repeat(ends[:, :1], 2, axis=1)
        ends[rng.integers(2)] = rng.choice([0, 65536])
    return ends.ravel() / 65536.0


def points_in(domain, rng, n=40):
    u0, u1, v0, v1 = domain
    t = np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], random_points(rng, n)])
    return np.float32([u0, v0] + np.round(t * [u1 - u0, v1 - v0] * 65536) / 65536)


def two_ended(rng, size):
    """A map of two texels: displacements of the patch's size, or far less or more, of any sign, also with zero."""
    t = np.sort(rng.normal(0, 1, 2) * size * 10 ** rng.uniform(-2, 0.7)).astype(np.float32)
    if rng.random() < 0.3:
        t[rng.integers(2)] = 0
        t.sort()
    return NaiveMap(t[None], "clamp", 1.0, 0.0)


def outside(bounds, k, points):
    """How far points leave box k, relative to its half extents; <= 0: nowhere."""
    axes, center = bounds.axes[k], bounds.center[k]
    squares = (axes * axes).sum(axis=1)
    along = abs((points - center) @ axes.T)
    reach = squares * (1 + 2.0**-50) + 2.0**-50 * (abs(center) @ abs(axes).T)
    return ((along - reach) / np.maximum(squares, 1e-300)).max()


def stage_of(patches, maps, domains=None):
    return make_input(patches, pack(maps), IDENTITY, VIEWPORT, domain=domains)


def displaced_extremes(cp, ends, uv):
    """World positions of a patch displaced by both constants."""
    patches = make_one(np.repeat(cp[None], 2, 0), map_id=[0, 1])
    clips, _ = shade(patches, [uv, uv], ends)
    return np.concatenate(clips)[:, :3].astype(np.float64)


# 1. Boxes hold the shader's output at both ends of the displacement


@by_seed
@by_kind
def test_boxes_hold_both_ends_of_the_displacement(kind, seed):
    rng = np.random.default_rng([seed, *kind.encode()])
    known = 0
    plain = patches_of(kind, rng)
    for k in range(12):
        cp = plain.control_points[k]
        image = two_ended(rng, size_of(cp.astype(np.float64)))
        domains = np.array([random_domain(rng) for _ in range(6)])
        stage = stage_of(make_one(np.repeat(cp[None], 6, 0), map_id=0), [image], domains)
        bounds = {name: BOUNDS[name](stage) for name in NAMES}
        for d in range(6):
            limits = [NaiveMap(np.array([[t]], np.float32), "clamp", 1.0, 0.0) for t in ends_of(stage, d)]
            points = displaced_extremes(cp, limits, points_in(domains[d], rng))
            for name, b in bounds.items():
                out = outside(b, d, points)
                assert out <= 0, f"{name} {kind} seed {seed} patch {k} domain {domains[d].tolist()}: {out}"
            known += bounds["tpatch"].cone_cos[d] > -1
    assert known > 10 or kind not in ("sheets", "collapsed", "flat")


def ends_of(stage, d):
    """Least and greatest displacement in the part of the map that domain d reads, rounded inwards to float32."""
    lo, hi = displacement_ranges(stage)[:, d]
    shrink = 8 * U * max(abs(lo), abs(hi))
    lo, hi = (lo + shrink, hi - shrink) if hi - lo > 2 * shrink else ((lo + hi) / 2,) * 2
    return np.float32(lo), np.float32(hi)


@by_seed
@by_name
def test_boxes_hold_filtered_maps_on_sub_domains(name, seed):
    rng = np.random.default_rng(50 + seed)
    n = 60
    cp = [(gentle, collapsed, rational_patch)[k % 3](rng) for k in range(n)]
    maps = [random_map(rng, most=40) for _ in range(n)]
    patches = make_one(cp, rng.uniform(-1, 2, (n, 4, 2)), np.arange(n))
    domains = np.array([random_domain(rng) for _ in range(n)])
    bounds = BOUNDS[name](stage_of(patches, maps, domains))
    clips, _ = shade(patches, [points_in(d, rng, 120) for d in domains], maps)
    for k in range(n):
        out = outside(bounds, k, clips[k][:, :3].astype(np.float64))
        assert out <= 0, f"seed {seed}, patch {k}, {domains[k].tolist()}: {out}"


@by_seed
@pytest.mark.parametrize("name", ["tpatch", "tpatch_tight", "npatch"])
def test_cones_hold_the_shaders_normals(name, seed):
    """Also next to and at collapsed edges, where the shader takes the normal of a point moved towards the middle."""
    rng = np.random.default_rng(80 + seed)
    n = 240
    cp = [(gentle, collapsed)[k % 2](rng) for k in range(n)]
    patches, domains = make_one(cp), np.array([random_domain(rng) for _ in range(n)])
    bounds = BOUNDS[name](stage_of(patches, [], domains))
    _, normals = shade(patches, [points_in(d, rng, 60) for d in domains])
    known = 0
    for k in np.flatnonzero(bounds.cone_cos > -1):
        normal = normals[k].astype(np.float64)
        assert (np.linalg.norm(normal, axis=1) > 0.9).all(), f"seed {seed}, patch {k}: no normal"
        axis = bounds.cone_axis[k]
        angle = np.arctan2(np.linalg.norm(np.cross(normal, axis), axis=1), normal @ axis).max()
        cosine = bounds.cone_cos[k]
        assert angle <= np.arctan2(np.sqrt((1 - cosine) * (1 + cosine)), cosine), (
            f"seed {seed}, patch {k}, {domains[k].tolist()}"
        )
        known += 1
    assert known > 80


def test_points_moved_out_of_a_sub_domain_are_in_its_cone():
    """At the pole of a dome twisted near it, the normal of a sub-domain's corner is one from outside of it."""
    rng = np.random.default_rng(4)
    left = 0
    for _ in range(200):
        cp = dome()
        cp[:, 2, :3] += rng.normal(0, 0.05, (4, 3))
        a = rng.integers(0, 1024) / 1024
        domain = np.array([a, a + 2.0**-12, 0.75, 1.0]) if a < 0.5 else np.array([a - 2.0**-12, a, 0.75, 1.0])
        uv = np.array([[domain[0], 1], [domain[1], 1]], np.float32)
        bounds = BOUNDS["npatch"](stage_of(make_one(cp), [], domain[None]))
        if bounds.cone_cos[0] > -1:
            image = [NaiveMap(np.full((1, 1), 1e3, np.float32), "wrap", 1.0, 0.0)]
            for name in NAMES:
                box = BOUNDS[name](stage_of(make_one(cp, map_id=0), image, domain[None]))
                assert outside(box, 0, displaced_extremes(cp, image * 2, uv)) <= 0
            moved = uv[:, 0] + (0.5 - uv[:, 0]) / 512
            left += ((moved < domain[0]) | (moved > domain[1])).any()
    assert left > 50


@pytest.mark.parametrize("name", ["tpatch", "tpatch_tight", "npatch"])
def test_climbing_towards_a_violation_finds_none(name):
    """Control points are moved so that the shaded points come closer to the box's faces, and beyond if they could."""
    rng = np.random.default_rng(60)
    image = [NaiveMap(np.array([[1.0]], np.float32), "wrap", 1.0, 0.0)]
    uv = attack_points(rng)
    worst = -np.inf

    def margin(cp):
        patches = make_one(cp, map_id=0)
        bounds = BOUNDS[name](stage_of(patches, image))
        clips, _ = shade(patches, [uv] * len(cp), image)
        score = [outside(bounds, k, clips[k][:, :3].astype(np.float64)) for k in range(len(cp))]
        return np.where(bounds.cone_cos > -1, score, -1.0)

    cp = np.stack([gentle(rng, 0.04) for _ in range(24)]).astype(np.float32)
    cp[..., :3] /= np.ptp(cp[..., :3], axis=(1, 2)).max(axis=-1)[:, None, None, None]
    best = margin(cp)
    first = best.copy()
    for step in range(120):
        moved = cp.copy()
        amount = 10 ** rng.uniform(-7, -1, (24, 1, 1, 1))
        moved[..., :3] += (rng.normal(size=moved[..., :3].shape) * amount).astype(np.float32)
        score = margin(moved)
        better = score > best
        cp[better], best[better] = moved[better], score[better]
        worst = max(worst, score.max())
        assert worst <= 0, f"step {step}: {worst}"
    assert (best > first).mean() > 0.5


# 2. Nesting


def along_frame(bounds, outer):
    """Whether each box of `bounds` lies in the box of the same frame in `outer`: largest overhang in half extents."""
    squares = (outer.axes**2).sum(axis=2)
    shift = abs(np.einsum("prc,pc->pr", outer.axes, bounds.center - outer.center))
    half = abs(np.einsum("prc,pqc->prq", outer.axes, bounds.axes)).sum(axis=2)
    size = abs(outer.center).max(axis=1, keepdims=True) * np.sqrt(squares)
    return ((shift + half - squares - 2.0**-48 * (squares + size)) / np.maximum(squares, 1e-300)).max()


@by_seed
@by_kind
def test_boxes_nest(kind, seed):
    rng = np.random.default_rng([seed, 1, *kind.encode()])
    patches = patches_of(kind, rng, 48)
    maps = [random_map(rng) for _ in range(48)]
    n = np.arange(48, dtype=np.int32)
    patches = patches._replace(map_id=n, texcoords=rng.uniform(-1, 2, (48, 4, 2)).astype(np.float32))
    for domains in (None, np.array([random_domain(rng) for _ in range(48)])):
        b = {name: BOUNDS[name](stage_of(patches, maps, domains)) for name in NAMES}
        for inner, outer in (
            ("npatch", "tpatch"), ("tpatch", "obbtex"), ("tpatch_tight", "tpatch"), ("max_displacement", "cbox"),
        ):  # fmt: skip
            assert along_frame(b[inner], b[outer]) <= 0, f"{inner} in {outer}, seed {seed}"
        assert (b["npatch"].cone_cos >= b["tpatch"].cone_cos).all()
        np.testing.assert_array_equal(b["tpatch"].cone_cos, b["tpatch_tight"].cone_cos)


def volumes(bounds):
    return 8 * np.prod(np.linalg.norm(bounds.axes, axis=2), axis=1)


@pytest.mark.parametrize("name", ["tpatch", "tpatch_tight", "npatch"])
def test_volume_falls_as_displaced_patches_are_split(name):
    rng = np.random.default_rng(70)
    patches = make_one([gentle(rng) for _ in range(40)], map_id=0)
    maps = [NaiveMap(np.full((1, 1), 0.1, np.float32), "wrap", 1.0, 0.0)]
    totals = [volumes(BOUNDS[name](split_domains(stage_of(patches, maps), k))).sum() for k in range(4)]
    assert (np.diff(totals) < 0).all(), totals


@by_name
def test_volume_falls_as_undisplaced_patches_are_split(name):
    rng = np.random.default_rng(71)
    patches = make_one([(smooth_patch, rational_patch)[k % 2](rng) for k in range(40)])
    totals = [volumes(BOUNDS[name](split_domains(stage_of(patches, []), k))).sum() for k in range(4)]
    assert (np.diff(totals) < 0).all(), totals


def test_a_sub_domains_cartesian_box_lies_in_the_whole_ones():
    rng = np.random.default_rng(72)
    patches = make_one([(smooth_patch, rational_patch)[k % 2](rng) for k in range(40)])
    domains = np.array([random_domain(rng) for _ in range(40)])
    whole, part = BOUNDS["cbox"](stage_of(patches, [])), BOUNDS["cbox"](stage_of(patches, [], domains))
    assert along_frame(part, whole) <= 0


@by_name
def test_weights_not_above_zero_give_no_box(name):
    rng = np.random.default_rng(73)
    for bad in (0, -1e-30, -3):
        cp = rational_patch(rng)
        cp[2, 1, 3] = bad
        bounds = BOUNDS[name](stage_of(make_one(cp), [], np.array([[0.0, 0.25, 0.5, 1.0]])))
        assert np.isnan(bounds.corners).any(axis=(1, 2)).all() and bounds.cone_cos[0] == -1


# Restriction and frame


@by_seed
def test_restriction_gives_the_same_surface(seed):
    rng = np.random.default_rng(90 + seed)
    net = np.empty((4, 4, 4))
    for _ in range(50):
        cp, (u0, u1, v0, v1) = rational_patch(rng), random_domain(rng)
        restrict_patch(cp, u0, u1, v0, v1, net)
        a, b = rng.random(2)
        ours, _, _, _ = exact_surface(net, a, b)
        exact, _, _, _ = exact_surface(cp, u0 + a * (u1 - u0), v0 + b * (v1 - v0))
        np.testing.assert_allclose(ours, exact, rtol=0, atol=2.0**-44 * abs(cp).max() / cp[..., 3].min())
    restrict_patch(cp, 0.0, 1.0, 0.0, 1.0, net)
    np.testing.assert_array_equal(net, cp)


@by_seed
def test_frames_are_orthonormal(seed):
    """Also of patches whose t and b are null, parallel or nearly so."""
    rng = np.random.default_rng(95 + seed)
    net, axes = np.empty((4, 4, 4)), np.empty((3, 3))
    for k in range(120):
        cp = smooth_patch(rng)
        if k % 4 == 1:
            cp[..., :3] *= [1, 10.0 ** -rng.uniform(3, 14), 10.0 ** -rng.uniform(3, 14)]
        elif k % 4 == 2:
            cp[3, :, :3] = cp[0, :, :3]
        elif k % 8 == 3:
            cp[..., :3] = cp[0, 0, :3]
        restrict_patch(cp, 0.0, 1.0, 0.0, 1.0, net)
        project_net(net)
        cosine, sine = make_frame(net, axes)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), rtol=0, atol=2.0**-50)
        assert sine >= 0 and (sine == 0 or abs(cosine**2 + sine**2 - 1) < 1e-14)
        if k % 4 == 0:
            np.testing.assert_allclose(axes, general.frame(net[..., :3]), rtol=0, atol=1e-9)


# Any bi-degree


def fast_nets(cp):
    """Tangent and normal nets of the fast path for the whole patch, their scale removed."""
    work = tangents.make_work()
    given_u, given_v = np.empty((0, 3, 4, 3), np.float32), np.empty((0, 4, 3, 3), np.float32)
    tangents.polynomial_nets(cp, -1, given_u, given_v, 0.0, 1.0, 0.0, 1.0, work)
    u, v = work.along_u[..., :3] * 3, work.along_v[..., :3] * 3
    scalar_normals.scale_net(work.along_u)
    scalar_normals.scale_net(work.along_v)
    scalar_normals.multiply_tangents(work.along_u, work.along_v, work.normals)
    return u, v, unscaled(work.normals[..., :3] * 9)


def unscaled(net):
    m, n = net.shape[0] - 1, net.shape[1] - 1
    return net / np.array([[[comb(m, i) * comb(n, j)] for j in range(n + 1)] for i in range(m + 1)])


@by_seed
def test_the_bicubic_path_equals_the_general_one(seed):
    rng = np.random.default_rng(110 + seed)
    for _ in range(10):
        cp = smooth_patch(rng)
        points = cp[..., :3].astype(np.float64)
        u, v = general.tangent_nets(points)
        for ours, expected in zip(fast_nets(cp), (u, v, general.normal_patch(u, v)), strict=True):
            assert ours.shape == expected.shape
            np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-13 * abs(expected).max() * 10)
        cp = rational_patch(rng)
        work = tangents.make_work()
        tangents.rational_nets(cp, 0.0, 1.0, 0.0, 1.0, work)
        expected = general.rational_tangent_nets(cp.astype(np.float64))
        for ours, theirs in zip((work.rational_u, work.rational_v), expected, strict=True):
            np.testing.assert_allclose(3 * unscaled(ours[..., :3]), theirs, rtol=0, atol=1e-12 * abs(theirs).max())


DEGREES = [(1, 1), (2, 1), (1, 3), (3, 3), (2, 4), (5, 2)]


@pytest.mark.parametrize("degree", DEGREES, ids=str)
def test_nets_of_any_degree_are_the_surfaces_derivatives(degree):
    rng = np.random.default_rng(sum(degree))
    m, n = degree
    points, weights = rng.normal(size=(m + 1, n + 1, 3)), rng.uniform(0.5, 2, (m + 1, n + 1, 1))
    along_u, along_v = general.tangent_nets(points)
    normals = general.normal_patch(along_u, along_v)
    assert normals.shape == (2 * m, 2 * n, 3)
    net = np.concatenate([points * weights, weights], -1)
    rational = general.rational_tangent_nets(net)
    assert rational[0].shape[:2] == (2 * m - 1, 2 * n + 1)
    h = 1e-5
    for u, v in rng.uniform(0.1, 0.9, (10, 2)):
        a = (general.evaluate(points, u + h, v) - general.evaluate(points, u - h, v)) / (2 * h)
        b = (general.evaluate(points, u, v + h) - general.evaluate(points, u, v - h)) / (2 * h)
        np.testing.assert_allclose(general.evaluate(along_u, u, v), a, atol=1e-7)
        np.testing.assert_allclose(general.evaluate(normals, u, v), np.cross(a, b), atol=1e-5)

        def project(u, v):
            value = general.evaluate(net, u, v)
            return value[:3] / value[3]

        weight = general.evaluate(net, u, v)[3]
        a = (project(u + h, v) - project(u - h, v)) / (2 * h) * weight**2
        b = (project(u, v + h) - project(u, v - h)) / (2 * h) * weight**2
        np.testing.assert_allclose(general.evaluate(rational[0], u, v), a, atol=1e-6)
        np.testing.assert_allclose(general.evaluate(rational[1], u, v), b, atol=1e-6)


# Errata: the printed form of each fails


def test_erratum_equation_10_multiplies_polynomials_of_one_variable():
    """Printed with u and v mixed: B(m,i)(u) B(n,j)(v) is no multiple of one Bernstein polynomial of degree m+n."""
    m, i, n, j, u, v = 2, 1, 3, 1, 0.2, 0.7
    factor = comb(m, i) * comb(n, j) / comb(m + n, i + j)
    for t in (u, v):
        right = general.bernstein(m, t)[i] * general.bernstein(n, t)[j]
        assert right == pytest.approx(factor * general.bernstein(m + n, t)[i + j], rel=1e-12)
    mixed = general.bernstein(m, u)[i] * general.bernstein(n, v)[j]
    for t in (u, v):
        assert mixed != pytest.approx(factor * general.bernstein(m + n, t)[i + j], rel=0.1)


@pytest.mark.parametrize("degree", [(1, 3), (2, 1), (2, 4)], ids=str)
def test_erratum_the_normal_patch_has_bi_degree_2m_1_2n_1(degree):
    """Printed m+n-1 twice: polynomials of that bi-degree cannot be the normal unless m = n."""
    rng = np.random.default_rng(1)
    m, n = degree
    along_u, along_v = general.tangent_nets(rng.normal(size=(m + 1, n + 1, 3)))
    u, v = rng.random((2, 200))
    normal = np.cross(general.evaluate(along_u, u, v), general.evaluate(along_v, u, v))

    def misfit(p, q):
        basis = np.einsum("ki,kj->kij", general.bernstein(p, u), general.bernstein(q, v)).reshape(200, -1)
        solution = np.linalg.lstsq(basis, normal, rcond=None)[0]
        return np.linalg.norm(basis @ solution - normal) / np.linalg.norm(normal)

    assert misfit(2 * m - 1, 2 * n - 1) < 1e-10
    assert misfit(m + n - 1, m + n - 1) > 1e-3
    net = general.normal_patch(along_u, along_v)
    np.testing.assert_allclose(general.evaluate(net, u, v), normal, atol=1e-11)


def unit_normals(cp, uv):
    _, (normal,) = shade(make_one(cp), [uv])
    return normal[np.linalg.norm(normal, axis=1) > 0.5].astype(np.float64)


def test_erratum_equation_13_beyond_90_degrees():
    """sin(theta) falls again and the cone is no longer convex: n_x, n_y in [-sin, sin], n_z in [cos, 1] is broken."""
    rng = np.random.default_rng(2)
    broken = obtuse = 0
    for _ in range(150):
        cp = smooth_patch(rng, 0.4)
        points = cp[..., :3].astype(np.float64)
        axes = general.frame(points)
        theta = general.half_angle(general.normal_patch(*general.tangent_nets(points)), axes[2])
        if theta <= np.pi / 2 + 1e-3:
            continue
        obtuse += 1
        uv = attack_points(rng)
        normal = unit_normals(cp, uv) @ axes.T
        outside_xy = abs(normal[:, :2]).max() > np.sin(theta) + 1e-6
        broken += outside_xy or normal[:, 2].min() < np.cos(theta) - 1e-6
        bounds = BOUNDS["npatch"](stage_of(make_one(cp), []))
        assert bounds.cone_cos[0] == -1
    assert obtuse > 50 and broken > 0.09 * obtuse, (obtuse, broken)


def test_erratum_sine_at_most_1_does_not_make_equation_14_valid():
    """Obtuse tangent cones have small sines: they pass the paper's test, and the normals leave the cone."""
    rng = np.random.default_rng(3)
    passed = broken = 0
    for _ in range(600):
        cp = smooth_patch(rng, 0.5)
        points = cp[..., :3].astype(np.float64)
        axes = general.frame(points)
        along_u, along_v = general.tangent_nets(points)
        b = points[0, 3] - points[0, 0] + points[3, 3] - points[3, 0]
        b /= np.linalg.norm(b)
        alpha_t, alpha_b = general.half_angle(along_u, axes[0]), general.half_angle(along_v, b)
        cosb, sinb = abs(axes[0] @ b), np.linalg.norm(np.cross(axes[0], b))
        st, sb = np.sin(alpha_t), np.sin(alpha_b)
        sine = np.sqrt(st**2 + 2 * st * sb * cosb + sb**2) / sinb
        if sine > 1 or alpha_t + alpha_b <= np.arccos(cosb):
            continue
        passed += 1
        normal = unit_normals(cp, attack_points(rng)) @ axes.T
        broken += abs(normal[:, :2]).max() > sine + 1e-6 or normal[:, 2].min() < np.sqrt(1 - sine**2) - 1e-6
        assert BOUNDS["tpatch"](stage_of(make_one(cp), [])).cone_cos[0] == -1
    assert passed > 10 and broken > 5, (passed, broken)


def test_erratum_sine_from_cosine_in_float32_is_too_small():
    """sqrt(1 - cos^2) of a unit vector's float32 cosine, against the sine of the same vector."""
    rng = np.random.default_rng(4)
    angle = 10 ** rng.uniform(-3, -1, 2000)
    vectors = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1) * rng.uniform(0.1, 10, (2000, 1))
    vectors = vectors.astype(np.float32)
    exact = vectors.astype(np.float64)
    true = exact[:, 0] / np.linalg.norm(exact, axis=1)
    length = np.sqrt((vectors * vectors).sum(axis=1, dtype=np.float32))
    cosine = vectors[:, 2] / length
    printed = np.sqrt(np.maximum(np.float32(1) - cosine * cosine, np.float32(0)))
    assert (printed < true * (1 - 1e-6)).mean() > 0.3
    assert (printed < true * 0.99).any()
    for x, _, z in exact[:200]:
        net = np.array([[[x, 0, z, np.hypot(x, z)]]])
        steep, _ = cones.cone_about(net, 0.0, 0.0, 1.0, np.inf)
        assert np.sqrt(steep / (1 + steep)) == pytest.approx(x / np.hypot(x, z), rel=1e-14)


def test_erratum_the_ndc_test_culls_a_visible_box():
    """Sathe 2011 divides the corners by w: a patch from (x, w) = (-2, 1) to (5, -1) is "left" in all and yet visible."""
    patches = make_one(quad([[-2, y, 1] if end == 0 else [5, y, -1] for y in (-0.01, 0.01) for end in (0, 1)]))
    matrix = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.5, 0], [0, 0, 1, 0]], np.float32)
    bounds = BOUNDS["obbtex"](make_input(patches, pack([]), matrix, VIEWPORT))
    corners = bounds.corners[0]
    assert (corners[:, 0] / corners[:, 3] < -1).all()
    clip = shade_with(patches, random_points(np.random.default_rng(0), 200), [], matrix)
    assert ((abs(clip[:, :2]) < clip[:, 3:]).all(axis=1) & (clip[:, 2] > 0)).any()
    assert bounds.rect[0, 0] < bounds.rect[0, 2]


def test_erratum_the_largest_displacement_is_that_of_the_magnitude():
    """Sathe 2011 takes the maximum: a map that only digs in has the maximum 0."""
    image = NaiveMap(np.array([[0, -2]], np.float32), "clamp", 1.0, 0.0)
    patches = make_one(flat_square(), map_id=0)
    bounds = one_bound(BOUNDS["max_displacement"], patches, 0, [image], IDENTITY)
    points = shade_with(patches, attack_points(np.random.default_rng(0)), [image], IDENTITY)
    assert points[:, 2].min() < -1.9 and outside(bounds, 0, points[:, :3]) <= 0


def test_max_displacement_looks_at_the_patch_s_own_part_of_the_map():
    texels = np.zeros((64, 64), np.float32)
    texels[40, 40] = 5
    image = NaiveMap(texels, "clamp", 1.0, 0.0)
    for corner, reach in ((0.1, 0.0), (0.6, 5.0)):
        patches = make_one(flat_square(), UNIT_SQUARE * np.float32(0.1) + np.float32(corner), 0)
        bounds = one_bound(BOUNDS["max_displacement"], patches, 0, [image], IDENTITY)
        assert bounds.axes[0, 2, 2] == pytest.approx(reach, abs=1e-4)


# Tightness


def test_quality_of_the_bounds_on_waves():
    rows = {row.bound: row for row in quality_table(["waves"], NAMES)}
    order = [rows[name].volume for name in ("cbox", "obbtex", "tpatch", "npatch")]
    assert order == sorted(order, reverse=True)
    assert rows["tpatch_tight"].volume <= rows["tpatch"].volume <= 3
    assert all(row.volume >= 1 and row.area >= 1 and row.patches == 1024 for row in rows.values())
    assert rows["tpatch"].cones == 1.0


def test_quality_of_split_patches():
    """Relative to references of their own, boxes with normal cones stay tight, others do not."""
    stage = scene_stage("spikelog")
    levels = [{row.bound: row for row in measure("spikelog", stage, ["obbtex", "tpatch_tight"], k)} for k in (0, 2)]
    assert levels[1]["obbtex"].volume > 5 * levels[0]["obbtex"].volume
    assert levels[1]["tpatch_tight"].volume < 2 * levels[0]["tpatch_tight"].volume
    assert isinstance(stage.patches, Patches) and levels[1]["obbtex"].patches == 96 * 16
