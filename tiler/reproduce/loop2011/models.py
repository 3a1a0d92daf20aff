"""The models that the back-patch tests are counted on."""

from dataclasses import replace
from typing import NamedTuple

from tiler.reproduce.item import Context
from tiler.reproduce.models import MODELS, open_model
from tiler.reproduce.plain import Ball, ball_of, plain_scene
from tiler.scene import load_scene
from tiler.scene.model import Scene
from tiler.scene.surfaces import read_surface

TESTS = ("tcone", "ncone", "tangent_plane")  # the paper's TCONE, NCONE, and its own
PUBLISHED = {  # Table 1: per cent culled, 10,000 views
    "bigguy": (35.3, 44.8, 48.4),
    "monsterfrog": (37.0, 44.2, 47.9),
}
KNOWN = {  # an independent implementation, the smallest cones, eyes on a sphere of 1.2 bounding radii
    "bigguy": (37.1, 45.1, 48.8),
    "monsterfrog": (37.2, 43.6, 47.3),
}


class Subject(NamedTuple):
    """A model of patches that nothing displaces."""

    name: str
    scene: Scene  # plain
    ball: Ball
    up: tuple[float, float, float]
    told: str  # a sentence for the page
    stands_for: str | None  # model of the paper whose rates are published; None for more of ours
    original: bool


def subjects(context: Context, most: int = 3) -> list[Subject]:
    """The paper's models that the user has, else scenes of ours; at most so many."""
    found = [_bigguy(context)]
    if _has(context, "monsterfrog"):
        found.append(_frog(context))
    if not found[0].original and len(found) == 1:
        for name, told in (
            ("creature_small", "its cage of few patches"),
            ("teapot", "Newell's patches, collapsed edges"),
        ):
            scene = load_scene(name)
            made = _subject(name, scene, f"`{name}`, {told}: {scene.num_patches:,} patches.", None, False)
            found.append(made)
    return found[:most]


def _has(context: Context, name: str) -> bool:
    return context.models is not None and (context.models / MODELS[name].file).is_file()


def _subject(name: str, scene: Scene, told: str, stands_for: str | None, original: bool) -> Subject:
    plain = plain_scene(scene)
    up = (0.0, 1.0, 0.0) if original else scene.camera.up
    return Subject(name, plain, ball_of(plain), up, told, stands_for, original)


def _bigguy(context: Context) -> Subject:
    opened = open_model(context, "bigguy_bezier")
    name = "bigguy" if opened.original else opened.name
    return _subject(name, opened.scene, opened.told, "bigguy", opened.original)


def _frog(context: Context) -> Subject:
    """MonsterFrog after one Catmull-Clark step, which gives the 5,168 patches that the paper counts."""
    assert context.models is not None
    file = context.models / MODELS["monsterfrog"].file
    scene = load_scene(file)
    surface, vertices, _, _ = read_surface(file, "acc", "uniform", False)
    scene = replace(scene, meshes=(replace(scene.meshes[0], surface=surface, vertices=vertices),))
    told = f"monsterfrog is `{file.name}` after one Catmull-Clark step, without its map: {scene.num_patches:,} patches."
    return _subject("monsterfrog", scene, told, "monsterfrog", True)
