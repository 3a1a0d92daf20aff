"""The creature's walk: a key every three frames of a walk in lateral sequence, two cycles of 48 frames, along +x.

Legs swing as pendulums, knees bend while a leg is carried forward, feet turn back towards level, the tail sways and the
head nods. It is meant to look alive and to move every control point, not to be good anatomy: feet slip a little.
"""

from typing import NamedTuple

import numpy as np

from pipeline.types import F32, F64
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.creature import BONES, LEGS, TRUNK, Parameters, build_with_weights
from tiler.scene.rounding import STEP, cos_turns, sin_turns
from tiler.scene.skinning import Skinning, strongest_four

CYCLE = 48  # frames
KEY_EVERY = 3  # frames
FRAMES = 96
STRIDE = 2.4  # world units a cycle
SWING = 0.05  # turns that a thigh swings to either side
BEND = 0.10  # turns that a knee bends
PHASE = {"hind left": 0.0, "front left": 0.25, "hind right": 0.5, "front right": 0.75}

Matrix = list[list[float]]  # three rows of four, column vectors


class Joint(NamedTuple):
    """Where a bone turns: its parent, and the point at rest."""

    parent: str | None
    pivot: tuple[float, float, float]


def build_walking(parameters: Parameters) -> tuple[ControlMesh, Skinning]:
    """The creature at rest, and its walk."""
    mesh, weights = build_with_weights(parameters)
    index, weight = strongest_four(weights)
    frames = np.arange(0, FRAMES + 1, KEY_EVERY)
    transforms = np.array([_pose(float(frame) / CYCLE) for frame in frames])
    return mesh, Skinning(index, weight, _rounded(transforms), frames.astype(np.float32))


def _rounded(values: F64) -> F32:
    return (np.rint(values / STEP) * STEP).astype(np.float32)


def _joints() -> dict[str, Joint]:
    """Every bone after its parent."""
    joints = {
        "body": Joint(None, (0.0, 0.0, 2.0)),
        "neck": Joint("body", (2.1, 0.0, 2.5)),
        "head": Joint("neck", (2.85, 0.0, 3.5)),
        "tail": Joint("body", (-1.9, 0.0, 2.1)),
        "tip": Joint("tail", (-3.4, 0.0, 1.33)),
    }
    along = {ring.name: k for k, ring in enumerate(TRUNK)}
    for leg, (behind, rings, side) in LEGS.items():
        hip = (TRUNK[along[behind]].x + TRUNK[along[behind] + 1].x) / 2
        upper, lower = rings[0], rings[1]
        joints[f"{leg} thigh"] = Joint("body", (hip, 0.9 * side, 1.85))
        knee = (hip + (upper.x + lower.x) / 2, upper.y * side, (upper.z + lower.z) / 2)
        joints[f"{leg} shin"] = Joint(f"{leg} thigh", knee)
        joints[f"{leg} foot"] = Joint(f"{leg} shin", (hip + lower.x, lower.y * side, lower.z / 2))
    return joints


def _pose(cycles: float) -> list[Matrix]:
    """The bones' transforms after so many cycles, in the order of BONES."""
    sway = sin_turns(cycles)
    bob = 0.03 * cos_turns(2 * cycles)
    turns = {
        "body": _moved((STRIDE * cycles - STRIDE, 0.0, bob)),
        "neck": _turned_y(0.008 * cos_turns(2 * cycles)),
        "head": _turned_y(-0.012 * cos_turns(2 * cycles + 0.1)),
        "tail": _turned_z(0.035 * sway),
        "tip": _turned_z(0.05 * sin_turns(cycles - 0.15)),
    }
    for leg, phase in PHASE.items():
        p = cycles + phase
        swing = -SWING * sin_turns(p)
        bend = BEND * max(0.0, cos_turns(p))
        turns[f"{leg} thigh"] = _turned_y(swing)
        turns[f"{leg} shin"] = _turned_y(bend)
        turns[f"{leg} foot"] = _turned_y(-0.7 * (swing + bend))
    placed: dict[str, Matrix] = {}
    for bone, joint in _joints().items():
        own = _about(turns[bone], joint.pivot)
        placed[bone] = own if joint.parent is None else _times(placed[joint.parent], own)
    return [placed[bone] for bone in BONES]


def _moved(offset: tuple[float, float, float]) -> Matrix:
    return [[float(r == c) for c in range(3)] + [offset[r]] for r in range(3)]


def _turned_y(turns: float) -> Matrix:
    """Rotation about y; a leg below its pivot goes back with positive turns."""
    c, s = cos_turns(turns), sin_turns(turns)
    return [[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0]]


def _turned_z(turns: float) -> Matrix:
    c, s = cos_turns(turns), sin_turns(turns)
    return [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]


def _about(matrix: Matrix, pivot: tuple[float, float, float]) -> Matrix:
    """The same motion with its origin at `pivot`."""
    back = (-pivot[0], -pivot[1], -pivot[2])
    return _times(_times(_moved(pivot), matrix), _moved(back))


def _times(a: Matrix, b: Matrix) -> Matrix:
    """First b, then a."""
    return [
        [a[r][0] * b[0][c] + a[r][1] * b[1][c] + a[r][2] * b[2][c] + (a[r][3] if c == 3 else 0.0) for c in range(4)]
        for r in range(3)
    ]
