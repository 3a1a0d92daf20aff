"""From the hull shader's tess factors to 16.16 fixed point: cull, clamp, round up, lift the inside, convert.

D3D11.3 functional specification 3.2.4.1 (float to fixed), 11.7.7 (partitioning), 11.7.11 (clamping), 11.7.12 (culling).

A patch's *key* is its factors after all of that, edges first: two patches with equal keys have the same points and
the same connectivity. Nothing after this module looks at a float again.
"""

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F32, I32

DOMAINS = ("quad", "tri", "isoline")
OUTPUTS = ("point", "line", "triangle_cw", "triangle_ccw")
QUAD, TRI, ISOLINE = range(3)
POINT, LINE, TRIANGLE_CW, TRIANGLE_CCW = range(4)

# pow2 is integer to this stage (11.7.7.1): the rounding to a power of two is shader code.
PARTITIONINGS = {"integer": 0, "pow2": 0, "fractional_odd": 1, "fractional_even": 2}
INTEGER, FRACTIONAL_ODD, FRACTIONAL_EVEN = range(3)

NUM_EDGES = (4, 3, 2)  # by domain
NUM_INSIDES = (2, 1, 0)
NUM_SLOTS = 6  # length of a key; a tri patch leaves the last two 0, an isoline the last four

ONE = 65536
MAX_FACTOR = 64.0

# In fractional_odd a factor rounds to something above one exactly if it is above LIFT_ABOVE (the tie goes to one). The
# border then has more than its corners, so the inside is lifted to LIFTED: a ring of triangles has to lie between.
LIFT_ABOVE = 1.0 + 2.0**-17
LIFTED = 1.0 + 2.0**-16


@helper
def clamp(x: float, lo: float, hi: float) -> float:
    """Clamp `x` into [lo, hi]; a NaN becomes `lo`."""
    return min(hi, x) if x > lo else lo


@helper
def to_fixed(x: float) -> np.int64:
    """16.16 fixed point of `x`, ties to even. The product is exact: a float32 in [1, 64] has few bits to lose."""
    return np.int64(np.rint(x * ONE))


@helper
def fix_patch(domain: int, partitioning: int, edge: F32, inside: F32, key: I32) -> bool:
    """Write the fixed-point factors of one patch to `key`; False, and no key, if the patch is culled."""
    for e in range(edge.size):
        if not edge[e] > 0.0:  # a NaN culls too
            return False
    lo = 2.0 if partitioning == FRACTIONAL_EVEN else 1.0
    hi = MAX_FACTOR - 1.0 if partitioning == FRACTIONAL_ODD else MAX_FACTOR
    lo_inside = lo
    for e in range(edge.size):
        if domain == ISOLINE and e == 0:  # line density: whole lines in every partitioning
            x = np.ceil(clamp(np.float64(edge[e]), 1.0, MAX_FACTOR))
        else:
            x = clamp(np.float64(edge[e]), lo, hi)
            if partitioning == INTEGER:
                x = np.ceil(x)
        if partitioning == FRACTIONAL_ODD and x > LIFT_ABOVE:
            lo_inside = LIFTED
        key[e] = to_fixed(x)
    if partitioning == FRACTIONAL_ODD and domain == QUAD:
        for i in range(inside.size):  # one axis lifts the other
            if inside[i] > LIFT_ABOVE:
                lo_inside = LIFTED
    for i in range(inside.size):
        x = clamp(np.float64(inside[i]), lo_inside, hi)
        if partitioning == INTEGER:
            x = np.ceil(x)
        key[edge.size + i] = to_fixed(x)
    for s in range(edge.size + inside.size, NUM_SLOTS):
        key[s] = 0
    return True


@helper
def is_odd(domain: int, partitioning: int, slot: int, factor: int) -> int:
    """1 if the side of this slot gets an odd number of segments at whole levels (16.16 `factor`), else 0."""
    if partitioning != INTEGER and not (domain == ISOLINE and slot == 0):
        return 1 if partitioning == FRACTIONAL_ODD else 0
    whole = factor >> 16
    num_edges = 4 - domain  # NUM_EDGES in closed form
    if whole == 1 and slot >= num_edges:
        return 0  # an inside factor of one acts as two: the ring around it needs a centre to close on
    return whole & 1


@helper
def _rows_equal(a: F32 | I32, p: int, q: int) -> bool:
    for i in range(a.shape[1]):  # noqa: SIM110 - Numba has no all() over a generator
        if a[p, i] != a[q, i]:
            return False
    return True


@helper
def _hash(key: I32) -> np.int64:
    h = np.int64(0)
    for s in range(NUM_SLOTS):
        h = ((h ^ np.int64(key[s])) * 0x9E3779B1) & 0x7FFFFFFF  # 31 bits: the product never overflows
        h ^= h >> 15  # whole factors have sixteen low zero bits: bring the high ones down
    return h


@kernel
def _fix_all(domain: int, partitioning: int, edge: F32, inside: F32, slots: I32, of_patch: I32, keys: I32) -> int:
    """Number of distinct keys. `slots` is a hash table, all -1 and at least twice as long as there are patches."""
    mask = slots.size - 1
    count = 0
    for p in range(edge.shape[0]):
        # Neighbours mostly have equal factors; a NaN equals nothing and takes the long way.
        if p > 0 and _rows_equal(edge, p, p - 1) and _rows_equal(inside, p, p - 1):
            of_patch[p] = of_patch[p - 1]
            continue
        candidate = keys[count]  # kept if it turns out to be new
        if not fix_patch(domain, partitioning, edge[p], inside[p], candidate):
            of_patch[p] = -1
            continue
        at = _hash(candidate) & mask
        while slots[at] >= 0 and not _rows_equal(keys, np.int64(slots[at]), count):
            at = (at + 1) & mask
        if slots[at] < 0:
            slots[at] = count
            count += 1
        of_patch[p] = slots[at]
    return count


def fix_factors(domain: int, partitioning: int, edge: F32, inside: F32) -> tuple[I32, I32]:
    """Fixed-point factors of all patches, each distinct set once.

    edge, inside : float32 (P, NUM_EDGES[domain]) and (P, NUM_INSIDES[domain]), any values.
    Returns keys : int32 (K, 6), 16.16, in the order of their first patch; of_patch : int32 (P,), the row of `keys`
    that patch p has, -1 where it is culled.
    """
    num_patches = edge.shape[0]
    slots = np.full(1 << (2 * num_patches).bit_length(), -1, np.int32)
    of_patch = np.empty(num_patches, np.int32)
    keys = np.empty((num_patches, NUM_SLOTS), np.int32)
    # One array type for every caller: a read-only or strided one would compile the kernel again.
    edge, inside = (np.require(a, np.float32, ["C", "W"]) for a in (edge, inside))
    count = _fix_all(domain, partitioning, edge, inside, slots, of_patch, keys)
    return keys[:count].copy(), of_patch
