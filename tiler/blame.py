"""Ideal and blame: what perfect knowledge would have needed, and why each other domain-shader invocation was not avoided.

The machine shades a unit (patch or sub-domain) as a whole, in a tile, or in `triangle` binning in the front end. Each such
event costs the unit's domain points; `BLAME` says what they were for. Every point is charged to one line, so the lines add
up to `ds_invocations`.

Events are those of the machine, with its domain cache replayed; what the entry covered, and what hid it, comes from a second
drawing of the frame (`tiler/blame_watch.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.primitives import NUM_OUTCOMES, Outcome
from pipeline.types import B1, I32, I64, U8, Patterns
from tiler.blame_watch import COVERED, FRESH, PASSED, TESTED, TRUE, Watch, Watched
from tiler.counters import Counters
from tiler.front_end import Geometry
from tiler.order import PATCH_SHIFT
from tiler.units import Units, num_domain_points


class Reason(NamedTuple):
    """A line of blame. `text`: which points are charged to it."""

    title: str
    text: str


BLAME: dict[str, Reason] = {
    "useful": Reason(
        "useful", "Points of triangles with a visible sample, each point of a patch once in the frame. They are charged to "
        "one event of the unit: the first in a tile where a sample of it is visible, or the first where it is shaded in none "
        "of these (a domain cache hands its points on).",
    ),
    "shared_border": Reason(
        "shared by sub-domains", "Points of triangles with a visible sample, in the same event, that an earlier sub-domain of "
        "the patch has too, and is charged for.",
    ),
    "granularity": Reason(
        "finer cull", "The other points of that event: only triangles without a visible sample have them.",
    ),
    "redundant": Reason(
        "redundant per tile", "A unit shaded in a tile where a sample of it is visible, but also in the tile that is charged "
        "for it: there was no domain cache, or the cache had lost it.",
    ),
    "vertex_cache": Reason(
        "lost by the vertex cache", "`triangle` binning: points of a patch, visible or not, shaded once more because the "
        "vertex cache had lost them.",
    ),
    "no_triangle_in_tile": Reason(
        "no triangle in the tile", "A unit shaded in a tile in which no triangle of it covers a sample, though one does "
        "elsewhere: the outline of its bound is loose.",
    ),
    "outside": Reason(
        "outside, bound loose", "A unit of which no triangle is inside the frustum with a sample in the picture, none culled "
        "for its face or its size: it is outside, and its bound did not show it.",
    ),
    "backface": Reason(
        "back-facing, undecided", "A unit of which nothing passes set-up, and some triangle is culled for its face; others of "
        "it may be outside, or too small.",
    ),
    "no_sample": Reason(
        "between samples", "Any other unit of which no triangle covers a sample in the picture: without area, or between the "
        "samples. No test of the machine asks for it.",
    ),
    "occluded_order": Reason(
        "occluded, drawn too early", "A unit that passed samples in the tile, none of them seen at the end: what hides it came "
        "later, so no test at that moment could know.",
    ),
    "occluded_untested": Reason(
        "occluded, not tested", "A unit that covers samples in the tile and passed none; no test against coarse Z was made "
        "before it was shaded.",
    ),
    "occluded_stale": Reason(
        "occluded, pyramid stale", "The same where a test was made, and the same bound is hidden by the same blocks by the "
        "depths of that moment: the pyramid was older than these.",
    ),
    "occluded_bound": Reason(
        "occluded, bound loose", "The same where not the unit's bound, but the box and nearest vertex of its triangles in the "
        "tile would be hidden by the blocks' depths of that moment. Whether the pyramid was older as well is not told apart.",
    ),
    "occluded_coarse": Reason(
        "occluded, pyramid coarse", "The same where these would not be hidden either: blocks, or one depth for all triangles, "
        "are too coarse, only a test of each sample would do.",
    ),
}  # fmt: skip

IDEAL: dict[str, str] = {
    "ideal_patches": "Patches with a visible sample.",
    "ideal_units": "Units with a visible sample: sub-domains in `subpatch` binning, else patches.",
    "ideal_domain_points": "Points of triangles with a visible sample, those of a patch once.",
    "ideal_unit_points": "All points of units with a visible sample.",
    "ideal_entries": "Pairs of a unit and a tile in which a sample of it is visible; in `triangle` binning pairs of a "
    "tessellated triangle and a tile.",
}

_CODES = {name: code for code, name in enumerate(BLAME)}


@dataclass(frozen=True)
class Blame:
    """invocations : domain-shader invocations by line of `BLAME`; their sum is `ds_invocations`. tiles : the same by tile,
    int64[tiles_y, tiles_x]; 0 in `triangle` binning, which shades in no tile. ideal : by name of `IDEAL`.
    """

    invocations: dict[str, int]
    tiles: dict[str, I64]
    ideal: dict[str, int]

    @property
    def wasted_domain_points(self) -> I64:
        """Invocations that were not useful, by tile: int64[tiles_y, tiles_x]."""
        return np.sum([values for name, values in self.tiles.items() if name != "useful"], axis=0)

    def record(self) -> dict[str, dict[str, int]]:
        """What `--json` says."""
        return {"ideal": dict(self.ideal), "invocations": dict(self.invocations)}


def waterfall(counters: Counters, blame: Blame) -> list[tuple[str, int]]:
    """From all patches to those visible, and from all invocations to the useful ones: lines of a title and a number.

    Lines that begin with a minus are taken away, lines that begin with an equals sign are what is left.
    """
    lines = [("patches", counters["ia_primitives"])]
    for title, name in (
        ("- not finite", "hs_culled_nonfinite"), ("- culled by the frustum", "hs_culled_frustum"),
        ("- culled as back faces", "hs_culled_backface"), ("- culled by a factor", "ts_culled_factor"),
    ):  # fmt: skip
        lines.append((title, counters[name]))
    lines.append(("- not visible", counters["ts_patches"] - blame.ideal["ideal_patches"]))
    lines.append(("= visible patches", blame.ideal["ideal_patches"]))
    lines.append(("domain-shader invocations", counters["ds_invocations"]))
    lines += [(f"- {BLAME[name].title}", value) for name, value in blame.invocations.items() if name != "useful"]
    lines.append(("= useful invocations", blame.invocations["useful"]))
    return lines


def waterfall_table(frames: Mapping[str, tuple[Counters, Blame]]) -> str:
    """Waterfalls as aligned text, a column a machine by its name; lines that are 0 everywhere are left out."""
    falls = [waterfall(*made) for made in frames.values()]
    rows = [["", *frames]] if len(frames) > 1 else []
    for lines in zip(*falls, strict=True):
        if any(value for _, value in lines):
            rows.append([lines[0][0], *(f"{value:,}" for _, value in lines)])
    rows.append(["", *[""] * len(frames)])
    blames = [blame for _, blame in frames.values()]
    rows += [[name, *(f"{blame.ideal[name]:,}" for blame in blames)] for name in IDEAL]
    widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
    return "\n".join("  ".join([r[0].ljust(widths[0]), *map(str.rjust, r[1:], widths[1:])]).rstrip() for r in rows)


@helper
def _find(keys, key):
    """Place of a key in sorted keys, -1 if it is not there."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == key else -1


