"""Control meshes in scenes: drawn the same in both binnings, counted as defined, moved by keys and bones, read from files."""

from dataclasses import replace

import numpy as np
import pytest

import tiler
from pipeline.animate import Motion, pose, transform_at
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from pipeline.subdivision.surface import Basis, make_surface
from tests.cages import BOX_FACES, BOX_POINTS, box
from tests.naive_machine import simulate_naively
from tests.scenes import flat_patch, looking_along_y, patch_scene
from tiler.front_end import run_vertex_shader
from tiler.scene import surfaces
from tiler.scene.arrays import ArrayFault
from tiler.scene.model import DisplacementMap, SceneMesh

by_basis = pytest.mark.parametrize("basis", list(Basis), ids=lambda b: b.name.lower())
IDENTITY = np.eye(3, 4, dtype=np.float32)


def mesh_scene(basis=Basis.ACC, displaced=True, between=False, **fields):
    """A displaced box before a flat patch; `between`: its object comes before that of the patch."""
    points, cage = box()
    surface, _ = make_surface(cage, basis)
    texels = np.random.default_rng(1).normal(0, 1, (16, 16)).astype(np.float32)
    scene = patch_scene(
        [flat_patch(-2, -1.4, 2, 1.4, y=2.0)], size=(72, 48), factor=5.0, camera=looking_along_y(5.0), face_cull="back"
    )
    mesh = SceneMesh(surface, points, 0 if between else 1, 0 if displaced else -1)
    turned = np.array([[0.8, -0.6, 0, 0.1], [0.6, 0.8, 0, -0.2], [0, 0, 1, 0.1]], np.float32)
    transforms = np.stack([turned, IDENTITY] if between else [IDENTITY, turned])
    return replace(
        scene, meshes=(mesh,), transforms=transforms, object_id=np.full(1, 1 if between else 0, np.int32),
        maps=(DisplacementMap(texels, scale=0.05),) if displaced else (), **fields,
    )  # fmt: skip


@by_basis
def test_both_binnings_draw_the_same(basis):
    scene = mesh_scene(basis, displaced=False)
    one = tiler.simulate(scene, tiler.Machine(binning="triangle", tile=16))
    other = tiler.simulate(scene, tiler.Machine(binning="patch", tile=32))
    np.testing.assert_array_equal(one.color, other.color)
    np.testing.assert_array_equal(one.depth.view(np.uint32), other.depth.view(np.uint32))
    colors = len(np.unique(one.color.reshape(-1, 4), axis=0))
    assert colors > 1 + 1 + 6  # flat faces would show one colour each: background, wall, and six of the box


@by_basis
def test_a_displaced_mesh_draws_the_same_on_every_machine(basis):
    """Both binnings, every bound, every cull that answers for triangles or for the frustum; verified on the way."""
    scene = mesh_scene(basis)
    reference = tiler.simulate(scene, tiler.Machine(binning="triangle", tile=16, cull=()))
    machines = [
        tiler.Machine(
            binning=binning, tile=16, bounds=bound, cull=("frustum", "backface:tessellation_safe"), verify=True
        )
        for bound in BOUNDS
        for binning in ("triangle", "patch")
    ]
    machines += [tiler.Machine(binning="patch", cull=(name,), verify=True) for name in CULL_TESTS]
    for machine in machines:
        frame = tiler.simulate(scene, machine)
        assert not frame.violations, (machine, frame.violations[:3])
        if not frame.false_culls:
            np.testing.assert_array_equal(frame.color, reference.color, str(machine))
            np.testing.assert_array_equal(frame.depth.view(np.uint32), reference.depth.view(np.uint32), str(machine))
    plain = tiler.simulate(mesh_scene(basis, displaced=False), tiler.Machine(tile=16, cull=()))
    assert (plain.depth != reference.depth).any()


