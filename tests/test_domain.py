"""Domain shader: bit for bit its slow twin, close to the truth, the same on both sides of an edge, and never NaN."""

from itertools import pairwise

import numpy as np
import pytest

from pipeline import domain
from pipeline.displacement import map_ranges, pack_maps
from pipeline.types import Address, DomainPoints, Patches, Patterns
from pipeline.vertex import make_patches
from tests.naive_domain import NaiveMap, exact_displacement, exact_surface, naive_shade

U = 2.0**-24
IDENTITY = np.eye(4, dtype=np.float32)
UNIT_SQUARE = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)
SEEDS = range(3)
by_seed = pytest.mark.parametrize("seed", SEEDS, ids=lambda s: f"seed{s}")


# Production, called alone


def make_one(cp, texcoords=UNIT_SQUARE, map_id=-1) -> Patches:
    """One patch or several; cp float32[..., 4, 4, 4]."""
    cp = np.ascontiguousarray(cp, np.float32).reshape(-1, 4, 4, 4)
    n = len(cp)
    texcoords = np.ascontiguousarray(np.broadcast_to(texcoords, (n, 4, 2)), np.float32)
    map_id = np.array(np.broadcast_to(map_id, n), np.int32)
    return make_patches(cp, texcoords, map_id, np.zeros(n, np.int32))


def pack(maps):
    return pack_maps([(m.texels, Address[m.address.upper()], m.scale, m.bias) for m in maps])


def shade(patches, uv, maps=(), matrix=IDENTITY):
    """Clip positions and normals of patch k at uv[k] (float32[n, 2]): lists of float32[n, 4] and float32[n, 3]."""
    n = len(patches.control_points)
    first = np.concatenate([[0], np.cumsum([len(points) for points in uv])]).astype(np.int64)
    flat = np.ascontiguousarray(np.concatenate(uv).T, np.float32)
    patterns = Patterns(np.arange(n, dtype=np.int32), flat, first, np.zeros(0, np.uint16), np.zeros(n + 1, np.int64))
    points = DomainPoints(first, np.full((4, first[-1]), 77, np.float32), np.full((3, first[-1]), 77, np.float32))
    live = np.arange(n, dtype=np.int32)
    scratch = np.full(domain.SCRATCH, np.nan, np.float32)
    domain.shade_patches(0, n, live, patches, patterns, pack(maps), np.asarray(matrix, np.float32), points, scratch)
    parts = list(pairwise(first))
    return [points.clip[:, a:b].T for a, b in parts], [points.normal[:, a:b].T for a, b in parts]


# Patches to try it on


