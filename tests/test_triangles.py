"""Triangle meshes: flat patches of the same shape, neighbours with the same bits, and refused headers."""

import struct

import numpy as np
import pytest
import trimesh

import tiler
from tiler.scene import triangles
from tiler.scene.arrays import ArrayFault
from tiler.scene.mesh_files import read_patches

XYZ = b"property float x\nproperty float y\nproperty float z\n"


def area_of(points):
    """Area of each patch (n, 4, 4, 3) from its corners."""
    a, b, d, c = points[:, 0, 0], points[:, 3, 0], points[:, 0, 3], points[:, 3, 3]
    halves = np.cross(b - a, c - a), np.cross(c - a, d - a)
    return sum(np.linalg.norm(half, axis=1) / 2 for half in halves)


@pytest.mark.parametrize("suffix", triangles.SUFFIXES)
def test_box_becomes_six_quads(tmp_path, suffix):
    box = trimesh.creation.box((1, 2, 3))
    box.export(tmp_path / f"box{suffix}") if suffix != ".gltf" else _write_gltf(box, tmp_path / "box.gltf")
    mesh, warnings = read_patches(tmp_path / f"box{suffix}")
    points = mesh.control_points[..., :3].astype(np.float64)
    assert len(points) == 6 and warnings == ()
    assert sorted(area_of(points)) == pytest.approx([2, 2, 3, 3, 6, 6])
    # Fronts are outside, and all 16 points lie in the quad's plane, evenly.
    normal = np.cross(points[:, 3, 0] - points[:, 0, 0], points[:, 0, 3] - points[:, 0, 0])
    assert ((points.mean(axis=(1, 2)) * normal).sum(axis=1) > 0).all()
    i, j = np.arange(4)[:, None, None] / 3, np.arange(4)[None, :, None] / 3
    a, b, d = points[:, None, None, 0, 0], points[:, None, None, 3, 0], points[:, None, None, 0, 3]
    assert np.abs(a + i * (b - a) + j * (d - a) - points).max() < 1e-6


def _write_gltf(mesh, path):
    for name, data in mesh.export(file_type="gltf").items():
        (path.parent / name.replace("model.gltf", path.name)).write_bytes(data)


def test_lone_triangles_stay_triangles(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(tmp_path / "ball.ply")
    points = read_patches(tmp_path / "ball.ply")[0].control_points[..., :3]
    assert len(points) == len(ball.faces) == 80
    assert (points[:, :, 3] == points[:, :1, 3]).all()  # the edge v = 1 is a point
    assert area_of(points.astype(np.float64)).sum() == pytest.approx(ball.area, rel=1e-6)
    # Each edge lies in two patches, with the same bits in both directions.
    edges = [e for p in points for e in (p[:, 0], p[3, :], p[0, :])]
    keys = [min(e.tobytes(), e[::-1].tobytes()) for e in edges]
    assert len(set(keys)) == 120 and all(keys.count(k) == 2 for k in set(keys))


def test_pairs_are_flat_and_convex():
    square = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0.5, 0.5, 0), (2, 2, 0.25)], np.float32)
    flat, bent = np.array([(0, 1, 2), (0, 2, 3)]), np.array([(0, 1, 5), (0, 5, 3)])
    arrow = np.array([(0, 1, 4), (4, 3, 0)])  # not convex at vertex 4
    assert len(triangles.quads_of(square, flat)[0]) == 1
    assert len(triangles.quads_of(square, bent)[0]) == 2
    assert len(triangles.quads_of(square, arrow)[0]) == 2
    assert len(triangles.quads_of(square, flat[:, ::-1])[0]) == 1
    assert len(triangles.quads_of(square, np.array([(0, 1, 2), (0, 3, 2)]))[0]) == 2  # opposite windings
    three = np.array([(0, 1, 2), (0, 2, 3), (0, 2, 3)])  # an edge of three triangles
    assert len(triangles.quads_of(square, three)[0]) == 2
    quads, warnings = triangles.quads_of(square, np.array([(0, 1, 2), (0, 0, 1)]))
    assert len(quads) == 1 and warnings == ("1 triangles without area are left out",)


def test_a_ball_hides_what_is_behind_it(tmp_path):
    trimesh.creation.icosphere(subdivisions=2, radius=1.5).export(tmp_path / "ball.stl")
    text = """[[camera.key]]\nframe = 0\neye = [0, -9, 0]\ntarget = [0, 0, 0]\n[[object]]\npatches = "ball.stl"\n"""
    (tmp_path / "scene.toml").write_text(text)
    scene = tiler.load_scene(tmp_path / "scene.toml", size=(96, 96), factor=1)
    frame = tiler.simulate(scene)
    covered = int((frame.depth < 1).sum())
    scale = 48 / np.tan(np.pi / 8)
    disc = np.pi * (scale * 1.5 / np.sqrt(81 - 2.25)) ** 2
    assert 0.93 * disc < covered < disc * 1.02  # a ball of 320 triangles is a little smaller than the ball
    assert frame.counters["ia_primitives"] == scene.num_patches == 320


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.ply", b"", "no .ply file"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 100000000\nend_header\n",
            "100,000,000 faces",
        ),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 900000\nelement face 1\nend_header\n", "only 69 bytes"),
        ("a.off", b"OFF\n3 100000000 0\n", "100,000,000 faces"),
        ("a.off", b"OFF\n3 x\n", "no .off file"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 100_000_000), "100,000,000 faces"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 9000), "only 84 bytes"),
        ("a.gltf", b'{"accessors": [{"count": 100000000}]}', "100,000,000 faces"),
        ("a.gltf", b"{", "no .gltf file"),
        ("a.glb", b"glTF" + b"\0" * 40, "no .glb file"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\n" + XYZ + b"end_header\n0 0 0\n", "no triangle"),
        ("a.xyz", b"", "ends in .xyz"),
    ],
)
def test_faults(tmp_path, name, data, said):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ArrayFault) as caught:
        read_patches(tmp_path / name)
    assert said in str(caught.value)


def test_cut_files(tmp_path):
    """Whatever is left of a file: some patches, or an ArrayFault."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    for suffix in (".ply", ".stl", ".off", ".glb"):
        data = ball.export(file_type=suffix[1:])
        data = data.encode() if isinstance(data, str) else data
        for part in (0.05, 0.3, 0.7, 0.99):
            (tmp_path / f"cut{suffix}").write_bytes(data[: int(part * len(data))])
            try:
                mesh, _ = read_patches(tmp_path / f"cut{suffix}")
            except ArrayFault:
                continue
            assert 0 < len(mesh.control_points) <= 80 and np.isfinite(mesh.control_points).all()
