"""A creature of our own: four legs, a tail, a neck, a head with crest, brows and ears, plates along the back.

A cage of 194 quads is put together from a tube of six-cornered rings, tail to nose, out of which the limbs are pulled;
two Catmull-Clark steps make 3,104 quads of it, with valences 3 to 7. The small cage has the same build and 104 quads.
It stands on z = 0, looks along +x, its left is +y. Coordinates are multiples of 2^-16.

Texture coordinates lay the trunk and the legs flat, each cut along a line below; there the map `hide` is 0, so the two
sides of a seam agree (`tiler.scene.creature_hide`).
"""

from typing import Literal, NamedTuple

import numpy as np

from pipeline.types import F64, I64
from tiler.scene.cage import Cage, Uv, pulled, refine, strip_texcoords
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.rounding import STEP
from tiler.scene.strict import Strict, whole

BONES = ("body", "neck", "head", "tail", "tip") + tuple(
    f"{leg} {part}"
    for leg in ("front left", "front right", "hind left", "hind right")
    for part in ("thigh", "shin", "foot")
)
_UV_SCALE = 0.085  # texture space a world unit


class Ring(NamedTuple):
    """Six vertices of the trunk around the point x on its axis; heights are z, w is half the width."""

    name: str
    x: float
    w: float
    top: float
    middle: float
    bottom: float
    bones: dict[str, float]
    small: bool  # whether the small cage has it


TRUNK = [
    Ring("tip", -5.0, 0.14, 1.52, 1.42, 1.30, {"tip": 1}, True),
    Ring("tail 3", -4.2, 0.22, 1.38, 1.22, 1.06, {"tip": 1}, False),
    Ring("tail 2", -3.4, 0.34, 1.58, 1.33, 1.08, {"tip": 0.5, "tail": 0.5}, True),
    Ring("tail 1", -2.6, 0.52, 2.05, 1.70, 1.30, {"tail": 1}, False),
    Ring("rump", -1.9, 0.85, 2.55, 2.10, 1.45, {"body": 0.75, "tail": 0.25}, False),
    Ring("hip", -1.3, 1.15, 2.95, 2.20, 1.25, {"body": 1}, True),
    Ring("flank", -0.5, 1.15, 3.00, 2.15, 1.15, {"body": 1}, True),
    Ring("belly", 0.2, 1.10, 2.95, 2.10, 1.10, {"body": 1}, False),
    Ring("elbow", 0.8, 1.12, 2.95, 2.10, 1.15, {"body": 1}, True),
    Ring("chest", 1.6, 1.02, 2.98, 2.20, 1.30, {"body": 1}, True),
    Ring("nape", 2.2, 0.66, 3.15, 2.60, 1.85, {"body": 0.5, "neck": 0.5}, False),
    Ring("neck", 2.6, 0.50, 3.55, 3.10, 2.50, {"neck": 1}, True),
    Ring("skull", 3.0, 0.62, 4.05, 3.55, 2.95, {"neck": 0.25, "head": 0.75}, False),
    Ring("brow", 3.6, 0.66, 4.10, 3.55, 3.00, {"head": 1}, True),
    Ring("snout", 4.2, 0.50, 3.65, 3.35, 3.00, {"head": 1}, False),
    Ring("nose", 4.75, 0.40, 3.45, 3.25, 3.02, {"head": 1}, True),
]
# Faces of a trunk segment: which edge of the ring they start from.
LEFT_LOW, LEFT_HIGH, TOP, RIGHT_HIGH, RIGHT_LOW, BELOW = range(6)


class LegRing(NamedTuple):
    """Four vertices around the leg's axis: x from the hip, y outward, half widths along x and y."""

    x: float
    y: float
    z: float
    wx: float
    wy: float
    part: str


FRONT = [
    LegRing(0.02, 0.98, 1.35, 0.36, 0.30, "thigh"),
    LegRing(-0.16, 1.02, 0.62, 0.26, 0.22, "shin"),
    LegRing(0.02, 1.02, 0.0, 0.32, 0.30, "foot"),
]
HIND = [
    LegRing(0.12, 1.05, 1.30, 0.44, 0.34, "thigh"),
    LegRing(-0.30, 1.05, 0.70, 0.24, 0.22, "shin"),
    LegRing(-0.06, 1.05, 0.0, 0.32, 0.30, "foot"),
]
LEGS = {  # trunk ring behind the leg, and the leg's rings
    "front left": ("elbow", FRONT, 1),
    "front right": ("elbow", FRONT, -1),
    "hind left": ("hip", HIND, 1),
    "hind right": ("hip", HIND, -1),
}
_LEG_PLACES = dict(zip(LEGS, [(0.02, 0.8), (0.265, 0.8), (0.51, 0.8), (0.755, 0.8)], strict=True))


