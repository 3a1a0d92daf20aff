"""The tally of a frame: adds up what its stages report, and turns it into counters, queues and per-tile maps."""

import numpy as np

from pipeline.hull import num_control_points
from pipeline.jit import kernel
from pipeline.primitives import NUM_OUTCOMES, Outcome
from pipeline.types import I32, I64, U8, CullFlag, Patches, Patterns
from tiler.binning import TileQueues
from tiler.config import Machine
from tiler.counters import Counters
from tiler.front_end import Geometry
from tiler.grid import Grid
from tiler.queue_memory import QueueReport
from tiler.queues import Queues, queue_bytes
from tiler.scene.model import Scene
from tiler.tile import NUM_TILE_COUNTS, Target, TileCount

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
}


@kernel
def _mark_vertices(triangles, used):
    """used[v] = 1 for every vertex of a set-up triangle."""
    for k in range(len(triangles.used)):
        for t in range(triangles.first[k], triangles.first[k] + triangles.used[k]):
            for c in range(3):
                used[triangles.vertex[t, c]] = 1


class Tally:
    """Sums of one frame."""

    def __init__(self, scene: Scene, machine: Machine, grid: Grid) -> None:
        self.machine = machine
        self.grid = grid
        self.tiles: I64 = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
        self.outcomes: I64 = np.zeros(NUM_OUTCOMES, np.int64)  # of the front end: each patch once
        self.values = {
            "ia_vertices": scene.num_vertices,
            "ia_primitives": scene.num_patches,
            "vs_invocations": scene.num_vertices,
            "hs_invocations": scene.num_patches,
            "bin_patches": 0,
            "bin_patches_offscreen": 0,
            "queue_bytes": 0,
            "ds_invocations": 0,  # of the front end
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

    def count_batch(self, geometry: Geometry, queues: TileQueues) -> None:
        """What binning a batch wrote, and what its front end did."""
        self.outcomes += geometry.outcomes.sum(axis=0)
        if self.machine.binning == "triangle":
            used = np.zeros(len(geometry.window.x), np.uint8)
            _mark_vertices(geometry.triangles, used)
            triangles, vertices, patches = int(geometry.triangles.used.sum()), int(used.sum()), 0
            self.values["ds_invocations"] += int(geometry.points.first[-1])
        else:
            queued = np.zeros(len(geometry.triangles.used), np.uint8)
            queued[queues.item] = 1
            triangles, vertices, patches = 0, 0, int(queued.sum())
            self.values["bin_patches"] += patches
            self.values["bin_patches_offscreen"] += len(queued) - patches
        self.values["queue_bytes"] += queue_bytes(len(queues.item), triangles, vertices, patches)

    def counters(self, target: Target, memory: dict[str, int]) -> Counters:
        """All counters of the frame. memory : those of the queues' memory."""
        by_patch = self.machine.binning == "patch"
        sums = self.tiles.sum(axis=0)
        outcomes = sums[:NUM_OUTCOMES] if by_patch else self.outcomes
        values = self.values | memory | {name: int(outcomes[column]) for name, column in OUTCOME_COUNTERS.items()}
        values |= {name: values.get(name, 0) + int(sums[column]) for name, column in TILE_COUNTERS.items()}
        entries = values["queue_entries"]
        values["bin_patch_tile_pairs"] = entries if by_patch else 0
        values["bin_triangle_tile_pairs"] = 0 if by_patch else entries
        values["queue_longest"] = int(self.tiles[:, TileCount.QUEUE_ENTRIES].max())
        values["om_samples_failed"] = values["rs_samples_covered"] - values["om_samples_passed"]
        values["om_samples_visible"] = int(np.count_nonzero(target.depth < 1.0))
        return Counters(values)

    def queues(self, memory: QueueReport) -> Queues:
        """The tile queues' lengths and bytes."""
        return Queues(self.tile_maps()["queue_entries"], self.values["queue_bytes"], memory)

    def tile_maps(self) -> dict[str, I64]:
        """Per-tile counters by name, int64[tiles_y, tiles_x]."""
        shape = (self.grid.tiles_y, self.grid.tiles_x)
        return {name: self.tiles[:, column].reshape(shape).copy() for name, column in TILE_COUNTERS.items()}

    def core_sums(self) -> dict[str, I64]:
        """Per-tile counters summed over the tiles of each simulated core, int64[cores]."""
        cores = self.machine.cores
        core = np.arange(self.grid.num_tiles) % cores
        return {
            name: np.array([self.tiles[core == c, column].sum() for c in range(cores)], np.int64)
            for name, column in TILE_COUNTERS.items()
        }
