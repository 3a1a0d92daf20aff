"""Frames drawn region by region: the fast way, for machines whose tiles draw in submit order and test nothing.

The picture is cut into rectangles of whole tiles, so that threads share no pixel, and each is given the patches whose bounds
touch it, in submit order. A patch at a border is shaded in both of its regions, which is executed more, and counted once.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline import pixel, primitives
from pipeline.primitives import NUM_OUTCOMES
from pipeline.types import B1, F64, I32, I64, DisplacementMaps, FaceCull, Patches, Patterns, Viewport
from tiler.back_end import NO_ORDER, unit_vector
from tiler.config import Machine
from tiler.front_end import split_batches
from tiler.grid import Grid
from tiler.host import Host
from tiler.rasterizer import MARGIN, SAMPLE_X, SAMPLE_Y
from tiler.region_kernel import Ended, Room, draw_region, make_room
from tiler.scene.camera import Camera
from tiler.scene.model import Scene
from tiler.tile import Target, clear_samples

BATCH_POINTS = 1 << 22  # domain points between two reports of progress
REGIONS = 1  # for each of several threads: more would even out, and have more patches on borders, shaded twice
# What a region takes, about, in domain points: a fit to scenes of ten kinds and sizes, where a point with its triangles and
# fragments took 29 ns, a pixel of a patch's rectangle 0.7, and a pixel of the picture 5.
RECT_PIXEL, PIXEL = 1 / 40, 0.18
CLEARED_FIRST = 0.25  # part of the picture that the calling thread clears, of what is cleared beside
CROWDED = 1.2  # regions of a patch, on average, from which it pays to bound patches more tightly

Rect = tuple[int, int, int, int]

# Rooms that no thread is in, with their sizes: fresh memory for each region of each frame would cost more than clearing the
# picture. A list's `append` and `pop` are whole for any thread.
_rooms: list[tuple[tuple[int, int, int, int], Room]] = []


class Drawn(NamedTuple):
    """What a frame's patches did."""

    outcomes: I64  # (live, NUM_OUTCOMES)
    num_used: I64  # (live,) vertices of set-up triangles
    counts: I64  # (tiles, NUM_TILE_COUNTS)
    most: I64  # (tiles, 3) as `queue_lists.rank_owners` finds them
    seen: I64  # (1,) samples of the picture that hold a triangle


def draws_in_regions(machine: Machine) -> bool:
    """Whether the machine's tiles draw what they draw in submit order, whatever they hold."""
    return (
        machine.binning == "triangle" and not machine.reordered and not machine.occlusion and machine.overlap == "rect"
    )


def begin_to_clear(target: Target, background: tuple[int, int, int], host: Host) -> Callable[[], None]:
    """Clear depths and colours beside what follows; call what is returned to wait for the end.

    Which triangles are seen need not be cleared: each group of patches does that where it draws. The calling thread does a
    part itself. So it has no need of the interpreter while another thread wakes up and takes it; waiting for that, it would
    be woken on the other's processor, and stay there.
    """
    depth, color = target.depth.ravel(), target.color.view(np.uint32).ravel()
    value = np.array([*background, 255], np.uint8).view(np.uint32)[0]
    mine = int(len(depth) * CLEARED_FIRST)
    wait = host.beside(lambda: clear_samples(depth[mine:], color[mine:], value))
    clear_samples(depth[:mine], color[:mine], value)
    return wait