class Parameters(Strict):
    """How fine the creature is."""

    cage: Literal["full", "small"] = "full"
    steps: int = whole(2, 0, 3, " (Catmull-Clark steps)")


def num_faces(parameters: Parameters) -> int:
    """194 or 104 times 4 for each step."""
    return (194 if parameters.cage == "full" else 104) * 4**parameters.steps


def build(parameters: Parameters) -> ControlMesh:
    """The creature standing at rest."""
    return build_with_weights(parameters)[0]


def build_with_weights(parameters: Parameters) -> tuple[ControlMesh, F64]:
    """The creature, and how much each bone moves each vertex: (V, bones), rows that add up to 1 but for rounding."""
    cage = make_cage(parameters.cage)
    points, faces = np.array(cage.points), np.array(cage.faces, np.int64)
    texcoords = np.array(cage.texcoords)
    for _ in range(parameters.steps):
        points, faces, texcoords = refine(points, faces, texcoords)
    st, index = np.unique(texcoords.reshape(-1, 2), axis=0, return_inverse=True)
    mesh = ControlMesh(
        name="creature",
        vertices=(np.rint(points[:, :3] / STEP) * STEP).astype(np.float32),
        face_first=np.arange(len(faces) + 1, dtype=np.int32) * np.int32(4),
        face_vertices=faces.astype(np.int32).ravel(),
        texcoords=st.astype(np.float32),
        face_texcoords=index.astype(np.int32).ravel(),
        crease_edges=np.zeros((0, 2), np.int32),
        crease_sharpness=np.zeros(0, np.float32),
        corner_vertices=np.zeros(0, np.int32),
        corner_sharpness=np.zeros(0, np.float32),
    )
    return mesh, points[:, 3:]


def make_cage(kind: str) -> Cage:
    """The cage before any step; a vertex's row is x, y, z and its bones' weights."""
    rings = [ring for ring in TRUNK if kind == "full" or ring.small]
    cage = Cage()
    faces = _trunk(cage, rings)
    for leg in LEGS:
        _leg(cage, faces, leg, kind)
    _head(cage, faces, rings)
    if kind == "full":
        for name, height in (("tail 1", 0.30), ("hip", 0.42), ("elbow", 0.42), ("nape", 0.30)):
            face = faces[name, TOP]
            cage.extrude(face, pulled(cage.corners(face), (-0.15, 0.0, height), 0.45))
    return cage


def _trunk(cage: Cage, rings: list[Ring]) -> dict[tuple[str, int], int]:
    """The tube from tail to nose and its two ends; face numbers by the ring behind them and the edge of the ring."""
    rows = np.array([[_row((ring.x, y * ring.w, z), ring.bones) for y, z in _six(ring)] for ring in rings])
    numbers = [cage.add_ring(row) for row in rows]
    uv = strip_texcoords(rows[:, :, :3], (0.02, 0.28), _UV_SCALE, middle=2)
    faces = {}
    for r, ring in enumerate(rings[:-1]):
        for k in range(6):
            m = (k + 1) % 6
            vertices = (numbers[r][k], numbers[r][m], numbers[r + 1][m], numbers[r + 1][k])
            faces[ring.name, k] = cage.add_face(vertices, (uv[r][k], uv[r][k + 1], uv[r + 1][k + 1], uv[r + 1][k]))
    # An end is two quads that share the edge across, each laid flat beside the strip's end.
    for end, at, order in ((numbers[-1], (0.955, 0.20), 1), (numbers[0], (0.955, 0.32), -1)):
        for upper in (True, False):
            corners = ((1, 2, 3, 4) if upper else (0, 1, 4, 5))[::order]
            square = [(at[0] + s * 0.03, at[1] + t * 0.03 + 0.03 * upper) for s, t in _SQUARES[upper]][::order]
            cage.add_face([end[c] for c in corners], [_on_grid(uv) for uv in square])
    return faces


# (s, t) of the corners 1, 2, 3, 4 and 0, 1, 4, 5 of a ring's two quads; the edge 1-4 is at t = 0 of one, 1 of the other.
_SQUARES = {True: [(0, 0), (0, 1), (1, 1), (1, 0)], False: [(0, 0), (0, 1), (1, 1), (1, 0)]}


