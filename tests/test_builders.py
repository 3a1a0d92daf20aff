"""Built scenes: patch counts, the teapot against the public figures, the same bits everywhere, and no cracks when displaced."""

import hashlib

import numpy as np
import pytest

from pipeline import displacement, domain, vertex
from pipeline.tessellator import make_patterns
from pipeline.types import Address, DomainPoints, TessFactors
from tests.shared_data import shared_file
from tiler.scene import bspline, colonnade, load_scene, noise, spikelog, teapot, transform, waves
from tiler.scene.builders import BUILDERS
from tiler.scene.catalog import scene_names, scene_summaries
from tiler.scene.maps import MAPS

SCENES = {"teapot": 32, "waves": 1024, "spikelog": 96, "colonnade": 4896}
SURFACES = {"creature": 3104, "creature_small": 104}

# The control points of each edge, and those of the row next to it, both in the direction of the rising parameter.
EDGES = {
    "u=0": (np.s_[:, 0, :], np.s_[:, 1, :]),
    "u=1": (np.s_[:, 3, :], np.s_[:, 2, :]),
    "v=0": (np.s_[:, :, 0], np.s_[:, :, 1]),
    "v=1": (np.s_[:, :, 3], np.s_[:, :, 2]),
}
CORNERS = {"u=0": [0, 2], "u=1": [1, 3], "v=0": [0, 1], "v=1": [2, 3]}


def shared_edges(points, high, low):
    """Pairs (a, b) of patches such that edge `high` of a has the same bits as edge `low` of b."""
    of_edge = {edge.tobytes(): b for b, edge in enumerate(points[EDGES[low][0]])}
    edges = points[EDGES[high][0]]
    return [(a, of_edge[edge.tobytes()]) for a, edge in enumerate(edges) if edge.tobytes() in of_edge]


SMOOTH_MESHES = {  # name: (mesh, edges shared across u, edges shared across v)
    "waves": (waves.build(waves.Parameters(n=8, swell=3.0)), 7 * 8, 8 * 7),
    "spikelog": (spikelog.build(spikelog.Parameters()), 8 * 12, 8 * 11),
    "shaft": (colonnade.build_columns(colonnade.Columns(along=3, across=2, nave=-1, radius=0.77)), 4 * 6, 0),
    "base": (colonnade.build_columns(colonnade.Columns(part="base", along=2, across=5, nave=2)), 4 * 8, 0),
    "capital": (colonnade.build_columns(colonnade.Columns(part="capital", along=2, across=1, nave=-1)), 4 * 2, 0),
    "floor": (colonnade.build_hall(colonnade.Hall(along=4, across=3, patch=5.1)), 3 * 3, 4 * 2),
    "ceiling": (colonnade.build_hall(colonnade.Hall(part="ceiling", along=4, across=3)), 2 * 4, 3 * 3),
}
smooth = pytest.mark.parametrize("name", SMOOTH_MESHES)


@pytest.mark.parametrize(("name", "count"), SCENES.items())
def test_scenes_are_complete_and_finite(name, count):
    scene = load_scene(name)
    assert scene.num_patches == count
    assert scene.control_points.shape == (count, 4, 4, 4) and scene.texcoords.shape == (count, 4, 2)
    assert scene.transforms.shape[1:] == (3, 4) and scene.object_id.max() == len(scene.transforms) - 1
    assert scene.map_id.min() >= -1 and scene.map_id.max() == len(scene.maps) - 1
    for array in (scene.control_points, scene.texcoords, scene.transforms, *(m.texels for m in scene.maps)):
        assert array.dtype == np.float32 and array.flags.c_contiguous and np.isfinite(array).all()
    assert (scene.control_points[..., 3] == 1).all()
    assert scene.map_id.dtype == scene.object_id.dtype == np.int32
    assert scene.title and scene.frames >= 48 and scene.picture.width / scene.picture.height == 16 / 9


@pytest.mark.parametrize(("name", "count"), SURFACES.items())
def test_surface_scenes_are_complete_and_finite(name, count):
    scene = load_scene(name)
    assert scene.num_patches == count and len(scene.control_points) == 0
    (mesh,) = scene.meshes
    surface = mesh.surface
    assert surface.num_patches == count and 0 <= mesh.map_id < len(scene.maps)
    assert len(mesh.vertices) == scene.num_vertices == surface.num_vertices == surface.used_vertices
    for array in (mesh.vertices, surface.texcoords, scene.transforms, *(m.texels for m in scene.maps)):
        assert array.dtype == np.float32 and array.flags.c_contiguous and np.isfinite(array).all()
    assert scene.title and scene.frames == 96 and scene.picture.width / scene.picture.height == 16 / 9


