"""Procedural displacement maps, by name. All are square, made of multiples of 2^-16 in [0, 1], and, but for hides, periodic.

A texel is a function of its whole-numbered position, through tables and whole-numbered hashes: the same bits everywhere.
Row 0 is at t = 0, column 0 at s = 0; texel (i, j) has its centre at s = (i + 0.5) / size.
"""

from collections.abc import Callable

import numpy as np

from pipeline.types import F32, F64, I64
from tiler.scene.creature_hide import hide, small_hide
from tiler.scene.noise import hash32, uniform
from tiler.scene.rounding import STEP, cos_turns, sin_turns


def sea(size: int, seed: int) -> F32:
    """Waves that run mostly one way, with sharp crests and flat troughs, and ripples across them."""
    column, row = _texels(size)
    crest = np.array([_crest(k / size) for k in range(size)])
    warp = np.array([sin_turns(k / size) for k in range(size)])
    # Crests are not straight: the phase wanders by some texels, slowly.
    bend = (
        warp[(2 * column + row) % size] * size / 24 + warp[(3 * row - column + size // 3) % size] * size / 32
    ).astype(np.int64)
    height = np.zeros((size, size))
    for k, (along, across, weight) in enumerate(_SEA_WAVES):
        phase = int(hash32(seed, k)) % size
        height += weight * crest[(along * row + across * column + bend * (1 + along // 8) + phase) % size]
    return _finish(height)


# Periods of a wave over the map (along t, along s), and its weight: the longer the higher.
_SEA_WAVES = [
    (4, 1, 26), (6, -2, 26), (7, 3, 22), (9, -4, 18), (11, 2, 16), (13, -6, 13), (16, 5, 11), (19, -1, 9),
    (23, 11, 6), (27, -13, 5), (17, 21, 3), (33, 6, 4), (41, -18, 3), (29, 31, 2), (47, 15, 2), (61, -9, 1),
]  # fmt: skip


def _crest(turns: float) -> float:
    """One period of a wave in [0, 1]: ((1 + sin) / 2)^4, narrow at the top and wide at the bottom."""
    half = 0.5 + 0.5 * sin_turns(turns)
    return half * half * half * half


def spikes(size: int, seed: int) -> F32:
    """Sharp spikes of many heights, 16 x 24 large ones and small ones between; 0 along t = 0 and t = 1."""
    large = _spike_field(size, seed, 16, 24, 0.55, 1.0)
    small = _spike_field(size, seed + 1, 32, 48, 0.0, 0.3)
    height = np.maximum(large, small)
    height[[0, -1]] = 0.0  # the two rows that a lookup at t = 0 or t = 1 reads: there a closed surface has its poles
    return (np.rint(height / STEP) * STEP).astype(np.float32)


def _spike_field(size: int, seed: int, columns: int, rows: int, low: float, high: float) -> F64:
    """One spike in each cell of a grid, wholly inside it, so that cell borders are 0; heights from `low` to `high`."""
    column, row = _texels(size)
    t = (row + 0.5) / size * rows
    cell_t = np.floor(t).astype(np.int64)
    s = (column + 0.5) / size * columns + 0.5 * (cell_t % 2)  # every other row is moved by half a cell
    cell_s = np.floor(s).astype(np.int64) % columns
    radius = 0.34 + 0.1 * uniform(seed, cell_s, cell_t, 0)
    room = 0.47 - radius
    centre_s = 0.5 + room * (2 * uniform(seed, cell_s, cell_t, 1) - 1)
    centre_t = 0.5 + room * (2 * uniform(seed, cell_s, cell_t, 2) - 1)
    ds, dt = (s - np.floor(s) - centre_s) / radius, (t - cell_t - centre_t) / radius
    slope = np.maximum(0.0, 1.0 - np.sqrt(ds * ds + dt * dt))
    return (low + (high - low) * uniform(seed, cell_s, cell_t, 3)) * slope * slope


def flutes(size: int, seed: int) -> F32:
    """Sixteen grooves along t (0: the ridge, 1: the groove's bottom) that run out near the ends; the stone is a bit worn."""
    column, row = _texels(size)
    groove = np.array([0.5 - 0.5 * cos_turns(16 * (k + 0.5) / size) for k in range(size)])[column]
    t = (row + 0.5) / size
    run_out = np.clip(16 * np.minimum(t, 1 - t) - 0.5, 0.0, 1.0)
    worn = 0.12 * _smooth_noise(size, seed, 32)
    return _finish(groove * run_out + worn)


def leaves(size: int, seed: int) -> F32:
    """Two rows of upright leaves with tips, twelve around, the upper row between the tips of the lower one."""
    column, row = _texels(size)
    s, t = (column + 0.5) / size * 12, (row + 0.5) / size
    height = np.zeros((size, size))
    for offset, foot, tip in ((0.5, 0.3, 0.95), (0.0, 0.0, 0.6)):
        up = np.clip((t - foot) / (tip - foot), 0.0, 1.0)
        width = 4 * up * (1 - up) + 0.15 * (up < 0.9)
        side = np.abs((s + offset) % 1.0 - 0.5) * 2
        leaf = np.maximum(0.0, 1 - side / np.maximum(width, STEP)) * (0.4 + 0.6 * up) * (up > 0) * (up < 1)
        height = np.maximum(height, leaf)
    return _finish(height + 0.02 * _smooth_noise(size, seed, 32))


def coffers(size: int, seed: int) -> F32:
    """Four by four sunk panels with two steps and a boss in the middle; 1 on the beams between them."""
    column, row = _texels(size)
    x = np.abs((column + 0.5) / size * 4 % 1.0 - 0.5) * 2
    y = np.abs((row + 0.5) / size * 4 % 1.0 - 0.5) * 2
    from_middle = np.maximum(x, y)  # 0 in the middle of a panel, 1 in the middle of a beam
    stairs = 0.5 * np.clip((from_middle - 0.75) * 16, 0, 1) + 0.4 * np.clip((from_middle - 0.5) * 16, 0, 1)
    boss = 0.4 * np.maximum(0.0, 1 - 12 * (x * x + y * y))
    return _finish(stairs + boss + 0.04 * _smooth_noise(size, seed, 64))


def stones(size: int, seed: int) -> F32:
    """Courses of cut stones, eight high and four long, each of its own height; 0 in the joints."""
    column, row = _texels(size)
    t = (row + 0.5) / size * 8
    course = np.floor(t).astype(np.int64)
    s = (column + 0.5) / size * 4 + 0.5 * (course % 2)
    stone = np.floor(s).astype(np.int64) % 4
    to_joint = np.minimum(0.5 - np.abs(s % 1.0 - 0.5), (0.5 - np.abs(t % 1.0 - 0.5)) / 2)
    face = np.clip(to_joint * 20 - 0.25, 0.0, 1.0)
    return _finish(face * (0.7 + 0.2 * uniform(seed, stone, course) + 0.1 * _smooth_noise(size, seed, 64)))


def _smooth_noise(size: int, seed: int, cells: int) -> F64:
    """Periodic noise in [0, 1): a lattice of `cells` x `cells` values, bilinear between them."""
    column, row = _texels(size)
    x, y = column / size * cells, row / size * cells
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = x - i, y - j
    values = [[uniform(seed, (i + a) % cells, (j + b) % cells) for a in (0, 1)] for b in (0, 1)]
    lower, upper = ((1 - fx) * left + fx * right for left, right in values)
    return (1 - fy) * lower + fy * upper


def _texels(size: int) -> tuple[I64, I64]:
    """Column and row of each texel, as arrays that broadcast to (size, size)."""
    return np.arange(size)[None, :], np.arange(size)[:, None]


def _finish(height: F64) -> F32:
    """Stretch to [0, 1], then round to the grid."""
    low, high = height.min(), height.max()
    return (np.rint((height - low) / max(high - low, STEP) / STEP) * STEP).astype(np.float32)


MAPS: dict[str, Callable[[int, int], F32]] = {
    "sea": sea,
    "spikes": spikes,
    "flutes": flutes,
    "leaves": leaves,
    "coffers": coffers,
    "stones": stones,
    "hide": hide,
    "small_hide": small_hide,
}
