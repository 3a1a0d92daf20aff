"""Wavefront OBJ files as control meshes: polygons, texture seams and OpenSubdiv's tags are kept as the file has them.

Read are `v`, `vt`, `f`, `o` (each starts an object), and the tags `t crease`, `t corner` and `t interpolateboundary` of
OpenSubdiv's dialect, whose vertex numbers count from 0. Normals, materials and groups say nothing that a subdivision
surface needs; lines and points are left out with a warning.

A file is read in blocks of whole lines. In each the lines of a kind are parsed all at once by NumPy; where that does not
come out even, the block's lines are gone through one by one for the message (`obj_lines`).
"""

import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.types import F32, I32, I64
from tiler.scene.arrays import ArrayFault, bytes_of
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.numbers import numbers_in
from tiler.scene.obj_lines import Tags, first_fault, read_tag
from tiler.scene.polygons import Polygons, split_objects

FILE_LIMIT = 2**31  # bytes
CORNER_LIMIT = 2**26  # face corners
VERTEX_LIMIT = 2**26
BLOCK = 2**24  # bytes parsed at once
INDEX_LIMIT = 10**18  # what a whole number of at most 18 digits stays below
ABSENT = 2**62  # stands for the index that `v//vn` leaves out

_CONTINUED = re.compile(rb"(?:[^\n]*\\\n)+[^\n]*")
_SKIPPED = (b"vn", b"vp", b"g", b"s", b"usemtl", b"mtllib", b"usemap", b"lod", b"#")


class _Block(NamedTuple):
    """What one block of lines says, indices still as written."""

    vertices: F32  # (v, 3)
    vertex_lines: I64  # line number of each
    texcoords: F32  # (t, 2)
    texcoord_lines: I64
    sizes: I32  # (f,) corners of each face
    face_lines: I64
    corners: I64  # (c, 2) vertex and texture index as written; ABSENT where there is none
    objects: list[tuple[int, str]]  # line number and name
    tags: list[tuple[int, Tags]]
    skipped: list[bytes]  # records that are left out


def read_obj(path: Path) -> tuple[list[ControlMesh], tuple[str, ...]]:
    """The objects of an OBJ file that have faces, and warnings. Raises ArrayFault with the line of the first fault."""
    data = bytes_of(path, FILE_LIMIT)
    faces = data.count(b"\nf ")
    if 3 * faces > CORNER_LIMIT:
        raise ArrayFault(f"has {faces:,} faces; allowed: at most {CORNER_LIMIT:,} face corners in all")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    blocks, corners, vertices = [], 0, 0
    for first_line, text in _blocks(data):
        block = _parse(text, first_line)
        corners += len(block.corners)
        vertices += max(len(block.vertices), len(block.texcoords))
        if corners > CORNER_LIMIT or vertices > VERTEX_LIMIT:
            raise ArrayFault(
                f"has more than {CORNER_LIMIT:,} face corners or {VERTEX_LIMIT:,} vertices; allowed: at most so many"
            )
        blocks.append(block)
    return _assemble(blocks, path.stem)


