"""Slow twin of the coarse Z pyramid: blocks in dictionaries, every coarser cell found anew from its blocks."""

import numpy as np


class NaiveCoarseZ:
    """Farthest and nearest depth of each block (bx, by) as they were when it was last read."""

    def __init__(self, width: int, height: int, block: int) -> None:
        self.width, self.height, self.block = width, height, block
        places = [(bx, by) for by in range(-(-height // block)) for bx in range(-(-width // block))]
        self.far = dict.fromkeys(places, np.float32(1))
        self.near = dict.fromkeys(places, np.float32(1))

    def pixels(self, place: tuple[int, int]) -> tuple[range, range]:
        """Columns and rows of a block."""
        bx, by = place
        return (
            range(bx * self.block, min((bx + 1) * self.block, self.width)),
            range(by * self.block, min((by + 1) * self.block, self.height)),
        )

    def blocks(self, box: tuple[int, int, int, int]) -> list[tuple[int, int]]:
        """Blocks of pixels x0, y0, x1, y1, inclusive."""
        x0, y0, x1, y1 = (c // self.block for c in box)
        return [(bx, by) for by in range(y0, y1 + 1) for bx in range(x0, x1 + 1)]

    def read(self, place: tuple[int, int], depth: np.ndarray) -> None:
        columns, rows = self.pixels(place)
        depths = [z for y in rows for x in columns for z in depth[y, x]]
        self.far[place], self.near[place] = max(depths), min(depths)

    def read_all(self, depth: np.ndarray) -> None:
        for place in self.far:
            self.read(place, depth)

    @staticmethod
    def hides(far: np.float32, z: np.float32, strict: bool) -> bool:
        return z > far if strict else z >= far

    def hidden_at(
        self, box: tuple[int, int, int, int], z: np.float32, strict: bool, largest: int
    ) -> tuple[int | None, int]:
        """Level at which the box is seen to hide z, and how many cells were read; cells of at most `largest` pixels."""
        x0, y0, x1, y1 = box
        level = 0
        while True:
            side = self.block << level
            if side * 2 > largest or (x1 // side - x0 // side < 2 and y1 // side - y0 // side < 2):
                break
            level += 1
        read = 0
        for k in range(level, -1, -1):
            side = self.block << k
            cells = [(cx, cy) for cy in range(y0 // side, y1 // side + 1) for cx in range(x0 // side, x1 // side + 1)]
            hidden = True
            for cx, cy in cells:
                read += 1
                below = [f for (bx, by), f in self.far.items() if bx >> k == cx and by >> k == cy]
                if not self.hides(max(below), z, strict):
                    hidden = False
                    break
            if hidden:
                return k, read
        return None, read
