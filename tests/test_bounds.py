"""Bounds of displaced patches and the cull tests built on them: safe for every vertex that float32 makes, and tight."""

import numpy as np
import pytest

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS, FLAG_OF
from pipeline.hull import flag_nonfinite, make_input, run_cull_tests
from pipeline.primitives import FRUSTUM, GUARD, Outcome, guard_band, project_points
from pipeline.types import CullFlag, PatchBounds, Viewport, Window
from tests.naive_domain import NaiveMap
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
    shade,
    smooth_patch,
)
from tests.test_primitives import assemble

U = 2.0**-24
VIEWPORT = Viewport(0, 0, 64, 48, 0.0, 1.0)
VIEWPORTS = [VIEWPORT, Viewport(5, 11, 37, 23, 0.25, 0.7), Viewport(0, 0, 1920, 1080, 0.0, 1.0)]
SEEDS = range(4)
by_seed = pytest.mark.parametrize("seed", SEEDS, ids=lambda s: f"seed{s}")
by_bound = pytest.mark.parametrize("bound", BOUNDS.values(), ids=BOUNDS.keys())
by_cull = pytest.mark.parametrize("cull", [name for name in CULL_TESTS if FLAG_OF[name] == CullFlag.FRUSTUM])

# Clip-space functions of (x, y, z, w) that the box and the vertices are compared by, as rows of coefficients.
FUNCTIONS = np.array(
    [
        [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1],
        [1, 0, 0, 1], [-1, 0, 0, 1], [0, 1, 0, 1], [0, -1, 0, 1], [0, 0, -1, 1],
    ],
    np.float64,
)  # fmt: skip
FRUSTUM_PLANES = [4, 5, 6, 7, 2, 8]  # of FUNCTIONS: left, right, bottom, top, near, far


# Cameras


