"""The fixed-function tessellator: domain points and connectivity from tess factors.

D3D11.3 functional specification, chapter 11 (11.5 to 11.7). What it demands and what the reference tessellator chose
(the order of points and triangles) are both reproduced, bit for bit.

`tessellate` answers for one patch of any domain; `make_patterns` for all quad patches of a frame, each distinct
pattern once, with the points inside in rows. Underneath: factors become 16.16 keys (tess_factors), keys become points
(tess_points), and the number of points on each side becomes triangles (tess_connectivity).
"""

import threading
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.tess_connectivity import fill_indices, num_indices, num_points
from pipeline.tess_factors import (
    DOMAINS,
    ISOLINE,
    NUM_EDGES,
    NUM_INSIDES,
    NUM_SLOTS,
    ONE,
    OUTPUTS,
    PARTITIONINGS,
    QUAD,
    fix_factors,
    is_odd,
)
from pipeline.tess_points import MAX_SIDE_POINTS, fill_points, num_side_points, number_in_rows
from pipeline.types import F32, I32, I64, U16, U32, Patterns, TessFactors

LEGAL_OUTPUTS = {  # 11.7.15
    "quad": ("point", "triangle_cw", "triangle_ccw"),
    "tri": ("point", "triangle_cw", "triangle_ccw"),
    "isoline": ("point", "line"),
}


class PackedPatterns(NamedTuple):
    """Patterns one after the other; those of `Patterns`, for any output."""

    uv: F32  # (2, sum of points)
    first_point: I64  # (K+1,)
    indices: U16  # (sum of indices,) point numbers local to the pattern
    first_index: I64  # (K+1,)


@kernel
def _count(domain: int, partitioning: int, output: int, keys: I32, n: I64, first_point: I64, first_index: I64) -> None:
    """Points on each side `n` (K, 6), and where each pattern's points and indices begin."""
    for k in range(keys.shape[0]):
        num_slots = 0
        minimal = domain != ISOLINE
        while num_slots < NUM_SLOTS and keys[k, num_slots] > 0:
            minimal = minimal and keys[k, num_slots] == ONE
            num_slots += 1
        for s in range(NUM_SLOTS):
            if s >= num_slots:
                n[k, s] = 0
            elif minimal:  # all factors one: no ring inside, even where an inside factor of one acts as two
                n[k, s] = 2
            else:
                factor = np.int64(keys[k, s])
                n[k, s] = num_side_points(factor, is_odd(domain, partitioning, s, factor))
        first_point[k + 1] = first_point[k] + num_points(domain, n[k])
        first_index[k + 1] = first_index[k] + num_indices(domain, output, n[k])


@helper
def _put_in_rows(n: I64, uv: F32, indices: U16, number: I64, listed: F32) -> None:
    """Points of a quad in rows (`number_in_rows`); the triangles and their corners keep their order."""
    count = number_in_rows(n, number)
    for c in range(2):
        for k in range(count):
            listed[k] = uv[c, k]
        for k in range(count):
            uv[c, number[k]] = listed[k]
    for i in range(len(indices)):
        indices[i] = number[indices[i]]


@kernel
def _fill(
    domain: int,
    output: int,
    keys: I32,
    n: I64,
    first_point: I64,
    first_index: I64,
    locations: I64,
    rows: I64,
    uv: F32,
    indices: U16,
    number: I64,
    listed: F32,
) -> None:
    for k in range(keys.shape[0]):
        a, b = first_point[k], first_point[k + 1]
        fill_points(domain, keys[k], n[k], locations, uv[0, a:b], uv[1, a:b])
        fill_indices(domain, output, n[k], rows, indices[first_index[k] : first_index[k + 1]])
        if len(number) > 0:
            _put_in_rows(n[k], uv[:, a:b], indices[first_index[k] : first_index[k + 1]], number, listed)


def _generate(domain: int, partitioning: int, output: int, keys: I32, in_rows: bool = False) -> PackedPatterns:
    """Patterns of the keys (K, 6): count, allocate, fill. in_rows : of quads, the points inside the border come in rows."""
    n = np.empty(keys.shape, np.int64)
    first_point, first_index = np.zeros((2, len(keys) + 1), np.int64)
    _count(domain, partitioning, output, keys, n, first_point, first_index)
    uv = np.empty((2, first_point[-1]), np.float32)
    indices = np.empty(first_index[-1], np.uint16)
    locations = np.empty((NUM_SLOTS, MAX_SIDE_POINTS), np.int64)
    rows = np.empty((2, MAX_SIDE_POINTS), np.int64)
    most = int(np.diff(first_point).max(initial=0)) if in_rows else 0
    number, listed = np.empty(most, np.int64), np.empty(most, np.float32)
    _fill(domain, output, keys, n, first_point, first_index, locations, rows, uv, indices, number, listed)
    return PackedPatterns(uv, first_point, indices, first_index)


