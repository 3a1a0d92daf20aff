"""Cull tests of the hull stage. `CULL_TESTS` is the table: tests, command line and reports loop over it.

Every entry is called as `cull(stage, bounds, flags)`, `stage` a HullInput: it may set `flags[p]` (uint8[P], a CullFlag) of
a patch that is still ALIVE, and only if no sample of the displaced patch can be drawn.

To add one: a module beside `frustum`, a value in `types.CullFlag`, and a line here.
"""

from collections.abc import Callable

from pipeline.culling import frustum
from pipeline.types import U8, CullFlag, HullInput, PatchBounds

CullTest = Callable[[HullInput, PatchBounds, U8], None]

CULL_TESTS: dict[str, CullTest] = {
    "frustum": frustum.cull_patches,
}

FLAG_OF: dict[str, CullFlag] = {"frustum": CullFlag.FRUSTUM}
