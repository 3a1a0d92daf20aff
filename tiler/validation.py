"""`tiler validate`: the bounds and cull tests under attack, and the tessellator against a file of reference answers.

Bounds. Every entry of BOUNDS and CULL_TESTS is checked by `tiler.verify` over the built-in scenes at several factors, then
over batches of patches that are made to break it: smooth, rational, degenerate, flat, tiny, huge, far away, with weights
that no bound can take, on spiky and stepped maps, seen by cameras near, inside and beside them, over whole patches and
parts of them. Points are what a tessellator can make, multiples of 2^-16, many on the ends. Every third batch is an
adversary: it moves control points, texture coordinates, texels and (u, v) of each patch towards the smallest margin of one
check, in units of what rounding is allowed. All bounds share a batch's shaded points.

A batch is made from the seed and its number alone, so that a violation can be made again; it also comes with its patch.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline import hull, tessellator
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from pipeline.displacement import pack_maps
from pipeline.types import F32, F64, I32, Address, FaceCull, HullInput, PatchBounds, Viewport
from pipeline.vertex import make_patches
from tiler import verify
from tiler.config import Machine
from tiler.errors import TilerError, unknown_name
from tiler.host import Host, available_threads
from tiler.scene import load_scene, scene_names
from tiler.scene.camera import Camera
from tiler.simulation import simulate
from tiler.verify import BOX, CLIP, CONE, DEPTH, NUM_FUNCTIONS, Margins, Shaded, Violation

PATCHES, POINTS = 256, 1024  # of a random batch
CLIMBERS, CLIMB_POINTS, CLIMB_ROUNDS = 64, 128, 24  # of an adversarial one
SCENE_FACTORS = (2, 7, 16)
SCENE_SIZE = (160, 90)
KEPT = 8  # violations of an algorithm that are reported in full
U = 2.0**-24

Progress = Callable[[float], None]

Texels = list[tuple[F32, Address, float, float]]  # maps as `pack_maps` takes them


# Families of patches


def _sheets(rng: np.random.Generator, n: int) -> F64:
    """Bumpy sheets about the origin, of size 1, float64[n, 4, 4, 4] with weights 1."""
    i = np.arange(4) / 3 - 0.5
    net = np.stack(np.broadcast_arrays(i[:, None], i[None, :], 0.0), -1) + rng.normal(0, 1, (n, 4, 4, 3)) * rng.choice(
        [0.02, 0.1, 0.3], (n, 1, 1, 1)
    )
    turn = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    points = np.einsum("nijc,ncd->nijd", net, turn) + rng.uniform(-1.5, 1.5, (n, 1, 1, 3))
    return np.concatenate([points, np.ones((n, 4, 4, 1))], -1)


def _smooth(rng: np.random.Generator, n: int) -> F64:
    return _sheets(rng, n)


def _weigh(rng: np.random.Generator, net: F64) -> F64:
    spread = rng.choice([1.3, 4.0, 50.0], (len(net), 1, 1, 1))
    return net * spread ** rng.uniform(-1, 1, (*net.shape[:3], 1))


def _rational(rng: np.random.Generator, n: int) -> F64:
    return _weigh(rng, _sheets(rng, n))


def _degenerate(rng: np.random.Generator, n: int) -> F64:
    """Collapsed edges and corners, lines, points, folds, twisted and doubled rows."""
    net = _sheets(rng, n)
    net[0::8, :, 3] = net[0::8, :1, 3]  # an edge is a point
    net[1::8, 0] = net[1::8, 0, :1]
    net[2::8] = net[2::8, :1, :1]  # a point
    net[3::8, :, :, 1:3] = 0.25  # a line
    net[4::8, 3] = net[4::8, 0]  # closed
    net[5::8, 1] = net[5::8, 0]  # zero derivative along an edge
    net[6::8, :2, :2] = net[6::8, :1, :1]  # a corner whose neighbours lie on it
    net[7::8, 2:] = net[7::8, 1::-1]  # folded over itself
    return net


def _flat(rng: np.random.Generator, n: int) -> F64:
    """In a plane of the coordinates, edges on it: boxes without thickness."""
    net = _sheets(rng, n)
    axis = rng.integers(0, 3, n)
    net[np.arange(n), :, :, axis] = rng.normal(size=(n, 1, 1)) * rng.integers(0, 2, (n, 1, 1))
    return net


def _needle(rng: np.random.Generator, n: int) -> F64:
    net = _sheets(rng, n)
    net[..., :3] *= 10.0 ** rng.uniform(-6, 0, (n, 1, 1, 3))
    return net


def _bad_weights(rng: np.random.Generator, n: int) -> F64:
    """Weights of zero, below zero, and extreme ones."""
    net = _rational(rng, n)
    net[np.arange(n), rng.integers(0, 4, n), rng.integers(0, 4, n), 3] = rng.choice([0.0, -1.0, -1e-30, 1e-30, 1e30], n)
    return net


SHAPES: dict[str, Callable[[np.random.Generator, int], F64]] = {
    "smooth": _smooth,
    "rational": _rational,
    "degenerate": _degenerate,
    "rational degenerate": lambda rng, n: _weigh(rng, _degenerate(rng, n)),
    "flat": _flat,
    "needle": _needle,
    "bad weights": _bad_weights,
}


def _no_map(rng: np.random.Generator) -> tuple[F32, float, float]:
    return np.zeros((1, 1), np.float32), 0.0, 0.0


def _spikes(rng: np.random.Generator) -> tuple[F32, float, float]:
    """Flat but for a few texels, at borders too."""
    height, width = rng.integers(1, 14, 2)
    texels = np.zeros((height, width), np.float32)
    for _ in range(3):
        texels[rng.choice([0, -1, rng.integers(height)]), rng.choice([0, -1, rng.integers(width)])] = rng.normal()
    return texels, float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3, 0.5)), 0.0


def _noise(rng: np.random.Generator) -> tuple[F32, float, float]:
    texels = rng.normal(0, 1, rng.integers(1, 18, 2)).astype(np.float32)
    return texels, float(rng.normal() * 10.0 ** rng.uniform(-3, 0)), float(rng.normal() * 0.2 * rng.integers(0, 2))


def _steps(rng: np.random.Generator) -> tuple[F32, float, float]:
    """Every texel at one of two ends."""
    return (
        rng.integers(0, 2, rng.integers(1, 9, 2)).astype(np.float32),
        float(rng.normal() * 0.3),
        float(rng.normal() * 0.1),
    )


def _constant(rng: np.random.Generator) -> tuple[F32, float, float]:
    return np.full((2, 3), rng.normal(), np.float32), float(rng.normal() * 0.3), float(rng.normal() * 0.3)


MAPS: dict[str, Callable[[np.random.Generator], tuple[F32, float, float]]] = {
    "plain": _no_map,
    "spikes": _spikes,
    "noise": _noise,
    "steps": _steps,
    "constant": _constant,
}


def _scale_of(place: str, rng: np.random.Generator) -> float:
    return {"tiny": 10.0 ** rng.uniform(-32, -6), "huge": 10.0 ** rng.uniform(6, 30)}.get(place, 1.0)


# shape, map, place
FAMILIES: tuple[tuple[str, str, str], ...] = (
    ("smooth", "plain", ""), ("smooth", "noise", ""), ("smooth", "spikes", ""), ("smooth", "steps", ""),
    ("smooth", "constant", ""), ("rational", "plain", ""), ("rational", "noise", ""), ("rational", "spikes", ""),
    ("degenerate", "plain", ""), ("degenerate", "noise", ""), ("degenerate", "constant", ""),
    ("rational degenerate", "steps", ""), ("flat", "plain", ""), ("flat", "spikes", ""), ("needle", "plain", ""),
    ("needle", "noise", ""), ("smooth", "plain", "tiny"), ("smooth", "noise", "tiny"), ("smooth", "plain", "huge"),
    ("rational", "noise", "huge"), ("smooth", "plain", "far away"), ("smooth", "noise", "far away"),
    ("degenerate", "plain", "far away"), ("bad weights", "noise", ""), ("rational degenerate", "plain", ""),
    ("degenerate", "spikes", "huge"),
)  # fmt: skip


class Batch(NamedTuple):
    """Patches with all that is needed to bound, shade and change them. Maps are kept apart so that they can be changed."""

    name: str
    control_points: F32  # (P, 4, 4, 4)
    texcoords: F32  # (P, 4, 2)
    maps: Texels
    map_id: I32  # (P,)
    domain: F64  # (P, 4) multiples of 2^-16
    camera: Camera
    viewport: Viewport
    face_cull: FaceCull


def _look(eye: F64, target: F64, near: float, far: float, rng: np.random.Generator) -> F32:
    """Clip-from-world matrix of a right-handed view."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(rng.normal(size=3), back)
    right /= np.linalg.norm(right)
    view = np.stack([right, np.cross(back, right), back])
    view = np.concatenate([view, -(view @ eye)[:, None]], 1)
    slope, k = 10.0 ** rng.uniform(-1, 0.3), far / (far - near)
    projection = np.array([[0.75 / slope, 0, 0, 0], [0, 1 / slope, 0, 0], [0, 0, -k, -k * near], [0, 0, -1, 0]])
    return (projection @ np.concatenate([view, [[0, 0, 0, 1]]])).astype(np.float32)


