"""GLB files: read back, every vertex lies in its box, and the surface is the one that is drawn."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import tiler
from pipeline.bounds import BOUNDS
from tests.scenes import flat_patch, patch_scene
from tests.test_cli import tiler as run_tiler
from tiler.errors import TilerError
from tiler.glb import BOX_FACES, SIGNS, patch_color

FLOAT32 = 2.0**-22  # corners and vertices are rounded to float32: relative to the greatest coordinate


def read(file):
    world = trimesh.load_scene(file, process=False)
    return {name: world.geometry[world.graph[name][1]] for name in world.graph.nodes_geometry}


def leaves(box, points):
    """How far points are outside of a parallelepiped with corners `box` (8, 3), world units; 0 inside."""
    center, edges = box.mean(axis=0), (box[[4, 2, 1]] - box[0]) / 2.0
    worst = 0.0
    for k in range(3):  # its faces are spanned by the other two edges; a flat box has no such face
        normal = np.cross(edges[k - 2], edges[k - 1])
        length = np.linalg.norm(normal)
        if length > 1e-6 * np.abs(edges).max() ** 2:
            normal /= length
            worst = max(worst, float((np.abs((points - center) @ normal) - abs(edges[k] @ normal)).max()))
    return worst


@pytest.mark.parametrize("name", ["waves", "teapot", "spikelog"])
def test_every_vertex_lies_in_its_boxes(load, tmp_path, name):
    scene = load(name, factor=3)
    bounds = ["cbox", "tpatch", "npatch"]
    done = tiler.export_glb(scene, tmp_path / "s.glb", bounds=bounds, patches=range(5, 15), threads=1)
    found = read(tmp_path / "s.glb")
    assert set(found) == {f"{kind} {p}" for kind in ("patch", *bounds) for p in range(5, 15)}
    assert done == (10, 10 * len(found["patch 5"].vertices), 10 * len(found["patch 5"].faces), 30, ())
    for p in range(5, 15):
        points = np.asarray(found[f"patch {p}"].vertices)
        size = np.abs(points).max()
        for bound in bounds:
            box = np.asarray(found[f"{bound} {p}"].vertices)
            assert len(box) == 8 and leaves(box, points) <= FLOAT32 * max(size, np.abs(box).max())
            assert leaves(box, points + 1.01 * (box[7] - box[0])) > 0  # the measure can fail


def test_surface_is_the_tessellated_one_and_faces_outwards(load, tmp_path):
    scene = patch_scene([flat_patch(-1.0, -1.0, 1.0, 1.0)], factor=2.0)
    tiler.export_glb(scene, tmp_path / "s.glb", threads=1)
    patch = read(tmp_path / "s.glb")["patch 0"]
    assert sorted(map(tuple, np.asarray(patch.vertices).tolist())) == [
        (x, 0.0, z) for x in (-1.0, 0.0, 1.0) for z in (-1.0, 0.0, 1.0)
    ]
    assert len(patch.faces) == 8 and patch.area == pytest.approx(4.0)
    # What `looking_along_y` sees from the front turns left for it, which is glTF's front.
    shown = tiler.simulate(replace(scene, face_cull="back"), threads=1).counters["om_samples_visible"]
    assert shown > 0 and (np.asarray(patch.face_normals) @ (0.0, -1.0, 0.0) > 0.99).all()
    assert (np.asarray(patch.visual.vertex_colors) == patch_color(0)).all()


def test_boxes_are_closed_and_face_outwards():
    box = trimesh.Trimesh(SIGNS, BOX_FACES, process=False)
    assert box.is_watertight and box.volume == pytest.approx(8.0)


def test_boxes_of_every_bound_are_translucent_and_apart(load, tmp_path):
    tiler.export_glb(load("waves", factor=1), tmp_path / "s.glb", bounds=list(BOUNDS)[:4], patches=[3], threads=1)
    found = read(tmp_path / "s.glb")
    colors = {tuple(found[f"{name} 3"].visual.material.baseColorFactor) for name in list(BOUNDS)[:4]}
    assert len(colors) == 4 and all(color[3] == 51 for color in colors)
    assert {found[f"{name} 3"].visual.material.alphaMode for name in list(BOUNDS)[:4]} == {"BLEND"}


def test_what_has_no_surface_is_left_out(tmp_path):
    broken = flat_patch(0.0, 0.0, 1.0, 1.0)
    broken[1, 2, 0] = np.nan
    scene = patch_scene([broken, flat_patch(0.0, 0.0, 1.0, 1.0)])
    assert tiler.export_glb(scene, tmp_path / "s.glb", bounds=["cbox"], threads=1).left_out == (0,)
    assert set(read(tmp_path / "s.glb")) == {"patch 1", "cbox 1"}
    with pytest.raises(TilerError, match="none of those asked for has a finite surface"):
        tiler.export_glb(scene, tmp_path / "s.glb", patches=[0], threads=1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"file": "s.obj"}, "out: 's.obj' is not allowed; allowed: a file that ends in .glb"),
        ({"file": "no/such/folder/s.glb"}, "a file in a folder that can be written"),
        ({"bounds": ["tpach"]}, "did you mean 'tpatch"),
        ({"bounds": ["cbox", "cbox"]}, "each at most once"),
        ({"patches": [40]}, "patches: 40 is not allowed; allowed: 0 to 31"),
        ({"patches": []}, "patches: 0 are asked for; allowed: 1 to 4,096 of the scene's 32"),
    ],
)
def test_refused(load, tmp_path, arguments, words):
    file = tmp_path / arguments.pop("file", "s.glb")
    words = words.replace("out: 's.obj'", "out: .*s.obj'")
    with pytest.raises(TilerError, match=words):
        tiler.export_glb(load("teapot", factor=1), file, threads=1, **arguments)


def test_command(tmp_path):
    done = run_tiler(
        "export", "teapot", "--factor", "2", "--bounds", "tpatch", "--patches", "0..3", "--out", "t.glb", "--json", "-",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["patches"], result["boxes"], result["bounds"]) == (4, 4, ["tpatch"])
    assert len(read(tmp_path / "t.glb")) == 8
    refused = run_tiler("export", "teapot", "--patches", "3..1", cwd=tmp_path)
    assert refused.returncode == 2 and "patches: '3..1' names none" in refused.stderr