@kernel
def _share_out(
    owner, of_part, part_first, original, of_whole, whole_first, indices, keys, unit_of, useful, shared, marks
):
    """Points of visible triangles of each unit: those that no earlier unit of its patch has, and the others.

    keys : sorted submit numbers of the visible triangles; unit_of[i] becomes the unit of keys[i]. marks : int64[2, points of
    a pattern], -1.
    """
    for u in range(len(owner)):
        if of_part[u] < 0:
            continue
        patch = np.int64(owner[u])
        base = whole_first[of_whole[patch]]
        for t in range(part_first[of_part[u]], part_first[of_part[u] + 1]):
            place = _find(keys, (patch << PATCH_SHIFT) + original[t])
            if place < 0:
                continue
            unit_of[place] = u
            for c in range(3):
                point = indices[3 * (base + original[t]) + c]
                if marks[0, point] != u:
                    marks[0, point] = u
                    if marks[1, point] != patch:
                        marks[1, point] = patch
                        useful[u] += 1
                    else:
                        shared[u] += 1


class _Seen(NamedTuple):
    """What is visible at the end of the frame."""

    keys: I64  # (n,) submit numbers of visible triangles, sorted
    unit_of: I64  # (n,)
    pairs: I64  # sorted codes unit * tiles + tile of units visible in tiles
    triangle_pairs: int  # pairs of a visible triangle and a tile that it is visible in
    useful: I64  # (units,) points of visible triangles
    shared: I64  # (units,) of these, points that an earlier unit of the patch has


