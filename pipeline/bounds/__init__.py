"""Bounds of displaced patches. `BOUNDS` is the table: tests, command line and reports loop over it.

Every entry is called as `bound(stage) -> PatchBounds`, `stage` a HullInput (`hull.make_input` makes one from arrays), and
bounds each patch over its parametric domain. To add one: a module beside `cbox` with such a function, and a line here.
"""

from collections.abc import Callable

from pipeline.bounds import cbox
from pipeline.types import HullInput, PatchBounds

Bound = Callable[[HullInput], PatchBounds]

BOUNDS: dict[str, Bound] = {
    "cbox": cbox.bound_patches,
}