def _blocks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Pieces of whole lines, with the number of the first."""
    start, line = 0, 1
    while start < len(data):
        end = len(data)
        if start + BLOCK < len(data):  # the last line end in reach, else the first beyond
            end = (data.rfind(b"\n", start, start + BLOCK) + 1) or (data.find(b"\n", start + BLOCK) + 1) or len(data)
        while end < len(data) and data[end - 2 : end] == b"\\\n":  # a continued line stays in one piece
            end = (data.find(b"\n", end) + 1) or len(data)
        text = data[start:end]
        yield line, text
        line += text.count(b"\n")
        start = end


def _parse(text: bytes, first_line: int) -> _Block:
    """One block. A continued line counts as its first line."""
    if b"\\\n" in text:
        text = _CONTINUED.sub(lambda m: m[0].replace(b"\\\n", b" ") + b"\n" * m[0].count(b"\n"), text)
    rows: dict[bytes, list[list[bytes]]] = {b"v": [], b"vt": [], b"f": []}
    numbers: dict[bytes, list[int]] = {b"v": [], b"vt": [], b"f": []}
    objects, tags, skipped = [], [], []
    for number, line in enumerate(text.split(b"\n"), first_line):
        row = line.split()
        if not row:
            continue
        key = row[0]
        if key in rows:
            if b"#" in line:
                row = line.split(b"#")[0].split()
            rows[key].append(row)
            numbers[key].append(number)
        elif key == b"o":
            objects.append((number, line.split(None, 1)[1].decode("utf-8", "replace").strip() if row[1:] else ""))
        elif key == b"t":
            tags.append((number, read_tag(number, row)))
        elif key not in _SKIPPED and not key.startswith(b"#"):
            skipped.append(key)
    vertices, texcoords = _points(rows[b"v"], 3), _points(rows[b"vt"], 2)
    faces = _corners(rows[b"f"])
    if vertices is None or texcoords is None or faces is None:
        raise first_fault(rows, numbers, text)
    lines = [np.array(numbers[key], np.int64) for key in (b"v", b"vt", b"f")]
    return _Block(vertices, lines[0], texcoords, lines[1], faces[0], lines[2], faces[1], objects, tags, skipped)


def _points(rows: list[list[bytes]], width: int) -> F32 | None:
    """The first `width` numbers of each row; None where a row has fewer, or something else."""
    # `vt` may have one number only (t is 0 then) and both may have more: weights, colours, a third coordinate.
    if width == 2:
        rows = [row if len(row) != 2 else [*row, b"0"] for row in rows]
    if rows and min(map(len, rows)) <= width:
        return None
    values = numbers_in(chain.from_iterable(row[1 : width + 1] for row in rows), len(rows) * width, np.float64)
    if values is None:
        return None
    with np.errstate(over="ignore"):
        return values.reshape(-1, width).astype(np.float32)


def _corners(rows: list[list[bytes]]) -> tuple[I32, I64] | None:
    """Corners of each face, and the indices (c, 2) of all; None where something is no index or a face has no three."""
    sizes = np.fromiter(map(len, rows), np.int32, len(rows)) - 1
    if len(sizes) and sizes.min() < 3:
        return None
    count = int(sizes.sum())
    text = b" ".join(chain.from_iterable(row[1:] for row in rows))
    if b"//" in text:
        text = text.replace(b"//", b"/%d/" % ABSENT)
    if b"/ " in text or text.endswith(b"/"):  # `1/`: a slash with nothing behind it
        text = (text + b" ").replace(b"/ ", b"/%d " % ABSENT)[:-1]
    # How many slashes each corner has: a running count of slashes, looked at where corners end.
    signs = np.frombuffer(text, np.uint8)
    signs = signs[(signs == 32) | (signs == 47)]
    ends = np.append(np.flatnonzero(signs == 32), len(signs))
    slashes = np.diff(ends, prepend=-1) - 1
    if len(slashes) != max(count, 1) or slashes.max() > 2:
        return None
    values = numbers_in([text.replace(b"/", b" ")], count + int(slashes.sum()), np.int64)
    if values is None:
        return None
    if not count:
        return sizes, np.zeros((0, 2), np.int64)
    if (np.abs(np.where(values == ABSENT, 0, values)) > INDEX_LIMIT).any():  # the parser stops at the largest of int64
        return None
    first = np.cumsum(slashes + 1) - (slashes + 1)
    if (values[first] == ABSENT).any():
        return None
    texcoord = np.where(slashes > 0, values[np.minimum(first + 1, len(values) - 1)], ABSENT)
    return sizes, np.stack([values[first], texcoord], axis=1)


def _assemble(blocks: list[_Block], stem: str) -> tuple[list[ControlMesh], tuple[str, ...]]:
    """Resolve indices, then cut the file into its objects."""
    if not blocks or not sum(len(b.sizes) for b in blocks):
        raise ArrayFault("has no face; allowed: an OBJ file with at least one f line")
    joined = [np.concatenate([getattr(b, name) for b in blocks]) for name in _Block._fields[:7]]
    vertices, vertex_lines, texcoords, texcoord_lines, sizes, face_lines, corners = joined
    corner_lines = np.repeat(face_lines, sizes)
    vertex = _resolved(corners[:, 0], corner_lines, vertex_lines, "vertex")
    texcoord = _resolved(corners[:, 1], corner_lines, texcoord_lines, "texture coordinate")
    first = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype(np.int32)
    _refuse_repeats(vertex, first, sizes, face_lines)
    objects = list(chain.from_iterable(b.objects for b in blocks))
    starts = np.array([line for line, _ in objects], np.int64)
    object_of_face = np.searchsorted(starts, face_lines)  # 0: before the first o line
    names = [stem, *(name or stem for _, name in objects)]
    tags = Tags.all_of(chain.from_iterable(b.tags for b in blocks), len(vertices))
    polygons = Polygons(vertices, first, vertex, texcoords, texcoord)
    warnings = list(tags.warnings)
    skipped = list(chain.from_iterable(b.skipped for b in blocks))
    if skipped:
        kinds = ", ".join(sorted({key.decode("utf-8", "replace")[:20] for key in skipped})[:5])
        warnings.append(f"{len(skipped)} lines of other kinds are left out: {kinds}")
    meshes, more = split_objects(polygons, object_of_face, names, tags)
    return meshes, (*warnings, *more)


def _resolved(index: I64, corner_lines: I64, record_lines: I64, what: str) -> I32:
    """Indices from 0; -1 where absent. Negative ones count back from the records above the face's line."""
    count = len(record_lines)
    absent = index == ABSENT
    back = index < 0
    above = np.searchsorted(record_lines, corner_lines[back])
    resolved = np.where(absent, -1, index - 1)
    resolved[back] = above + index[back]
    wrong = ~absent & ((resolved < 0) | (resolved >= count))
    if wrong.any():
        k = int(np.argmax(wrong))
        known = f"1 to {count:,}, or -{count:,} to -1" if count else f"none: the file has no {what}"
        raise ArrayFault(f"line {corner_lines[k]}: has {what} {index[k]}; allowed: {known}")
    return resolved.astype(np.int32)


def _refuse_repeats(vertex: I32, first: I32, sizes: I32, face_lines: I64) -> None:
    """A polygon that comes back to one of its vertices has no well-defined neighbours there."""
    for size in np.unique(sizes):
        faces = np.flatnonzero(sizes == size)
        ring = np.sort(vertex[first[faces, None] + np.arange(size)], axis=1)
        repeated = (ring[:, 1:] == ring[:, :-1]).any(axis=1)
        if repeated.any():
            f = int(np.argmax(repeated))
            twice = ring[f][1:][ring[f][1:] == ring[f][:-1]][0]
            raise ArrayFault(
                f"line {face_lines[faces[f]]}: names vertex {twice + 1} twice; allowed: different vertices"
            )
