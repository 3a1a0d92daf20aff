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
CLAMPED = "taylor_clamped"  # TAYLOR with the normal's components cut to [-1, 1]; ours, beside the paper's five


class Subject(NamedTuple):
    """A scene of a figure."""

    name: str  # as the figure names it
    scene: Scene
    told: str  # a line for the page


class Extent(NamedTuple):
    """What heights are told in; measured once, as the stage of a scene with large maps takes a second."""

    side: float  # mean length of the patches' sides, world units
    top: float  # largest displacement, world units


def extent_of(scene: Scene) -> Extent:
    """Mean patch side and largest displacement at the first frame."""
    stage = stage_of(scene)
    return Extent(float(side_lengths(stage.patches).mean()), float(np.abs(stage.pyramids.whole).max(initial=0.0)))


def with_height(scene: Scene, extent: Extent, sides: float) -> Scene:
    """The scene with its maps scaled so that the largest displacement is `sides` mean patch sides."""
    factor = sides * extent.side / extent.top
    return replace(scene, maps=tuple(replace(m, scale=m.scale * factor, bias=m.bias * factor) for m in scene.maps))


def with_constant(scene: Scene, extent: Extent, sides: float) -> Scene:
    """The scene with a constant displacement of `sides` mean patch sides on every patch, in place of its maps."""
    one = DisplacementMap(np.ones((2, 2), np.float32), scale=sides * extent.side)
    meshes = tuple(replace(mesh, map_id=0) for mesh in scene.meshes)
    return replace(scene, maps=(one,), map_id=np.zeros_like(scene.map_id), meshes=meshes)


def subjects(context: Context) -> list[Subject]:
    """The scenes of Figure 6, or those in their place. Raises TilerError."""
    frog, head = open_model(context, "monsterfrog"), open_model(context, "animated_head")
    log = load_scene("spikelog")
    found = [
        Subject(frog.name, frog.scene, frog.told),
        Subject("spikelog", log, "Spikelog is our own log of the paper's 96 patches, as theirs was not published."),
        Subject(
            f"{head.name},\nconstant", with_constant(head.scene, extent_of(head.scene), 1.0),
            f"{head.told} It takes the place of SubD11's character, under a constant displacement of one patch side.",
        ),
    ]  # fmt: skip
    if frog.original:
        ours = load_scene("creature")
        found.append(
            Subject("creature", ours, "The built-in scene `creature` ran in place of Killeroo, also beside the frog.")
        )
    else:
        found[0] = found[0]._replace(told=f"{frog.told} It stands for Killeroo, too.")
    return found


def frog(context: Context) -> Opened:
    """The MonsterFrog, or what stands in for it."""
    return open_model(context, "monsterfrog")
