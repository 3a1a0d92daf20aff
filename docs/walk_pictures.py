"""The pictures of docs/how-it-works.md, drawn over what the stages leave (docs/walkthrough.py)."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from PIL import Image, ImageDraw

import tiler
from docs.walkthrough import MACHINE, PATCH, SIZE, control_points, load, pattern, place, tile_box, tiles_of, walk
from pipeline.types import F64, I32
from tiler.config import Machine

LARGE = 4  # times the frame's size: what panels are cut from
NEAR, FAR, WIDE = 5.0, 2.4, 1.75  # a panel shows each pixel as so many: of the patch, of its tiles, of its bounds
PANEL = (480, 320)

PALE, WARM, COOL, GREEN, RED = (238, 236, 230), (255, 176, 59), (92, 180, 255), (120, 220, 150), (255, 99, 92)


# Drawing. A panel shows a part of the frame; it is drawn at twice its size and halved at the end.


def corner_of(zoom: float) -> tuple[float, float]:
    """Where in the frame a panel's upper left corner lies: the patch is in the middle near by, its bounds from afar."""
    if zoom == NEAR:
        at = np.concatenate([domain_points(), on_screen(control_points()).reshape(-1, 2)])
        x, y = (at.min(axis=0) + at.max(axis=0)) / 2
    else:
        x0, y0, x1, y1 = walk().boxes["cbox" if zoom == WIDE else MACHINE.bounds].rect[PATCH].tolist()
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return float(round(x - PANEL[0] / zoom / 2)), float(round(y - PANEL[1] / zoom / 2))


def dimmed(image: Image.Image, part: float) -> Image.Image:
    """The picture towards the background's colour."""
    return Image.blend(Image.new("RGB", image.size, (24, 22, 21)), image, part)


def crop(image: Image.Image, zoom: float) -> Image.Image:
    """A part of a picture of the frame, at twice the panel's size. image : of any multiple of the frame's size."""
    scale = image.width // SIZE[0]
    x, y = corner_of(zoom)
    size = 2 * PANEL[0], 2 * PANEL[1]
    box = (x * scale, y * scale, (x + PANEL[0] / zoom) * scale, (y + PANEL[1] / zoom) * scale)
    return image.transform(size, Image.Transform.EXTENT, box, Image.Resampling.NEAREST)


@cache
def large(only: bool = False, smooth: bool = False) -> tuple[Image.Image, F64]:
    """The frame, or the patch alone, or alone and not displaced, at `LARGE` times the size, with its depth."""
    scene = load((SIZE[0] * LARGE, SIZE[1] * LARGE))
    if smooth:
        scene = replace(scene, map_id=np.full_like(scene.map_id, -1))
    if only:
        arrays = ("control_points", "texcoords", "map_id", "object_id")
        scene = replace(scene, **{name: getattr(scene, name)[PATCH : PATCH + 1] for name in arrays})
        scene = replace(scene, face_cull="none")
    frame = tiler.simulate(scene, Machine())
    return frame.image().convert("RGB"), frame.depth


def tinted(image: Image.Image, color: tuple[int, int, int]) -> Image.Image:
    """A grey picture in a colour."""
    light = np.asarray(image.convert("L"), np.float64)[..., None] / 225.0
    return Image.fromarray((np.minimum(light, 1.0) * color + 0.5).astype(np.uint8))


def with_patch(part: float, seen_only: bool, smooth: bool = False) -> Image.Image:
    """The dimmed frame at `LARGE` times its size with the patch in colour: where it is seen, or all of it."""
    frame, depth = large()
    alone, own = large(True, smooth)
    mask = own < 1.0
    if seen_only:
        mask &= own <= depth
    return Image.composite(tinted(alone, WARM), dimmed(frame, part), Image.fromarray(mask))


def on_screen(world: F64) -> F64:
    """Points of world space, float64[..., 3], in pixels of the frame, [..., 2]."""
    homogeneous = np.concatenate([world, np.ones((*world.shape[:-1], 1))], axis=-1)
    clip = homogeneous @ walk().camera.clip_from_world.astype(np.float64).T
    ndc = clip[..., :2] / clip[..., 3:]
    return (ndc * (0.5, -0.5) + 0.5) * SIZE


