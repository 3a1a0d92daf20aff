"""The tables of docs/backface.md: how much the back-patch tests cull, and how often a culled patch had a front face.

Run as `python -m tiler.cull_tables bigguy_bezier_3570.npz` with the model (array `P`, float32[n, 4, 4, 3], du x dv outward)
that stands in Loop et al. 2011, and names of `TABLES` behind it for some of them only. Minutes; the same on every machine.
A view looks at the middle of the box of the control points from a sphere about it, eyes uniform on the sphere.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from pipeline.displacement import pack_maps
from pipeline.hull import fixed_factors, make_input
from pipeline.types import B1, F32, F64, FaceCull, HullInput, Partitioning, Patches, Viewport
from pipeline.vertex import make_patches
from tiler import front_end
from tiler.errors import TilerError
from tiler.host import Host
from tiler.scene import load_scene
from tiler.scene.camera import Camera, camera_at
from tiler.scene.model import CameraKey, CameraPath, Scene
from tiler.verify import front_triangles

RADII = 1.2  # of the sphere of eyes, in bounding radii
SMOOTH = ("tcone", "ncone", "tangent_plane", "normal_box")
SAFE, DISPLACED = "tessellation_safe", "displaced"


def views(patches: Patches, count: int, seed: int) -> Iterator[tuple[Camera, F64]]:
    """Cameras of wide pictures, and their eyes."""
    points = (patches.control_points[..., :3] / patches.control_points[..., 3:]).reshape(-1, 3).astype(np.float64)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    far = RADII * np.linalg.norm(points - middle, axis=1).max()
    rng = np.random.default_rng(seed)
    for way in rng.normal(size=(count, 3)):
        eye = middle + far * way / np.linalg.norm(way)
        key = CameraKey(0.0, tuple(eye.tolist()), tuple(middle.tolist()))
        path = CameraPath((key,), fov=60.0, near=1e-3 * far, far=100 * far)
        yield camera_at(path, 0, 1280 / 720), eye


def stage_of(
    patches: Patches, view: tuple[Camera, F64], factor: float, size: tuple[int, int], partitioning: Partitioning,
    maps: front_end.PackedMaps | None = None,
) -> HullInput:  # fmt: skip
    """What the tests look at: one factor for all edges, back faces dropped."""
    return make_input(
        patches, maps.maps if maps else pack_maps([]), view[0].clip_from_world, Viewport(0, 0, *size, 0.0, 1.0),
        pyramids=maps.pyramids if maps else None, slopes=maps.slopes if maps else None, eye=view[1],
        factors=fixed_factors(len(patches.map_id), (factor,) * 6), face_cull=FaceCull.BACK, partitioning=partitioning,
    )  # fmt: skip


def culled(stage: HullInput, name: str) -> B1:
    """Which patches a back-patch test drops."""
    flags = np.zeros(len(stage.patches.map_id), np.uint8)
    CULL_TESTS[f"backface:{name}"](stage, BOUNDS["cbox"](stage), flags)
    return flags != 0


def table(head: list[str], rows: list[list[str]]) -> str:
    """As the pages have it."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [head, ["---"] * len(head), *rows])


# A model without displacement


HD = (1280, 720)


def rates_table(patches: Patches, host: Host) -> str:
    """Percent culled, 300 views."""
    rates = dict.fromkeys(SMOOTH, 0.0)
    for view in views(patches, 300, 0):
        stage = stage_of(patches, view, 8.0, HD, Partitioning.INTEGER)
        for name in SMOOTH:
            rates[name] += 100 * float(culled(stage, name).mean()) / 300
    return table(["test", "here"], [[f"`{name}`", f"{rate:.1f}"] for name, rate in rates.items()])


KINDS = (Partitioning.INTEGER, Partitioning.FRACTIONAL_ODD, Partitioning.FRACTIONAL_EVEN, Partitioning.ANY)


def safe_table(patches: Patches, host: Host) -> str:
    """Percent culled by `tessellation_safe`; 20 views, 8 from factor 16 on."""
    factors = (1, 2, 4, 8, 16, 32, 64)
    rows = [["`tangent_plane`"], *([f"`{kind.name.lower()}`"] for kind in KINDS)]
    for factor in factors:
        some = list(views(patches, 20 if factor < 16 else 8, 1))
        rates = np.zeros(1 + len(KINDS))
        for view in some:
            rates[0] += culled(stage_of(patches, view, factor, HD, Partitioning.INTEGER), "tangent_plane").mean()
            for k, kind in enumerate(KINDS):
                rates[1 + k] += culled(stage_of(patches, view, factor, HD, kind), SAFE).mean()
        for row, rate in zip(rows, 100 * rates / len(some), strict=True):
            row.append(f"{rate:.1f}")
    return table(["factor", *map(str, factors)], rows)


