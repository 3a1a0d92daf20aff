"""The papers' models, where the user has them, and the scenes of ours that stand in where not.

The models are not ours to ship; `--models DIR` names a folder that holds some of these files.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tiler.errors import TilerError
from tiler.reproduce.item import Context
from tiler.scene import load_scene
from tiler.scene.model import Scene


class Model(NamedTuple):
    """A model of a paper."""

    file: str  # its file in the folder of models
    stand_in: str  # built-in scene of the same character
    displacement: Mapping[str, Any] | None = None  # keys of object.displacement; `map` is a file of the folder
    note: str = ""


FROG_HEIGHT = 2.0  # world units from black to white; the model is 62 units long
MODELS = {
    "monsterfrog": Model(
        "monsterfrog.obj", "creature",
        {
            "map": "monsterfrog_normal_height.png", "channel": "a",
            "scale": FROG_HEIGHT, "bias": -FROG_HEIGHT * 128 / 255,  # 128 of 255 is no displacement
        },
        "displaced by the alpha channel of its map",
    ),
    "bigguy": Model("bigguy.obj", "creature"),
    "bigguy_bezier": Model("bigguy_bezier_3570.npz", "creature", note="3570 Bézier patches"),
    "animated_head": Model("animated_head.obj", "creature"),
}  # fmt: skip


class Opened(NamedTuple):
    """What runs in an item."""

    name: str  # of the model or of the scene in its place
    scene: Scene
    told: str  # a sentence for the page
    original: bool  # whether it is the paper's model


def check_models(folder: Path | None) -> None:
    """Raise TilerError for a folder that holds none of the models."""
    if folder is None:
        return
    files = sorted({model.file for model in MODELS.values()})
    if not folder.is_dir() or not any((folder / file).is_file() for file in files):
        raise TilerError(
            f"models: {folder} is not allowed; allowed: a folder that holds one or more of {', '.join(files)}"
        )


def model_files(folder: Path) -> list[Path]:
    """The files of a folder that items may read."""
    named = {model.file for model in MODELS.values()}
    named |= {model.displacement["map"] for model in MODELS.values() if model.displacement is not None}
    return [folder / file for file in sorted(named) if (folder / file).is_file()]


def open_model(context: Context, name: str, **settings: Any) -> Opened:
    """The paper's model as a scene, or the scene that stands in for it. settings : as for `load_scene`. Raises TilerError."""
    model = MODELS[name]
    wanted = [model.file, *([model.displacement["map"]] if model.displacement is not None else [])]
    if context.models is None or not all((context.models / file).is_file() for file in wanted):
        scene = load_scene(model.stand_in, **settings)
        told = f"The built-in scene `{scene.name}` ran in place of {name} (`{model.file}` was not given by `--models`)."
        return Opened(scene.name, scene, told, False)
    displacement = None
    if model.displacement is not None:
        displacement = {**model.displacement, "map": str(context.models / model.displacement["map"])}
    scene = load_scene(context.models / model.file, displacement=displacement, **settings)
    note = f", {model.note}" if model.note else ""
    return Opened(name, scene, f"{name} is `{model.file}`{note}: {scene.num_patches:,} patches.", True)