def test_summaries_agree_with_the_scenes():
    summaries = {summary.name: summary for summary in scene_summaries()}
    counts = SCENES | SURFACES
    assert sorted(summaries) == scene_names() == sorted(counts)
    for name, count in counts.items():
        scene = load_scene(name)
        assert (summaries[name].patches, summaries[name].title, summaries[name].frames) == (
            count,
            scene.title,
            scene.frames,
        )


@pytest.mark.parametrize("name", BUILDERS)
def test_builders_count_without_building(name):
    builder = BUILDERS[name]
    parameters = builder.parameters()
    assert builder.num_patches(parameters) == len(builder.build(parameters).control_points)


def test_walls_close_the_hall():
    walls = colonnade.Hall(part="walls", along=3, across=2, up=2)
    mesh = colonnade.build_hall(walls)
    assert len(mesh.control_points) == colonnade.num_hall_patches(walls) == 20
    assert len(shared_edges(mesh.control_points, "u=1", "u=0")) == 20  # once around, in both courses


def test_teapot_has_the_public_control_points():
    """The same 32 patches as the reference, front sides included, whatever the order and the start of u and v."""
    reference = list(np.load(shared_file("data", "models", "teapot_bezier_32.npz"))["P"])
    for patch in teapot.build(teapot.Parameters()).control_points[..., :3]:
        same_front = [patch, patch[::-1, ::-1], patch.transpose(1, 0, 2)[::-1], patch.transpose(1, 0, 2)[:, ::-1]]
        found = [k for k, other in enumerate(reference) if any(np.array_equal(other, p) for p in same_front)]
        assert len(found) == 1
        del reference[found[0]]
    assert not reference


def test_teapot_has_collapsed_edges_and_shares_the_others():
    points = teapot.build(teapot.Parameters()).control_points
    collapsed = [
        (e, p) for e, (edge, _) in EDGES.items() for p in range(32) if (points[edge][p] == points[edge][p][0]).all()
    ]
    assert len(collapsed) == 8  # the top of the lid, the middle of the bottom
    ends = [points[edge][p] for edge, _ in EDGES.values() for p in range(32)]
    seen = [min(e.tobytes(), e[::-1].tobytes()) for e in ends]
    once = [e for e, key in zip(ends, seen, strict=True) if seen.count(key) == 1]
    # Open are: the body's rim inside (4), the lid's rim (4), both ends of handle (4) and spout (4).
    assert len(once) == 16
    assert len(teapot.build(teapot.Parameters(bottom=False)).control_points) == 28


DIGESTS = {
    "teapot": "e72b1ba0c7b244b4",
    "waves": "1278a1817ac490d5",
    "spikelog": "fe443febfbdcef23",
    "colonnade": "f5ec39b52d897ccb",
    "creature": "f6aaa98719a511b1",
    "creature_small": "06ac39c77cad3017",
}


@pytest.mark.parametrize(("name", "digest"), DIGESTS.items())
def test_the_same_bits_everywhere(name, digest):
    """A digest that changes changes the golden images too: change it only with a builder or a scene file."""
    scene = load_scene(name)
    content = hashlib.sha256()
    for array in (scene.control_points, scene.texcoords, scene.transforms, *(m.texels for m in scene.maps)):
        content.update(array.tobytes())
    for mesh in scene.meshes:
        for array in (mesh.vertices, mesh.surface.texcoords, mesh.surface.edge_row, mesh.surface.corner_row):
            content.update(array.tobytes())
    for motion in scene.motions:
        for value in motion or ():
            content.update(value.tobytes() if isinstance(value, np.ndarray) else str(value).encode())
    assert content.hexdigest()[:16] == digest


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("size", [16, 100, 256])
def test_maps(name, size):
    texels = MAPS[name](size, 7)
    assert texels.shape == (size, size) and texels.dtype == np.float32
    assert texels.min() >= 0 and texels.max() <= 1 and texels.max() > texels.min()
    assert np.array_equal(texels * 65536, np.rint(texels * 65536))
    assert np.array_equal(texels, MAPS[name](size, 7))


