"""The numbers of docs/how-it-works.md: one patch of spikelog, followed through the machine; its pictures: walk_pictures.py.

The stages are called one by one, as `tiler.machine.draw_frame` does. All is counted or drawn from what they leave, so it is
the same on every machine; `docs/make_figures.py` writes it, tests/test_docs.py compares.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

import tiler
from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.primitives import Outcome
from pipeline.types import F64, I32, U8, HullInput, PatchBounds, Patterns, Viewport
from tiler import back_end, front_end
from tiler.back_end import Bins, Canvas
from tiler.binning import TileQueues
from tiler.config import Machine
from tiler.front_end import Geometry, PackedMaps
from tiler.grid import Grid, make_grid
from tiler.host import Host
from tiler.order import number_triangles
from tiler.scene.camera import Camera, camera_at
from tiler.scene.model import Scene
from tiler.tally import Tally
from tiler.units import front_to_back, whole_patches

PATCH = 15
MACHINE = Machine(
    bounds="tpatch", overlap="exact", cull=("frustum", "occlusion"), queue_order="front_to_back", occlusion_area="hull"
)
SIZE = (640, 360)


class Walk(NamedTuple):
    """What the stages leave of the frame."""

    scene: Scene
    camera: Camera
    packed: PackedMaps
    stage: HullInput
    boxes: dict[str, PatchBounds]
    patterns: Patterns
    live: I32  # in the order of the queues
    geometry: Geometry
    grid: Grid
    queue: TileQueues
    by_triangle: TileQueues  # what a machine that bins triangles would queue
    outcome: U8  # of each queue entry: 1 where coarse Z hid the patch
    canvas: Canvas  # the finished picture
    before: Canvas  # each tile of the patch as it stands when the patch's turn comes


def load(size: tuple[int, int] = SIZE, **options: object) -> Scene:
    """The scene: factors by the length of edges on the screen, so that the edges of a patch differ."""
    return tiler.load_scene(
        "spikelog", size=size, edge_pixels=4.0 * size[0] / SIZE[0], partitioning="fractional_odd", **options
    )


@cache
def walk() -> Walk:
    """Run the stages."""
    scene, machine, number = load(), MACHINE, 0
    viewport = Viewport(0, 0, *SIZE, 0.0, 1.0)
    camera = camera_at(scene.camera, number, SIZE[0] / SIZE[1])
    packed = front_end.scene_maps(scene, number)
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    flags = hull.flag_nonfinite(patches, stage.pyramids.whole)
    boxes = {name: bound(stage) for name, bound in BOUNDS.items()}
    bounds = boxes[machine.bounds]
    with Host(1) as host:
        for name in machine.hull_cull:
            flags = front_end.cull(name, stage, bounds, flags, host)
    patterns = front_end.tessellate(scene.tessellation, stage.factors, flags)
    flags, live = front_end.live_patches(patterns, flags)
    units = whole_patches(patches, bounds, patterns)
    live = front_to_back(live, bounds)
    with Host(1) as host:
        points = front_end.shade_domain_points(live, patches, patterns, packed.maps, camera, host)
        geometry = front_end.set_up_triangles(live, points, patterns, viewport, scene, host)
        order = number_triangles(live, units.owner, units.original, patterns, geometry.triangles)
        grid = make_grid(*SIZE, machine.tile)
        bins = back_end.bin_batch(live, geometry, bounds, machine, grid, scene.picture.samples, host)

        def draw(queue: TileQueues) -> tuple[Canvas, U8]:
            canvas = back_end.make_canvas(scene.picture, True, machine.coarse_z_block, grid)
            counts = Tally(scene, machine, grid).tiles
            outcome = back_end.run_tiles(
                Bins(queue, bins.triangles), live, geometry, order, bounds, back_end.make_rules(machine), scene, grid,
                canvas.target, canvas.coarse, counts, True, True, host,
            )  # fmt: skip
            return canvas, outcome

        canvas, outcome = draw(bins.queue)
        before, _ = draw(until(bins.queue, int(np.flatnonzero(live == PATCH)[0])))
    return Walk(
        scene,
        camera,
        packed,
        stage,
        boxes,
        patterns,
        live,
        geometry,
        grid,
        bins.queue,
        bins.triangles,
        outcome,
        canvas,
        before,
    )


def until(queue: TileQueues, item: int) -> TileQueues:
    """The queues cut before an item, where they have it."""
    parts = []
    for tile in range(len(queue.first) - 1):
        items = queue.item[queue.first[tile] : queue.first[tile + 1]]
        place = np.flatnonzero(items == item)
        parts.append(items[: place[0]] if len(place) else items)
    first = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
    return queue._replace(first=first, item=np.concatenate(parts))


def place() -> int:
    """Number of the patch in the order of the queues."""
    return int(np.flatnonzero(walk().live == PATCH)[0])


def control_points() -> F64:
    """The patch's control points, [4, 4, 3], world space."""
    return walk().stage.patches.control_points[PATCH, ..., :3].astype(np.float64)


def pattern() -> tuple[F64, I32]:
    """The patch's domain points [n, 2] and the triangles of its pattern [m, 3]."""
    k = walk().patterns
    p = k.of_patch[PATCH]
    uv = k.uv[:, k.first_point[p] : k.first_point[p + 1]].T.astype(np.float64)
    index = k.indices[3 * k.first_triangle[p] : 3 * k.first_triangle[p + 1]].reshape(-1, 3).astype(np.int32)
    return uv, index


