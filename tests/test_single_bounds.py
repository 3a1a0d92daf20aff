"""Whole Bezier patches in float32: their bounds hold the surface, and are looser than in float64 by what is derived."""

import numpy as np
import pytest

from pipeline.bounds import BOUNDS, cbox, normals, oriented, single_normals
from pipeline.bounds.cbox import position_errors
from pipeline.bounds.extremes import find_extremes, put_diagonals
from pipeline.bounds.general import evaluate
from pipeline.bounds.lanes import LANES
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.project import allocate_boxes
from pipeline.bounds.rows import copy_lanes, narrow_lanes
from pipeline.bounds.spread import load3, load9, store3, store4, store9, store32
from pipeline.bounds.transpose import fill_tail, load_block
from pipeline.jit import kernel
from tests import cone_twin
from tests.naive_domain import NaiveMap
from tests.test_box_bounds import outside
from tests.test_domain import make_one, random_points, smooth_patch
from tests.test_lane_bounds import by_seed, stage_of

U = 2.0**-24
KINDS = {
    "obbtex": oriented.NOTHING,
    "tpatch": normals.TPATCH,
    "tpatch_tight": normals.TPATCH_TIGHT,
    "npatch": normals.NPATCH,
}
by_kind = pytest.mark.parametrize("name", KINDS)


def sheets(rng, n, bumps=0.06):
    """Bumpy sheets of any size, some of them far from the origin for it."""
    cp = np.stack([smooth_patch(rng, bumps) for _ in range(n)]).astype(np.float64)
    cp[..., :3] /= cp[..., 3:]
    cp[..., 3] = 1
    cp[..., :3] *= 10 ** rng.uniform(-6, 6, (n, 1, 1, 1))
    size = np.ptp(cp[..., :3].reshape(n, 16, 3), axis=1).max(axis=1)
    cp[..., :3] += (size * 10 ** rng.uniform(-1, 3, n))[:, None, None, None] * rng.normal(size=(n, 1, 1, 3))
    return cp.astype(np.float32)


def staged(rng, n, reach=0.3, bumps=0.06):
    """Those sheets, each displaced by a map of one texel: (stage, size of each, displacement of each)."""
    cp = sheets(rng, n, bumps)
    size = np.ptp(cp[..., :3].reshape(n, 16, 3).astype(np.float64), axis=1).max(axis=1)
    moves = (size * reach).astype(np.float32)
    maps = [NaiveMap(np.full((1, 1), t, np.float32), "clamp", 1.0, 0.0) for t in moves]
    return stage_of(make_one(cp, map_id=np.arange(n)), maps), size, moves.astype(np.float64)


def twins(stage, kind):
    """Boxes in float32, where it is used, and in float64."""
    ranges = displacement_ranges(stage)
    wide = allocate_boxes(len(stage.domain))
    oriented._box_any(stage, kind, ranges, wide)
    return oriented.box_patches(stage, kind, ranges), wide


# Rows and columns


@kernel
def _load(control_points, first, tail, s):
    load_block(control_points, first, tail, s)


def test_points_of_a_block_become_rows():
    rng = np.random.default_rng(0)
    cp = rng.normal(size=(LANES + 7, 64)).astype(np.float32)
    rows, tail = np.zeros((50, LANES), np.float32), np.zeros((LANES, 64), np.float32)
    for first in (0, LANES):
        _load(cp, first, tail, rows.reshape(-1))
        expected = cp[np.minimum(first + np.arange(LANES), LANES + 6)].reshape(LANES, 16, 4)[..., :3]
        np.testing.assert_array_equal(rows[:48], expected.transpose(2, 1, 0).reshape(48, LANES))
        assert not rows[48:].any()


@kernel
def _store(which, s, row, first, target):
    if which == 3:
        store3(s, row, first, target)
    elif which == 4:
        store4(s, row, first, target)
    elif which == 9:
        store9(s, row, first, target)
    else:
        store32(s, row, first, target)


@kernel
def _load_back(which, s, row, first, source):
    if which == 3:
        load3(s, row, first, source)
    else:
        load9(s, row, first, source)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("width", [3, 4, 9, 32])
