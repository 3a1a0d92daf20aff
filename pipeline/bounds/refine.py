"""Hierarchical refinement: patches are split where a criterion says so, and each part is bounded anew.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, section 3.5. A box of a patch is replaced by the boxes of the two halves of
its parametric domain, which the bound computes from the restricted control points: control vectors, frame and normal
bounds are those of the part. What holds between levels, and what does not:

- the parts' domains tile the patch's exactly (both share the middle, (a + b) / 2), so every point of the surface lies in
  the box of a part that owns it;
- a part's oriented box may leave that of its parent, and with a constant displacement summed volumes may grow. So boxes of
  different levels are never intersected; only the criterion's *cost* is compared, to judge whether a split was worth it;
- a part outside the frustum is culled, stays, is never split again, and costs nothing. Parts of a culled part would be
  outside too; nobody looks;
- where a part's region of the map is zero throughout, filter footprint included, with no bias, the shader adds 0 n: the
  part is bounded as if it had no map, and normals need not be bounded.

A priority queue holds the boxes that may still be split, the most expensive first. Rounds split several at once, so that
the bound sees arrays; with `per_round=1` it is strictly best first. Equal costs go by patch number, then by domain.
"""

import heapq
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from pipeline.bounds import Bound
from pipeline.bounds.restrict import FAR, texcoord_rect
from pipeline.bounds.vector import is_special
from pipeline.culling import CULL_TESTS
from pipeline.jit import helper, kernel
from pipeline.minmax import texel_range
from pipeline.types import F64, I32, U8, CullFlag, HullInput, PatchBounds, Patches, TessFactors


class Refined(NamedTuple):
    """Boxes that together cover every patch, ordered by patch, then by u0, then by v0."""

    patch: I32  # (n,) patch number
    domain: F64  # (n, 4) u0, u1, v0, v1
    bounds: PatchBounds  # n rows
    culled: U8  # (n,) 1: outside the frustum
    cost: F64  # (n,) the criterion's cost; 0 where culled
    rounds: int  # calls of the bound


# Criteria: what a box costs, float64[n]. A cost of zero or NaN is never worth a split.


def screen_extent(bounds: PatchBounds) -> F64:
    """Pixels of the screen rectangle."""
    size = (bounds.rect[:, 2:] - bounds.rect[:, :2]).astype(np.float64)
    return size[:, 0] * size[:, 1]


def nearness(bounds: PatchBounds) -> F64:
    """How near the box may be: 1 - z_min, for boxes that touch the screen."""
    return np.where(bounds.rect[:, 0] < bounds.rect[:, 2], 1.0 - bounds.z_min.astype(np.float64), 0.0)


def straddled_planes(bounds: PatchBounds) -> F64:
    """Planes of the frustum that the box crosses, 0 to 6: some corners are inside, some outside."""
    x, y, z, w = np.moveaxis(bounds.corners, -1, 0)
    inside = np.stack([w + x, w - x, w + y, w - y, z, w - z]) >= 0.0
    return (inside.any(axis=2) & ~inside.all(axis=2)).sum(axis=0).astype(np.float64)


def _half_extents(bounds: PatchBounds) -> F64:
    return np.sqrt((bounds.axes**2).sum(axis=2))


def surface_area(bounds: PatchBounds) -> F64:
    """Surface of the box, square world units."""
    a, b, c = _half_extents(bounds).T
    return 8.0 * (a * b + b * c + c * a)


def volume(bounds: PatchBounds) -> F64:
    """Volume of the box, cubic world units."""
    return 8.0 * _half_extents(bounds).prod(axis=1)


Criterion = Callable[[PatchBounds], F64]

CRITERIA: dict[str, Criterion] = {
    "screen": screen_extent,
    "depth": nearness,
    "straddle": straddled_planes,
    "area": surface_area,
    "volume": volume,
}
WORST_PART = frozenset({"depth", "straddle"})  # a pair of parts costs what its worse one does; otherwise the sum


# Parts of patches

EXACT_TEXELS = 4096.0  # regions of the map up to this size are looked at texel by texel, larger ones in the pyramid