def look(eye, target, near=0.1, far=50.0, slope=0.6):
    """Clip-from-world matrix, float32; slope: half the height of the picture at distance 1."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.1, 1, 0.05], back)
    right /= np.linalg.norm(right)
    view = np.stack([right, np.cross(back, right), back])
    view = np.concatenate([view, -(view @ eye)[:, None]], 1)
    k = far / (far - near)
    projection = np.array([[0.75 / slope, 0, 0, 0], [0, 1 / slope, 0, 0], [0, 0, -k, -k * near], [0, 0, -1, 0]])
    return (projection @ np.concatenate([view, [[0, 0, 0, 1]]])).astype(np.float32)


def random_camera(rng, center, size):
    """Near or far from, inside of, in front of, beside, or looking away from something of this size."""
    distance = size * 10 ** rng.uniform(-1, 1.3)
    eye = center + rng.normal(size=3) * distance
    aim = rng.choice(["at it", "beside", "anywhere"], p=[0.5, 0.35, 0.15])
    target = center + {"at it": 0, "beside": distance, "anywhere": 9 * distance}[str(aim)] * rng.normal(size=3)
    return look(eye, target, near=distance * 10 ** rng.uniform(-2, 0.3), far=distance * 10 ** rng.uniform(0.2, 2))


# Families of patches with their maps


def spikes(rng):
    """A map that is flat but for single texels of either sign."""
    texels = np.zeros((8, 8), np.float32)
    texels[tuple(rng.integers(0, 8, (2, 3)))] = rng.normal(0, 1, 3)
    return NaiveMap(texels, str(rng.choice(["wrap", "mirror", "clamp"])), float(rng.normal()), 0.0)


def constant(rng):
    return NaiveMap(np.full((2, 3), rng.normal(), np.float32), "clamp", float(rng.normal()), float(rng.normal()))


def family_of(kind, rng, n=16):
    """Patches, their maps, and the middle and the size of each."""
    make = rational_patch if kind in ("rational", "rational displaced") else smooth_patch
    cp = np.stack([make(rng) for _ in range(n)]).astype(np.float64)
    if kind in ("degenerate", "degenerate displaced"):
        cp[0::4] = dome()
        cp[1::4] = cp[1::4, :1, :1]
        cp[2::4, :, :, 1:3] = 0.7
        cp[3::4, :, 3] = cp[3::4, :1, 3]
    elif kind == "flat":
        cp[..., 2] = 1.3
    elif kind in ("tiny", "huge", "far away"):
        cp[..., :3] *= {"tiny": 1e-15, "huge": 1e15, "far away": 1}[kind]
        cp[..., :3] += 1e5 if kind == "far away" else 0
    elif kind == "needle":
        cp[..., :3] = cp[..., :3] * [1e-4, 1, 1] + [3, 0, 0]
    points = cp[..., :3] / cp[..., 3:]
    size = np.ptp(points.reshape(n, 16, 3), axis=1).max(axis=1)
    maps, map_id = [], np.full(n, -1)
    if kind in DISPLACED:
        maps = [DISPLACED[kind](rng) for _ in range(n)]
        maps = [m._replace(scale=m.scale * s, bias=m.bias * s) for m, s in zip(maps, size, strict=True)]
        map_id = np.arange(n)
    patches = make_one(cp, rng.uniform(-1, 2, (n, 4, 2)), map_id)
    return patches, maps, points.reshape(n, 16, 3).mean(axis=1), size


DISPLACED = {
    "constant": constant,
    "spikes": spikes,
    "displaced": random_map,
    "rational displaced": random_map,
    "degenerate displaced": random_map,
}
PLAIN = ["polynomial", "rational", "degenerate", "flat", "tiny", "huge", "far away", "needle"]
by_kind = pytest.mark.parametrize("kind", PLAIN + list(DISPLACED))


def grid_points(factor):
    t = np.arange(factor + 1) / factor
    return np.stack(np.meshgrid(t, t, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)


def attack_points(rng):
    """Two grids as integer factors make them, the edges and corners, and anywhere between."""
    return np.concatenate([grid_points(1), grid_points(7), grid_points(8), random_points(rng, 60)])


def grid_triangles(factor):
    """Triangles of `grid_points(factor)` as point numbers."""
    k = np.arange(factor * (factor + 1)).reshape(factor, factor + 1)[:, :-1].ravel()
    one, two = np.stack([k, k + factor + 1, k + 1], -1), np.stack([k + 1, k + factor + 1, k + factor + 2], -1)
    return np.concatenate([one, two])


def one_bound(bound, patches, k, maps, matrix, viewport=VIEWPORT):
    """Bounds of patch k by itself."""
    some = type(patches)(*(a[k : k + 1] for a in patches))
    return bound(make_input(some, pack(maps), matrix, viewport))


def one_shade(patches, k, points, maps, matrix):
    """Clip positions of patch k, float64[n, 4]."""
    some = type(patches)(*(a[k : k + 1] for a in patches))
    return shade_with(some, points, maps, matrix)


def shade_with(patches, points, maps, matrix):
    (clip,), _ = shade(patches, [points], maps, matrix)
    return clip.astype(np.float64)


def window_of(clip, viewport):
    n = len(clip)
    window = Window(*(np.zeros(n, t) for t in (np.int32, np.int32, np.float32, np.float32, np.uint8)))
    project_points(0, n, np.ascontiguousarray(clip.T, np.float32), viewport, guard_band(viewport), window)
    return window


def views(kind, seed, n=16):
    """(patches, maps, k, matrix, viewport, rng): each patch from a camera of its own."""
    rng = np.random.default_rng([seed, len(kind), *kind.encode()])
    patches, maps, middle, size = family_of(kind, rng, n)
    for k in range(n):
        matrix = random_camera(rng, middle[k], size[k] or 1.0)
        yield patches, maps, k, matrix, VIEWPORTS[rng.integers(3)], rng


# Safe


@by_seed
@by_kind
@by_bound
def test_box_contains_world_positions(bound, kind, seed):
    """What the shader adds up in float32, seen through the identity: no vertex leaves the box by anything."""
    rng = np.random.default_rng(100 + seed)
    patches, maps, _, _ = family_of(kind, rng)
    bounds = bound(make_input(patches, pack(maps), IDENTITY, VIEWPORT))
    for k in range(16):
        clip = one_shade(patches, k, attack_points(rng), maps, IDENTITY)[:, :3]
        axes, center = bounds.axes[k], bounds.center[k]
        for axis in axes:
            along = (clip - center) @ axis
            # The box's ends are themselves rounded to float64.
            reach = axis @ axis * (1 + 2.0**-50) + 2.0**-50 * abs(center) @ abs(axis)
            assert (abs(along) <= reach).all(), f"seed {seed}, patch {k}"


@by_seed
@by_kind
@by_bound
def test_clip_positions_stay_within_corners_and_slack(bound, kind, seed):
    for patches, maps, k, matrix, viewport, rng in views(kind, seed):
        bounds = one_bound(bound, patches, k, maps, matrix, viewport)
        clip = one_shade(patches, k, attack_points(rng), maps, matrix)
        corners, slack = bounds.corners[0] @ FUNCTIONS.T, bounds.slack[0] @ abs(FUNCTIONS).T
        values = clip @ FUNCTIONS.T
        assert (values >= corners.min(axis=0) - slack).all() and (values <= corners.max(axis=0) + slack).all(), (
            f"seed {seed}, patch {k}: {values.min(axis=0)} .. {values.max(axis=0)}"
        )


@by_seed
@by_kind
@by_bound
def test_rectangle_depth_and_inside_flag_hold_for_every_vertex(bound, kind, seed):
    seen = {"on screen": 0, "inside": 0}
    for patches, maps, k, matrix, viewport, rng in views(kind, seed, 32):
        bounds = one_bound(bound, patches, k, maps, matrix, viewport)
        window = window_of(one_shade(patches, k, attack_points(rng), maps, matrix), viewport)
        left, top = viewport.left, viewport.top
        right, bottom = left + viewport.width, top + viewport.height
        x0, y0, x1, y1 = bounds.rect[0]
        assert left <= x0 <= x1 <= right and top <= y0 <= y1 <= bottom
        if bounds.inside[0]:
            seen["inside"] += 1
            assert (window.code & (FRUSTUM | GUARD) == 0).all()
        front = window.code & ~np.uint8(0b1111) == 0  # at any x and y in the guard band
        x, y = window.x[front] / 256, window.y[front] / 256
        shown = (x > left) & (x < right) & (y > top) & (y < bottom)
        seen["on screen"] += shown.any()
        if x0 == x1:
            assert not shown.any(), f"seed {seed}, patch {k}: no pixels, yet a vertex is on the screen"
        else:
            x, y = np.clip(x, left, right), np.clip(y, top, bottom)
            inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
            assert inside.all(), f"seed {seed}, patch {k}: {bounds.rect[0]}, vertex at {x[~inside]}, {y[~inside]}"
        assert (window.z[front] >= bounds.z_min[0]).all(), f"seed {seed}, patch {k}: z_min {bounds.z_min[0]}"
    assert seen["on screen"] > 3 and (seen["inside"] or kind in ("tiny", "huge")), seen


def set_up(patches, k, factor, maps, matrix, viewport, samples=4):
    """Every triangle of patch k at a tess factor, through clipping and set-up."""
    clip = one_shade(patches, k, grid_points(factor), maps, matrix).astype(np.float32)
    triangles = clip[grid_triangles(factor)]
    return assemble(triangles, np.zeros((len(triangles), 3, 3), np.float32), viewport, samples)


@by_seed
@by_bound
def test_rectangle_holds_where_window_coordinates_round_most(bound, seed):
    """In a picture so wide that float32 is off by more than the snap, patches whose edges lie on borders of pixels."""
    rng = np.random.default_rng(300 + seed)
    viewport = Viewport(0, 0, 32000, 32000, 0.0, 1.0)
    for _ in range(150):
        w = rng.uniform(0.1, 10)
        low = rng.integers(16000, 31000, 2)
        high = low + rng.integers(1, 500, 2)
        (x0, x1), (y0, y1) = ((np.array(ends) / 16000 - 1) * w for ends in zip(low, high, strict=True))
        matrix = IDENTITY.copy()
        matrix[3] = [0, 0, 0, w]
        patches = make_one(quad([[x, -y, 0.5 * w] for y in (y0, y1) for x in (x0, x1)]))
        (left, top, right, bottom), *_ = bound(make_input(patches, pack([]), matrix, viewport)).rect
        window = window_of(shade_with(patches, grid_points(2), [], matrix), viewport)
        x, y = window.x / 256, window.y / 256
        assert (x >= left).all() and (x <= right).all() and (y >= top).all() and (y <= bottom).all(), f"seed {seed}"


@by_seed
@by_kind
@by_bound
def test_rectangle_and_depth_hold_for_every_triangle(bound, kind, seed):
    """Also for those that the clipper cut: every pixel that it may touch, every depth that it may have."""
    triangles = cut = 0
    for patches, maps, k, matrix, viewport, _ in views(kind, seed, 24):
        bounds = one_bound(bound, patches, k, maps, matrix, viewport)
        for factor in (1, 5):
            assembled = set_up(patches, k, factor, maps, matrix, viewport)
            chosen = assembled.all()
            box, (x0, y0, x1, y1) = assembled.triangles.box[chosen], bounds.rect[0]
            # A vertex that the clipper made at the near plane may lie 1e-15 before it; depths of samples are clamped.
            z = np.maximum(assembled.window.z[assembled.triangles.vertex[chosen]], np.float32(viewport.min_depth))
            context = f"seed {seed}, patch {k}, factor {factor}"
            assert ((box[:, :2] >= [x0, y0]) & (box[:, 2:] < [x1, y1])).all(), f"{context}: {bounds.rect[0]}, {box}"
            assert (z >= bounds.z_min[0]).all(), f"{context}: z_min {bounds.z_min[0]}, {z.min()}"
            triangles += len(chosen)
            cut += assembled.outcomes[:, Outcome.CUT].sum()
            assert not (bounds.inside[0] and assembled.outcomes[:, Outcome.CUT].any())
    assert triangles > 20 and (cut or kind in ("tiny", "huge"))


@by_bound
def test_box_contains_patches_of_denormal_coordinates(bound):
    """Coordinates of 1e-20 with weights of 1e-20: their products are denormal."""
    rng = np.random.default_rng(0)
    cp = np.full((4, 4, 4), 1e-40)
    cp[..., 3] = 1e-20
    cp[0, 0] *= 1.5
    patches = make_one(cp)
    bounds = bound(make_input(patches, pack([]), IDENTITY, VIEWPORT))
    points = shade_with(patches, random_points(rng, 200), [], IDENTITY)[:, :3]
    assert (abs(points - bounds.center[0]) <= abs(bounds.axes[0]).sum(axis=0)).all()


@by_bound
def test_slack_is_needed(bound):
    """Clip positions do leave the corners' hull: a bound without slack would be caught by the tests above."""
    left = 0
    for kind in ("flat", "far away"):
        for patches, maps, k, matrix, viewport, rng in views(kind, 0, 32):
            corners = one_bound(bound, patches, k, maps, matrix, viewport).corners[0] @ FUNCTIONS.T
            values = one_shade(patches, k, attack_points(rng), maps, matrix) @ FUNCTIONS.T
            left += (values < corners.min(axis=0)).any() or (values > corners.max(axis=0)).any()
    assert left > 0


