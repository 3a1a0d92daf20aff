"""Slow twin of the whole machine: it executes everything that it counts, one event at a time, tile by tile.

Where the production machine shades a patch once and *adds up* what tiles would do, this one tessellates, shades, clips
and sets up every patch again in every tile that has it queued, tests every sample of the tile, and counts by `+= 1`.
Taken from production, for one patch at a time: the tessellator, the domain shader's arithmetic, bounds and cull tests, the
overlap of a bound's hull, screen-space factors and the camera, each of which has tests of its own. Primitives and coarse Z
are the slow twins of their own tests.
"""

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from pipeline import domain, hull
from pipeline.bounds import BOUNDS
from pipeline.bounds.refine import gather_parts
from pipeline.culling import CULL_TESTS, FLAG_OF
from pipeline.displacement import pack_maps
from pipeline.hull import make_input
from pipeline.tessellator import tessellate
from pipeline.types import (
    Address,
    DomainPoints,
    FaceCull,
    HullInput,
    Partitioning,
    PatchBounds,
    Patches,
    Patterns,
    TessFactors,
    Viewport,
)
from pipeline.vertex import make_patches
from tests.naive import SAMPLE_OFFSETS
from tests.naive_coarse_z import NaiveCoarseZ
from tests.naive_near_planes import naive_nearest
from tests.naive_outline import naive_lines, naive_reached
from tests.naive_primitives import NaiveTriangle, naive_assemble, twice_area
from tests.naive_queue_memory import NaiveQueueMemory
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.front_end import run_vertex_shader
from tiler.grid import make_grid
from tiler.host import Host
from tiler.overlap import bin_hulls
from tiler.queue_models import load_queue_model
from tiler.scene.camera import Camera, camera_at
from tiler.scene.model import Scene

f32 = np.float32
REACH = {1: 0, 4: 96}  # farthest sample from the pixel centre along an axis, 1/256 pixel
COUNTER_OF = {
    "C_IN": "c_invocations", "C_OUT": "c_primitives", "CLIPPED": "c_culled_outside", "INVALID": "c_culled_nonfinite",
    "CUT": "c_cut", "ZERO_AREA": "su_culled_zero_area", "FACE": "su_culled_face", "NO_SAMPLE": "su_culled_no_sample",
    "OFFSCREEN": "su_culled_offscreen", "SETUP": "su_triangles",
}  # fmt: skip
COUNTED_BY_TILE = (
    "queue_entries", "ds_invocations", "su_culled_outside_tile", "rs_triangles", "rs_samples_covered", "om_samples_passed",
    "ps_invocations", "ps_helper_invocations", "cz_pairs_tested", "cz_pairs_occluded", "cz_triangles_tested",
    "cz_triangles_occluded", "cz_blocks_tested", "cz_blocks_occluded", "cz_blocks_accepted", "cz_cells_read",
    "cz_hits_level_0", "cz_hits_level_1", "cz_hits_level_2", "cz_hits_level_3_up", "cz_updates", "dc_lookups", "dc_hits",
    "cz_outlines_tested", "cz_outlines_missed",
)  # fmt: skip
HIT = ("cz_hits_level_0", "cz_hits_level_1", "cz_hits_level_2")


@dataclass
class NaiveFrame:
    """What the slow machine drew and counted."""

    depth: np.ndarray  # float32[H, W, S]
    patch: np.ndarray  # int[H, W, S], the patch seen at each sample, -1 for none
    counters: dict[str, int]
    tiles: dict[str, np.ndarray]  # int[tiles_y, tiles_x]
    cores: dict[str, list[int]]


@dataclass
class Triangle:
    """A triangle that passed set-up. `vertices`: names of its vertices, equal where a vertex is shared."""

    patch: int
    number: int  # in the tessellator's order
    shape: NaiveTriangle
    vertices: list[tuple]

    def nearest(self) -> np.float32:
        return min(max(min(v.z for v in self.shape.vertices), f32(0)), f32(1))

    def farthest(self) -> np.float32:
        return min(max(max(v.z for v in self.shape.vertices), f32(0)), f32(1))


@dataclass
class Unit:
    """A patch or a sub-domain of it: what is queued, and what a tile makes of it."""

    patch: int
    number: int  # among the units of the frame
    data: Patches
    uv: np.ndarray
    indices: np.ndarray
    triangles: list[int]  # their numbers in the tessellator's order
    bound: PatchBounds  # of one row

    @property
    def rect(self) -> tuple[int, int, int, int]:
        """Pixels of the bound, inclusive."""
        x0, y0, x1, y1 = (int(c) for c in self.bound.rect[0])
        return x0, y0, x1 - 1, y1 - 1


