"""What the figures on tightness look at: the paper's scenes, or ours in their place; and how high they are displaced.

Heights are told in mean patch sides (the mean length of a patch's sides), so that they compare between models.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pipeline.bounds.refine import side_lengths
from tiler.quality import stage_of
from tiler.reproduce.item import Context
from tiler.reproduce.models import Opened, open_model
from tiler.scene import load_scene
from tiler.scene.model import DisplacementMap, Scene

ALGORITHMS = ("cbox", "obbtex", "tpatch", "npatch", "taylor")


class Subject(NamedTuple):
    """A scene of a figure."""

    name: str  # as the figure names it
    scene: Scene
    told: str  # a line for the page


def patch_side(scene: Scene) -> float:
    """Mean length of the patches' sides, world units."""
    return float(side_lengths(stage_of(scene).patches).mean())


def with_height(scene: Scene, sides: float) -> Scene:
    """The scene with its maps scaled so that the largest displacement is `sides` mean patch sides."""
    top = float(np.abs(stage_of(scene).pyramids.whole).max())
    factor = sides * patch_side(scene) / top
    return replace(scene, maps=tuple(replace(m, scale=m.scale * factor, bias=m.bias * factor) for m in scene.maps))


def with_constant(scene: Scene, sides: float) -> Scene:
    """The scene with a constant displacement of `sides` mean patch sides on every patch, in place of its maps."""
    one = DisplacementMap(np.ones((2, 2), np.float32), scale=sides * patch_side(scene))
    meshes = tuple(replace(mesh, map_id=0) for mesh in scene.meshes)
    return replace(scene, maps=(one,), map_id=np.zeros_like(scene.map_id), meshes=meshes)


def subjects(context: Context) -> list[Subject]:
    """The scenes of Figure 6, or those in their place. Raises TilerError."""
    frog, head = open_model(context, "monsterfrog"), open_model(context, "animated_head")
    log = load_scene("spikelog")
    found = [
        _subject(frog.name, frog.scene, frog.told),
        _subject("spikelog", log, "Spikelog is our own log of the paper's 96 patches, as theirs was not published."),
        _subject(
            f"{head.name},\nconstant", with_constant(head.scene, 1.0),
            f"{head.told} It takes the place of SubD11's character, under a constant displacement of one patch side.",
        ),
    ]  # fmt: skip
    if frog.original:
        ours = load_scene("creature")
        found.append(
            _subject("creature", ours, "The built-in scene `creature` ran in place of Killeroo, also beside the frog.")
        )
    else:
        found[0] = found[0]._replace(told=f"{frog.told} It stands for Killeroo, too.")
    return found


def frog(context: Context) -> Opened:
    """The MonsterFrog, or what stands in for it."""
    return open_model(context, "monsterfrog")


def _subject(name: str, scene: Scene, told: str) -> Subject:
    return Subject(name, scene, told)