def test_rows_of_a_block_become_numbers_of_patches_and_back(width, compiled):
    rng = np.random.default_rng(0)
    source = rng.normal(size=(width + 8, LANES))
    store, load = (_store, _load_back) if compiled else (_store.py_func, _load_back.py_func)
    for n in (LANES + 7, 2 * LANES):
        for first in (0, LANES):
            count = min(LANES, n - first)
            target = np.zeros((n, width))
            store(width, source.reshape(-1), 5, first, target)
            np.testing.assert_array_equal(target[first : first + count], source[5 : 5 + width, :count].T)
            assert not target[:first].any() and not target[first + count :].any()
            if width in (3, 9):
                rows = np.zeros((width + 8, LANES))
                load(width, rows.reshape(-1), 5, first, target)
                np.testing.assert_array_equal(rows[5 : 5 + width, :count], source[5 : 5 + width, :count])
                assert (rows[5 : 5 + width, count:] == rows[5 : 5 + width, count - 1 : count]).all()
                assert not rows[:5].any() and not rows[5 + width :].any()


@kernel
def _copy(source, target, narrow):
    copy_lanes(source, 3, target, 5)
    narrow_lanes(source, 3, narrow, 5)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_row_is_copied_and_rounded_to_float32(compiled):
    source = np.random.default_rng(0).normal(size=(3, LANES)) * 1e3
    target, narrow = np.zeros((2, LANES)), np.zeros((2, LANES), np.float32)
    run = _copy if compiled else _copy.py_func
    run(source, target, narrow)
    row = source.reshape(-1)[3 : 3 + LANES]
    for copy in (target, narrow):
        np.testing.assert_array_equal(copy.reshape(-1)[5 : 5 + LANES], row.astype(copy.dtype))
        assert not copy.reshape(-1)[:5].any() and not copy.reshape(-1)[5 + LANES :].any()


@kernel
def _extremes(control_points, first, tail, s):
    fill_tail(control_points, first, tail)
    return find_extremes(control_points, first, tail, s)