def _camera(center: F64, size: float, rng: np.random.Generator) -> Camera:
    """Near or far from, inside of, beside, or looking away from patches of about this size."""
    distance = size * 10.0 ** rng.uniform(-1, 1)
    eye = center + rng.normal(size=3) * distance
    target = eye
    while not np.linalg.norm(target - eye) > 0:
        target = center + rng.choice([0.0, 1.0, 3.0], p=[0.6, 0.3, 0.1]) * size * rng.normal(size=3)
    near, far = distance * 10.0 ** rng.uniform(-2, 0.2), distance * 10.0 ** rng.uniform(0.4, 2)
    return Camera(_look(eye, target, near, far, rng), eye, near, far)


def _domains(rng: np.random.Generator, n: int) -> F64:
    """Parts of patches, some of no size along one side or both."""
    ends = np.empty((n, 2, 2))
    for c in range(2):
        size = np.rint(
            65536.0 * 2.0 ** -rng.integers(0, 11, n) * rng.choice([1.0, 1.0, 0.7, 0.0], n, p=[0.5, 0.2, 0.28, 0.02])
        )
        first = np.rint(rng.uniform(0, 1, n) * (65536.0 - size))
        ends[:, c] = np.stack([first, first + size], 1) / 65536.0
    return ends.reshape(n, 4)


