"""OBJ files: against a reader that goes line by line, the dialect's tags, several objects, and everything that can be wrong."""

import time

import numpy as np
import pytest

from tests.shared_data import shared_file
from tiler.scene import obj
from tiler.scene.arrays import ArrayFault
from tiler.scene.mesh_files import read_mesh

MODELS = ["bigguy", "monsterfrog", "animated_head", "subdbox", "osd_torus", "osd_gregory_test1", "osd_nonquads"]
QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def naive_read(text):
    """Faces of a whole file as lists of (position, texture coordinate or None)."""
    points, texcoords, faces = [], [], []
    for line in text.replace("\\\n", " ").split("\n"):
        words = line.split("#")[0].split()
        if words[:1] == ["v"]:
            points.append(tuple(np.float32(float(w)) for w in words[1:4]))
        elif words[:1] == ["vt"]:
            texcoords.append(tuple(np.float32(float(w)) for w in (words[1:3] + ["0"])[:2]))
        elif words[:1] == ["f"]:
            faces.append([])
            for word in words[1:]:
                v, t, *_ = [*word.split("/"), ""]
                at = [int(x) - 1 if x and int(x) > 0 else int(x) if x else None for x in (v, t)]
                point = points[at[0]]
                faces[-1].append((point, None if at[1] is None else texcoords[at[1]]))
    return faces


def faces_of(mesh):
    """The same of a mesh that was read."""
    found = []
    for f in range(len(mesh.face_first) - 1):
        corners = range(mesh.face_first[f], mesh.face_first[f + 1])
        found.append(
            [
                (
                    tuple(mesh.vertices[mesh.face_vertices[c]]),
                    None if mesh.face_texcoords[c] < 0 else tuple(mesh.texcoords[mesh.face_texcoords[c]]),
                )
                for c in corners
            ]
        )
    return found


def read(tmp_path, text):
    file = tmp_path / "mesh.obj"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_mesh(file)


def fault(tmp_path, text):
    with pytest.raises(ArrayFault) as caught:
        read(tmp_path, text)
    return str(caught.value)


@pytest.mark.parametrize("block", [200, 2**24])
@pytest.mark.parametrize("name", MODELS)
def test_models_read_as_line_by_line(name, block, monkeypatch):
    monkeypatch.setattr(obj, "BLOCK", block)
    file = shared_file("data", "models", f"{name}.obj")
    meshes, warnings = read_mesh(file)
    (mesh,) = meshes
    assert faces_of(mesh) == naive_read(file.read_text())
    assert warnings == ()
    assert mesh.vertices.dtype == mesh.texcoords.dtype == np.float32
    assert mesh.face_vertices.dtype == mesh.face_first.dtype == mesh.face_texcoords.dtype == np.int32
    assert np.array_equal(np.unique(mesh.face_vertices), np.arange(len(mesh.vertices)))


ODD = """# every way to write a corner, blanks,  odd ends
v 0 0 0 1.0
v\t1 0 0   0.5 0.5 0.5
 v 1.5e0 1 +0.
v 0 1 -.0 # a comment
vt 0.25
vt 1 0 0
vt 1 1
vt 0 1
vn 0 0 1
g one
s 1
f 1/1/1 2/2/1 \\
  3/3/1 \\
  4/4/1
usemtl stone
v 2 0 1
v 2 1 1
f -5//1 -2//1 -1//1
f 2 5 6 3
f 2/1 5/-1 6/-2/1   # comment
vt .5 .5
f 3/-1/-1 6/4/-1 5/5/1

"""


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("start", [b"", b"\xef\xbb\xbf"])
def test_all_forms(tmp_path, ends, start, monkeypatch):
    expected = naive_read(ODD)
    bare = [(0.0, 0.0) for _ in range(3)]
    for block in (16, 60, 2**24):
        monkeypatch.setattr(obj, "BLOCK", block)
        (mesh,), warnings = read(tmp_path, start + ODD.replace("\n", ends).encode())
        found = faces_of(mesh)
        assert [[p for p, _ in face] for face in found] == [[p for p, _ in face] for face in expected]
        assert [t for face in found for _, t in face] == [t or bare[0] for face in expected for _, t in face]
        assert len(warnings) == 1 and "2 faces" in warnings[0] and "(1, 2)" in warnings[0]
        assert mesh.name == "mesh"


def test_objects(tmp_path):
    text = "f 1 2 3 4\no left part\nv 9 9 9\nf 3 4 1\no unused\no right\nf 5 1 2\nt corner 1/1/0 4 2.5\nt crease 2/1/0 0 1 3\n"
    meshes, warnings = read(tmp_path, QUAD + text)
    assert [m.name for m in meshes] == ["mesh", "left part", "right"] and warnings == ()
    assert [len(m.vertices) for m in meshes] == [4, 3, 3]
    assert [point for point, _ in faces_of(meshes[2])[0]] == [(9, 9, 9), (0, 0, 0), (1, 0, 0)]
    assert [len(m.crease_edges) for m in meshes] == [1, 0, 1]
    assert [m.corner_vertices.tolist() for m in meshes] == [[], [], [2]]
    assert meshes[2].corner_sharpness.tolist() == [2.5]
    assert all(m.texcoords.shape == (0, 2) and (m.face_texcoords == -1).all() for m in meshes)


