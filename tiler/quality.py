"""How tight the bounds are: volume and screen area of their boxes relative to the displaced surface's own box.

Munkberg et al. 2010, section 5.2. The reference of a patch is the box, in the patch's oriented frame, of what the domain
shader gives at 32 x 32 points of its domain, ends included: an inner estimate of the tightest box of that frame. A ratio is
the sum over all patches divided by the sum over their references. Areas are those of the rectangles in normalized device
coordinates around the eight projected corners of a box (the reference's box too), not cut by the screen; patches with a
corner not before the eye, in any box, are left out of them. With `splits` each patch is cut into 2^splits x 2^splits equal
sub-domains, and each has a reference of its own.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pipeline import domain, vertex
from pipeline.bounds import BOUNDS
from pipeline.displacement import pack_maps
from pipeline.hull import make_input
from pipeline.types import (
    F32,
    F64,
    I64,
    Address,
    DomainPoints,
    HullInput,
    PatchBounds,
    Patterns,
    TessFactors,
    Viewport,
)
from tiler import front_end
from tiler.host import Host
from tiler.scene import load_scene
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene

SAMPLES = 32
CHUNK = 2048  # boxes at a time: their shaded points take 56 MiB
VIEWPORT = Viewport(0, 0, 1280, 720, 0.0, 1.0)
RANDOM = "random"  # name of a set of bumpy random patches, half of them rational


class Quality(NamedTuple):
    """One bounding algorithm over all patches of a scene."""

    scene: str
    bound: str
    patches: int  # bounded: patches, or sub-domains
    volume: float  # summed volume of the boxes / that of the references
    area: float  # summed screen area / that of the references
    cones: float  # share of patches whose normals have a known cone
    summed: float  # volume of all boxes together, cubed world units


def split_domains(stage: HullInput, splits: int) -> HullInput:
    """The same patches, each `4**splits` times: once for each equal sub-domain."""
    n, parts = len(stage.patches.control_points), 2**splits
    ends = np.arange(parts + 1) / parts
    cells = [[ends[i], ends[i + 1], ends[j], ends[j + 1]] for i in range(parts) for j in range(parts)]
    repeat = np.repeat(np.arange(n), len(cells))
    f = stage.factors
    patches = stage.patches.take(repeat)
    factors = TessFactors(f.edge[repeat], f.inside[repeat])
    return stage._replace(patches=patches, factors=factors, domain=np.tile(np.array(cells), (n, 1)))


def shaded_grid(stage: HullInput, samples: int = SAMPLES) -> F32:
    """World-space output of the domain shader on a samples x samples grid of each patch's domain: float32[P, samples^2, 3]."""
    cells, of_patch = np.unique(stage.domain, axis=0, return_inverse=True)
    t = np.linspace(0.0, 1.0, samples)
    u, v = (a.ravel() for a in np.meshgrid(t, t, indexing="ij"))
    along_u = cells[:, :1] * (1 - u) + cells[:, 1:2] * u
    along_v = cells[:, 2:3] * (1 - v) + cells[:, 3:] * v
    uv = np.ascontiguousarray(np.stack([along_u.ravel(), along_v.ravel()]), np.float32)
    n, size = len(stage.patches.control_points), samples * samples
    patterns = Patterns(
        of_patch=of_patch.astype(np.int32).ravel(),
        uv=uv,
        first_point=np.arange(len(cells) + 1, dtype=np.int64) * size,
        indices=np.zeros(0, np.uint16),
        first_triangle=np.zeros(len(cells) + 1, np.int64),
    )
    first = np.arange(n + 1, dtype=np.int64) * size
    points = DomainPoints(first, np.empty((4, n * size), np.float32), np.empty((3, n * size), np.float32))
    live, scratch = np.arange(n, dtype=np.int32), np.empty(domain.SCRATCH, np.float32)
    domain.shade_patches(
        0, n, live, stage.patches, patterns, stage.maps, np.eye(4, dtype=np.float32), points, scratch
    )  # fmt: skip
    return np.ascontiguousarray(points.clip[:3].T).reshape(n, size, 3)


def reference_boxes(stage: HullInput, points: F32) -> tuple[F64, F64]:
    """Centre float64[P, 3] and half-extent vectors float64[P, 3, 3] of the points' boxes in the oriented frame."""
    axes = BOUNDS["obbtex"](stage).axes
    length = np.linalg.norm(axes, axis=2, keepdims=True)
    frame = np.where(length > 0, axes / np.where(length > 0, length, 1), np.eye(3))
    along = np.einsum("prc,pnc->prn", frame, points.astype(np.float64))
    lo, hi = along.min(axis=2), along.max(axis=2)
    return np.einsum("pr,prc->pc", (lo + hi) / 2, frame), frame * ((hi - lo) / 2)[..., None]


def box_volumes(axes: F64) -> F64:
    """Volumes of boxes by their half-extent vectors, float64[P, 3, 3]."""
    return 8.0 * np.prod(np.linalg.norm(axes, axis=2), axis=1)


def _areas(center: F64, axes: F64, matrix: F32) -> F64:
    """Area of the rectangle around the projected corners of each box, NaN where one is not before the eye."""
    signs = np.array([[1 if k >> r & 1 else -1 for r in range(3)] for k in range(8)])
    corners = center[:, None] + np.einsum("kr,prc->pkc", signs, axes)
    clip = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], axis=2) @ matrix.T.astype(np.float64)
    w = np.where((clip[..., 3:] > 0).all(axis=1, keepdims=True), clip[..., 3:], np.nan)
    return np.prod(np.ptp(clip[..., :2] / w, axis=1), axis=1)