def smooth_patch(rng, bumps=0.3):
    """A bumpy sheet somewhere in space, of some size, polynomial."""
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    sheet = np.stack([i, j, np.zeros((4, 4))], -1) / 3 + rng.normal(0, bumps, (4, 4, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    sheet = sheet @ turn * 10 ** rng.uniform(-2, 2) + rng.normal(0, 1, 3)
    return np.concatenate([sheet, np.ones((4, 4, 1))], -1).astype(np.float32)


def rational_patch(rng, bumps=0.3, spread=4.0):
    cp = smooth_patch(rng, bumps)
    weights = rng.uniform(1 / spread, spread, (4, 4, 1)).astype(np.float32)
    return np.concatenate([cp[..., :3] * weights, weights], -1)


def dome(radius=1.0, height=1.0):
    """A quarter of a dome, as the teapot's lid has: the edge v = 1 is one point, (0, 0, height), where it is flat."""
    k = 0.5522847
    circle = np.array([[1, 0], [1, k], [k, 1], [0, 1]])
    profile = np.array([[1, 0], [1, k], [k, 1], [0, 1]]) * [radius, height]
    cp = np.ones((4, 4, 4))
    for i in range(4):
        for j in range(4):
            cp[i, j, :3] = *(circle[i] * profile[j, 0]), profile[j, 1]
    return cp.astype(np.float32)


def flat_square():
    """(3u, 3v, 0), exactly; its normal is (0, 0, 1), exactly: a displacement comes out as z."""
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    return np.stack([i, j, 0 * i, 0 * i + 1], -1).astype(np.float32)


def random_map(rng, address=None, most=9):
    height, width = rng.integers(1, most, 2)
    texels = rng.normal(0, 1, (height, width)).astype(np.float32)
    address = address or str(rng.choice(["wrap", "mirror", "clamp"]))
    return NaiveMap(texels, address, float(rng.normal(0, 0.3)), float(rng.normal(0, 0.3)))


def random_points(rng, n):
    """Domain points as the tessellator makes them: multiples of 2^-16, many on edges and in corners."""
    uv = rng.integers(0, 65537, (n, 2)) / 65536.0
    ends = rng.random((n, 2)) < 0.25
    return np.where(ends, rng.integers(0, 2, (n, 2)), uv).astype(np.float32)


def random_matrix(rng):
    return (rng.normal(0, 1, (4, 4)) * 10 ** rng.uniform(-1, 1, (4, 1))).astype(np.float32)


def bits(a):
    return np.ascontiguousarray(a, np.float32).view(np.uint32)


def assert_equals_twin(patches, uv, maps, matrix, context):
    clips, normals = shade(patches, uv, maps, matrix)
    for k, (clip, normal) in enumerate(zip(clips, normals, strict=True)):
        image = maps[patches.map_id[k]] if patches.map_id[k] >= 0 else None
        for i, (u, v) in enumerate(uv[k]):
            expected = naive_shade(patches.control_points[k], patches.texcoords[k], image, matrix, u, v)
            for ours, theirs in zip((clip[i], normal[i]), expected, strict=True):
                same = (bits(ours) == bits(theirs)) | (np.isnan(ours) & np.isnan(theirs))
                assert same.all(), f"{context}, patch {k} at ({u}, {v}): {ours}, expected {theirs}"


# The slow twin, bit for bit


@by_seed
@pytest.mark.parametrize("kind", ["polynomial", "rational"])
def test_equals_twin(kind, seed):
    rng = np.random.default_rng(seed)
    patches = make_one([{"polynomial": smooth_patch, "rational": rational_patch}[kind](rng) for _ in range(12)])
    uv = [random_points(rng, 20) for _ in range(12)]
    assert_equals_twin(patches, uv, [], random_matrix(rng), f"seed {seed}")


@by_seed
@pytest.mark.parametrize("address", ["wrap", "mirror", "clamp"])
def test_displaced_equals_twin(address, seed):
    rng = np.random.default_rng(100 + seed)
    maps = [random_map(rng, address) for _ in range(8)]
    cp = [(smooth_patch, rational_patch)[k % 2](rng) for k in range(8)]
    patches = make_one(cp, rng.uniform(-3, 4, (8, 4, 2)), np.arange(8))
    uv = [random_points(rng, 20) for _ in range(8)]
    assert_equals_twin(patches, uv, maps, random_matrix(rng), f"seed {seed}")


def test_strange_patches_equal_twin():
    """Collapsed, folded, tiny, huge, and non-finite ones, with and without a map."""
    rng = np.random.default_rng(7)
    point, line, folded = np.ones((4, 4, 4)), flat_square(), smooth_patch(rng)
    line[..., 1] = 0
    folded[3] = folded[0]
    cp = [dome(), dome(1e-3), point, line, folded]
    for scale in (1e-25, 1e-12, 1e15, 1e30):
        cp.append(smooth_patch(rng) * [scale, scale, scale, 1])
    for bad in (np.nan, np.inf, -np.inf):
        cp.append(smooth_patch(rng))
        cp[-1][1, 2, 0] = bad
    negative = rational_patch(rng)
    negative[0, 0, 3] = -1
    cp.append(negative)
    n = len(cp)
    maps = [random_map(rng), NaiveMap(np.full((2, 2), np.inf, np.float32), "wrap", 1.0, 0.0)]
    with np.errstate(over="ignore"):
        patches = make_one(cp * 3, rng.uniform(-1, 2, (3 * n, 4, 2)), np.repeat([-1, 0, 1], n))
    patches.texcoords[-1, 0, 0] = 1e30
    patches.texcoords[-2, 0, 0] = np.nan
    assert_equals_twin(patches, [random_points(rng, 12) for _ in range(3 * n)], maps, random_matrix(rng), "seed 7")


def test_long_patterns_equal_the_same_points_shaded_separately():
    rng = np.random.default_rng(11)
    image = random_map(rng)
    count = 2 * domain.BLOCK + 7
    for cp, map_id in ((smooth_patch(rng), -1), (rational_patch(rng), 0), (dome(), 0)):
        uv = random_points(rng, count)
        (clip,), (normal,) = shade(make_one(cp, map_id=map_id), [uv], [image])
        alone = make_one(np.repeat(cp[None], count, 0), map_id=map_id)
        clips, normals = shade(alone, list(uv[:, None]), [image])
        np.testing.assert_array_equal(bits(clip), bits(np.concatenate(clips)))
        np.testing.assert_array_equal(bits(normal), bits(np.concatenate(normals)))


def test_shades_the_listed_patches_only():
    """Patches begin .. end-1 of the live list, each with the pattern it names, into its own places."""
    rng = np.random.default_rng(13)
    patches = make_one([smooth_patch(rng) for _ in range(5)])
    uv = [random_points(rng, n) for n in (9, 4)]
    first = np.array([0, 9, 13], np.int64)
    of_patch = np.array([1, -1, 0, 1, -1], np.int32)
    flat = np.ascontiguousarray(np.concatenate(uv).T)
    patterns = Patterns(of_patch, flat, first, np.zeros(0, np.uint16), np.zeros(3, np.int64))
    live = np.array([0, 2, 3], np.int32)
    points = DomainPoints(
        np.array([0, 4, 13, 17], np.int64), np.full((4, 17), 77, np.float32), np.full((3, 17), 77, np.float32)
    )
    domain.shade_patches(
        1, 2, live, patches, patterns, pack([]), IDENTITY, points, np.empty(domain.SCRATCH, np.float32)
    )
    (expected,), (normal,) = shade(make_one(patches.control_points[2]), uv[:1])
    np.testing.assert_array_equal(points.clip[:, 4:13].T, expected)
    np.testing.assert_array_equal(points.normal[:, 4:13].T, normal)
    for rest in (np.s_[:, :4], np.s_[:, 13:]):
        assert (points.clip[rest] == 77).all() and (points.normal[rest] == 77).all()


# The truth. With u = 2^-24 and cp the control points:
#
# position: 12 u max|c| (3 roundings of a basis value, 1 of a product, 2 of a sum, twice), 25 u max|X/w| where rational;
# tangent (a third of it): as above in the differences d, 12 u max|d| + u max|d|; rational: two products of two such sums,
# a difference, and a division by w^2, each relative to max w max|dX| + max|dw| max|X|;
# cross product: 2 e |A| |B| + 3 u |A| |B| for tangents of relative error e (relative to the largest |A|, |B| possible);
# unit vector: twice the relative error of the vector (the length is off as well), and 4 u.


def surface_error(cp, rational, weight):
    """Bounds where the weight is `weight`: error of the position, and of a third of a tangent; longest of those thirds."""
    x, w = cp[..., :3].astype(np.float64), cp[..., 3:].astype(np.float64)
    longest = max(np.linalg.norm(np.diff(x, axis=axis), axis=-1).max() for axis in (0, 1))
    if not rational:
        return 12 * U * abs(x).max(), 13 * U * longest * np.sqrt(3), longest
    weight_step = max(abs(np.diff(w, axis=axis)).max() for axis in (0, 1))
    longest = (w.max() * longest + weight_step * np.linalg.norm(x, axis=-1).max()) / weight**2
    return 25 * U * abs(x / w).max(), (13 + 13 + 2 + 27) * U * longest * np.sqrt(3), longest


def sheet(kind, rng):
    return smooth_patch(rng, 0.1) if kind == "polynomial" else rational_patch(rng, 0.1, 1.25)


def assert_close(ours, exact, error, context):
    assert (abs(ours - exact) <= error).all(), f"{context}: {ours}, exactly {exact}, allowed {error}"


@by_seed
@pytest.mark.parametrize("kind", ["polynomial", "rational"])
def test_position_and_normal_are_right(kind, seed):
    rng = np.random.default_rng(200 + seed)
    checked = 0
    for _ in range(20):
        cp, uv = sheet(kind, rng), random_points(rng, 20)
        (clip,), (normal,) = shade(make_one(cp), [uv])
        for (u, v), p, n in zip(uv.astype(np.float64), clip, normal, strict=True):
            exact, a, b, weight = exact_surface(cp, u, v)
            position_error, tangent_error, longest = surface_error(cp, kind == "rational", weight)
            assert_close(
                p[:3], exact, position_error + 3 * U * abs(exact).sum(), f"seed {seed}, position at ({u}, {v})"
            )
            assert p[3] == 1
            c = np.cross(a, b)
            error = (2 * tangent_error * longest + 3 * U * longest**2) / np.linalg.norm(c)
            if error < 1e-3:
                checked += 1
                assert_close(n, c / np.linalg.norm(c), 2 * error + 4 * U, f"seed {seed}, normal at ({u}, {v})")
    assert checked > 100


@by_seed
@pytest.mark.parametrize("kind", ["polynomial", "rational"])
def test_displacement_is_right(kind, seed):
    """Displaced position, and the normal of the displaced surface to first order in the slope (Blinn 1978)."""
    rng = np.random.default_rng(300 + seed)
    checked = 0
    for _ in range(20):
        cp, uv = sheet(kind, rng), random_points(rng, 20)
        image, texcoords = random_map(rng), rng.uniform(-1, 2, (4, 2)).astype(np.float32)
        (clip,), (normal,) = shade(make_one(cp, texcoords, 0), [uv], [image])
        size, largest = max(image.texels.shape), float(abs(image.texels).max())
        reach = abs(texcoords).max() * size + 1  # a texel coordinate has at most 6 roundings of this size
        scale, bias = abs(image.scale), abs(image.bias)
        value_error = scale * largest * (2 * 2 * 6 * U * reach + 10 * U) + 2 * U * bias
        slope = 2 * scale * largest * size * 2 * np.ptp(texcoords, axis=0).max()
        slope_error = slope * (2 * 6 * U * reach + 12 * U)
        for (u, v), p, n in zip(uv.astype(np.float64), clip, normal, strict=True):
            exact, a, b, weight = exact_surface(cp, u, v)
            position_error, tangent_error, longest = surface_error(cp, kind == "rational", weight)
            t, along_u, along_v, border = exact_displacement(image, texcoords, u, v)
            c = np.cross(a, b)
            length = np.linalg.norm(c)
            unit, unit_error = c / length, 2 * (2 * tangent_error * longest + 3 * U * longest**2) / length + 4 * U
            displaced = exact + t * unit
            error = position_error + value_error + abs(t) * unit_error + 3 * U * (abs(exact).max() + abs(t))
            assert_close(p[:3], displaced, error + 4 * U * abs(displaced).sum(), f"seed {seed}, ({u}, {v})")
            if border < 12 * U * reach:  # which texels it reads is open, and with them the slope
                continue
            m = 3 * c + along_v * np.cross(a, unit) + along_u * np.cross(unit, b)
            error = 3 * (2 * tangent_error * longest + 3 * U * longest**2)
            error += 2 * (slope_error * longest + slope * (tangent_error + longest * (unit_error + 3 * U)))
            error = (error + 5 * U * (3 * longest**2 + 2 * slope * longest)) / np.linalg.norm(m)
            if error < 1e-2:
                checked += 1
                assert_close(n, m / np.linalg.norm(m), 2 * error + 4 * U, f"seed {seed}, normal at ({u}, {v})")
    assert checked > 100


def test_displaced_normal_turns_against_the_slope():
    """On a plane, z = 0.5 x gives (-1, 0, 2) / sqrt(5)."""
    ramp = NaiveMap(np.arange(8, dtype=np.float32)[None], "clamp", 0.5 * 3 / 8, 0.0)
    uv = np.array([[0.5, 0.25], [0.375, 0.75]], np.float32)
    (clip,), (normal,) = shade(make_one(flat_square(), map_id=0), [uv], [ramp])
    np.testing.assert_allclose(clip[:, 2], 0.5 * (3 * uv[:, 0] - 3 / 16), atol=1e-6)
    np.testing.assert_allclose(normal, np.array([[-1, 0, 2]] * 2) / np.sqrt(5), atol=1e-6)


# Edges that patches share


def corner_order(orientation):
    """Where the corners (0,0) (1,0) (0,1) (1,1) of the reoriented patch lie in the original one."""
    grid = np.array([[0, 2], [1, 3]])  # [u, v]
    return reorient(grid, orientation).T.ravel()


def reorient(a, orientation):
    """Array over (u, v) in one of the eight orientations; bits: reverse u, reverse v, then swap u and v."""
    a = a[::-1] if orientation & 1 else a
    a = a[:, ::-1] if orientation & 2 else a
    return np.swapaxes(a, 0, 1) if orientation & 4 else a


def turns_over(orientation):
    return bin(orientation).count("1") % 2 == 1


def edge_points(orientation, t):
    """Domain points of the reoriented patch that lie where u = 0 and v = t in the original one."""
    u, v = np.zeros_like(t), t
    u = 1 - u if orientation & 1 else u
    v = 1 - v if orientation & 2 else v
    return np.stack([v, u] if orientation & 4 else [u, v], -1).astype(np.float32)


def shared_edge(rng, rational):
    """Two patches; u = 1 of the first is u = 0 of the second, where they have the same differences across the edge."""
    grid = rng.integers(-4096, 4096, (2, 4, 4, 4)) / 512.0  # sums and differences of these are exact
    grid[..., 3] = rng.integers(256, 1024, (2, 4, 4)) / 512.0 if rational else 1
    a, b = grid
    b[0] = a[3]
    b[1] = b[0] + (a[3] - a[2])
    if rational:
        b[1, :, 3] = np.maximum(b[1, :, 3], 1 / 64)
        a[2] = a[3] - (b[1] - b[0])
    return a.astype(np.float32), b.astype(np.float32)


@by_seed
@pytest.mark.parametrize("rational", [False, True], ids=["polynomial", "rational"])
@pytest.mark.parametrize("orientation", range(8))
def test_shared_edges_have_the_same_points(orientation, rational, seed):
    """Only the edge's own control points are the same."""
    rng = np.random.default_rng(400 + seed)
    make = rational_patch if rational else smooth_patch
    t = np.append(rng.integers(0, 65537, 40), [0, 65536]) / 65536.0
    for first in [make(rng) for _ in range(8)]:
        second = make(rng)
        second[0] = first[3]
        turned = reorient(second, orientation)
        uv = [np.stack([np.ones_like(t), t], -1).astype(np.float32), edge_points(orientation, t)]
        (one, other), _ = shade(make_one([first, turned]), uv, matrix=random_matrix(rng))
        np.testing.assert_array_equal(one, other, f"seed {seed}")


def assert_same_displaced_edge(orientation, rational, seed):
    rng = np.random.default_rng(500 + seed)
    t = np.append(rng.integers(0, 65537, 40), [0, 65536]) / 65536.0
    sign = -1 if turns_over(orientation) else 1  # its normal points the other way then
    for _ in range(8):
        first, second = shared_edge(rng, rational)
        image = random_map(rng)
        turned_image = image._replace(scale=sign * image.scale, bias=sign * image.bias)
        texcoords = rng.uniform(-1, 2, (2, 4, 2)).astype(np.float32)
        texcoords[1, [0, 2]] = texcoords[0, [1, 3]]
        texcoords[1] = texcoords[1, corner_order(orientation)]
        cp = [first, reorient(second, orientation)]
        uv = [np.stack([np.ones_like(t), t], -1).astype(np.float32), edge_points(orientation, t)]
        (one, other), _ = shade(make_one(cp, texcoords, [0, 1]), uv, [image, turned_image], random_matrix(rng))
        np.testing.assert_array_equal(one, other, f"seed {seed}, displaced")
        _, (normal, turned_normal) = shade(make_one(cp), uv)
        np.testing.assert_array_equal(normal, sign * turned_normal, f"seed {seed}, normal")


@by_seed
@pytest.mark.parametrize("orientation", range(8))
def test_shared_edges_have_the_same_displaced_points(orientation, seed):
    assert_same_displaced_edge(orientation, False, seed)


@pytest.mark.parametrize("orientation", [0, 3, 5], ids=["straight on", "turned half", "turned a quarter"])
def test_shared_rational_edges_have_the_same_displaced_points(orientation):
    assert_same_displaced_edge(orientation, True, 0)


@by_seed
@pytest.mark.parametrize("rational", [False, True], ids=["polynomial", "rational"])
def test_corners_are_exact(rational, seed):
    rng = np.random.default_rng(600 + seed)
    cp = np.stack([(rational_patch if rational else smooth_patch)(rng) for _ in range(50)])
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)
    clips, _ = shade(make_one(cp), [corners] * len(cp))
    for patch, clip in zip(cp, clips, strict=True):
        ends = np.stack([patch[0, 0], patch[3, 0], patch[0, 3], patch[3, 3]])
        np.testing.assert_array_equal(clip[:, :3], ends[:, :3] / ends[:, 3:])


# Patches without a normal of their own


@pytest.mark.parametrize("scale", [1e-25, 1e-10, 1, 1e10])
def test_normals_at_a_collapsed_edge(scale):
    """All around the pole one normal, up to the 2^-9 that the shader moves inwards, and up to the circle's own flaw."""
    cp = dome() * np.array([scale, scale, scale, 1])
    u = np.linspace(0, 1, 65)
    for orientation in range(8):
        uv = np.stack([u, np.ones_like(u)], -1)
        turned = reorient(cp, orientation)
        for bit in (1, 2):
            if orientation & bit:
                uv[:, bit - 1] = 1 - uv[:, bit - 1]
        uv = uv[:, ::-1] if orientation & 4 else uv
        (clip,), (normal,) = shade(make_one(turned), [uv.astype(np.float32)])
        np.testing.assert_allclose(clip[:, :3], [[0, 0, clip[0, 2]]] * 65, atol=12 * U * scale)
        up = -1 if turns_over(orientation) else 1
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(normal, np.tile([0, 0, up], (65, 1)), atol=2 * 2.0**-9)


def test_normals_beside_a_collapsed_edge():
    """They approach that of the pole: the tangents keep their relative accuracy, however short."""
    v = 1 - 2.0 ** -np.arange(4, 17)
    for u in (0, 0.3125, 1):
        uv = np.stack([np.full_like(v, u), v], -1).astype(np.float32)
        (_,), (normal,) = shade(make_one(dome()), [uv])
        tilt = np.hypot(normal[:, 0], normal[:, 1])
        assert (tilt <= 2 * (1 - v) + 8 * U).all() and (tilt >= 1 - v).all()


@pytest.mark.parametrize("map_id", [-1, 0])
def test_a_patch_without_area_has_no_normal(map_id):
    rng = np.random.default_rng(17)
    point, line = np.empty((4, 4, 4)), flat_square()
    point[:] = [0.3, -7, 2, 1]
    line[..., 1] = 2.5
    bent = line.copy()
    bent[..., 0] = rng.normal(size=(4, 4))
    uv = [random_points(rng, 50)] * 3
    clips, normals = shade(make_one([point, line, bent], map_id=map_id), uv, [random_map(rng)], random_matrix(rng))
    for clip, normal in zip(clips, normals, strict=True):
        assert (normal == 0).all()
        assert np.isfinite(clip).all()
    # Without a normal it is not displaced.
    (clip,), _ = shade(make_one(point, map_id=map_id), uv[:1], [random_map(rng)])
    np.testing.assert_allclose(clip[:, :3], [[0.3, -7, 2]] * 50, rtol=12 * U)


@by_seed
@pytest.mark.parametrize("map_id", [-1, 0])
def test_normals_are_unit_or_zero_and_finite(map_id, seed):
    """On lines in any direction rounding decides which; patches folded onto themselves have zeros inside."""
    rng = np.random.default_rng(700 + seed)
    cp = []
    for _ in range(20):
        line = rng.normal(size=(4, 4, 1)) * rng.normal(size=3) + rng.normal(size=3)
        cp.append(np.concatenate([line, np.ones((4, 4, 1))], -1))
        folded = smooth_patch(rng)
        folded[2:] = folded[1::-1]
        cp.append(folded)
        pinched = smooth_patch(rng)
        pinched[:, 0], pinched[0] = pinched[0, 0], pinched[0, 0]
        cp.append(pinched)
    uv = [random_points(rng, 30) for _ in cp]
    uv[1][:, 0] = 0.5  # where the fold is
    clips, normals = shade(make_one(cp, map_id=map_id), uv, [random_map(rng)])
    for clip, normal in zip(clips, normals, strict=True):
        length = np.linalg.norm(normal.astype(np.float64), axis=1)
        assert (np.isclose(length, 1, atol=4 * U) | (length == 0)).all(), f"seed {seed}"
        assert np.isfinite(clip).all()
    assert all((np.linalg.norm(n, axis=1) > 0.5).all() for n in normals[2::3])


@pytest.mark.parametrize("scale", [1e-25, 1e-15, 1e-11, 1e-10, 1e-9, 1e10, 1e15, 1e25])
def test_normals_do_not_depend_on_size(scale):
    rng = np.random.default_rng(19)
    cp = np.stack([smooth_patch(rng, 0.1) for _ in range(20)])
    cp[..., :3] -= cp[..., :1, :1, :3]
    uv = [random_points(rng, 20)] * 20
    _, expected = shade(make_one(cp), uv)
    _, normals = shade(make_one(cp * np.array([scale, scale, scale, 1])), uv)
    assert np.allclose(np.linalg.norm(np.concatenate(normals).astype(np.float64), axis=1), 1, atol=4 * U)
    np.testing.assert_allclose(np.concatenate(normals), np.concatenate(expected), atol=2e-3)


# Displacement maps


def padded(texels, address, by):
    return np.pad(texels, by, {"wrap": "wrap", "mirror": "symmetric", "clamp": "edge"}[address])


def fetched(image, x, y):
    """What lookups at texel coordinates (x, y) give: z of a flat patch that is displaced by them."""
    height, width = image.texels.shape
    low = np.floor(min(x.min(), y.min()))
    span = 2.0 ** np.ceil(np.log2(max(x.max(), y.max()) - low))  # a power of two, so that u and v are exact
    begin, end = low + 0.5, low + span + 0.5
    texcoords = np.array([[a / width, b / height] for b in (begin, end) for a in (begin, end)], np.float32)
    uv = ((np.stack([x, y], -1) - low) / span).astype(np.float32)
    (clip,), _ = shade(make_one(flat_square(), texcoords, 0), [uv], [image])
    return clip[:, 2]


def texel_grid(low, high, step):
    x = np.arange(low, high, step)
    return np.repeat(x, len(x)), np.tile(x, len(x))


SIZES = [(1, 1), (1, 4), (2, 2), (8, 4), (3, 5), (7, 1), (6, 10)]


@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
@pytest.mark.parametrize("address", ["wrap", "mirror", "clamp"])
def test_address_modes_are_those_of_a_padded_image(address, size):
    """At texel centres, between two and four of them, and anywhere: all around the map, several times its size."""
    rng = np.random.default_rng(23)
    width, height = size
    texels = (rng.integers(-64, 64, (height, width)) / 16).astype(np.float32)
    around = 16
    image, large = NaiveMap(texels, address, 1.0, 0.0), padded(texels, address, around).astype(np.float64)
    exact_centres = width in (1, 2, 4, 8) and height in (1, 2, 4, 8)
    for step in (1, 0.5, 0.25):
        x, y = texel_grid(-around, 10, step)
        i, j = (np.floor(a).astype(int) + around for a in (x, y))
        fx, fy = x - np.floor(x), y - np.floor(y)
        upper = (1 - fx) * large[j, i] + fx * large[j, i + 1]
        lower = (1 - fx) * large[j + 1, i] + fx * large[j + 1, i + 1]
        expected = (1 - fy) * upper + fy * lower
        # Where the size is no power of two a coordinate of up to 32 texels is rounded 6 times; texels differ by up to 8.
        error = 0 if exact_centres else 2 * 8 * 6 * 32 * U
        found = fetched(image, x, y)
        assert (abs(found - expected) <= error).all()


def test_address_modes_far_away():
    """A million periods off and still the right texel; past 2^30 texels the first, and no crash."""
    texels = np.arange(1, 5, dtype=np.float32)[None]
    period = {"wrap": [1, 2, 3, 4], "mirror": [1, 2, 3, 4, 4, 3, 2, 1], "clamp": [1]}
    for address, expected in period.items():
        image = NaiveMap(texels, address, 1.0, 0.0)
        for k in range(16):
            s = np.full((4, 2), (k + 0.5) / 4 - 2.0**17, np.float32)
            (clip,), _ = shade(make_one(flat_square(), s, 0), [np.zeros((1, 2), np.float32)], [image])
            assert clip[0, 2] == expected[k % len(expected)]
        for far in (1e12, -1e30, np.inf, np.nan):
            s = np.full((4, 2), far, np.float32)
            (clip,), _ = shade(make_one(flat_square(), s, 0), [np.zeros((1, 2), np.float32)], [image])
            assert clip[0, 2] == 1


def test_scale_and_bias():
    image = NaiveMap(np.array([[2, 6]], np.float32), "clamp", -0.5, 10.0)
    np.testing.assert_array_equal(fetched(image, np.array([0, 0.5, 1]), np.zeros(3)), [9, 8, 7])


@by_seed
def test_packed_maps_are_read_each_by_itself(seed):
    rng = np.random.default_rng(800 + seed)
    maps = [random_map(rng) for _ in range(7)]
    cp = np.repeat(flat_square()[None], 7, 0)
    uv = random_points(rng, 30)
    together, _ = shade(make_one(cp, UNIT_SQUARE * 2, np.arange(7)), [uv] * 7, maps)
    for k in range(7):
        (alone,), _ = shade(make_one(cp[0], UNIT_SQUARE * 2, 0), [uv], maps[k : k + 1])
        np.testing.assert_array_equal(bits(together[k]), bits(alone))


def attack_range(image, rng):
    """Lookups at texel centres, halves, and everywhere; and the range that the map is said to have."""
    corners = [texel_grid(-3, 6, 0.5), tuple(rng.uniform(-3, 6, (2, 400))), tuple(rng.integers(-8, 16, (2, 100)) / 2.0)]
    found = np.concatenate([fetched(image, x, y) for x, y in corners]).astype(np.float64)
    ((low, high),) = map_ranges(pack([image]))
    return found.min(), found.max(), low, high


def nasty_maps(rng):
    """Texels at two ends, or constant (all weights give the same value, up to rounding), and cancelling biases."""
    for address in ("wrap", "mirror", "clamp"):
        for scale in (1.0, -1.0, 1 / 3, -0.7, 1e-8, -3e7):
            width, height = rng.integers(1, 7, 2)
            low, high = np.sort(rng.normal(0, 1, 2)) * 10 ** rng.uniform(-3, 3)
            ends = rng.choice(np.array([low, high], np.float32), (height, width))
            flat = np.full((height, width), high, np.float32)
            for texels in (ends, flat):
                for bias in (0.0, -scale * high, -scale * low, float(rng.normal())):
                    yield NaiveMap(texels, address, scale, bias)


@by_seed
def test_map_ranges_enclose_every_lookup(seed):
    rng = np.random.default_rng(900 + seed)
    rounded_out = 0
    for image in nasty_maps(rng):
        least, most, low, high = attack_range(image, rng)
        assert low <= least and most <= high, f"seed {seed}, {image}: {least} .. {most} not in {low} .. {high}"
        scale, bias = float(np.float32(image.scale)), float(np.float32(image.bias))
        ends = [scale * float(t) + bias for t in (image.texels.min(), image.texels.max())]
        rounded_out += least < min(ends) or most > max(ends)
        largest = abs(scale) * float(abs(image.texels).max()) + abs(bias)
        assert high - low <= max(ends) - min(ends) + 32 * U * largest + 1e-40, f"seed {seed}, {image}: too wide"
    assert rounded_out > 20, "the attack must reach beyond the exact range, or it proves nothing of the widening"


def test_map_ranges_hold_for_denormal_texels():
    rng = np.random.default_rng(0)
    image = NaiveMap(np.full((3, 2), 3e-41, np.float32), "wrap", 1e30, 0.0)
    least, most, low, high = attack_range(image, rng)
    assert low <= least and most <= high


def test_map_ranges_are_reached():
    image = NaiveMap(np.array([[-1, 3]], np.float32), "clamp", -2.0, 0.5)
    ((low, high),) = map_ranges(pack([image]))
    assert (low, high) == pytest.approx((-5.5, 2.5), rel=1e-5)
    np.testing.assert_array_equal(fetched(image, np.array([0.0, 1.0]), np.zeros(2)), [2.5, -5.5])


def test_map_ranges_of_broken_maps():
    ranges = map_ranges(
        pack([NaiveMap(np.array([[1, bad]], np.float32), "wrap", 1.0, 0.0) for bad in (np.nan, np.inf, 2)])
    )
    assert np.isnan(ranges[:2]).all() and np.isfinite(ranges[2]).all()
    assert map_ranges(pack([])).shape == (0, 2)
