"""View-frustum cull of a patch by the clip-space corners of its bound, without a division.

A patch is outside when all eight corners are outside the *same* plane by more than the slack of the float32 shader.
Right for any sign of w: each plane's distance is linear in clip space, so the corners bound it. (The test in NDC that
Sathe 2011 describes divides first, and wrongly culls boxes that cross w = 0.)
"""

from pipeline.jit import helper, kernel
from pipeline.types import U8, CullFlag, HullInput, PatchBounds

ALIVE, FRUSTUM = int(CullFlag.ALIVE), int(CullFlag.FRUSTUM)


@helper
def _outside(corners, slack):
    sx, sy, sz, sw = slack[0], slack[1], slack[2], slack[3]
    outside = 0b111111
    for k in range(8):
        x, y, z, w = corners[k, 0], corners[k, 1], corners[k, 2], corners[k, 3]
        outside &= (
            (w + x < -(sw + sx))
            | (w - x < -(sw + sx)) << 1
            | (w + y < -(sw + sy)) << 2
            | (w - y < -(sw + sy)) << 3
            | (z < -sz) << 4
            | (w - z < -(sw + sz)) << 5
        )
    return outside != 0


@kernel
def _cull_patches(corners, slack, inside, flags):
    for p in range(len(flags)):
        if flags[p] == ALIVE and inside[p] == 0 and _outside(corners[p], slack[p]):
            flags[p] = FRUSTUM


def cull_patches(stage: HullInput, bounds: PatchBounds, flags: U8) -> None:
    """Flag alive patches whose bound lies outside one plane of the frustum; `flags` uint8[P] modified in place.

    Those known to lie wholly inside, most of a usual view, are not asked.
    """
    _cull_patches(bounds.corners, bounds.slack, bounds.inside, flags)