@pytest.mark.parametrize("compiled", [True, False])
def test_extremes_of_a_block_are_those_of_its_points_and_broken_ones_are_told(compiled):
    rng = np.random.default_rng(0)
    cp = rng.normal(size=(LANES + 7, 64)).astype(np.float32)
    s, tail = np.zeros(2 * 3 * LANES, np.float32), np.zeros((LANES, 64), np.float32)
    run = _extremes if compiled else _extremes.py_func
    for first, count in ((0, LANES), (LANES, 7)):
        assert run(cp, first, tail, s)
        points = cp[first : first + count].reshape(count, 16, 4)
        low, high = s.reshape(2, LANES, 3)[:, :count]
        np.testing.assert_array_equal(low, points.min(axis=1)[:, :3])
        np.testing.assert_array_equal(high, points.max(axis=1)[:, :3])
        for number in (np.nan, np.inf, -np.inf):
            for k in range(48):
                broken = cp.copy()
                broken[first + k % count].reshape(16, 4)[k % 16, k // 16] = number
                with np.errstate(invalid="ignore"):
                    assert not run(broken, first, tail, s)


@kernel
def _diagonals(numbers, axes, begin):
    put_diagonals(numbers, axes, begin)


@pytest.mark.parametrize("compiled", [True, False])
def test_three_numbers_a_patch_become_diagonal_matrices(compiled):
    numbers = np.random.default_rng(0).normal(size=(LANES, 3))
    axes = np.full((LANES + 2, 3, 3), 7.0)
    run = _diagonals if compiled else _diagonals.py_func
    run(numbers.reshape(-1), axes.reshape(-1), 9)
    np.testing.assert_array_equal(axes[1:-1], numbers[:, :, None] * np.eye(3))
    assert (axes[[0, -1]] == 7.0).all()


@by_seed
def test_cartesian_boxes_in_blocks_are_those_of_the_patches_one_by_one(seed):
    """But for float64's roundings, as extents are added up in another order, and for 28 u^2 that blocks are larger."""
    rng = np.random.default_rng(seed)
    for n in (1, LANES - 1, LANES, 2 * LANES + 5):
        stage, _, _ = staged(rng, n, 0.3)
        for ranges, by_map in ((stage.pyramids.whole, True), (displacement_ranges(stage), False)):
            blocks, alone = cbox.box_patches(stage, ranges, by_map), allocate_boxes(n)
            cbox._fill_boxes(np.arange(n), stage.patches, stage.domain, ranges, by_map, np.empty((4, 4, 4)), alone)
            size = abs(alone.center).max(axis=1) + abs(alone.axes).max(axis=(1, 2))
            assert (abs(blocks.center - alone.center).max(axis=1) <= 2.0**-51 * size).all()
            more = np.diagonal(blocks.axes - alone.axes, axis1=1, axis2=2)
            assert (-(2.0**-51) * size <= more.min(axis=1)).all() and (more.max(axis=1) <= 28 * U * U * size).all()
            assert not blocks.axes[:, ~np.eye(3, dtype=bool)].any()
            assert (blocks.cone_cos == -1.0).all()


# Beside float64


@by_seed
def test_boxes_are_looser_than_in_float64_by_what_is_derived(seed):
    """At each end 68 u of the size, 2^-8 of the shader's error and 2^-36 of the largest coordinate."""
    rng = np.random.default_rng(seed)
    n = 300
    stage, _, _ = staged(rng, n, 0.0)
    narrow, wide = twins(stage, oriented.NOTHING)
    half, wanted = np.linalg.norm(narrow.axes, axis=2), np.linalg.norm(wide.axes, axis=2)
    cp = stage.patches.control_points
    errors = np.array([np.linalg.norm(position_errors(c, 0)) for c in cp])
    magnitude = abs(cp[..., :3]).max(axis=(1, 2, 3)).astype(np.float64)
    extent = np.linalg.norm(np.ptp(cp[..., :3].reshape(n, 16, 3).astype(np.float64), axis=1), axis=1)
    more = 68 * U * extent + (2.0**-8 + 2.0**-20) * errors + 2.0**-35 * magnitude
    assert (half != wanted).any(axis=1).mean() > 0.95  # float32 was used
    assert (half >= wanted - 2.0**-46 * magnitude[:, None]).all()
    assert (half <= wanted + more[:, None]).all()
    same = np.einsum("prc,prc->pr", narrow.axes, wide.axes) / (half * wanted)
    assert (same > 1 - 1e-9).all()


def greatest_angles(cp, axes):
    """Above the half angles (rad) of TPATCH and NPATCH in float32, by what `single_normals` says of its errors.

    cp : float64[n, 4, 4, 3]; axes : the frames, (n, 3, 3). Infinite where nothing is promised. All in units of |t|. The cones
    of float32 hold computed vectors, off by VECTOR_T D or VECTOR_B D; then comes what the shader may be off by, of which
    MORE and 2^-6 cover the rounding. Sines have ROUND for theirs; 2^-20 twice is `_sine_and_cosine` and what follows it.
    """
    points = np.einsum("nijc,nrc->nijr", cp - cp[:, :1, :1], axes)
    points /= np.linalg.norm(points[:, 3, 0] + points[:, 3, 3] - points[:, 0, 3], axis=1)[:, None, None, None]
    size = abs(points).max(axis=(1, 2, 3))
    b = points[:, 0, 3] + points[:, 3, 3] - points[:, 3, 0]
    b[:, 2] = 0
    b /= np.linalg.norm(b, axis=1)[:, None]
    x, z = (np.tile(axis, (len(b), 1)) for axis in np.eye(3)[[0, 2]])
    u, v = np.diff(points, axis=1), np.diff(points, axis=2)
    off_t = single_normals.VECTOR_T * size / cone_twin.dots(u, x).min(axis=1)
    off_b = single_normals.VECTOR_B * size / cone_twin.dots(v, b).min(axis=1)
    alpha_t = cone_twin.widened(cone_twin.half_angle(u, x), off_t)
    alpha_b = cone_twin.widened(cone_twin.half_angle(v, b), off_b)
    more, rounding = single_normals.MORE * (1 + 2.0**-6), 2.0**-18
    beta = np.arccos(abs(b[:, 0])) - rounding
    angle, apart = cone_twin.combine(alpha_t, alpha_b, beta)
    error = (16 * U * (1 / np.cos(alpha_t) + 1 / np.cos(alpha_b)) + off_t + off_b + 3 * U) * more / apart + 2 * U
    error = np.where((apart > 2 * single_normals.LEAST_SINE) & (error < single_normals.LIMIT), error, np.nan)
    tangents = cone_twin.widened(np.arcsin(np.minimum(np.sin(angle) * (1 + rounding), 1)), error)
    a, b = (np.linalg.norm(net, axis=-1).max(axis=(1, 2)) for net in (u, v))
    net = cone_twin.net_product(u, v, np.cross)
    own = (single_normals.VECTOR_T * size * (a + b) + single_normals.OWN * a * b) * (1 + 2.0**-6)
    height = cone_twin.dots(net, z).min(axis=1) - own
    error = (own + single_normals.NORMAL * a * b) * more / height + 2 * U
    error = np.where((height > 2 * single_normals.CLEAR * own) & (error < single_normals.LIMIT), error, np.nan)
    angle = cone_twin.widened(cone_twin.half_angle(net, z), own / height)
    normals = cone_twin.widened(np.arcsin(np.minimum(np.sin(angle) * (1 + rounding), 1)), error)
    return tangents, np.minimum(tangents, normals)


@by_seed
@pytest.mark.parametrize("name", ["tpatch", "tpatch_tight", "npatch"])
def test_cones_are_wider_than_in_float64_by_what_is_derived(name, seed):
    """Wherever a cone is promised it is known, and no wider than that; a cone of tangents is no narrower than in float64."""
    rng = np.random.default_rng([seed, 1])
    stage, _, _ = staged(rng, 300)
    narrow, wide = twins(stage, KINDS[name])
    axes = wide.axes / np.linalg.norm(wide.axes, axis=2)[..., None]
    cp = stage.patches.control_points[..., :3].astype(np.float64)
    with np.errstate(all="ignore"):
        promised = greatest_angles(cp, axes)[name == "npatch"]
    known, sure = narrow.cone_cos > -1, promised < np.pi / 2 - 2.0**-10
    assert sure.mean() > 0.5  # of bumpy sheets, some of which have no cone
    assert (known & (wide.cone_cos > -1))[sure].all()
    ours, theirs = np.arccos(np.minimum([narrow.cone_cos, wide.cone_cos], 1.0))
    assert (ours <= promised + 1e-6)[sure].all()
    if name != "npatch":  # there float64 takes the error of the tangents' cones, which may be the greater
        assert (ours >= theirs - 1e-6)[known].all()  # arccos near 1 loses half the digits
    assert (narrow.cone_cos != wide.cone_cos)[sure].mean() > 0.95  # float32 was used


@by_seed
@by_kind
def test_boxes_and_cones_hold_the_surface(name, seed):
    rng = np.random.default_rng([seed, 2])
    n = 120
    stage, _, moves = staged(rng, n, 0.2, 0.15)
    bounds = BOUNDS[name](stage)
    for p in range(n):
        uv = np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], random_points(rng, 60)]).astype(np.float64)
        cp = stage.patches.control_points[p, ..., :3].astype(np.float64)
        a, b = evaluate(np.diff(cp, axis=0), *uv.T), evaluate(np.diff(cp, axis=1), *uv.T)
        normal = np.cross(a, b)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        points = evaluate(cp, *uv.T) + moves[p] * normal
        assert outside(bounds, p, points) <= 0, f"seed {seed}, patch {p}"
        if bounds.cone_cos[p] > -1:
            assert (normal @ bounds.cone_axis[p] >= bounds.cone_cos[p] - 1e-12).all()


