"""Bounds and cull tests under attack: batch by batch, and scene by scene."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS, TRIANGLE_SAFE
from pipeline.types import (
    F32,
    F64,
    I32,
    HullInput,
    PatchBounds,
)
from tiler import verify
from tiler.config import Machine
from tiler.host import Host
from tiler.scene import load_scene
from tiler.simulation import simulate
from tiler.validation.attack import attack_points, gather_around, mutate, take
from tiler.validation.families import Batch, make_batch, make_stage
from tiler.validation.tally import Tally
from tiler.verify import BOX, CLIP, CONE, DEPTH, NUM_FUNCTIONS, Margins, Shaded, Violation

POINTS = 1024  # of a patch of a random batch
CLIMBERS, CLIMB_POINTS, CLIMB_ROUNDS = 64, 128, 24  # of an adversarial one
SCENE_SIZE = (160, 90)
U = 2.0**-24


def _units(bounds: PatchBounds) -> F64:
    """What one rounding amounts to in each check that the adversary climbs, float64[P, CONE + 1]."""
    units = np.full((len(bounds.center), CONE + 1), U)
    with np.errstate(all="ignore"):
        units[:, BOX : BOX + 3] = U * (abs(bounds.center).max(axis=1) + abs(bounds.axes).sum(axis=(1, 2)))[:, None]
        x, y, z, w = bounds.slack.T
        units[:, CLIP : CLIP + NUM_FUNCTIONS] = np.stack([x, y, z, w, w + x, w + x, w + y, w + y, w + z], 1)
    return units


CLIMBED = [*range(BOX, BOX + 3), *range(CLIP, CLIP + NUM_FUNCTIONS), DEPTH, CONE]


class Campaign:
    """All tallies of one validation of bounds and cull tests."""

    def __init__(self, names: Sequence[str], seed: int, host: Host) -> None:
        self.seed, self.host = seed, host
        self.bounds = {name: Tally(name) for name in names}
        self.culls = {name: Tally(name) for name in CULL_TESTS}
        self.shading_seconds = 0.0
        self.shaded = 0

    def _shade(self, batch: Batch, stage: HullInput, uv: F32) -> tuple[Shaded, I32, Any]:
        """Shaded points of the patches that are not refused as non-finite, their numbers, and the patterns."""
        start = time.perf_counter()
        flags = hull.flag_nonfinite(stage.patches, stage.pyramids.whole)
        live = np.flatnonzero(flags == 0).astype(np.int32)
        patterns = verify.point_patterns(uv)
        shaded = verify.shade_all(live, stage.patches, patterns, stage.maps, batch.camera, batch.viewport, self.host)
        self.shading_seconds += time.perf_counter() - start
        self.shaded += shaded.clip.clip.shape[1]
        return shaded, live, patterns

    def _check_bound(
        self, name: str, batch: Batch, stage: HullInput, shaded: Shaded, live: I32, patterns: Any, where: dict[str, Any]
    ) -> tuple[PatchBounds, Margins] | None:
        tally, start = self.bounds[name], time.perf_counter()
        try:
            bounds = BOUNDS[name](stage)
        except ValueError:
            tally.refused += 1
            return None
        margins = verify.measure_margins(bounds, live, shaded, batch.viewport, self.host)
        tally.add(verify.name_violations(name, margins, live, patterns), where, batch)
        tally.samples += shaded.clip.clip.shape[1]
        tally.cases += len(live)
        tally.seconds += time.perf_counter() - start
        with np.errstate(all="ignore"):
            near = (margins.margin[:, BOX : BOX + 3] / _units(bounds)[live, BOX : BOX + 3]).ravel()
        if np.isfinite(near).any():
            tally.closest = min(tally.closest, float(near[np.isfinite(near)].min()))
        return bounds, margins

    def random_batch(self, number: int) -> None:
        """Check every bound, and every cull test with every bound, on one batch."""
        batch, rng = make_batch(self.seed, number), np.random.default_rng([self.seed, number, 1])
        stage = make_stage(batch)
        shaded, live, patterns = self._shade(batch, stage, attack_points(batch.domain, POINTS, rng))
        where = {"family": batch.name, "seed": self.seed, "batch": number}
        reach: tuple[F64, Any] | None = None
        answers: dict[tuple[str, bytes], list[Violation]] = {}  # most tests ignore the bounds: same answer, same check
        for name in self.bounds:
            checked = self._check_bound(name, batch, stage, shaded, live, patterns, where)
            if checked is None:
                continue
            if reach is None:
                reach = verify.reach_planes(shaded.clip, self.host)
            for cull, tally in self.culls.items():
                start = time.perf_counter()
                flags = np.ones(len(batch.control_points), np.uint8)
                flags[live] = 0
                before = flags.copy()
                CULL_TESTS[cull](stage, checked[0], flags)
                culled = (flags != before)[live]
                key = (cull, culled.tobytes())
                if key not in answers:
                    answers[key] = self._check_cull(cull, f"{cull} on {name}", stage, live, culled, reach, patterns)
                    tally.add(answers[key], where, batch)
                tally.samples += shaded.clip.clip.shape[1]
                tally.cases += len(live)
                tally.seconds += time.perf_counter() - start

    def _check_cull(
        self, cull: str, label: str, stage: HullInput, live: I32, culled: Any, reach: tuple[F64, Any], patterns: Any
    ) -> list[Violation]:
        """Culled patches with a point inside every plane's side, or (back-patch tests) with a surface that faces the eye."""
        found = []
        if cull.startswith("backface"):
            rows = live[culled]
            cosine, uv = verify.facing(stage, rows, stage.maps, self.host)
            for k in np.flatnonzero(cosine > 0.0):
                u, v = map(float, uv[k])
                what = "culled, yet the surface faces the eye"
                found.append(Violation(int(rows[k]), u, v, label, what, -float(cosine[k]), "cosine"))
            if cull in TRIANGLE_SAFE:
                front = verify.front_triangles(stage, rows, self.host)
                for k in np.flatnonzero(front):
                    what = "culled, yet triangles face the eye"
                    found.append(Violation(int(rows[k]), np.nan, np.nan, label, what, -float(front[k]), "triangles"))
            return found
        least = reach[0].min(axis=1)
        for k in np.flatnonzero(culled & (least >= 0.0)):
            point = patterns.first_point[patterns.of_patch[live[k]]] + reach[1][k, reach[0][k].argmin()]
            u, v = map(float, patterns.uv[:, point])
            what = "culled, yet outside no plane of the frustum"
            found.append(Violation(int(live[k]), u, v, label, what, -float(least[k]), "clip units"))
        return found

    def adversarial_batch(self, number: int) -> None:
        """For every bound: move patches, maps and points towards the smallest margin, and check all on the way."""
        for name in self.bounds:
            self._climb(name, number)

    def _climb(self, name: str, number: int) -> None:
        rng = np.random.default_rng([self.seed, number, 2])
        best = make_batch(self.seed, number, CLIMBERS)
        check = rng.choice(CLIMBED, CLIMBERS)
        margin, where_best = np.full(CLIMBERS, np.inf), np.full((2, CLIMBERS), 0.5)
        for climb in range(CLIMB_ROUNDS):
            tried = best if climb == 0 else mutate(best, rng)
            uv = attack_points(tried.domain, CLIMB_POINTS, rng)
            gather_around(uv, where_best, tried.domain, rng)
            stage = make_stage(tried)
            shaded, live, patterns = self._shade(tried, stage, uv)
            where = {"family": tried.name, "seed": self.seed, "batch": number, "climb": climb}
            checked = self._check_bound(name, tried, stage, shaded, live, patterns, where)
            if checked is None:
                return
            bounds, margins = checked
            with np.errstate(all="ignore"):
                relative = margins.margin[:, : CONE + 1] / _units(bounds)[live]
            relative = relative[np.arange(len(live)), check[live]]
            better = relative < margin[live]
            margin[live[better]] = relative[better]
            at = margins.at[np.arange(len(live)), check[live]][better]
            where_best[:, live[better]] = uv[:, live[better], at]
            best = take(best, tried, live[better])

    def scene(self, name: str, factor: float, number: float, threads: int) -> None:
        """Verify one frame of a built-in scene with every bound and all cull tests, each alone with the first bound."""
        scene = load_scene(name, size=SCENE_SIZE, factor=factor)
        where = {"family": f"scene {name}", "factor": factor, "frame": number}
        points = 0
        machines = [Machine(bounds=bound, cull=(), verify=True) for bound in self.bounds]
        machines += [Machine(bounds=next(iter(self.bounds)), cull=(cull,), verify=True) for cull in self.culls]
        for machine in machines:
            tally = self.culls[machine.cull[0]] if machine.cull else self.bounds[machine.bounds]
            start = time.perf_counter()
            frame = simulate(scene, machine, frame=number, threads=threads)
            tally.add(frame.violations, where)
            tally.false_culls += len(frame.false_culls)
            points = max(
                points, frame.counters["ts_domain_points"]
            )  # of the machines that cull nothing, which come first
            tally.samples += points
            tally.cases += scene.num_patches
            tally.seconds += time.perf_counter() - start
