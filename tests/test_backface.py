"""Back-patch culls: exact where they say so, never where no answer is safe, and at the rates that are known.

Numbers in brackets: properties of section 13, errata of section 14 of the specification of bounds and culls.
"""

import os
import time
from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from pipeline.bounds.project import allocate
from pipeline.culling import CLASSIFIERS, CULL_TESTS, FLAG_OF, classify, make_tangent_plane_table, tangent_plane
from pipeline.culling.backface import Facing, mirrored
from pipeline.culling.frustum_ndc import cull_ndc
from pipeline.culling.pattern_steps import NUM_STEPS, measure_steps
from pipeline.culling.tangent_plane_table import POINTS, TARGET, TERMS, WEIGHT
from pipeline.hull import fixed_factors, make_input
from pipeline.primitives import Outcome
from pipeline.tessellator import tessellate
from pipeline.types import CullFlag, FaceCull, TessFactors, Viewport
from tests.shared_data import shared_file
from tests.test_bounds import family_of, look, quad
from tests.test_domain import IDENTITY, dome, make_one, pack, rational_patch, shade, smooth_patch
from tests.test_primitives import assemble
from tiler.config import Machine
from tiler.validation import families, make_batch, make_stage

BACKFACE = [name for name in CULL_TESTS if FLAG_OF[name] == CullFlag.BACKFACE]
SMOOTH = [name for name in BACKFACE if name != "backface:tessellation_safe"]
DISPLACED = "backface:displaced"
SAFE = "backface:tessellation_safe"
VIEWPORT = Viewport(0, 0, 640, 480, 0.0, 1.0)
FRONT, BACK, SILHOUETTE = Facing.FRONT, Facing.BACK, Facing.SILHOUETTE
SCENES = tiler.scene_names()
by_test = pytest.mark.parametrize("name", BACKFACE)
by_smooth = pytest.mark.parametrize("name", SMOOTH)
by_seed = pytest.mark.parametrize("seed", range(3), ids=lambda s: f"seed{s}")


# Patches, and eyes that see them


def gentle(rng, n, make=smooth_patch, bumps=0.06):
    return make_one([make(rng, bumps) for _ in range(n)])