def false_table(patches: Patches, host: Host) -> str:
    """Culled patches with a front-facing triangle in any partitioning; 12 views, 5 at factors 8 and 16."""
    names = (*SMOOTH, SAFE)
    rows = []
    for factor in (1, 2, 4, 8, 16):
        counts = np.zeros((len(names), 2), int)
        for view in views(patches, 12 if factor < 8 else 5, 2):
            stage = stage_of(patches, view, factor, HD, Partitioning.ANY)
            dropped = np.array([culled(stage, name) for name in names])
            rows_of = np.flatnonzero(dropped.any(axis=0)).astype(np.int32)
            front = np.zeros(len(patches.map_id), bool)
            front[rows_of] = front_triangles(stage, rows_of, host) > 0
            counts += np.stack([(dropped & front).sum(axis=1), dropped.sum(axis=1)], 1)
        rows.append([str(factor), *(f"{wrong} of {n}" for wrong, n in counts)])
    return table(["factor", *(f"`{name}`" for name in names)], rows)


# Displaced scenes


CASES = (
    ("waves", 4, 1.0), ("waves", 4, 0.2), ("waves", 4, 0.05), ("waves", 16, 1.0), ("waves", 16, 0.2), ("waves", 16, 0.05),
    ("spikelog", 4, 1.0), ("spikelog", 4, 0.05), ("spikelog", 16, 0.05),
)  # fmt: skip


def displaced_row(scene: Scene, factor: float, height: float, host: Host) -> list[str]:
    """Patches dropped in 6 views at `height` times the scene's displacement, and those of them with a front face."""
    scene = replace(
        scene, maps=tuple(replace(m, scale=m.scale * height, bias=m.bias * height) for m in scene.maps)
    )  # fmt: skip
    maps, patches = front_end.scene_maps(scene, 0), front_end.run_vertex_shader(scene, 0)
    plain = patches._replace(map_id=np.full(len(patches.map_id), -1, np.int32))
    moved = patches.map_id >= 0
    counts = np.zeros(7, int)
    for view in views(patches, 6, 3):
        stage = stage_of(patches, view, factor, (640, 360), Partitioning.INTEGER, maps)
        front = front_triangles(stage, np.arange(len(moved), dtype=np.int32), host) > 0
        base = stage_of(plain, view, factor, (640, 360), Partitioning.INTEGER)
        sets = [culled(base, "tangent_plane"), culled(stage, DISPLACED), culled(stage, SAFE)]
        counts += [(moved & ~front).sum(), *(n for s in sets for n in ((moved & s).sum(), (moved & s & front).sum()))]
    told = [f"{n} ({wrong})" for n, wrong in counts[1:].reshape(3, 2)]
    return [f"{scene.name} ({moved.sum()}), {factor:g}", f"{height:g}", str(counts[0]), *told]


def displaced_table(patches: Patches, host: Host) -> str:
    """Dropped (of them wrong), summed over the views; the model is not looked at."""
    rows = [displaced_row(load_scene(name), factor, height, host) for name, factor, height in CASES]
    return table(
        ["scene, factor", "height", "ideal", "base surface's `tangent_plane` (wrong on)", "`displaced`", f"`{SAFE}`"],
        rows,
    )


TABLES: dict[str, Callable[[Patches, Host], str]] = {
    "rates": rates_table,
    "safe": safe_table,
    "false": false_table,
    "displaced": displaced_table,
}


def read_model(path: Path) -> Patches:
    """Bicubic patches of an .npz file. Raises TilerError where there are none."""
    try:
        points: F32 = np.load(path)["P"].astype(np.float32)
    except (OSError, ValueError, KeyError) as error:
        raise TilerError(f"model: {path} is not allowed ({error}); allowed: an .npz file with an array P") from None
    if points.ndim != 4 or points.shape[1:] != (4, 4, 3):
        raise TilerError(f"model: P of shape {points.shape} is not allowed; allowed: (patches, 4, 4, 3)")
    n = len(points)
    cp = np.concatenate([points, np.ones((n, 4, 4, 1), np.float32)], axis=-1)
    return make_patches(cp, np.zeros((n, 4, 2), np.float32), np.full(n, -1, np.int32), np.zeros(n, np.int32))


def main(arguments: list[str]) -> None:
    """Print the tables of these names, or all."""
    if not arguments:
        raise TilerError("model: missing; allowed: the path of an .npz file with an array P")
    patches, names = read_model(Path(arguments[0])), arguments[1:] or list(TABLES)
    for name in names:
        if name not in TABLES:
            raise TilerError(f"table: {name!r} is not allowed; allowed: {', '.join(TABLES)}")
    with Host(1) as host:
        for name in names:
            print(f"{name}\n\n{TABLES[name](patches, host)}\n", flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except TilerError as error:
        sys.exit(f"error: {error}")