@by_basis
@pytest.mark.parametrize("binning", ["triangle", "patch"])
def test_counters_equal_the_slow_machine(binning, basis):
    scene = mesh_scene(basis, displaced=False)
    machine = tiler.Machine(binning=binning, tile=32)
    frame, naive = tiler.simulate(scene, machine), simulate_naively(scene, machine)
    assert dict(frame.counters) == naive.counters
    np.testing.assert_array_equal(frame.depth.reshape(naive.depth.shape), naive.depth)
    counters = frame.counters
    assert counters["ia_primitives"] == counters["hs_invocations"] == 7
    assert counters["ia_vertices"] == counters["vs_invocations"] == 16 + 8
    assert counters["hs_control_points"] == 16 + 6 * (32 if basis == Basis.ACC else 20)


def test_patches_are_numbered_in_object_order():
    patches = run_vertex_shader(mesh_scene(between=True), 0)
    assert patches.object_id.tolist() == [0] * 6 + [1] and patches.map_id.tolist() == [0] * 6 + [-1]
    assert patches.tangent_id.tolist() == [*range(6), -1] and patches.normal_id.tolist() == [*range(6), -1]
    other = run_vertex_shader(mesh_scene(between=False), 0)
    assert other.object_id.tolist() == [0] + [1] * 6 and other.tangent_id.tolist() == [-1, *range(6)]
    np.testing.assert_array_equal(patches.control_points[:6], other.control_points[1:])


def test_two_meshes_share_tables_without_mixing():
    scene = mesh_scene()
    (first,) = scene.meshes
    second = replace(first, object_id=2, vertices=first.vertices * np.float32(0.5))
    both = replace(scene, meshes=(first, second), transforms=np.stack([*scene.transforms, IDENTITY]))
    alone = replace(scene, meshes=(replace(second, object_id=1),), transforms=np.stack([IDENTITY, IDENTITY]))
    a, b = run_vertex_shader(both, 0), run_vertex_shader(alone, 0)
    for p, q in zip(range(7, 13), range(1, 7), strict=True):
        np.testing.assert_array_equal(a.tangent_u[a.tangent_id[p]], b.tangent_u[b.tangent_id[q]])
        for e in range(4):
            r, s = a.edge_row[a.normal_id[p], e], b.edge_row[b.normal_id[q], e]
            assert (r < 0) == (s < 0)
            np.testing.assert_array_equal(a.edge_normals[r if r >= 0 else ~r], b.edge_normals[s if s >= 0 else ~s])
        np.testing.assert_array_equal(
            a.corner_normals[a.corner_row[a.normal_id[p]]], b.corner_normals[b.corner_row[b.normal_id[q]]]
        )


# Motion


def keyed(interpolation="linear", **arrays):
    return Motion(np.array([0.0, 4.0, 6.0]), interpolation, **arrays)


@pytest.mark.parametrize("interpolation", ["linear", "catmull_rom"])
def test_keyframes(interpolation):
    rng = np.random.default_rng(2)
    points = rng.normal(0, 1, (3, 8, 3)).astype(np.float32)
    motion = keyed(interpolation, points=points)
    for frame, key in ((-3, 0), (0, 0), (4, 1), (6, 2), (99, 2)):
        np.testing.assert_array_equal(pose(BOX_POINTS, motion, frame), points[key])
    x = 0.25  # of the way from frame 0 to frame 4
    p, q, r = points.astype(np.float64)
    slopes = (q - p) / 4, (r - p) / 6
    if interpolation == "linear":
        expected = (1 - x) * p + x * q
    else:
        h = 2 * x**3 - 3 * x**2 + 1, -2 * x**3 + 3 * x**2, x**3 - 2 * x**2 + x, x**3 - x**2
        expected = h[0] * p + h[1] * q + 4 * (h[2] * slopes[0] + h[3] * slopes[1])
    np.testing.assert_allclose(pose(BOX_POINTS, motion, 1.0), expected, atol=1e-6)