@dataclass
class NaiveMachine:
    """One frame in the making."""

    scene: Scene
    machine: Machine
    camera: Camera
    number: float = 0.0
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(DEFINITIONS, 0))
    tile: int | None = None  # the tile being worked off; None in the front end

    def __post_init__(self) -> None:
        p = self.scene.picture
        self.viewport = Viewport(0, 0, p.width, p.height, 0.0, 1.0)
        size = self.machine.tile
        self.tiles_x, self.tiles_y = math.ceil(p.width / size), math.ceil(p.height / size)
        self.tiles = {name: [0] * (self.tiles_x * self.tiles_y) for name in COUNTED_BY_TILE}
        if self.scene.meshes:
            self.patches = run_vertex_shader(self.scene, self.number)
        self.maps = pack_maps([(m.texels, Address[m.address.upper()], m.scale, m.bias) for m in self.scene.maps])
        self.depth = np.ones((p.height, p.width, p.samples), f32)
        # The patch at each sample that has one, and the triangle's number in it.
        self.seen: dict[tuple[int, int, int], tuple[int, int]] = {}
        self.coarse = NaiveCoarseZ(p.width, p.height, self.machine.coarse_z_block)
        self.tests = self.machine.occlusion  # what the phase at hand tests in its tiles
        self.feedback = bool(self.tests) and self.machine.z_feedback == "tile"
        self.strict = self.machine.reordered

        m = self.machine
        self.memory = NaiveQueueMemory(
            load_queue_model(m.queue_model), m.binning, self.tiles_x, self.tiles_y, pool=m.queue_pool,
            policy=m.queue_policy or "",
        )  # fmt: skip
        self.longest = [0] * (self.tiles_x * self.tiles_y)

    def count(self, name: str, number: int = 1) -> None:
        self.counters[name] += number
        if self.tile is not None and name in self.tiles:
            self.tiles[name][self.tile] += number

    # Per patch.

    def patch(self, p: int) -> Patches:
        """Patch p alone, in world space; those of subdivision surfaces come from production."""
        scene = self.scene
        if scene.meshes:
            return self.patches.take(np.array([p]))
        m = scene.transforms[scene.object_id[p]]
        world = np.empty((1, 4, 4, 4), f32)
        with np.errstate(all="ignore"):
            for i in range(4):
                for j in range(4):
                    x, y, z, w = scene.control_points[p, i, j]
                    for r in range(3):
                        world[0, i, j, r] = ((m[r, 0] * x + m[r, 1] * y) + m[r, 2] * z) + m[r, 3] * w
                    world[0, i, j, 3] = w
        return make_patches(world, scene.texcoords[p : p + 1], scene.map_id[p : p + 1], scene.object_id[p : p + 1])

    def vertex_shader(self) -> None:
        """Count the control points: 16 for each patch, and each vertex of a mesh that one of its faces has."""
        for _ in range(16 * len(self.scene.control_points)):
            self.count("ia_vertices")
            self.count("vs_invocations")
        for mesh in self.scene.meshes:
            for _ in range(mesh.surface.used_vertices):
                self.count("ia_vertices")
                self.count("vs_invocations")

    def control_points(self, patch: Patches) -> int:
        """Runs of the hull shader's control-point phase for a patch."""
        if patch.tangent_id[0] >= 0:
            return 16 + 16
        return 20 if patch.gregory_id[0] >= 0 else 16

    def finite(self, patch: Patches) -> bool:
        values = list(patch.control_points.flat)
        if patch.tangent_id[0] >= 0:
            values += [*patch.tangent_u[patch.tangent_id[0]].flat, *patch.tangent_v[patch.tangent_id[0]].flat]
        if patch.gregory_id[0] >= 0:
            values += [*patch.inner[patch.gregory_id[0]].flat]
        if patch.map_id[0] >= 0:
            displacement = self.scene.maps[patch.map_id[0]]
            values += [*patch.texcoords.flat, *displacement.texels.flat, displacement.scale, displacement.bias]
        return all(math.isfinite(value) for value in values)

    def hull_shader(self) -> list[Unit]:
        """What lives on, in submit order."""
        alive: list[Unit] = []
        self.vertex_shader()
        for p in range(self.scene.num_patches):
            self.count("ia_primitives")
            patch = self.patch(p)
            self.count("hs_invocations")
            for _ in range(self.control_points(patch)):
                self.count("hs_control_points")
            self.count("hs_bounds_evaluated")
            if not self.finite(patch):
                self.count("hs_culled_nonfinite")
                continue
            stage = make_input(
                patch, self.maps, self.camera.clip_from_world, self.viewport, eye=self.camera.eye,
                factors=TessFactors(*(np.array([a], f32) for a in self.factors(patch))),
                face_cull=FaceCull[self.scene.face_cull.upper()],
                partitioning=Partitioning[self.scene.tessellation.partitioning.upper()],
            )  # fmt: skip
            bound = BOUNDS[self.machine.bounds](stage)
            culled_by = self.first_cull(stage, bound)
            if culled_by:
                self.count(f"hs_culled_{FLAG_OF[culled_by].name.lower()}")
                continue
            uv, indices = self.tessellate(patch)
            if len(indices) == 0:
                self.count("ts_culled_factor")
                continue
            self.count("ts_patches")
            for _ in uv:
                self.count("ts_domain_points")
            for _ in range(0, len(indices), 3):
                self.count("ts_triangles")
            if self.machine.binning == "subpatch":
                alive += self.sub_domains(p, patch, stage, bound, uv, indices, len(alive))
            else:
                alive.append(Unit(p, len(alive), patch, uv, indices, list(range(len(indices) // 3)), bound))
        return alive

    def sub_domains(
        self,
        p: int,
        patch: Patches,
        stage: HullInput,
        bound: PatchBounds,
        uv: np.ndarray,
        indices: np.ndarray,
        first: int,
    ) -> list[Unit]:
        """Bound and split one patch."""
        everything = list(range(len(indices) // 3))
        whole = (0.0, 1.0, 0.0, 1.0)
        leaves, waiting = [], [(whole, everything, bound, False)]
        cp = patch.control_points[0, ..., :3].astype(float) / patch.control_points[0, ..., 3:]
        length_u = max(sum(math.dist(cp[i][j], cp[i + 1][j]) for i in range(3)) for j in range(4))
        length_v = max(sum(math.dist(cp[i][j], cp[i][j + 1]) for j in range(3)) for i in range(4))
        while waiting:
            wishes = [part for part in waiting if self.should_split(*part)]
            wishes.sort(key=lambda part: (-self.pixels(part[2]), part[0][0], part[0][2]))
            room = self.machine.subpatch_budget - len(waiting) - len(leaves)
            chosen = wishes[: max(room, 0)]
            leaves += [part for part in waiting if not any(part is c for c in chosen)]
            waiting = []
            for (u0, u1, v0, v1), owned, _, _ in chosen:
                in_u, in_v = (u1 - u0) * length_u, (v1 - v0) * length_v
                if v1 - v0 > 1 / 64 and (u1 - u0 <= 1 / 64 or in_v > in_u or (in_v == in_u and v1 - v0 > u1 - u0)):
                    middle = (v0 + v1) / 2
                    halves = [(u0, u1, v0, middle), (u0, u1, middle, v1)]
                else:
                    middle = (u0 + u1) / 2
                    halves = [(u0, middle, v0, v1), (middle, u1, v0, v1)]
                for cell in halves:
                    mine = [t for t in owned if self.owns(cell, uv[indices[3 * t : 3 * t + 3]])]
                    if not mine:
                        continue
                    corners = np.concatenate([uv[indices[3 * t : 3 * t + 3]] for t in mine]).astype(float)
                    reach = [corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max()]
                    part_stage = gather_parts(stage, np.zeros(1, np.int32), np.array([reach]))
                    self.count("hs_bounds_evaluated")
                    part_bound = BOUNDS[self.machine.bounds](part_stage)
                    outside = np.zeros(1, np.uint8)
                    if "frustum" in self.machine.cull:
                        CULL_TESTS["frustum"](part_stage, part_bound, outside)
                    waiting.append((cell, mine, part_bound, bool(outside[0])))
        units = []
        for _, owned, part_bound, culled in sorted(leaves, key=lambda part: (part[0][0], part[0][2])):
            self.count("hs_subpatches")
            if culled:
                self.count("hs_subpatches_culled_frustum")
                continue
            corners = [int(i) for t in owned for i in indices[3 * t : 3 * t + 3]]
            points = list(dict.fromkeys(corners))
            local = np.array([points.index(i) for i in corners])
            units.append(Unit(p, first + len(units), patch, uv[points], local, owned, part_bound))
        return units

    @staticmethod
    def owns(cell: tuple, corners: np.ndarray) -> bool:
        """Whether a triangle's centroid is in the cell; on a border the later cell has it."""
        u, v = (sum(int(c * 65536) for c in column) for column in corners.T)  # exact, times 3 * 65536
        u0, u1, v0, v1 = (int(c * 3 * 65536) for c in cell)
        return u0 <= u and (u < u1 or u == u1 == 3 * 65536) and v0 <= v and (v < v1 or v == v1 == 3 * 65536)

    @staticmethod
    def pixels(bound: PatchBounds) -> int:
        x0, y0, x1, y1 = (int(c) for c in bound.rect[0])
        return (x1 - x0) * (y1 - y0)

    def should_split(self, cell: tuple, owned: list[int], bound: PatchBounds, culled: bool) -> bool:
        x0, y0, x1, y1 = (int(c) for c in bound.rect[0])
        size = self.machine.tile
        tiles = ((x1 - 1) // size - x0 // size + 1) * ((y1 - 1) // size - y0 // size + 1)
        wide = max(x1 - x0, y1 - y0) > self.machine.subpatch_extent
        return (
            wide and tiles > 1 and not culled and len(owned) > 2 and max(cell[1] - cell[0], cell[3] - cell[2]) > 1 / 64
        )

    def first_cull(self, stage: HullInput, bound: PatchBounds) -> str:
        for name in self.machine.cull:
            if name.startswith("occlusion"):
                continue
            flags = np.zeros(1, np.uint8)
            CULL_TESTS[name](stage, bound, flags)
            if flags[0]:
                assert flags[0] == FLAG_OF[name]
                return name
        return ""

    def factors(self, patch: Patches) -> tuple[np.ndarray, np.ndarray]:
        policy = self.scene.tessellation
        edge, inside = policy.factor[:4], policy.factor[4:]
        if policy.edge_pixels is not None:
            factors = hull.screen_factors(
                patch.control_points, self.camera.clip_from_world, self.viewport, self.camera.near, policy.edge_pixels,
                policy.max_factor,
            )  # fmt: skip
            edge, inside = factors.edge[0], factors.inside[0]
        return edge, inside

    def tessellate(self, patch: Patches) -> tuple[np.ndarray, np.ndarray]:
        edge, inside = self.factors(patch)
        return tessellate("quad", self.scene.tessellation.partitioning, edge, inside, "triangle_ccw")

    def domain_shader(self, patch: Patches, uv: np.ndarray, indices: np.ndarray) -> np.ndarray:
        """Clip positions (n, 4) of every domain point of a patch, each counted where it is shaded."""
        n = len(uv)
        zero = np.zeros(1, np.int32)
        pattern = Patterns(
            zero,
            np.ascontiguousarray(uv.T),
            np.array([0, n]),
            indices.astype(np.uint16),
            np.array([0, len(indices) // 3]),
        )
        points = DomainPoints(np.array([0, n]), np.empty((4, n), f32), np.empty((3, n), f32))
        scratch = np.empty(domain.SCRATCH, f32)
        domain.shade_patches(0, 1, zero, patch, pattern, self.maps, self.camera.clip_from_world, points, scratch)
        for _ in range(n):
            self.count("ds_invocations")
        return points.clip.T

    # Per triangle.

    def primitives(self, unit: Unit, clip: np.ndarray) -> Iterator[Triangle]:
        """Clip and set up each triangle of a unit; those that passed."""
        samples, p, indices = self.scene.picture.samples, unit.patch, unit.indices
        for t in range(0, len(indices), 3):
            numbers = indices[t : t + 3].tolist()
            # A vertex carries its number as an attribute.
            corners = [(*clip[i], i) for i in numbers]
            counts, shapes = naive_assemble(corners, self.viewport, REACH[samples], self.scene.face_cull.upper())
            for outcome, n in counts.items():
                for _ in range(n):
                    self.count(COUNTER_OF[outcome])
            for shape in shapes:
                if "CUT" in counts:  # new vertices, shared by the triangles of the fan
                    names = [(p, "cut", t, id(v)) for v in shape.vertices]
                else:
                    names = [(p, int(v.attributes[0])) for v in shape.vertices]
                yield Triangle(p, unit.triangles[t // 3], shape, names)

    # Per tile.

    def tile_pixels(self, tile: int) -> tuple[range, range]:
        size, (y, x) = self.machine.tile, divmod(tile, self.tiles_x)
        columns = range(x * size, min((x + 1) * size, self.viewport.width))
        return columns, range(y * size, min((y + 1) * size, self.viewport.height))

    def touches(self, tile: int, box: tuple[int, int, int, int]) -> bool:
        """Whether the tile has a pixel of the box: first column, first row, last column, last row, inclusive."""
        columns, rows = self.tile_pixels(tile)
        x0, y0, x1, y1 = box
        return any(x0 <= x <= x1 for x in columns) and any(y0 <= y <= y1 for y in rows)

    def reaches(self, tile: int, triangle: Triangle) -> bool:
        """Whether the triangle's box touches the tile; with exact overlap, whether no edge keeps all of their samples out."""
        if not self.touches(tile, triangle.shape.box):
            return False
        (_, columns), (_, rows) = (self.tile_span(tile, axis) for axis in range(2))
        x0, y0, x1, y1 = triangle.shape.box
        if self.machine.overlap == "rect" or len(self.tiles_of(triangle.shape.box)) == 1:
            return True
        reach = REACH[self.scene.picture.samples]
        xs = (max(x0, columns[0]) * 256 + 128 - reach, min(x1, columns[-1]) * 256 + 128 + reach)
        ys = (max(y0, rows[0]) * 256 + 128 - reach, min(y1, rows[-1]) * 256 + 128 + reach)
        a, b, c = triangle.shape.vertices
        for p, q in ((b, c), (c, a), (a, b)):
            top_left = q.y < p.y or (q.y == p.y and q.x > p.x)
            most = max((q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x) for x in xs for y in ys)
            if most < 0 or (most == 0 and not top_left):
                return False
        return True

    def tile_span(self, tile: int, axis: int) -> tuple[int, range]:
        pixels = self.tile_pixels(tile)[axis]
        return len(pixels), pixels

    def tiles_of(self, box: tuple[int, int, int, int]) -> list[int]:
        return [t for t in range(self.tiles_x * self.tiles_y) if self.touches(t, box)]

    def unit_tiles(self, unit: Unit) -> list[int]:
        """Tiles that a unit is queued in."""
        x0, y0, x1, y1 = unit.rect
        if x0 > x1 or y0 > y1:
            return []
        if self.machine.overlap == "exact":
            grid = make_grid(self.viewport.width, self.viewport.height, self.machine.tile)
            with Host(1) as host:
                first = bin_hulls(np.zeros(1, np.int32), unit.bound, grid, host).first
            return [t for t in range(len(first) - 1) if first[t + 1] > first[t]]
        return self.tiles_of(unit.rect)

    def clipped(self, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        """The part of a box in the tile at hand."""
        columns, rows = self.tile_pixels(self.tile)
        x0, y0, x1, y1 = box
        return max(x0, columns[0]), max(y0, rows[0]), min(x1, columns[-1]), min(y1, rows[-1])

    def nearest(self, unit: Unit) -> np.float32:
        """Least depth of a unit's bound in the tile at hand."""
        return naive_nearest(unit.bound, self.viewport, self.clipped(unit.rect))

    def reached(self, unit: Unit) -> Callable[[tuple[int, int, int, int]], bool] | None:
        """Whether the outline of a unit's bound reaches pixels; None if it has no outline."""
        lines = naive_lines(unit.bound, self.viewport)
        return None if lines is None else lambda box: naive_reached(lines, box)

    def unit_hidden(self, unit: Unit, box: tuple[int, int, int, int], z: np.float32, largest: int) -> bool:
        """Test these pixels of a unit, by rectangle with nearest depth z, or by hull; counted."""
        if self.machine.occlusion_area == "rect":
            return self.hidden(box, z, largest)
        level, cells, asked, missed = self.coarse.hidden_hull(
            box, lambda part: naive_nearest(unit.bound, self.viewport, part), self.reached(unit), self.strict, largest
        )
        for name, times in (("cz_cells_read", cells), ("cz_outlines_tested", asked), ("cz_outlines_missed", missed)):
            for _ in range(times):
                self.count(name)
        if level is None:
            return False
        self.count(HIT[level] if level < 3 else "cz_hits_level_3_up")
        return True

    def hidden(self, box: tuple[int, int, int, int], z: np.float32, largest: int) -> bool:
        """Test against the pyramid, cells of at most `largest` pixels; counted."""
        level, cells = self.coarse.hidden_at(box, z, self.strict, largest)
        for _ in range(cells):
            self.count("cz_cells_read")
        if level is None:
            return False
        self.count(HIT[level] if level < 3 else "cz_hits_level_3_up")
        return True

    def draw(self, triangle: Triangle, written: set) -> None:
        """One triangle in the tile at hand: coarse Z, rasterization; `written`: blocks to recompute."""
        box = self.clipped(triangle.shape.box)
        by_unit = self.machine.binning != "triangle"
        if ("occlusion:triangle" if by_unit else "occlusion") in self.tests:
            what = "triangles" if by_unit else "pairs"
            self.count(f"cz_{what}_tested")
            if self.hidden(box, triangle.nearest(), self.machine.tile):
                self.count(f"cz_{what}_occluded")
                return
        self.count("rs_triangles")
        columns, rows = self.tile_pixels(self.tile)
        feed_forward = self.feedback and self.machine.coarse_z_update == "feed_forward"
        if "occlusion:block" not in self.tests and not feed_forward:
            parts = [(None, columns, rows)]
        else:
            parts = [(b, *self.coarse.pixels(b)) for b in self.coarse.blocks(box)]
        any_passed = 0
        for block, part_columns, part_rows in parts:
            if "occlusion:block" in self.tests:
                self.count("cz_blocks_tested")
                if self.coarse.hides(self.coarse.far[block], triangle.nearest(), self.strict):
                    self.count("cz_blocks_occluded")
                    continue
                if triangle.farthest() < self.coarse.near[block]:
                    self.count("cz_blocks_accepted")
            before = self.counters["rs_samples_covered"]
            passed = self.rasterize(triangle, part_columns, part_rows)
            any_passed += passed
            if block is not None and passed:
                self.coarse.near[block] = min(self.coarse.near[block], triangle.nearest())
                covered = self.counters["rs_samples_covered"] - before
                full = covered == len(part_columns) * len(part_rows) * self.scene.picture.samples
                if feed_forward and full and triangle.farthest() < self.coarse.far[block]:
                    self.coarse.far[block] = triangle.farthest()
                    self.count("cz_updates")
        if any_passed and self.feedback and not feed_forward:
            written.update(self.coarse.blocks(box))

    def rasterize(self, triangle: Triangle, columns: range, rows: range) -> int:
        """Test every sample of these pixels against the triangle; depth test, write, count. How many samples passed."""
        a, b, c = triangle.shape.vertices
        edges = [(b, c), (c, a), (a, b)]
        centre_x, centre_y = np.array(columns)[None, :] * 256 + 128, np.array(rows)[:, None] * 256 + 128
        inside, values = [], []
        for dx, dy in SAMPLE_OFFSETS[self.scene.picture.samples]:
            x, y = centre_x + 16 * dx, centre_y + 16 * dy
            e = [(q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x) for p, q in edges]
            covered = np.ones(e[0].shape, bool)
            for (p, q), value in zip(edges, e, strict=True):
                top_left = q.y < p.y or (q.y == p.y and q.x > p.x)
                covered &= value >= 0 if top_left else value > 0
            inside.append(covered)
            values.append(e)
        shaded, all_passed = [], 0
        for j, i in np.argwhere(np.any(inside, axis=0)):
            any_passed = False
            for s, e in enumerate(values):
                if inside[s][j, i]:
                    self.count("rs_samples_covered")
                    passed = self.depth_test(triangle, float(e[1][j, i]), float(e[2][j, i]), (rows[j], columns[i], s))
                    self.count("om_samples_passed" if passed else "om_samples_failed")
                    any_passed |= passed
                    all_passed += passed
            if any_passed:
                self.count("ps_invocations")
                shaded.append((rows[j], columns[i]))
        blocks = {(y // 2, x // 2) for y, x in shaded}
        self.count("ps_helper_invocations", 4 * len(blocks) - len(shaded))
        return all_passed

    def depth_test(self, triangle: Triangle, e1: float, e2: float, place: tuple[int, int, int]) -> bool:
        """Depth of the triangle at a sample with edge values e1, e2 (of vertices 1 and 2); LESS, and write."""
        vertices = triangle.shape.vertices
        z0, z1, z2 = (float(v.z) for v in vertices)
        area = float(twice_area(*vertices))
        z = f32(z0 + (e1 * ((z1 - z0) / area) + e2 * ((z2 - z0) / area)))
        z = min(max(z, min(v.z for v in vertices)), max(v.z for v in vertices))
        z = min(max(z, f32(0)), f32(1))
        mine = (triangle.patch, triangle.number)
        earlier = self.strict and z == self.depth[place] and place in self.seen and mine < self.seen[place]
        if not (z < self.depth[place] or earlier):
            return False
        self.depth[place], self.seen[place] = z, mine
        return True

    def walk(self) -> list[int]:
        """Tiles in the order of the walk."""
        tiles = range(self.tiles_x * self.tiles_y)
        if self.machine.tile_walk == "scanline":
            return list(tiles)
        curve = naive_morton if self.machine.tile_walk == "morton" else naive_hilbert
        side = 1
        while side < max(self.tiles_x, self.tiles_y):
            side *= 2
        places = {place: n for n, place in enumerate(curve(side))}
        return sorted(tiles, key=lambda t: places[t % self.tiles_x, t // self.tiles_x])

    def is_full_before(self, owner: int, tiles: list[int], shared: list) -> bool:
        """Append an item to the queues' memory; whether the tiles had to work off first what was queued before it."""
        flushes = self.memory.flushes
        places = [(t % self.tiles_x, t // self.tiles_x) for t in tiles]
        self.memory.append(self.memory.appended, owner, places, shared)
        return self.memory.flushes > flushes

    def count_memory(self) -> None:
        self.memory.finish()
        width, height = self.viewport.width, self.viewport.height
        memory = self.memory.counters(self.machine.tile, width, height, self.scene.picture.samples)
        for name, value in memory.items():
            self.count(name, value)

    def run_triangle_binning(self, alive: list[Unit]) -> None:
        """Front end: every patch once. Back end: each tile rasterizes its triangles."""
        queues: list[list[Triangle]] = [[] for _ in range(self.tiles_x * self.tiles_y)]
        kept, vertices = [], set()
        for unit in alive:
            before = self.counters["ds_invocations"]
            clip = self.domain_shader(unit.data, unit.uv, unit.indices)
            if self.machine.vertex_cache:
                self.counters["ds_invocations"] = before
                fifo: list[int] = []
                for i in unit.indices:
                    if i not in fifo:
                        self.count("ds_invocations")
                        fifo = [*fifo, i][-self.machine.vertex_cache :]
            for triangle in self.primitives(unit, clip):
                kept.append(triangle)
                vertices.update(triangle.vertices)
                touched = [tile for tile in range(len(queues)) if self.reaches(tile, triangle)]
                if self.is_full_before(triangle.patch, touched, triangle.vertices):
                    self.work_off_triangles(queues)
                for tile in touched:
                    self.count("bin_triangle_tile_pairs")
                    self.longest[tile] += 1
                    queues[tile].append(triangle)
        self.work_off_triangles(queues)
        self.counters["queue_longest"] = max(self.longest)
        self.count_memory()
        # Layout of tiler/queues.py: an entry 4 bytes, a triangle 12, a vertex 28.
        self.counters["queue_bytes"] = 4 * sum(self.longest) + 12 * len(kept) + 28 * len(vertices)

    def work_off_triangles(self, queues: list[list[Triangle]]) -> None:
        """Every tile, in the order of the walk; the queues are empty then."""
        for tile in self.walk():
            self.tile = tile
            for triangle in queues[self.tile]:
                self.count("queue_entries")
                written: set = set()
                self.draw(triangle, written)
                self.recompute(written)
            queues[tile].clear()
        self.tile = None

    def recompute(self, written: set) -> None:
        for block in written:
            self.count("cz_updates")
            self.coarse.read(block, self.depth)

    def run_unit_binning(self, alive: list[Unit], history: "NaiveFrame | None") -> None:
        """Front end: units to the tiles that their bounds touch. Back end: each tile does all the rest by itself."""
        if self.machine.queue_order == "front_to_back":
            alive = sorted(alive, key=lambda unit: unit.bound.z_min[0])
        self.caches: dict[int, OrderedDict] = {}  # of each core
        self.clip_of: dict[int, np.ndarray] = {}
        self.queued: set[int] = set()
        if not self.machine.phased:
            self.run_phase(alive)
        else:
            everywhere, tests = max(self.viewport.width, self.viewport.height) * 2, self.machine.occlusion
            seen = set() if history is None else set(np.unique(history.patch).tolist())
            if self.machine.z_feedback == "previous_frame" and "occlusion" in tests:
                if history is not None:
                    self.coarse.read_all(history.depth)
                now = [unit for unit in alive if not self.test_unit(unit, everywhere)]
            else:
                now = [unit for unit in alive if unit.patch in seen]
            self.tests = ()
            self.run_phase(now)
            self.memory.drain()
            self.coarse.read_all(self.depth)
            self.tests, self.tile, rest = tests, None, []
            for unit in alive:
                if any(unit is drawn for drawn in now):
                    continue
                if "occlusion" in tests and self.test_unit(unit, everywhere):
                    self.count("cz_units_occluded")
                    continue
                if "occlusion" in tests and self.machine.z_feedback == "previous_frame":
                    self.count("cz_stale_rejects")
                rest.append(unit)
            self.run_phase(rest)
        self.counters["queue_longest"] = max(self.longest)
        self.count_memory()
        # Layout of tiler/queues.py: an entry 4 bytes, the factors of a patch that is queued anywhere 24, a sub-domain 8.
        entries, parts = self.counters["queue_entries"], self.counters["bin_subpatches"]
        self.counters["bin_patches"] = len(self.queued)
        self.counters["queue_bytes"] = 4 * entries + 24 * len(self.queued) + 8 * parts

    def test_unit(self, unit: Unit, largest: int) -> bool:
        """Test a unit whole; one that touches no pixel is not hidden, whatever stands there."""
        self.count("cz_units_tested")
        x0, y0, x1, y1 = unit.rect
        return x0 <= x1 and y0 <= y1 and self.unit_hidden(unit, unit.rect, unit.bound.z_min[0], largest)

    def run_phase(self, units: list[Unit]) -> None:
        queues: list[list[Unit]] = [[] for _ in range(self.tiles_x * self.tiles_y)]
        name = "bin_subpatch" if self.machine.binning == "subpatch" else "bin_patch"
        self.tile = None
        for unit in units:
            touched = self.unit_tiles(unit)
            if touched:
                self.queued.add(unit.patch)
            if not touched:
                self.count(f"{name}es_offscreen")
            elif self.machine.binning == "subpatch":
                self.count("bin_subpatches")
            shared = [unit.patch] if self.machine.binning == "subpatch" else []
            if self.is_full_before(unit.patch, touched, shared):
                self.work_off_units(queues)
            for tile in touched:
                self.count(f"{name}_tile_pairs")
                queues[tile].append(unit)
                self.longest[tile] += 1
        self.work_off_units(queues)

    def work_off_units(self, queues: list[list[Unit]]) -> None:
        """Every tile, in the order of the walk; the queues are empty then."""
        for place, tile in enumerate(self.walk()):
            self.tile = tile
            for unit in queues[self.tile]:
                self.count("queue_entries")
                if "occlusion" in self.tests:
                    self.count("cz_pairs_tested")
                    if self.unit_hidden(unit, self.clipped(unit.rect), self.nearest(unit), self.machine.tile):
                        self.count("cz_pairs_occluded")
                        continue
                written: set = set()
                for triangle in self.primitives(unit, self.shade(unit, place)):
                    if self.reaches(self.tile, triangle):
                        self.draw(triangle, written)
                    else:
                        self.count("su_culled_outside_tile")
                self.recompute(written)
            queues[tile].clear()
        self.tile = None

    def shade(self, unit: Unit, place: int) -> np.ndarray:
        """Clip positions of the unit's domain points, through the domain cache of the core that has the tile."""
        kind = self.machine.domain_cache
        if kind == "none":
            return self.domain_shader(unit.data, unit.uv, unit.indices)
        core = 0 if kind == "frame" else place % self.machine.cores
        cache = self.caches.setdefault(core, OrderedDict())
        self.count("dc_lookups")
        if unit.number in cache:
            self.count("dc_hits")
            cache.move_to_end(unit.number)
        else:
            cache[unit.number] = self.domain_shader(unit.data, unit.uv, unit.indices)
            if kind != "frame" and len(cache) > int(kind.removeprefix("lru:")):
                cache.popitem(last=False)
        return cache[unit.number]


def naive_morton(side: int) -> list[tuple[int, int]]:
    """Places (x, y) of Morton's curve: four curves of half the side, in the order of reading."""
    if side == 1:
        return [(0, 0)]
    half = side // 2
    return [(x + dx, y + dy) for dy in (0, half) for dx in (0, half) for x, y in naive_morton(half)]


def naive_hilbert(side: int) -> list[tuple[int, int]]:
    """Places (x, y) of Hilbert's curve from the top left to the top right, by its four halves, the outer ones turned."""
    if side == 1:
        return [(0, 0)]
    half = side // 2
    part = naive_hilbert(half)
    first = [(y, x) for x, y in part]
    last = [(side - 1 - y, half - 1 - x) for x, y in part]
    return [*first, *((x, y + half) for x, y in part), *((x + half, y + half) for x, y in part), *last]


def simulate_naively(scene: Scene, machine: Machine, frame: float = 0) -> NaiveFrame:
    """What `tiler.simulate` answers, the slow way, up to the shading of what is seen."""
    picture = scene.picture
    history = None
    if machine.phased and frame >= 1:
        history = simulate_naively(scene, machine.model_copy(update={"cull": machine.hull_cull}), frame - 1)
    m = NaiveMachine(scene, machine, camera_at(scene.camera, frame, picture.width / picture.height), frame)
    alive = m.hull_shader()
    if machine.binning == "triangle":
        m.run_triangle_binning(alive)
    else:
        m.run_unit_binning(alive, history)
    patch = np.full(m.depth.shape, -1)
    for place, (number, _) in m.seen.items():
        m.count("om_samples_visible")
        patch[place] = number
    shape = (m.tiles_y, m.tiles_x)
    walk = m.walk()
    cores = {
        n: [sum(v[t] for t in walk[core :: machine.cores]) for core in range(machine.cores)] for n, v in m.tiles.items()
    }
    tiles = {n: np.array(v).reshape(shape) for n, v in m.tiles.items()}
    return NaiveFrame(m.depth, patch, m.counters, tiles, cores)
