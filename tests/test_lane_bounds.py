"""Bounds in blocks of patches: the same as one at a time, whoever shares the block; patches with tangent patches, Gregory."""

import numpy as np
import pytest

from pipeline.bounds import BOUNDS, normals, scalar_normals
from pipeline.bounds.cbox import position_errors
from pipeline.bounds.cones import TANGENT, U
from pipeline.bounds.fit import AXES, COSINE, HI, KEPT, LO, SINE, fit_boxes
from pipeline.bounds.general import bernstein, evaluate
from pipeline.bounds.lanes import LANES, columns
from pipeline.bounds.obb_frame import make_frame
from pipeline.bounds.project import project_boxes
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.bounds.tangents import make_work, polynomial_nets
from pipeline.hull import make_input
from tests import cone_twin
from tests.naive_domain import NaiveMap
from tests.test_bounds import VIEWPORT, family_of, look, random_camera
from tests.test_box_bounds import KINDS, gentle, outside, patches_of, random_domain, size_of
from tests.test_domain import IDENTITY, make_one, pack, random_map, random_points, smooth_patch

by_seed = pytest.mark.parametrize("seed", range(3), ids=lambda s: f"seed{s}")
by_kind = pytest.mark.parametrize("kind", KINDS)
by_bound = pytest.mark.parametrize("name", BOUNDS)


def stage_of(patches, maps=(), domains=None, matrix=IDENTITY):
    return make_input(patches, pack(list(maps)), matrix, VIEWPORT, domain=domains)


