"""ACC and Gregory patches in the domain shader: bit for bit the slow twin, and the same on both sides of every edge."""

from itertools import pairwise

import numpy as np
import pytest

from pipeline import hull
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.types import Patches
from tests.cages import box, read_model
from tests.naive_domain import NaiveMap, bernstein, naive_shade_patch
from tests.test_domain import bits, random_matrix, random_points, shade
from tests.test_subdivision import evaluate

U = 2.0**-24
SIDES = [[0, 2], [0, 1], [1, 3], [2, 3]]  # texture corners of the edges u=0, v=0, u=1, v=1
by_basis = pytest.mark.parametrize("basis", list(Basis), ids=lambda b: b.name.lower())


def bumps(size=64, scale=0.3):
    rng = np.random.default_rng(3)
    return NaiveMap(rng.normal(0, 1, (size, size)).astype(np.float32), "wrap", scale, 0.05)


def patches_of(points, cage, basis, map_id=0, **options) -> Patches:
    surface, _ = make_surface(cage, basis, **options)
    return hull.surface_patches(surface, points, map_id, 0)


@by_basis
@pytest.mark.parametrize("map_id", [-1, 0])
def test_equals_twin(map_id, basis):
    rng = np.random.default_rng(5)
    patches = patches_of(*read_model("subdbox"), basis, map_id).take(np.arange(0, 90, 5))
    assert (patches.tangent_id >= 0).any() or (patches.gregory_id >= 0).any()
    maps, matrix = [bumps()], random_matrix(rng)
    uv = [random_points(rng, 16) for _ in patches.map_id]
    for k in (0, 1):
        uv[k][:4] = [(0, 0), (1, 0), (0, 1), (1, 1)]
    clips, normals = shade(patches, uv, maps, matrix)
    for p, (clip, normal) in enumerate(zip(clips, normals, strict=True)):
        for i, (u, v) in enumerate(uv[p]):
            expected = naive_shade_patch(patches, p, maps[0] if map_id == 0 else None, matrix, u, v)
            np.testing.assert_array_equal(bits(clip[i]), bits(expected[0]), f"patch {p} at ({u}, {v})")
            np.testing.assert_allclose(normal[i], expected[1], rtol=0, atol=0, err_msg=f"patch {p} at ({u}, {v})")


@pytest.mark.parametrize("step", [2.0**-8, 2.0**-10])
def test_gregory_normals_are_those_of_the_surface(step):
    """Against differences of positions: the quotients' derivatives are in them."""
    patches = patches_of(*box(), Basis.GREGORY, -1)
    rng = np.random.default_rng(7)
    uv = (rng.integers(20, 236, (40, 2)) / 256).astype(np.float32)
    around = [uv + np.float32(step) * np.array(d, np.float32) for d in [(1, 0), (-1, 0), (0, 1), (0, -1)]]
    _, (normal,) = shade(patches.take(np.array([2])), [uv])
    p = [shade(patches.take(np.array([2])), [points])[0][0][:, :3].astype(np.float64) for points in around]
    expected = np.cross(p[0] - p[1], p[2] - p[3])
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    # A difference's error: third derivatives (30 for a unit patch) times step^2, and rounding over the step.
    assert abs(normal - expected).max() < 30 * step**2 + 8 * U / step


def edges_of(patches: Patches, maps, factor=16):
    """For each edge: (clip, undisplaced normals, texture corners) of every patch at it, in the edge's direction."""
    t = np.arange(factor + 1) / factor
    zero, one = np.zeros_like(t), np.ones_like(t)
    uv = np.concatenate([np.stack(side, 1) for side in ((zero, t), (t, zero), (one, t), (t, one))]).astype(np.float32)
    n = len(patches.map_id)
    clips, _ = shade(patches, [uv] * n, maps)
    _, normals = shade(patches._replace(map_id=np.full(n, -1, np.int32)), [uv] * n)
    found: dict[int, list] = {}
    for p, (clip, normal) in enumerate(zip(clips, normals, strict=True)):
        for e, (a, b) in enumerate(pairwise(range(0, 5 * (factor + 1), factor + 1))):
            row, corners = patches.edge_row[p, e], patches.texcoords[p, SIDES[e]]
            order = slice(None) if row >= 0 else slice(None, None, -1)
            found.setdefault(int(row if row >= 0 else ~row), []).append(
                (clip[a:b][order], normal[a:b][order], corners[order])
            )
    return found