class Witness:
    """Collects what blame needs while a frame is drawn."""

    def __init__(self, watch: Watch, binning: str, walk: I64) -> None:
        """walk : the tiles in the order in which they are worked off."""
        self.watch, self.binning, self.walk = watch, binning, walk
        self.fates: list[tuple[I32, I64]] = []
        self.blame: Blame | None = None

    def note_front_end(self, batch: I32, geometry: Geometry) -> None:
        """What became of the triangles of a batch of units."""
        self.fates.append((batch, geometry.outcomes))

    def _look(self, units: Units, patterns: Patterns) -> _Seen:
        grid, order = self.watch.grid, self.watch.film.order
        y, x, _ = np.nonzero(order >= 0)
        tile = (y >> grid.tile_log2) * grid.tiles_x + (x >> grid.tile_log2)
        keys, place = np.unique(order[order >= 0], return_inverse=True)
        unit_of = np.full(len(keys), -1, np.int64)
        useful, shared = np.zeros(len(units.owner), np.int64), np.zeros(len(units.owner), np.int64)
        marks = np.full((2, int(np.diff(patterns.first_point).max(initial=0))), -1, np.int64)
        _share_out(
            units.owner, units.patterns.of_patch, units.patterns.first_triangle, units.original, patterns.of_patch,
            patterns.first_triangle, patterns.indices, keys, unit_of, useful, shared, marks,
        )  # fmt: skip
        pairs = np.unique(unit_of[place] * grid.num_tiles + tile)
        triangle_pairs = len(np.unique(place * grid.num_tiles + tile))
        return _Seen(keys, unit_of, pairs, triangle_pairs, useful, shared)

    def testify(self, units: Units, patterns: Patterns, shaded: U8, misses: I64) -> None:
        """Find the blame of a drawn frame. patterns : of whole patches.

        shaded : uint8[entries], 1 where a tile shaded the unit of a queue entry, in the order of `watch.passes`; not read in
        `triangle` binning. misses : int64[units], domain points that shading a unit takes in the front end; read there only.
        """
        seen = self._look(units, patterns)
        points = num_domain_points(units, np.arange(len(units.owner), dtype=np.int32))
        visible = seen.useful + seen.shared > 0
        fates = np.zeros((len(units.owner), NUM_OUTCOMES), np.int64)
        for batch, outcomes in self.fates:
            fates[batch] = outcomes
        ideal = {
            "ideal_patches": len(np.unique(seen.keys >> PATCH_SHIFT)),
            "ideal_units": int(visible.sum()),
            "ideal_domain_points": int(seen.useful.sum()),
            "ideal_unit_points": int(points[visible].sum()),
            "ideal_entries": seen.triangle_pairs if self.binning == "triangle" else len(seen.pairs),
        }
        passes = self.watch.passes
        unit = np.concatenate([p.unit for p in passes])
        bits = np.concatenate([p.bits for p in passes])
        covered, passed = np.zeros(len(points), bool), np.zeros(len(points), bool)
        covered[unit[(bits & COVERED) > 0]] = True
        passed[unit[(bits & PASSED) > 0]] = True
        if self.binning == "triangle":
            live = np.concatenate([batch for batch, _ in self.fates])
            invocations = _blame_front_end(live, points, misses, seen, visible, covered, passed, fates)
            nowhere = np.zeros((self.watch.grid.tiles_y, self.watch.grid.tiles_x), np.int64)
            self.blame = Blame(invocations, {name: nowhere.copy() for name in BLAME}, ideal)
            return
        tile = np.concatenate([np.repeat(np.arange(len(p.first) - 1), np.diff(p.first)) for p in passes])
        done = _in_order(passes, tile, self.walk)
        done = done[shaded[done] == 1]
        unit, tile, bits = unit[done], tile[done], bits[done]
        here = np.isin(unit * self.watch.grid.num_tiles + tile, seen.pairs)
        charge = _charge_tiles(unit, here, bits, points, seen, visible, covered, fates)
        grid = self.watch.grid
        maps = np.zeros((len(BLAME), grid.num_tiles), np.int64)
        for name, values in charge.items():
            np.add.at(maps[_CODES[name]], tile, values)
        tiles = {name: maps[code].reshape(grid.tiles_y, grid.tiles_x) for name, code in _CODES.items()}
        self.blame = Blame({name: int(values.sum()) for name, values in tiles.items()}, tiles, ideal)