class Pen:
    """Draws on a panel in pixels of the frame."""

    def __init__(self, image: Image.Image, corner: tuple[float, float], scale: float) -> None:
        """corner : what is at the panel's upper left. scale : pixels of the image for one of the frame."""
        self.image, self.corner, self.scale = image, np.array(corner, np.float64), scale
        self.draw = ImageDraw.Draw(image, "RGBA")

    def at(self, points: F64) -> list[tuple[float, float]]:
        """Places on the panel."""
        return [tuple(p) for p in ((np.asarray(points, np.float64) - self.corner) * self.scale).tolist()]

    def line(self, points: F64, color: tuple[int, ...], width: int = 3) -> None:
        """A line through points [n, 2]."""
        self.draw.line(self.at(points), fill=color, width=width, joint="curve")

    def dot(self, point: F64, color: tuple[int, ...], radius: float = 6) -> None:
        """A disc."""
        ((x, y),) = self.at(np.asarray(point)[None])
        self.draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color, outline=(20, 18, 18))

    def area(self, points: F64, color: tuple[int, ...]) -> None:
        """A filled polygon."""
        self.draw.polygon(self.at(points), fill=color)

    def rect(self, box: F64, color: tuple[int, ...], width: int = 3) -> None:
        """The outline of x0 y0 x1 y1."""
        x0, y0, x1, y1 = box
        self.line(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]), color, width)

    def done(self) -> Image.Image:
        """The panel."""
        return self.image.resize((self.image.width // 2, self.image.height // 2), Image.Resampling.BOX)


def side_by_side(*panels: Image.Image) -> Image.Image:
    """Panels in a row, with a gap."""
    gap, height = 8, panels[0].height
    whole = Image.new("RGB", (sum(p.width + gap for p in panels) - gap, height), (96, 94, 92))
    x = 0
    for panel in panels:
        whole.paste(panel, (x, 0))
        x += panel.width + gap
    return whole


def part_of(image: Image.Image, zoom: float) -> Pen:
    """A panel with a part of a picture of the frame."""
    return Pen(crop(image, zoom), corner_of(zoom), 2 * zoom)


def patch_picture() -> Image.Image:
    """Where the patch is seen, and its control points with the smooth patch that they make."""
    left = Pen(with_patch(0.75, True).resize((1138, 640), Image.Resampling.BOX).crop((89, 0, 1049, 640)), (0, 0), 1)
    right = part_of(with_patch(0.28, False, smooth=True), NEAR)
    net = on_screen(control_points())
    for k in range(4):
        right.line(net[k], (*COOL, 255))
        right.line(net[:, k], (*COOL, 255))
    for point in net.reshape(16, 2):
        right.dot(point, PALE)
    return side_by_side(left.done(), right.done())


EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]
SIGNS = np.array([[1 if k >> axis & 1 else -1 for axis in range(3)] for k in range(8)])


def bound_picture() -> Image.Image:
    """Two bounds of the displaced patch, and the rectangles that they give."""
    panels = []
    for name, color in (("cbox", RED), (MACHINE.bounds, GREEN)):
        bounds = walk().boxes[name]
        pen = part_of(with_patch(0.28, False), WIDE)
        box = on_screen(bounds.center[PATCH] + SIGNS @ bounds.axes[PATCH])
        for a, b in EDGES:
            pen.line(box[[a, b]], (*color, 255))
        pen.rect(bounds.rect[PATCH].astype(float), (*PALE, 255), 2)
        panels.append(pen.done())
    return side_by_side(*panels)


def domain_points() -> F64:
    """The patch's shaded points on the screen, pixels of the frame, [n, 2]."""
    k = walk()
    p = place()
    first, end = k.geometry.points.first[p : p + 2]
    clip = k.geometry.points.clip[:, first:end].astype(np.float64)
    return ((clip[:2] / clip[3]).T * (0.5, -0.5) + 0.5) * SIZE


def tessellation_picture() -> Image.Image:
    """The pattern in (u, v), and the same triangles displaced, on the screen."""
    uv, index = pattern()
    left = Image.new("RGB", (2 * PANEL[0], 2 * PANEL[1]), (30, 27, 26))
    side = 2 * PANEL[1] - 80
    pen = Pen(left, (-(2 * PANEL[0] - side) / 2 / side, -40 / side), side)
    _triangles(pen, uv, index, lambda a: (*WARM, 46))
    right = part_of(dimmed(large()[0], 0.28), NEAR)
    _triangles(right, domain_points(), index, lambda area: (*WARM, 90) if area > 0 else (*COOL, 60), 4)
    return side_by_side(pen.done(), right.done())


def _triangles(
    pen: Pen, points: F64, index: I32, fill: Callable[[float], tuple[int, ...]], radius: float = 5
) -> None:  # fmt: skip
    for a, b, c in index:
        area = float(np.linalg.det(np.stack([points[b] - points[a], points[c] - points[a]])))
        pen.area(points[[a, b, c]], fill(area))
    for triangle in index:
        pen.line(points[[*triangle, triangle[0]]], (*PALE, 200), 2)
    for point in points:
        pen.dot(point, WARM, radius)


def tiles_picture() -> Image.Image:
    """The tiles that get the patch; and what stands in them when its turn comes, with those crossed out where it is hidden."""
    left = part_of(with_patch(0.4, False), FAR)
    box = walk().boxes[MACHINE.bounds]
    for tile in tiles_of():
        x0, y0, x1, y1 = tile_box(tile)
        left.area(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), (*GREEN, 46))
    _grid(left)
    for tile in tiles_of():
        left.rect(tile_box(tile), (*GREEN, 255))
    edges = on_screen(box.center[PATCH] + SIGNS @ box.axes[PATCH])
    for a, b in EDGES:
        left.line(edges[[a, b]], (*GREEN, 255), 2)
    left.rect(box.rect[PATCH].astype(float), (*PALE, 255), 2)
    right = part_of(Image.fromarray(walk().before.target.resolved[..., :3]), FAR)
    _fates(right)
    return side_by_side(left.done(), right.done())


