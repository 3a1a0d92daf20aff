"""What the page is sent for a request: a length, JSON, and arrays as they lie in memory, for nothing of it goes far.

Four bytes, little endian, say how long the JSON is; arrays begin at the next multiple of 8, each named there by its place.
"""

import json
from typing import Any

import numpy as np

from tiler.explore.patch_boxes import Box
from tiler.explore.session import View
from tiler.explore.tile_queue import TileQueue
from tiler.report.maps import tile_maps
from tiler.scene.camera import eye_and_target
from tiler.tile import TileCount

KIND = "application/octet-stream"
MOST_TOLD = 20  # violations

Data = dict[str, Any]


class _Arrays:
    """The arrays behind the JSON."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._end = 0

    def add(self, values: np.ndarray) -> Data:
        """Where the array will be; integers become int32, or float64 where that is too narrow."""
        if values.dtype != np.uint8:
            fits = values.dtype.kind in "iub" and (not values.size or abs(values).max() < 2**31)
            values = values.astype("<i4" if fits else "<f8")
        kind = {1: "u8", 4: "i32", 8: "f64"}[values.dtype.itemsize]
        place = {"type": kind, "at": self._end, "length": int(values.size)}
        content = values.tobytes()
        content += bytes(-len(content) % 8)
        self.parts.append(content)
        self._end += len(content)
        return place


def pack(view: View) -> bytes:
    """The reply."""
    arrays = _Arrays()
    frame, plan = view.frame, view.plan
    rows, columns = frame.queues.entries.shape
    eye, target = eye_and_target(plan.scene.camera, plan.ask.frame)
    told = [str(violation) for violation in (*frame.violations, *frame.false_culls)]
    maps = {name: arrays.add(values) for name, values in tile_maps(frame)}
    if view.pixel_map is not None:
        maps[plan.ask.map] = arrays.add(view.pixel_map)
    data = {
        "full": plan.ask.full,
        "size": [plan.scene.picture.width, plan.scene.picture.height],
        "seconds": frame.seconds,
        "machine": plan.machine.model_dump(mode="json"),
        "tile": plan.machine.tile,
        "grid": [columns, rows],
        "camera": {"eye": eye, "target": target},
        "counters": list(frame.counters.values()),
        "picture": arrays.add(frame.color),
        "under": arrays.add(view.under),
        "maps": maps,
        "queue": None if view.queue is None or view.tile is None else _queue(view, view.queue, view.tile, columns),
        "boxes": [_box(box) for box in view.boxes],
        "violations": told[:MOST_TOLD] + ([f"and {len(told) - MOST_TOLD} more"] if len(told) > MOST_TOLD else []),
    }
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(4 + len(text)) % 8)
    return b"".join([len(text).to_bytes(4, "little"), text, *arrays.parts])


def _queue(view: View, queue: TileQueue, tile: int, columns: int) -> Data:
    """A tile's queue by columns."""
    return {
        "column": tile % columns,
        "row": tile // columns,
        "entries": queue.column(TileCount.QUEUE_ENTRIES).tolist(),
        "patch": queue.patch.tolist(),
        "triangle": queue.triangle.tolist() if view.plan.machine.binning == "triangle" else None,
        "domain": None if view.domain is None else view.domain.tolist(),
        "pass": queue.pass_number.tolist(),
        "phase": queue.phase.tolist() if view.plan.machine.phased else None,
        "fate": queue.fate,
        "ds": queue.column(TileCount.DS_INVOCATIONS).tolist(),
        "triangles": queue.column(TileCount.TRIANGLES).tolist(),
        "covered": queue.column(TileCount.SAMPLES_COVERED).tolist(),
        "passed": queue.column(TileCount.SAMPLES_PASSED).tolist(),
        "visible": queue.visible.tolist(),
    }


def _box(box: Box) -> Data:
    return box._asdict() | {"lines": np.round(box.lines, 5).tolist()}
