"""The tally of a frame: adds up what its stages report, and turns it into counters, queues and per-tile maps."""

import numpy as np

from pipeline.hull import num_control_points
from pipeline.primitives import NUM_OUTCOMES, Outcome
from pipeline.types import I32, I64, U8, CullFlag, Patches, Patterns
from tiler.binning import TileQueues
from tiler.config import Machine
from tiler.counters import Counters
from tiler.domain_cache import Events, note_events, replay_shading, vertex_misses
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.phases import UnitTests
from tiler.queue_memory import QueueReport
from tiler.queues import Queues, queue_bytes
from tiler.regions import Drawn
from tiler.scene.model import Scene
from tiler.subpatch import Split
from tiler.tile import NUM_TILE_COUNTS, Target, TileCount, count_seen
from tiler.tile_walk import walk_tiles
from tiler.units import Units, num_domain_points

OUTCOME_COUNTERS = {
    "c_invocations": Outcome.C_IN,
    "c_primitives": Outcome.C_OUT,
    "c_culled_outside": Outcome.CLIPPED,
    "c_culled_nonfinite": Outcome.INVALID,
    "c_cut": Outcome.CUT,
    "su_culled_zero_area": Outcome.ZERO_AREA,
    "su_culled_face": Outcome.FACE,
    "su_culled_no_sample": Outcome.NO_SAMPLE,
    "su_culled_offscreen": Outcome.OFFSCREEN,
    "su_triangles": Outcome.SETUP,
}

TILE_COUNTERS = {
    "queue_entries": TileCount.QUEUE_ENTRIES,
    "ds_invocations": TileCount.DS_INVOCATIONS,
    "su_culled_outside_tile": TileCount.OUTSIDE,
    "rs_triangles": TileCount.TRIANGLES,
    "rs_samples_covered": TileCount.SAMPLES_COVERED,
    "om_samples_passed": TileCount.SAMPLES_PASSED,
    "ps_invocations": TileCount.PS_INVOCATIONS,
    "ps_helper_invocations": TileCount.PS_HELPERS,
    "cz_pairs_tested": TileCount.PAIRS_TESTED,
    "cz_pairs_occluded": TileCount.PAIRS_OCCLUDED,
    "cz_triangles_tested": TileCount.TRIANGLES_TESTED,
    "cz_triangles_occluded": TileCount.TRIANGLES_OCCLUDED,
    "cz_blocks_tested": TileCount.BLOCKS_TESTED,
    "cz_blocks_occluded": TileCount.BLOCKS_OCCLUDED,
    "cz_blocks_accepted": TileCount.BLOCKS_ACCEPTED,
    "cz_cells_read": TileCount.CELLS_READ,
    "cz_outlines_tested": TileCount.OUTLINES_TESTED,
    "cz_outlines_missed": TileCount.OUTLINES_MISSED,
    "cz_hits_level_0": TileCount.HITS_0,
    "cz_hits_level_1": TileCount.HITS_1,
    "cz_hits_level_2": TileCount.HITS_2,
    "cz_hits_level_3_up": TileCount.HITS_3,
    "cz_updates": TileCount.UPDATES,
    "dc_lookups": TileCount.CACHE_LOOKUPS,
    "dc_hits": TileCount.CACHE_HITS,
}


