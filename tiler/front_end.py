"""The front end: launches the pipeline's stages over the patches of a scene, chunk by chunk on the host's threads."""

from typing import NamedTuple

import numpy as np

from pipeline import animate, domain, hull, primitives, vertex
from pipeline.culling import PER_PATCH, tangent_plane
from pipeline.culling.backface import Facing
from pipeline.displacement import pack_maps, vector_lengths
from pipeline.inside import make_lanes
from pipeline.jit import kernel
from pipeline.minmax import build_pyramids
from pipeline.primitives import NUM_OUTCOMES
from pipeline.silhouette import raise_factors, shared_edges
from pipeline.slopes import build_slopes
from pipeline.tessellator import make_patterns
from pipeline.types import (
    I32,
    I64,
    U8,
    Address,
    DisplacementMaps,
    DomainPoints,
    FaceCull,
    HullInput,
    Partitioning,
    PatchBounds,
    Patches,
    Patterns,
    Pyramids,
    Slopes,
    TessFactors,
    Triangles,
    Viewport,
    Window,
)
from tiler.host import Host
from tiler.lent import lend
from tiler.rasterizer import MARGIN
from tiler.scene.camera import Camera
from tiler.scene.model import DisplacementMap, Scene, Tessellation
from tiler.shared import Stages

BATCH_POINTS = 1 << 18  # domain points in flight: a batch of about 40 MB, whose memory the next one gets again
WINDING = "triangle_ccw"  # with u x v pointing to the viewer this is clockwise on the screen: a front face
CULL_CHUNK = 2048  # least patches of a chunk: what surrounds the kernels of a cull test takes as long as 200 patches
FAN_TRIANGLES = primitives.MAX_CORNERS - 2


class Geometry(NamedTuple):
    """Set-up triangles of a batch with their vertices, and what became of the others."""

    points: DomainPoints  # `normal` also has the normals of the clipper's vertices
    window: Window
    triangles: Triangles
    outcomes: I64  # (live, NUM_OUTCOMES)
    num_used: I64  # (live,) vertices of a unit that its set-up triangles use
    drawn: Triangles  # `triangles`, perhaps without the rows of units that have none


class PackedMaps(NamedTuple):
    """A scene's displacement maps as kernels read them, and the maps themselves, so that they are not forgotten."""

    source: tuple[DisplacementMap, ...]
    maps: DisplacementMaps
    pyramids: Pyramids
    slopes: Slopes


KEPT_MAPS = 4  # sets of maps that are kept packed from one frame to the next
_packed: dict[tuple[int, ...], PackedMaps] = {}


def scene_maps(scene: Scene, number: float) -> PackedMaps:
    """The scene's displacement maps at frame `number`, packed, with pyramids.

    Made once for a scene's frames: its arrays never change. But vectors in an object's axes turn with the object.
    """
    key = tuple(map(id, scene.maps))  # no other object can get these while `source` holds the maps
    packed = _packed.get(key)
    if packed is None:
        maps = pack_maps([(m.texels, Address[m.address.upper()], m.scale, m.bias) for m in scene.maps])
        packed = PackedMaps(scene.maps, maps, build_pyramids(maps), build_slopes(maps))
        while len(_packed) >= KEPT_MAPS:
            _packed.pop(next(iter(_packed)), None)
        _packed[key] = packed
    return _turned(packed, scene, number) if any(m.space == "object" for m in scene.maps) else packed


def _turned(packed: PackedMaps, scene: Scene, number: float) -> PackedMaps:
    """The maps with their vectors' axes at a frame: those of the object that has the map, which is one."""
    turn = packed.maps.turn.copy()
    object_of = dict(zip(scene.map_id.tolist(), scene.object_id.tolist(), strict=True))
    object_of |= {mesh.map_id: mesh.object_id for mesh in scene.meshes}
    for m, image in enumerate(scene.maps):
        if image.space == "object" and image.texels.ndim == 3 and m in object_of:
            k = object_of[m]
            motion = scene.motions[k] if scene.motions else None
            turn[m] = animate.transform_at(scene.transforms[k], motion, number)[:, :3]
    maps = packed.maps._replace(turn=turn)
    return packed._replace(
        maps=maps, pyramids=packed.pyramids._replace(whole=vector_lengths(maps, packed.pyramids.whole))
    )


def run_vertex_shader(scene: Scene, number: float) -> Patches:
    """World-space patches of the scene at frame `number`: vertex shader and the hull shader's control-point phase."""
    motions = scene.motions or (None,) * len(scene.transforms)
    transforms = np.stack(
        [animate.transform_at(m, motion, number) for m, motion in zip(scene.transforms, motions, strict=True)]
    )
    parts = []
    if len(scene.control_points) or not scene.meshes:
        world = vertex.transform_control_points(scene.control_points, scene.object_id, transforms)
        parts.append(vertex.make_patches(world, scene.texcoords, scene.map_id, scene.object_id))
    for mesh in scene.meshes:
        posed = animate.pose(mesh.vertices, motions[mesh.object_id], number)
        world = vertex.transform_vertices(posed, transforms[mesh.object_id])
        close_seams = mesh.seams == "lower_face"
        parts.append(hull.surface_patches(mesh.surface, world, mesh.map_id, mesh.object_id, close_seams))
    patches = hull.join_patches(parts)
    if scene.meshes and (np.diff(patches.object_id) < 0).any():
        patches = patches.take(np.argsort(patches.object_id, kind="stable"))
    return patches


