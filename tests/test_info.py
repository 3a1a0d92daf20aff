"""`tiler info`: counts against the table of the models and against loops, and what it says of broken meshes."""

import json
import re
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
from PIL import Image

from tests.shared_data import shared_file
from tiler.errors import TilerError
from tiler.scene import texture_charts
from tiler.scene.info import file_info, info_text
from tiler.scene.mesh_counts import count_mesh
from tiler.scene.mesh_files import read_mesh
from tiler.scene.texture_charts import GRID, texture_coverage

MODELS = ["bigguy", "monsterfrog", "animated_head", "subdbox", "osd_torus", "osd_gregory_test1", "osd_nonquads"]
QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def row_of(name):
    """A model's row of the table in shared/data/models/README.md."""
    for line in shared_file("data", "models", "README.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if cells[0] == f"`{name}.obj`" and len(cells) == 9:
            return cells
    raise AssertionError(name)


def pairs(text):
    """{3: 108, 4: 1256} of '3:108 4:1256'."""
    return {int(k): int(n) for k, n in re.findall(r"(\d+):(\d+)", text)}


@pytest.mark.parametrize("name", MODELS)
def test_models_have_the_counts_of_the_table(name):
    _, vertices, quads, others, valences, ordinary, boundary, box, notes = row_of(name)
    (mesh,), _ = read_mesh(shared_file("data", "models", f"{name}.obj"))
    counts = count_mesh(mesh)
    assert counts.vertices == int(vertices) and counts.faces_of_size[4] == int(quads)
    named = {"tri": 3, "pent": 5, "hex": 6}
    wanted = {named[kind]: int(n) for n, kind in re.findall(r"(\d+) (tri|pent|hex)", others)}
    assert {n: k for n, k in counts.faces_of_size.items() if n != 4} == wanted
    interior, _, border = valences.partition("; boundary with")
    assert counts.interior_valences == pairs(interior)
    assert counts.boundary_faces == {int(k): int(n) for k, n in re.findall(r"(\d+) faces?:(\d+)", border)}
    assert counts.ordinary == int(ordinary.split()[0])
    assert counts.boundary_edges == int(boundary.split(",")[0])
    pieces = re.search(r"(\d+) (components?|pieces)", boundary)
    assert counts.components == (int(pieces[1]) if pieces else 1)
    numbers = [float(x) for x in re.findall(r"-?\d+\.?\d*", box)]
    assert [*counts.low, *counts.high] == pytest.approx(numbers, abs=6e-4)
    assert counts.warnings == () and counts.nonmanifold_edges == counts.flipped_edges == counts.split_vertices == 0
    assert counts.boundary_loops == {"osd_gregory_test1": 1, "osd_nonquads": 4}.get(name, 0)
    # Euler's formula for what is closed.
    if not counts.boundary_edges:
        genus = 1 if name in ("osd_torus", "monsterfrog") else 0  # one handle in all
        assert counts.vertices - counts.edges + counts.faces == 2 * counts.components - 2 * genus
    assert counts.faces_without_texcoords == (counts.faces if name == "subdbox" else 0), notes


def test_regular_faces():
    """Boundary rules decide about corners; 5 quads have no corner of one face, 2 have one."""
    (mesh,), _ = read_mesh(shared_file("data", "models", "osd_nonquads.obj"))
    assert count_mesh(mesh).regular == 7
    assert count_mesh(mesh._replace(boundary="edge_only")).regular == 5
    assert count_mesh(mesh).extraordinary == 10


def naive_seams(mesh):
    """Interior edges whose two faces have other texture coordinates, by a loop."""
    sides = {}
    for f in range(len(mesh.face_first) - 1):
        corners = list(range(mesh.face_first[f], mesh.face_first[f + 1]))
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            ends = sorted((int(mesh.face_vertices[c]), tuple(mesh.texcoords[mesh.face_texcoords[c]])) for c in (a, b))
            sides.setdefault((ends[0][0], ends[1][0]), []).append((ends[0][1], ends[1][1]))
    return sum(len(set(both)) > 1 for both in sides.values())


@pytest.mark.parametrize("name", ["bigguy", "monsterfrog", "osd_gregory_test1", "osd_torus"])
def test_seams_and_area(name):
    (mesh,), _ = read_mesh(shared_file("data", "models", f"{name}.obj"))
    counts = count_mesh(mesh)
    assert counts.seam_edges == naive_seams(mesh)
    quads = mesh.texcoords[mesh.face_texcoords.reshape(-1, 4)].astype(np.float64)
    diagonals = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    area = np.abs(diagonals[0][:, 0] * diagonals[1][:, 1] - diagonals[0][:, 1] * diagonals[1][:, 0]).sum() / 2
    assert counts.texture_area == pytest.approx(area)


def counted(tmp_path, text):
    (tmp_path / "mesh.obj").write_text(text)
    info = file_info(tmp_path / "mesh.obj")
    return info["objects"][0], info["warnings"]


def test_broken_meshes_are_told(tmp_path):
    fan = QUAD + "v 1 0 1\nv 0 0 1\nv 0 1 1\nv 1 1 1\n"
    part, warnings = counted(tmp_path, fan + "f 1 2 3 4\nf 2 1 6 5\nf 1 2 8 7\n")
    assert part["nonmanifold_edges"] == 1 and "1 edges have more than two faces: 1-2" in warnings[0]
    part, warnings = counted(tmp_path, fan + "f 1 2 3 4\nf 1 2 5 6\nf 3 4 7 8\n")
    assert part["flipped_edges"] == 2 and "2 edges have two faces of opposite winding: 1-2, 3-4" in warnings[0]
    part, warnings = counted(tmp_path, fan + "f 1 2 3 4\nf 1 6 5\n")
    assert part["split_vertices"] == 1 and "1 vertices join faces that share no edge there: 1" in warnings[1]
    part, warnings = counted(tmp_path, QUAD + "v 9 9 9\nf 1 2 3 4\nt crease 2/1/0 0 2 1\n")
    assert "1 vertices (5): no face has them; dropped" in warnings and part["crease_edges"] == 1
    assert any("1 creases are on no edge: 1-3" in w for w in warnings)
    assert any("1 faces have no texture coordinates" in w for w in warnings)
    part, warnings = counted(tmp_path, QUAD + "v nan 0 0\nf 1 2 3 4\nf 2 1 5\n")
    assert part["low"] == [0, 0, 0] and part["high"] == [1, 1, 0] and any("not finite" in w for w in warnings)


def test_two_closed_fans_at_a_vertex(tmp_path):
    """Two tetrahedra that touch at a point: every edge has two faces, and the vertex is still two fans."""
    points = "v 0 0 0\n" + "".join(f"v {x} {y} {z}\n" for z in (1, -1) for x, y in ((1, 0), (0, 1), (-1, -1)))
    faces = "f 2 3 4\nf 1 3 2\nf 1 4 3\nf 1 2 4\nf 5 7 6\nf 1 5 6\nf 1 6 7\nf 1 7 5\n"
    part, _ = counted(tmp_path, points + faces)
    assert part["split_vertices"] == 1 and part["boundary_edges"] == 0 and part["components"] == 1
    assert part["interior_valences"] == {"3": 6, "6": 1}


def test_against_loops_on_random_polygons(tmp_path):
    rng = np.random.default_rng(2)
    for _ in range(30):
        faces = [rng.choice(12, rng.integers(3, 6), replace=False) for _ in range(rng.integers(1, 9))]
        text = "".join(f"v {x} {x * x} 0\n" for x in range(12))
        part, _ = counted(tmp_path, text + "".join("f " + " ".join(str(v + 1) for v in face) + "\n" for face in faces))
        edges = Counter(frozenset((a, b)) for f in faces for a, b in zip(f, np.roll(f, -1), strict=True))
        assert part["edges"] == len(edges)
        assert part["boundary_edges"] == sum(n == 1 for n in edges.values())
        assert part["nonmanifold_edges"] == sum(n > 2 for n in edges.values())
        groups = []
        for face in faces:
            touching = [g for g in groups if g & set(face)]
            groups = [g for g in groups if g not in touching] + [set(face).union(*touching)]
        assert part["components"] == len(groups)


def test_patches_and_maps(tmp_path):
    info = file_info(shared_file("data", "models", "teapot_bezier_32.npz"))
    assert (info["patches"], info["collapsed_edges"], info["rational_patches"]) == (32, 8, 0)
    assert info["low"] == [-3, -2, 0] and info["high"] == pytest.approx([3.525, 2, 3.15])
    info = file_info(shared_file("data", "models", "bigguy_bezier_3570.npz"))
    assert (info["patches"], info["distinct_patches"]) == (3570, 3226)
    info = file_info(shared_file("data", "models", "monsterfrog_normal_height.png"))
    assert (info["width"], info["height"], info["channels"]) == (512, 512, ["r", "g", "b", "a"])
    assert info["range_a"] == [95 / 255, 249 / 255] and info["values"] == "8 bits"
    np.save(tmp_path / "map.npy", np.array([[1.5, np.inf, -2]], np.float32))
    info = file_info(tmp_path / "map.npy")
    assert info["kind"] == "displacement map" and info["range_grey"] == [-2, 1.5]
    assert info["warnings"] == ["channel grey has 1 texels that are not finite"]
    np.save(tmp_path / "patches.npy", np.zeros((2, 4, 4, 3), np.float32))
    assert file_info(tmp_path / "patches.npy")["patches"] == 2
    Image.fromarray(np.zeros((2, 3), np.uint8)).save(tmp_path / "grey.png")
    assert "range grey" in info_text(file_info(tmp_path / "grey.png"))


def test_faults_name_the_file(tmp_path):
    (tmp_path / "a.obj").write_text(QUAD + "f 1 2 3 9\n")
    with pytest.raises(TilerError, match=r"a\.obj: line 5: has vertex 9"):
        file_info(tmp_path / "a.obj")
    with pytest.raises(TilerError, match=r"a\.max is not allowed; allowed: .*\.obj.*\.npz.*\.png"):
        file_info(tmp_path / "a.max")


def test_command(tmp_path):
    (tmp_path / "a.obj").write_text(QUAD + "o one\nf 1 2 3 4\no two\nf 3 2 1\n")

    def run(*words):
        command = [sys.executable, "-m", "tiler", "info", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)

    done = run("a.obj", "--json", "-")
    found = json.loads(done.stdout)
    assert done.returncode == 0 and [part["name"] for part in found["objects"]] == ["one", "two"]
    assert found["objects"][0]["faces_of_size"] == {"4": 1}
    done = run("a.obj")
    assert "object two" in done.stdout and "warning: one: 1 faces have no texture coordinates" in done.stdout
    done = run("b.obj")
    assert done.returncode == 2 and done.stderr == "error: b.obj: does not exist\n" and not done.stdout


def charts(*faces):
    """Coverage of faces, each a list of (s, t)."""
    first = np.cumsum([0, *map(len, faces)])
    return texture_coverage(first, np.concatenate(faces).astype(np.float64))


def test_texture_coverage_counts_texels_once():
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    assert charts(square) == charts(square, square[::-1]) == 1
    assert charts(square / 2) == charts(square / 2, square / 2 + [1, -3]) == 0.25  # wrapped onto itself
    assert charts(square / 2, square / 2 + 0.25) == 0.25 + 0.25 - 0.0625
    assert charts(square / 2 + [0.75, 0]) == 0.25  # across the border
    assert charts(square * 3 - 1) == 1
    assert charts(square[:3]) == (GRID + 1) / (2 * GRID)  # centres on and below the diagonal
    assert charts(square * 1e6) == charts(square * np.nan) == charts(square * 0) == 0


def test_texture_coverage_of_a_model():
    """Against a search over faces, for a sample of texel centres."""
    (mesh,), _ = read_mesh(shared_file("data", "models", "monsterfrog.obj"))
    counts = count_mesh(mesh)
    st = mesh.texcoords[mesh.face_texcoords].astype(np.float64).reshape(-1, 4, 2)
    points = (np.random.default_rng(1).integers(0, GRID, (1000, 2)) + 0.5) / GRID
    covered = np.zeros(len(points), bool)
    for face in st:
        for triangle in (face[[0, 1, 2]], face[[0, 2, 3]]):
            a, b = triangle, np.roll(triangle, -1, axis=0)
            side = (b - a)[:, None, 0] * (points[None, :, 1] - a[:, None, 1])
            side -= (b - a)[:, None, 1] * (points[None, :, 0] - a[:, None, 0])
            covered |= (side >= 0).all(axis=0) | (side <= 0).all(axis=0)
    rows = np.zeros((GRID, GRID + 1), np.int64)
    texture_charts._draw_faces(mesh.face_first.astype(np.int64), st.reshape(-1, 2), rows)
    image = np.cumsum(rows, axis=1)[:, :GRID] > 0
    at = image[(points[:, 1] * GRID).astype(int), (points[:, 0] * GRID).astype(int)]
    np.testing.assert_array_equal(at, covered)
    assert counts.texture_coverage == image.mean() <= counts.texture_area + 4 * counts.edges / GRID
