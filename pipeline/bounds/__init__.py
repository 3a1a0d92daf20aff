"""Bounds of displaced patches. `BOUNDS` is the table: tests, command line and reports loop over it.

Every entry is called as `bound(patches, ranges, clip_from_world, viewport) -> PatchBounds`:

patches : Patches in world space. ranges : float64[L, 2], smallest and largest displacement of each map.
clip_from_world : float32[4, 4]. viewport : Viewport, whose pixels the screen rectangles are clipped to.

To add one: a module beside `cbox` with a function of this signature, and a line here.
"""

from collections.abc import Callable

from pipeline.bounds import cbox
from pipeline.types import F32, F64, PatchBounds, Patches, Viewport

Bound = Callable[[Patches, F64, F32, Viewport], PatchBounds]

BOUNDS: dict[str, Bound] = {
    "cbox": cbox.bound_patches,
}
