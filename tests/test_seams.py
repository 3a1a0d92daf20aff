"""Texture seams: how wide they crack, closed by the lower face's displacement bit for bit, bounded, and told by validation."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.bounds.refine import gather_parts
from pipeline.bounds.vector import is_special
from pipeline.displacement import pack_maps
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.types import Address, Viewport
from tests.cages import box, read_model
from tests.naive_domain import naive_shade_patch
from tests.scenes import looking_along_y, patch_scene
from tests.shared_data import shared_file
from tests.test_cli import tiler as run
from tests.test_domain import bits, random_matrix
from tests.test_surface_patches import bumps
from tests.test_vector_maps import pack, shade, vectors, violations
from tiler import front_end
from tiler.errors import TilerError
from tiler.scene.catalog import load_scene
from tiler.scene.model import DisplacementMap, SceneMesh, Tessellation
from tiler.validation import settings_of, validate_limit, validate_watertight
from tiler.validation.watertight import pair_sides

by_basis = pytest.mark.parametrize("basis", list(Basis), ids=lambda b: b.name.lower())
SMALL = [Tessellation(partitioning=p, factor=(f,) * 6) for p, f in (("integer", 4.0), ("fractional_odd", 2.5))]


def seamed(basis=Basis.ACC, vector=False):
    """Patches of a box, each face with the unit square, seams closed; and its map."""
    points, cage = box()
    surface, _ = make_surface(cage, basis)
    return hull.surface_patches(surface, points, 0, 0, close_seams=True), vectors() if vector else bumps(size=9)


def box_scene(seams, texels=None, basis=Basis.ACC, space="world"):
    points, cage = box()
    surface, _ = make_surface(cage, basis)
    texels = np.random.default_rng(1).normal(0, 1, (16, 16)).astype(np.float32) if texels is None else texels
    scene = patch_scene([], size=(72, 48), factor=5.0, camera=looking_along_y(6.0))
    return replace(
        scene,
        meshes=(SceneMesh(surface, points, 0, 0, seams),),
        maps=(DisplacementMap(texels, scale=0.05, space=space),),
    )


def test_owners_are_the_lowest_faces():
    """Against a search over the faces, for each edge and corner of each patch."""
    _, cage = read_model("monsterfrog")
    surface, _ = make_surface(cage)
    faces = cage.face_vertices.reshape(-1, 4).tolist()
    own = cage.texcoords.reshape(-1, 4, 2)
    at_vertex: dict[int, np.ndarray] = {}
    at_edge: dict[tuple[int, int], np.ndarray] = {}
    for f, face in enumerate(faces):
        for k, v in enumerate(face):
            at_vertex.setdefault(v, own[f, k])
            for a, b in ((k, (k + 1) % 4), ((k + 1) % 4, k)):
                at_edge.setdefault((face[a], face[b]), np.array([own[f, a], own[f, b]]))
    assert 0 < len(surface.seam_edges) < len(faces)
    for p, face in enumerate(faces):
        edges = np.array([at_edge[face[a], face[b]] for a, b in ((0, 3), (0, 1), (1, 2), (3, 2))])
        corners = np.array([at_vertex[face[k]] for k in (0, 1, 3, 2)])
        row = surface.seam_id[p]
        if row >= 0:
            np.testing.assert_array_equal(surface.seam_edges[row], edges)
            np.testing.assert_array_equal(surface.seam_corners[row], corners)
        else:
            np.testing.assert_array_equal(corners, surface.texcoords[p])
            ends = surface.texcoords[p][[[0, 2], [0, 1], [1, 3], [2, 3]]]
            np.testing.assert_array_equal(edges, ends)


@by_basis
@pytest.mark.parametrize("vector", [False, True])
def test_equals_twin(basis, vector):
    patches, image = seamed(basis, vector)
    rng = np.random.default_rng(4)
    matrix, turn = random_matrix(rng), rng.normal(size=(3, 3)).astype(np.float32) if vector else None
    t = np.array([0, 1 / 16, 0.25, 0.625, 1], np.float32)
    edge = np.array([(a, b) for a in t for b in t if {a, b} & {0, 1}] + [(0.5, 0.25), (0.75, 0.125)], np.float32)
    clip, normal = shade(patches, np.tile(edge, (6, 1, 1)), pack(image, turn), matrix)
    for p, i in np.ndindex(*clip.shape[:2]):
        expected = naive_shade_patch(patches, p, image, matrix, *edge[i], turn)
        np.testing.assert_array_equal(bits(clip[p, i]), bits(expected[0]), f"patch {p} at {edge[i]}")
        np.testing.assert_array_equal(normal[p, i], expected[1], f"patch {p} at {edge[i]}")


@pytest.mark.parametrize("name", BOUNDS)
def test_bounds_hold_owners_too_and_a_planted_fault_is_found(name):
    """Every face has a part of the map of its own, and the lowest face's is high."""
    points, cage = box()
    surface, _ = make_surface(cage)
    own = 0.1 + 0.1 * np.arange(6, dtype=np.float32)[:, None, None] + 0.02 * surface.texcoords
    surface = surface._replace(
        seam_id=np.arange(6, dtype=np.int32),
        texcoords=own,
        seam_edges=np.full((6, 4, 2, 2), 0.9, np.float32),
        seam_corners=np.full((6, 4, 2), 0.9, np.float32),
    )
    patches = hull.surface_patches(surface, points, 0, 0, close_seams=True)
    texels = np.zeros((32, 32), np.float32)
    texels[27:30, 27:30] = 1
    maps = pack_maps([(texels, Address.CLAMP, 0.7, 0.0)])
    matrix = np.eye(4, dtype=np.float32)
    matrix[3, 3] = 4
    stage = hull.make_input(patches, maps, matrix, Viewport(0, 0, 64, 48, 0.0, 1.0))
    t = np.linspace(0, 1, 9, dtype=np.float32)
    uv = np.tile(np.stack(np.meshgrid(t, t), -1).reshape(-1, 2), (6, 1, 1))
    assert violations(stage, BOUNDS[name](stage), uv) == []
    assert is_special(patches, maps).all()
    parts = gather_parts(stage, np.arange(6, dtype=np.int32), np.tile([0.0, 0.5, 0.25, 0.75], (6, 1)))
    assert (parts.patches.map_id == 0).all()
    inner = uv[:, (uv[0] <= [0.5, 0.75]).all(1) & (uv[0] >= [0, 0.25]).all(1)]
    assert violations(parts, BOUNDS[name](parts), inner) == []
    if name != "cbox":  # which takes the whole map
        forgotten = stage._replace(patches=patches._replace(seam_id=np.full(6, -1, np.int32)))
        assert violations(stage, BOUNDS[name](forgotten), uv) != []