def make_batch(seed: int, number: int, n: int = PATCHES) -> Batch:
    """Batch `number` of a seed: n patches of one family, seen by one camera."""
    rng = np.random.default_rng([seed, number])
    shape, kind, place = FAMILIES[number % len(FAMILIES)]
    net = SHAPES[shape](rng, n)
    scale = _scale_of(place, rng)
    net[..., :3] *= scale
    shift = np.zeros(3)
    if place == "far away":
        shift = rng.normal(size=3) * 10.0 ** rng.uniform(2, 6)
        net[..., :3] += shift * net[..., 3:]
    count = 1 if kind == "plain" else n
    maps: Texels = []
    for _ in range(count):
        texels, factor, bias = MAPS[kind](rng)
        maps.append((texels, Address(int(rng.integers(3))), factor * scale, bias * scale))
    return Batch(
        name=" ".join(word for word in (shape, kind, place) if word),
        control_points=np.ascontiguousarray(net, np.float32),
        texcoords=rng.uniform(-1, 2, (n, 4, 2)).astype(np.float32),
        maps=maps,
        map_id=np.full(n, -1, np.int32) if kind == "plain" else np.arange(n, dtype=np.int32),
        domain=_domains(rng, n) if rng.integers(2) else np.tile([0.0, 1.0, 0.0, 1.0], (n, 1)),
        camera=_camera(shift, scale, rng),
        viewport=[
            Viewport(0, 0, 64, 48, 0.0, 1.0),
            Viewport(5, 11, 37, 23, 0.25, 0.7),
            Viewport(0, 0, 4096, 2160, 0.0, 1.0),
        ][rng.integers(3)],
        face_cull=FaceCull(int(rng.integers(1, 3))),
    )