# Tight


def quad(corners, w=1.0):
    """A flat bilinear patch with straight, evenly divided edges; corners (4, 3) at (0,0) (1,0) (0,1) (1,1)."""
    t = np.arange(4) / 3
    u, v = t[:, None, None], t[None, :, None]
    p00, p10, p01, p11 = np.asarray(corners, float)
    points = (1 - u) * (1 - v) * p00 + u * (1 - v) * p10 + (1 - u) * v * p01 + u * v * p11
    return np.concatenate([points, np.full((4, 4, 1), w)], -1)


@by_seed
@by_bound
def test_rectangle_of_a_flat_patch_is_tight(bound, seed):
    """A rectangle that faces the camera: at most one pixel more a side than its true extent; z_min is its depth."""
    rng = np.random.default_rng(200 + seed)
    shown = 0
    for viewport in VIEWPORTS:
        for _ in range(30):
            (x0, x1), (y0, y1) = (np.sort(rng.uniform(-1, 1, 2)) for _ in range(2))
            z, matrix = -rng.uniform(0.5, 40), look([0, 0, 0], [0, 0, -1])
            matrix[:2] = np.diag([0.8, 1.2, 0, 0])[:2]
            corners = [[x * -z, y * -z, z] for y in (y0, y1) for x in (x0, x1)]
            patches = make_one(quad(corners))
            bounds = bound(make_input(patches, pack([]), matrix, viewport))
            window = window_of(shade_with(patches, grid_points(1), [], matrix), viewport)
            x = np.clip(window.x / 256, viewport.left, viewport.left + viewport.width)
            y = np.clip(window.y / 256, viewport.top, viewport.top + viewport.height)
            extent = np.array([np.floor(x.min()), np.floor(y.min()), np.ceil(x.max()), np.ceil(y.max())])
            if bounds.rect[0, 0] < bounds.rect[0, 2]:
                assert (abs(bounds.rect[0] - extent) <= 1).all(), f"seed {seed}: {bounds.rect[0]}, truly {extent}"
                shown += 1
            else:
                assert extent[0] == extent[2] or extent[1] == extent[3]
            assert bounds.z_min[0] == pytest.approx(window.z.min(), abs=64 * U)
    assert shown > 60