def _check_name(field: str, value: object, allowed: Iterable[str]) -> None:
    if value not in tuple(allowed):
        raise ValueError(f"{field} = {value!r}: allowed are {', '.join(allowed)}")


def _factor_row(field: str, values: Sequence[float], length: int, domain: str) -> F32:
    try:
        with np.errstate(over="ignore", under="ignore"):  # beyond float32 is infinity, below it zero
            row = np.asarray(values, np.float64).astype(np.float32)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{field} = {values!r}: allowed are {length} numbers ({error})") from error
    if row.shape != (length,):
        raise ValueError(
            f"{field} = {values!r}: domain {domain!r} takes {length} factors, allowed is shape ({length},)"
        )
    return row[None]


def _tessellate(
    domain: str, partitioning: str, edge: Sequence[float], inside: Sequence[float], output: str
) -> tuple[F32, U32]:
    """Like `tessellate`, but it also answers, as the reference does, for outputs that D3D11 forbids."""
    code = DOMAINS.index(domain)
    edge_row = _factor_row("edge", edge, NUM_EDGES[code], domain)
    inside_row = _factor_row("inside", inside, NUM_INSIDES[code], domain)
    keys, _ = fix_factors(code, PARTITIONINGS[partitioning], edge_row, inside_row)  # no key if the patch is culled
    packed = _generate(code, PARTITIONINGS[partitioning], OUTPUTS.index(output), keys)
    return np.ascontiguousarray(packed.uv.T), packed.indices.astype(np.uint32)


def tessellate(
    domain: str, partitioning: str, edge: Sequence[float], inside: Sequence[float], output: str
) -> tuple[F32, U32]:
    """Domain points and index list of one patch, in the reference tessellator's order.

    domain : quad, tri or isoline. partitioning : integer, pow2, fractional_odd or fractional_even; pow2 does not round
    to powers of two here, that is the hull shader's part (D3D11.3 functional specification 11.7.7.1).
    edge, inside : factors in the order of SV_TessFactor and SV_InsideTessFactor, taken as float32: 4 and 2 for quad
    (edges u=0, v=0, u=1, v=1; along u, along v), 3 and 1 for tri (u=0, v=0, w=0), 2 and 0 for isoline (density,
    detail). Any value will do: an edge factor that is not above zero culls the patch, the rest is clamped.
    output : point with every domain, line with isoline only, triangle_cw and triangle_ccw with quad and tri only
    (clockwise as seen with u to the right and v down).

    Returns points, float32 (N, 2): u, v in [0, 1] (on a tri, w = 1 - u - v); indices, uint32 (M,): 1, 2 or 3 a
    primitive. Both are empty for a culled patch. Two points may coincide: triangles without area are emitted too.

    Raises ValueError for an unknown name, a wrong number of factors, or an output that the domain does not have.
    """
    _check_name("domain", domain, DOMAINS)
    _check_name("partitioning", partitioning, PARTITIONINGS)
    _check_name("output", output, OUTPUTS)
    _check_name(f"output of domain {domain!r}", output, LEGAL_OUTPUTS[domain])
    return _tessellate(domain, partitioning, edge, inside, output)


