"""Single lines of OBJ files: the tags of OpenSubdiv's dialect, and what is wrong with a line that would not parse."""

import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pipeline.types import F32, I32
from tiler.scene.arrays import ArrayFault
from tiler.scene.control_mesh import Boundary

_NUMBER = re.compile(rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf(?:inity)?)", re.IGNORECASE)
_INDEX = re.compile(rb"[+-]?\d{1,18}")
_WIDTH = {b"v": 3, b"vt": 1}
SHARPNESS_LIMIT = 1e6


class Tags(NamedTuple):
    """What tags say; vertex numbers from 0, of the whole file."""

    crease_edges: I32  # (E, 2)
    crease_sharpness: F32  # (E,)
    corner_vertices: I32  # (C,)
    corner_sharpness: F32  # (C,)
    boundary: Boundary | None
    warnings: tuple[str, ...]

    @staticmethod
    def all_of(tags: "Iterable[tuple[int, Tags]]", num_vertices: int) -> "Tags":
        """Tags of several lines in one; each comes with its line's number, for the message where a vertex is unknown."""
        numbered = list(tags)
        for line, tag in numbered:
            for index in (*tag.crease_edges.ravel(), *tag.corner_vertices):
                if not 0 <= index < num_vertices:
                    raise ArrayFault(
                        f"line {line}: the tag has vertex {index}; allowed: 0 to {num_vertices - 1} (tags count from 0)"
                    )
        every = [NO_TAGS, *(tag for _, tag in numbered)]
        boundaries = [tag.boundary for tag in every if tag.boundary is not None]
        return Tags(
            np.concatenate([t.crease_edges for t in every]),
            np.concatenate([t.crease_sharpness for t in every]),
            np.concatenate([t.corner_vertices for t in every]),
            np.concatenate([t.corner_sharpness for t in every]),
            boundaries[-1] if boundaries else None,
            tuple(dict.fromkeys(warning for t in every for warning in t.warnings)),
        )


NO_TAGS = Tags(
    np.zeros((0, 2), np.int32), np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32), None, ()
)


def read_tag(line: int, row: list[bytes]) -> Tags:
    """One line `t NAME INTEGERS/FLOATS/STRINGS integers... floats... strings...`."""
    name = row[1].decode("utf-8", "replace") if len(row) > 1 else ""
    if name not in ("crease", "corner", "interpolateboundary"):
        return NO_TAGS._replace(warnings=(f"tags {name!r} are left out",))
    counts = row[2].split(b"/") if len(row) > 2 else []
    if len(counts) != 3 or not all(c.isdigit() and len(c) < 8 for c in counts):
        raise ArrayFault(f"line {line}: tag {name} has no counts; allowed: INTEGERS/FLOATS/STRINGS, such as 2/1/0")
    num_integers, num_floats = int(counts[0]), int(counts[1])
    words = row[3:]
    if len(words) < num_integers + num_floats:
        raise ArrayFault(f"line {line}: tag {name} has {len(words)} values; needed: {num_integers + num_floats}")
    for word in words[:num_integers]:
        if not _INDEX.fullmatch(word):
            raise ArrayFault(f"line {line}: {_shown(word)} is not a whole number")
    integers = np.array([min(int(w), 2**31 - 1) for w in words[:num_integers]], np.int32)
    floats = [_sharpness(line, w) for w in words[num_integers : num_integers + num_floats]]
    if name == "interpolateboundary":
        return _boundary_tag(line, integers)
    per = 2 if name == "crease" else 1
    if num_integers % per or not num_integers or num_floats not in (1, num_integers // per):
        raise ArrayFault(
            f"line {line}: tag {name} has {num_integers} vertices and {num_floats} sharpnesses; allowed: "
            f"{'pairs of vertices' if per == 2 else 'vertices'}, and one sharpness, or one for each"
        )
    sharpness = np.broadcast_to(np.array(floats, np.float32), num_integers // per)
    sharp = sharpness > 0
    if name == "crease":
        return NO_TAGS._replace(crease_edges=integers.reshape(-1, 2)[sharp], crease_sharpness=sharpness[sharp])
    return NO_TAGS._replace(corner_vertices=integers[sharp], corner_sharpness=sharpness[sharp])


def _boundary_tag(line: int, integers: I32) -> Tags:
    """RenderMan's numbers: 0 cuts off the faces at a boundary, 1 keeps corners sharp, 2 does not."""
    rule = int(integers[0]) if len(integers) == 1 else -1
    if rule not in (0, 1, 2):
        raise ArrayFault(f"line {line}: tag interpolateboundary has {integers.tolist()}; allowed: 0, 1 or 2")
    if rule == 0:
        told = "interpolateboundary 0 (no surface at boundaries) is read as 1 (edges and corners)"
        return NO_TAGS._replace(boundary="edge_and_corner", warnings=(told,))
    return NO_TAGS._replace(boundary="edge_and_corner" if rule == 1 else "edge_only")


def _sharpness(line: int, word: bytes) -> float:
    if not _NUMBER.fullmatch(word):
        raise ArrayFault(f"line {line}: {_shown(word)} is not a number")
    value = float(word)
    if value < 0 or value != value:
        raise ArrayFault(f"line {line}: sharpness {_shown(word)}; allowed: numbers from 0")
    return min(value, SHARPNESS_LIMIT)


def first_fault(rows: dict[bytes, list[list[bytes]]], numbers: dict[bytes, list[int]], text: bytes) -> ArrayFault:
    """What is wrong with the first wrong line of a block."""
    lines = sorted((number, row) for key in rows for number, row in zip(numbers[key], rows[key], strict=True))
    for number, row in lines:
        problem = _problem(row)
        if problem:
            last = number == lines[-1][0] and not text.endswith(b"\n")
            return ArrayFault(
                f"line {number}: {problem}" + (" (the file ends here: it seems cut short)" if last else "")
            )
    return ArrayFault("has numbers that cannot be read")


def _problem(row: list[bytes]) -> str | None:
    """What is wrong with a line v, vt or f."""
    key, words = row[0].decode(), row[1:]
    if key == "f":
        if len(words) < 3:
            return f"a face of {len(words)} vertices; allowed: at least 3"
        return next((problem for word in words if (problem := _corner_problem(word))), None)
    width = _WIDTH[row[0]]
    if len(words) < width:
        return f"{key} has {len(words)} numbers; needed: {width}"
    for word in words[: max(width, 2)]:
        if not _NUMBER.fullmatch(word):
            return f"{_shown(word)} is not a number"
    return None


def _corner_problem(word: bytes) -> str | None:
    parts = word.split(b"/")
    if len(parts) > 3 or not parts[0]:
        return f"{_shown(word)} is no corner; allowed: v, v/vt, v//vn, v/vt/vn"
    wrong = next((part for k, part in enumerate(parts) if not (_INDEX.fullmatch(part) or (k and not part))), None)
    return None if wrong is None else f"{_shown(wrong)} is not a whole number"


def _shown(word: bytes) -> str:
    """A word of a file, cut short where it is long."""
    text = word.decode("utf-8", "replace")
    return repr(text if len(text) <= 30 else text[:27] + "...")
