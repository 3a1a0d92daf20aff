"""The maps of a report: which there are of a frame, what each says, and its values."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from pipeline.types import I64
from tiler.blame import BLAME
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.frame import Frame
from tiler.heatmaps import PIXEL_MAPS, TILE_MAPS
from tiler.scene.model import Scene
from tiler.tally import TILE_COUNTERS

MAIN = "Overview"


class MapInfo(NamedTuple):
    """What a map says. per : `tile` or `pixel`."""

    title: str
    unit: str
    per: str
    group: str
    text: str


def _info(name: str) -> MapInfo:
    d = DEFINITIONS[name]
    return MapInfo(name, d.unit, "tile", d.stage, d.text)


def _main(name: str, title: str) -> MapInfo:
    return _info(name)._replace(title=title, group=MAIN)


# In the order of the page's list: what architects look at first, then all others by stage.
MAPS: dict[str, MapInfo] = {
    "queue_entries": _main("queue_entries", "Queue length")._replace(text="Entries of each tile's queue."),
    "queue_bytes": MapInfo(
        "Queue bytes", "bytes", "tile", MAIN, "Bytes of each tile's list by the queue model, whole chunks; records that tiles "
        "share are in none.",
    ),
    "ds_invocations": _main("ds_invocations", "Domain-shader invocations"),
    "wasted_domain_points": MapInfo(
        "Wasted invocations", "domain points", "tile", MAIN, "Domain-shader invocations of each tile that were not useful: all "
        "lines of blame but the first.",
    ),
    "cz_pairs_occluded": _main("cz_pairs_occluded", "Occluded pairs"),
    "overdraw": MapInfo(
        "Overdraw", "samples", "pixel", MAIN, "Samples of the pixel that triangles cover, each one a depth test, if no "
        "occlusion test hides them first.",
    ),
    "depth_complexity": MapInfo(
        "Depth complexity", "samples", "pixel", MAIN, "The same of all patches and both faces: the layers that the scene has "
        "there, whatever is culled.",
    ),
    "bounds_overlap": MapInfo(
        "Bounds overlap", "patches", "pixel", MAIN, "Patches alive after the hull stage whose screen rectangle has the pixel.",
    ),
    "ps_invocations": _main("ps_invocations", "Pixel-shader invocations"),
    "wasted_samples": MapInfo(
        "Wasted samples", "samples", "tile", MAIN, "Samples tested in each tile that are not seen at the end.",
    ),
    "queue_passes": MapInfo(
        "queue_passes", "passes", "tile", "queue memory", "Passes in which the tile's queue has an entry.",
    ),
    **{f"blame:{name}": MapInfo(reason.title, "domain points", "tile", "Blame", reason.text) for name, reason in BLAME.items()},
}  # fmt: skip
MAPS |= {name: _info(name) for name in TILE_COUNTERS if name not in MAPS}


def tile_maps(frame: Frame) -> Iterator[tuple[str, I64]]:
    """Every per-tile map of a frame that is not 0 all over, int64[tiles_y, tiles_x], by name of `MAPS`."""
    for name in MAPS:
        values = _tile_map(frame, name)
        if values is not None and values.any():
            yield name, values


def _tile_map(frame: Frame, name: str) -> I64 | None:
    blamed = frame.blame is not None and frame.machine.binning != "triangle"  # which shades in no tile
    if name.startswith("blame:"):
        return frame.blame.tiles[name[6:]] if frame.blame is not None and blamed else None
    if name == "wasted_domain_points" and not blamed:
        return None
    return TILE_MAPS[name](frame) if name in TILE_MAPS else frame.tiles.get(name)


class PixelMaps:
    """Per-pixel maps of a scene; those that machines share are made once."""

    def __init__(self, scene: Scene, number: float) -> None:
        """number : of the frame."""
        self._scene, self._number = scene, number
        self._made: dict[tuple[str, ...], np.ndarray] = {}

    def of(self, machine: Machine) -> Iterator[tuple[str, np.ndarray]]:
        """The maps of a machine, int32[H, W], by name of `MAPS`."""
        for name, info in MAPS.items():
            if info.per == "pixel":
                key = (name,) if name == "depth_complexity" else (name, machine.bounds, *machine.hull_cull)
                if key not in self._made:
                    make: Callable[[Scene, Machine, float], np.ndarray] = PIXEL_MAPS[name]
                    self._made[key] = make(self._scene, machine, self._number)
                yield name, self._made[key]