@helper
def _adds_nothing(maps, pyramids, m, texcoords, domain):
    """Whether lookups of map m within the domain give exactly zero: no bias, and zero in every texel that they may blend."""
    if not (maps.bias[m] == 0.0 and abs(maps.scale[m]) < np.inf):
        return False
    s0, s1, t0, t1 = texcoord_rect(texcoords, domain[0], domain[1], domain[2], domain[3])
    width, height = np.float64(pyramids.size[m, 0, 0]), np.float64(pyramids.size[m, 0, 1])
    if not (max(abs(s0), abs(s1)) * width < FAR and max(abs(t0), abs(t1)) * height < FAR):
        return False
    exact = (s1 - s0) * width * (t1 - t0) * height <= EXACT_TEXELS
    lo, hi = texel_range(maps, pyramids, m, s0, s1, t0, t1, exact)
    return lo == 0.0 and hi == 0.0


@kernel
def _find_flat(maps, pyramids, map_id, texcoords, domain, flat):
    for k in range(len(map_id)):
        m = map_id[k]
        flat[k] = m < 0 or _adds_nothing(maps, pyramids, m, texcoords[k], domain[k])


def gather_parts(stage: HullInput, patch: I32, domain: F64) -> HullInput:
    """The input for bounding parts of patches: row k is domain[k] of patch[k]; parts without displacement have no map.

    patch : int32[n]. domain : float64[n, 4]. Everything else is the stage's.
    """
    patches = stage.patches.take(patch)
    flat = np.zeros(len(patch), np.uint8)
    _find_flat(stage.maps, stage.pyramids, patches.map_id, patches.texcoords, domain, flat)
    flat[is_special(patches, stage.maps)] = 0
    patches = patches._replace(map_id=np.where(flat, -1, patches.map_id).astype(np.int32))
    factors = TessFactors(*(a[patch] for a in stage.factors))
    return stage._replace(patches=patches, domain=domain, factors=factors)


def side_lengths(patches: Patches) -> F64:
    """Longest row of the control polygon along u and along v, world units, float64[P, 2]; 1 where that is not finite."""
    with np.errstate(all="ignore"):
        points = patches.control_points[..., :3].astype(np.float64) / patches.control_points[..., 3:]
        along_u = np.sqrt((np.diff(points, axis=1) ** 2).sum(axis=-1)).sum(axis=1).max(axis=1)
        along_v = np.sqrt((np.diff(points, axis=2) ** 2).sum(axis=-1)).sum(axis=2).max(axis=1)
    lengths = np.stack([along_u, along_v], axis=1)
    return np.where(np.isfinite(lengths), lengths, 1.0)


def split_domains(domain: F64, lengths: F64, min_size: float) -> F64:
    """Both halves of each domain, float64[n, 2, 4], cut across the side that is longer in world units.

    lengths : float64[n, 2], of the whole patch along u and v. A side that is not longer than `min_size` is not cut (one of
    the two must be).
    """
    size = np.stack([domain[:, 1] - domain[:, 0], domain[:, 3] - domain[:, 2]], axis=1)
    may = size > min_size
    world = size * lengths
    longer = (world[:, 1] > world[:, 0]) | ((world[:, 1] == world[:, 0]) & (size[:, 1] > size[:, 0]))
    along_v = may[:, 1] & (~may[:, 0] | longer)
    column = np.where(along_v, 2, 0)
    rows = np.arange(len(domain))
    middle = 0.5 * (domain[rows, column] + domain[rows, column + 1])
    halves = np.repeat(domain[:, None], 2, axis=1)
    halves[rows, 0, column + 1] = middle
    halves[rows, 1, column] = middle
    return halves


# The loop