class PatternCache:
    """Patterns that were generated before. Safe to share between threads.

    The points inside a quad's border come in rows of constant v, where `tessellate` lists them ring by ring as the reference
    tessellator does: the domain shader shares a row's sums over u.

    max_points : how many domain points are kept, at about 20 bytes each with their triangles. Beyond it the patterns
    that were generated first go. The last table is kept besides, if it is not larger than that itself.
    `hits` and `misses` count distinct patterns asked for, over all calls.
    """

    def __init__(self, max_points: int = 1 << 22) -> None:
        self.max_points = max_points
        self.hits = 0
        self.misses = 0
        self._lock = threading.Lock()
        # What one call generated is one block, dropped as one; an entry is a block and its pattern number there.
        self._blocks: list[tuple[PackedPatterns, list[bytes]]] = []
        self._entries: dict[bytes, tuple[PackedPatterns, int]] = {}
        self._last: tuple[bytes, PackedPatterns] | None = None

    @property
    def num_points(self) -> int:
        """Domain points kept at present, the last table not counted."""
        return sum(int(block.first_point[-1]) for block, _ in self._blocks)

    def table(self, domain: int, partitioning: int, output: int, keys: I32) -> PackedPatterns:
        """Patterns of `keys` (K, 6), in that order. The arrays are shared with later calls: read only."""
        mode = bytes((domain, partitioning, output))
        packed_keys = keys.tobytes()
        with self._lock:
            if self._last is not None and self._last[0] == mode + packed_keys:
                self.hits += len(keys)
                return self._last[1]
            size = keys.itemsize * NUM_SLOTS
            names = [mode + packed_keys[i : i + size] for i in range(0, len(packed_keys), size)]
            missing = [k for k, name in enumerate(names) if name not in self._entries]
            self.hits += len(names) - len(missing)
            self.misses += len(missing)
            block = _generate(domain, partitioning, output, keys[missing], domain == QUAD)
            new = {names[k]: (block, j) for j, k in enumerate(missing)}
            if len(missing) == len(names):
                table = block
            else:
                table = _gather([new.get(name) or self._entries[name] for name in names])
            self._keep(block, new)
            small = table.first_point[-1] <= self.max_points
            self._last = (mode + packed_keys, table) if small else None
            return table

    def _keep(self, block: PackedPatterns, new: dict[bytes, tuple[PackedPatterns, int]]) -> None:
        if new:
            self._blocks.append((block, list(new)))
            self._entries |= new
        while self.num_points > self.max_points:
            for name in self._blocks.pop(0)[1]:
                del self._entries[name]


def _gather(parts: list[tuple[PackedPatterns, int]]) -> PackedPatterns:
    """One table of patterns that lie in several blocks."""
    points = [slice(block.first_point[j], block.first_point[j + 1]) for block, j in parts]
    indices = [slice(block.first_index[j], block.first_index[j + 1]) for block, j in parts]
    return PackedPatterns(
        np.concatenate([block.uv[:, s] for (block, _), s in zip(parts, points, strict=True)], axis=1),
        np.cumsum([0] + [s.stop - s.start for s in points], dtype=np.int64),
        np.concatenate([block.indices[s] for (block, _), s in zip(parts, indices, strict=True)]),
        np.cumsum([0] + [s.stop - s.start for s in indices], dtype=np.int64),
    )


PATTERNS = PatternCache()  # of this process


def make_patterns(
    factors: TessFactors, partitioning: str, output: str = "triangle_cw", cache: PatternCache = PATTERNS
) -> Patterns:
    """The distinct tessellation patterns of a frame's quad patches, and which of them each patch has.

    factors : edge float32 (P, 4), inside float32 (P, 2), any values. output : triangle_cw or triangle_ccw.
    Returns `Patterns`: of_patch is -1 for culled patches; patterns stand in the order of their first patch. Patches
    share a pattern if their factors are equal after clamping and conversion to 16.16. All arrays but of_patch may be
    those of an earlier call: read only. (They are not flagged so, as Numba would then compile their readers twice.)

    Raises ValueError for an unknown partitioning or output and for factors of another shape.
    Source: D3D11.3 functional specification 11.5 to 11.7, and 10.10 for the order of the factors.
    """
    _check_name("partitioning", partitioning, PARTITIONINGS)
    _check_name("output of make_patterns", output, ("triangle_cw", "triangle_ccw"))
    edge, inside = np.asarray(factors.edge), np.asarray(factors.inside)
    if edge.ndim != 2 or edge.shape[1] != NUM_EDGES[QUAD]:
        raise ValueError(f"factors.edge has shape {edge.shape}: allowed is (P, {NUM_EDGES[QUAD]})")
    if inside.shape != (len(edge), NUM_INSIDES[QUAD]):
        raise ValueError(f"factors.inside has shape {inside.shape}: allowed is ({len(edge)}, {NUM_INSIDES[QUAD]})")
    keys, of_patch = fix_factors(QUAD, PARTITIONINGS[partitioning], edge, inside)
    table = cache.table(QUAD, PARTITIONINGS[partitioning], OUTPUTS.index(output), keys)
    return Patterns(of_patch, table.uv, table.first_point, table.indices, table.first_index // 3)
