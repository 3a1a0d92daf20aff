"""Patches as the domain shader leaves them, and the oriented boxes that bound them, as a binary glTF file for any 3D viewer.

World space and its axes are kept as they are. A node for each patch, and one for each box: `patch 7`, `tpatch 7`.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.types import F32, F64, I32, U8
from tiler import front_end
from tiler.config import Machine
from tiler.errors import TilerError, unknown_name
from tiler.files import check_target, write_bytes
from tiler.heatmaps import live_patches
from tiler.host import Host, available_threads
from tiler.scene.model import Scene
from tiler.simulation import check_request

if TYPE_CHECKING:
    import trimesh

MOST_PATCHES = 4096
# Corner k of a box is center + SIGNS[k] @ axes.
SIGNS: F64 = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
BOX_FACES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
     (1, 5, 7), (1, 7, 3)]
)  # fmt: skip
BOX_OPACITY = 0.2
# One colour a bound, apart for colour-blind readers too (Okabe and Ito's palette).
BOX_COLORS = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)


class Exported(NamedTuple):
    """What a file holds. left_out : patches asked for without a finite surface, or that the tessellator culls."""

    patches: int
    vertices: int
    triangles: int
    boxes: int
    left_out: tuple[int, ...]


def export_glb(
    scene: Scene,
    file: str | Path,
    *,
    bounds: Sequence[str] = (),
    patches: Iterable[int] | None = None,
    frame: float = 0,
    threads: int | None = None,
) -> Exported:
    """Write the tessellated, displaced patches of a frame, a colour each, and their boxes, to a .glb file.

    bounds : names of `pipeline.bounds.BOUNDS`; a translucent box for each of them and each patch. patches : numbers, all by
    default, at most 4096. Nothing is culled but what has no finite surface. Raises TilerError.
    """
    file = Path(file)
    check_export(file, bounds)
    threads = available_threads() if threads is None else threads
    check_request(scene, Machine(), threads, frame)
    wanted = _wanted(scene, patches)
    alive = live_patches(scene, Machine(cull=()), frame)
    live = np.intersect1d(alive.live, wanted).astype(np.int32)
    camera = alive.camera._replace(clip_from_world=np.eye(4, dtype=np.float32))  # what comes out is world space
    with Host(threads) as host:
        points = front_end.shade_domain_points(live, alive.patches, alive.patterns, alive.maps, camera, host)
    import trimesh

    world = trimesh.Scene()
    shown, vertices, triangles = [], 0, 0
    for k, p in enumerate(live.tolist()):
        place = points.clip[:3, points.first[k] : points.first[k + 1]].T
        if not np.isfinite(place).all():
            continue
        pattern = int(alive.patterns.of_patch[p])
        first, last = alive.patterns.first_triangle[pattern : pattern + 2]
        faces = alive.patterns.indices[3 * first : 3 * last].reshape(-1, 3)[:, ::-1]  # glTF's front faces turn left
        _add(world, _surface(trimesh, place, faces, patch_color(p)), f"patch {p}")
        shown.append(p)
        vertices, triangles = vertices + len(place), triangles + len(faces)
    boxes = 0
    for number, name in enumerate(bounds):
        found = live_patches(scene, Machine(cull=(), bounds=name), frame).bounds
        color = BOX_COLORS[number % len(BOX_COLORS)]
        for p in shown:
            corners = found.center[p] + SIGNS @ found.axes[p]
            if np.isfinite(corners.astype(np.float32)).all():
                _add(world, _box(trimesh, corners, color), f"{name} {p}")
                boxes += 1
    if not shown:
        raise TilerError("patches: none of those asked for has a finite surface to show; allowed: at least one")
    write_bytes(file, world.export(file_type="glb"))
    return Exported(len(shown), vertices, triangles, boxes, tuple(np.setdiff1d(wanted, shown).tolist()))


def check_export(file: Path, bounds: Sequence[str]) -> None:
    """Raise TilerError where nothing can be exported so, before anything is shaded."""
    if file.suffix.lower() != ".glb":
        raise TilerError(f"out: {str(file)!r} is not allowed; allowed: a file that ends in .glb")
    check_target(file, "out")
    for name in bounds:
        if name not in BOUNDS:
            raise TilerError(f"bounds: {name!r} is not allowed; {unknown_name(name, BOUNDS)}")
    if len(set(bounds)) != len(bounds):
        raise TilerError(f"bounds: {', '.join(bounds)} names one twice; allowed: each at most once")


def patch_color(patch: int) -> U8:
    """A colour for a patch, RGBA; neighbours in number differ: hues go round by the golden section."""
    hue = (patch * 0.6180339887498949) % 1.0 * 6.0
    rgb = [min(max(abs((hue + shift) % 6.0 - 3.0) - 1.0, 0.0), 1.0) for shift in (0.0, 4.0, 2.0)]
    return np.array([*(int(90 + 150 * c) for c in rgb), 255], np.uint8)


def _wanted(scene: Scene, patches: Iterable[int] | None) -> I32:
    n = scene.num_patches
    numbers = np.unique(np.fromiter(patches, np.int64)) if patches is not None else np.arange(n)
    if len(numbers) and not 0 <= numbers[0] <= numbers[-1] < n:
        wrong = int(numbers[0] if numbers[0] < 0 else numbers[-1])
        raise TilerError(f"patches: {wrong} is not allowed; allowed: 0 to {n - 1}")
    if not 1 <= len(numbers) <= MOST_PATCHES:
        raise TilerError(
            f"patches: {len(numbers):,} are asked for; allowed: 1 to {MOST_PATCHES:,} of the scene's {n:,}, such as 0..31"
        )
    return numbers.astype(np.int32)


def _surface(trimesh: Any, place: F32, faces: Any, color: U8) -> "trimesh.Trimesh":
    colors = np.broadcast_to(color, (len(place), 4))
    return trimesh.Trimesh(place, faces, vertex_colors=colors, process=False)


def _box(trimesh: Any, corners: F64, color: tuple[int, int, int]) -> "trimesh.Trimesh":
    made = trimesh.Trimesh(corners, BOX_FACES, process=False)
    opacity = round(255 * BOX_OPACITY)
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[*color, opacity], alphaMode="BLEND", doubleSided=True, metallicFactor=0.0, roughnessFactor=1.0
    )
    made.visual = trimesh.visual.TextureVisuals(material=material)
    return made


def _add(world: "trimesh.Scene", mesh: "trimesh.Trimesh", name: str) -> None:
    world.add_geometry(mesh, node_name=name, geom_name=name)
