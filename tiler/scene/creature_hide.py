"""The creature's hide as a displacement map: overlapping scales, large on the back and small below; 0 along all seams.

A seam's two sides read different texels. Where both are 0 they agree, and the displaced creature has no crack there.
"""

import numpy as np

from pipeline.types import F32, F64
from tiler.scene.creature import Parameters, seam_segments
from tiler.scene.noise import uniform
from tiler.scene.rounding import STEP

ROWS = 44  # of scales, along s
BARE = (
    2.5  # texels around a seam that are 0: more than a bilinear lookup reaches, with room for Catmull-Clark's rounding
)
FADE = 0.02  # of texture space: as wide is the rise from a seam to full height


def hide(size: int, seed: int) -> F32:
    """Scales for the full creature, multiples of 2^-16 in [0, 1]."""
    return _hide(size, seed, Parameters(cage="full"))


def small_hide(size: int, seed: int) -> F32:
    """Scales for the small creature, whose seams lie elsewhere."""
    return _hide(size, seed, Parameters(cage="small"))


def _hide(size: int, seed: int, creature: Parameters) -> F32:
    s = (np.arange(size)[None, :] + 0.5) / size
    t = (np.arange(size)[:, None] + 0.5) / size
    height = _scales(s, t, seed)
    distance = np.full((size, size), FADE + BARE / size)
    for ends in seam_segments(creature):
        _near(distance, ends, size)
    rise = np.clip((distance - BARE / size) / FADE, 0.0, 1.0)
    return (np.rint(height * rise * rise * (3 - 2 * rise) / STEP) * STEP).astype(np.float32)


def _scales(s: F64, t: F64, seed: int) -> F64:
    """Rows of scales across s, each row moved by half a scale, each scale highest at its rear edge, as tiles on a roof.

    The nose is at high s: a scale's rear is at low s, and lies over the front of the next one behind it.
    """
    best = np.zeros((s * t + t).shape)
    along = s * ROWS
    for back in (0, 1):  # the scale that starts in this row, and the one before that reaches into it
        row = np.floor(along).astype(np.int64) + back
        across = t * ROWS + 0.5 * (row % 2)
        column = np.floor(across).astype(np.int64)
        x = 2 * (across - column) - 1
        y = (row + 1 - along) / 2  # 0 at the front of a scale, 1 at its rear
        round_off = np.clip((1 - x * x) * 1.4, 0, 1) * np.clip((1 - y) * 6 - 2 * x * x, 0, 1)
        grown = 0.6 + 0.4 * uniform(seed, row, column)
        best = np.maximum(best, grown * round_off * (0.25 + 0.75 * y))
    return best


def _near(distance: F64, ends: F64, size: int) -> None:
    """Lower `distance` (texture space) around a segment, in place."""
    reach = FADE + (BARE + 1) / size
    (s0, t0), (s1, t1) = ends
    low_s, high_s = int((min(s0, s1) - reach) * size), int((max(s0, s1) + reach) * size) + 1
    low_t, high_t = int((min(t0, t1) - reach) * size), int((max(t0, t1) + reach) * size) + 1
    columns = np.arange(max(low_s, 0), min(high_s, size))
    rows = np.arange(max(low_t, 0), min(high_t, size))
    if not len(columns) or not len(rows):
        return
    s, t = (columns[None, :] + 0.5) / size, (rows[:, None] + 0.5) / size
    ds, dt = s1 - s0, t1 - t0
    along = np.clip(((s - s0) * ds + (t - t0) * dt) / max(ds * ds + dt * dt, STEP * STEP), 0.0, 1.0)
    away_s, away_t = s - s0 - along * ds, t - t0 - along * dt
    window = distance[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    np.minimum(window, np.sqrt(away_s * away_s + away_t * away_t), out=window)
