"""Slow twin of the coarse Z pyramid: blocks in dictionaries, every coarser cell found anew from its blocks."""

from collections.abc import Callable

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

    def first_level(self, box: tuple[int, int, int, int], largest: int) -> int:
        x0, y0, x1, y1 = box
        level = 0
        while True:
            side = self.block << level
            if side * 2 > largest or (x1 // side - x0 // side < 2 and y1 // side - y0 // side < 2):
                return level
            level += 1

    def hidden_hull(
        self,
        box: tuple[int, int, int, int],
        nearest: Callable[[tuple[int, int, int, int]], np.float32],
        reached: Callable[[tuple[int, int, int, int]], bool] | None,
        strict: bool,
        largest: int,
    ) -> tuple[int | None, int, int, int]:
        """Test a hull: the finest level read, None if it is not hidden; cells read, asked for the outline, missed by it.

        nearest : depth of the bound in pixels. reached : whether its outline reaches pixels; None: it has no outline.
        """
        count = {"read": 0, "asked": 0, "missed": 0, "level": self.first_level(box, largest)}

        def hides_all(level: int, part: tuple[int, int, int, int]) -> bool:
            """Whether each cell of a level that the pixels touch passes, in the order of reading."""
            side = self.block << level
            x0, y0, x1, y1 = part
            count["level"] = min(count["level"], level)
            for cy in range(y0 // side, y1 // side + 1):
                for cx in range(x0 // side, x1 // side + 1):
                    inside = (
                        max(x0, cx * side), max(y0, cy * side), min(x1, cx * side + side - 1), min(y1, cy * side + side - 1)
                    )  # fmt: skip
                    count["read"] += 1
                    below = [f for (bx, by), f in self.far.items() if bx >> level == cx and by >> level == cy]
                    if self.hides(max(below), nearest(inside), strict):
                        continue
                    if reached is not None:
                        count["asked"] += 1
                        if not reached(inside):
                            count["missed"] += 1
                            continue
                    if level == 0 or not hides_all(level - 1, inside):
                        return False
            return True

        hidden = hides_all(count["level"], box)
        return count["level"] if hidden else None, count["read"], count["asked"], count["missed"]

    def hidden_at(
        self, box: tuple[int, int, int, int], z: np.float32, strict: bool, largest: int
    ) -> tuple[int | None, int]:
        """Level at which the box is seen to hide z, and how many cells were read; cells of at most `largest` pixels."""
        x0, y0, x1, y1 = box
        level = self.first_level(box, largest)
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
