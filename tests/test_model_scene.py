"""A model file as a scene: camera, options, displacement, warnings, and what is wrong told once."""

import numpy as np
import pytest

import tiler
from tests.test_cli import tiler as run
from tiler.errors import TilerError, TilerWarning
from tiler.scene.model_scene import read_displacement

QUAD = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"


@pytest.fixture
def quad(tmp_path):
    (tmp_path / "quad.obj").write_text(QUAD + FACE)
    return tmp_path / "quad.obj"


def test_the_model_is_seen_whole(quad):
    scene = tiler.load_scene(quad, size=(96, 64))
    assert scene.num_patches == 1 and scene.tessellation.factor == (8,) * 6 and scene.title == "quad.obj, y up"
    frame = tiler.simulate(scene)
    drawn = np.isfinite(frame.depth) & (frame.depth < 1)
    assert drawn.sum() > 300 and not drawn[[0, -1]].any() and not drawn[:, [0, -1]].any()
    assert frame.counters["om_samples_visible"] == drawn.sum()


@pytest.mark.parametrize(("end", "up"), [(".npz", (0, 0, 1)), (".obj", (0, 1, 0))])
def test_up_is_guessed_by_the_kind_of_file(tmp_path, end, up):
    path = tmp_path / f"model{end}"
    if end == ".obj":
        path.write_text(QUAD + FACE)
    else:
        i = np.arange(4, dtype=np.float32)
        np.savez(path, P=np.stack(np.broadcast_arrays(i[:, None], i, 0 * i), -1)[None].astype(np.float32))
    scene = tiler.load_scene(path)
    assert scene.camera.up == up and f"{'y' if up[1] else 'z'} up" in scene.title


def test_overrides_and_displacement(quad):
    np.save(quad.parent / "map.npy", np.zeros((4, 4, 3), np.float32))
    given = read_displacement(f"{quad.parent / 'map.npy'},kind=vector,scale=0.5,bias=-1,seams=lower_face")
    scene = tiler.load_scene(quad, factor=3, shading="normal", displacement=given)
    (image,) = scene.maps
    assert image.texels.shape == (4, 4, 3) and (image.scale, image.bias, image.space) == (0.5, -1, "object")
    assert scene.meshes[0].seams == "lower_face" and scene.tessellation.factor == (3,) * 6
    assert scene.picture.shading == "normal"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sea,kind=vector", "is vector, and sea is a procedural map"),
        ("sea,space=world", "belongs to maps of vectors"),
        ("sea,colour=3", "unknown key"),
        ("map.npy,kind=vector,channel=r", "belongs to scalar maps"),
        ("sea,scale", "is not allowed; allowed: a map, then key=value pairs"),
        ("missing.png", "missing.png does not exist"),
    ],
)
def test_wrong_displacement_is_told(quad, text, told):
    with pytest.raises(TilerError, match=told):
        tiler.load_scene(quad, displacement=read_displacement(text))


def test_displacement_without_texture_coordinates_is_one_clear_error(tmp_path):
    path = tmp_path / "bare.obj"
    path.write_text(QUAD + "f 1/ 2/ 3/ 4/\n")
    assert tiler.load_scene(path).num_patches == 1
    with pytest.raises(
        TilerError, match="has 1 faces without texture coordinates in bare, and the object has a disp"
    ) as e:
        tiler.load_scene(path, displacement={"map": "sea"})
    assert str(e.value).count("texture coordinates") == 2  # the problem, and what is allowed


def test_seams_belong_to_meshes(tmp_path):
    (tmp_path / "a.toml").write_text(
        '[camera]\nkey = [{ frame = 0, eye = [1, 1, 1], target = [0, 0, 0] }]\n[[object]]\nbuilder = "waves"\n'
        'displacement = { map = "sea", seams = "lower_face" }\n'
    )
    with pytest.raises(TilerError, match=r"a.toml:5: object\[0\].displacement.seams: belongs to a mesh"):
        tiler.load_scene(tmp_path / "a.toml")
    with pytest.raises(TilerError, match="displacement: stands beside"):
        tiler.load_scene("teapot", displacement={"map": "sea"})


@pytest.mark.parametrize("text", ["f 1/1/ 2/2/ 3/3/ 4/4/", "f 1/ 2/2 3// 4/4/"])
def test_trailing_slashes_are_read(tmp_path, text):
    (tmp_path / "a.obj").write_text(QUAD + text + "\n" + FACE.replace("1/1 2/2 3/3 4/4", "1//1 2//1 3//1 4//1"))
    from tiler.scene.mesh_files import read_mesh

    ((mesh,), _) = read_mesh(tmp_path / "a.obj")
    assert mesh.face_vertices.tolist() == [0, 1, 2, 3] * 2
    bare, corners = [0, 0], [[0, 0], [1, 0], [1, 1], [0, 1]]  # (0, 0) is taken where others have texture coordinates
    first = corners if "1/1/" in text else [bare, corners[1], bare, corners[3]]
    assert mesh.texcoords[mesh.face_texcoords].tolist() == [*first, *[bare] * 4]


def test_warnings_reach_the_user(tmp_path):
    (tmp_path / "odd.obj").write_text(QUAD + "v 5 5 5\n" + FACE)
    with pytest.warns(TilerWarning, match="odd.obj: .*dropped"):
        tiler.load_scene(tmp_path / "odd.obj")
    done = run("render", "odd.obj", "--size", "48x32", "-q", cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "out" / "color.png").exists()
    lines = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    assert len(lines) == 1 and "dropped" in lines[0]
