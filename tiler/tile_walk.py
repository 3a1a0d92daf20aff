"""Order in which tiles are worked off: scanline, along Morton's or along Hilbert's curve over the next power of two."""

import numpy as np

from pipeline.types import I64
from tiler.grid import Grid


def _morton(x: I64, y: I64, log2: int) -> I64:
    """Place on Morton's curve: the bits of x and y interleaved, y the higher."""
    place = np.zeros_like(x)
    for bit in range(log2):
        place |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return place


def _hilbert(x: I64, y: I64, log2: int) -> I64:
    """Place on Hilbert's curve: quadrant by quadrant from the top, each turned or mirrored so that neighbours meet."""
    place, x, y = np.zeros_like(x), x.copy(), y.copy()
    for bit in range(log2 - 1, -1, -1):
        side = np.int64(1) << bit
        right, low = (x & side) > 0, (y & side) > 0
        place += side * side * ((3 * right) ^ low)
        flip = ~low & right
        x, y = np.where(flip, side - 1 - (x & (side - 1)), x & (side - 1)), np.where(
            flip, side - 1 - (y & (side - 1)), y & (side - 1)
        )  # fmt: skip
        x, y = np.where(low, x, y), np.where(low, y, x)
    return place


def walk_tiles(grid: Grid, walk: str) -> I64:
    """All tiles of the grid in the order of the walk, int64[tiles]: `scanline`, `morton` or `hilbert`."""
    tile = np.arange(grid.num_tiles)
    if walk == "scanline":
        return tile
    y, x = np.divmod(tile, grid.tiles_x)
    log2 = (max(grid.tiles_x, grid.tiles_y) - 1).bit_length()
    return np.argsort((_morton if walk == "morton" else _hilbert)(x, y, log2), kind="stable")