def mixed(rng, n):
    """Patches of every kind in turn, some with broken coordinates or weights, over parts of themselves."""
    patches = patches_of(KINDS[0], rng, n)
    cp = patches.control_points.copy()
    for k in range(n):
        cp[k] = patches_of(KINDS[k % len(KINDS)], rng, 1).control_points[0]
    for k in range(5, n, 11):
        cp[k, k % 4, k // 4 % 4, k % 3] = (np.nan, np.inf, -np.inf)[k % 3]
    for k in range(7, n, 13):
        cp[k, 1, 2, 3] = (0, -1)[k % 2]
    maps = [random_map(rng) for _ in range(n)]
    domains = np.array([random_domain(rng) for _ in range(n)])
    domains[: n // 3] = [0, 1, 0, 1]
    return make_one(cp, rng.uniform(-1, 2, (n, 4, 2)), np.where(np.arange(n) % 5 == 4, -1, np.arange(n))), maps, domains


# Who shares the block


@by_seed
@by_bound
def test_a_patch_gets_the_same_bound_in_any_company(name, seed):
    rng = np.random.default_rng(seed)
    n = 2 * LANES + 9
    patches, maps, domains = mixed(rng, n)
    stage = stage_of(patches, maps, domains, random_camera(rng, np.zeros(3), 3.0))
    together = BOUNDS[name](stage)
    order = rng.permutation(n)[: LANES + 3]
    other = BOUNDS[name](stage._replace(patches=patches.take(order), domain=domains[order]))
    for a, b in zip(together, other, strict=True):
        np.testing.assert_allclose(b, a[order], rtol=1e-9, atol=0)


# The scalar functions


@by_seed
@by_kind
def test_fitted_boxes_are_those_of_the_scalar_functions(kind, seed):
    """Frames differ in rounding; extents along the same frame too."""
    rng = np.random.default_rng([seed, *kind.encode()])
    n = 40
    patches = patches_of(kind, rng, n)
    domains = np.array([random_domain(rng) for _ in range(n)])
    boxes = fit_boxes(stage_of(patches, domains=domains))
    assert boxes.shape == (KEPT, columns(n))
    net, axes = np.empty((4, 4, 4)), np.empty((3, 3))
    for p in range(n):
        restrict_patch(patches.control_points[p], *domains[p], net)
        if patches.rational[p]:
            project_net(net)
        cosine, sine = make_frame(net, axes)
        ours = boxes[AXES : AXES + 9, p].reshape(3, 3)
        np.testing.assert_allclose(ours @ ours.T, np.eye(3), rtol=0, atol=2.0**-50)
        if sine > 1e-3:
            np.testing.assert_allclose(ours, axes, rtol=0, atol=1e-9)
            np.testing.assert_allclose(boxes[[COSINE, SINE], p], [cosine, sine], rtol=0, atol=1e-9)
        along = net[..., :3].reshape(16, 3) @ ours.T
        errors = abs(ours) @ position_errors(patches.control_points[p], patches.rational[p])
        size = abs(patches.control_points[p, ..., :3] / patches.control_points[p, ..., 3:]).max()
        assert (boxes[LO : LO + 3, p] <= along.min(axis=0) - errors).all()
        assert (boxes[HI : HI + 3, p] >= along.max(axis=0) + errors).all()
        assert (boxes[LO : LO + 3, p] >= along.min(axis=0) - errors - 2.0**-44 * size).all()
        assert (boxes[HI : HI + 3, p] <= along.max(axis=0) + errors + 2.0**-44 * size).all()


def npatch_errors(stage, boxes, tpatch):
    """Sines of the error terms of NPATCH, of the lanes and of the scalar functions, for polynomial patches; 0 for rational.

    Of the lanes TPATCH's where the tangents' cone (row of cosines) is no wider than LEAST_COSINE, else
    (2 T + 3) u A B / h + u; of the scalar functions (2 T + 3) u lambda + u, lambda the largest size / n.z.
    """
    patches, n = stage.patches, len(stage.domain)
    along_u, along_v, work = np.zeros((n, 3, 4, 4)), np.zeros((n, 4, 3, 4)), make_work()
    for p in range(n):
        polynomial_nets(
            patches.control_points[p], -1, patches.tangent_u, patches.tangent_v, *stage.domain[p], work
        )  # fmt: skip
        along_u[p], along_v[p] = work.along_u, work.along_v
    x, y, z = boxes[AXES : AXES + 9, :n].reshape(3, 3, n).transpose(0, 2, 1)
    b = boxes[COSINE, :n, None] * x + boxes[SINE, :n, None] * y
    (u, v), (size_u, size_v) = (along_u[..., :3], along_v[..., :3]), (along_u[..., 3], along_v[..., 3])
    beta = np.arccos(abs(boxes[COSINE, :n]))
    _, apart = cone_twin.combine(cone_twin.half_angle(u, x), cone_twin.half_angle(v, b), beta)
    spread = [(s.reshape(n, -1) / cone_twin.dots(a, w)).max(axis=1) for a, s, w in ((u, size_u, x), (v, size_v, b))]
    by_tangents = (TANGENT * (spread[0] + spread[1]) + 3) * U / apart + U
    heights = cone_twin.dots(cone_twin.net_product(u, v, np.cross), z)
    sizes = cone_twin.net_product(size_u, size_v, np.multiply).reshape(n, -1)
    normal = (2 * TANGENT + 3) * U
    by_length = normal * size_u.max(axis=(1, 2)) * size_v.max(axis=(1, 2)) / heights.min(axis=1) + U
    lanes = np.where(tpatch > normals.LEAST_COSINE, by_tangents, by_length)
    scalar = normal * (sizes / heights).max(axis=1) + U
    return np.where(patches.rational[:n] != 0, 0.0, [lanes, scalar])


def asin(x):
    """Of an error term; a right angle where it says nothing."""
    return np.where((x >= 0) & (x < 1), np.arcsin(np.clip(x, 0, 1)), np.pi / 2)


@by_seed
@by_kind
@pytest.mark.parametrize("which", [normals.TPATCH, normals.TPATCH_TIGHT, normals.NPATCH])
def test_normal_bounds_are_those_of_the_scalar_functions(which, kind, seed):
    """Up to rounding. Of NPATCH both are a cone and an angle for what float32 does, by different formulas: either may be
    wider by its own."""
    rng = np.random.default_rng([seed, 1, *kind.encode()])
    n = 60
    patches = patches_of(kind, rng, n)
    domains = np.array([random_domain(rng) for _ in range(n)])
    domains[::2] = [0, 1, 0, 1]
    stage = stage_of(patches, domains=domains)
    boxes, ours = normals.bound_normals(stage, which)
    ours = ours[:, :n]
    theirs = np.empty((4, n))
    scalar_normals.bound_normals(
        stage, np.arange(n), boxes, which == normals.NPATCH, which == normals.TPATCH_TIGHT, theirs
    )  # fmt: skip
    # A cone may be lost where it nearly reaches 90 degrees or its tangents nearly vanish.
    lost = (ours[3] == -1) & (theirs[3] > -1)
    assert lost.sum() <= (n // 4 if which == normals.NPATCH else 0), f"{lost.sum()} of {n}"
    assert not ((theirs[3] == -1) & (ours[3] > 1e-3)).any()
    both = (ours[3] > -1) & (theirs[3] > -1)
    if which != normals.NPATCH:
        np.testing.assert_allclose(ours[:, both], theirs[:, both], rtol=0, atol=1e-9)
        return
    with np.errstate(all="ignore"):
        of_lanes, of_scalar = npatch_errors(stage, boxes, normals.bound_normals(stage, normals.TPATCH)[1][3, :n])
    more = np.arctan2(ours[0], ours[3]) - np.arctan2(theirs[0], theirs[3])
    assert (more <= asin(of_lanes) + 1e-9)[both].all() and (-more <= asin(of_scalar) + 1e-9)[both].all()
    for rows in (ours, theirs):
        np.testing.assert_allclose(np.hypot(rows[0], rows[3])[both], 1, rtol=0, atol=1e-9)
    assert (ours[:3] == [ours[0], ours[0], ours[3]]).all()


@by_seed
def test_projections_are_the_same_alone(seed):
    """Boxes before and across the near plane, far away, and not finite, in one block and one by one."""
    rng = np.random.default_rng(seed)
    n = 3 * LANES + 1
    stage = stage_of(make_one([gentle(rng) for _ in range(n)]))
    bounds = BOUNDS["obbtex"](stage)
    bounds.center[:] = rng.normal(0, 1, (n, 3)) * 10 ** rng.uniform(-2, 2, (n, 1))
    bounds.axes[:] = rng.normal(0, 1, (n, 3, 3)) * 10 ** rng.uniform(-3, 2, (n, 1, 1))
    bounds.center[::17, 0], bounds.axes[5::19, 1, 1] = np.nan, np.inf
    matrix = look([0, 0, 9], [0, 0, 0])
    project_boxes(matrix, VIEWPORT, bounds)
    for p in range(n):
        one = type(bounds)(*(np.ascontiguousarray(a[p : p + 1]) for a in bounds))
        project_boxes(matrix, VIEWPORT, one)
        for a, b in zip(one, bounds, strict=True):
            np.testing.assert_array_equal(a[0], b[p])
    signs = np.array([[1 if k >> r & 1 else -1 for r in range(3)] for k in range(8)])
    corners = bounds.center[:, None] + np.einsum("kr,prc->pkc", signs, bounds.axes)
    with np.errstate(invalid="ignore"):
        exact = np.concatenate([corners, np.ones((n, 8, 1))], 2) @ matrix.T.astype(np.float64)
    fine = np.isfinite(exact).all(axis=(1, 2))
    size = abs(corners[fine]).max() * abs(matrix).max()
    np.testing.assert_allclose(bounds.corners[fine], exact[fine], rtol=0, atol=2.0**-48 * size)
    assert not bounds.inside[~fine].any() and (bounds.rect[~fine] == [0, 0, 64, 48]).all()
    assert 5 < (bounds.corners[fine][..., 3] < 0).any(axis=1).sum() < n - 20


@by_bound
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_control_point_that_is_not_finite_gives_no_box(name, bad):
    rng = np.random.default_rng(3)
    for domain in (None, np.tile([0.25, 0.5, 0, 1.0], (48, 1))):
        cp = np.stack([gentle(rng) for _ in range(48)])
        for k in range(48):
            cp[k, k // 12, k // 3 % 4, k % 3] = bad
        bounds = BOUNDS[name](stage_of(make_one(cp), domains=domain))
        assert np.isnan(bounds.corners).any(axis=2).all() and (bounds.rect == [0, 0, 64, 48]).all()


# Patches with tangent patches: positions as Bezier, normals of TU x TV


def with_tangents(patches, rng, amount):
    """ACC patches: tangent patches that are the derivatives, times 3, plus noise of that share."""
    cp = patches.control_points[..., :3].astype(np.float64)
    along_u, along_v = 3 * np.diff(cp, axis=1), 3 * np.diff(cp, axis=2)
    scale = np.linalg.norm(along_u, axis=-1).mean(axis=(1, 2))[:, None, None, None] * amount
    n = len(cp)
    return patches._replace(
        tangent_id=np.arange(n, dtype=np.int32)[::-1].copy(),
        tangent_u=(along_u + rng.normal(0, 1, along_u.shape) * scale)[::-1].astype(np.float32),
        tangent_v=(along_v + rng.normal(0, 1, along_v.shape) * scale)[::-1].astype(np.float32),
    )


def acc_normals(patches, p, uv):
    """Unit normals in float64."""
    row = patches.tangent_id[p]
    u, v = uv.T.astype(np.float64)
    a = evaluate(patches.tangent_u[row].astype(np.float64), u, v)
    b = evaluate(patches.tangent_v[row].astype(np.float64), u, v)
    n = np.cross(a, b)
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def points_of(domain, rng, n=60):
    u0, u1, v0, v1 = domain
    t = np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], random_points(rng, n)])
    return [u0, v0] + t * [u1 - u0, v1 - v0]


@by_seed
@by_bound
def test_bounds_hold_patches_with_tangent_patches(name, seed):
    rng = np.random.default_rng(30 + seed)
    n, known, apart = 70, 0, 0
    for amount in (0.0, 0.05, 0.2):
        cp = (
            np.stack([gentle(rng) for _ in range(n)]) if seed else np.stack([smooth_patch(rng, 0.06) for _ in range(n)])
        )
        cp[..., :3] /= cp[..., 3:]
        cp[..., 3] = 1
        domains = np.array([random_domain(rng) for _ in range(n)])
        domains[::3] = [0, 1, 0, 1]
        patches = with_tangents(make_one(cp, map_id=np.arange(n)), rng, amount)
        sizes = [size_of(c.astype(np.float64)) * 10 ** rng.uniform(-1, 1) for c in cp]
        maps = [NaiveMap(np.full((1, 1), t, np.float32), "clamp", 1.0, 0.0) for t in sizes]
        bounds = BOUNDS[name](stage_of(patches, maps, domains))
        wrong = BOUNDS[name](stage_of(patches._replace(tangent_id=np.full(n, -1, np.int32)), maps, domains))
        for p in range(n):
            uv = points_of(domains[p], rng)
            normal = acc_normals(patches, p, uv)
            points = evaluate(cp[p, ..., :3].astype(np.float64), *uv.T) + np.float32(sizes[p]) * normal
            assert outside(bounds, p, points) <= 0, f"seed {seed}, noise {amount}, patch {p}, {domains[p].tolist()}"
            apart += outside(wrong, p, points) > 0
            if bounds.cone_cos[p] > -1:
                assert (normal @ bounds.cone_axis[p] >= bounds.cone_cos[p] - 1e-12).all()
                known += 1
    knows = name in ("tpatch", "tpatch_tight", "npatch", "taylor", "taylor_clamped")
    assert (known > n) == knows
    assert apart > 5 or not knows  # the derivatives' normals are not the shader's


# Gregory patches


def gregory(rng, n, spread):
    """Bumpy sheets whose inner points are pairs apart by `spread` of the patch's size; the mean as control point."""
    cp = np.stack([smooth_patch(rng, 0.1) for _ in range(n)])
    size = np.ptp(cp[..., :3].reshape(n, 16, 3), axis=1).max(axis=1)[:, None, None]
    middle = cp[:, [1, 2, 2, 1], [1, 1, 2, 2], :3]
    offset = rng.normal(0, spread, (n, 4, 3)) * size
    inner = np.stack([middle + offset, middle - offset], 2).astype(np.float32)
    cp[:, [1, 2, 2, 1], [1, 1, 2, 2], :3] = inner.astype(np.float64).mean(axis=2)
    return make_one(cp)._replace(gregory_id=np.arange(n, dtype=np.int32)[::-1].copy(), inner=inner[::-1].copy())


def gregory_points(patches, p, uv):
    """Positions in float64, one point at a time."""
    inner = patches.inner[patches.gregory_id[p]].astype(np.float64)
    out = []
    for u, v in uv:
        net = patches.control_points[p, ..., :3].astype(np.float64)
        places = (((1, 1), u, v), ((2, 1), v, 1 - u), ((2, 2), 1 - u, 1 - v), ((1, 2), 1 - v, u))
        for ((i, j), a, b), (plus, minus) in zip(places, inner, strict=True):
            net[i, j] = (a * plus + b * minus) / (a + b) if a + b > 0 else (plus + minus) / 2
        out.append(np.einsum("i,j,ijk->k", bernstein(3, u), bernstein(3, v), net))
    return np.array(out)


@by_seed
@by_bound
def test_bounds_hold_gregory_patches(name, seed):
    """Displaced by any vector of the map's length: nothing is known of their normals."""
    rng = np.random.default_rng(60 + seed)
    n, left = 40, 0
    for spread in (0.0, 0.02, 0.3):
        patches = gregory(rng, n, spread)._replace(map_id=np.arange(n, dtype=np.int32) // 2)
        domains = np.array([random_domain(rng) for _ in range(n)])
        domains[::3] = [0, 1, 0, 1]
        reach = [size_of(c.astype(np.float64)) * rng.choice([0, 0.1]) for c in patches.control_points[::2]]
        maps = [NaiveMap(np.full((1, 1), t, np.float32), "clamp", 1.0, 0.0) for t in reach]
        bounds = BOUNDS[name](stage_of(patches, maps, domains))
        mean = BOUNDS[name](stage_of(patches._replace(gregory_id=np.full(n, -1, np.int32)), maps, domains))
        assert (bounds.cone_cos == -1).all()
        for p in range(n):
            points = gregory_points(patches, p, points_of(domains[p], rng, 40))
            turn = rng.normal(size=points.shape)
            points = points + np.float32(reach[p // 2]) * turn / np.linalg.norm(turn, axis=1, keepdims=True)
            assert outside(bounds, p, points) <= 0, f"seed {seed}, spread {spread}, patch {p}, {domains[p].tolist()}"
            left += outside(mean, p, points) > 0
        if name in ("cbox", "max_displacement", "obbtex") and spread == 0:
            half = [np.linalg.norm(b.axes, axis=2) for b in (bounds, mean)]
            coordinates = abs(patches.control_points[..., :3]).max(axis=(1, 2, 3))[:, None]
            assert (abs(half[0] - half[1]) <= 64 * 2.0**-24 * coordinates).all()
    assert left > 5


@by_bound
def test_inner_points_that_are_not_finite_give_no_box(name):
    patches = gregory(np.random.default_rng(1), 3, 0.1)
    patches.inner[1, 2, 1, 0] = np.nan
    bounds = BOUNDS[name](stage_of(patches))
    assert np.isnan(bounds.corners).any(axis=(1, 2)).tolist() == [False, True, False]


def test_family_of_degenerate_displaced_patches_is_degenerate():
    patches, maps, _, _ = family_of("degenerate displaced", np.random.default_rng(0))
    assert len(maps) == 16 and (patches.control_points[1] == patches.control_points[1, :1, :1]).all()