def measure(
    scene: str, stage: HullInput, names: Sequence[str] | None = None, splits: int = 0, threads: int = 1
) -> list[Quality]:
    """Quality of the named bounds (all without names) over the patches of a stage; `scene` is a name to print.

    threads : of this computer; the result does not depend on it.
    """
    chosen = list(BOUNDS if names is None else names)
    n = len(stage.patches.control_points)
    step = max(1, CHUNK >> 2 * splits)
    chunks: list[dict[str, F64]] = [{}] * -(-n // step)

    def work(c: int) -> None:
        part = rows_of_stage(stage, np.arange(c * step, min((c + 1) * step, n)))
        chunks[c] = _measure_chunk(split_domains(part, splits) if splits else part, chosen)

    with Host(threads) as host:
        host.run(work, len(chunks))
    sums = {name: sum((found[name] for found in chunks), np.zeros(5)) for name in chosen}
    boxes = n << 2 * splits
    with np.errstate(divide="ignore", invalid="ignore"):
        return [
            Quality(
                scene=scene,
                bound=name,
                patches=boxes,
                volume=float(volume / reference),
                area=float(area / reference_area),
                cones=float(cones / boxes),
                summed=float(volume),
            )
            for name, (volume, reference, area, reference_area, cones) in sums.items()
        ]


def _measure_chunk(stage: HullInput, names: Sequence[str]) -> dict[str, F64]:
    """For each bound the sums over the stage: volume, that of the references, area, that of the references, known cones."""
    chosen: dict[str, PatchBounds] = {name: BOUNDS[name](stage) for name in names}
    center, axes = reference_boxes(stage, shaded_grid(stage))
    reference_areas = _areas(center, axes, stage.clip_from_world)
    areas = {name: _areas(b.center, b.axes, stage.clip_from_world) for name, b in chosen.items()}
    shown = np.isfinite(np.stack([reference_areas, *areas.values()])).all(axis=0)
    reference, reference_area = box_volumes(axes).sum(), reference_areas[shown].sum()
    return {
        name: np.array(
            [box_volumes(b.axes).sum(), reference, areas[name][shown].sum(), reference_area, (b.cone_cos > -1).sum()]
        )
        for name, b in chosen.items()
    }


def rows_of_stage(stage: HullInput, rows: I64) -> HullInput:
    """The stage with only these patches."""
    factors = TessFactors(stage.factors.edge[rows], stage.factors.inside[rows])
    return stage._replace(patches=stage.patches.take(rows), factors=factors, domain=stage.domain[rows])


def scene_stage(name: str) -> HullInput:
    """Hull stage's input of a built-in scene's (or scene file's) first frame; of the random patches for `RANDOM`."""
    return random_stage() if name == RANDOM else stage_of(load_scene(name))


def stage_of(scene: Scene, number: float = 0) -> HullInput:
    """Hull stage's input of a scene's frame."""
    viewport = Viewport(0, 0, scene.picture.width, scene.picture.height, 0.0, 1.0)
    camera = camera_at(scene.camera, number, viewport.width / viewport.height)
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    return front_end.hull_input(scene, patches, front_end.scene_maps(scene, number), factors, camera, viewport)


def random_stage(n: int = 500, seed: int = 0) -> HullInput:
    """Bumpy unit sheets turned anywhere, every second one rational, each with a part of a rough map of its own."""
    rng = np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    sheet = np.stack([i, j, 0 * i], axis=-1) / 3 - [0.5, 0.5, 0]
    turns, _ = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    points = (sheet + rng.normal(0, 0.06, (n, 4, 4, 3))) @ turns[:, None]
    weights = np.where(np.arange(n)[:, None, None, None] % 2, rng.uniform(0.7, 1.4, (n, 4, 4, 1)), 1.0)
    cp = np.concatenate([points * weights, weights], axis=-1).astype(np.float32)
    texels = rng.uniform(-0.2, 1.0, (64, 64)).astype(np.float32)
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    texcoords = (rng.uniform(0, 1, (n, 1, 2)) + corners * rng.uniform(0.05, 0.3, (n, 1, 1))).astype(np.float32)
    none = np.zeros(n, np.int32)
    patches = vertex.make_patches(cp, texcoords, none, none)
    matrix = np.array([[2, 0, 0, 0], [0, 3.5, 0, 0], [0, 0, -1.01, 4], [0, 0, -1, 5]], np.float32)
    return make_input(patches, pack_maps([(texels, Address.WRAP, 0.3, 0.0)]), matrix, VIEWPORT)


def quality_table(
    scenes: Sequence[str] = ("waves", "spikelog", "creature", RANDOM),
    names: Sequence[str] | None = None,
    splits: int = 0,
) -> list[Quality]:
    """Quality of each bound on each scene's first frame. names : of `BOUNDS`, all without; splits : see the module."""
    return [row for scene in scenes for row in measure(scene, scene_stage(scene), names, splits)]


def format_table(rows: Sequence[Quality]) -> str:
    """The rows as a table of text."""
    lines = [f"{'scene':<12} {'bound':<17} {'boxes':>7} {'volume':>9} {'area':>9} {'cones':>7}"]
    lines += [
        f"{r.scene:<12} {r.bound:<17} {r.patches:>7} {r.volume:>9.3f} {r.area:>9.3f} {r.cones:>7.1%}" for r in rows
    ]
    return "\n".join(lines)
