"""Displacement maps of picture files: which channel, which scale, which way up, and what is refused."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

import tiler
from tests.shared_data import shared_file
from tiler.errors import TilerError
from tiler.scene import map_files
from tiler.scene.arrays import ArrayFault
from tiler.scene.map_files import read_image, read_map, read_vector_map

GREY8 = np.array([[0, 51, 255], [128, 3, 4]], np.uint8)  # top row first
GREY16 = GREY8.astype(np.uint16) * np.uint16(257) + (GREY8 == 51).astype(np.uint16)
FLOAT = np.array([[0.25, -1.5, 1e-7], [3e8, 0, -0.0]], np.float32)


def save(path, array, **options):
    Image.fromarray(array).save(path, **options)
    return path


def fault(path, *arguments):
    with pytest.raises(ArrayFault) as caught:
        read_map(path, *arguments)
    return str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".TIFF"])
def test_grey(tmp_path, suffix):
    eight, sixteen = read_map(save(tmp_path / f"a{suffix}", GREY8)), read_map(save(tmp_path / f"b{suffix}", GREY16))
    assert np.array_equal(eight, (GREY8[::-1] / 255).astype(np.float32))
    assert np.array_equal(sixteen, (GREY16[::-1] / 65535).astype(np.float32))
    for texels in (eight, sixteen):
        assert texels.dtype == np.float32 and texels.flags.c_contiguous and texels.flags.writeable
    assert eight[1].tolist() == [0, np.float32(0.2), 1]  # the top row is the last


def test_big_endian_tiff(tmp_path):
    path = tmp_path / "a.tif"
    pixels = GREY16.astype(">u2").tobytes()
    short, long = 3, 4  # kinds of number in a tag
    tags = {256: (short, 3), 257: (short, 2), 258: (short, 16), 259: (short, 1), 262: (short, 1), 273: (long, 200)}
    tags |= {277: (short, 1), 278: (short, 2), 279: (long, 12)}
    entries = b"".join(
        struct.pack(">HHI", tag, kind, 1)
        + (struct.pack(">HH", value, 0) if kind == short else struct.pack(">I", value))
        for tag, (kind, value) in tags.items()
    )
    head = b"MM\0*" + struct.pack(">IH", 8, len(tags)) + entries + b"\0" * 4
    path.write_bytes(head.ljust(200, b"\0") + pixels)
    assert np.array_equal(read_map(path), (GREY16[::-1] / 65535).astype(np.float32))


def test_channels(tmp_path):
    rgba = np.stack([GREY8, GREY8 // 2, GREY8 // 3, 255 - GREY8], axis=2)
    path = save(tmp_path / "a.png", rgba)
    for k, name in enumerate("rgba"):
        assert np.array_equal(read_map(path, name), (rgba[::-1, :, k] / 255).astype(np.float32))
    assert "r, g, b, a that differ" in fault(path)
    assert "no channel grey; allowed: r, g, b, a" in fault(path, "grey")
    same = save(tmp_path / "b.png", np.stack([GREY8] * 3 + [255 - GREY8], axis=2))
    assert np.array_equal(read_map(same), (GREY8[::-1] / 255).astype(np.float32))
    both = save(tmp_path / "c.png", np.stack([GREY8, 255 - GREY8], axis=2))
    assert np.array_equal(read_map(both), (GREY8[::-1] / 255).astype(np.float32))
    assert np.array_equal(read_map(both, "a"), ((255 - GREY8)[::-1] / 255).astype(np.float32))
    assert np.array_equal(read_vector_map(path), (rgba[::-1, :, :3] / 255).astype(np.float32))
    with pytest.raises(ArrayFault, match="r, g and b"):
        read_vector_map(both)


def test_palette_and_bits(tmp_path):
    image = Image.fromarray(np.array([[0, 1], [1, 0]], np.uint8), "P")
    image.putpalette([0, 0, 0, 200, 200, 200])
    image.save(tmp_path / "p.png")
    assert np.array_equal(read_map(tmp_path / "p.png"), np.array([[200, 0], [0, 200]], np.float32) / np.float32(255))
    Image.fromarray(np.array([[True, False]])).save(tmp_path / "one.png")
    assert read_map(tmp_path / "one.png").tolist() == [[1, 0]]


def test_float_tiff(tmp_path):
    texels = read_map(save(tmp_path / "a.tiff", FLOAT))
    assert texels.tobytes() == FLOAT[::-1].tobytes()
    save(tmp_path / "b.tiff", np.array([[0, np.nan]], np.float32))
    assert "nan in texels[0, 1]" in fault(tmp_path / "b.tiff")


def test_arrays_are_not_turned(tmp_path):
    np.save(tmp_path / "a.npy", FLOAT)
    assert read_map(tmp_path / "a.npy").tobytes() == FLOAT.tobytes()
    vectors = np.arange(18, dtype=np.float64).reshape(2, 3, 3)
    np.save(tmp_path / "v.npy", vectors)
    assert np.array_equal(read_vector_map(tmp_path / "v.npy"), vectors)
    assert "r, g, b that differ" in fault(tmp_path / "v.npy")
    np.save(tmp_path / "i.npy", GREY8)
    assert "type uint8" in fault(tmp_path / "i.npy")


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr(tmp_path, dtype, capfd):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}

    def write(name, channels):
        with OpenEXR.File(header, channels) as file:
            file.write(str(tmp_path / name))
        return tmp_path / name

    values = FLOAT.clip(-2, 2).astype(dtype)
    expected = values.astype(np.float32)[::-1]
    assert np.array_equal(read_map(write("z.exr", {"Z": values})), expected)
    assert np.array_equal(read_map(write("y.exr", {"Y": values})), expected)
    path = write("rgb.exr", {"R": values, "G": -values, "B": values * 0, "A": values})
    assert np.array_equal(read_map(path, "g"), -expected)
    assert np.array_equal(read_vector_map(path), np.stack([expected, -expected, expected * 0], axis=2))
    assert "that differ" in fault(path)
    data = path.read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: len(data) - 20])
    capfd.readouterr()
    assert "cannot be decoded (" in fault(tmp_path / "cut.exr")
    assert capfd.readouterr().out == ""  # standard output belongs to --json -
    at = data.index(b"dataWindow\0box2i\0") + 21
    wide = data[:at] + struct.pack("<4i", 0, 0, 19999, 1) + data[at + 16 :]
    (tmp_path / "wide.exr").write_bytes(wide)
    assert "20000 x 2 texels" in fault(tmp_path / "wide.exr")
    (tmp_path / "none.exr").write_bytes(b"not an image")
    assert "no EXR file" in fault(tmp_path / "none.exr")
    assert "uint32; allowed: half, float" in fault(write("whole.exr", {"Z": GREY8.astype(np.uint32)}))


def test_missing_extra(tmp_path, monkeypatch):
    import sys

    (tmp_path / "a.exr").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    assert "pip install 'tilesim[exr]'" in fault(tmp_path / "a.exr")


def png(width, height, bits=8, colour=0, data=b""):
    """A PNG file with this header; `data` are its rows."""

    def chunk(name, content):
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


def test_bad_pictures(tmp_path):
    good = save(tmp_path / "good.png", np.arange(10000, dtype=np.uint16).reshape(100, 100)).read_bytes()
    cases = {
        "empty.png": (b"", "no PNG file"),
        "text.png": (b"hello", "no PNG file"),
        "cut.png": (good[: len(good) // 2], "cannot be decoded"),
        "head.png": (good[:40], "no PNG file"),
        "wide.png": (png(16385, 1), "16385 x 1 texels; allowed: from 1 to 16384"),
        "large.png": (png(16384, 9000), "16384 x 9000 texels"),
        "bomb.png": (png(16384, 16384), "texels"),
        "huge.png": (png(2**30, 2**30), "texels"),
        "deep.png": (png(1, 1, 16, 2, b"\0" + b"\1\2" * 3), "several channels of 16 bits"),
        "tiff.png": (save(tmp_path / "x.tif", GREY8).read_bytes(), "no PNG file"),
        "png.tif": (good, "no TIFF file"),
        "a.jpg": (good, "ends in .jpg"),
    }
    for name, (data, said) in cases.items():
        (tmp_path / name).write_bytes(data)
        assert said in fault(tmp_path / name), name
    assert "does not exist" in fault(tmp_path / "absent.png")
    frames = [Image.fromarray(GREY8), Image.fromarray(255 - GREY8)]
    for name in ("moving.png", "pages.tif"):
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
        assert "has 2 pictures; allowed: one" in fault(tmp_path / name)
    Image.fromarray(np.stack([GREY8] * 4, axis=2), "CMYK").save(tmp_path / "ink.tif")
    assert "kind CMYK" in fault(tmp_path / "ink.tif")


def test_damaged_pictures_never_do_more_than_fail(tmp_path):
    rng = np.random.default_rng(3)
    for suffix in (".png", ".tif"):
        good = save(tmp_path / f"good{suffix}", (np.arange(600) % 251).astype(np.uint8).reshape(20, 30)).read_bytes()
        failed = 0
        for _ in range(150):
            data = bytearray(good)
            for _ in range(3):
                data[rng.integers(len(data))] = rng.integers(256)
            (tmp_path / f"bad{suffix}").write_bytes(data)
            try:
                assert read_map(tmp_path / f"bad{suffix}").ndim == 2
            except ArrayFault:
                failed += 1
        assert failed > 10


def test_monsterfrog_map():
    image = read_image(shared_file("data", "models", "monsterfrog_normal_height.png"))
    assert image.channels == ("r", "g", "b", "a") and image.texels.shape == (512, 512, 4)
    texels = read_map(shared_file("data", "models", "monsterfrog_normal_height.png"), "a")
    assert (texels.min(), texels.max()) == (np.float32(95 / 255), np.float32(249 / 255))
    assert np.array_equal(texels[::-1] * 255, image.texels[..., 3])


SCENE = """[[camera.key]]
frame = 0
eye = [0, -9, 3]
target = [0, 0, 0]
[[object]]
builder = "teapot"
[object.displacement]
"""


def test_scene_files_name_pictures(tmp_path):
    save(tmp_path / "map.png", np.stack([GREY8, 255 - GREY8], axis=2))
    scene_file = tmp_path / "scene.toml"
    scene_file.write_text(SCENE + 'map = "map.png"\nchannel = "a"\nscale = 0.1\n')
    (drawn,) = tiler.load_scene(scene_file).maps
    assert np.array_equal(drawn.texels, ((255 - GREY8)[::-1] / 255).astype(np.float32))
    for text, words in (
        ('map = "map.png"\nchannel = "x"\n', "scene.toml:9: object[0].displacement.channel"),
        ('map = "sea"\nchannel = "a"\n', "belongs to map files"),
        ('map = "map.png"\nsize = 16\n', "belongs to procedural maps"),
        ('map = "map.jpg"\n', "FILE.png"),
        ('map = "absent.png"\n', "does not exist"),
        ('map = "map.png"\nchannel = "r"\n', "has no channel r; allowed: grey, a"),
    ):
        scene_file.write_text(SCENE + text)
        with pytest.raises(TilerError) as caught:
            tiler.load_scene(scene_file)
        assert words in str(caught.value), str(caught.value)


def test_limits_are_those_of_the_machine():
    assert map_files.TEXEL_LIMIT * 4 <= 2**31 and map_files.MAP_LIMIT == 16384