def test_spikes_leave_the_poles_alone():
    for seed in range(5):
        texels = MAPS["spikes"](512, seed)
        assert not texels[[0, -1]].any() and texels.max() > 0.7


def test_noise_is_even_and_takes_negative_numbers():
    values = noise.uniform(3, np.arange(-200, 200)[:, None], np.arange(50)[None, :])
    assert values.min() >= 0 and values.max() < 1 and abs(values.mean() - 0.5) < 0.01
    assert abs(np.corrcoef(values[1:].ravel(), values[:-1].ravel())[0, 1]) < 0.02
    assert [int(w) for w in noise.hash32(1, np.array([0, 1, -1]), 5)] == [1171367025, 3209270644, 2936855518]


@smooth
def test_neighbours_share_edges_and_cross_differences(name):
    """What the displaced surface needs to have no cracks: see `bspline`. Differences are float32, as in the shader."""
    mesh, across_u, across_v = SMOOTH_MESHES[name]
    for high, low, count in (("u=1", "u=0", across_u), ("v=1", "v=0", across_v)):
        pairs = shared_edges(mesh.control_points, high, low)
        assert len(pairs) == count
        for a, b in pairs:
            before = mesh.control_points[EDGES[high][0]][a] - mesh.control_points[EDGES[high][1]][a]
            after = mesh.control_points[EDGES[low][1]][b] - mesh.control_points[EDGES[low][0]][b]
            assert before.tobytes() == after.tobytes()
            periods = mesh.texcoords[a, CORNERS[high]] - mesh.texcoords[b, CORNERS[low]]
            assert np.array_equal(periods, np.rint(periods))


@smooth
def test_control_points_are_exact_in_float32(name):
    points = SMOOTH_MESHES[name][0].control_points.astype(np.float64)
    assert np.array_equal(points * 65536, np.rint(points * 65536)) and np.abs(points).max() <= 128


def shade(points, texcoords, name, scale):
    """Every domain point of the patches, factor 16, through the real domain shader, the identity as camera."""
    count = len(points)
    patches = vertex.make_patches(points, texcoords, np.zeros(count, np.int32), np.zeros(count, np.int32))
    factors = TessFactors(np.full((count, 4), 16, np.float32), np.full((count, 2), 16, np.float32))
    patterns = make_patterns(factors, "integer", "triangle_cw")
    uv = patterns.uv
    first = np.arange(count + 1) * uv.shape[1]
    shaded = DomainPoints(first, *(np.zeros((rows, first[-1]), np.float32) for rows in (4, 3)))
    maps = displacement.pack_maps([(MAPS[name](256, 1), Address.WRAP, scale, 0.0)])
    live, scratch = np.arange(count, dtype=np.int32), np.zeros(domain.SCRATCH, np.float32)
    domain.shade_patches(0, count, live, patches, patterns, maps, np.eye(4, dtype=np.float32), shaded, scratch)
    return uv, shaded.clip.reshape(4, count, -1)


@pytest.mark.parametrize(
    ("name", "map_name", "scale"),
    [("waves", "sea", 1.2), ("spikelog", "spikes", 1.5), ("shaft", "flutes", -0.2), ("floor", "stones", 0.3)],
)
def test_displaced_neighbours_meet_bit_for_bit(name, map_name, scale):
    mesh, _, _ = SMOOTH_MESHES[name]
    (u, v), clip = shade(mesh.control_points, mesh.texcoords, map_name, scale)
    assert np.isfinite(clip).all()
    for high, low, across, along in (("u=1", "u=0", u, v), ("v=1", "v=0", v, u)):
        ends = [np.flatnonzero(across == end) for end in (1, 0)]
        at_one, at_zero = (end[np.argsort(along[end])] for end in ends)
        for a, b in shared_edges(mesh.control_points, high, low):
            assert clip[:, a, at_one].tobytes() == clip[:, b, at_zero].tobytes()


