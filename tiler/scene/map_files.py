"""Displacement maps in picture files: PNG, TIFF, EXR, and .npy arrays.

Row 0 of our maps is at t = 0 (`pipeline.displacement`). Pictures have their top row first, and t points up in them (the
convention of OBJ and USD), so pictures are flipped; arrays (.npy) are taken as they are. Whole numbers become [0, 1]: v / 255
of 8 bits, v / 65535 of 16 bits; floats stay as they are. A map that holds 128 where the surface is to stay wants
bias = -scale * 128 / 255.
"""

import contextlib
import io
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from pipeline.types import F32
from tiler.scene.arrays import MAP_LIMIT, ArrayFault, array_of, check_file, float32_of

Channel = Literal["grey", "r", "g", "b", "a"]

SUFFIXES = (".npy", ".png", ".tif", ".tiff", ".exr")
TEXEL_LIMIT = 2**27
FILE_LIMIT = 2**32  # bytes
_FORMATS = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF"}
_FULL = {"uint8": 255.0, "uint16": 65535.0}


class Image(NamedTuple):
    """A picture as its file has it, top row first; an array of .npy is turned into that."""

    texels: np.ndarray  # (height, width, channels) uint8, uint16 or float
    channels: tuple[str, ...]  # "grey", "r", "g", "b", "a", or other names of an EXR file
    values: str  # what its numbers are, in words


def read_map(path: Path, channel: Channel | None = None) -> F32:
    """One channel of a map, (height, width) float32, row 0 at t = 0. Raises ArrayFault.

    channel : which; where it is None the map must have one channel, or colours that are all grey.
    """
    image = read_image(path)
    if channel is not None:
        if channel not in image.channels:
            raise ArrayFault(f"has no channel {channel}; allowed: {', '.join(image.channels)}")
        k = image.channels.index(channel)
    else:
        k = _only_channel(image)
    return _normalized(image.texels[..., k])


def read_vector_map(path: Path) -> F32:
    """A vector displacement map, (height, width, 3) float32 from channels r, g, b, row 0 at t = 0. Raises ArrayFault.

    Whole numbers become [0, 1] as in `read_map`, so a map whose zero is the middle grey needs a bias.
    """
    image = read_image(path)
    missing = [name for name in "rgb" if name not in image.channels]
    if missing:
        raise ArrayFault(f"has channels {', '.join(image.channels)}; a vector map needs r, g and b")
    return _normalized(image.texels[..., [image.channels.index(name) for name in "rgb"]])


def read_image(path: Path) -> Image:
    """All channels of a map file. Raises ArrayFault."""
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise ArrayFault(f"ends in {kind or 'nothing'}; allowed: {', '.join(SUFFIXES)}")
    check_file(path, FILE_LIMIT)
    if kind == ".npy":
        return _array_image(path)
    return _exr_image(path) if kind == ".exr" else _pillow_image(path, _FORMATS[kind])


def _only_channel(image: Image) -> int:
    """The channel of a map that has one, or whose colours are equal; an alpha channel beside them is left out."""
    colours = [k for k, name in enumerate(image.channels) if name != "a"] or [0]
    first = image.texels[..., colours[0]]
    if any(not np.array_equal(image.texels[..., k], first, equal_nan=first.dtype.kind == "f") for k in colours[1:]):
        raise ArrayFault(f"has channels {', '.join(image.channels)} that differ; needed: which one, by channel")
    return colours[0]


def _normalized(texels: np.ndarray) -> F32:
    """Rows turned around, whole numbers to [0, 1]."""
    if texels.dtype.kind == "f":
        return float32_of(texels[::-1], "texels")
    return np.ascontiguousarray((texels[::-1] / full_value(texels)).astype(np.float32))


def full_value(texels: np.ndarray) -> float:
    """What stands for 1 in texels of this type."""
    return _FULL.get(str(texels.dtype), 1.0)


def _check_size(width: int, height: int) -> None:
    if not (0 < width <= MAP_LIMIT and 0 < height <= MAP_LIMIT) or width * height > TEXEL_LIMIT:
        raise ArrayFault(
            f"has {width} x {height} texels; allowed: from 1 to {MAP_LIMIT} along a side, at most {TEXEL_LIMIT:,} in all"
        )


def _array_image(path: Path) -> Image:
    texels = array_of(path)
    if texels.ndim not in (2, 3) or (texels.ndim == 3 and texels.shape[2] not in (1, 3, 4)) or texels.size == 0:
        raise ArrayFault(
            f"has shape {texels.shape}; allowed: (height, width), or (height, width, 3) "
            f"for vectors; each from 1 to {MAP_LIMIT}"
        )
    _check_size(texels.shape[1], texels.shape[0])
    if texels.ndim == 2:
        texels = texels[..., None]
    names = ("grey",) if texels.shape[2] == 1 else ("r", "g", "b", "a")[: texels.shape[2]]
    if texels.dtype.kind != "f":
        raise ArrayFault(f"has texels of type {texels.dtype}; allowed: float32, float64")
    return Image(texels[::-1], names, str(texels.dtype))


