"""Hierarchical refinement: parts tile their patch, hold their surface, come in order of cost, and stop when told."""

import numpy as np
import pytest

from pipeline.bounds import BOUNDS
from pipeline.bounds.refine import CRITERIA, gather_parts, refine, side_lengths, split_domains
from pipeline.culling import CULL_TESTS
from pipeline.hull import make_input
from pipeline.types import PatchBounds, Viewport
from tests.naive_domain import NaiveMap
from tests.test_bounds import DISPLACED, PLAIN, family_of, look, quad, random_camera
from tests.test_domain import IDENTITY, flat_square, make_one, pack, random_map, rational_patch, shade, smooth_patch

VIEWPORT = Viewport(0, 0, 64, 48, 0.0, 1.0)
ALL = float("-inf")  # as min_gain: keep every split
by_bound = pytest.mark.parametrize("bound", BOUNDS.values(), ids=BOUNDS.keys())
by_criterion = pytest.mark.parametrize("criterion", CRITERIA)


def honours_domain(bound):
    """Whether the bound of a quarter of a flat patch is smaller than that of the whole."""
    patches = make_one(flat_square())
    sizes = []
    for domain in ([0.0, 1.0, 0.0, 1.0], [0.0, 0.5, 0.0, 0.5]):
        bounds = bound(make_input(patches, pack([]), IDENTITY, VIEWPORT, domain=np.array([domain])))
        sizes.append(abs(bounds.axes).sum())
    return sizes[1] < 0.9 * sizes[0]


def view(rng, kind="displaced", n=6):
    """A stage of n patches of a family of `test_bounds`, seen by one camera, and its maps."""
    patches, maps, middle, size = family_of(kind, rng, n)
    matrix = random_camera(rng, middle[0], size[0] or 1.0)
    return make_input(patches, pack(maps), matrix, VIEWPORT), maps


def smooth_view(rng, n=4, displacement=None):
    """A stage of n bumpy patches of similar size in front of a camera that sees most of them."""
    cp = np.stack([smooth_patch(rng) for _ in range(n)]).astype(np.float64)
    points = cp[..., :3].reshape(n, 16, 3)
    points = (points - points.mean(axis=1, keepdims=True)) / np.ptp(points, axis=1).max(axis=1)[:, None, None]
    cp[..., :3] = points.reshape(n, 4, 4, 3) + rng.uniform(-1, 1, (n, 1, 1, 3))
    maps = [] if displacement is None else [displacement]
    patches = make_one(cp, map_id=-1 if displacement is None else 0)
    return make_input(patches, pack(maps), look([0, -2, 0.5], [0, 0, 0], near=1.0), VIEWPORT), maps


def assert_tiles(refined, patch):
    """The leaves of the patch cover the unit square exactly once, in exact arithmetic."""
    leaves = refined.domain[refined.patch == patch]
    cells = (leaves * 2.0**26).astype(np.int64)  # halves of halves: exact
    assert (cells == leaves * 2.0**26).all()
    width, height = cells[:, 1] - cells[:, 0], cells[:, 3] - cells[:, 2]
    assert (width > 0).all() and (height > 0).all()
    assert (width * height).sum() == 2**52  # with no overlap this leaves no gap
    for a in range(len(cells)):
        for b in range(a):
            apart = (
                cells[a, 1] <= cells[b, 0] or cells[b, 1] <= cells[a, 0]
                or cells[a, 3] <= cells[b, 2] or cells[b, 3] <= cells[a, 2]
            )  # fmt: skip
            assert apart, f"{leaves[a]} and {leaves[b]} overlap"


@by_criterion
@by_bound
def test_domains_tile_each_patch(bound, criterion):
    stage, _ = smooth_view(np.random.default_rng(1))
    refined = refine(stage, bound, criterion, max_boxes=60, min_gain=ALL)
    assert len(refined.patch) > 4
    for patch in range(4):
        assert_tiles(refined, patch)
    assert all(len(a) == len(refined.patch) for a in (*refined.bounds, refined.domain, refined.culled, refined.cost))
    order = list(zip(refined.patch.tolist(), refined.domain[:, 0].tolist(), refined.domain[:, 2].tolist(), strict=True))
    assert order == sorted(order)


