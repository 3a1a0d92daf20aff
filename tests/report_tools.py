"""Reports read back: the data of a page, and its arrays unpacked as the browser does it, in plain loops."""

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np

KINDS = {"u8": np.uint8, "u16": np.uint16, "u32": np.uint32, "f64": np.float64}


def read_data(page: Path | str) -> dict[str, Any]:
    """The JSON of a page."""
    text = page.read_text(encoding="utf-8") if isinstance(page, Path) else page
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    return json.loads(found)


def unpack(blob: dict[str, Any]) -> np.ndarray:
    """An array of `blobs`."""
    raw = zlib.decompress(base64.b64decode(blob["data"]))
    kind = np.dtype(KINDS[blob["type"]]).newbyteorder("<")
    width, n = kind.itemsize, blob["length"]
    assert len(raw) == width * n
    values = np.frombuffer(bytes(raw[k * n + i] for i in range(n) for k in range(width)), kind).copy()
    if blob["stride"]:
        for i in range(blob["stride"], n):
            values[i] = (int(values[i]) + int(values[i - blob["stride"]])) % (1 << (8 * width))
    return values if blob["type"] == "f64" else values.astype(np.int64) + blob["low"]