def make_stage(batch: Batch) -> HullInput:
    """The hull stage's input of a batch."""
    n = len(batch.control_points)
    patches = make_patches(batch.control_points, batch.texcoords, batch.map_id, np.zeros(n, np.int32))
    return hull.make_input(
        patches,
        pack_maps(batch.maps),
        batch.camera.clip_from_world,
        batch.viewport,
        eye=batch.camera.eye,
        domain=batch.domain,
        face_cull=batch.face_cull,
    )


def attack_points(domain: F64, m: int, rng: np.random.Generator) -> F32:
    """m points in each domain, multiples of 2^-16, float32[2, P, m]; corners first, then many on edges."""
    ends = np.rint(domain * 65536.0)
    uv = np.empty((2, len(domain), m), np.float32)
    for c in range(2):
        lo, hi = ends[:, 2 * c, None], ends[:, 2 * c + 1, None]
        r = rng.random((len(domain), m), np.float32).astype(np.float64)
        r = np.clip(1.25 * r - 0.125, 0.0, 1.0)  # a fifth on the ends
        r[:, :4] = [[0, 1, 0, 1], [0, 0, 1, 1]][c]
        uv[c] = np.rint(lo + r * (hi - lo)) / 65536.0
    return uv


# Checking a batch


@dataclass
class Tally:
    """What was checked of one algorithm, and what failed."""

    algorithm: str
    samples: int = 0
    cases: int = 0  # patches, or parts of them
    failed: int = 0
    refused: int = 0  # batches that the algorithm says it cannot take
    seconds: float = 0.0  # spent on this algorithm, without its share of the shading
    closest: float = np.inf  # least margin of the box, in roundings (2^-24) of its largest coordinate
    false_culls: int = 0
    violations: list[dict[str, Any]] = field(default_factory=list)

    def add(self, found: Sequence[Violation], where: dict[str, Any], batch: Batch | None = None) -> None:
        """Count the patches of these violations, and keep the first few."""
        self.failed += len({violation.patch for violation in found})
        for violation in found:
            if len(self.violations) >= KEPT:
                break
            record = violation.record() | where
            if batch is not None:
                p = violation.patch
                record |= {
                    "control_points": batch.control_points[p].tolist(),
                    "texcoords": batch.texcoords[p].tolist(),
                    "domain": batch.domain[p].tolist(),
                }
            self.violations.append(record)

    def record(self) -> dict[str, Any]:
        """For JSON."""
        record: dict[str, Any] = {
            "algorithm": self.algorithm,
            "samples": self.samples,
            "cases": self.cases,
            "failed": self.failed,
            "seconds": round(self.seconds, 3),
        }
        if np.isfinite(self.closest):
            record["closest"] = self.closest
        if self.refused:
            record["refused_batches"] = self.refused
        return record | {"false_culls": self.false_culls, "violations": self.violations}


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
            tried = best if climb == 0 else _mutate(best, rng)
            uv = attack_points(tried.domain, CLIMB_POINTS, rng)
            _gather_around(uv, where_best, tried.domain, rng)
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
            best = _take(best, tried, live[better])

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


def _gather_around(uv: F32, center: F64, domain: F64, rng: np.random.Generator) -> None:
    """Move the second half of the points, in place, close to the worst point so far, at all distances."""
    half = uv.shape[2] // 2
    for c in range(2):
        lo, hi = domain[:, 2 * c, None], domain[:, 2 * c + 1, None]
        step = rng.normal(size=(uv.shape[1], half)) * 2.0 ** rng.uniform(-16, -2, (uv.shape[1], half)) * (hi - lo)
        near = np.rint(np.clip(center[c][:, None] + step, lo, hi) * 65536.0) / 65536.0
        uv[c, :, half:] = near
    inside = (center[0] >= domain[:, 0]) & (center[0] <= domain[:, 1])
    inside &= (center[1] >= domain[:, 2]) & (center[1] <= domain[:, 3])
    uv[:, inside, half] = center[:, inside]