@pytest.mark.parametrize("kind", PLAIN + list(DISPLACED))
@by_bound
def test_every_point_lies_in_its_own_leafs_box(bound, kind):
    rng = np.random.default_rng([5, *kind.encode()])
    stage, maps = view(rng, kind)
    refined = refine(stage, bound, "volume", max_boxes=48, min_gain=ALL)
    for k, (patch, (u0, u1, v0, v1)) in enumerate(zip(refined.patch, refined.domain, strict=True)):
        u, v = (np.rint(rng.uniform(a, b, 40) * 65536) / 65536 for a, b in ((u0, u1), (v0, v1)))
        u[:6], v[:6] = [u0, u0, u1, u1, u0, u1], [v0, v1, v0, v1, v[4], v[5]]
        some = type(stage.patches)(*(a[patch : patch + 1] for a in stage.patches))
        (clip,), _ = shade(some, [np.stack([u, v], 1).astype(np.float32)], maps, IDENTITY)
        points, center = clip[:, :3].astype(np.float64), refined.bounds.center[k]
        for axis in refined.bounds.axes[k]:
            reach = axis @ axis * (1 + 2.0**-50) + 2.0**-50 * abs(center) @ abs(axis)
            assert (abs((points - center) @ axis) <= reach).all(), f"{kind}, patch {patch}, {refined.domain[k]}"


