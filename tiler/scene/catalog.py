"""Scenes by name or by file. `load_scene` is what users call; the built-in scenes are the files of one folder."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from tiler.errors import TilerError
from tiler.scene.model import Partitioning, Scene, Shading


class SceneSummary(NamedTuple):
    """What `tiler scenes` lists."""

    name: str
    title: str
    patches: int
    frames: int


def load_scene(
    source: str | Path,
    *,
    size: tuple[int, int] | None = None,
    samples: int | None = None,
    shading: Shading | None = None,
    factor: float | Sequence[float] | None = None,
    edge_pixels: float | None = None,
    partitioning: Partitioning | None = None,
    displacement: Mapping[str, Any] | None = None,
) -> Scene:
    """The scene of a built-in name, of a scene file (.toml), or of a model file (`model_scene`).

    source : a name of `scene_names()`; a Path, or a text that ends as a scene or model does or has a path separator, is a file.
    size : (width, height) of the picture, pixels. samples : 1 or 4.
    factor : all tessellation factors, or six (edges u=0, v=0, u=1, v=1, inside u, v).
    edge_pixels : wished length of an edge's segments on the screen, pixels; takes the place of fixed factors.
    displacement : of a model file, the keys of a scene file's table object.displacement.

    What is given here stands in place of what the file says, and is checked in the same way.
    Raises TilerError: it names the file, line and key, or the argument, the value, and what is allowed.
    """
    from tiler.scene import schema
    from tiler.scene.loader import build_scene, read_scene_file
    from tiler.scene.model_scene import is_model, model_scene
    from tiler.scene.overrides import override_picture, override_tessellation

    file = scene_path(source)
    if is_model(file):
        scene = model_scene(file, displacement)
        picture = override_picture(schema.PictureFile(), size, samples, shading)
        tessellation = override_tessellation(
            schema.TessellationFile(factor=(8.0,) * 6), factor, edge_pixels, partitioning
        )
        return replace(scene, picture=picture, tessellation=tessellation)
    if displacement is not None:
        raise TilerError(
            f"displacement: stands beside {file}, a scene; allowed: beside a model file, whose scene says nothing of it"
        )
    checked = read_scene_file(file)
    picture = override_picture(checked.scene.picture, size, samples, shading)
    tessellation = override_tessellation(checked.scene.tessellation, factor, edge_pixels, partitioning)
    return replace(build_scene(checked, file.stem), picture=picture, tessellation=tessellation)


def scene_names() -> list[str]:
    """Names of the built-in scenes, sorted."""
    return sorted(_files())


def scene_path(source: str | Path) -> Path:
    """The file of a scene or model. Raises TilerError for an unknown name; a file's existence is not checked."""
    from tiler.scene.model_scene import is_model

    if not isinstance(source, str | Path):
        raise TilerError(f"scene: {source!r} is not allowed; allowed: a name, or the path of a scene or model file")
    if (
        isinstance(source, Path)
        or source.endswith(".toml")
        or "/" in source
        or os.sep in source
        or is_model(Path(source))
    ):
        return Path(source)
    files = _files()
    if source in files:
        return files[source]
    raise TilerError(_unknown_scene(source, sorted(files)))


def scene_summaries() -> list[SceneSummary]:
    """Name, title, patches and frames of each built-in scene; nothing is built."""
    from tiler.scene.loader import count_patches, read_scene_file

    summaries = []
    for name, file in sorted(_files().items()):
        checked = read_scene_file(file)
        summaries.append(SceneSummary(name, checked.scene.title, count_patches(checked), checked.scene.frames))
    return summaries


def _files() -> dict[str, Path]:
    """File of each built-in scene.

    The folder is `_scenes` in an installed package, or `scenes` beside the package in a source tree or an editable
    install; the folder that TILER_SCENES names, if any, may add scenes of its own.
    """
    package = Path(__file__).resolve().parent.parent
    shipped = next((folder for folder in (package / "_scenes", package.parent / "scenes") if folder.is_dir()), None)
    added = os.environ.get("TILER_SCENES")
    folders = ([Path(added)] if added else []) + ([shipped] if shipped else [])
    return {file.stem: file for folder in folders for file in sorted(folder.glob("*.toml"))}


def _unknown_scene(name: str, known: list[str]) -> str:
    from tiler.scene.problems import did_you_mean

    if not known:
        return f"scene: {name!r} is unknown, and no built-in scenes were found; set TILER_SCENES to their folder"
    names = ", ".join(known)
    return (
        f"scene: {name!r} is unknown; allowed: {names}, or the path of a scene or model file{did_you_mean(name, known)}"
    )
