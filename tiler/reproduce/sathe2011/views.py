"""The model, and views of it of which a given part is outside; machines with and without the cull."""

from typing import NamedTuple

import numpy as np

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from pipeline.types import B1, F64
from tiler.bench.stages import hull_stage
from tiler.config import Machine
from tiler.reproduce.item import Context
from tiler.reproduce.models import open_model
from tiler.reproduce.plain import Ball, ball_of, plain_scene, view_from
from tiler.scene.model import Scene

BOUND = "max_displacement"  # the paper's: the box of the control points, grown by the patch's largest displacement
MACHINES = {
    "none": Machine(binning="triangle", cull=()),
    BOUND: Machine(binning="triangle", bounds=BOUND, cull=("frustum",)),
    "tpatch": Machine(binning="triangle", bounds="tpatch", cull=("frustum",)),
}
SIZE, QUICK_SIZE = (960, 540), (320, 180)
DISTANCE = 3.9  # bounding radii: from 1 / sin(FOV / 2) = 3.86 on the whole sphere is in the picture
TOWARDS = {"y": (0.5, 0.35, 0.8), "z": (0.5, -0.8, 0.35)}
STEPS = 14  # of the bisection
FAR_ENOUGH = 6.0  # radii sideways: nothing is left in the picture


class Subject(NamedTuple):
    """The model that stands in the views."""

    name: str
    scene: Scene  # displaced
    plain: Scene
    ball: Ball
    told: str

    @property
    def up(self) -> tuple[float, float, float]:
        """Axis that points up."""
        return self.scene.camera.up


def open_subject(context: Context) -> Subject:
    """Displaced Catmull-Clark patches: MonsterFrog where the user has it."""
    opened = open_model(context, "monsterfrog")
    plain = plain_scene(opened.scene)
    told = f"{opened.told} The paper's model is not named in what we know of it; these are Catmull-Clark patches, displaced."
    return Subject(opened.name, opened.scene, plain, ball_of(plain), told)


def moved_view(subject: Subject, shift: float, size: tuple[int, int], plain: bool = False) -> Scene:
    """The model from three quarters to the front, the camera moved sideways by `shift` bounding radii."""
    towards = np.array(TOWARDS["y" if subject.up[1] else "z"])
    towards /= np.sqrt((towards**2).sum())
    right = np.cross(np.array(subject.up), towards)
    target = subject.ball.center + shift * subject.ball.radius * right / np.sqrt((right**2).sum())
    eye: F64 = target + DISTANCE * subject.ball.radius * towards
    return view_from(subject.plain if plain else subject.scene, eye, target, subject.up, size)


def outside(scene: Scene) -> B1:
    """Whether the paper's cull drops each patch: bool[P]."""
    stage = hull_stage(scene)
    flags = np.zeros(scene.num_patches, np.uint8)
    CULL_TESTS["frustum"](stage, BOUNDS[BOUND](stage), flags)
    return flags != 0


def shift_for(subject: Subject, share: float, size: tuple[int, int]) -> float:
    """How far to the side the camera has to be, in bounding radii, to have this share of the patches outside."""
    if share == 0.0:
        return 0.0
    if share == 1.0:
        return FAR_ENOUGH
    low, high = 0.0, FAR_ENOUGH
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        if outside(moved_view(subject, middle, size)).mean() < share:
            low = middle
        else:
            high = middle
    return high
