"""Bezier View and .bpt files: degrees raised exactly, orders of points, and refused kinds."""

import numpy as np
import pytest

from tests.shared_data import shared_file
from tiler.scene import bezier_files
from tiler.scene.arrays import ArrayFault
from tiler.scene.mesh_files import read_patches


def bernstein(n, t):
    """All Bernstein polynomials of degree n at t, by the recursion."""
    row = [1.0]
    for k in range(1, n + 1):
        row = [(1 - t) * (row[i] if i < k else 0) + t * (row[i - 1] if i else 0) for i in range(k + 1)]
    return np.array(row)


def point(points, u, v):
    return np.einsum("i,j,ijc->c", bernstein(len(points) - 1, u), bernstein(points.shape[1] - 1, v), points)


def words(points):
    return "\n".join(" ".join(f"{x:.9g}" for x in row) for row in points.reshape(-1, points.shape[-1]))


def read(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return read_patches(tmp_path / name)[0].control_points


@pytest.mark.parametrize("degree_u", [1, 2, 3])
@pytest.mark.parametrize("degree_v", [1, 2, 3])
def test_raised_patches_are_the_same_surface(tmp_path, degree_u, degree_v):
    rng = np.random.default_rng(10 * degree_u + degree_v)
    points = rng.integers(-64, 64, (degree_u + 1, degree_v + 1, 3)) / 8.0
    weighted = np.concatenate([points, rng.integers(1, 32, (degree_u + 1, degree_v + 1, 1)) / 8.0], axis=2)
    degrees = f"{degree_u} {degree_v}"
    bv = f"Group 0 first of two\n5 {degrees}\n{words(points)}\ngroup 1 x\n8\n{degrees}\n{words(weighted)}\n"
    found = read(tmp_path, "a.bv", bv)
    bpt = read(tmp_path, "a.bpt", f"1\n{degree_u} {degree_v}\n{words(points.transpose(1, 0, 2))}\n")
    assert found.shape == (2, 4, 4, 4) and bpt.shape == (1, 4, 4, 4) and found.dtype == np.float32
    assert (found[0, ..., 3] == 1).all() and np.array_equal(bpt[0], found[0])
    for u, v in ((0, 0), (1, 0), (0.3, 0.8), (0.5, 0.25)):
        assert point(found[0, ..., :3], u, v) == pytest.approx(point(points, u, v), abs=1e-5)
        assert point(found[1], u, v) == pytest.approx(point(weighted, u, v), abs=1e-5)
    if degree_u == degree_v:
        assert np.array_equal(read(tmp_path, "b.bv", f"4\n{degree_u}\n{words(points)}\n")[0], found[0])


def test_teapot_goes_through_both_formats_unchanged(tmp_path):
    patches = np.load(shared_file("data", "models", "teapot_bezier_32.npz"))["P"].astype(np.float64)
    bv = read(tmp_path, "t.bv", "".join(f"5\n3 3\n{words(p)}\n" for p in patches))
    bpt = read(tmp_path, "t.bpt", "32\n" + "".join(f"3 3\n{words(p.transpose(1, 0, 2))}\n" for p in patches))
    assert np.array_equal(bv[..., :3], patches.astype(np.float32)) and np.array_equal(bpt, bv)


LINE = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.bv", "", ["has no patch"]),
        ("a.bv", "Group 0\n", ["has no patch"]),
        ("a.bv", "3\n2\n" + LINE, ["line 1", "a triangular patch", "4, 5 or 8"]),
        ("a.bv", "1\n4 1\n" + LINE, ["line 1", "a polyhedron"]),
        ("a.bv", "4\n1\n" + LINE + "10 1 1 1 1\n", ["line 7", "a PN quad"]),
        ("a.bv", "4\n1\n" + LINE + "half\n", ["line 7", "'half'"]),
        ("a.bv", "4\n4\n" + LINE, ["line 2", "'4'", "a degree", "1 to 3"]),
        ("a.bv", "5\n3\n", ["line 2", "ends", "a degree"]),
        ("a.bv", "4\n1\n0 0 0\n1 0 0\n", ["the file ends", "4 points of 3 numbers"]),
        ("a.bv", "4\n1\n0 0 0\n1 0 zero\n" + LINE, ["line 4", "'zero'"]),
        ("a.bv", "4\n1\n0 0 0\n1 0 nan\n" + LINE, ["line 4", "'nan'"]),
        ("a.bv", "4\n1\n" + LINE.replace("1 1 0", "1 1 1e99"), ["finite float32"]),
        ("a.bv", "8\n1 1\n" + LINE.replace("0\n", "0 0\n"), ["w = 0", "above 0"]),
        ("a.bpt", "", ["line 1", "ends", "the number of patches"]),
        ("a.bpt", "x\n", ["line 1", "'x'"]),
        ("a.bpt", "0\n", ["line 1", "'0'"]),
        ("a.bpt", "100000000\n1 1\n" + LINE, ["line 1", "'100000000'", "4194304"]),
        ("a.bpt", "4000000\n1 1\n" + LINE, ["line 1", "4000000 patches", "too short"]),
        ("a.bpt", "1\n1 5\n" + LINE * 9, ["line 2", "'5'"]),
        ("a.bpt", "1\n1 1\n" + LINE + "1 1\n", ["line 7", "goes on", "1 patches"]),
    ],
)
def test_faults(tmp_path, name, text, said):
    with pytest.raises(ArrayFault) as caught:
        read(tmp_path, name, text)
    assert all(word in str(caught.value) for word in said), str(caught.value)


def test_patch_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(bezier_files, "PATCH_LIMIT", 2)
    assert len(read(tmp_path, "a.bv", ("4\n1\n" + LINE) * 2)) == 2
    with pytest.raises(ArrayFault, match="more than 2 patches"):
        read(tmp_path, "a.bv", ("4\n1\n" + LINE) * 3)