@by_basis
@pytest.mark.parametrize("vector", [False, True])
def test_seams_are_open_or_closed_as_the_scene_says(basis, vector):
    texels = vectors().texels if vector else None
    kept = validate_watertight(box_scene("keep", texels, basis), SMALL, threads=1)
    assert kept["edges"] == 12 and kept["cases"] == 24 and kept["failed"] == 0 and kept["boundary_edges"] == 0
    # The map wraps: half of the edges have s = 0 and s = 1, or t, on their sides, which is the same place.
    assert kept["seams"] == 12 and kept["open_seams"] == 6 and kept["open_edges"] == 0
    widest = kept["details"][0]
    assert widest["seam"] and not widest["failure"] and widest["crack"] == kept["largest_crack"] > 0.01
    closed = validate_watertight(box_scene("lower_face", texels, basis), SMALL, threads=1)
    assert closed["failed"] == closed["open_seams"] == 0 and closed["largest_crack"] == 0 and closed["details"] == []


def test_cracks_are_measured_in_the_world():
    """Two squares side by side, their own halves of a map that is 0 and 1: a crack of the scale."""
    texels = np.zeros((2, 4), np.float32)
    texels[:, 2:] = 1
    i = np.arange(4) / 3
    nets = np.ones((2, 4, 4, 4), np.float32)
    nets[..., 0], nets[..., 1], nets[..., 2] = i[:, None], 0, i[None, :]
    nets[1, ..., 0] += 1
    scene = patch_scene(list(nets), displacement=DisplacementMap(texels, address="clamp", scale=0.25))
    scene.texcoords[0], scene.texcoords[1] = (0.125, 0.5), (0.875, 0.5)
    found = validate_watertight(scene, SMALL, threads=1)
    assert (found["edges"], found["boundary_edges"], found["seams"], found["failed"]) == (1, 6, 1, 0)
    assert found["largest_crack"] == 0.25 and found["largest_relative"] == 0.25 / found["diagonal"]
    assert found["details"][0]["position"][0] == 1


