"""ACC and Gregory patches in the domain shader: bit for bit the slow twin, and the same on both sides of every edge."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline import hull
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.types import Patches
from tests.cages import BOX_FACES, box, read_model
from tests.naive_domain import NaiveMap, bernstein, naive_shade_patch
from tests.scenes import looking_along_y, patch_scene
from tests.test_domain import bits, random_matrix, random_points, shade
from tests.test_subdivision import evaluate
from tiler.scene.model import SceneMesh, Tessellation
from tiler.validation import validate_watertight
from tiler.validation.levels import level_edges

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


def edges_of(patches: Patches, edge_row, maps=(), factor=16):
    """For each edge: (clip, normals, texture corners) of every patch at it, in the edge's direction."""
    t = np.arange(factor + 1) / factor
    zero, one = np.zeros_like(t), np.ones_like(t)
    uv = np.concatenate([np.stack(side, 1) for side in ((zero, t), (t, zero), (one, t), (t, one))]).astype(np.float32)
    clips, normals = shade(patches, [uv] * len(patches.map_id), maps)
    found: dict[int, list] = {}
    for p, (clip, normal) in enumerate(zip(clips, normals, strict=True)):
        for e, (a, b) in enumerate(pairwise(range(0, 5 * (factor + 1), factor + 1))):
            row, corners = edge_row[p, e], patches.texcoords[p, SIDES[e]]
            order = slice(None) if row >= 0 else slice(None, None, -1)
            found.setdefault(int(row if row >= 0 else ~row), []).append(
                (clip[a:b][order], normal[a:b][order], corners[order])
            )
    return found


MODELS = [("bigguy", "none"), ("monsterfrog", "none"), ("animated_head", "none"), ("osd_gregory_test1", "uniform"),
          ("osd_nonquads", "none")]  # fmt: skip


@by_basis
@pytest.mark.parametrize(("name", "refine"), MODELS)
def test_edges_are_watertight(name, refine, basis):
    """Displaced points of both sides have the same bits where texture coordinates agree."""
    points, cage = read_model(name)
    surface, _ = make_surface(cage, basis, refine)
    extent = float(np.ptp(points, axis=0).max())
    displaced = hull.surface_patches(surface, points, 0, 0)
    assert displaced.normal_slack.min() > 0
    agreeing = 0
    for edge, sides in edges_of(displaced, surface.edge_row, [bumps(scale=0.01 * extent)]).items():
        assert len(sides) <= 2
        if len(sides) == 2 and (sides[0][2] == sides[1][2]).all():
            agreeing += 1
            np.testing.assert_array_equal(bits(sides[0][0]), bits(sides[1][0]), f"edge {edge}")
    assert agreeing > len(displaced.map_id) * 0.5


@by_basis
@pytest.mark.parametrize(("name", "refine"), MODELS)
def test_both_sides_of_an_edge_are_shaded_alike(name, refine, basis):
    """Without a map: points and normals of both sides have the same bits, on every edge."""
    points, cage = read_model(name)
    surface, _ = make_surface(cage, basis, refine)
    patches = hull.surface_patches(surface, points, -1, 0)
    assert (patches.normal_slack == 0).all()
    shared = 0
    for edge, sides in edges_of(patches, surface.edge_row).items():
        if len(sides) == 2:
            shared += 1
            for a, b in zip(sides[0][:2], sides[1][:2], strict=True):
                np.testing.assert_array_equal(bits(a), bits(b), f"edge {edge}")
    assert shared > len(patches.map_id)


@by_basis
def test_smooth_meshes_are_shaded_along_the_normals_that_they_are_displaced_along(basis):
    """So `test_slack_encloses_the_normals_of_edges` says how far these are from the patches' own."""
    points, cage = read_model("animated_head")
    surface, _ = make_surface(cage, basis)
    plain, displaced = (hull.surface_patches(surface, points, map_id, 0) for map_id in (-1, 0))
    np.testing.assert_array_equal(plain.edge_row, displaced.edge_row)
    np.testing.assert_array_equal(plain.edge_normals, displaced.edge_normals)
    np.testing.assert_array_equal(
        plain.corner_normals[plain.corner_row], displaced.corner_normals[displaced.corner_row]
    )