def tess_factors(policy: Tessellation, patches: Patches, camera: Camera, viewport: Viewport) -> TessFactors:
    """Factors by the scene's policy."""
    if policy.edge_pixels is None:
        return hull.fixed_factors(len(patches.control_points), policy.factor)
    return hull.screen_factors(
        patches.control_points, camera.clip_from_world, viewport, camera.near, policy.edge_pixels, policy.max_factor
    )


def hull_input(
    scene: Scene, patches: Patches, packed: PackedMaps, factors: TessFactors, camera: Camera, viewport: Viewport
) -> HullInput:
    """What the hull stage's bounds and cull tests may look at."""
    return hull.make_input(
        patches,
        packed.maps,
        camera.clip_from_world,
        viewport,
        pyramids=packed.pyramids,
        slopes=packed.slopes,
        eye=camera.eye,
        factors=factors,
        face_cull=FaceCull[scene.face_cull.upper()],
        partitioning=Partitioning[scene.tessellation.partitioning.upper()],
    )


def raise_silhouettes(scene: Scene, stage: HullInput) -> HullInput:
    """The stage with finer factors where a patch may show its outline, by the scene's policy.

    The class of a patch is that of its base surface, by the parametric tangent plane; of a displaced one nothing is known.
    """
    policy = scene.tessellation
    if policy.silhouette == 1.0:
        return stage
    everyone = np.arange(len(stage.patches.control_points))
    marked = (tangent_plane.classify_patches(stage, everyone) == Facing.SILHOUETTE).astype(np.uint8)
    edge = shared_edges(stage.patches.control_points)
    factors = raise_factors(stage.factors, edge, marked, policy.silhouette, policy.max_factor)
    return stage._replace(factors=factors)


def cull(name: str, stage: HullInput, bounds: PatchBounds, flags: U8, host: Host) -> U8:
    """The flags after cull test `name` of the patches still alive."""
    after = flags.copy()
    if name not in PER_PATCH:
        hull.run_cull_tests((name,), stage, bounds, after)
        return after
    chunks = host.chunks(len(flags), CULL_CHUNK) if host.threads > 1 else [(0, len(flags))]

    def work(c: int) -> None:
        begin, end = chunks[c]
        part = PatchBounds._make(array[begin:end] for array in bounds)
        hull.run_cull_tests((name,), hull.part_of(stage, begin, end), part, after[begin:end])

    host.run(work, len(chunks))
    return after


def tessellate(policy: Tessellation, factors: TessFactors, flags: U8) -> Patterns:
    """Tessellator: patterns of the patches that no flag drops."""
    kept = factors._replace(edge=factors.edge.copy())
    hull.drop_culled(kept, flags)
    return make_patterns(kept, policy.partitioning, WINDING)


def live_patches(patterns: Patterns, flags: U8) -> tuple[U8, I32]:
    """The flags with those that the tessellator culled by a factor, and the numbers of the patches alive."""
    flags = flags.copy()
    hull.flag_factors(patterns.of_patch, flags)
    return flags, hull.live_patches(flags)


def split_batches(live: I32, patterns: Patterns, most_points: int = 0) -> list[I32]:
    """Cut the live patches into runs of at most BATCH_POINTS domain points, or `most_points` where that is more.

    At least one run, of no patch if need be.
    """
    most = max(BATCH_POINTS, most_points)
    sizes = np.diff(patterns.first_point)[patterns.of_patch[live]]
    run = np.concatenate([[0], np.cumsum(sizes)[:-1]]) // most if len(live) else np.zeros(0, np.int64)
    cuts = np.flatnonzero(np.diff(run)) + 1
    return np.split(live, cuts) if len(cuts) else [live]


def patches_at_once(patterns: Patterns, most_points: int) -> I32 | None:
    """All patches that have a pattern, if they have at most so many domain points."""
    everyone = np.flatnonzero(patterns.of_patch >= 0).astype(np.int32)
    points = int(np.diff(patterns.first_point)[patterns.of_patch[everyone]].sum())
    return everyone if points <= most_points else None


def shade_domain_points(
    live: I32, patches: Patches, patterns: Patterns, maps: DisplacementMaps, camera: Camera, host: Host
) -> DomainPoints:
    """Domain shader: every domain point of the live patches, once."""
    first = np.zeros(len(live) + 1, np.int64)
    np.cumsum(np.diff(patterns.first_point)[patterns.of_patch[live]], out=first[1:])
    points = DomainPoints(first, lend((4, int(first[-1])), np.float32), lend((3, int(first[-1])), np.float32))
    chunks = host.chunks(len(live))

    def work(c: int) -> None:
        scratch = np.empty(domain.SCRATCH, np.float32)
        domain.shade_patches(*chunks[c], live, patches, patterns, maps, camera.clip_from_world, points, scratch)

    host.run(work, len(chunks))
    return points


