"""A frame drawn without culls, and everything that its machine said, against it."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS, TRIANGLE_SAFE
from pipeline.tessellator import make_patterns
from pipeline.types import (
    F32,
    I32,
    U8,
    DisplacementMaps,
    HullInput,
    PatchBounds,
    Patterns,
    Viewport,
)
from tiler import back_end, front_end
from tiler.config import Machine
from tiler.front_end import Geometry
from tiler.grid import make_grid
from tiler.host import Host
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene
from tiler.tile import NUM_TILE_COUNTS, Target
from tiler.verify.bounds import measure_margins, name_violations, shade_all, uv_of
from tiler.verify.facing import facing, sort_back_patch_cull
from tiler.verify.report import Report, Violation


def run_each_cull(names: tuple[str, ...], stage: HullInput, bounds: PatchBounds, flags: U8) -> I32:
    """Run the tests in order as the hull stage does (`flags` in place): the test that dropped each patch, -1 for none."""
    culled_by = np.full(len(flags), -1, np.int32)
    for number, name in enumerate(names):
        before = flags.copy()
        CULL_TESTS[name](stage, bounds, flags)
        culled_by[flags != before] = number
    return culled_by


class _Owners(NamedTuple):
    """Who is seen at each sample of the picture that culls nothing."""

    patch: I32  # (H, W, S) patch number, -1 for none
    point: I32  # (H, W, S) a domain point of the visible triangle, within its patch; -1 where none can be named


def _note_owners(owners: _Owners, target: Target, geometry: Geometry, live: I32) -> None:
    seen = target.visible >= 0
    triangle = target.visible[seen]
    patch = geometry.triangles.patch[triangle]
    k = np.searchsorted(live, patch)
    lead = geometry.triangles.vertex[triangle, 0]
    inside = lead < geometry.points.first[k + 1]
    owners.patch[seen] = patch
    owners.point[seen] = np.where(inside, lead - geometry.points.first[k], -1)


def check_frame(
    scene: Scene,
    machine: Machine,
    number: float,
    host: Host,
    picture: tuple[U8, F32],
    progress: Callable[[float], None] = lambda part: None,
) -> Report:
    """Verify one frame: all patches shaded, nothing culled, against the machine's bound, its culls and its picture.

    picture : resolved colours uint8[H, W, 4] and depth float32[H, W, S] that the machine drew.
    """
    width, height = scene.picture.width, scene.picture.height
    camera = camera_at(scene.camera, number, width / height)
    viewport = Viewport(0, 0, width, height, 0.0, 1.0)
    plain = Machine(tile=machine.tile, binning="triangle", cull=())
    grid, target = make_grid(width, height, plain.tile), back_end.make_target(scene.picture)
    packed = front_end.scene_maps(scene, number)
    patches = front_end.run_vertex_shader(scene, number)
    factors = front_end.tess_factors(scene.tessellation, patches, camera, viewport)
    stage = front_end.hull_input(scene, patches, packed, factors, camera, viewport)
    stage = front_end.raise_silhouettes(scene, stage)
    flags = hull.flag_nonfinite(patches, stage.pyramids.whole)
    broken = flags.copy()
    bounds = BOUNDS[machine.bounds](stage)
    culled_by = run_each_cull(machine.hull_cull, stage, bounds, flags)
    hull.drop_culled(stage.factors, broken)
    patterns = make_patterns(stage.factors, scene.tessellation.partitioning, front_end.WINDING)
    live = np.flatnonzero((broken == 0) & (patterns.of_patch >= 0)).astype(np.int32)

    violations: list[Violation] = []
    owners = _Owners(np.full(target.visible.shape, -1, np.int32), np.full(target.visible.shape, -1, np.int32))
    counts = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
    batches = front_end.split_batches(live, patterns)
    for b, batch in enumerate(batches):
        shaded = shade_all(batch, patches, patterns, packed.maps, camera, viewport, host)
        geometry = front_end.set_up_triangles(batch, shaded.clip, patterns, viewport, scene, host)
        margins = measure_margins(bounds, batch, shaded, viewport, host, geometry)
        violations += name_violations(machine.bounds, margins, batch, patterns)
        bins = back_end.bin_batch(batch, geometry, bounds, plain, grid, scene.picture.samples, host)
        back_end.run_tiles(
            bins, batch, geometry, back_end.NO_ORDER, bounds, back_end.make_rules(plain), scene, grid, target,
            back_end.make_coarse_z(plain, grid), counts, b == 0, b == len(batches) - 1, host,
        )  # fmt: skip
        _note_owners(owners, target, geometry, batch)
        progress((b + 1) / len(batches))
    lost, false_culls = _check_culls(machine.hull_cull, culled_by, stage, packed.maps, patterns, owners, host)
    if not lost and not false_culls:
        lost = _compare_pictures(machine, target, picture, patterns, owners)
    return Report(tuple(violations + lost), tuple(false_culls))


def _check_culls(
    names: tuple[str, ...],
    culled_by: I32,
    stage: HullInput,
    maps: DisplacementMaps,
    patterns: Patterns,
    owners: _Owners,
    host: Host,
) -> tuple[list[Violation], list[Violation]]:
    """Culled patches that are seen in the picture without culls: violations, and false culls of back-patch tests."""
    violations: list[Violation] = []
    false_culls: list[Violation] = []
    seen, first, samples = np.unique(owners.patch, return_index=True, return_counts=True)
    lost = (seen >= 0) & (culled_by[seen] >= 0)
    cosines, where = facing(stage, seen[lost], maps, host)
    for k, p in enumerate(seen[lost]):
        name = names[culled_by[p]]
        u, v = uv_of(patterns, p, owners.point.flat[first[lost][k]])
        dropped = Violation(int(p), u, v, name, "culled, yet visible", -float(samples[lost][k]), "samples")
        if not name.startswith("backface"):
            violations.append(dropped)
        elif name in TRIANGLE_SAFE or sort_back_patch_cull(stage, cosines[k]):
            violations.append(dropped)
            if cosines[k] > 0.0:
                u, v = map(float, where[k])
                violations.append(
                    Violation(int(p), u, v, name, "culled, yet the surface faces the eye", -float(cosines[k]), "cosine")
                )
        else:
            false_culls.append(dropped)
    return violations, false_culls


def _compare_pictures(
    machine: Machine, target: Target, picture: tuple[U8, F32], patterns: Patterns, owners: _Owners
) -> list[Violation]:
    """A violation where the machine's picture is not the one that culls nothing: at its first sample."""
    color, depth = picture
    differ = (target.resolved != color).any(axis=2)[..., None] | (target.depth.view(np.uint32) != depth.view(np.uint32))
    if not differ.any():
        return []
    at = int(np.flatnonzero(differ)[0])
    patch, (y, x) = int(owners.patch.flat[at]), np.argwhere(differ.any(axis=2))[0]
    u, v = uv_of(patterns, patch, int(owners.point.flat[at])) if patch >= 0 else (math.nan, math.nan)
    what = f"the picture differs, first in column {x}, row {y}"
    return [Violation(patch, u, v, machine.bounds, what, -float(np.count_nonzero(differ)), "samples")]