def _mutate(batch: Batch, rng: np.random.Generator) -> Batch:
    """Every patch changed a little or a lot: some control points, texture coordinates, texels."""
    n = len(batch.control_points)
    step = 2.0 ** rng.uniform(-24, -1, (n, 1, 1, 1))
    size = abs(batch.control_points).max(axis=(1, 2), keepdims=True).astype(np.float64)
    where = rng.random((n, 4, 4, 4)) < rng.choice([0.02, 0.1, 0.5], (n, 1, 1, 1))
    where[..., 3] &= (batch.control_points[..., 3] != 1.0).any(axis=(1, 2))[:, None, None]  # polynomial patches stay so
    with np.errstate(over="ignore"):
        cp = (batch.control_points + where * step * rng.normal(size=(n, 4, 4, 4)) * size).astype(np.float32)
    cp[..., 3] = np.where(cp[..., 3] > 0, cp[..., 3], batch.control_points[..., 3])
    move = rng.random((n, 4, 2)) < 0.2
    texcoords = (batch.texcoords + move * rng.normal(size=(n, 4, 2)) * step[..., 0]).astype(np.float32)
    maps = []
    for texels, address, scale, bias in batch.maps:
        change = (rng.random(texels.shape) < 0.2) * rng.normal(size=texels.shape) * 2.0 ** rng.uniform(-12, 0)
        maps.append(((texels + change).astype(np.float32), address, scale, bias))
    return batch._replace(control_points=cp, texcoords=texcoords, maps=maps)


def _take(old: Batch, new: Batch, rows: Any) -> Batch:
    """`old` with these patches of `new`, each with its map."""
    cp, texcoords, maps = old.control_points.copy(), old.texcoords.copy(), list(old.maps)
    cp[rows], texcoords[rows] = new.control_points[rows], new.texcoords[rows]
    for p in rows:
        if old.map_id[p] >= 0:
            maps[old.map_id[p]] = new.maps[old.map_id[p]]
    return old._replace(control_points=cp, texcoords=texcoords, maps=maps)


ADVERSARY_EACH = 3  # one batch in so many


def validate_bounds(
    samples: int,
    *,
    seed: int = 0,
    names: Sequence[str] | None = None,
    scenes: Sequence[str] | None = None,
    threads: int | None = None,
    progress: Progress = lambda samples: None,
) -> dict[str, Any]:
    """Check bounds and all cull tests at `samples` shaded points a bound at least: the JSON object of `tiler validate bounds`.

    names : entries of BOUNDS, all by default. scenes : built-in scenes, all by default. progress : called with the samples
    done. Raises TilerError for an unknown name or a number that is not allowed.
    """
    names = list(BOUNDS) if names is None else list(names)
    for name in names:
        if name not in BOUNDS:
            raise TilerError(f"bounds: {name!r} is not allowed; {unknown_name(name, BOUNDS)}")
    if not 1 <= samples <= 10**12:
        raise TilerError(f"samples: {samples} is not allowed; allowed: 1 to 10^12")
    if not 0 <= seed < 2**63:
        raise TilerError(f"seed: {seed} is not allowed; allowed: 0 to 2^63 - 1")
    threads = available_threads() if threads is None else threads
    start = time.perf_counter()
    with Host(threads) as host:
        campaign = Campaign(names, seed, host)

        def done() -> int:
            return min(tally.samples for tally in campaign.bounds.values())

        for name in scene_names() if scenes is None else scenes:
            for factor in SCENE_FACTORS:
                campaign.scene(name, factor, 0, threads)
                progress(min(done(), samples))
        number = 0
        while done() < samples:
            adversarial = number % ADVERSARY_EACH == ADVERSARY_EACH - 1
            (campaign.adversarial_batch if adversarial else campaign.random_batch)(number)
            number += 1
            progress(min(done(), samples))
            if all(tally.refused >= number > len(FAMILIES) for tally in campaign.bounds.values()):
                break
    tallies = [*campaign.bounds.values(), *campaign.culls.values()]
    seconds = time.perf_counter() - start
    return {
        "what": "bounds",
        "cases": sum(tally.cases for tally in tallies),
        "failed": sum(tally.failed for tally in tallies),
        "details": [tally.record() for tally in tallies],
        "seed": seed,
        "seconds": round(seconds, 3),
        "shaded_samples_per_second": round(campaign.shaded / max(campaign.shading_seconds, 1e-9)),
        "checked_samples_per_second": round(sum(t.samples for t in campaign.bounds.values()) / max(seconds, 1e-9)),
    }