class Tally:
    """Sums of one frame."""

    def __init__(self, scene: Scene, machine: Machine, grid: Grid) -> None:
        self.machine = machine
        self.grid = grid
        self.walk = walk_tiles(grid, machine.tile_walk)
        self.events: list[Events] = []
        self.shaded: U8 = np.zeros(0, np.uint8)  # 1 for each queue entry, by `events`, whose unit its tile shaded
        self.queued: U8 = np.zeros(0, np.uint8)  # patches queued anywhere
        self.tiles: I64 = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
        self.outcomes: I64 = np.zeros(NUM_OUTCOMES, np.int64)  # of the front end: each patch once
        self.seen: int | None = None  # samples that hold a triangle, where they are counted as they are drawn
        self.values = {
            "ia_vertices": scene.num_vertices,
            "ia_primitives": scene.num_patches,
            "vs_invocations": scene.num_vertices,
            "hs_invocations": scene.num_patches,
            "hs_bounds_evaluated": scene.num_patches,
            "hs_subpatches": 0,
            "hs_subpatches_culled_frustum": 0,
            "bin_patches": 0,
            "bin_patches_offscreen": 0,
            "bin_subpatches": 0,
            "bin_subpatches_offscreen": 0,
            "cz_units_tested": 0,
            "cz_units_occluded": 0,
            "cz_stale_rejects": 0,
            "queue_bytes": 0,
            "ds_invocations": 0,  # of the front end
            "cz_cells_read": 0,  # by tests of whole units
            "cz_outlines_tested": 0,
            "cz_outlines_missed": 0,
            "cz_hits_level_0": 0,
            "cz_hits_level_1": 0,
            "cz_hits_level_2": 0,
            "cz_hits_level_3_up": 0,
        }

    def count_patches(self, patches: Patches, flags: U8, patterns: Patterns, live: I32) -> None:
        """What became of the patches up to the tessellator."""
        culled = np.bincount(flags, minlength=len(CullFlag))
        used = patterns.of_patch[live]
        self.values |= {
            "hs_control_points": num_control_points(patches),
            "hs_culled_nonfinite": int(culled[CullFlag.NONFINITE]),
            "hs_culled_frustum": int(culled[CullFlag.FRUSTUM]),
            "hs_culled_backface": int(culled[CullFlag.BACKFACE]),
            "ts_culled_factor": int(culled[CullFlag.FACTOR]),
            "ts_patches": len(live),
            "ts_domain_points": int(np.diff(patterns.first_point)[used].sum()),
            "ts_triangles": int(np.diff(patterns.first_triangle)[used].sum()),
        }

    def count_split(self, split: Split) -> None:
        """What cutting the patches alive into sub-domains took."""
        self.values["hs_bounds_evaluated"] += split.bounded
        self.values["hs_subpatches"] = len(split.units.owner)
        self.values["hs_subpatches_culled_frustum"] = split.culled

    def count_batch(self, units: Units, live: I32, geometry: Geometry, queues: TileQueues) -> None:
        """What binning a batch of units wrote, and what its front end did."""
        if self.machine.binning == "triangle":
            self._count_triangles(units, live, geometry.outcomes, geometry.num_used, len(queues.item))
            return
        self.outcomes += geometry.outcomes.sum(axis=0)
        queued = np.zeros(len(live), np.uint8)
        queued[queues.item] = 1
        found, name = int(queued.sum()), "bin_subpatches" if self.machine.binning == "subpatch" else "bin_patches"
        self.values[name] += found
        self.values[f"{name}_offscreen"] += len(live) - found
        parts = 0
        if self.machine.binning == "subpatch":
            if not len(self.queued):
                self.queued = np.zeros(self.values["ia_primitives"], np.uint8)
            self.queued[units.owner[live[queued == 1]]] = 1
            found, parts = 0, found  # the patches are counted at the end: their parts may lie in several batches
        self._add_bytes(len(queues.item), 0, 0, found, parts)

    def count_drawn(self, units: Units, live: I32, drawn: Drawn) -> None:
        """What a `triangle` machine did with patches `live`, which were drawn in regions and counted in `tiles`."""
        entries = int(drawn.counts[:, TileCount.QUEUE_ENTRIES].sum())
        self._count_triangles(units, live, drawn.outcomes, drawn.num_used, entries)
        self.seen = int(drawn.seen[0])

    def _count_triangles(self, units: Units, live: I32, outcomes: I64, num_used: I64, entries: int) -> None:
        """outcomes : int64[live, NUM_OUTCOMES]. num_used : int64[live], vertices of set-up triangles. entries : queued."""
        self.outcomes += outcomes.sum(axis=0)
        self._add_bytes(entries, int(outcomes[:, Outcome.SETUP].sum()), int(num_used.sum()), 0, 0)
        misses = vertex_misses(units.patterns, self.machine.vertex_cache)
        self.values["ds_invocations"] += int(misses[units.patterns.of_patch[live]].sum())

    def count_entries(self, live: I32, queues: TileQueues, outcome: U8, number: int) -> None:
        """What became of the queue entries that pass `number` worked off, of a batch of units `live`."""
        if self.machine.binning != "triangle":
            self.events.append(note_events(number, queues, live, outcome))

    def _add_bytes(self, entries: int, triangles: int, vertices: int, patches: int, parts: int) -> None:
        self.values["queue_bytes"] += queue_bytes(entries, triangles, vertices, patches, parts)

    def count_units(self, units: Units, tests: UnitTests) -> None:
        """What happened to units as wholes, after all batches."""
        if self.machine.binning == "subpatch":
            self.values["bin_patches"] = int(self.queued.sum())
            self._add_bytes(0, 0, 0, self.values["bin_patches"], 0)
        if self.machine.binning != "triangle":
            points = num_domain_points(units, np.arange(len(units.owner), dtype=np.int32))
            self.shaded = replay_shading(
                self.events, points, self.walk, self.machine.cores, self.machine.domain_cache, self.tiles
            )  # fmt: skip
        self.values |= {
            "cz_units_tested": tests.tested,
            "cz_units_occluded": tests.occluded,
            "cz_stale_rejects": tests.stale,
            "cz_cells_read": tests.cells,
            "cz_outlines_tested": tests.outlines,
            "cz_outlines_missed": tests.misses,
        }
        for name, hits in zip(("0", "1", "2", "3_up"), tests.hits, strict=True):
            self.values[f"cz_hits_level_{name}"] = int(hits)

    def counters(self, target: Target, memory: dict[str, int]) -> Counters:
        """All counters of the frame. memory : those of the queues' memory."""
        by_unit = self.machine.binning != "triangle"
        sums = self.tiles.sum(axis=0)
        outcomes = sums[:NUM_OUTCOMES] if by_unit else self.outcomes
        values = self.values | memory | {name: int(outcomes[column]) for name, column in OUTCOME_COUNTERS.items()}
        values |= {name: values.get(name, 0) + int(sums[column]) for name, column in TILE_COUNTERS.items()}
        entries = values["queue_entries"]
        for binning in ("patch", "subpatch", "triangle"):
            values[f"bin_{binning}_tile_pairs"] = entries if self.machine.binning == binning else 0
        values["queue_longest"] = int(self.tiles[:, TileCount.QUEUE_ENTRIES].max())
        values["om_samples_failed"] = values["rs_samples_covered"] - values["om_samples_passed"]
        values["om_samples_visible"] = int(count_seen(target.depth.ravel())) if self.seen is None else self.seen
        return Counters(values)

    def queues(self, memory: QueueReport) -> Queues:
        """The tile queues' lengths and bytes."""
        entries = self.tiles[:, TileCount.QUEUE_ENTRIES].reshape(self.grid.tiles_y, self.grid.tiles_x).copy()
        return Queues(entries, self.values["queue_bytes"], memory)

    def tile_maps(self) -> dict[str, I64]:
        """Per-tile counters by name, int64[tiles_y, tiles_x]."""
        shape = (self.grid.tiles_y, self.grid.tiles_x)
        return {name: self.tiles[:, column].reshape(shape).copy() for name, column in TILE_COUNTERS.items()}

    def core_sums(self) -> dict[str, I64]:
        """Per-tile counters summed over the tiles of each simulated core, int64[cores]."""
        cores = self.machine.cores
        turns = np.zeros((-(-self.grid.num_tiles // cores) * cores, NUM_TILE_COUNTS), np.int64)
        turns[: self.grid.num_tiles] = self.tiles[self.walk]
        sums = turns.reshape(-1, cores, NUM_TILE_COUNTS).sum(axis=0)
        return {name: sums[:, column].copy() for name, column in TILE_COUNTERS.items()}