def cut_regions(rect: I32, weight: F64, grid: Grid, most: int, tile_weight: float = 0.0) -> list[Rect]:
    """Cut the picture into at most so many rectangles of whole tiles, of like weight; pixels x0, y0, x1, y1, inclusive.

    rect : int32[n, 4], pixels of patches, ends exclusive. weight : float64[n], what each takes; tile_weight : what a tile does.
    """
    side = 1 << grid.tile_log2

    def cut(tiles: Rect, x: np.ndarray, y: np.ndarray, w: np.ndarray, parts: int) -> list[Rect]:
        x0, y0, x1, y1 = tiles
        along_x = x1 - x0 >= y1 - y0
        if parts < 2 or (x1 - x0 if along_x else y1 - y0) < 2:
            return [tiles]
        lo, hi, middle = (x0, x1, x) if along_x else (y0, y1, y)
        across = y1 - y0 if along_x else x1 - x0
        sums = np.cumsum(np.bincount(np.clip(middle - lo, 0, hi - lo - 1), w, hi - lo) + across * tile_weight)
        at = lo + 1 + int(np.abs(sums[:-1] - sums[-1] / 2).argmin())
        near = middle < at
        first, second = ((x0, y0, at, y1), (at, y0, x1, y1)) if along_x else ((x0, y0, x1, at), (x0, at, x1, y1))
        return [
            *cut(first, x[near], y[near], w[near], parts // 2),
            *cut(second, x[~near], y[~near], w[~near], parts // 2),
        ]

    centre = (rect[:, :2].astype(np.int64) + rect[:, 2:]) // (2 * side)
    pieces = cut((0, 0, grid.tiles_x, grid.tiles_y), centre[:, 0], centre[:, 1], weight, most)
    return [
        (side * x0, side * y0, min(side * x1, grid.width) - 1, min(side * y1, grid.height) - 1)
        for x0, y0, x1, y1 in pieces
    ]


def _num_pixels(rect: I32) -> I64:
    """Pixels of rectangles x0, y0, x1, y1, ends exclusive."""
    size = np.maximum(rect[:, 2:].astype(np.int64) - rect[:, :2], 0)
    return size[:, 0] * size[:, 1]


def draw_frame_in_regions(
    scene: Scene, live: I32, rect: I32, tighter: Callable[[], I32] | None, patches: Patches, patterns: Patterns,
    maps: DisplacementMaps, camera: Camera, viewport: Viewport, grid: Grid, target: Target,
    cleared: Callable[[], None], counts: I64, host: Host, progress: Callable[[float], None],
) -> Drawn | None:  # fmt: skip
    """Draw the live patches on `target`; None where that can't be done so, and all is to be drawn anew.

    cleared() : returns when `target` is clear (`begin_to_clear`).
    rect : int32[P, 4], pixels that hold each patch, ends exclusive; tighter() : the same by a better bound, if there is one. It
    is asked for where many patches would be shaded in several regions. counts : int64[tiles, NUM_TILE_COUNTS], 0 at
    first, becomes the result's; 0 again where there is none.
    """
    drawn = Drawn(
        np.zeros((len(live), NUM_OUTCOMES), np.int64),
        np.zeros(len(live), np.int64),
        counts,
        np.zeros((grid.num_tiles, 3), np.int64),
        np.zeros(1, np.int64),
    )
    drawn.most[:, 2] = -1
    sizes = np.diff(patterns.first_point)
    batches = split_batches(live, patterns, BATCH_POINTS)
    done = 0
    for b, batch in enumerate(batches):
        regions = _regions_of(batch, rect, sizes, patterns, grid, host)
        if b == 0 and tighter and _num_pairs(rect[batch], regions) > CROWDED * len(batch):
            rect = intersect(rect, tighter())
            regions = _regions_of(batch, rect, sizes, patterns, grid, host)
        cleared()
        part = Drawn(drawn.outcomes[done : done + len(batch)], drawn.num_used[done : done + len(batch)], *drawn[2:])
        ended = _draw_batch(
            scene, batch, rect[batch], regions, patches, patterns, maps, camera, viewport, grid, target,
            b == len(batches) - 1, max(map(len, batches)), part, host,
        )  # fmt: skip
        if not ended:
            counts[:] = 0
            return None
        done += len(batch)
        progress((b + 1) / len(batches))
    return drawn


def _regions_of(batch: I32, rect: I32, sizes: I64, patterns: Patterns, grid: Grid, host: Host) -> list[Rect]:
    weight = sizes[patterns.of_patch[batch]] + RECT_PIXEL * _num_pixels(rect[batch])
    most = 1 if host.threads == 1 else REGIONS * host.threads
    return cut_regions(rect[batch], weight, grid, most, PIXEL * (1 << 2 * grid.tile_log2))


def _touching(rect: I32, region: Rect) -> B1:
    """bool[n], which rectangles, none of them empty, reach into a region."""
    x0, y0, x1, y1 = region
    return (rect[:, 0] <= x1) & (rect[:, 2] > x0) & (rect[:, 1] <= y1) & (rect[:, 3] > y0)


def _num_pairs(rect: I32, regions: list[Rect]) -> int:
    """Pairs of regions and rectangles that reach into them."""
    return sum(int(_touching(rect, region).sum()) for region in regions) if len(regions) > 1 else 0


def intersect(a: I32, b: I32) -> I32:
    """int32[n, 4], what rectangles have in common, row by row; ends exclusive, and not before their begins."""
    begins = np.maximum(a[:, :2], b[:, :2])
    return np.concatenate([begins, np.maximum(np.minimum(a[:, 2:], b[:, 2:]), begins)], axis=1)


def _take_room(sizes: tuple[int, int, int, int]) -> Room:
    """A room of these sizes (`region_kernel.make_room`): an empty one or a new one. Those of other sizes are forgotten."""
    while _rooms:
        try:
            found, room = _rooms.pop()
        except IndexError:  # another thread took it
            break
        if found == sizes:
            return room
    return make_room(*sizes)


def _draw_batch(
    scene: Scene, batch: I32, rect: I32, regions: list[Rect], patches: Patches, patterns: Patterns, maps: DisplacementMaps,
    camera: Camera, viewport: Viewport, grid: Grid, target: Target, last: bool, most_patches: int,
    drawn: Drawn, host: Host,
) -> bool:  # fmt: skip
    """Draw a batch in all regions; whether that went well."""
    picture = scene.picture
    samples = picture.samples
    guard = primitives.guard_band(viewport)
    bounds = (viewport.left, viewport.top, viewport.left + viewport.width - 1, viewport.top + viewport.height - 1)
    pattern = (SAMPLE_X[samples], SAMPLE_Y[samples], MARGIN[samples])
    depth_range = (np.float32(0.0), np.float32(1.0))
    shading, light = int(pixel.Shade[picture.shading.upper()]), unit_vector(scene.light)
    face_cull = int(FaceCull[scene.face_cull.upper()])
    sizes = (
        most_patches,
        int(np.diff(patterns.first_point).max(initial=0)),
        int(np.diff(patterns.first_triangle).max(initial=0)),
        grid.num_tiles,
    )
    ended, seen = np.zeros(len(regions), np.int64), np.zeros(len(regions), np.int64)

    def work(r: int) -> None:
        room = _take_room(sizes)
        ended[r] = draw_region(
            batch, rect, regions[r], r == 0, patches, patterns, maps, camera.clip_from_world, viewport, guard, bounds,
            pattern[2], face_cull, grid, pattern, depth_range, shading, light, last, NO_ORDER, room, target, drawn.outcomes,
            drawn.num_used, drawn.counts, drawn.most, seen[r : r + 1],
        )  # fmt: skip
        if ended[r] == int(Ended.DRAWN):
            _rooms.append((sizes, room))

    host.run(work, len(regions))
    drawn.seen[0] = seen.sum()
    return bool((ended == int(Ended.DRAWN)).all())
