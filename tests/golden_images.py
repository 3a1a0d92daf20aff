"""Golden pictures and counters: compared exactly, and on a mismatch everything left behind that one needs to look at."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tiler.frame import Frame

MAX_TILES_NAMED = 12


@dataclass(frozen=True)
class Golden:
    """folder : the golden files. failed : where the pictures of a mismatch go. update : write instead of comparing."""

    folder: Path
    failed: Path
    update: bool = False

    def check(self, name: str, frame: Frame) -> None:
        """Fail unless picture and counters of the frame are those of `NAME.png` and `NAME.counters.txt`, exactly."""
        if self.update:
            self.write(name, frame)
            return
        problems = [p for p in (self._compare_picture(name, frame), self._compare_counters(name, frame)) if p]
        if problems:
            advice = "if the new one is right: python -m pytest tests/test_golden.py --update-golden, look, and commit"
            pytest.fail("\n".join([*problems, advice]), pytrace=False)

    def write(self, name: str, frame: Frame) -> None:
        """Make both files anew; each appears whole."""
        self.folder.mkdir(parents=True, exist_ok=True)
        save_picture(frame.color, self.folder / f"{name}.png")
        text = self.folder / f"{name}.counters.txt"
        beside = text.with_suffix(".new")
        beside.write_text(counter_lines(frame.counters))
        os.replace(beside, text)

    def _compare_picture(self, name: str, frame: Frame) -> str:
        file = self.folder / f"{name}.png"
        folder = self.failed / name
        if not file.exists():
            save_picture(frame.color, folder / "actual.png")
            return f"golden picture missing: {file.name} in {self.folder}; what was drawn is in {folder}"
        expected = np.asarray(Image.open(file).convert("RGBA"))
        if expected.shape != frame.color.shape:
            difference = None
            what = f"is {size_text(frame.color)} pixels, expected {size_text(expected)}"
        else:
            difference = picture_difference(expected, frame.color)
            if not difference.any():
                return ""
            what = describe_difference(difference, frame.machine.tile)
        save_picture(expected, folder / "expected.png")
        save_picture(frame.color, folder / "actual.png")
        if difference is not None:
            save_picture(show_difference(difference), folder / "difference.png")
        return f"golden picture {name}: {what}\nexpected, actual and difference are in {folder}"

    def _compare_counters(self, name: str, frame: Frame) -> str:
        file = self.folder / f"{name}.counters.txt"
        if not file.exists():
            return f"golden counters missing: {file.name} in {self.folder}"
        expected, actual = read_counters(file.read_text()), dict(frame.counters)
        lines = []
        for counter in expected | actual:
            a, b = expected.get(counter), actual.get(counter)
            if a != b:
                deviation = f"{b - a:+}" if a is not None and b is not None else "appeared" if a is None else "is gone"
                lines.append(f"  {counter}: expected {a}, measured {b}, {deviation}")
        return "\n".join([f"golden counters {name}: {len(lines)} differ", *lines]) if lines else ""


def counter_lines(counters: Mapping[str, int]) -> str:
    """One line a counter, `name value`: a change shows as one line of a diff."""
    return "".join(f"{name} {value}\n" for name, value in counters.items())


def read_counters(text: str) -> dict[str, int]:
    """Inverse of `counter_lines`."""
    return {name: int(value) for name, value in (line.split() for line in text.splitlines())}


def picture_difference(expected: np.ndarray, actual: np.ndarray) -> np.ndarray:
    """Absolute difference of two pictures, int[H, W, 4]."""
    return np.abs(expected.astype(int) - actual.astype(int))


def describe_difference(difference: np.ndarray, tile: int) -> str:
    """How many pixels differ, where, and by how much."""
    rows, columns = np.nonzero(difference.any(axis=2))
    tiles = sorted({(int(y), int(x)) for y, x in zip(rows // tile, columns // tile, strict=True)})
    named = " ".join(f"({x}, {y})" for y, x in tiles[:MAX_TILES_NAMED])
    more = f" and {len(tiles) - MAX_TILES_NAMED} more" if len(tiles) > MAX_TILES_NAMED else ""
    return (
        f"{len(rows)} of {difference[..., 0].size} pixels differ, in columns {columns.min()} to {columns.max()} and rows "
        f"{rows.min()} to {rows.max()}; largest difference {difference.max()} of 255; "
        f"tiles (x, y) of {tile} pixels touched: {named}{more}"
    )


def show_difference(difference: np.ndarray) -> np.ndarray:
    """The difference as a picture: black where equal, at least half bright where not."""
    largest = difference.max(axis=2, keepdims=True)
    bright = np.where(difference > 0, 128 + difference // 2, 0)
    shown = np.where(largest > 0, np.maximum(bright, 48), 0).astype(np.uint8)
    shown[..., 3] = 255
    return shown


def size_text(picture: np.ndarray) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"


def save_picture(picture: np.ndarray, file: Path) -> None:
    """Write a picture beside its place, then rename it: it appears whole."""
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_suffix(".new")
    Image.fromarray(np.ascontiguousarray(picture)).save(beside, format="png", optimize=True)
    os.replace(beside, file)