def test_planted_cracks_are_failures(monkeypatch):
    """A normal of one edge turned a little, a factor of one edge changed: neither is a seam."""
    scene = box_scene("lower_face")
    patches = front_end.run_vertex_shader(scene, 0)
    row = patches.edge_row.copy()
    row[3, 1] = row[3, 0]
    monkeypatch.setattr(front_end, "run_vertex_shader", lambda *_: patches._replace(edge_row=row))
    assert validate_watertight(scene, SMALL, threads=1)["failed"] == 2
    monkeypatch.undo()
    uneven = [Tessellation(factor=(4.0, 5.0, 4.0, 4.0, 4.0, 4.0))]
    found = validate_watertight(scene, uneven, threads=1)
    assert found["failed"] > 0 and found["details"][0]["failure"]


def test_edges_of_patch_sets_are_found_by_their_points():
    scene = load_scene("teapot")
    sides = pair_sides(scene, front_end.run_vertex_shader(scene, 0))
    assert len(sides.seam) == 52 and not sides.may_open.any()


def test_vectors_follow_their_object():
    """In object space they turn with it, so the picture of the turned box is that of the box seen from elsewhere."""
    scene = box_scene("lower_face", vectors().texels, space="object")
    quarter = np.array([[[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]]], np.float32)
    for space in ("object", "world"):
        maps = (replace(scene.maps[0], space=space),)
        packed = front_end.scene_maps(replace(scene, maps=maps, transforms=quarter), 0)
        np.testing.assert_array_equal(packed.maps.turn[0], quarter[0, :, :3] if space == "object" else np.eye(3))
    assert len(settings_of(scene, False)) == 20 and len(settings_of(scene, True)) == 1


def test_the_command(tmp_path):
    np.save(tmp_path / "map.npy", np.random.default_rng(1).random((8, 8)).astype(np.float32))
    cube = "".join(f"v {x} {y} {z}\n" for z in (-1, 1) for y in (-1, 1) for x in (-1, 1))
    cube += "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    for face in ([1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [2, 4, 8, 6], [4, 3, 7, 8], [3, 1, 5, 7]):
        cube += "f " + " ".join(f"{v}/{k}" for k, v in enumerate(face, 1)) + "\n"
    (tmp_path / "cube.obj").write_text(cube)
    options = ("watertight", "cube.obj", "--factor", "3")
    done = run("validate", *options, "--displacement", "map.npy,scale=0.1", cwd=tmp_path)
    assert done.returncode == 0 and "12 edges of two patches" in done.stdout, done.stderr
    done = run("validate", *options, "--displacement", "map.npy,seams=lower_face", "--json", "-", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert found["what"] == "watertight" and (found["cases"], found["failed"], found["details"]) == (12, 0, [])
    uneven = ("watertight", "cube.obj", "--factor", "3,4,3,3,3,3", "--json", "-")
    done = run("validate", *uneven, cwd=tmp_path)
    assert done.returncode == 1 and json.loads(done.stdout)["failed"] > 0
    assert run("validate", "watertight", cwd=tmp_path).returncode == 2


def test_limit_reference_holds_and_a_moved_one_fails(tmp_path):
    arrays = dict(np.load(shared_file("data", "catmull_clark_limit_reference.npz")))
    some = {k: a for k, a in arrays.items() if k == "uv" or k.rpartition("__")[0] in ("cube", "torus", "nonquads_open")}
    np.savez(tmp_path / "some.npz", **some)
    found = validate_limit(tmp_path / "some.npz")
    assert found["what"] == "limit" and (found["cases"], found["failed"]) == (2 * (6 + 32 + 38), 0)
    some["torus__P"][3, 5] += 1e-5
    some["cube__N"][2, 0] = some["cube__N"][2, 0, [1, 2, 0]] * [1, -1, 1]
    np.savez(tmp_path / "moved.npz", **some)
    rows = validate_limit(tmp_path / "moved.npz")["details"]
    assert {(r["model"], r["basis"]): r["patches"] for r in rows if r["failed"]} == {
        ("cube", "acc"): [2], ("torus", "acc"): [3], ("torus", "gregory"): [3],
    }  # fmt: skip
    del some["torus__P"]
    np.savez(tmp_path / "less.npz", **some)
    with pytest.raises(TilerError, match="has no array torus__P"):
        validate_limit(tmp_path / "less.npz")
    (tmp_path / "text.npz").write_text("no")
    with pytest.raises(TilerError, match="cannot read"):
        validate_limit(tmp_path / "text.npz")