def eyes_around(rng, patches, far=1.2):
    """For each patch an eye at `far` times 10^[-0.5, 1] of its radius about its middle."""
    cp = patches.control_points.astype(np.float64)
    points = (cp[..., :3] / cp[..., 3:]).reshape(len(cp), 16, 3)
    middle = points.mean(axis=1)
    radius = np.linalg.norm(points - middle[:, None], axis=2).max(axis=1)
    radius[radius == 0] = 1.0
    way = rng.normal(size=(len(cp), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return middle + way * (far * radius * 10 ** rng.uniform(-0.5, 1, len(cp)))[:, None]


def one_of(patches, k):
    return patches.take(np.array([k]))


def view_of(patches, eye, factor=4.0, viewport=VIEWPORT, target=None, maps=(), face=FaceCull.BACK):
    """Stage of these patches as an eye sees them that looks at their middle."""
    cp = patches.control_points.astype(np.float64)
    points = (cp[..., :3] / cp[..., 3:]).reshape(-1, 3)
    target = points.mean(axis=0) if target is None else target
    distance = np.linalg.norm(eye - target)
    matrix = look(eye, target, 1e-3 * distance, 100 * distance, 1.0)
    factors = fixed_factors(len(cp), (factor,) * 6)
    return make_input(patches, pack(list(maps)), matrix, viewport, eye=eye, factors=factors, face_cull=face)


def cull(name, stage):
    flags = np.zeros(len(stage.patches.control_points), np.uint8)
    CULL_TESTS[name](stage, BOUNDS["cbox"](stage), flags)
    return flags


def exact_patch(cp, n=33):
    """Points and p_u x p_v of one patch on an n x n grid, float64 (n * n, 3) each: an evaluation of its own."""
    t = np.linspace(0, 1, n)
    b = np.stack([comb(3, k) * t**k * (1 - t) ** (3 - k) for k in range(4)], -1)
    q = np.stack([comb(2, k) * t**k * (1 - t) ** (2 - k) for k in range(3)], -1)
    cp = cp.astype(np.float64)
    s = np.einsum("ui,vj,ijc->uvc", b, b, cp)
    su = 3 * np.einsum("ui,vj,ijc->uvc", q, b, np.diff(cp, axis=0))
    sv = 3 * np.einsum("ui,vj,ijc->uvc", b, q, np.diff(cp, axis=1))
    p, w = s[..., :3] / s[..., 3:], s[..., 3:]
    pu, pv = (su[..., :3] - su[..., 3:] * p) / w, (sv[..., :3] - sv[..., 3:] * p) / w
    return p.reshape(-1, 3), np.cross(pu, pv).reshape(-1, 3)


def exact_faces(cp, eye):
    """(e - p) . n at the grid, relative to its largest size."""
    p, n = exact_patch(cp)
    value = ((eye - p) * n).sum(axis=1)
    scale = (np.linalg.norm(eye - p, axis=1) * np.linalg.norm(n, axis=1)).max()
    return value / (scale or 1.0)


def front_triangles(stage, factor=None, partitioning="integer", viewport=VIEWPORT):
    """Triangles of each patch that a machine that drops back faces sets up or only drops for having no sample."""
    factor = stage.factors.edge[0, 0] if factor is None else factor
    uv, indices = tessellate("quad", partitioning, (factor,) * 4, (factor,) * 2, "triangle_ccw")
    n = len(stage.patches.control_points)
    if n == 0:
        return np.zeros(0, int)
    clips, _ = shade(stage.patches, [uv] * n, [], stage.clip_from_world)
    corners = np.concatenate([clip[indices].reshape(-1, 3, 4) for clip in clips])
    face = FaceCull(stage.face_cull).name
    made = assemble(corners, np.zeros((len(corners), 3, 3), np.float32), viewport, 1, face, len(indices) // 3)
    return made.outcomes[:, [Outcome.SETUP, Outcome.NO_SAMPLE, Outcome.OFFSCREEN]].sum(axis=1)


def cases(kind, seed, n=60):
    """Patches of a kind, each with an eye of its own."""
    rng = np.random.default_rng([seed, *kind.encode()])
    if kind == "gentle":
        patches = gentle(rng, n)
    elif kind == "rational gentle":
        patches = make_one([rational_patch(rng, 0.05, 1.4) for _ in range(n)])
    elif kind == "flat":
        cp = np.repeat(quad([[0, 0, 1.3], [1, 0, 1.3], [0, 1, 1.3], [1, 1, 1.3]])[None], n, 0)
        cp[..., :2] += rng.normal(0, 0.04, (n, 4, 4, 2))
        patches = make_one(cp)
    else:
        patches, _, _, _ = family_of(kind, rng, n)
    for k, eye in enumerate(eyes_around(rng, patches)):
        yield one_of(patches, k), eye


KINDS = ["gentle", "rational gentle", "polynomial", "rational", "degenerate", "flat", "needle", "tiny", "huge"]
by_kind = pytest.mark.parametrize("kind", KINDS)


# The smooth surface


@by_seed
@by_kind
def test_every_point_of_a_culled_patch_faces_away(kind, seed):
    """And every point of one that is called front-facing towards the eye: by each test, on a 33 x 33 grid."""
    seen = dict.fromkeys(BACKFACE, 0)
    for patch, eye in cases(kind, seed):
        stage = view_of(patch, eye)
        value = None
        for name in BACKFACE:
            (facing,) = classify(stage, name)
            if facing == SILHOUETTE:
                continue
            value = exact_faces(patch.control_points[0], eye) if value is None else value
            seen[name] += 1
            worst = value.max() if facing == BACK else -value.min()
            assert worst <= 1e-9, f"{name}, seed {seed}: a culled patch shows {worst}"
    if kind in ("gentle", "rational gentle", "flat"):
        rare = ("backface:normal_box", *((SAFE, DISPLACED) if kind == "rational gentle" else ()))  # the last takes none
        assert all(seen[name] > 3 for name in BACKFACE if name not in rare), seen


@by_seed
def test_what_culls_less_culls_nothing_else(seed):
    """[13.3, 13.4] tcone culls => tangent plane culls; ncone culls => so does the tangent plane; safe => so it does too."""
    counts = dict.fromkeys(BACKFACE, 0)
    for kind in ("gentle", "polynomial", "flat"):
        for patch, eye in cases(kind, 40 + seed, 150):
            stage = view_of(patch, eye)
            answers = {name: classify(stage, name)[0] for name in BACKFACE}
            for name, facing in answers.items():
                counts[name] += facing != SILHOUETTE
                if facing != SILHOUETTE and name not in ("backface:tangent_plane", DISPLACED):  # that looks at parts
                    assert answers["backface:tangent_plane"] == facing, f"{kind}, {name}"
    assert min(counts.values()) > 20, counts


def split(cp):
    """The four quarters of a patch."""
    half = np.array([[1, 0, 0, 0], [1 / 2, 1 / 2, 0, 0], [1 / 4, 1 / 2, 1 / 4, 0], [1 / 8, 3 / 8, 3 / 8, 1 / 8]])
    ends = (half, half[::-1, ::-1])
    return [np.einsum("ai,bj,ijc->abc", u, v, cp.astype(np.float64)) for u in ends for v in ends]


@by_seed
@pytest.mark.parametrize("kind", ["gentle", "rational gentle"])
def test_quarters_of_a_culled_patch_are_culled(kind, seed):
    """[13.5] In float64 terms: quarters are rounded to float32, so those seen edge-on may be lost."""
    culled = 0
    for patch, eye in cases(kind, 60 + seed, 120):
        stage = view_of(patch, eye)
        if (
            classify(stage, "backface:tangent_plane")[0] == BACK
            and exact_faces(patch.control_points[0], eye).max() < -1e-4
        ):
            culled += 1
            quarters = view_of(make_one(split(patch.control_points[0])), eye)
            assert (classify(quarters, "backface:tangent_plane") == BACK).all()
    assert culled > 10


@by_smooth
@by_seed
def test_exchanging_or_reversing_parameters_exchanges_front_and_back(name, seed):
    """[13.6] And both at once change nothing."""
    rng = np.random.default_rng(80 + seed)
    patches = gentle(rng, 400)
    stage = view_of(patches, np.array([3.0, 2, 1]))
    cp = patches.control_points
    other = np.array([SILHOUETTE, BACK, FRONT], np.uint8)
    before = classify(stage, name)
    assert (before != SILHOUETTE).sum() > 8
    for turned, sign in ((cp.swapaxes(1, 2), -1), (cp[:, ::-1], -1), (cp[:, :, ::-1], -1), (cp[:, ::-1, ::-1], 1)):
        after = classify(stage._replace(patches=make_one(turned)), name)
        assert (after == (before if sign > 0 else other[before])).mean() > 0.99
        swapped = other[before] if sign > 0 else before
        assert not ((after == swapped) & (after != SILHOUETTE)).any()


@by_smooth
@by_seed
def test_moving_eye_and_patches_together_changes_nothing(name, seed):
    """[13.8] A rotation (float32 rounds it, so a patch on the limit may change), and scaling by powers of two exactly."""
    rng = np.random.default_rng(90 + seed)
    patches = gentle(rng, 200)
    eye = np.array([3.0, 2, 1])
    before = classify(view_of(patches, eye), name)
    cp = patches.control_points.astype(np.float64)
    for scale in (2.0**-20, 2.0**20):
        scaled = cp * [scale, scale, scale, 1]
        np.testing.assert_array_equal(classify(view_of(make_one(scaled), eye * scale), name), before)
    if name != "backface:normal_box":  # its box has world axes
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.sign(np.linalg.det(turn))
        turned = np.concatenate([cp[..., :3] @ turn.T, cp[..., 3:]], -1)
        after = classify(view_of(make_one(turned), turn @ eye), name)
        assert (after == before).mean() > 0.98 and not (after.astype(int) * before == FRONT * BACK).any()


def plane_coefficients(cp):
    """T of one patch, float64 (64, 4): cross4 of the table's products, as printed."""
    points = cp.reshape(16, 4).astype(np.float64)
    rows = points[POINTS]  # (516, 3, 4)
    minors = np.stack([(-1) ** k * np.linalg.det(np.delete(rows, k, axis=2)) for k in range(4)], -1)
    t = np.zeros((64, 4))
    np.add.at(t, TARGET, WEIGHT[:, None] * minors)
    return t


@by_seed
@pytest.mark.parametrize("kind", ["gentle", "rational gentle"])
def test_clip_space_form_agrees_when_det_and_alpha_are_counted(kind, seed):
    """[13.7] sign(e . T) = sign(alpha) sign(det M) sign(T_z) of transformed points; without det M it is wrong [14, L11]."""
    agree = disagree = 0
    for patch, eye in cases(kind, 30 + seed, 40):
        cp = patch.control_points[0].astype(np.float64)
        (facing,) = classify(view_of(patch, eye), "backface:tangent_plane")
        p = cp[..., :3] / cp[..., 3:]
        target = p.mean(axis=(0, 1))
        distance = np.linalg.norm(eye - target)
        m = look(eye, target, 0.01 * distance, 10 * distance).astype(np.float64)
        for flip in (1.0, -1.0):
            for reverse in (False, True):
                matrix = m.copy()
                matrix[0] *= flip
                if reverse:
                    matrix[2] = matrix[3] - matrix[2]
                clip_eye = matrix @ np.append(eye, 1)
                alpha, det = clip_eye[2], np.linalg.det(matrix)
                tz = plane_coefficients(cp @ matrix.T)[:, 2]
                sign = np.sign(tz) * np.sign(alpha) * np.sign(det)
                if facing == BACK:
                    assert (sign <= 0).mean() > 0.98 and (np.sign(tz) * np.sign(alpha) < 0).any() == (det > 0)
                    agree += 1
                    disagree += det < 0
                elif facing == FRONT:
                    assert (sign >= 0).mean() > 0.98
    assert agree > 20 and disagree > 5, "the printed form, without det M, was never wrong"


def test_a_view_that_mirrors_exchanges_front_and_back():
    patches = gentle(np.random.default_rng(1), 100)
    stage = view_of(patches, np.array([2.0, 1, 4]))
    flipped = stage._replace(clip_from_world=stage.clip_from_world * np.array([[-1], [1], [1], [1]], np.float32))
    assert not mirrored(stage) and mirrored(flipped)
    for name in BACKFACE:
        one, other = classify(stage, name), classify(flipped, name)
        assert ((one == BACK) == (other == FRONT)).all() and ((one == FRONT) == (other == BACK)).all()
    assert (front_triangles(flipped._replace(face_cull=FaceCull.BACK))[cull(SAFE, flipped) > 0] == 0).all()


# Errata of the papers [14]


def test_cone_test_without_its_minus_culls_visible_patches():
    """L11 prints v.a <= sin(alpha): of visible patches that culls some forty percent."""
    wrong = visible = 0
    for patch, eye in cases("gentle", 7, 400):
        p, n = exact_patch(patch.control_points[0], 9)
        axis = n.mean(axis=0) / np.linalg.norm(n.mean(axis=0))
        unit = n / np.linalg.norm(n, axis=1, keepdims=True)
        sin = np.sqrt(1 - (unit @ axis).min() ** 2)
        v = eye - p.mean(axis=0)
        printed = v @ axis <= sin * np.linalg.norm(v)
        if ((eye - p) * n).sum(axis=1).max() > 0:
            visible += 1
            wrong += printed
            assert classify(view_of(patch, eye), "backface:ncone")[0] != BACK
    assert visible > 100 and 0.1 < wrong / visible < 0.9, (wrong, visible)


def test_table_is_made_by_its_script():
    file = os.path.join(os.path.dirname(make_tangent_plane_table.__file__), "tangent_plane_table.py")
    with open(file) as made:
        assert made.read() == make_tangent_plane_table.text()


def counts_of(terms, shape):
    counts = np.zeros(shape, int)
    for _, _, _, row, column, _ in terms:
        counts[row, column] += 1
    return counts


def test_table_has_the_counts_of_the_paper():
    counts = counts_of(TERMS, (8, 8))
    half = np.array(
        [
            [1, 2, 4, 5, 5, 4, 2, 1],
            [2, 4, 8, 10, 10, 8, 4, 2],
            [4, 8, 11, 17, 17, 11, 8, 4],
            [5, 10, 17, 21, 21, 17, 10, 5],
        ]
    )
    np.testing.assert_array_equal(counts, np.concatenate([half, half[::-1]]))
    owners = counts.reshape(2, 4, 2, 4).sum(axis=(0, 2))
    np.testing.assert_array_equal(owners, [[32, 33, 33, 32], [33, 31, 31, 33], [33, 31, 31, 33], [32, 33, 33, 32]])
    assert counts.sum() == 516 and abs(WEIGHT).max() <= 9
    for degrees, number in {(3, 3): 516, (2, 2): 76, (2, 3): 200, (1, 1): 4}.items():
        assert len(make_tangent_plane_table.make_terms(*degrees)) == number
    assert len(list(combinations(range(16), 3))) - 516 == 44


def test_the_printed_loop_does_not_fit_the_owners():
    """`k += 16` gives four threads 33 products and twelve 32; the owners of the control planes need 33, 32 and 31."""
    printed = sorted(len(range(thread, 516, 16)) for thread in range(16))
    owners = np.zeros(16, int)
    for _, _, _, row, column, _ in TERMS:
        owners[4 * (row % 4) + column % 4] += 1
    assert printed == [32] * 12 + [33] * 4 and sorted(owners) == [31] * 4 + [32] * 4 + [33] * 8
    assert sorted(owners) != printed and max(owners) * 16 == 528


def test_the_printed_shape_of_the_index_table_is_transposed():
    """`uint idx[4][]`: read as four rows, the table's first column would hold points of other triples."""
    table = np.concatenate([POINTS, TARGET[:, None]], axis=1)
    assert table.shape == (516, 4) and (np.diff(POINTS, axis=1) > 0).all() and TARGET.max() == 63
    transposed = table.reshape(4, 516).T
    assert not (np.diff(transposed[:, :3], axis=1) > 0).all()


@by_seed
@pytest.mark.parametrize("kind", ["polynomial", "rational"])
def test_table_gives_the_tangent_plane(kind, seed):
    """Sum of coefficients times Bernstein polynomials = cross4(S, S_u, S_v), and e . T = w^3 (e - p) . (p_u x p_v)."""
    for patch, eye in cases(kind, 100 + seed, 4):
        cp = patch.control_points[0].astype(np.float64)
        t = plane_coefficients(cp).reshape(8, 8, 4)
        x = np.linspace(0, 1, 9)
        b = np.stack([comb(7, k) * x**k * (1 - x) ** (7 - k) for k in range(8)], -1)
        value = np.einsum("ui,vj,ijc,c->uv", b, b, t, np.append(eye, 1)).ravel()
        p, n = exact_patch(cp, 9)
        cubic = np.stack([comb(3, k) * x**k * (1 - x) ** (3 - k) for k in range(4)], -1)
        w = np.einsum("ui,vj,ij->uv", cubic, cubic, cp[..., 3]).ravel()
        expected = w**3 * ((eye - p) * n).sum(axis=1)
        np.testing.assert_allclose(value, expected, rtol=0, atol=1e-8 * abs(expected).max())


# Bad input


@by_test
def test_no_answer_where_none_is_safe(name):
    """Rough displacement, Gregory patches, weights <= 0, no eye, no face cull: nothing is culled."""
    rng = np.random.default_rng(3)
    patches = gentle(rng, 100)
    stage = view_of(patches, np.array([4.0, 1, 2]), 8)
    front = stage._replace(face_cull=int(FaceCull.FRONT))
    assert (cull(name, stage) == CullFlag.BACKFACE).any() and (cull(name, front) == CullFlag.BACKFACE).any()
    assert not (cull(name, stage) & cull(name, front)).any()
    assert not cull(name, stage._replace(face_cull=int(FaceCull.NONE))).any()
    assert not cull(name, stage._replace(eye=np.full(3, np.nan))).any()
    assert not cull(name, stage._replace(eye=np.array([np.inf, 0, 0]))).any()
    displaced = make_one(patches.control_points, map_id=0)
    assert not cull(name, view_of(displaced, np.array([4.0, 1, 2]), 8, maps=[rough_map()])).any()
    assert not cull(name, stage._replace(patches=patches._replace(gregory_id=np.zeros(100, np.int32)))).any()
    bad = patches.control_points.copy()
    bad[:, 1, 2, 3] = rng.choice([0, -1, -1e-30], 100)
    assert not cull(name, stage._replace(patches=make_one(bad))).any()


def rough_map():
    from tests.naive_domain import NaiveMap

    return NaiveMap(np.random.default_rng(0).normal(size=(16, 16)).astype(np.float32), "wrap", 1.0, 0.0)


@by_test
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_patches_are_never_culled(name, bad):
    patches = gentle(np.random.default_rng(4), 64)
    cp = patches.control_points.copy()
    for k in range(64):
        cp[k, k // 16, k // 4 % 4, k % 4] = bad
    stage = view_of(patches, np.array([4.0, 1, 2]), 8)
    assert not cull(name, stage._replace(patches=make_one(cp))).any()
    for entry in range(16):
        matrix = stage.clip_from_world.copy()
        matrix.flat[entry] = bad
        flags = np.zeros(64, np.uint8)
        CULL_TESTS[name](stage._replace(clip_from_world=matrix), allocate(64), flags)
        if name == SAFE and entry // 4 != 2:
            assert not flags.any()


@by_test
def test_points_lines_and_edge_on_patches_are_silhouettes(name):
    point = np.ones((4, 4, 4))
    line = np.ones((4, 4, 4))
    line[..., 0] = np.linspace(0, 1, 4)[:, None]
    flat = quad([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    stage = view_of(make_one([point, line, flat]), np.array([3.0, 2, 0]))
    assert (classify(stage, name) == SILHOUETTE).all()
    for height, facing in ((1e-3, FRONT), (-1e-3, BACK)):
        stage = view_of(make_one(flat), np.array([3.0, 2, height]), 1)
        assert classify(stage, name)[0] in ((facing, SILHOUETTE) if name == SAFE else (facing,))


def test_collapsed_edges_are_culled_by_the_p_rule_only():
    """The lid of a pot, one edge of which is a point, from below: N_cnt < 64 and P_cnt = 0."""
    stage = view_of(make_one(dome()), np.array([-3.0, -3, -4]))
    if classify(stage, "backface:tangent_plane")[0] == FRONT:
        stage = view_of(make_one(dome()[::-1]), np.array([-3.0, -3, -4]))
    ((negative, positive),) = tangent_plane.sign_counts(stage, np.arange(1))
    assert 0 < negative < 64 and positive == 0
    assert classify(stage, "backface:tangent_plane")[0] == BACK


@by_test
@pytest.mark.parametrize("size", [1e-30, 1e-15, 1e9, 1e30])
def test_sizes_of_numbers_do_not_matter(name, size):
    rng = np.random.default_rng(5)
    cp = np.stack([smooth_patch(rng, 0.05) for _ in range(40)]).astype(np.float64)
    cp[..., :3] *= size
    for k in range(40):
        patch = make_one(cp[k])
        middle = cp[k, ..., :3].mean(axis=(0, 1))
        eye = middle + np.ptp(cp[k, ..., :3].reshape(16, 3), axis=0).max() * np.array([2.0, 1, 3])
        (facing,) = CLASSIFIERS[name](view_of(patch, eye)._replace(clip_from_world=IDENTITY), np.arange(1))
        if facing != SILHOUETTE and name != SAFE:
            value = exact_faces(patch.control_points[0] / np.float32([size, size, size, 1]), eye / size)
            assert (value * (1 if facing == BACK else -1)).max() <= 1e-5


def test_empty_input():
    stage = view_of(gentle(np.random.default_rng(0), 4), np.array([4.0, 1, 2]))
    none = stage._replace(patches=make_one(np.zeros((0, 4, 4, 4))), factors=fixed_factors(0, (1,) * 6))
    for name in CULL_TESTS:
        flags = np.zeros(0, np.uint8)
        CULL_TESTS[name](none, allocate(0), flags)


# Triangles


FACTORS = (1.0, 2.0, 3.0, 8.0, 16.0)
PARTITIONINGS = ("integer", "pow2", "fractional_odd", "fractional_even")


def bigguy():
    p = np.load(shared_file("data", "models", "bigguy_bezier_3570.npz"))["P"]
    return make_one(np.concatenate([p, np.ones((*p.shape[:3], 1), np.float32)], -1)), p.reshape(-1, 3).astype(float)


def bigguy_view(patches, points, way, factor, far=1.2, viewport=VIEWPORT):
    lo, hi = points.min(axis=0), points.max(axis=0)
    middle = (lo + hi) / 2
    radius = np.linalg.norm(points - middle, axis=1).max()
    eye = middle + far * radius * way / np.linalg.norm(way)
    return view_of(patches, eye, factor, viewport, middle)


def false_culls(stage, name, partitioning="integer", viewport=VIEWPORT):
    """(patches culled, those of them with a triangle that the machine would have set up)."""
    culled = np.flatnonzero(cull(name, stage))
    wrong = front_triangles(
        stage._replace(patches=stage.patches.take(culled)), stage.factors.edge[0, 0], partitioning, viewport
    )
    return len(culled), int((wrong > 0).sum())


@pytest.mark.parametrize("factor", [1.0, 2.0, 5.0, 7.3])
def test_safe_test_drops_no_triangle_of_a_model(factor):
    """BigGuy from all sides, in a small picture, where many triangles are of the size that the snap decides."""
    patches, points = bigguy()
    rng = np.random.default_rng(6)
    culled = 0
    for partitioning in ("integer", "fractional_odd", "fractional_even"):
        for size in (1.0, 0.2):
            viewport = Viewport(0, 0, int(640 * size), int(480 * size), 0.0, 1.0)
            stage = bigguy_view(patches, points, rng.normal(size=3), factor, rng.uniform(1.1, 4), viewport)
            n, wrong = false_culls(stage, SAFE, partitioning, viewport)
            assert wrong == 0
            culled += n
    assert culled > 300


def test_other_tests_drop_triangles_of_coarse_tessellations():
    """The exception that rule 1 of the design names, counted: about 0.2 percent of culled patches at factor 1."""
    patches, points = bigguy()
    rng = np.random.default_rng(7)
    total = {name: np.zeros(2, int) for name in SMOOTH}
    for _ in range(6):
        stage = bigguy_view(patches, points, rng.normal(size=3), 1.0)
        for name in SMOOTH:
            total[name] += false_culls(stage, name)
    assert 0 < total["backface:tangent_plane"][1] < 0.01 * total["backface:tangent_plane"][0], total
    assert total["backface:tcone"][1] <= 2, (
        "its triangles have an edge along u and one along v; only the snap flips them"
    )


@by_seed
@by_kind
def test_safe_test_holds_for_any_patch_factor_and_partitioning(kind, seed):
    """Adversarial: uneven factors, slivers just above a whole factor, patches of a pixel or less, near and far eyes."""
    rng = np.random.default_rng(400 + seed)
    culled = 0
    for patch, eye in cases(kind, 200 + seed, 100):
        size = int(10 ** rng.uniform(0.6, 3.6))
        viewport = Viewport(0, 0, size, max(4, size * 3 // 4), 0.0, 1.0)
        factors = (rng.choice([1, 2, 3, 5, 8], 6) + rng.choice([0, 0.01, 0.5], 6)).astype(np.float32)
        if rng.random() < 0.6:
            factors[:] = factors[0]
        stage = view_of(patch, eye, 1.0, viewport)
        stage = stage._replace(factors=TessFactors(factors[None, :4].copy(), factors[None, 4:].copy()))
        for face in (FaceCull.BACK, FaceCull.FRONT):
            stage = stage._replace(face_cull=int(face))
            if not cull(SAFE, stage)[0]:
                continue
            culled += 1
            for partitioning in PARTITIONINGS:
                uv, indices = tessellate("quad", partitioning, factors[:4], factors[4:], "triangle_ccw")
                (clip,), _ = shade(patch, [uv], [], stage.clip_from_world)
                corners = clip[indices].reshape(-1, 3, 4)
                made = assemble(
                    corners, np.zeros((len(corners), 3, 3), np.float32), viewport, 1, face.name, len(corners)
                )
                dropped = made.outcomes[0, [Outcome.FACE, Outcome.ZERO_AREA, Outcome.CLIPPED]].sum()
                assert dropped == made.outcomes[0, Outcome.C_IN], f"{kind}, seed {seed}, {partitioning} {factors}"
    if kind in ("gentle", "flat"):
        assert culled > 2


def test_steps_of_patterns():
    """Whole equal factors: right angles only, 1 / n apart. And a pattern turned over has no finite steps."""
    for n in (1, 2, 3, 7, 8, 33, 64):
        (steps,) = measure_steps(fixed_factors(1, (n,) * 6), np.arange(1))
        assert steps.shape == (NUM_STEPS,) and np.isfinite(steps).all()
        assert not steps[[2, 3, 6]].any() and not steps[8:].any(), "some triangle has no right angle"
        assert 1 / n <= steps[0] + 1e-4 and steps[4] >= 1 / steps[0]
    (uneven,) = measure_steps(fixed_factors(1, (4, 4, 4, 4, 8, 8)), np.arange(1))
    assert (uneven > 0).all()
    assert np.isinf(measure_steps(fixed_factors(1, (1, 0, 1, 1, 1, 1)), np.arange(1))).all()
    assert np.isinf(measure_steps(fixed_factors(1, (np.nan,) * 6), np.arange(1))).all()


def test_slivers_keep_a_patch_alive():
    """Just above a whole factor, fractional partitioning makes slivers whose area the snap may turn over."""
    patches = make_one(quad([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]))
    eye = np.array([0.5, 0.4, -2.0])
    assert cull(SAFE, view_of(patches, eye, 8.0))[0] == CullFlag.BACKFACE
    assert cull(SAFE, view_of(patches, eye, 8.002))[0] == CullFlag.ALIVE
    assert cull("backface:tangent_plane", view_of(patches, eye, 8.002))[0] == CullFlag.BACKFACE


# Pictures


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("face", ["back", "front", "none"])
def test_safe_cull_changes_no_picture(name, face, load):
    for factor in (1, 5, (2, 3, 4, 5, 6, 2.5)):
        scene = replace(load(name, size=(104, 60), factor=factor, samples=4), face_cull=face)
        reference = tiler.simulate(scene, Machine(cull=()))
        frame = tiler.simulate(scene, Machine(cull=("frustum", SAFE)))
        assert np.array_equal(frame.color, reference.color)
        assert np.array_equal(frame.depth_samples, reference.depth_samples)
        if name == "teapot" and face == "back" and factor == 5:
            assert frame.counters["hs_culled_backface"] > 0
        if face == "none":
            assert frame.counters["hs_culled_backface"] == 0


@by_smooth
@pytest.mark.parametrize("name_of_scene", SCENES)
def test_smooth_culls_change_no_picture_that_is_not_coarse(name, name_of_scene, load):
    scene = load(name_of_scene, size=(104, 60), factor=12)
    reference = tiler.simulate(scene, Machine(cull=()))
    frame = tiler.simulate(scene, Machine(cull=("frustum", name)))
    assert np.array_equal(frame.color, reference.color)
    assert np.array_equal(frame.depth_samples, reference.depth_samples)
    culled = frame.counters["hs_culled_backface"]
    if name_of_scene == "teapot" and name == "backface:tangent_plane":
        assert culled > 2
    if name_of_scene in ("waves", "spikelog") and name != DISPLACED:
        assert culled == 0, "displaced patches"


# Rates and time


def test_cull_rates_of_bigguy():
    """200 views: patches of a view are not independent; the standard error, from the views' scatter, is 0.5 points."""
    patches, points = bigguy()
    rng = np.random.default_rng(11)
    names = {"backface:tcone": 37.1, "backface:ncone": 45.1, "backface:tangent_plane": 48.8}
    rates = {name: [] for name in names}
    for way in rng.normal(size=(200, 3)):
        stage = bigguy_view(patches, points, way, 8.0)
        for name, got in rates.items():
            got.append(100 * (classify(stage, name) == BACK).mean())
    for name, expected in names.items():
        mean, error = np.mean(rates[name]), np.std(rates[name]) / np.sqrt(200)
        assert error < 0.6 and abs(mean - expected) < 1.5, f"{name}: {mean:.2f} +- {error:.2f}, expected {expected}"


def test_safe_test_gives_up_little():
    """Against the tangent plane, on BigGuy in a picture of 1280 x 720: within 5 points at factor 1, 6 at factor 8."""
    patches, points = bigguy()
    viewport = Viewport(0, 0, 1280, 720, 0.0, 1.0)
    rng = np.random.default_rng(12)
    lost = {1.0: [], 8.0: []}
    for way in rng.normal(size=(12, 3)):
        for factor, got in lost.items():
            stage = bigguy_view(patches, points, way, factor, viewport=viewport)
            smooth, safe = classify(stage, "backface:tangent_plane") == BACK, classify(stage, SAFE) == BACK
            assert not (safe & ~smooth).any()
            got.append(100 * (smooth.mean() - safe.mean()))
    assert np.mean(lost[1.0]) < 5 and np.mean(lost[8.0]) < 6, {k: np.mean(v) for k, v in lost.items()}


@pytest.mark.timing
def test_tangent_plane_takes_a_microsecond_a_patch_or_less():
    patches, points = bigguy()
    stage = bigguy_view(patches, points, np.array([1.0, 0.4, 0.7]), 8.0)
    best = np.inf
    for _ in range(20):
        start = time.perf_counter()
        classify(stage, "backface:tangent_plane")
        best = min(best, time.perf_counter() - start)
    assert best / 3570 < 1e-6, f"{best / 3570 * 1e6:.2f} microseconds a patch"


# Frustum variants


@by_seed
def test_frustum_variants_agree_with_clip_space(seed):
    """World-space planes give the answer of the clip-space corners; an object's box never culls what they would not."""
    rng = np.random.default_rng(500 + seed)
    patches = make_one([smooth_patch(rng) for _ in range(400)])
    patches = patches._replace(object_id=rng.integers(0, 60, 400).astype(np.int32))
    middle = np.zeros((60, 3))
    middle[:] = rng.normal(0, 60, (60, 3))
    patches.control_points[..., :3] = (
        patches.control_points[..., :3] * 0.05 + middle[patches.object_id][:, None, None]
    ).astype(np.float32)
    stage = view_of(patches, np.array([5.0, 2, 1]), target=np.zeros(3))
    by_corner, by_plane, by_object = (cull(name, stage) for name in ("frustum", "frustum:world", "frustum:object"))
    np.testing.assert_array_equal(by_corner, by_plane)
    assert 20 < (by_object > 0).sum() <= (by_corner > 0).sum() < 400
    assert (by_corner[by_object > 0] > 0).all()
    for o in range(60):
        assert len(set(by_object[patches.object_id == o])) <= 1


def test_an_unbounded_patch_keeps_its_object():
    patches = gentle(np.random.default_rng(8), 6)._replace(object_id=np.array([0, 0, 0, 1, 1, 1], np.int32))
    patches.control_points[..., 0] += 1000
    stage = view_of(patches, np.zeros(3), target=np.array([0, 0, -1.0]))
    bounds = BOUNDS["cbox"](stage)
    bounds.center[1] = np.nan
    flags = np.zeros(6, np.uint8)
    CULL_TESTS["frustum:object"](stage, bounds, flags)
    assert flags.tolist() == [0, 0, 0, 3, 3, 3]


def test_ndc_frustum_cull_is_not_conservative():
    """S11's test divides first. Of boxes that cross w = 0 it culls visible ones, and it misses others."""
    rng = np.random.default_rng(9)
    false = true = 0
    bounds = allocate(20000)
    bounds.corners[..., 3] = rng.normal(0.5, 1, (20000, 8))
    bounds.corners[..., :3] = rng.normal(0, 2, (20000, 8, 3)) + rng.normal(0, 1, (20000, 1, 3))
    bounds.slack[:] = 0
    crossing = (bounds.corners[..., 3] > 0).any(axis=1) & (bounds.corners[..., 3] < 0).any(axis=1)
    flags, right = np.zeros(20000, np.uint8), np.zeros(20000, np.uint8)
    stage = view_of(gentle(rng, 1), np.array([4.0, 1, 2]))
    cull_ndc(stage, bounds, flags)
    CULL_TESTS["frustum"](stage, bounds, right)
    weights = rng.dirichlet(np.full(8, 0.5), 200)
    for k in np.flatnonzero((flags > 0) & crossing):
        x, y, z, w = (weights @ bounds.corners[k]).T
        seen = ((abs(x) < w) & (abs(y) < w) & (z > 0) & (z < w)).any()
        false += seen
        true += not seen
        assert not (seen and right[k])
    assert false > 0 and "frustum:ndc" not in CULL_TESTS, (false, true)
    corners = np.zeros((1, 8, 4))
    corners[0, ::2], corners[0, 1::2] = [-2, 0, 0.1, 1], [5, 0, 0.1, -1]
    one, two = np.zeros(1, np.uint8), np.zeros(1, np.uint8)
    some = allocate(1)._replace(corners=corners, slack=np.zeros((1, 4)))
    cull_ndc(stage, some, one)
    CULL_TESTS["frustum"](stage, some, two)
    assert one[0] == CullFlag.FRUSTUM and two[0] == CullFlag.ALIVE


# Found by the verifier: rational patches whose points nearly coincide, seen from afar. With unequal weights the products
# of the tangent plane cancel to their own rounding noise, which once decided the cull.


@pytest.mark.parametrize(("seed", "batch", "rows"), [(1, 24, (18, 130)), (11, 24, (82,)), (12, 76, (114, 162, 250))])
def test_products_that_cancel_to_noise_decide_nothing(
    seed: int, batch: int, rows: tuple[int, ...], monkeypatch
) -> None:
    monkeypatch.setattr(families, "FAMILIES", families.FAMILIES[:26])  # as many as there were then: number 24 is meant
    assert make_batch(seed, batch, 1).name == "rational degenerate plain"
    stage = make_stage(make_batch(seed, batch))
    for name in ("backface:tangent_plane", "backface:tessellation_safe"):
        facing = classify(stage, name)
        assert all(facing[row] == Facing.SILHOUETTE for row in rows), name