def tiles_of() -> dict[int, bool]:
    """The tiles that have the patch in their queue, and whether coarse Z hid it there."""
    k = walk()
    tile = np.repeat(np.arange(k.grid.num_tiles), np.diff(k.queue.first))
    mine = k.queue.item == place()
    return dict(zip(tile[mine].tolist(), k.outcome[mine].astype(bool).tolist(), strict=True))


def tile_box(tile: int) -> F64:
    """x0 y0 x1 y1 of a tile, pixels."""
    grid = walk().grid
    x, y = tile % grid.tiles_x * MACHINE.tile, tile // grid.tiles_x * MACHINE.tile
    return np.array([x, y, min(x + MACHINE.tile, SIZE[0]), min(y + MACHINE.tile, SIZE[1])], np.float64)


def patch_text() -> str:
    """What comes in."""
    k = walk()
    points = control_points().reshape(16, 3)
    size = " x ".join(f"{s:.2f}" for s in points.max(axis=0) - points.min(axis=0))
    texels = f"{k.scene.maps[0].texels.shape[1]} x {k.scene.maps[0].texels.shape[0]} texels"
    (m,) = k.scene.maps
    s, t = (k.stage.patches.texcoords[PATCH, :, c] for c in (0, 1))
    return "\n".join(
        [
            f"- One of {len(k.live)} patches that live, number {PATCH}; {place()} of them begin nearer to the eye.",
            f"- 16 control points in a box of {size} world units.",
            f"- Its part of the map: s from {s.min():g} to {s.max():g}, t from {t.min():g} to {t.max():g}, of {texels}.",
            f"- A texel of 1 moves the surface by {m.scale:g} along its normal.",
        ]
    )


def bound_text() -> str:
    """What each bound says of the patch."""
    k = walk()
    lines = [
        "| bound | volume | on the screen | nearest depth | tiles, `rect` |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, bounds in k.boxes.items():
        volume = 8 * float(np.prod(np.sqrt((bounds.axes[PATCH] ** 2).sum(axis=1))))
        x0, y0, x1, y1 = bounds.rect[PATCH].tolist()
        side = MACHINE.tile
        tiles = (-(-x1 // side) - x0 // side) * (-(-y1 // side) - y0 // side)
        lines.append(
            f"| `{name}` | {volume:.2f} | {x1 - x0} x {y1 - y0} pixels | {bounds.z_min[PATCH]:.4f} | {tiles} |"
        )
    return "\n".join(lines)


def tessellation_text() -> str:
    """What the tessellator, the domain shader and the primitive stage do with it."""
    k = walk()
    factors = ", ".join(f"{f:.2f}" for f in k.stage.factors.edge[PATCH])
    inside = ", ".join(f"{f:.2f}" for f in k.stage.factors.inside[PATCH])
    uv, index = pattern()
    c = {o.name: int(k.geometry.outcomes[place(), o]) for o in Outcome}
    return "\n".join(
        [
            f"- Factors: edges u=0, v=0, u=1, v=1 {factors}; inside {inside}.",
            f"- {len(uv)} domain points, {len(index)} triangles.",
            f"- Of these {c['FACE']} show their back, {c['ZERO_AREA']} have no area, {c['NO_SAMPLE']} cover no sample; "
            f"{c['SETUP']} are set up.",
        ]
    )


def tiles_text() -> str:
    """What is queued for it."""
    k = walk()
    x0, y0, x1, y1 = k.boxes[MACHINE.bounds].rect[PATCH].tolist()
    t, p = k.geometry.triangles, place()
    mine = (k.by_triangle.item >= t.first[p]) & (k.by_triangle.item < t.first[p] + t.used[p])
    length = int(np.diff(k.queue.first)[list(tiles_of())].max())
    return "\n".join(
        [
            f"- The rectangle: pixels {x0} to {x1 - 1} across, {y0} to {y1 - 1} down.",
            f"- Queued in {len(tiles_of())} tiles; a machine that bins its {int(t.used[p])} triangles, shaded, writes "
            f"{int(mine.sum())} entries for it.",
            f"- The longest of these queues has {length} patches.",
        ]
    )


def _shows(tile: int) -> bool:
    """Whether a pixel of the tile shows the patch in the end."""
    k = walk()
    x0, y0, x1, y1 = tile_box(tile).astype(int)
    shown = k.canvas.target.visible[y0:y1, x0:x1, 0]
    return bool((k.geometry.triangles.patch[shown[shown >= 0]] == PATCH).any())


def coarse_z_text() -> str:
    """What becomes of it in its tiles."""
    k, (uv, _) = walk(), pattern()
    fates = list(tiles_of().values())
    shown = k.canvas.target.visible[..., 0]
    pixels = int((k.geometry.triangles.patch[shown[shown >= 0]] == PATCH).sum())
    useful = len({t for t in tiles_of() if _shows(t)})
    drawn = len(fates) - sum(fates)
    return "\n".join(
        [
            f"- Hidden in {sum(fates)} tiles, shaded in {drawn}: {drawn} x {len(uv)} = {drawn * len(uv):,} domain-shader "
            f"invocations. With a domain cache for the frame it would be {len(uv)}.",
            f"- It is seen in {useful} of these tiles, in {pixels} pixels.",
        ]
    )


TEXTS: dict[str, Callable[[], str]] = {
    "walk patch": patch_text,
    "walk bound": bound_text,
    "walk tessellation": tessellation_text,
    "walk tiles": tiles_text,
    "walk coarse z": coarse_z_text,
}