@pytest.mark.parametrize("make", [smooth_patch, rational_patch])
@by_bound
def test_summed_volume_falls_without_displacement(bound, make):
    assert honours_domain(bound)
    patches = make_one([make(np.random.default_rng(k)) for k in range(4)])
    stage = make_input(patches, pack([]), IDENTITY, VIEWPORT)
    volumes = []
    for boxes in (4, 16, 64, 256):
        sizes = []
        for p in range(4):
            one = stage._replace(
                patches=type(patches)(*(a[p : p + 1] for a in patches)),
                domain=stage.domain[p : p + 1],
                factors=type(stage.factors)(*(a[p : p + 1] for a in stage.factors)),
            )
            refined = refine(one, bound, "volume", max_boxes=boxes // 4, min_gain=ALL, min_size=2.0**-10)
            half = np.sqrt((refined.bounds.axes**2).sum(axis=2))
            sizes.append(8 * half.prod(axis=1).sum())
        volumes.append(sizes)
    volumes = np.array(volumes)
    # A camera that shows nothing would cull: the identity's clip volume keeps some of the patches at least.
    assert (volumes[1:] <= volumes[:-1] * (1 + 1e-12)).all()
    assert volumes[-1].sum() < 0.6 * volumes[0].sum()


# Order


def made_up(rows):
    """Bounds of boxes with these half extents, rectangles, depths and clip corners."""
    n = len(rows["half"])
    axes = np.zeros((n, 3, 3))
    axes[:, [0, 1, 2], [0, 1, 2]] = rows["half"]
    return PatchBounds(
        center=np.zeros((n, 3)),
        axes=axes,
        corners=np.array(rows["corners"], float),
        slack=np.zeros((n, 4)),
        rect=np.array(rows["rect"], np.int32),
        z_min=np.array(rows["z"], np.float32),
        inside=np.zeros(n, np.uint8),
        cone_axis=np.zeros((n, 3)),
        cone_cos=-np.ones(n),
    )


def test_criteria_measure_what_they_say():
    cube = np.array([[x, y, z] for z in (0.25, 0.75) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    inside = np.concatenate([cube, np.ones((8, 1))], 1)
    right = np.concatenate([cube + [1, 0, 0], np.ones((8, 1))], 1)
    corner = np.concatenate([cube + [1, 1, -0.5], np.ones((8, 1))], 1)
    bounds = made_up(
        {
            "half": [[1, 2, 3], [0, 2, 3], [1, 1, 1]],
            "rect": [[0, 0, 4, 3], [5, 5, 5, 5], [10, 10, 11, 30]],
            "z": [0.25, 0.5, 0.0],
            "corners": [inside, right, corner],
        }
    )
    expected = {
        "screen": [12, 0, 20],
        "depth": [0.75, 0, 1],
        "straddle": [0, 1, 3],
        "area": [8 * 11, 8 * 6, 24],
        "volume": [48, 0, 8],
    }
    assert set(expected) == set(CRITERIA)
    for name, values in expected.items():
        np.testing.assert_allclose(CRITERIA[name](bounds), values, err_msg=name)


class Recorder:
    """A bound that counts its calls and keeps what each was asked and answered."""

    def __init__(self, bound):
        self.bound, self.calls = bound, []

    def __call__(self, stage):
        bounds = self.bound(stage)
        self.calls.append((stage, bounds))
        return bounds


@by_criterion
def test_the_most_expensive_box_is_split_first(criterion):
    """Strictly best first: the parents of each round are those that a plain search over all leaves finds."""
    rng = np.random.default_rng(3)
    stage, _ = smooth_view(rng, 6)
    bound = Recorder(finest())
    refined = refine(stage, bound, criterion, max_boxes=40, min_gain=ALL, min_size=2.0**-30, per_round=1)
    leaves = {}
    for number, (part, bounds) in enumerate(bound.calls):
        cost = CRITERIA[criterion](bounds)
        flags = np.zeros(len(cost), np.uint8)
        CULL_TESTS["frustum"](part, bounds, flags)
        if number:
            u0, u1, v0, v1 = part.domain.T
            parent = (float(u0.min()), float(u1.max()), float(v0.min()), float(v1.max()))
            same = [key for key in leaves if key[1] == parent]
            best = min((-value, key[0], key[1]) for key, value in leaves.items())
            assert (best[0], best[2]) in [(-leaves[key], key[1]) for key in same]
            del leaves[best[1], best[2]]
        patch = np.arange(6) if number == 0 else [best[1]] * 2
        for p, domain, c, flag in zip(patch, part.domain.tolist(), cost, flags, strict=True):
            leaves[int(p), tuple(domain)] = 0.0 if flag else float(c)
    assert len(bound.calls) > 5
    assert {(int(p), tuple(d)) for p, d in zip(refined.patch, refined.domain.tolist(), strict=True)} == set(leaves)


def finest():
    """A quick bound that honours its domain."""
    return BOUNDS["cbox"]


def test_the_longer_side_is_cut():
    domain = np.array([[0, 1, 0, 1], [0, 0.25, 0, 1], [0, 1, 0.5, 0.75], [0, 1, 0, 1]])
    lengths = np.array([[2.0, 1.0], [2.0, 1.0], [1.0, 9.0], [1.0, 1.0]])
    halves = split_domains(domain, lengths, 1 / 64)
    assert halves[0].tolist() == [[0, 0.5, 0, 1], [0.5, 1, 0, 1]]
    assert halves[1].tolist() == [[0, 0.25, 0, 0.5], [0, 0.25, 0.5, 1]]
    assert halves[2].tolist() == [[0, 1, 0.5, 0.625], [0, 1, 0.625, 0.75]]
    assert halves[3].tolist() == [[0, 0.5, 0, 1], [0.5, 1, 0, 1]]
    # A side that is short enough is left alone however long it is in the world.
    halves = split_domains(np.array([[0, 0.25, 0, 1.0]]), np.array([[100.0, 1.0]]), 0.25)
    assert halves[0].tolist() == [[0, 0.25, 0, 0.5], [0, 0.25, 0.5, 1]]


def test_side_lengths_are_those_of_the_control_polygon():
    patches = make_one(quad([[0, 0, 0], [3, 0, 0], [0, 5, 0], [3, 5, 0]]))
    np.testing.assert_allclose(side_lengths(patches), [[3, 5]])
    broken = patches.control_points.copy()
    broken[0, 1, 1, 0] = np.nan
    assert side_lengths(patches._replace(control_points=broken))[0].tolist() == [1, 1]


# Stop rules


@pytest.mark.parametrize("boxes", [1, 4, 5, 17, 100])
def test_stops_at_the_count(boxes):
    stage, _ = smooth_view(np.random.default_rng(8))
    refined = refine(stage, finest(), "volume", max_boxes=boxes, min_gain=ALL)
    assert len(refined.patch) == max(boxes, 4)


@pytest.mark.parametrize("size", [1.0, 0.5, 0.2])
def test_stops_at_the_size(size):
    stage, _ = smooth_view(np.random.default_rng(9))
    refined = refine(stage, finest(), "volume", max_boxes=10**6, min_size=size, min_gain=ALL)
    sides = refined.domain[:, 1::2] - refined.domain[:, ::2]
    alive = refined.culled == 0
    assert (sides[alive] <= size).all() and (sides >= size / 2).all()


def test_stops_where_nothing_is_gained():
    """A flat patch: halves of a flat box have together the area of the whole."""
    stage = make_input(make_one(flat_square()), pack([]), look([1.5, 1.5, 9], [1.5, 1.5, 0]), VIEWPORT)
    assert len(refine(stage, finest(), "area", max_boxes=64, min_gain=0.1).patch) == 1
    assert len(refine(stage, finest(), "area", max_boxes=64, min_gain=ALL).patch) == 64
    smooth, _ = smooth_view(np.random.default_rng(10))
    counts = [len(refine(smooth, finest(), "volume", max_boxes=512, min_gain=gain).patch) for gain in (0.9, 0.3, 0.1)]
    assert counts[0] < counts[1] < counts[2]


def test_stops_at_the_cost():
    stage, _ = smooth_view(np.random.default_rng(11))
    refined = refine(stage, finest(), "screen", max_boxes=10**5, min_cost=200.0, min_gain=ALL, min_size=2.0**-12)
    assert len(refined.patch) > 4 and (refined.cost <= 200).all()


# Culls


def test_culled_parts_stay_culled_and_whole():
    """A plane of the frustum runs through the patch: what is outside is never looked at again, what straddles is split."""
    patches = make_one(quad([[-4, 0, -4], [4, 0, -4], [-4, 0, 4], [4, 0, 4]]))
    stage = make_input(patches, pack([]), look([3, -4, 0.2], [3, 0, 0.1]), VIEWPORT)
    bound = Recorder(finest())
    refined = refine(stage, bound, "straddle", max_boxes=200, min_gain=ALL, min_size=1 / 256)
    assert 5 < refined.culled.sum() < len(refined.culled)
    assert_tiles(refined, 0)
    assert (refined.cost[refined.culled == 1] == 0).all()
    dropped = []
    for part, bounds in bound.calls:
        for u0, u1, v0, v1 in part.domain:
            for a0, a1, b0, b1 in dropped:
                assert u1 <= a0 or u0 >= a1 or v1 <= b0 or v0 >= b1, "a part of a culled part was bounded"
        flags = np.zeros(len(part.domain), np.uint8)
        CULL_TESTS["frustum"](part, bounds, flags)
        dropped += part.domain[flags != 0].tolist()
    # Every box that still straddles is as small as may be: the queue ran dry.
    sides = (refined.domain[:, 1::2] - refined.domain[:, ::2]).max(axis=1)
    assert len(refined.patch) == 200 or (sides[refined.cost > 0] <= 1 / 256).all()


# No displacement


def test_parts_without_displacement_have_no_map():
    texels = np.zeros((16, 16), np.float32)
    texels[12, 3] = 1.0  # t = 0.78, s = 0.22
    image = NaiveMap(texels, "clamp", 1.0, 0.0)
    patches = make_one(np.repeat(flat_square()[None], 6, 0), map_id=0)
    domain = np.array(
        [
            [0, 1, 0, 1],
            [0, 0.5, 0, 0.5],
            [0.5, 1, 0.5, 1],
            [0, 0.5, 0.5, 1],
            [0.29, 0.5, 0.5, 1],
            [0.24, 0.3, 0.75, 0.8],
        ]
    )
    everything = np.arange(6, dtype=np.int32)
    stage = make_input(patches, pack([image]), IDENTITY, VIEWPORT)
    assert gather_parts(stage, everything, domain).patches.map_id.tolist() == [0, -1, -1, 0, -1, 0]
    biased = make_input(patches, pack([image._replace(bias=0.5)]), IDENTITY, VIEWPORT)
    assert (gather_parts(biased, everything, domain).patches.map_id == 0).all()


@by_bound
def test_the_shortcut_changes_no_safety_and_tightens(bound):
    texels = np.zeros((32, 32), np.float32)
    texels[5, 5], texels[20, 9] = 2.0, -3.0
    stage, _ = smooth_view(np.random.default_rng(12), 3, NaiveMap(texels, "wrap", 0.1, 0.0))
    refined = refine(stage, bound, "volume", max_boxes=150, min_gain=ALL)
    parts = gather_parts(stage, refined.patch, refined.domain)
    assert 0 < (parts.patches.map_id < 0).sum() < len(refined.patch)
    mapped = parts._replace(patches=parts.patches._replace(map_id=np.zeros(len(refined.patch), np.int32)))
    half = [np.sqrt((bound(s).axes ** 2).sum(axis=2)).prod(axis=1) for s in (parts, mapped)]
    assert (half[0] <= half[1] * (1 + 1e-9)).all()


# The same, and bad input


@by_criterion
def test_same_input_same_boxes(criterion):
    rng = np.random.default_rng(4)
    stage, _ = smooth_view(rng, 5, random_map(rng))
    one, two = (refine(stage, BOUNDS["cbox"], criterion, max_boxes=70, min_gain=ALL) for _ in range(2))
    for a, b in zip((one.patch, one.domain, *one.bounds), (two.patch, two.domain, *two.bounds), strict=True):
        np.testing.assert_array_equal(a, b)


def test_ties_go_by_patch_and_domain():
    """Equal patches: the first is split first."""
    patches = make_one(np.repeat(flat_square()[None], 3, 0))
    stage = make_input(patches, pack([]), look([1.5, 1.5, 9], [1.5, 1.5, 0]), VIEWPORT)
    refined = refine(stage, finest(), "area", max_boxes=5, min_gain=ALL, per_round=1)
    assert np.bincount(refined.patch).tolist() == [2, 2, 1]


def test_broken_patches_are_never_split():
    cp = np.repeat(flat_square()[None], 3, 0)
    cp[1, 2, 2, 1] = np.nan
    cp[2, 0, 0, 3] = -1
    stage = make_input(make_one(cp), pack([]), look([1.5, 1.5, 9], [1.5, 1.5, 0]), VIEWPORT)
    refined = refine(stage, finest(), "volume", max_boxes=50, min_gain=ALL)
    assert (refined.patch == 1).sum() == 1 and (refined.patch == 2).sum() == 1 and not refined.culled.any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"criterion": "size"}, "criterion: 'size'"),
        ({"max_boxes": 0}, "max_boxes: 0"),
        ({"min_size": 0.0}, "min_size: 0.0"),
        ({"min_size": float("nan")}, "min_size: nan"),
        ({"min_gain": 1.0}, "min_gain: 1.0"),
        ({"min_gain": float("nan")}, "min_gain: nan"),
        ({"per_round": 0}, "per_round: 0"),
    ],
)
def test_bad_numbers_are_named(change, said):
    stage, _ = smooth_view(np.random.default_rng(0))
    arguments = {"criterion": "volume", "max_boxes": 9} | change
    with pytest.raises(ValueError, match=said):
        refine(stage, BOUNDS["cbox"], arguments.pop("criterion"), **arguments)


def test_no_patches():
    stage = make_input(make_one(np.zeros((0, 4, 4, 4))), pack([]), IDENTITY, VIEWPORT)
    refined = refine(stage, BOUNDS["cbox"], "volume", max_boxes=9)
    assert len(refined.patch) == 0 and refined.domain.shape == (0, 4)
