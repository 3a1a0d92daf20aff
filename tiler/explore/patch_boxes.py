"""Bounds of patches drawn in 3D: the twelve edges of their oriented boxes, as lines on the picture."""

from typing import NamedTuple

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.types import F64, I32, HullInput, PatchBounds, TessFactors, Viewport
from tiler import front_end
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene

EDGES = tuple(
    (k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1
)  # bit a of a corner: axis a
REACH = 4.0  # lines end so many half pictures from the middle; a screen draws no longer ones well


class Box(NamedTuple):
    """One box. part : of a sub-domain its number among those of the patch, else -1."""

    patch: int
    part: int
    bound: str
    own: bool  # of the machine's own bound
    lines: F64  # (n, 4) x0 y0 x1 y1 in pictures: 0..1 from the left and the top
    rect: tuple[int, int, int, int]  # pixels x0 y0 x1 y1, ends exclusive
    z_min: float


def box_lines(corners: F64) -> F64:
    """The edges of a box that are before the near plane, float64[n, 4]: x0 y0 x1 y1, 0..1 from the left and the top.

    corners : float64[8, 4], clip space. An edge that leaves the view far is cut; one that is not finite is left out.
    """
    lines = []
    for a, b in EDGES:
        cut = _clip(corners[a], corners[b])
        if cut is not None:
            lines.append([place for x, y, _, w in cut for place in (0.5 * (1.0 + x / w), 0.5 * (1.0 - y / w))])
    return np.array(lines, np.float64).reshape(-1, 4)


def _clip(a: F64, b: F64) -> tuple[F64, F64] | None:
    """The part of an edge with w > 0, z >= 0 and x, y within REACH w; None if nothing is left."""
    planes = np.array(
        [(0, 0, 0, 1), (0, 0, 1, 0), (1, 0, 0, REACH), (-1, 0, 0, REACH), (0, 1, 0, REACH), (0, -1, 0, REACH)]
    )
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return None
    begin, end = 0.0, 1.0
    for at_a, at_b in zip(planes @ a, planes @ b, strict=True):
        if at_a < 0 and at_b < 0:
            return None
        if at_a < 0:
            begin = max(begin, at_a / (at_a - at_b))
        elif at_b < 0:
            end = min(end, at_a / (at_a - at_b))
    first, last = a + begin * (b - a), a + end * (b - a)
    return (first, last) if begin <= end and first[3] > 0 and last[3] > 0 else None


def hull_stage(scene: Scene, number: float) -> HullInput:
    """What the frame's hull stage looks at, all patches."""
    viewport = Viewport(0, 0, scene.picture.width, scene.picture.height, 0.0, 1.0)
    camera = camera_at(scene.camera, number, viewport.width / viewport.height)
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    packed = front_end.scene_maps(scene, number)
    return front_end.raise_silhouettes(
        scene, front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    )  # fmt: skip


def pick_patches(stage: HullInput, numbers: I32) -> HullInput:
    """The stage with these patches alone."""
    factors = TessFactors(*(a[numbers] for a in stage.factors))
    return stage._replace(patches=stage.patches.take(numbers), domain=stage.domain[numbers], factors=factors)


def whole_boxes(scene: Scene, number: float, patches: list[int], own: str, bounds: list[str]) -> list[Box]:
    """Boxes of whole patches by several bounds. own : name of the machine's."""
    stage = pick_patches(hull_stage(scene, number), np.array(patches, np.int32))
    boxes = []
    for name in bounds:
        made = BOUNDS[name](stage)
        boxes += [_box(patch, -1, name, name == own, made, k) for k, patch in enumerate(patches)]
    return boxes


def part_boxes(patches: list[int], own: str, owner: I32, bounds: PatchBounds) -> list[Box]:
    """Boxes of the sub-domains that a machine cut the patches into. owner, bounds : of the frame's units."""
    boxes = []
    for patch in patches:
        units = np.flatnonzero(owner == patch)
        if len(units) > 1:
            boxes += [_box(patch, part, own, True, bounds, int(unit)) for part, unit in enumerate(units)]
    return boxes


def _box(patch: int, part: int, name: str, own: bool, bounds: PatchBounds, row: int) -> Box:
    x0, y0, x1, y1 = bounds.rect[row].tolist()
    return Box(patch, part, name, own, box_lines(bounds.corners[row]), (x0, y0, x1, y1), float(bounds.z_min[row]))
