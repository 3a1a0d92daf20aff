"""Files of tensor-product Bezier patches: Bezier View (.bv) and .bpt. Degrees up to 3 become bicubic, exactly but for rounding.

.bv : https://www.cise.ufl.edu/research/SurfLab/bview. Segments, each a kind, its degrees and its points; a line
    `Group NUMBER NAME` may stand before one. Read are the kinds 4 (one degree for both directions), 5 (two degrees) and 8
    (two degrees, rational, points (wx, wy, wz, w)). The points follow row by row: v runs fastest.
.bpt : https://www.holmes3d.net/graphics/roffview/tools/patchoff. The number of patches, then for each its degrees and its
    points, the first direction (our u) fastest.

What the two leave open is which side is the front: here as everywhere du x dv points to it.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.types import F64
from tiler.scene.arrays import ArrayFault, bytes_of, checked_mesh
from tiler.scene.mesh import Mesh

FILE_LIMIT = 2**30  # bytes
PATCH_LIMIT = 2**22
DEGREE = 3
BV_KINDS = {1: "a polyhedron", 3: "a triangular patch", 9: "a PN triangle", 10: "a PN quad"}

_WORD = re.compile(rb"\S+")
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


class Words:
    """The words of a file one after the other, with their lines."""

    def __init__(self, path: Path) -> None:
        self.text = bytes_of(path, FILE_LIMIT).removeprefix(b"\xef\xbb\xbf")
        self.at = 0

    def line(self) -> int:
        """Number of the line that was read last."""
        return self.text.count(b"\n", 0, max(self.at - 1, 0)) + 1

    def next(self) -> bytes | None:
        """The next word, None at the end."""
        match = _WORD.search(self.text, self.at)
        if match is None:
            return None
        self.at = match.end()
        return match[0]

    def skip_line(self) -> None:
        """Leave out the rest of this line."""
        end = self.text.find(b"\n", self.at)
        self.at = len(self.text) if end < 0 else end

    def whole(self, what: str, least: int, most: int) -> int:
        """The next word as a whole number."""
        word = self.next()
        if word is None or not word.isdigit() or len(word) > 12 or not least <= int(word) <= most:
            told = "ends" if word is None else f"has {word.decode('utf-8', 'replace')[:30]!r}"
            raise ArrayFault(f"line {self.line()}: {told} where {what} should be; allowed: {least} to {most}")
        return int(word)

    def points(self, rows: int, width: int) -> F64:
        """The next `rows` points, (rows, width)."""
        values = []
        for _ in range(rows * width):
            word = self.next()
            if word is None or not _NUMBER.fullmatch(word):
                told = "the file ends" if word is None else f"{word.decode('utf-8', 'replace')[:30]!r} is not a number"
                raise ArrayFault(f"line {self.line()}: {told}; needed: {rows} points of {width} numbers")
            values.append(float(word))
        return np.array(values).reshape(rows, width)


def read_bv(path: Path) -> Mesh:
    """Patches of a Bezier View file. Raises ArrayFault."""
    words = Words(path)
    patches = []
    while (word := words.next()) is not None:
        if word.lower() == b"group":
            words.skip_line()
            continue
        kind = int(word) if word.isdigit() and len(word) < 4 else -1
        if kind not in (4, 5, 8):
            told = BV_KINDS.get(kind, repr(word.decode("utf-8", "replace")[:30]))
            raise ArrayFault(f"line {words.line()}: has {told}; allowed: patches of kind 4, 5 or 8 (tensor product)")
        degree_u = words.whole("a degree", 1, DEGREE)
        degree_v = degree_u if kind == 4 else words.whole("a degree", 1, DEGREE)
        points = words.points((degree_u + 1) * (degree_v + 1), 4 if kind == 8 else 3)
        patches.append(bicubic(points.reshape(degree_u + 1, degree_v + 1, -1)))
        _check_count(len(patches))
    return _mesh_of(patches)


def read_bpt(path: Path) -> Mesh:
    """Patches of a .bpt file. Raises ArrayFault."""
    words = Words(path)
    count = words.whole("the number of patches", 1, PATCH_LIMIT)
    if count * 2 * 16 > len(words.text):  # 2 degrees and 4 points make at least 14 words, each with a blank
        raise ArrayFault(f"line 1: says {count} patches, and the file is too short for them")
    patches = []
    for _ in range(count):
        degree_u, degree_v = words.whole("a degree", 1, DEGREE), words.whole("a degree", 1, DEGREE)
        points = words.points((degree_u + 1) * (degree_v + 1), 3)
        patches.append(bicubic(points.reshape(degree_v + 1, degree_u + 1, 3).transpose(1, 0, 2)))
    if words.next() is not None:
        raise ArrayFault(f"line {words.line()}: goes on after the last of {count} patches")
    return _mesh_of(patches)


def bicubic(points: F64) -> F64:
    """Points (m+1, n+1, c) of a patch of degrees m, n up to 3, raised to (4, 4, c)."""
    for _ in range(DEGREE + 1 - points.shape[0]):
        points = _raised(points)
    points = points.transpose(1, 0, 2)
    for _ in range(DEGREE + 1 - points.shape[0]):
        points = _raised(points)
    return points.transpose(1, 0, 2)


def _raised(points: F64) -> F64:
    """One degree more along axis 0: (k b[k-1] + (n - k) b[k]) / n, where n is the new degree."""
    n = len(points)
    k = np.arange(n + 1)[:, None, None]
    zero = np.zeros_like(points[:1])
    return (k * np.concatenate([zero, points]) + (n - k) * np.concatenate([points, zero])) / n


def _check_count(count: int) -> None:
    if count > PATCH_LIMIT:
        raise ArrayFault(f"has more than {PATCH_LIMIT:,} patches; allowed: at most so many")


def _mesh_of(patches: list[F64]) -> Mesh:
    """Mesh of patches (4, 4, 3) or (4, 4, 4)."""
    if not patches:
        raise ArrayFault("has no patch; allowed: at least one")
    points = np.ones((len(patches), 4, 4, 4))
    for p, patch in enumerate(patches):
        points[p, ..., : patch.shape[2]] = patch
    return checked_mesh(points, None)


READERS: dict[str, Callable[[Path], Mesh]] = {".bv": read_bv, ".bpt": read_bpt}