# The tessellator

REFERENCE_ARRAYS = (
    "domain", "partitioning", "output", "tag", "legal", "num_edge_factors", "num_inside_factors", "factors_bits",
    "culled", "point_offset", "index_offset", "points", "indices",
)  # fmt: skip


def validate_tessellator(reference: Path, progress: Progress = lambda cases: None) -> dict[str, Any]:
    """Compare the tessellator, bit for bit and in order, with a file of reference answers.

    reference : an .npz whose arrays, a row a case, hold domain, partitioning, output, factors and the answer: points
    (float32) and indices of case k lie at point_offset[k] .. point_offset[k + 1] and index_offset[k] .. index_offset[k + 1].
    Returns the JSON object of `tiler validate tessellator`. Raises TilerError for a file that is not so.
    """
    answers = _load_reference(reference)
    details: list[dict[str, Any]] = []
    failed, cases = 0, len(answers["domain"])
    for k in range(cases):
        wrong = _compare_case(answers, k)
        if wrong:
            failed += 1
            if len(details) < 4 * KEPT:
                words = {name: str(answers[name][k]) for name in ("domain", "partitioning", "output", "tag")}
                factors = [repr(float(f)) for f in answers["factors_bits"][k].view(np.float32)]
                details.append({"case": k} | words | {"factors": factors, "wrong": wrong})
        if k % 32 == 31:
            progress(k + 1)
    return {"what": "tessellator", "cases": cases, "failed": failed, "details": details}


def count_cases(reference: Path) -> int:
    """Number of cases in a file of reference answers. Raises TilerError for a file that is none."""
    return len(_load_reference(reference)["domain"])


def _load_reference(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in REFERENCE_ARRAYS if name not in file.files]
            if missing:
                raise TilerError(
                    f"reference: {path} has no array {', '.join(missing)}; allowed: a file of reference answers"
                )
            return {name: file[name] for name in REFERENCE_ARRAYS}
    except TilerError:
        raise
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise TilerError(f"reference: cannot read {path} as an .npz file ({error})") from None


def _compare_case(answers: dict[str, Any], k: int) -> list[str]:
    """What differs in case k."""
    domain, partitioning, output = (str(answers[name][k]) for name in ("domain", "partitioning", "output"))
    edges, insides = int(answers["num_edge_factors"][k]), int(answers["num_inside_factors"][k])
    factors = answers["factors_bits"][k].view(np.float32)
    edge, inside = factors[:edges], factors[edges : edges + insides]
    answer = tessellator.tessellate if answers["legal"][k] else tessellator._tessellate
    points, indices = answer(domain, partitioning, edge, inside, output)
    expected = answers["points"][slice(*answers["point_offset"][k : k + 2])].astype(np.float32)
    same = {
        "culled": bool(answers["culled"][k]) == (len(points) == 0),
        "points": np.array_equal(points.view(np.uint32), expected.view(np.uint32)),
        "indices": np.array_equal(indices, answers["indices"][slice(*answers["index_offset"][k : k + 2])]),
    }
    return [name for name, equal in same.items() if not equal]