def test_tags(tmp_path):
    tags = "t crease 4/2/0 0 1 2 3 2.5 10\nt crease 2/1/0 1 2 0\nt corner 2/1/0 0 2 4\nt interpolateboundary 1/0/0 2\n"
    (mesh,), warnings = read(tmp_path, QUAD + "f 1 2 3 4\n" + tags + "t creasemethod 0/0/1 chaikin\n")
    assert mesh.crease_edges.tolist() == [[0, 1], [2, 3]] and mesh.crease_sharpness.tolist() == [2.5, 10]
    assert mesh.corner_vertices.tolist() == [0, 2] and mesh.corner_sharpness.tolist() == [4, 4]
    assert mesh.boundary == "edge_only"
    assert warnings == ("tags 'creasemethod' are left out",)
    (mesh,), warnings = read(tmp_path, QUAD + "f 1 2 3 4\nt interpolateboundary 1/0/0 0\n")
    assert mesh.boundary == "edge_and_corner" and "interpolateboundary 0" in warnings[0]


def test_warnings(tmp_path):
    text = QUAD + "v 5 5 5\nv nan 0 0\nv 1e40 0 0\nl 1 2\np 1\nf 1 2 3 4\nf 4 3 6 7\n"
    (mesh,), warnings = read(tmp_path, text)
    assert len(mesh.vertices) == 6
    assert warnings[0] == "2 lines of other kinds are left out: l, p"
    assert warnings[1] == "1 vertices (5): no face has them; dropped"
    assert warnings[2].startswith("2 vertices (6, 7): not finite")
    assert np.isnan(mesh.vertices[4, 0]) and np.isinf(mesh.vertices[5, 0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["has no face"]),
        (QUAD, ["has no face"]),
        ("# nothing\n\n", ["has no face"]),
        (QUAD + "f 1 2 3 5\n", ["line 5", "vertex 5", "1 to 4"]),
        (QUAD + "f 1 2 3 0\n", ["line 5", "vertex 0", "1 to 4"]),
        (QUAD + "f 1 2 3 -5\n", ["line 5", "vertex -5", "-4 to -1"]),
        ("f -1 -2 -3\n" + QUAD, ["line 1", "vertex -1"]),
        (QUAD + "f 1 2 3 99999999999999999999\n", ["line 5", "whole number"]),
        (QUAD + f"f 1 2 3 {2**62}\n", ["line 5", "whole number"]),
        (QUAD + "f 1/1 2/1 3/1\n", ["line 5", "texture coordinate 1", "none"]),
        (QUAD + "vt 0 0\n\nf 1/1 2/2 3/1\n", ["line 7", "texture coordinate 2", "1 to 1"]),
        (QUAD + "f 1 2\n", ["line 5", "2 vertices", "at least 3"]),
        (QUAD + "f\n", ["line 5", "0 vertices"]),
        (QUAD + "f 1 2 3 1\n", ["line 5", "vertex 1 twice"]),
        (QUAD + "f 1 2 x 4\n", ["line 5", "'x'", "whole number"]),
        (QUAD + "f 1 2 3.5 4\n", ["line 5", "'3.5'"]),
        (QUAD + "f /1 2/ 3/\n", ["line 5", "'/1'", "v/vt"]),
        (QUAD + "f 1/1/1/1 2 3\n", ["line 5", "'1/1/1/1'"]),
        (QUAD + "f 1//// 2 3\n", ["line 5", "'1////'"]),
        (QUAD + "f / 2 3\n", ["line 5", "'/'"]),
        ("v 0 0\n" + QUAD + "f 1 2 3\n", ["line 1", "v has 2 numbers", "3"]),
        (QUAD + "v 0 0 zero\nf 1 2 3\n", ["line 5", "'zero'", "not a number"]),
        (QUAD + "v 0 0 1_0\nf 1 2 3\n", ["line 5", "'1_0'"]),
        (QUAD + "v 1,5 0 0\nf 1 2 3\n", ["line 5", "'1,5'"]),
        (QUAD + "vt\nf 1 2 3\n", ["line 5", "vt has 0 numbers"]),
        (QUAD + "f 1 2 3\nv 0.25 0.", ["line 6", "v has 2 numbers", "cut short"]),
        (QUAD + "f 1 2 3 4\nf 3 2", ["line 6", "2 vertices", "cut short"]),
        (QUAD + "f 1 2 3\nt crease 2/1/0 0 4 1\n", ["line 6", "vertex 4", "0 to 3"]),
        (QUAD + "f 1 2 3\nt crease 2/1/0 0\n", ["line 6", "1 values", "needed: 3"]),
        (QUAD + "f 1 2 3\nt crease 3/1/0 0 1 2 1\n", ["line 6", "pairs of vertices"]),
        (QUAD + "f 1 2 3\nt crease 0 1 1\n", ["line 6", "INTEGERS/FLOATS/STRINGS"]),
        (QUAD + "f 1 2 3\nt corner 1/1/0 0 sharp\n", ["line 6", "'sharp'"]),
        (QUAD + "f 1 2 3\nt corner 1/1/0 0 -1\n", ["line 6", "'-1'", "from 0"]),
        (QUAD + "f 1 2 3\nt corner 1/1/0 0 nan\n", ["line 6", "'nan'"]),
        (QUAD + "f 1 2 3\nt interpolateboundary 1/0/0 3\n", ["line 6", "0, 1 or 2"]),
    ],
)
def test_faults(tmp_path, text, words):
    for ends in ("\n", "\r\n"):
        message = fault(tmp_path, text.replace("\n", ends))
        assert all(word in message for word in words), message
        assert "\n" not in message and len(message) < 300