def _pillow_image(path: Path, kind: str) -> Image:
    from PIL import Image as pillow

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of size: the limit is ours; of odd metadata: only the pixels count
            with pillow.open(path, formats=[kind]) as image:
                return _decoded(image, path)
    except pillow.DecompressionBombError:
        raise ArrayFault(f"has too many texels; allowed: at most {TEXEL_LIMIT:,}") from None
    except ArrayFault:
        raise
    except pillow.UnidentifiedImageError:
        raise ArrayFault(f"is no {kind} file that can be read") from None
    except (OSError, SyntaxError, ValueError, EOFError, IndexError, KeyError, TypeError, OverflowError) as error:
        raise ArrayFault(f"cannot be decoded ({error})") from None
    except (struct.error, zlib.error, MemoryError) as error:
        raise ArrayFault(f"cannot be decoded ({error})") from None


def _decoded(image: Any, path: Path) -> Image:
    """Texels of an opened picture."""
    _check_size(*image.size)
    if getattr(image, "n_frames", 1) > 1:
        raise ArrayFault(f"has {image.n_frames} pictures; allowed: one")
    mode = image.mode
    if mode in ("RGB", "RGBA", "LA", "P") and _bits(image, path) > 8:
        raise ArrayFault(
            "has several channels of 16 bits; allowed: 16 bits with one grey channel, 8 bits, or an EXR file"
        )
    if mode == "P":
        mode = "RGBA" if "transparency" in image.info else "RGB"
        image = image.convert(mode)
    if mode == "1":
        mode, image = "L", image.convert("L")
    if mode == "I" and image.format == "PNG":  # how older Pillows read 16 bits
        image.load()
        return Image(np.asarray(image).astype(np.uint16)[..., None], ("grey",), "16 bits")
    names = {"L": "grey", "LA": "grey a", "RGB": "r g b", "RGBA": "r g b a", "F": "grey"}
    channels: tuple[str, ...]
    if mode.startswith("I;16"):
        texels, channels, values = np.asarray(image).astype(np.uint16), ("grey",), "16 bits"
    elif mode in names:
        texels, channels = np.array(image), tuple(names[mode].split())
        values = "float32" if mode == "F" else "8 bits"
    else:
        raise ArrayFault(
            f"has pixels of kind {mode}; allowed: grey or RGB with or without alpha, 16-bit grey, float grey"
        )
    return Image(texels.reshape(*texels.shape[:2], -1), channels, values)


def _bits(image: Any, path: Path) -> int:
    """Bits of a channel as the file has them; Pillow keeps only 8 of them where a picture has several channels."""
    if image.format == "PNG":
        with path.open("rb") as file:
            return file.read(25)[24]
    bits = image.tag_v2.get(258, 1)  # BitsPerSample
    return max(bits) if isinstance(bits, tuple) else int(bits)


def _exr_image(path: Path) -> Image:
    try:
        import OpenEXR
    except ImportError:
        raise ArrayFault("needs the package OpenEXR: pip install 'tilesim[exr]'") from None
    try:
        low, high = OpenEXR.File(str(path), header_only=True).header()["dataWindow"]
        _check_size(int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1)  # before anything is decoded
        with contextlib.redirect_stdout(io.StringIO()) as told:  # where OpenEXR says that it could not decode a part
            file = OpenEXR.File(str(path), separate_channels=True)
        if not file.parts:
            raise ArrayFault(f"cannot be decoded ({' '.join(told.getvalue().split())[:120]})")
        if len(file.parts) != 1:
            raise ArrayFault(f"has {len(file.parts)} parts; allowed: one")
        pixels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError, KeyError, OSError, MemoryError) as error:
        if isinstance(error, ArrayFault):
            raise
        raise ArrayFault(f"is no EXR file that can be read ({' '.join(str(error).split())[:120]})") from None
    shapes = {array.shape for array in pixels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ArrayFault("has channels of several sizes, or is deep; allowed: flat channels of one size")
    height, width = next(iter(shapes))
    _check_size(width, height)
    own = {"Y": "grey", "R": "r", "G": "g", "B": "b", "A": "a"}
    names = tuple(own.get(name, name) for name in pixels)
    if len(names) == 1:
        names = ("grey",)
    kinds = sorted({str(array.dtype) for array in pixels.values()})
    if any(array.dtype.kind != "f" for array in pixels.values()):
        raise ArrayFault(f"has channels of type {', '.join(kinds)}; allowed: half, float")
    return Image(np.stack([array.astype(np.float32) for array in pixels.values()], axis=2), names, ", ".join(kinds))
