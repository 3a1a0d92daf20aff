"""The screen cut into square tiles, numbered in scanline order."""

from typing import NamedTuple


class Grid(NamedTuple):
    """Tiles of 2**tile_log2 pixels a side over a picture; the last column and row may be cut off by its border."""

    width: int
    height: int
    tile_log2: int
    tiles_x: int
    tiles_y: int

    @property
    def num_tiles(self) -> int:
        """Number of tiles."""
        return self.tiles_x * self.tiles_y


def make_grid(width: int, height: int, tile: int) -> Grid:
    """Grid of `tile` x `tile` pixels (a power of two) over a picture of width x height pixels."""
    return Grid(width, height, tile.bit_length() - 1, -(-width // tile), -(-height // tile))