class _Boxes:
    """All boxes made so far, in the order of making; those that were split are no longer leaves."""

    def __init__(self, stage: HullInput, bound: Bound, criterion: Criterion) -> None:
        self.stage, self.bound, self.criterion = stage, bound, criterion
        self.sound: Any = np.isfinite(stage.patches.control_points).all(axis=(1, 2, 3))
        self.patch: list[int] = []
        self.domain: list[tuple[float, ...]] = []
        self.cost: list[float] = []
        self.culled: list[int] = []
        self.leaf: list[bool] = []
        self.parts: list[PatchBounds] = []
        self.rounds = 0

    def add(self, patch: I32, domain: F64) -> range:
        """Bound and test the parts; their numbers."""
        stage = gather_parts(self.stage, patch, domain)
        bounds = self.bound(stage)
        flags = np.where(self.sound[patch], np.uint8(CullFlag.ALIVE), np.uint8(CullFlag.NONFINITE))
        CULL_TESTS["frustum"](stage, bounds, flags)
        culled = flags == CullFlag.FRUSTUM
        with np.errstate(all="ignore"):
            cost = np.where(flags == CullFlag.ALIVE, self.criterion(bounds), 0.0)
        first = len(self.patch)
        self.patch += patch.tolist()
        self.domain += [tuple(row) for row in domain.tolist()]
        self.cost += np.where(np.isfinite(cost) & (cost > 0.0), cost, 0.0).tolist()  # what is unknown is not split
        self.culled += culled.tolist()
        self.leaf += [True] * len(patch)
        self.parts.append(bounds)
        self.rounds += 1
        return range(first, len(self.patch))

    def leaves(self) -> Refined:
        """The leaves, ordered."""
        leaf = np.flatnonzero(self.leaf)
        patch, domain = np.array(self.patch, np.int32)[leaf], np.array(self.domain, np.float64).reshape(-1, 4)[leaf]
        order = np.lexsort((domain[:, 2], domain[:, 0], patch))
        chosen = leaf[order]
        bounds = PatchBounds(*(np.concatenate(parts)[chosen] for parts in zip(*self.parts, strict=True)))
        culled, cost = np.array(self.culled, np.uint8)[chosen], np.array(self.cost, np.float64)[chosen]
        return Refined(patch[order], domain[order], bounds, culled, cost, self.rounds)


def refine(
    stage: HullInput,
    bound: Bound,
    criterion: str,
    *,
    max_boxes: int,
    min_size: float = 1.0 / 64.0,
    min_gain: float = 0.0,
    min_cost: float = 0.0,
    per_round: int | None = None,
) -> Refined:
    """Split the patches of a stage, each first bounded over its domain, until a rule says stop.

    bound : one of `BOUNDS`. criterion : a name of CRITERIA; the box of greatest cost is split first.
    max_boxes : at most this many boxes, culled ones included (but always one a patch). min_size : a side of a domain that
    is not longer is not cut. min_gain : a split whose parts together cost more than (1 - min_gain) times what the box did is
    undone, and the box stays; -inf keeps every split. min_cost : cheaper boxes are not split. per_round : at most so many
    splits before boxes are compared anew; by default a quarter of those that wait.

    Raises ValueError for an unknown criterion or a number that is not allowed.
    """
    if criterion not in CRITERIA:
        raise ValueError(f"criterion: {criterion!r} is not allowed; allowed: {', '.join(CRITERIA)}")
    if max_boxes < 1:
        raise ValueError(f"max_boxes: {max_boxes!r} is not allowed; allowed: 1 or more")
    if not 0.0 < min_size <= 1.0:
        raise ValueError(f"min_size: {min_size!r} is not allowed; allowed: above 0, at most 1")
    if not min_gain < 1.0:
        raise ValueError(f"min_gain: {min_gain!r} is not allowed; allowed: below 1")
    if per_round is not None and per_round < 1:
        raise ValueError(f"per_round: {per_round!r} is not allowed; allowed: 1 or more")
    boxes = _Boxes(stage, bound, CRITERIA[criterion])
    lengths = side_lengths(stage.patches)
    waiting: list[tuple[float, int, tuple[float, ...], int]] = []

    def push(numbers: range) -> None:
        for k in numbers:
            u0, u1, v0, v1 = boxes.domain[k]
            if boxes.cost[k] > min_cost and max(u1 - u0, v1 - v0) > min_size:
                heapq.heappush(waiting, (-boxes.cost[k], boxes.patch[k], boxes.domain[k], k))

    push(boxes.add(np.arange(len(stage.patches.control_points), dtype=np.int32), stage.domain))
    count = len(boxes.patch)
    while waiting and count < max_boxes:
        wish = -(-len(waiting) // 4) if per_round is None else per_round
        parents = [heapq.heappop(waiting)[3] for _ in range(min(wish, len(waiting), max_boxes - count))]
        patch = np.array([boxes.patch[k] for k in parents], np.int32)
        halves = split_domains(np.array([boxes.domain[k] for k in parents]), lengths[patch], min_size)
        parts = boxes.add(np.repeat(patch, 2), halves.reshape(-1, 4))
        for parent, first in zip(parents, parts[::2], strict=True):
            pair = boxes.cost[first : first + 2]
            after = max(pair) if criterion in WORST_PART else sum(pair)
            if after > (1.0 - min_gain) * boxes.cost[parent]:
                boxes.leaf[first] = boxes.leaf[first + 1] = False  # not worth it: the box stays whole
                continue
            boxes.leaf[parent] = False
            count += 1
            push(range(first, first + 2))
    return boxes.leaves()