def test_no_file(tmp_path):
    for path, words in ((tmp_path / "none.obj", "does not exist"), (tmp_path, "ends in nothing")):
        with pytest.raises(ArrayFault, match=words):
            read_mesh(path)
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ArrayFault, match="is not a file"):
        read_mesh(tmp_path / "folder.obj")


def test_line_numbers_far_down(tmp_path, monkeypatch):
    monkeypatch.setattr(obj, "BLOCK", 64)
    text = QUAD + "f 1 2 3 \\\n4\n" * 50 + "f 1 2 3 7\n"
    assert fault(tmp_path, text).startswith("line 105:")
    text = QUAD + "f 1 2 3 \\\n4\n" * 50 + "f 1 2 3 seven\n"
    assert fault(tmp_path, text).startswith("line 105:")


@pytest.mark.parametrize("block", range(8, 60, 3))
def test_blocks_end_where_lines_do(tmp_path, block, monkeypatch):
    monkeypatch.setattr(obj, "BLOCK", block)
    text = QUAD + "f 1 2 \\\n3 4\n" + "# a comment that is longer than a block or two, " * 3 + "\nf 4 3 \\\n2 \\\n1"
    (mesh,), _ = read(tmp_path, text)
    assert mesh.face_vertices.tolist() == [0, 1, 2, 3, 3, 2, 1, 0]


def test_too_large_files_are_refused_before_they_are_read(tmp_path, monkeypatch):
    huge = tmp_path / "huge.obj"
    with huge.open("wb") as file:
        file.truncate(obj.FILE_LIMIT + 1)  # a sparse file: no such bytes on the disk
    with pytest.raises(ArrayFault, match=r"2,147,483,649 bytes; allowed: at most 2,147,483,648"):
        read_mesh(huge)
    monkeypatch.setattr(obj, "CORNER_LIMIT", 30)
    assert "11 faces" in fault(tmp_path, QUAD + "f 1 2 3\n" * 11)
    assert "more than 30 face corners" in fault(tmp_path, QUAD + "f 1 2 3 4\n" * 8)
    monkeypatch.setattr(obj, "VERTEX_LIMIT", 3)
    assert "3 vertices" in fault(tmp_path, QUAD + "f 1 2 3 4\n")


def test_random_bytes_never_do_more_than_fail(tmp_path):
    """Files cut, and with bytes changed: a mesh or an ArrayFault, nothing else."""
    rng = np.random.default_rng(5)
    good = ODD.encode() + b"t crease 2/1/0 0 1 2\n"
    results = set()
    for _ in range(400):
        data = bytearray(good[: rng.integers(len(good))] if rng.random() < 0.3 else good)
        for _ in range(rng.integers(1, 4)):
            if data:
                data[rng.integers(len(data))] = rng.choice(list(b" \n/-0129.evft\\\x00\xff"))
        try:
            meshes, _ = read(tmp_path, bytes(data))
        except ArrayFault:
            results.add("fault")
            continue
        results.add("mesh")
        for mesh in meshes:
            assert mesh.face_vertices.min() >= 0 and mesh.face_vertices.max() < len(mesh.vertices)
            assert mesh.face_texcoords.max() < max(len(mesh.texcoords), 1)
            assert (np.diff(mesh.face_first) >= 3).all() and mesh.face_first[-1] == len(mesh.face_vertices)
    assert results == {"fault", "mesh"}


@pytest.mark.timing
def test_a_hundred_thousand_quads_in_about_half_a_second(tmp_path):
    n = 317
    rng = np.random.default_rng(0)
    lines = [f"v {a:.6f} {b:.6f} {c:.6f}\nvt {a:.6f} {b:.6f}\n" for a, b, c in rng.normal(size=((n + 1) ** 2, 3))]
    at = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel() + 1
    lines += [f"f {k}/{k} {k + n + 1}/{k + n + 1} {k + n + 2}/{k + n + 2} {k + 1}/{k + 1}\n" for k in at]
    (tmp_path / "mesh.obj").write_text("".join(lines))
    start = time.perf_counter()
    (mesh,), _ = read_mesh(tmp_path / "mesh.obj")
    assert time.perf_counter() - start < 2.0 and len(mesh.face_first) == n * n + 1
