"""Bounds of displaced patches. `BOUNDS` is the table: tests, command line and reports loop over it.

Every entry is called as `bound(stage) -> PatchBounds`, `stage` a HullInput (`hull.make_input` makes one from arrays), and
bounds each patch over its parametric domain. To add one: a module beside `cbox` with such a function, and a line here.
"""

from collections.abc import Callable

from pipeline.bounds import cbox, max_displacement, npatch, obbtex, taylor, tpatch, tpatch_tight
from pipeline.types import HullInput, PatchBounds

Bound = Callable[[HullInput], PatchBounds]

BOUNDS: dict[str, Bound] = {
    "cbox": cbox.bound_patches,
    "max_displacement": max_displacement.bound_patches,
    "obbtex": obbtex.bound_patches,
    "tpatch": tpatch.bound_patches,
    "tpatch_tight": tpatch_tight.bound_patches,
    "npatch": npatch.bound_patches,
    "taylor": taylor.bound_patches,
    "taylor_clamped": taylor.bound_patches_clamped,
}
