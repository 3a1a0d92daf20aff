"""Batches of patches that are made to break bounds: a family for each way that one may be wrong."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline import hull
from pipeline.displacement import pack_maps
from pipeline.types import F32, F64, I32, Address, FaceCull, HullInput, Partitioning, Patches, TessFactors, Viewport
from pipeline.vertex import make_patches
from tiler.scene.camera import Camera
from tiler.validation.surfaces import MESHES, NETS, mesh_patches

PATCHES = 256  # of a random batch

Texels = list[tuple[F32, Address, float, float]]  # maps as `pack_maps` takes them


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


def _vectors(rng: np.random.Generator) -> tuple[F32, float, float]:
    """Noise or spikes in three components, one of them often zero."""
    texels = rng.normal(0, 1, (*rng.integers(1, 12, 2), 3)) * rng.integers(0, 2, (1, 1, 3))
    texels *= rng.random((*texels.shape[:2], 1)) < rng.choice([0.05, 1.0])
    return texels.astype(np.float32), float(rng.normal() * 10.0 ** rng.uniform(-3, 0)), float(rng.normal() * 0.1)


MAPS: dict[str, Callable[[np.random.Generator], tuple[F32, float, float]]] = {
    "plain": _no_map,
    "spikes": _spikes,
    "noise": _noise,
    "steps": _steps,
    "constant": _constant,
    "vectors": _vectors,
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
    ("degenerate", "spikes", "huge"), ("smooth", "vectors", ""), ("rational", "vectors", ""),
    ("degenerate", "vectors", ""), ("needle", "vectors", "tiny"), ("smooth", "vectors", "far away"),
    ("smooth ACC", "plain", ""), ("smooth ACC", "noise", ""),
    ("degenerate ACC", "constant", ""), ("smooth ACC", "spikes", "far away"), ("smooth Gregory", "plain", ""),
    ("smooth Gregory", "noise", ""), ("degenerate Gregory", "steps", "huge"), ("ACC mesh", "plain", ""),
    ("ACC mesh", "noise", ""), ("ACC mesh", "constant", "tiny"), ("Gregory mesh", "spikes", ""),
)  # fmt: skip


class Batch(NamedTuple):
    """Patches with all that is needed to bound, shade and change them. Maps are kept apart so that they can be changed."""

    name: str
    patches: Patches
    maps: Texels
    turn: F32  # (maps, 3, 3) axes of the maps of vectors
    domain: F64  # (P, 4) multiples of 2^-16
    camera: Camera
    viewport: Viewport
    face_cull: FaceCull
    factors: TessFactors
    partitioning: Partitioning

    @property
    def control_points(self) -> F32:
        """(P, 4, 4, 4)."""
        return self.patches.control_points


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


def _factors(rng: np.random.Generator, n: int) -> TessFactors:
    """Equal or uneven factors, whole ones and ones a little above, four sets of them in a batch."""
    sets = rng.choice([1, 2, 3, 5, 8], (4, 6)) + rng.choice([0.0, 0.0, 0.01, 0.5], (4, 6))
    sets[:3] = sets[:3, :1]
    six = sets[rng.integers(0, 4, n)].astype(np.float32)
    return TessFactors(np.ascontiguousarray(six[:, :4]), np.ascontiguousarray(six[:, 4:]))


def _turns(rng: np.random.Generator, n: int) -> F32:
    """Axes for vectors: the world's, turned, or scaled and sheared, float32[n, 3, 3]."""
    turns = rng.normal(size=(n, 3, 3))
    turns[0::3] = np.eye(3)
    turns[1::3] = np.linalg.qr(turns[1::3])[0]
    return turns.astype(np.float32)


def make_batch(seed: int, number: int, n: int = PATCHES) -> Batch:
    """Batch `number` of a seed: n patches of one family, seen by one camera."""
    rng = np.random.default_rng([seed, number])
    shape, kind, place = FAMILIES[number % len(FAMILIES)]
    base, _, nets = shape.partition(" ") if shape.split()[-1] in NETS else (shape, "", "")
    net = None if shape in MESHES else SHAPES[base](rng, n)
    scale = _scale_of(place, rng)
    shift = np.zeros(3)
    if place == "far away":
        shift = rng.normal(size=3) * 10.0 ** rng.uniform(2, 6)
    if net is not None:
        net[..., :3] *= scale
        net[..., :3] += shift * net[..., 3:]
    count = 1 if kind == "plain" else n
    maps: Texels = []
    for _ in range(count):
        texels, factor, bias = MAPS[kind](rng)
        maps.append((texels, Address(int(rng.integers(3))), factor * scale, bias * scale))
    texcoords = rng.uniform(-1, 2, (n, 4, 2)).astype(np.float32)
    map_id: I32 = np.full(n, -1, np.int32) if kind == "plain" else np.arange(n, dtype=np.int32)
    made = np.random.default_rng([seed, number, 4])
    if net is None:
        patches = mesh_patches(made, n, MESHES[shape], scale)._replace(texcoords=texcoords, map_id=map_id)
    else:
        points = np.ascontiguousarray(net, np.float32)
        patches = make_patches(points, texcoords, map_id, np.zeros(n, np.int32))
        patches = NETS[nets](made, patches) if nets else patches
    return Batch(
        name=" ".join(word for word in (shape, kind, place) if word),
        patches=patches,
        maps=maps,
        turn=_turns(np.random.default_rng([seed, number, 5]), count),
        domain=_domains(rng, n) if rng.integers(2) else np.tile([0.0, 1.0, 0.0, 1.0], (n, 1)),
        camera=_camera(shift, scale, rng),
        viewport=[
            Viewport(0, 0, 64, 48, 0.0, 1.0),
            Viewport(5, 11, 37, 23, 0.25, 0.7),
            Viewport(0, 0, 4096, 2160, 0.0, 1.0),
        ][rng.integers(3)],
        face_cull=FaceCull(int(rng.integers(1, 3))),
        factors=_factors(np.random.default_rng([seed, number, 3]), n),
        partitioning=Partitioning(number % len(Partitioning)),
    )


def make_stage(batch: Batch) -> HullInput:
    """The hull stage's input of a batch."""
    maps = pack_maps(batch.maps)
    maps.turn[: len(batch.turn)] = batch.turn
    return hull.make_input(
        batch.patches,
        maps,
        batch.camera.clip_from_world,
        batch.viewport,
        eye=batch.camera.eye,
        domain=batch.domain,
        factors=batch.factors,
        face_cull=batch.face_cull,
        partitioning=batch.partitioning,
    )