def test_displaced_log_is_closed_at_its_poles():
    mesh = SMOOTH_MESHES["spikelog"][0]
    for edge in (mesh.control_points[0::12, :, 0], mesh.control_points[11::12, :, 3]):
        assert (edge == edge[0, 0]).all()
    (_, v), clip = shade(mesh.control_points, mesh.texcoords, "spikes", 1.5)
    for end, patches in ((0, np.s_[0::12]), (1, np.s_[11::12])):
        pole = clip[:3, patches][:, :, v == end].reshape(3, -1)
        assert pole.shape[1] == 8 * 17
        assert np.abs(pole - pole[:, :1]).max() < 1e-6  # a weighted sum of equal points rounds
        assert (pole.reshape(3, 8, 17) == pole.reshape(3, 8, 17)[:, :1]).all()  # in each patch alike


def test_spikes_are_longer_than_a_patch():
    scene = load_scene("spikelog")
    length = scene.maps[0].scale * scene.maps[0].texels.max()
    corners = scene.control_points[:, [0, 3, 0, 3], [0, 0, 3, 3], :3]
    sides = np.linalg.norm(np.concatenate([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]]), axis=1)
    assert length > sides.max()


def middle_and_normal(mesh):
    """Point and normal at u = v = 1/2 of each patch."""
    points = mesh.control_points[..., :3].astype(np.float64)
    value, slope = np.array([1, 3, 3, 1]) / 8, np.array([-1, -1, 1, 1])
    du, dv = np.einsum("i,j,pijc->pc", slope, value, points), np.einsum("i,j,pijc->pc", value, slope, points)
    return np.einsum("i,j,pijc->pc", value, value, points), np.cross(du, dv)


def test_front_sides():
    middle, normal = middle_and_normal(SMOOTH_MESHES["waves"][0])
    assert (normal[:, 2] > 0).all()
    middle, normal = middle_and_normal(SMOOTH_MESHES["spikelog"][0])
    assert ((middle * [0.2, 1, 1] * normal).sum(1) > 0).all()
    for part in ("base", "shaft", "capital"):
        middle, normal = middle_and_normal(
            colonnade.build_columns(colonnade.Columns(part=part, along=1, across=1, nave=-1))
        )
        assert ((middle * normal)[:, :2].sum(1) > 0).all()
    for part in ("floor", "ceiling", "walls"):
        middle, normal = middle_and_normal(colonnade.build_hall(colonnade.Hall(part=part)))
        assert (((np.array([0, 0, 3.75]) - middle) * normal).sum(1) > 0).all()


def test_bspline_is_the_bspline():
    """Against the recursion of Cox and de Boor, and at its limits."""

    def basis(k, degree, t):
        if degree == 0:
            return float(k <= t < k + 1)
        rising = (t - k) / degree * basis(k, degree - 1, t)
        return rising + (k + degree + 1 - t) / degree * basis(k + 1, degree - 1, t)

    net = noise.uniform(5, np.arange(7)[:, None, None], np.arange(6)[None, :, None], np.arange(3)) * 20
    patches = bspline.bezier_patches(net).reshape(4, 3, 4, 4, 3)
    for x, y in ((3.25, 4.5), (6.75, 3.125)):
        expected = sum(basis(a, 3, x) * basis(b, 3, y) * net[a, b] for a in range(7) for b in range(6))
        u, v = x % 1, y % 1
        bu, bv = ([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3] for t in (u, v))
        got = np.einsum("i,j,ijc->c", bu, bv, patches[int(x) - 3, int(y) - 3].astype(np.float64))
        assert got == pytest.approx(expected, abs=2 * bspline.STEP)
    with pytest.raises(ValueError, match="128"):
        bspline.bezier_patches(np.full((4, 4, 3), 129.0))
    with pytest.raises(ValueError, match="128"):
        bspline.bezier_patches(np.full((4, 4, 3), np.nan))


def test_transforms():
    """Scale, then rotate about x, y, z in this order, then translate; quarter turns are exact."""
    matrix = transform.object_to_world((1, 2, 3), (90, 0, 90), (2, 3, 4))
    assert matrix.dtype == np.float32
    for point, expected in (((1, 0, 0), (1, 4, 3)), ((0, 1, 0), (1, 2, 6)), ((0, 0, 1), (5, 2, 3))):
        assert np.array_equal(matrix @ np.array([*point, 1], np.float32), expected)
    turned = transform.object_to_world((0, 0, 0), (20, -35, 123), (1, 1, 1))[:, :3].astype(np.float64)
    assert turned @ turned.T == pytest.approx(np.eye(3), abs=1e-4)
    assert np.linalg.det(turned) == pytest.approx(1, abs=1e-4)