@by_bound
def test_inside_flag_is_set_where_it_should_be(bound):
    """A flat patch inside all planes by a hundredth."""
    patches = make_one(quad([[x, y, z] for (y, z) in ((-0.99, 0.01), (0.99, 0.99)) for x in (-0.99, 0.99)]))
    bounds = bound(make_input(patches, pack([]), IDENTITY, VIEWPORT))
    assert bounds.inside[0] == 1


@by_bound
def test_displacement_widens_by_the_range_of_the_map_only(bound):
    image = NaiveMap(np.array([[-0.25, 0.125]], np.float32), "wrap", 1.0, 0.0)
    patches = make_one(flat_square(), map_id=0)
    bounds = bound(make_input(patches, pack([image]), IDENTITY, VIEWPORT))
    extent = abs(bounds.axes[0]).sum(axis=0)
    assert (extent <= np.array([1.5, 1.5, 0]) + 0.25 + 1e-5).all()
    assert (bounds.center[0] - extent)[2] <= -0.25 and (bounds.center[0] + extent)[2] >= 0.125


@by_bound
def test_each_patch_uses_its_own_map(bound):
    maps = [NaiveMap(np.full((1, 1), t, np.float32), "wrap", 1.0, 0.0) for t in (0.5, 64.0, 2.0)]
    patches = make_one(np.repeat(flat_square()[None], 4, 0), map_id=[2, 0, -1, 0])
    bounds = bound(make_input(patches, pack(maps), IDENTITY, VIEWPORT))
    depth = abs(bounds.axes[:, :, 2]).sum(axis=1) + abs(bounds.center[:, 2])
    np.testing.assert_allclose(depth, [2, 0.5, 0, 0.5], atol=1e-4)