def test_skinning_follows_its_bones():
    rng = np.random.default_rng(4)
    bones = rng.normal(0, 1, (3, 2, 3, 4)).astype(np.float32)
    index = rng.integers(0, 2, (8, 3)).astype(np.int32)
    weight = rng.dirichlet(np.ones(3), 8).astype(np.float32)
    motion = keyed(bone_index=index, bone_weight=weight, bones=bones)
    for frame, matrices in ((4, bones[1].astype(np.float64)), (5, (bones[1].astype(np.float64) + bones[2]) / 2)):
        expected = [
            sum(weight[v, b].astype(np.float64) * (matrices[index[v, b]] @ [*BOX_POINTS[v], 1]) for b in range(3))
            for v in range(8)
        ]
        np.testing.assert_allclose(pose(BOX_POINTS, motion, frame), expected, atol=1e-6)


def test_transforms_move_the_object():
    matrices = np.stack([IDENTITY, IDENTITY + np.float32(1), IDENTITY * np.float32(2)])
    motion = keyed(transforms=matrices)
    np.testing.assert_array_equal(transform_at(IDENTITY, motion, 4), matrices[1])
    np.testing.assert_array_equal(transform_at(IDENTITY, motion, 2), IDENTITY + np.float32(0.5))
    np.testing.assert_array_equal(transform_at(IDENTITY, None, 2), IDENTITY)


def test_animated_frames_are_reproducible_and_topology_is_kept(monkeypatch):
    standing = mesh_scene(displaced=False)
    moved = np.stack([BOX_POINTS, BOX_POINTS * np.float32(1.25), BOX_POINTS])
    scene = replace(standing, motions=(None, keyed(points=moved)), frames=7)
    monkeypatch.setattr("pipeline.subdivision.surface.make_topology", None)  # it is not made again
    frames = [tiler.simulate(scene, tiler.Machine(tile=16), frame=n) for n in (0, 2, 4, 6)]
    still = tiler.simulate(standing, tiler.Machine(tile=16))
    for frame in (frames[0], frames[3]):
        np.testing.assert_array_equal(frame.color, still.color)
        np.testing.assert_array_equal(frame.depth, still.depth)
        assert frame.counters == still.counters
    assert (
        frames[2].counters["om_samples_visible"] != still.counters["om_samples_visible"]
        or (frames[2].depth != still.depth).any()
    )
    assert (frames[1].depth != frames[2].depth).any()


# Files


SCENE = """
[camera]
up = [0, 0, 1]
[[camera.key]]
frame = 0
eye = [0, -6, 2]
target = [0, 0, 0]
[[object]]
mesh = "box.obj"
refine = "uniform"
"""


def obj_text(faces=BOX_FACES, textured=True, objects=1):
    """An OBJ file of so many boxes, `faces` their lists of vertices; each face has the unit square as texture."""
    lines = [f"vt {s} {t}" for s, t in ((0, 0), (1, 0), (1, 1), (0, 1))]
    for k in range(objects):
        lines += [f"o box{k}", *(f"v {x} {y} {z}" for x, y, z in BOX_POINTS + k * np.float32(3))]
        for face in faces:
            corners = [f"{8 * k + v + 1}/{c + 1}" if textured else f"{8 * k + v + 1}" for c, v in enumerate(face)]
            lines.append("f " + " ".join(corners))
    return "\n".join(lines) + "\n"


@pytest.fixture
def folder(tmp_path):
    """A folder with a scene file and its mesh."""
    (tmp_path / "box.obj").write_text(obj_text())
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path


