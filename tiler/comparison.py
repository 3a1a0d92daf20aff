"""Machines side by side on one frame: counters with their ratio to the first, and whether all draw the same picture."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.frame import Frame
from tiler.scene.model import Scene
from tiler.shared import Shared
from tiler.simulation import simulate

if TYPE_CHECKING:
    import pandas

EVERYTHING: dict[str, object] = {
    "bounds": "cbox",
    "cull": ("frustum", "backface:tessellation_safe", "occlusion", "occlusion:triangle"),
    "queue_order": "front_to_back",
    "domain_cache": "frame",
    "overlap": "exact",
    "occlusion_area": "hull",
}

MACHINES: dict[str, dict[str, object]] = {
    "triangle": {"binning": "triangle", "cull": ()},  # what exists: shades every patch, bins triangles
    "patch": {"binning": "patch"},
    "patch, frame cache": {"binning": "patch", "domain_cache": "frame"},
    "patch, all": {"binning": "patch", "tile": 128, **EVERYTHING},
    "subpatch, all": {"binning": "subpatch", "tile": 128, "subpatch_extent": 128.0, **EVERYTHING},
}


@dataclass(frozen=True)
class Comparison:
    """Frames of the machines by name, the baseline first."""

    frames: dict[str, Frame]

    def same_picture(self) -> dict[str, bool]:
        """Whether each machine's picture and depth equal the baseline's bit for bit."""
        first = next(iter(self.frames.values()))
        return {
            name: bool(
                np.array_equal(frame.color, first.color)
                and np.array_equal(frame.depth_samples.view(np.uint32), first.depth_samples.view(np.uint32))
            )
            for name, frame in self.frames.items()
        }

    def table(self) -> str:
        """Counters as aligned text, a column a machine, with ratios to the first; rows that are 0 everywhere are left out."""
        frames = list(self.frames.values())
        rows = [["", *self.frames]]
        for name in DEFINITIONS:
            values = [frame.counters[name] for frame in frames]
            if any(values):
                rows.append([name, f"{values[0]:,}", *(f"{v:,}{_ratio(v, values[0])}" for v in values[1:])])
        rows.append(["milliseconds", *(f"{frame.seconds * 1e3:,.0f}" for frame in frames)])
        widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
        lines = ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows]
        same = all(self.same_picture().values())
        return "\n".join([*lines, "", "pictures: bit-identical" if same else "pictures: DIFFERENT"])

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row a counter and a column a machine, the baseline first, as a pandas DataFrame.

        Raises TilerError where pandas is not installed.
        """
        from tiler.notebook import pandas_for

        pandas = pandas_for("to_dataframe", "frames and their counters, or table()")
        made = pandas.DataFrame({name: dict(frame.counters) for name, frame in self.frames.items()})
        made.index.name = "counter"
        return made

    def _repr_html_(self) -> str:
        from tiler.notebook import comparison_html

        return comparison_html(self)


def _ratio(value: int, baseline: int) -> str:
    return f" x{value / baseline:<7.3g}" if baseline else " " * 9


def compare(
    scene: Scene,
    machines: Mapping[str, Machine],
    *,
    frame: float = 0,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda machines: None,
) -> Comparison:
    """Draw one frame of a scene on each machine. progress : called with the number of machines done.

    Stages that a change of machine does not touch run once, so a frame's `seconds` are those that it took beside the others.
    """
    frames, shared = {}, Shared()
    for done, (name, machine) in enumerate(machines.items()):
        frames[name] = simulate(scene, machine, frame=frame, threads=threads, shared=shared)
        progress(done + 1)
    return Comparison(frames)