# Patches without bound


@by_bound
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_patches_disturb_no_other(bound, bad):
    """They are the hull stage's to flag, and it flags each; what their bound says is never asked."""
    rng = np.random.default_rng(5)
    cp = np.stack([smooth_patch(rng) for _ in range(128)])
    for k in range(64):
        cp[2 * k, k // 16, k // 4 % 4, k % 4] = bad
    patches = make_one(cp)
    matrix = look([0, 0, 60], [0, 0, 0], 0.1, 1e4)
    flags = flag_nonfinite(patches, np.zeros((0, 2)))
    assert flags.tolist() == [CullFlag.NONFINITE, CullFlag.ALIVE] * 64
    bounds = bound(make_input(patches, pack([]), matrix, VIEWPORT))
    alone = bound(make_input(make_one(cp[1::2]), pack([]), matrix, VIEWPORT))
    for all_of_them, good in zip(bounds, alone, strict=True):
        np.testing.assert_array_equal(all_of_them[1::2], good)
    run_cull_tests(list(CULL_TESTS), make_input(patches, pack([]), matrix, VIEWPORT), bounds, flags)
    assert (flags[::2] == CullFlag.NONFINITE).all()


@by_bound
def test_broken_maps_and_weights_give_no_bound(bound):
    rng = np.random.default_rng(6)
    rational = np.stack([rational_patch(rng) for _ in range(3)])
    rational[0, 1, 2, 3], rational[1, 0, 0, 3], rational[2, 3, 3, 3] = 0, -1, -1e-30
    broken = NaiveMap(np.array([[0, np.nan]], np.float32), "wrap", 1.0, 0.0)
    cp = np.concatenate([rational, smooth_patch(rng)[None]])
    bounds = bound(
        make_input(make_one(cp, map_id=[-1, -1, -1, 0]), pack([broken]), look([0, 0, 60], [0, 0, 0]), VIEWPORT)
    )
    assert_no_bound(bounds)
    assert (bounds.rect == [0, 0, 64, 48]).all() and (bounds.z_min == 0).all()


@by_bound
def test_a_non_finite_matrix_culls_nothing(bound):
    rng = np.random.default_rng(7)
    patches = make_one([smooth_patch(rng) for _ in range(8)])
    for bad in (np.nan, np.inf, -np.inf):
        for entry in range(16):
            matrix = look([0, 0, 60], [0, 0, 0], 0.1, 1e4)
            assert_no_bound(bound(make_input(patches, pack([]), matrix, VIEWPORT)), sure=False)
            matrix.flat[entry] = bad
            bounds = bound(make_input(patches, pack([]), matrix, VIEWPORT))
            assert_no_bound(bounds)


def assert_no_bound(bounds, sure=True):
    """Nothing is culled, and nothing said to be inside (unless not `sure`)."""
    assert not (sure and bounds.inside.any())
    assert (cull_one("frustum", bounds) == CullFlag.ALIVE).all()


@by_bound
def test_a_box_through_the_eye_gives_the_whole_viewport(bound):
    patches = make_one(quad([[-1, -1, -1], [1, -1, -1], [-1, 1, 1], [1, 1, 1]]))
    matrix = look([0, 0, 0], [0, 0, -1], near=1e-4)
    bounds = bound(make_input(patches, pack([]), matrix, VIEWPORT))
    assert bounds.rect[0].tolist() == [0, 0, 64, 48] and bounds.z_min[0] <= 1e-4 and bounds.inside[0] == 0


@by_bound
def test_a_box_behind_the_eye_touches_no_pixel(bound):
    patches = make_one(quad([[-1, -1, 1], [1, -1, 1], [-1, 1, 3], [1, 1, 3]]))
    bounds = bound(make_input(patches, pack([]), look([0, 0, 0], [0, 0, -1]), VIEWPORT))
    assert bounds.rect[0, 0] == bounds.rect[0, 2]


# Cull tests


def any_stage(n):
    """n patches without an eye, for tests that look at the bounds only."""
    return make_input(make_one(np.ones((n, 4, 4, 4))), pack([]), IDENTITY, VIEWPORT)


def cull_one(cull, bounds, stage=None):
    flags = np.zeros(len(bounds.inside), np.uint8)
    CULL_TESTS[cull](stage or any_stage(len(flags)), bounds, flags)
    return flags


@by_seed
@by_kind
@by_cull
@by_bound
def test_no_patch_with_a_covered_sample_is_culled(bound, cull, kind, seed):
    """Not even one of which a triangle gets past trivial rejection."""
    culled = drawn = 0
    for patches, maps, k, matrix, viewport, rng in views(kind, 50 + seed, 48):
        some = type(patches)(*(a[k : k + 1] for a in patches))
        stage = make_input(some, pack(maps), matrix, viewport)
        (flag,) = cull_one(cull, bound(stage), stage)
        outcomes = set_up(patches, k, int(rng.integers(1, 9)), maps, matrix, viewport).outcomes
        visible = outcomes[:, Outcome.SETUP].sum()
        drawn += visible > 0
        if flag:
            culled += 1
            assert flag == FLAG_OF[cull]
            assert visible == 0, f"seed {seed}, patch {k} is culled, but draws {visible} triangles"
    assert culled and drawn


AXES = ["left", "right", "bottom", "top", "near", "far"]


@by_cull
@by_bound
@pytest.mark.parametrize("plane", range(6), ids=AXES)
@pytest.mark.parametrize("w", [1.0, 0.37, 5.0])
def test_a_flat_patch_just_inside_lives_and_just_outside_dies(bound, cull, plane, w):
    """It lies along the plane, 32 units of rounding before or behind it."""
    shift = 32 * U
    for side in (-1, 1):  # out, in
        inside = {"left": [1, 0, 0], "bottom": [0, 1, 0], "near": [0, 0, 1]}
        inside |= {"right": [-1, 0, 0], "top": [0, -1, 0], "far": [0, 0, -1]}
        normal = np.array(inside[AXES[plane]], float)
        at = {"left": [-1, 0, 0.5], "right": [1, 0, 0.5], "bottom": [0, -1, 0.5], "top": [0, 1, 0.5]}
        at |= {"near": [0, 0, 0], "far": [0, 0, 1]}
        middle = np.array(at[AXES[plane]]) + side * shift * normal
        one, other = (a * 0.25 for a in np.eye(3)[normal == 0])
        corners = [middle + s * one + t * other for t in (-1, 1) for s in (-1, 1)]
        matrix = np.diag([w, w, w, 1]).astype(np.float32)  # clip = (w x, w y, w z, w)
        matrix[3] = [0, 0, 0, w]
        patches = make_one(quad(corners))
        clip = shade_with(patches, grid_points(8), [], matrix)
        assert ((clip @ FUNCTIONS[FRUSTUM_PLANES[plane]]) * side > 0).all(), "the case is not what it claims to be"
        stage = make_input(patches, pack([]), matrix, VIEWPORT)
        (flag,) = cull_one(cull, bound(stage), stage)
        assert (flag == CullFlag.ALIVE) == (side > 0)


def corner_bounds(corners, slack=0.0):
    """Bounds that consist of clip-space corners."""
    corners = np.asarray(corners, float)
    n = len(corners)
    return PatchBounds(
        np.zeros((n, 3)), np.zeros((n, 3, 3)), corners, np.full((n, 4), slack), np.zeros((n, 4), np.int32),
        np.zeros(n, np.float32), np.zeros(n, np.uint8), np.zeros((n, 3)), np.zeros(n),
    )  # fmt: skip


def test_a_box_that_crosses_w_0_is_not_culled_by_its_quotients():
    """(x, w) = (-2, 1) and (5, -1): both x / w are left of -1, and yet points between are on the screen."""
    corners = np.zeros((8, 4))
    corners[::2] = [-2, 0, 0, 1]
    corners[1::2] = [5, 0, 0, -1]
    assert cull_one("frustum", corner_bounds(corners[None])).tolist() == [CullFlag.ALIVE]
    middle = 0.7 * corners[0] + 0.3 * corners[1]
    assert abs(middle[0]) < middle[3]


@pytest.mark.parametrize("plane", range(6), ids=AXES)
def test_frustum_cull_needs_all_corners_outside_by_more_than_the_slack(plane):
    rng = np.random.default_rng(plane)
    function = FUNCTIONS[FRUSTUM_PLANES[plane]]
    corners = rng.normal(size=(200, 8, 4))
    corners -= ((corners @ function) + rng.uniform(0.5, 1, (200, 8)))[..., None] * function / (function @ function)
    assert (cull_one("frustum", corner_bounds(corners)) == CullFlag.FRUSTUM).all()
    assert (cull_one("frustum", corner_bounds(corners, slack=2.0)) == CullFlag.ALIVE).all()
    saved = corners.copy()
    saved[np.arange(200), rng.integers(0, 8, 200)] = [0, 0, 0.5, 1]  # one corner inside of everything
    assert (cull_one("frustum", corner_bounds(saved)) == CullFlag.ALIVE).all()


@by_cull
def test_cull_tests_leave_other_flags_alone(cull):
    corners = np.tile([5.0, 0, 0.5, 1], (len(CullFlag), 8, 1))
    flags = np.arange(len(CullFlag)).astype(np.uint8)
    bounds = corner_bounds(corners)._replace(center=corners[:, 0, :3])
    CULL_TESTS[cull](any_stage(len(flags)), bounds, flags)
    assert flags.tolist() == [FLAG_OF[cull], *range(1, len(CullFlag))]


@by_bound
def test_undisplaced_patches_without_maps_need_no_range(bound):
    bounds = bound(make_input(make_one(flat_square()), pack([]), IDENTITY, VIEWPORT))
    assert np.isfinite(bounds.corners).all()
    assert len(bound(make_input(make_one(np.zeros((0, 4, 4, 4)), UNIT_SQUARE), pack([]), IDENTITY, VIEWPORT)).rect) == 0