def _grid(pen: Pen) -> None:
    for x in range(0, SIZE[0] + 1, MACHINE.tile):
        pen.line(np.array([(x, 0), (x, SIZE[1])], float), (*PALE, 70), 2)
    for y in range(0, SIZE[1] + 1, MACHINE.tile):
        pen.line(np.array([(0, y), (SIZE[0], y)], float), (*PALE, 70), 2)


def _fates(pen: Pen) -> None:
    for tile, hidden in tiles_of().items():
        x0, y0, x1, y1 = tile_box(tile)
        if hidden:
            pen.line(np.array([(x0 + 3, y0 + 3), (x1 - 3, y1 - 3)]), (*RED, 200))
            pen.line(np.array([(x0 + 3, y1 - 3), (x1 - 3, y0 + 3)]), (*RED, 200))
    for hidden, color in ((False, GREEN), (True, RED)):
        for tile, is_hidden in tiles_of().items():
            if is_hidden == hidden:
                pen.rect(tile_box(tile) + (0.4, 0.4, -0.4, -0.4), (*color, 255))


def coarse_z_picture() -> Image.Image:
    """The farthest depth of each block when the patch's turn comes; and the finished picture with the patch's pixels."""
    k = walk()
    coarse = k.before.coarse
    far = coarse.farthest[: coarse.width[0] * coarse.height[0]].reshape(coarse.height[0], coarse.width[0])
    standing = far[far < 1.0]
    low, high = float(standing.min()), float(standing.max())
    grey = np.where(far < 1.0, 235 - 175 * (far - low) / (high - low), 12).astype(np.uint8)
    blocks = np.stack([grey] * 3, axis=-1).repeat(8, axis=0).repeat(8, axis=1)[: SIZE[1], : SIZE[0]]
    left = part_of(Image.fromarray(np.ascontiguousarray(blocks)), FAR)
    _fates(left)
    right = part_of(with_patch(0.75, True), FAR)
    return side_by_side(left.done(), right.done())


PICTURES: dict[str, Callable[[], Image.Image]] = {
    "walk-patch": patch_picture,
    "walk-bound": bound_picture,
    "walk-tessellation": tessellation_picture,
    "walk-tiles": tiles_picture,
    "walk-coarse-z": coarse_z_picture,
}