def test_sharp_creases_keep_the_normals_of_both_sides():
    """All edges of a box sharp: each face is flat, and shaded so; displaced, its edges move along the mean."""
    edges = sorted({tuple(sorted(pair)) for f in BOX_FACES for pair in zip(f, f[1:] + f[:1], strict=True)})
    points, cage = box(creases=edges, sharpness=[10] * len(edges))
    uv = [random_points(np.random.default_rng(2), 16)] * 6
    uv[0][:4] = [(0, 0), (1, 0), (0, 0.5), (0.25, 1)]
    outward = points[np.array(BOX_FACES)].mean(axis=1)
    surface, _ = make_surface(cage)
    patches = hull.surface_patches(surface, points, -1, 0)
    assert len(patches.edge_normals) == 24 and len(patches.corner_normals) == 24
    for normal, axis in zip(shade(patches, uv)[1], outward, strict=True):
        np.testing.assert_allclose(normal, np.tile(axis, (len(normal), 1)), atol=4 * U)
    displaced = hull.surface_patches(surface, points, 0, 0)
    assert len(displaced.edge_normals) == 12 and len(displaced.corner_normals) == 8
    np.testing.assert_allclose(abs(displaced.corner_normals), 1 / np.sqrt(3), atol=4 * U)


def test_vanishing_shared_normals_leave_the_own_where_nothing_is_displaced():
    patches = patches_of(*box(), Basis.ACC, -1)
    none = patches._replace(edge_normals=0 * patches.edge_normals, corner_normals=0 * patches.corner_normals)
    own = patches._replace(normal_id=np.full(6, -1, np.int32))
    uv = [np.array([(0, 0), (0, 0.25), (0, 0.5), (0.25, 1), (1, 1), (0.5, 0.5)], np.float32)] * 6
    np.testing.assert_array_equal(shade(none, uv)[1], shade(own, uv)[1])
    gone = none._replace(map_id=np.zeros(6, np.int32))
    moved, still = shade(gone, uv, [bumps()])[0], shade(own, uv)[0]
    np.testing.assert_array_equal(np.array(moved)[:, :5], np.array(still)[:, :5])


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


@by_basis
def test_adaptive_levels_meet_in_one_curve(basis):
    """An ordinary face's edge has the points of its refined neighbours' two edges, to the rounding of both."""
    points, cage = read_model("subdbox")
    surface, _ = make_surface(cage, basis, "adaptive")
    scene = mesh_scene_of(surface, points)
    patches = hull.surface_patches(surface, points, -1, 0)
    levels = level_edges(scene, patches)
    large, small = levels.patch.T
    assert (large < 36).all() and (small >= 36).all() and len(large) % 2 == 0
    assert (np.bincount(large * 4 + levels.side[:, 0]) % 2 == 0).all()  # two halves of every edge
    t = np.arange(9, dtype=np.float32) / 8
    for k in range(len(large)):
        along = levels.start[k] + levels.step[k] * t
        first, second = (
            edge_points(patches, levels.patch[k, j], levels.side[k, j], np.where(levels.turned[k, j], 1 - s, s))
            for j, s in ((0, along.astype(np.float32)), (1, t))
        )
        # Control points are rounded once, and sums of four products thrice: 8 u on each side.
        assert abs(first - second).max() <= 16 * U * abs(points).max()


def mesh_scene_of(surface, points, **fields):
    scene = patch_scene([], camera=looking_along_y(4 * float(abs(points).max())), **fields)
    return replace(scene, meshes=(SceneMesh(surface, points, 0, -1),))


def edge_points(patches, p, side, t):
    fixed = np.full_like(t, side // 2)
    uv = np.stack((fixed, t) if side % 2 == 0 else (t, fixed), 1).astype(np.float32)
    return shade(patches.take(np.array([p])), [uv])[0][0][:, :3]


def test_level_cracks_are_measured_and_no_failure():
    """The same factor on both sides leaves every second point of the finer side off the coarser one's chords."""
    points, cage = read_model("subdbox")
    surface, _ = make_surface(cage, Basis.ACC, "adaptive")
    found = [
        validate_watertight(mesh_scene_of(surface, points), [Tessellation(factor=(f,) * 6)], threads=1)
        for f in (1.0, 4.0, 16.0)
    ]
    assert all(r["failed"] == 0 and r["boundary_edges"] == 0 for r in found)
    assert len({r["level_edges"] for r in found}) == 1 and found[0]["level_edges"] > 0
    patches = hull.surface_patches(surface, points, -1, 0)
    net = patches.control_points[:36, ..., :3].astype(np.float64)
    curves = np.concatenate([net[:, 0], net[:, 3], net[:, :, 0], net[:, :, 3]])
    bend = 6 * np.linalg.norm(np.diff(curves, 2, axis=1), axis=2).max()  # a cubic's second derivative is at most that
    for factor, r in zip((1, 4, 16), found, strict=True):
        assert 0 < r["largest_level_crack"] <= bend / 8 / factor**2 + 16 * U * abs(points).max()
    uniform, _ = make_surface(cage, Basis.ACC, "uniform")
    plain = validate_watertight(mesh_scene_of(uniform, points), [Tessellation(factor=(4,) * 6)], threads=1)
    assert plain["level_edges"] == plain["largest_level_crack"] == 0