def test_a_scene_file_with_a_mesh(folder):
    scene = tiler.load_scene(folder / "scene.toml")
    assert scene.num_patches == 24 and scene.num_vertices == 8 and scene.motions == ()
    assert scene.meshes[0].surface.basis == Basis.ACC
    np.testing.assert_array_equal(scene.meshes[0].vertices, BOX_POINTS)
    (folder / "box.obj").write_text(obj_text(objects=2))  # several meshes of a file are one object
    (folder / "scene.toml").write_text(SCENE.replace('refine = "uniform"', 'basis = "gregory"\nanimation = "move.npz"'))
    np.savez(folder / "move.npz", frames=[0, 3], transforms=np.stack([IDENTITY, IDENTITY]), interpolation="catmull_rom")
    scene = tiler.load_scene(folder / "scene.toml")
    assert scene.num_patches == 12 and scene.num_vertices == 16 and len(scene.motions) == 1
    assert scene.motions[0].interpolation == "catmull_rom" and scene.meshes[0].surface.basis == Basis.GREGORY


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ('mesh = "box.stl"', "object[0].mesh"),
        ('mesh = "box.obj"\nbasis = "bezier"', "object[0].basis"),
        ('mesh = "box.obj"\nrefine = "twice"', "object[0].refine"),
        ('mesh = "box.obj"\nbuilder = "teapot"', "builder and mesh are given"),
        ('builder = "teapot"\nbasis = "acc"', "belongs to a mesh"),
        ('mesh = "box.obj"\nanimation = "move.txt"', "object[0].animation"),
        ('mesh = "box.obj"\nanimation = "missing.npz"', "does not exist"),
    ],
)
def test_errors_of_scene_files(folder, line, text):
    (folder / "scene.toml").write_text(SCENE.replace('mesh = "box.obj"\nrefine = "uniform"', line))
    with pytest.raises(tiler.TilerError) as error:
        tiler.load_scene(folder / "scene.toml")
    assert text in str(error.value)


def test_a_displaced_mesh_needs_texture_coordinates(folder):
    (folder / "scene.toml").write_text(SCENE + '[object.displacement]\nmap = "stones"\n')
    assert tiler.load_scene(folder / "scene.toml").num_patches == 24
    (folder / "box.obj").write_text(obj_text(textured=False))
    with pytest.raises(tiler.TilerError, match="without texture coordinates"):
        tiler.load_scene(folder / "scene.toml")


def test_a_mesh_that_is_no_surface(folder):
    (folder / "box.obj").write_text(obj_text([*BOX_FACES[:5], BOX_FACES[5][::-1]]))
    with pytest.raises(tiler.TilerError, match=r"scene.toml:9: object\[0\].mesh.* in the same direction"):
        tiler.load_scene(folder / "scene.toml")


MOTIONS = {
    "no array frames": {"points": np.zeros((1, 8, 3))},
    "an array speed; allowed": {"frames": [0.0], "speed": [1.0]},
    "do not rise": {"frames": [0.0, 0.0], "points": np.zeros((2, 8, 3))},
    "interpolation 'cubic'": {"frames": [0.0], "interpolation": "cubic", "points": np.zeros((1, 8, 3))},
    r"points of shape \(1, 7, 3\); allowed: \(1, 8, 3\)": {"frames": [0.0], "points": np.zeros((1, 7, 3))},
    "numbers in points that are not finite": {"frames": [0.0], "points": np.full((1, 8, 3), np.nan)},
    "moves nothing": {"frames": [0.0]},
    "bone_index and bones only": {"frames": [0.0], "bone_index": np.zeros((8, 1), int), "bones": np.zeros((1, 1, 3, 4))},
    "bone 3; allowed: 0 to 0": {
        "frames": [0.0], "bone_index": np.full((8, 1), 3), "bone_weight": np.ones((8, 1)), "bones": np.zeros((1, 1, 3, 4)),
    },
}  # fmt: skip


@pytest.mark.parametrize("text", MOTIONS)
def test_errors_of_motion_files(text, tmp_path):
    np.savez(tmp_path / "move.npz", **MOTIONS[text])
    with pytest.raises(ArrayFault, match=text):
        surfaces.read_motion(tmp_path / "move.npz", 8)


def test_patches_move_as_a_whole_only(tmp_path):
    np.savez(tmp_path / "move.npz", frames=[0.0], points=np.zeros((1, 8, 3)))
    with pytest.raises(ArrayFault, match="object of patches"):
        surfaces.read_motion(tmp_path / "move.npz", 0)
