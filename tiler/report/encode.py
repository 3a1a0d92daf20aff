"""Arrays and pictures as text that a browser turns back without loss.

An array becomes unsigned integers of the least width that fits (or float64), each the difference to the value `stride`
places before, wrapped; their bytes sorted by significance, deflated (zlib, RFC 1950), in base64. Neighbouring pixels and
tiles are alike, so most bytes are 0 before they are deflated. Equal arrays are stored once.
"""

import base64
import io
import zlib
from typing import Any

import numpy as np

from pipeline.types import U8

WIDTHS: tuple[tuple[str, type[np.unsignedinteger]], ...] = (("u8", np.uint8), ("u16", np.uint16), ("u32", np.uint32))


class Blobs:
    """The arrays of a page. `stored` is what the page holds: type, length, stride, low (added to all) and data."""

    def __init__(self) -> None:
        self.stored: list[dict[str, Any]] = []
        self._known: dict[tuple[str, bytes], int] = {}

    def add(self, values: np.ndarray) -> int:
        """Number of the array among `stored`; of any shape, read row by row."""
        key = (f"{values.dtype}{values.shape}", np.ascontiguousarray(values).tobytes())
        if key not in self._known:
            self._known[key] = len(self.stored)
            self.stored.append(encode(values))
        return self._known[key]

    def size(self) -> int:
        """Characters of all data."""
        return sum(len(blob["data"]) for blob in self.stored)


def encode(values: np.ndarray) -> dict[str, Any]:
    """An array as plain data, see above. NaN stays; integers of 2**53 and more lose digits, as they do in a browser."""
    flat = np.ascontiguousarray(values).reshape(-1)
    if flat.dtype.kind in "iub" and len(flat):
        low = int(flat.min())
        span = int(flat.max()) - low
        for name, kind in WIDTHS:
            if span <= np.iinfo(kind).max:
                return _packed(name, (flat.astype(np.int64) - low).astype(kind), low, values.shape[-1])
    return _packed("f64", flat.astype(np.float64), 0, 1)


def _packed(name: str, flat: np.ndarray, low: int, row: int) -> dict[str, Any]:
    strides = (0,) if name == "f64" else (0, 1) if row in (1, len(flat)) else (0, 1, row)
    packed = {stride: zlib.compress(_bytes(flat, stride), 6) for stride in strides}
    best = min(packed, key=lambda stride: len(packed[stride]))
    data = base64.b64encode(packed[best]).decode("ascii")
    return {"type": name, "length": len(flat), "stride": best, "low": low, "data": data}


def _bytes(flat: np.ndarray, stride: int) -> bytes:
    if stride:
        before = flat.copy()
        before[:stride] = 0
        before[stride:] = flat[:-stride]
        flat = flat - before  # unsigned: wraps
    little = flat.astype(flat.dtype.newbyteorder("<"), copy=False)
    return little.view(np.uint8).reshape(len(flat), flat.dtype.itemsize).T.tobytes()


def picture_uri(color: U8) -> str:
    """A picture, uint8[H, W, 4] RGBA, as a data URI in PNG."""
    from PIL import Image

    image = Image.fromarray(color)
    if (color[..., 3] == 255).all():
        image = image.convert("RGB")
    content = io.BytesIO()
    image.save(content, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii")
