"""A frame as users get it: pictures, depth, counters, queues, and maps of what happened in each tile."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pipeline.types import F32, I64, U8
from tiler.counters import Counters
from tiler.errors import TilerError, unknown_name
from tiler.queues import Queues

if TYPE_CHECKING:
    import pandas
    from PIL.Image import Image

    from tiler.blame import Blame
    from tiler.config import Machine
    from tiler.verify import Violation

# Dark blue to pale yellow in even steps of lightness; readable in grey and by colour-blind readers.
RAMP = np.array(
    [
        (20, 16, 52),
        (62, 30, 108),
        (116, 38, 116),
        (172, 52, 102),
        (220, 82, 76),
        (246, 132, 56),
        (252, 190, 80),
        (252, 244, 180),
    ],
    np.float64,
)


@dataclass(frozen=True, repr=False)
class Frame:
    """One simulated frame.

    color : uint8[H, W, 4], RGBA, samples resolved. depth : float32[H, W], window depth of sample 0; 1 where nothing is.
    depth_samples : float32[H, W, S]. tiles : per-tile counters by name, each int64[tiles_y, tiles_x]. cores : the same
    summed over each simulated core's tiles, int64[cores]. seconds : wall time of the simulation. violations : what a machine
    with `verify` found wrong with its bounds and culls. false_culls : patches dropped by a back-patch test that is right for
    the smooth surface, of which a coarse triangle would have been visible. blame : of a machine with `blame`.
    """

    scene: str
    machine: "Machine"
    number: float
    color: U8
    depth_samples: F32
    counters: Counters
    queues: Queues
    tiles: dict[str, I64]
    cores: dict[str, I64]
    seconds: float = field(compare=False)
    violations: tuple["Violation", ...] = ()
    false_culls: tuple["Violation", ...] = ()
    blame: "Blame | None" = None

    @property
    def depth(self) -> F32:
        """Window depth of sample 0, float32[H, W]."""
        return self.depth_samples[:, :, 0]

    def image(self) -> "Image":
        """The picture as a PIL image."""
        from PIL import Image

        return Image.fromarray(self.color)

    def heatmap(self, name: str, scale: float | None = None) -> "Image":
        """Map of a per-tile counter over the picture, as a PIL image of the picture's size.

        scale : the value of the brightest colour; the largest tile's by default. Raises TilerError for an unknown name.
        """
        from PIL import Image

        values = self.tile_map(name).astype(np.float64)
        top = float(values.max()) if scale is None else float(scale)
        place = np.clip(values / top if top > 0 else values * 0.0, 0.0, 1.0) * (len(RAMP) - 1)
        low = np.minimum(place.astype(int), len(RAMP) - 2)
        part = (place - low)[..., None]
        rgb = (RAMP[low] * (1 - part) + RAMP[low + 1] * part + 0.5).astype(np.uint8)
        rgb = rgb.repeat(self.machine.tile, axis=0).repeat(self.machine.tile, axis=1)
        height, width = self.depth.shape
        return Image.fromarray(np.ascontiguousarray(rgb[:height, :width]))

    def tile_map(self, name: str) -> I64:
        """A per-tile counter, or `wasted_domain_points` of a machine with `blame`, int64[tiles_y, tiles_x]."""
        if name == "wasted_domain_points":
            if self.blame is None:
                raise TilerError(f"heatmap: {name!r} is not known of this machine; allowed: one with blame=True")
            return self.blame.wasted_domain_points
        if name not in self.tiles:
            raise TilerError(f"heatmap: {name!r} is not a per-tile counter; {unknown_name(name, self.tiles)}")
        return self.tiles[name]

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row a tile as a pandas DataFrame, indexed by x and y of the tile: all per-tile counters.

        Its `attrs` say scene, frame and machine. Raises TilerError where pandas is not installed.
        """
        from tiler.notebook import pandas_for

        pandas = pandas_for("to_dataframe", "frame.tiles, arrays by name")
        tiles_y, tiles_x = self.queues.entries.shape
        y, x = np.divmod(np.arange(tiles_y * tiles_x), tiles_x)
        index = pandas.MultiIndex.from_arrays([x, y], names=["x", "y"])
        made = pandas.DataFrame({name: values.ravel() for name, values in self.tiles.items()}, index=index)
        made.attrs = {"scene": self.scene, "frame": self.number, "machine": self.machine.model_dump(mode="json")}
        return made

    def _repr_png_(self) -> bytes:
        from tiler.notebook import png

        return png(self.image())

    def _repr_html_(self) -> str:
        from tiler.notebook import frame_html

        return frame_html(self)

    def __repr__(self) -> str:
        height, width = self.depth.shape
        return f"<Frame {self.number:g} of {self.scene!r}, {width}x{height}, {self.machine.binning} binning>"