@by_basis
@pytest.mark.parametrize(
    ("name", "refine"),
    [("bigguy", "none"), ("monsterfrog", "none"), ("osd_gregory_test1", "uniform"), ("osd_nonquads", "none")],
)
def test_edges_are_watertight(name, refine, basis):
    """Displaced points of both sides have the same bits where texture coordinates agree; plain ones everywhere."""
    points, cage = read_model(name)
    surface, _ = make_surface(cage, basis, refine)
    extent = float(np.ptp(points, axis=0).max())
    maps = [bumps(scale=0.01 * extent)]
    displaced = hull.surface_patches(surface, points, 0, 0)
    assert displaced.normal_slack.min() > 0
    agreeing = 0
    for edge, sides in edges_of(displaced, maps).items():
        assert len(sides) <= 2
        if len(sides) == 2 and (sides[0][2] == sides[1][2]).all():
            agreeing += 1
            np.testing.assert_array_equal(bits(sides[0][0]), bits(sides[1][0]), f"edge {edge}")
    assert agreeing > len(displaced.map_id) * 0.5
    plain = hull.surface_patches(surface, points, -1, 0)
    gap = 0.0
    for edge, sides in edges_of(plain._replace(edge_row=displaced.edge_row), ()).items():
        if len(sides) == 2:
            np.testing.assert_array_equal(bits(sides[0][0]), bits(sides[1][0]), f"edge {edge}")
            gap = max(gap, float(abs(sides[0][1] - sides[1][1]).max()))
    assert gap < 2e-4  # float32 rounding of points of size 30 whose differences are 0.05


@by_basis
def test_displaced_corners_agree_all_around(basis):
    points, cage = read_model("subdbox")
    surface, _ = make_surface(cage._replace(texcoords=np.zeros_like(cage.texcoords)), basis)
    patches = hull.surface_patches(surface, points, 0, 0)
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)
    clips, _ = shade(patches, [corners] * surface.num_patches, [bumps()])
    seen: dict[int, np.ndarray] = {}
    for clip, row in zip(clips, surface.corner_row, strict=True):
        for point, vertex in zip(clip, row, strict=True):
            np.testing.assert_array_equal(bits(seen.setdefault(int(vertex), point)), bits(point))
    assert len(seen) == 92


def test_slack_encloses_the_normals_of_edges():
    """How far the normal of an edge is from that of each patch's own float32 nets, on all edges."""
    points, cage = read_model("monsterfrog")
    patches = patches_of(points, cage, Basis.ACC)
    tightest = 0.0
    for p, slack in enumerate(patches.normal_slack.astype(np.float64)):
        b = patches.control_points[p][..., :3].astype(np.float64)
        tu, tv = np.diff(b, axis=0), np.diff(b, axis=1)
        if patches.tangent_id[p] >= 0:
            tu, tv = patches.tangent_u[patches.tangent_id[p]], patches.tangent_v[patches.tangent_id[p]]
        farthest = 0.0
        for e, row in enumerate(patches.edge_row[p]):
            net = patches.edge_normals[row] if row >= 0 else patches.edge_normals[~row][::-1]
            for t in (0.0, 0.25, 0.5, 0.875, 1.0):
                u, v = ((e // 2, t), (t, e // 2))[e % 2]
                normals = bernstein(5, t) @ net.astype(np.float64), np.cross(evaluate(tu, u, v), evaluate(tv, u, v))
                one, other = (n / np.linalg.norm(n) for n in normals)
                farthest = max(farthest, float(np.linalg.norm(one - other)))
        assert farthest <= slack, f"patch {p}"
        tightest = max(tightest, farthest / slack)
    assert tightest > 0.2 and np.median(patches.normal_slack) < 1e-4
