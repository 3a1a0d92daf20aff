"""Subdivision patches against limit positions and normals that somebody else evaluated: `tiler validate limit`.

Regular patches and all corners must be the limit surface up to float32: control points are rounded once, of vertices that
are rounded once. Normals are of two tangents, each a difference of such points. Between the corners of other patches
ACC and Gregory patches are approximations: where it was published how far they are from the limit they must not be farther,
elsewhere that is told, not judged. But after three Catmull-Clark steps every sample is a vertex, whose limit position is
exact: so the surface that is approximated must be the reference's. Models with creases or corner tags have limits of their
own and are left out.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline import hull
from pipeline.subdivision.limit import multiply, position_rows
from pipeline.subdivision.refine import make_step, move_points, refine_cage
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.subdivision.topology import Cage, TopologyFault, make_rings, make_topology
from pipeline.types import F32, F64, I64, Patches
from tiler.errors import TilerError
from tiler.validation.tally import KEPT

Progress = Callable[[float], None]

U = 2.0**-24
# How far patches that are not regular are from the limit, part of the diagonal, where somebody told (spec section 9).
PUBLISHED = {
    ("bigguy_subset", Basis.ACC): 3.0e-3, ("bigguy_subset", Basis.GREGORY): 3.4e-3, ("cube", Basis.ACC): 9.3e-3,
    ("cube", Basis.GREGORY): 1.6e-2,
}  # fmt: skip
ARRAYS = (
    "V", "P", "N", "ptex", "face_sizes", "face_verts", "boundary", "crease_edges", "crease_sharpness", "corner_verts",
    "corner_sharpness",
)  # fmt: skip


class Model(NamedTuple):
    """One model of the reference, its samples those of quads, or of the quads that one step makes."""

    name: str
    cage: Cage
    vertices: F64  # (V, 3)
    patch: I64  # (n,) patch of each row of samples
    position: F64  # (n, 16, 3)
    normal: F64  # (n, 16, 3) unit; NaN where there is none


def validate_limit(reference: Path, progress: Progress = lambda models: None) -> dict[str, Any]:
    """The JSON object of `tiler validate limit`; a case is a patch of a model in one basis.

    reference : an .npz of arrays MODEL__NAME (`ARRAYS`) and uv, the 16 samples, u slow. Raises TilerError for another file.
    """
    uv, models = load_models(reference)
    details: list[dict[str, Any]] = []
    for k, model in enumerate(models):
        for basis in Basis:
            details.append(_check_model(model, uv, basis))
        progress(k + 1)
    return {
        "what": "limit",
        "cases": sum(row["cases"] for row in details),
        "failed": sum(row["failed"] for row in details),
        "details": details,
    }


def load_models(path: Path) -> tuple[F64, list[Model]]:
    """Samples (16, 2) and the models without tags. Raises TilerError for a file that is no such reference."""
    try:
        with np.load(path, allow_pickle=False) as file:
            names = sorted({name.rpartition("__")[0] for name in file.files if "__" in name})
            missing = [f"{m}__{a}" for m in names for a in ARRAYS if f"{m}__{a}" not in file.files]
            if "uv" not in file.files or not names or missing:
                lacks = missing[0] if missing else "uv" if "uv" not in file.files else "MODEL__V"
                raise TilerError(f"reference: {path} has no array {lacks}; allowed: a file of limit positions")
            arrays = {name: {a: file[f"{name}__{a}"] for a in ARRAYS} for name in names}
            uv = np.asarray(file["uv"], np.float64)
    except TilerError:
        raise
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise TilerError(f"reference: cannot read {path} as an .npz file ({error})") from None
    plain = [n for n, a in arrays.items() if not len(a["crease_edges"]) and not len(a["corner_verts"])]
    try:
        return uv, [_model(name, arrays[name]) for name in plain]
    except (ValueError, IndexError, TypeError) as error:
        raise TilerError(f"reference: {path} has arrays that do not go together ({error})") from None


def _model(name: str, arrays: dict[str, Any]) -> Model:
    sizes = arrays["face_sizes"]
    first = np.cumsum([0, *sizes]).astype(np.int32)
    cage = Cage(
        len(arrays["V"]), first, arrays["face_verts"].astype(np.int32), np.zeros((first[-1], 2), np.float32),
        np.zeros((0, 2), np.int32), np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32),
        keep_corners=int(arrays["boundary"]) == 2,
    )  # fmt: skip
    # With a polygon in it the mesh is refined once, and (face, k) is the quad of corner first[face] + k.
    quads = bool((sizes == 4).all())
    used = np.ones(len(arrays["ptex"]), bool) if quads else arrays["ptex"][:, 1] >= 0
    face, k = arrays["ptex"][used].T.astype(np.int64)
    return Model(name, cage, arrays["V"], face if quads else first[face] + k, arrays["P"][used], arrays["N"][used])


def evaluate_patches(patches: Patches, rows: I64, uv: F64) -> tuple[F64, F64]:
    """Position and normal (not unit) of patches, float64[n, 16, 3] each; of Gregory patches right on their edges only."""
    net = patches.control_points[rows][..., :3].astype(np.float64)
    along_u, along_v = np.diff(net, axis=1), np.diff(net, axis=2)
    acc = patches.tangent_id[rows]
    b = [_bernstein(3, t) for t in uv.T]
    q = [_bernstein(2, t) for t in uv.T]
    du, dv = _sum(q[0], b[1], along_u), _sum(b[0], q[1], along_v)
    at = np.flatnonzero(acc >= 0)
    du[at] = _sum(q[0], b[1], patches.tangent_u[acc[at]].astype(np.float64))
    dv[at] = _sum(b[0], q[1], patches.tangent_v[acc[at]].astype(np.float64))
    return _sum(b[0], b[1], net), np.cross(du, dv)


def _limit_after_steps(model: Model, uv: F64) -> F64:
    """Limit positions of all samples, float64[n, 16, 3]: those of vertices after three steps, as samples lie at eighths."""
    points, cage = model.vertices, model.cage
    face, at = np.repeat(model.patch[:, None], len(uv), axis=1), np.repeat(uv[None], len(model.patch), axis=0)
    topology, _ = make_topology(cage)
    steps = (
        3 if (np.diff(cage.face_first) == 4).all() else 4
    )  # the first one of polygons makes the quads of the samples
    for k in range(steps):
        points, cage = move_points(make_step(topology), points), refine_cage(cage, topology)
        topology, _ = make_topology(cage)
        if k >= steps - 3:
            face, at = child_of(face, at)
    corner = np.where(at[..., 0] == 0, np.where(at[..., 1] == 0, 0, 3), np.where(at[..., 1] == 0, 1, 2))
    return multiply(position_rows(topology, make_rings(topology)), points)[topology.vertex[4 * face + corner]]


def child_of(face: I64, uv: F64) -> tuple[I64, F64]:
    """Quads and parameters after a Catmull-Clark step of points uv (..., 2) of quads `face` (...)."""
    x, y = uv[..., 0] > 0.5, uv[..., 1] > 0.5
    k = np.where(x, np.where(y, 2, 1), np.where(y, 3, 0))
    u, v = 2 * np.where(x, 1 - uv[..., 0], uv[..., 0]), 2 * np.where(y, 1 - uv[..., 1], uv[..., 1])
    turned = (k == 1) | (k == 3)  # the child's u runs along the edge that leaves its corner
    return 4 * face + k, np.stack([np.where(turned, v, u), np.where(turned, u, v)], axis=-1)


def _bernstein(degree: int, t: F64) -> F64:
    k, choose = np.arange(degree + 1), np.array([[1, 2, 1], [1, 3, 3, 1]][degree - 2])
    return choose * t[:, None] ** k * (1.0 - t[:, None]) ** (degree - k)


def _sum(a: F64, b: F64, nets: F64) -> F64:
    return np.einsum("si,sj,pijc->psc", a, b, nets)


def _check_model(model: Model, uv: F64, basis: Basis) -> dict[str, Any]:
    try:
        surface, _ = make_surface(model.cage, basis)
    except TopologyFault as fault:
        raise TilerError(f"reference: model {model.name} is no surface: {fault}") from None
    vertices: F32 = model.vertices.astype(np.float32)
    patches = hull.surface_patches(surface, vertices, 0, 0)
    position, normal = evaluate_patches(patches, model.patch, uv)
    size, diagonal = float(abs(model.vertices).max()), float(np.linalg.norm(np.ptp(model.vertices, axis=0)))
    regular = (surface.irregular_id[model.patch] < 0)[:, None]
    ends = (uv == 0) | (uv == 1)
    corner, edge = ends.all(axis=1)[None], ends.any(axis=1)[None]
    off = np.linalg.norm(position - model.position, axis=2)
    exact = regular | corner
    near = ~exact & (edge | (basis == Basis.ACC))
    far = PUBLISHED.get((model.name, basis), np.inf)
    refined = np.linalg.norm(_limit_after_steps(model, uv) - model.position, axis=2)
    wrong = ~(off <= 4 * U * size) & exact | ~(off / diagonal <= far) & near | ~(refined <= 4 * U * size)
    # Two tangents, each a difference of points that are rounded twice.
    net = patches.control_points[model.patch][..., :3].astype(np.float64)
    legs = [np.linalg.norm(np.diff(net, axis=axis), axis=3).max(axis=(1, 2)) for axis in (1, 2)]
    length = np.linalg.norm(normal, axis=2)
    with np.errstate(all="ignore"):
        turned = np.linalg.norm(normal / length[..., None] - model.normal, axis=2)
        allowed = 24 * U * size * np.maximum(*legs)[:, None] / length + 4 * U
    known = np.isfinite(model.normal).all(axis=2) & (regular | (corner & (basis == Basis.ACC)))
    wrong_normal = known & ~(turned <= allowed)
    bad = np.flatnonzero((wrong | wrong_normal).any(axis=1))
    return {
        "model": model.name,
        "basis": basis.name.lower(),
        "cases": len(model.patch),
        "failed": len(bad),
        "limit_error": _most(np.where(exact, off / diagonal, 0)),
        "approximation_error": _most(np.where(near, off / diagonal, 0)),
        "normal_error": _most(np.where(known, turned, 0)),
        "patches": [int(p) for p in model.patch[bad[:KEPT]]],
    }


def _most(values: F64) -> float:
    return float(values.max(initial=0.0))