@by_kind
def test_what_float32_cannot_tell_is_left_to_float64(name):
    """Rational patches, parts of patches, collapsed edges, needles and numbers that are not finite: bit for bit its boxes."""
    rng = np.random.default_rng(4)
    n = 60
    stage, _, _ = staged(rng, n)
    cp, domain = stage.patches.control_points.copy(), stage.domain.copy()
    kind = np.arange(n) % 6
    cp[kind == 1, :, :, 3] = 2
    domain[kind == 2] = [0.25, 1, 0, 0.5]
    cp[kind == 3, 3] = cp[kind == 3, 3:, :1, :][:, 0]  # an edge that is a point
    cp[kind == 4, 1, 2, 1] = np.nan
    cp[kind == 5] *= np.float32(1e-30)
    patches = make_one(cp, map_id=stage.patches.map_id)
    narrow, wide = twins(stage._replace(patches=patches, domain=domain), KINDS[name])
    same = (np.isnan(narrow.axes) | (narrow.axes == wide.axes)).all(axis=(1, 2))
    left = (kind == 1) | (kind == 2) | (kind == 4) | (kind == 5) | ((kind == 3) & (name != "obbtex"))
    assert same[left].all() and not same[kind == 0].any()
    assert (np.isnan(narrow.axes) == np.isnan(wide.axes)).all()