def _in_order(passes: list[Watched], tile: I64, walk: I64) -> I64:
    """Numbers of all entries in the order of the machine: by pass, place of the tile in the walk, place in the queue."""
    place = np.empty(len(walk), np.int64)
    place[walk] = np.arange(len(walk))
    number = np.repeat([p.number for p in passes], [len(p.unit) for p in passes])
    return np.lexsort((place[tile], number))


def _fate(fates: I64, covered: B1) -> np.ndarray:
    """Codes of units that cover no sample of the picture, by what became of their triangles; -1 of the others."""
    set_up, face = fates[:, Outcome.SETUP], fates[:, Outcome.FACE]
    small = fates[:, Outcome.ZERO_AREA] + fates[:, Outcome.NO_SAMPLE]
    codes = np.full(len(fates), _CODES["no_sample"])
    codes[set_up + face + small == 0] = _CODES["outside"]
    codes[(set_up == 0) & (face > 0)] = _CODES["backface"]
    codes[covered] = -1
    return codes


def _charge_tiles(
    unit: I64, here: B1, bits: U8, points: I64, seen: _Seen, visible: B1, covered: B1, fates: I64
) -> dict[str, I64]:
    """Points charged to each line by each shading event, int64[events]. here : the unit is visible in the event's tile."""
    n = len(unit)
    # The event of each visible unit that is charged for what is useful.
    rank = np.lexsort((np.arange(n), ~here, unit))
    first = rank[np.flatnonzero(np.diff(unit[rank], prepend=-1))]
    chosen = np.zeros(n, bool)
    chosen[first] = True
    chosen &= visible[unit]
    tests = [
        (here, "redundant"),
        (_fate(fates, covered)[unit] == _CODES["outside"], "outside"),
        (_fate(fates, covered)[unit] == _CODES["backface"], "backface"),
        (~covered[unit], "no_sample"),
        ((bits & COVERED) == 0, "no_triangle_in_tile"),
        ((bits & PASSED) > 0, "occluded_order"),
        ((bits & TESTED) == 0, "occluded_untested"),
        ((bits & FRESH) > 0, "occluded_stale"),
        ((bits & TRUE) > 0, "occluded_bound"),
    ]
    code = np.select([test for test, _ in tests], [_CODES[name] for _, name in tests], _CODES["occluded_coarse"])
    cost = points[unit]
    charge = {name: np.where((code == k) & ~chosen, cost, 0) for name, k in _CODES.items()}
    charge["useful"] = np.where(chosen, seen.useful[unit], 0)
    charge["shared_border"] = np.where(chosen, seen.shared[unit], 0)
    charge["granularity"] = np.where(chosen, cost, 0) - charge["useful"] - charge["shared_border"]
    return charge


def _blame_front_end(
    live: I32, points: I64, misses: I64, seen: _Seen, visible: B1, covered: B1, passed: B1, fates: I64
) -> dict[str, int]:
    """`triangle` binning: each live patch is shaded once; no test against coarse Z comes before."""
    code = np.where(passed, _CODES["occluded_order"], _CODES["occluded_untested"])
    code = np.where(covered, code, _fate(fates, covered))[live]
    invocations = {
        name: int(points[live][(code == k) & ~visible[live]].sum()) for name, k in _CODES.items()
    }  # fmt: skip
    invocations["useful"] = int(seen.useful.sum())
    invocations["granularity"] = int(points[visible].sum() - seen.useful.sum())
    invocations["vertex_cache"] = int((misses - points)[live].sum())
    return invocations
