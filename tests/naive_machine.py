"""Slow twin of the whole machine: it executes everything that it counts, one event at a time, tile by tile.

Where the production machine shades a patch once and *adds up* what tiles would do, this one tessellates, shades, clips
and sets up every patch again in every tile that has it queued, tests every sample of the tile, and counts by `+= 1`.
Taken from production, for one patch at a time: the tessellator, the domain shader's arithmetic, bounds and cull tests,
screen-space factors and the camera, each of which has tests of its own. Primitives are the slow twin of their own tests.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from pipeline import domain, hull
from pipeline.bounds import BOUNDS
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
from tests.naive_primitives import NaiveTriangle, naive_assemble, twice_area
from tests.naive_queue_memory import NaiveQueueMemory
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.front_end import run_vertex_shader
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
COUNTED_BY_TILE = ("queue_entries", "ds_invocations", "su_culled_outside_tile", "rs_triangles", "rs_samples_covered",
                   "om_samples_passed", "ps_invocations", "ps_helper_invocations")  # fmt: skip


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
    shape: NaiveTriangle
    vertices: list[tuple]


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
        self.seen: dict[tuple[int, int, int], int] = {}  # the patch at each sample that has one

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

    def hull_shader(self) -> list[tuple[int, Patches, np.ndarray]]:
        """Patches that live on, in submit order: number, patch, and the pixels of its bound."""
        alive = []
        self.vertex_shader()
        for p in range(self.scene.num_patches):
            self.count("ia_primitives")
            patch = self.patch(p)
            self.count("hs_invocations")
            for _ in range(self.control_points(patch)):
                self.count("hs_control_points")
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
            alive.append((p, patch, bound.rect[0]))
        return alive

    def first_cull(self, stage: HullInput, bound: PatchBounds) -> str:
        for name in self.machine.cull:
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

    def primitives(self, p: int, clip: np.ndarray, indices: np.ndarray) -> Iterator[Triangle]:
        """Clip and set up each triangle of a patch; those that passed."""
        samples = self.scene.picture.samples
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
                yield Triangle(p, shape, names)

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

    def rasterize(self, triangle: Triangle) -> None:
        """Test every sample of the tile against the triangle; LESS, write, count."""
        self.count("rs_triangles")
        a, b, c = triangle.shape.vertices
        edges = [(b, c), (c, a), (a, b)]
        columns, rows = self.tile_pixels(self.tile)
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
        shaded = []
        for j, i in np.argwhere(np.any(inside, axis=0)):
            any_passed = False
            for s, e in enumerate(values):
                if inside[s][j, i]:
                    self.count("rs_samples_covered")
                    passed = self.depth_test(triangle, float(e[1][j, i]), float(e[2][j, i]), (rows[j], columns[i], s))
                    self.count("om_samples_passed" if passed else "om_samples_failed")
                    any_passed |= passed
            if any_passed:
                self.count("ps_invocations")
                shaded.append((rows[j], columns[i]))
        blocks = {(y // 2, x // 2) for y, x in shaded}
        self.count("ps_helper_invocations", 4 * len(blocks) - len(shaded))

    def depth_test(self, triangle: Triangle, e1: float, e2: float, place: tuple[int, int, int]) -> bool:
        """Depth of the triangle at a sample with edge values e1, e2 (of vertices 1 and 2); LESS, and write."""
        vertices = triangle.shape.vertices
        z0, z1, z2 = (float(v.z) for v in vertices)
        z = f32(z0 + (e1 * (z1 - z0) + e2 * (z2 - z0)) / float(twice_area(*vertices)))
        z = min(max(z, min(v.z for v in vertices)), max(v.z for v in vertices))
        z = min(max(z, f32(0)), f32(1))
        if not z < self.depth[place]:
            return False
        self.depth[place], self.seen[place] = z, triangle.patch
        return True

    def run_triangle_binning(self, alive: list) -> None:
        """Front end: every patch once. Back end: each tile rasterizes its triangles."""
        queues: list[list[Triangle]] = [[] for _ in range(self.tiles_x * self.tiles_y)]
        kept, vertices = [], set()
        for p, patch, _ in alive:
            uv, indices = self.tessellate(patch)
            clip = self.domain_shader(patch, uv, indices)
            for triangle in self.primitives(p, clip, indices):
                kept.append(triangle)
                vertices.update(triangle.vertices)
                for tile, queue in enumerate(queues):
                    if self.touches(tile, triangle.shape.box):
                        self.count("bin_triangle_tile_pairs")
                        queue.append(triangle)
        for self.tile, queue in enumerate(queues):
            for triangle in queue:
                self.count("queue_entries")
                self.rasterize(triangle)
        self.counters["queue_longest"] = max(map(len, queues))
        self.count_memory([(t.patch, queued_in(t, queues), t.vertices) for t in kept])
        # Layout of tiler/queues.py: an entry 4 bytes, a triangle 12, a vertex 28.
        self.counters["queue_bytes"] = 4 * sum(map(len, queues)) + 12 * len(kept) + 28 * len(vertices)

    def run_patch_binning(self, alive: list) -> None:
        """Front end: patches to the tiles that their bounds touch. Back end: each tile does all the rest by itself."""
        queues: list[list[tuple[int, Patches]]] = [[] for _ in range(self.tiles_x * self.tiles_y)]
        for p, patch, (x0, y0, x1, y1) in alive:
            touched = [t for t in range(len(queues)) if self.touches(t, (x0, y0, x1 - 1, y1 - 1))]
            self.count("bin_patches" if touched else "bin_patches_offscreen")
            for tile in touched:
                self.count("bin_patch_tile_pairs")
                queues[tile].append((p, patch))
        cache: dict[int, np.ndarray] = {}  # the domain cache `frame`: what was shaded stays
        for self.tile, queue in enumerate(queues):
            for p, patch in queue:
                self.count("queue_entries")
                uv, indices = self.tessellate(patch)
                clip = cache[p] if p in cache else self.domain_shader(patch, uv, indices)
                if self.machine.domain_cache == "frame":
                    cache[p] = clip
                for triangle in self.primitives(p, clip, indices):
                    if self.touches(self.tile, triangle.shape.box):
                        self.rasterize(triangle)
                    else:
                        self.count("su_culled_outside_tile")
        self.counters["queue_longest"] = max(map(len, queues))
        self.count_memory([(p, queued_in((p, patch), queues), []) for p, patch, _ in alive])
        # Layout of tiler/queues.py: an entry 4 bytes, the factors of a patch that is queued anywhere 24.
        self.counters["queue_bytes"] = 4 * sum(map(len, queues)) + 24 * self.counters["bin_patches"]

    def count_memory(self, items: list[tuple[int, list[int], list]]) -> None:
        """Lay the queues out by the machine's queue model. items : patch, tiles and shared records of each, in order."""
        m = self.machine
        memory = NaiveQueueMemory(
            load_queue_model(m.queue_model), m.binning, self.tiles_x, self.tiles_y, pool=m.queue_pool,
            policy=m.queue_policy or "",
        )  # fmt: skip
        for number, (p, tiles, shared) in enumerate(items):
            memory.append(number, p, [(t % self.tiles_x, t // self.tiles_x) for t in tiles], shared)
        memory.finish()
        width, height = self.viewport.width, self.viewport.height
        for name, value in memory.counters(m.tile, width, height, self.scene.picture.samples).items():
            self.count(name, value)


def queued_in(item: object, queues: list[list]) -> list[int]:
    """The tiles whose queue holds this very item."""
    return [tile for tile, queue in enumerate(queues) if any(held is item or held == item for held in queue)]


def simulate_naively(scene: Scene, machine: Machine, frame: float = 0) -> NaiveFrame:
    """What `tiler.simulate` answers, the slow way, up to the shading of what is seen."""
    picture = scene.picture
    m = NaiveMachine(scene, machine, camera_at(scene.camera, frame, picture.width / picture.height), frame)
    alive = m.hull_shader()
    if machine.binning == "triangle":
        m.run_triangle_binning(alive)
    else:
        m.run_patch_binning(alive)
    patch = np.full(m.depth.shape, -1)
    for place, number in m.seen.items():
        m.count("om_samples_visible")
        patch[place] = number
    shape = (m.tiles_y, m.tiles_x)
    cores = {n: [sum(v[core :: machine.cores]) for core in range(machine.cores)] for n, v in m.tiles.items()}
    tiles = {n: np.array(v).reshape(shape) for n, v in m.tiles.items()}
    return NaiveFrame(m.depth, patch, m.counters, tiles, cores)