def _six(ring: Ring) -> list[tuple[float, float]]:
    """(y / w, z) of a ring's vertices: up on the left, down on the right."""
    return [
        (0.55, ring.bottom), (1.0, ring.middle), (0.5, ring.top), (-0.5, ring.top), (-1.0, ring.middle), (-0.55, ring.bottom),
    ]  # fmt: skip


def _leg(cage: Cage, faces: dict[tuple[str, int], int], leg: str, kind: str) -> None:
    """A leg out of the lower side of the trunk, and a foot out of the leg's front."""
    behind, rings, side = LEGS[leg]
    face = faces[behind, LEFT_LOW if side > 0 else RIGHT_LOW]
    base = cage.corners(face)
    hip = float(base[:, 0].sum() / 4)
    if kind == "small":
        rings = [rings[0], rings[2]]
    rows = [base] + [_leg_row(ring, hip, side, leg) for ring in rings]
    # The strip is cut along the corner at the leg's inner back, which is number 0 on the left and 1 on the right.
    cut = 0 if side > 0 else 1
    turned = np.roll(np.array([row[:, :3] for row in rows]), -cut, axis=1)
    uv = strip_texcoords(turned, _LEG_PLACES[leg], _UV_SCALE)
    for r in range(len(rings)):
        sides: list[list[Uv]] = []
        for j in range(4):
            k = (j - cut) % 4
            sides.append([uv[r][k], uv[r][k + 1], uv[r + 1][k + 1], uv[r + 1][k]])
        s, t = uv[-1][0][0] + 0.01, _LEG_PLACES[leg][1]
        sides.append([_on_grid((s + 0.05 * x, t + 0.05 * (y - 0.5))) for x, y in ((0, 0), (0, 1), (1, 1), (1, 0))])
        made = cage.extrude(face, rows[r + 1], sides)
    if kind == "full":
        front = cage.corners(made[2])
        toes = pulled(front, (0.34, 0.0, -0.06), 0.9)
        toes[:, 2] = np.where(front[:, 2] > 0.3, 0.30, 0.0)
        toes[:, 3:] = _weights({f"{leg} foot": 1})
        cage.extrude(made[2], toes)


def _leg_row(ring: LegRing, hip: float, side: int, leg: str) -> F64:
    """Four vertices in the order of the corners of the trunk's lower side faces."""
    inner, outer = ring.y - ring.wy, ring.y + ring.wy
    back, front = hip + ring.x - ring.wx, hip + ring.x + ring.wx
    near, far = (inner, outer) if side > 0 else (-outer, -inner)
    corners = [(back, near), (back, far), (front, far), (front, near)]
    return np.array([_row((x, y, ring.z), {f"{leg} {ring.part}": 1}) for x, y in corners])


def _head(cage: Cage, faces: dict[tuple[str, int], int], rings: list[Ring]) -> None:
    """Ears, brows and a crest out of five faces that meet at two vertices, whose valence becomes 7."""
    names = [ring.name for ring in rings]
    brow, behind = "brow", names[names.index("brow") - 1]
    for edge, side in ((LEFT_HIGH, 1), (RIGHT_HIGH, -1)):
        ear, eye = faces[behind, edge], faces[brow, edge]
        cage.extrude(ear, pulled(cage.corners(ear), (-0.25, 0.42 * side, 0.5), 0.45))
        cage.extrude(eye, pulled(cage.corners(eye), (0.05, 0.14 * side, 0.1), 0.6))
    crest = faces[behind, TOP]
    cage.extrude(crest, pulled(cage.corners(crest), (-0.35, 0.0, 0.45), 0.4))


def _row(point: tuple[float, float, float], bones: dict[str, float]) -> list[float]:
    return [*point, *_weights(bones)]


def _weights(bones: dict[str, float]) -> list[float]:
    return [float(bones.get(name, 0.0)) for name in BONES]


def _on_grid(uv: Uv) -> Uv:
    return round(uv[0] * 1024) / 1024, round(uv[1] * 1024) / 1024


def seam_segments(parameters: Parameters) -> F64:
    """Edges of the cage along which texture coordinates differ, (n, 2, 2) in texture space; each side is one."""
    cage = make_cage(parameters.cage)
    known: dict[tuple[int, int], tuple[Uv, Uv]] = {}
    for face, uv in zip(cage.faces, cage.texcoords, strict=True):
        for k in range(4):
            known[face[k], face[(k + 1) % 4]] = (uv[k], uv[(k + 1) % 4])
    return np.array([ends for (a, b), ends in known.items() if known[b, a] != ends[::-1]])


def quads_of(mesh: ControlMesh) -> I64:
    """Faces (F, 4) of a mesh of quads."""
    return mesh.face_vertices.reshape(-1, 4).astype(np.int64)