def set_up_triangles(
    live: I32, points: DomainPoints, patterns: Patterns, viewport: Viewport, scene: Scene, host: Host
) -> Geometry:
    """Primitives: viewport, clip, snap, face cull and set-up of every triangle of the live patches, once."""
    guard = primitives.guard_band(viewport)
    num_points = int(points.first[-1])
    window = allocate_window(num_points)
    chunks = host.chunks(num_points)
    host.run(lambda c: primitives.project_points(*chunks[c], points.clip, viewport, guard, window), len(chunks))

    # Vertices and triangles that the clipper may add, counted before anything is allocated for them.
    chunks = host.chunks(len(live))
    cuts = np.zeros(len(live), np.int64)
    host.run(lambda c: primitives.count_cuts(*chunks[c], live, patterns, points.first, window.code, cuts), len(chunks))
    first_spare = num_points + np.concatenate([[0], np.cumsum(cuts * primitives.MAX_CORNERS)])
    if spare := int(first_spare[-1]) - num_points:
        points = points._replace(normal=np.concatenate([points.normal, np.zeros((3, spare), np.float32)], axis=1))
        window = Window(*(np.concatenate([a, np.zeros(spare, a.dtype)]) for a in window))
    room = np.diff(patterns.first_triangle)[patterns.of_patch[live]] + cuts * (FAN_TRIANGLES - 1)
    triangles = _allocate_triangles(room)
    outcomes, num_used = np.zeros((len(live), NUM_OUTCOMES), np.int64), np.empty(len(live), np.int64)
    used = np.zeros(len(window.x), np.uint8)
    most_points = int(np.diff(patterns.first_point).max(initial=0))

    bounds = (
        viewport.left,
        viewport.top,
        viewport.left + viewport.width - 1,
        viewport.top + viewport.height - 1,
    )
    margin, face_cull = MARGIN[scene.picture.samples], int(FaceCull[scene.face_cull.upper()])

    def work(c: int) -> None:
        scratch = np.empty((2 * primitives.MAX_CORNERS, primitives.POLYGON))
        primitives.assemble(
            *chunks[c], live, patterns, points, first_spare, viewport, guard, bounds, margin, face_cull, window, triangles,
            outcomes, used, num_used, scratch, make_lanes(most_points),
        )  # fmt: skip

    host.run(work, len(chunks))
    return Geometry(points, window, triangles, outcomes, num_used, triangles)


@kernel
def _pick(rows, source, first, target):
    for k in range(len(rows)):
        for i in range(source.used[rows[k]]):
            t, s = first[k] + i, source.first[rows[k]] + i
            for c in range(3):
                target.vertex[t, c] = source.vertex[s, c]
            for c in range(4):
                target.box[t, c] = source.box[s, c]
            target.cover[t], target.edges[t] = source.cover[s], source.edges[s]
            target.patch[t], target.source[t] = source.patch[s], source.source[s]


def pick_triangles(triangles: Triangles, rows: I64) -> Triangles:
    """The triangles of these rows, in this order, without gaps."""
    used = triangles.used[rows]
    picked = _allocate_triangles(used.astype(np.int64))
    _pick(rows, triangles, picked.first, picked)
    return picked._replace(used=used)


def pick_units(geometry: Geometry, live: I32, wanted: I32, shared: Stages) -> Geometry:
    """The geometry of some units of a batch. live : numbers of the batch's units, rising; wanted : those to pick, in order.

    The triangles are the same arrays for all who pick the same triangles, whichever units without any they pick besides.
    """
    rows = np.searchsorted(live, wanted)
    used = geometry.triangles.used[rows]
    drawn = shared.run(pick_triangles, geometry.triangles, shared.same(rows[used > 0]))
    first = np.zeros(len(rows) + 1, np.int64)
    np.cumsum(used, out=first[1:])
    return Geometry(
        geometry.points, geometry.window, drawn._replace(first=first, used=used), geometry.outcomes[rows],
        geometry.num_used[rows], drawn,
    )  # fmt: skip


def allocate_window(n: int) -> Window:
    """Room for n vertices."""
    return Window(
        lend((n,), np.int32),
        lend((n,), np.int32),
        lend((n,), np.float32),
        lend((n,), np.float32),
        lend((n,), np.uint8),
    )


def _allocate_triangles(room: I64) -> Triangles:
    first = np.zeros(len(room) + 1, np.int64)
    np.cumsum(room, out=first[1:])
    n = int(first[-1])
    return Triangles(
        first=first,
        used=np.zeros(len(room), np.int32),
        vertex=lend((n, 3), np.int32),
        box=lend((n, 4), np.int16),
        cover=lend((n,), np.uint16),
        edges=lend((n,), np.uint8),
        patch=lend((n,), np.int32),
        source=lend((n,), np.int32),
    )
