"""Scene files: what a good one may say, and that a bad one gives one message: file, line, key, value, what is allowed."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tiler
from tiler.errors import TilerError
from tiler.scene import catalog
from tiler.scene.model import CameraKey
from tiler.scene.toml_lines import toml_lines

CAMERA = """[[camera.key]]
frame = 0
eye = [0, -9, 3]
target = [0, 0, 0]
"""
OBJECT = """[[object]]
builder = "teapot"
"""


def patch():
    """One flat patch (1, 4, 4, 3)."""
    points = np.zeros((1, 4, 4, 3), np.float32)
    points[..., 0], points[..., 1] = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    return points


@pytest.fixture
def folder(tmp_path):
    """A folder with array files, good and bad."""
    good = patch()
    weighted = np.concatenate([good * 2, np.full((1, 4, 4, 1), 2, np.float32)], axis=3)
    np.save(tmp_path / "flat.npy", good)
    np.savez(tmp_path / "flat.npz", P=good, texcoords=np.arange(8, dtype=np.float32).reshape(1, 4, 2))
    np.savez(tmp_path / "weighted.npz", P=weighted)
    np.save(tmp_path / "ramp.npy", np.arange(12, dtype=np.float32).reshape(3, 4))

    bad = good.copy()
    bad[0, 2, 1, 0] = np.nan
    np.save(tmp_path / "nan.npy", bad)
    np.save(tmp_path / "huge.npy", np.where(good == 3, 1e300, good.astype(np.float64)))
    np.save(tmp_path / "whole.npy", good.astype(np.int32))
    np.save(tmp_path / "none.npy", good[:0])
    np.savez(tmp_path / "nothing.npz")
    np.savez(tmp_path / "other.npz", Q=good)
    np.savez(tmp_path / "coords.npz", P=good, texcoords=np.zeros((1, 4, 3), np.float32))
    weighted[0, 0, 3, 3] = 0
    np.savez(tmp_path / "weightless.npz", P=weighted)
    np.save(tmp_path / "objects.npy", np.array([print]), allow_pickle=True)
    np.save(tmp_path / "cube.npy", np.zeros((2, 2, 2), np.float32))
    np.save(tmp_path / "hole.npy", np.array([[0, 1], [np.inf, 2]], np.float32))
    (tmp_path / "text.npy").write_text("not an array")
    (tmp_path / "empty.npy").write_bytes(b"")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "flat.npz").read_bytes()[:200])
    (tmp_path / "folder.npy").mkdir()
    with open(tmp_path / "archive.npy", "wb") as file:
        np.savez(file, P=good)
    return tmp_path


def load(folder, text):
    file = folder / "scene.toml"
    file.write_text(text)
    return tiler.load_scene(file)


def error_of(folder, text):
    with pytest.raises(TilerError) as caught:
        load(folder, text)
    return str(caught.value)


# --- Good files ---------------------------------------------------------------------------------------------------


def test_the_least_file(folder):
    scene = load(folder, CAMERA + OBJECT)
    assert (scene.name, scene.num_patches, scene.frames, scene.title) == ("scene", 32, 1, "")
    assert scene.camera.keys == (CameraKey(0, (0, -9, 3), (0, 0, 0)),)
    assert (scene.picture.width, scene.picture.height, scene.picture.samples) == (1280, 720, 1)
    assert scene.tessellation.factor == (16,) * 6 and scene.tessellation.edge_pixels is None
    assert (scene.map_id == -1).all() and scene.maps == ()
    assert np.array_equal(scene.transforms, np.eye(4, dtype=np.float32)[None, :3])


def test_everything_a_file_may_say(folder):
    scene = load(
        folder,
        """
        title = "all"
        frames = 8
        face_cull = "none"
        light = [1, 0, 0.5]
        picture = { width = 64, height = 48, samples = 4, shading = "patch", background = [1, 2, 3] }

        [tessellation]
        partitioning = "fractional_odd"
        edge_pixels = 12.5
        max_factor = 32

        [camera]
        up = [0, 1, 0]
        fov = 60
        near = 1
        far = 10
        key = [
            { frame = 0, eye = [0, 0, 5], target = [0, 0, 0] },  # a remark
            { frame = 7.5, eye = [1, 0, 5], target = [0, 0, 0] },
        ]

        [[object]]
        patches = "flat.npz"
        translate = [1, 2, 3]
        rotate = [0, 0, 90]
        scale = 2

        [object.displacement]
        map = "ramp.npy"
        address = "mirror"
        scale = -0.5
        bias = 0.25

        [[object]]
        patches = "weighted.npz"

        [[object]]
        builder = "waves"
        scale = [1, 2, 4]
        parameters = { n = 2 }
        displacement = { map = "sea", size = 16, seed = 3 }
        """,
    )
    assert (scene.title, scene.frames, scene.face_cull, scene.light) == ("all", 8, "none", (1, 0, 0.5))
    assert (scene.picture.width, scene.picture.shading, scene.picture.background) == (64, "patch", (1, 2, 3))
    assert (scene.tessellation.partitioning, scene.tessellation.edge_pixels) == ("fractional_odd", 12.5)
    assert (scene.tessellation.max_factor, scene.camera.up, scene.camera.fov) == (32, (0, 1, 0), 60)
    assert [key.frame for key in scene.camera.keys] == [0, 7.5]
    assert scene.object_id.tolist() == [0, 1, 2, 2, 2, 2] and scene.map_id.tolist() == [0, -1, 1, 1, 1, 1]
    assert np.array_equal(scene.transforms[0], [[0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3]])
    assert np.array_equal(scene.transforms[2][:, :3], np.diag([1, 2, 4]))
    assert np.array_equal(scene.control_points[0, ..., :3], patch()[0]) and (scene.control_points[1, ..., 3] == 2).all()
    assert np.array_equal(scene.texcoords[0].ravel(), np.arange(8))
    assert np.array_equal(scene.texcoords[1], [(0, 0), (1, 0), (0, 1), (1, 1)])
    ramp, sea = scene.maps
    assert ramp.texels.shape == (3, 4) and (ramp.address, ramp.scale, ramp.bias) == ("mirror", -0.5, 0.25)
    assert sea.texels.shape == (16, 16) and (sea.address, sea.scale, sea.bias) == ("wrap", 1, 0)


def test_arguments_stand_in_place_of_the_file():
    scene = tiler.load_scene("teapot", size=(np.int64(64), 32), samples=4, shading="normal", factor=(1, 2, 3, 4, 5, 6))
    assert (scene.picture.width, scene.picture.height, scene.picture.samples) == (64, 32, 4)
    assert scene.picture.shading == "normal"
    assert scene.picture.background == tiler.load_scene("teapot").picture.background
    assert scene.tessellation.factor == (1, 2, 3, 4, 5, 6)
    assert tiler.load_scene("teapot", factor=7).tessellation.factor == (7,) * 6
    assert tiler.load_scene("teapot", edge_pixels=8, partitioning="pow2").tessellation.edge_pixels == 8


def test_factor_and_edge_pixels_replace_each_other(folder):
    (folder / "edges.toml").write_text("tessellation.edge_pixels = 9\n" + CAMERA + OBJECT)
    assert tiler.load_scene(folder / "edges.toml", factor=5).tessellation.edge_pixels is None
    (folder / "fixed.toml").write_text("tessellation.factor = 9\n" + CAMERA + OBJECT)
    assert tiler.load_scene(str(folder / "fixed.toml"), edge_pixels=5).tessellation.edge_pixels == 5


def test_byte_order_mark_and_dos_lines(folder):
    text = ("title = 'x'\n" + CAMERA + OBJECT).replace("\n", "\r\n")
    (folder / "dos.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert tiler.load_scene(folder / "dos.toml").title == "x"


# --- Bad files: one fault each ------------------------------------------------------------------------------------

PICTURE = "[picture]\n"
TESSELLATION = "[tessellation]\n"
DISPLACED = CAMERA + OBJECT + "[object.displacement]\n"


def eye_line(eye="[0, -9, 3]", target="[0, 0, 0]", more=""):
    return f"[camera]\n{more}\n[[camera.key]]\nframe = 0\neye = {eye}\ntarget = {target}\n"


BAD_VALUES = [  # text put before camera and object; the line and the words of the message
    ('titel = "x"\n', 1, ["titel: unknown key", "did you mean 'title'?"]),
    ("title = 3\n", 1, ["title: 3 is not allowed", "a text"]),
    ("zzz = 1\n", 1, ["zzz: unknown key", "allowed: title, frames, face_cull, light, picture"]),
    ("frames = 0\n", 1, ["frames: 0", "from 1 to 1000000"]),
    ("frames = 2.5\n", 1, ["frames: 2.5", "whole number"]),
    ("frames = " + "9" * 400 + "\n", 1, ["frames: a very large whole number"]),
    ('face_cull = "front-face"\n', 1, ['"front-face"', "none, front, back", "did you mean 'front'?"]),
    ("light = [0, 0, 0.0]\n", 1, ["light: [0, 0, 0.0]", "not all 0"]),
    ("light = [0, nan, 1]\n", 1, ["light[1]: nan", "three numbers"]),
    ("picture = 5\n", 1, ["picture: 5", "a table"]),
    (PICTURE + "heigth = 720\n", 2, ["picture.heigth: unknown key", "did you mean 'height'?"]),
    (PICTURE + "width = 0\n", 2, ["picture.width: 0", "from 1 to 16384"]),
    (PICTURE + "\n# remark\nheight = 16385\n", 4, ["picture.height: 16385", "from 1 to 16384"]),
    (PICTURE + "width = 640.0\n", 2, ["picture.width: 640.0", "whole number"]),
    (PICTURE + 'width = "640"\n', 2, ['picture.width: "640"', "whole number"]),
    (PICTURE + "width = true\n", 2, ["picture.width: true", "whole number"]),
    (PICTURE + "samples = 2\n", 2, ["picture.samples: 2", "allowed: 1, 4"]),
    (PICTURE + 'shading = "Lambertian"\n', 2, ["picture.shading", "wireframe", "did you mean 'lambert'?"]),
    (PICTURE + "background = [0, 0, 256]\n", 2, ["picture.background[2]: 256", "from 0 to 255"]),
    (PICTURE + "background = [0, 0]\n", 2, ["picture.background", "three whole numbers"]),
    (TESSELLATION + "factor = 0\n", 2, ["tessellation.factor: 0", "above 0 and at most 64"]),
    (TESSELLATION + "factor = 64.5\n", 2, ["tessellation.factor: 64.5", "at most 64"]),
    (TESSELLATION + "factor = inf\n", 2, ["tessellation.factor: inf"]),
    (TESSELLATION + "factor = nan\n", 2, ["tessellation.factor: nan"]),
    (TESSELLATION + "factor = [1, 2, 3]\n", 2, ["tessellation.factor: [1, 2, 3]", "six"]),
    (TESSELLATION + "factor = [1, 2, 3, 4, 5, -6]\n", 2, ["tessellation.factor: [1, 2, 3, 4, 5, -6]"]),
    (TESSELLATION + "edge_pixels = 0\n", 2, ["tessellation.edge_pixels: 0", "above 0"]),
    (TESSELLATION + "factor = 4\nedge_pixels = 8\n", 3, ["tessellation.edge_pixels", "beside factor"]),
    (TESSELLATION + "max_factor = 65\n", 2, ["tessellation.max_factor: 65", "from 1 to 64"]),
    (TESSELLATION + 'partitioning = "fractional"\n', 2, ["partitioning", "did you mean 'fractional_odd'?"]),
]

BAD_CAMERAS = [
    (eye_line(more="fov = 170"), 2, ["camera.fov: 170", "above 1 and below 170"]),
    (eye_line(more="fov = 1"), 2, ["camera.fov: 1 "]),
    (eye_line(more="near = 0"), 2, ["camera.near: 0", "above 0"]),
    (eye_line(more="near = 200"), 1, ["camera.far: 100 is not beyond near = 200"]),
    (eye_line(more="far = 0.05"), 2, ["camera.far: 0.05 is not beyond near = 0.1"]),
    (eye_line(more="up = [0, 0, 0]"), 2, ["camera.up: [0, 0, 0]", "not all 0"]),
    (eye_line(eye="[0, 0, 0]"), 6, ["camera.key[0].target", "where eye is"]),
    (eye_line(eye="[0, 0, 3]"), 6, ["camera.key[0].target", "straight along up"]),
    (eye_line(eye="[0, 1]"), 5, ["camera.key[0].eye", "three numbers"]),
    (eye_line(eye="[0, 1, 2, 3]"), 5, ["camera.key[0].eye", "three numbers"]),
    (eye_line(eye='[0, 1, "2"]'), 5, ['camera.key[0].eye[2]: "2"', "three numbers"]),
    (eye_line(target="[0, -inf, 2]"), 6, ["camera.key[0].target[1]: -inf", "three numbers"]),
    (eye_line(target="[0, 1e7, 2]"), 6, ["camera.key[0].target[1]", "1e+06"]),
    (CAMERA + CAMERA, 6, ["camera.key[1].frame: 0 does not follow 0", "rising order"]),
    ("[[camera.key]]\neye = [0, 1, 2]\ntarget = [0, 0, 0]\n", 1, ["camera.key[0].frame: is missing"]),
    ("[camera]\nfov = 30\n", 1, ["camera.key: is missing", "[[camera.key]]"]),
    ("[camera]\nkey = []\n", 2, ["camera.key: [] is not allowed", "one or more"]),
    ("", 0, ["camera: is missing", "[camera]"]),
]

BAD_OBJECTS = [  # text of the object; lines are counted from its first
    ("", 0, ["object: is missing", "[[object]]"]),
    ("object = []\n", 1, ["object: [] is not allowed", "[[object]]"]),
    ("[[object]]\n", 1, ["object[0]: none of builder, patches and mesh is given"]),
    ('[[object]]\nbuilder = "teapot"\npatches = "flat.npy"\n', 1, ["object[0]: builder and patches are given"]),
    ('[[object]]\nbuilder = "teapott"\n', 2, ['builder: "teapott"', "did you mean 'teapot'?", "spikelog"]),
    ("[[object]]\nbuilder = 4\n", 2, ["object[0].builder: 4", "one of"]),
    ('[[object]]\npatches = "cage.obj"\n', 2, ['object[0].patches: "cage.obj"', ".npz, .npy"]),
    ('[[object]]\npatches = "flat.npy"\n[object.parameters]\n', 3, ["object[0].parameters", "builders"]),
    (OBJECT + "scale = 0\n", 3, ["object[0].scale: 0", "above 0"]),
    (OBJECT + "scale = [1, 2]\n", 3, ["object[0].scale: [1, 2]", "three"]),
    (OBJECT + 'translate = "up"\n', 3, ['object[0].translate: "up"', "three numbers"]),
    (OBJECT + "rotate = [0, nan, 0]\n", 3, ["object[0].rotate[1]: nan", "degrees"]),
    (OBJECT + "[object.parameters]\nbotom = false\n", 4, ["object[0].parameters.botom", "did you mean 'bottom'?"]),
    (OBJECT + "[object.parameters]\nbottom = 1\n", 4, ["object[0].parameters.bottom: 1", "true or false"]),
    (OBJECT + OBJECT + "parameters.bottom = 1\n", 5, ["object[1].parameters.bottom: 1"]),
    ('[[object]]\nbuilder = "waves"\nparameters = { n = 129 }\n', 3, ["parameters.n: 129", "from 1 to 128"]),
    (
        '[[object]]\nbuilder = "columns"\nparameters = { across = 1, nave = 0 }\n',
        3,
        ["object[0].parameters.nave", "only row"],
    ),
    (OBJECT + "[object.displacement]\nscale = 1\n", 3, ["object[0].displacement.map: is missing"]),
    (OBJECT + '[object.displacement]\nmap = "see"\n', 4, ['map: "see"', "spikes", "did you mean 'sea'?"]),
    (OBJECT + '[object.displacement]\nmap = "sea"\nsize = 8\n', 5, ["displacement.size: 8", "from 16 to 4096"]),
    (OBJECT + '[object.displacement]\nmap = "sea"\nscale = inf\n', 5, ["displacement.scale: inf"]),
    (OBJECT + '[object.displacement]\nmap = "sea"\naddress = "repeat"\n', 5, ["wrap, mirror, clamp"]),
    (OBJECT + '[object.displacement]\nmap = "ramp.npy"\nseed = 2\n', 5, ["displacement.seed", "procedural"]),
]

BAD_PATCHES = [
    ("gone.npz", ["does not exist"]),
    ("folder.npy", ["is not a file"]),
    ("text.npy", ["is no .npy file of plain numbers"]),
    ("empty.npy", ["is no .npy file of plain numbers"]),
    ("objects.npy", ["is no .npy file of plain numbers"]),
    ("archive.npy", ["archive", "one array"]),
    ("cut.npz", ["is no .npz file of plain numbers"]),
    ("nothing.npz", ["has no array P but none"]),
    ("other.npz", ["has no array P but Q"]),
    ("cube.npy", ["(2, 2, 2)", "(n, 4, 4, 3) or (n, 4, 4, 4)"]),
    ("none.npy", ["empty mesh", "at least one patch"]),
    ("nan.npy", ["nan in P[0, 2, 1, 0]", "finite"]),
    ("huge.npy", ["1e+300 in P[", "float32"]),
    ("whole.npy", ["int32", "float32, float64"]),
    ("weightless.npz", ["w = 0 in P[0, 0, 3]", "above 0"]),
    ("coords.npz", ["texcoords of shape (1, 4, 3)", "(1, 4, 2)"]),
]

BAD_MAPS = [
    ("gone.npy", ["does not exist"]),
    ("text.npy", ["is no .npy file of plain numbers"]),
    ("objects.npy", ["is no .npy file of plain numbers"]),
    ("cube.npy", ["(2, 2, 2)", "(height, width)"]),
    ("none.npy", ["(0, 4, 4, 3)", "from 1 to 16384"]),
    ("hole.npy", ["inf in texels[1, 0]", "finite"]),
]


def assert_one_message(message, folder, line, words):
    """The message is one line that names the file, the line (0: the file says nothing near it) and all of `words`."""
    start = f"{folder / 'scene.toml'}:{line}: " if line else f"{folder / 'scene.toml'}: "
    assert message.startswith(start) and "\n" not in message, message
    for word in words:
        assert word in message, message
    assert "pydantic" not in message and "http" not in message


@pytest.mark.parametrize(("text", "line", "words"), BAD_VALUES)
def test_bad_value(folder, text, line, words):
    assert_one_message(error_of(folder, text + CAMERA + OBJECT), folder, line, words)


@pytest.mark.parametrize(("text", "line", "words"), BAD_CAMERAS)
def test_bad_camera(folder, text, line, words):
    assert_one_message(error_of(folder, text + OBJECT), folder, line, words)


@pytest.mark.parametrize(("text", "line", "words"), BAD_OBJECTS)
def test_bad_object(folder, text, line, words):
    if text.startswith("object ="):  # a key of the top, not of the camera
        assert_one_message(error_of(folder, text + CAMERA), folder, line, words)
    else:
        assert_one_message(error_of(folder, CAMERA + text), folder, line and 4 + line, words)


@pytest.mark.parametrize(("file", "words"), BAD_PATCHES)
def test_bad_patch_file(folder, file, words):
    message = error_of(folder, CAMERA + f'[[object]]\npatches = "{file}"\n')
    assert_one_message(message, folder, 6, ["object[0].patches", str(folder / file), *words])


@pytest.mark.parametrize(("file", "words"), BAD_MAPS)
def test_bad_map_file(folder, file, words):
    message = error_of(folder, DISPLACED + f'map = "{file}"\n')
    assert_one_message(message, folder, 8, ["object[0].displacement.map", str(folder / file), *words])


def test_all_faults_come_at_once_in_the_order_of_lines(folder):
    message = error_of(
        folder,
        "frames = -1\n[picture]\nwidth = 0\ncolour = 1\n[camera]\nnear = 5\nfar = 4\n[[camera.key]]\nframe = 0\n"
        "eye = [0, 0, 0]\ntarget = [0, 0, 0]\n[[object]]\nbuilder = 'waves'\n[object.parameters]\nn = 0\nm = 0\n",
    )
    places = [line.split(": ")[0:2] for line in message.splitlines()]
    assert [(int(place.rsplit(":", 1)[1]), key) for place, key in places] == [
        (1, "frames"),
        (3, "picture.width"),
        (4, "picture.colour"),
        (7, "camera.far"),
        (11, "camera.key[0].target"),
        (15, "object[0].parameters.n"),
        (16, "object[0].parameters.m"),
    ]


def test_all_bad_files_come_at_once(folder):
    message = error_of(folder, DISPLACED + 'map = "gone.npy"\n[[object]]\npatches = "nan.npy"\n')
    assert len(message.splitlines()) == 2 and "gone.npy" in message and "nan.npy" in message


@pytest.mark.parametrize(
    ("content", "place", "words"),
    [
        (b"[picture]\nwidth = \n", ":2:9: ", "not valid TOML"),
        (b"[picture]\nwidth = 1\nwidth = 2\n", ":3:", "not valid TOML"),
        (b"a = [1,\n", ":1:8: ", "not valid TOML"),
        (b"a = " + b"[" * 100_000, ": ", "nested too deeply"),
        (b"a = " + b"9" * 5000, ": ", "too many digits"),
        (b"title = 'x'\nb = '\xff'\n", ":2: ", "byte 0xff is not UTF-8"),
    ],
)
def test_text_that_is_no_toml(folder, content, place, words):
    file = folder / "scene.toml"
    file.write_bytes(content)
    with pytest.raises(TilerError) as caught:
        tiler.load_scene(file)
    assert str(caught.value).startswith(f"{file}{place}") and words in str(caught.value)


def test_no_such_scene(folder):
    known = "colonnade, creature, creature_small, spikelog, teapot, waves"
    for source, words in (
        ("teapott", ["scene: 'teapott'", known, "did you mean 'teapot'?"]),
        ("qqq", ["scene: 'qqq'", known]),
        (folder / "gone.toml", ["gone.toml: no such scene file"]),
        (str(folder / "gone"), ["gone: no such scene file"]),
        (folder, [f"{folder}: is a folder"]),
        (os.devnull, ["is not a text file"]),
        (7, ["scene: 7", "a name, or the path"]),
    ):
        with pytest.raises(TilerError) as caught:
            tiler.load_scene(source)
        assert all(word in str(caught.value) for word in words), caught.value


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"size": (0, 720)}, ["size: 0", "from 1 to 16384"]),
        ({"size": (1280, 16385)}, ["size: 16385", "from 1 to 16384"]),
        ({"size": (1280.5, 720)}, ["size: 1280.5", "whole number"]),
        ({"size": 720}, ["size: 720", "(width, height)"]),
        ({"size": (None, 720)}, ["size: (None, 720)", "(width, height)"]),
        ({"size": "12"}, ["size: '12'", "(width, height)"]),
        ({"samples": 8}, ["samples: 8", "1, 4"]),
        ({"shading": "norml"}, ["shading", "did you mean 'normal'?"]),
        ({"factor": 65}, ["factor: 65", "at most 64"]),
        ({"factor": (1, 2)}, ["factor: [1, 2]", "six"]),
        ({"factor": float("nan")}, ["factor: nan"]),
        ({"edge_pixels": -1}, ["edge_pixels: -1", "above 0"]),
        ({"edge_pixels": float("inf")}, ["edge_pixels: inf"]),
        ({"factor": 4, "edge_pixels": 8}, ["edge_pixels", "factor"]),
        ({"partitioning": "even"}, ["partitioning", "fractional_even"]),
    ],
)
def test_bad_arguments(arguments, words):
    with pytest.raises(TilerError) as caught:
        tiler.load_scene("teapot", **arguments)
    assert all(word in str(caught.value) for word in words), caught.value


# --- Where scenes are found, and what is imported when ------------------------------------------------------------


def test_a_folder_of_ones_own(folder, monkeypatch):
    (folder / "mine.toml").write_text("title = 'Mine'\n" + CAMERA + OBJECT)
    (folder / "teapot.toml").write_text("a broken file does not hide a built-in scene")
    monkeypatch.setenv("TILER_SCENES", str(folder))
    assert "mine" in tiler.scene_names() and tiler.load_scene("mine").title == "Mine"
    assert tiler.load_scene("teapot").title == "Utah teapot"


def test_no_folder_at_all(folder, monkeypatch):
    monkeypatch.setattr(catalog, "__file__", str(folder / "tiler" / "scene" / "catalog.py"))
    monkeypatch.delenv("TILER_SCENES", raising=False)
    assert tiler.scene_names() == []
    with pytest.raises(TilerError, match="TILER_SCENES"):
        tiler.load_scene("teapot")


def test_an_installed_package_has_its_own_folder(folder, monkeypatch):
    for place, name in ((folder / "scenes", "beside"), (folder / "tiler" / "_scenes", "inside")):
        place.mkdir(parents=True)
        (place / f"{name}.toml").write_text(CAMERA + OBJECT)
    monkeypatch.setattr(catalog, "__file__", str(folder / "tiler" / "scene" / "catalog.py"))
    assert tiler.scene_names() == ["inside"]


def test_imports_stay_light():
    code = "import sys, tiler, tiler.scene, tiler.scene.camera; print([m for m in ('pydantic', 'PIL') if m in sys.modules])"
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, check=True)
    assert done.stdout.strip() == "[]"


# --- The reader of line numbers -----------------------------------------------------------------------------------


def test_lines_of_keys():
    text = '''# remark [a]
a.b = 1 # [x]
"quoted key" = """
[not.a.table]
x = 3
"""
c = [ # first
  "]", { d = 1, e = [2,
    3] },
]
[t]
f = 'it''s'
[[t.list]]
g = 2020-01-01T00:00:00
[[t.list]]
[t.list.sub]
h = "\\"]"
'''.replace("'it''s'", "'# it'")
    assert toml_lines(text) == {
        ("a",): 2,
        ("a", "b"): 2,
        ("quoted key",): 3,
        ("c",): 7,
        ("c", 0): 8,
        ("c", 1): 8,
        ("c", 1, "d"): 8,
        ("c", 1, "e"): 8,
        ("c", 1, "e", 0): 8,
        ("c", 1, "e", 1): 9,
        ("t",): 11,
        ("t", "f"): 12,
        ("t", "list"): 13,
        ("t", "list", 0): 13,
        ("t", "list", 0, "g"): 14,
        ("t", "list", 1): 15,
        ("t", "list", 1, "sub"): 16,
        ("t", "list", 1, "sub", "h"): 17,
    }
