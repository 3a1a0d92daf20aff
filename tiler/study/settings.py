"""What of a scene a study may set: keys as scene files have them, checked by the classes that check scene files.

A setting is applied to the loaded scene, so it works for scenes of any source. `displacement.*` is set on all maps.
"""

import functools
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from pydantic import ValidationError, create_model

from tiler.errors import TilerError
from tiler.scene import schema
from tiler.scene.model import CameraPath, DisplacementMap, Picture, Scene, Tessellation
from tiler.scene.problems import problems_of, shown
from tiler.scene.strict import Strict

_TABLES: dict[str, tuple[type[Strict], type]] = {
    "picture": (schema.PictureFile, Picture),
    "tessellation": (schema.TessellationFile, Tessellation),
    "displacement": (schema.DisplacementFile, DisplacementMap),
    "camera": (schema.CameraFile, CameraPath),
    "": (schema.SceneFile, Scene),
}
_WHOLE_SCENE = ("face_cull", "light")  # keys of the scene file's top that are plain values
_SIZE = '[width, height] or a text such as "1920x1080"'
_EXCLUDE = (("tessellation.factor", "tessellation.edge_pixels"), ("picture.size", "picture.width"))


@functools.cache
def setting_names() -> list[str]:
    """All keys that a study may set on a scene."""
    names = [f"{table}.{name}" if table else name for table in _TABLES for name in _model(table).model_fields]
    return ["picture.size", *names]


def check_setting(key: str, value: Any) -> Any:
    """The value as plain data, if the key allows it. Raises TilerError (without the key's name) otherwise."""
    value = plain(value)
    _checked(key, value)
    return value


def clashes(keys: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of keys that may not stand side by side."""
    return [pair for pair in _EXCLUDE if all(key in keys for key in pair)]


def apply_settings(scene: Scene, settings: Mapping[str, Any]) -> Scene:
    """The scene with the settings in place of its own values. Raises TilerError for a value that is not allowed."""
    given: dict[str, dict[str, Any]] = {}
    for key, value in settings.items():
        try:
            given.setdefault(_split(key)[0], {}).update(_checked(key, value))
        except TilerError as error:
            raise TilerError(f"{key}: {error}") from None
    changed: dict[str, Any] = dict(given.pop("", {}))
    for table, values in given.items():
        if table == "displacement":
            if not scene.maps:
                raise TilerError(f"displacement: scene {scene.name!r} has no displacement that could be set")
            changed["maps"] = tuple(replace(each, **values) for each in scene.maps)
            continue
        if table == "tessellation" and "factor" in values:
            values = {"edge_pixels": None} | values  # fixed factors stand in place of wished lengths
        changed[table] = replace(getattr(scene, table), **values)
    scene = replace(scene, **changed)
    if not scene.camera.near < scene.camera.far:
        raise TilerError(
            f"camera.near: {scene.camera.near:g} is not nearer than far = {scene.camera.far:g}; allowed: near < far"
        )
    return scene


def plain(value: Any) -> Any:
    """NumPy's numbers and tuples as Python's numbers and lists; other values as they are."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _checked(key: str, value: Any) -> dict[str, Any]:
    """Fields of the dataclass that `key` sets, with the checked values."""
    table, name = _split(key)
    if key == "picture.size":
        width, height = _parse_size(value)
        return _checked("picture.width", width) | _checked("picture.height", height)
    model = _model(table)
    try:
        return {name: getattr(model.model_validate({name: value}), name)}
    except ValidationError as error:
        raise TilerError("; ".join(problem.text for problem in problems_of(error, model))) from None


def _split(key: str) -> tuple[str, str]:
    table, _, name = key.rpartition(".")
    return table, name


def _parse_size(value: Any) -> tuple[int, int]:
    parts: Any = value.lower().split("x") if isinstance(value, str) else value
    if isinstance(value, str) and all(part.isdigit() and len(part) < 10 for part in parts):
        parts = [int(part) for part in parts]
    if isinstance(parts, list) and len(parts) == 2 and all(type(part) is int for part in parts):
        return parts[0], parts[1]
    raise TilerError(f"{shown(value)} is not allowed; allowed: {_SIZE}")


@functools.cache
def _model(table: str) -> type[Strict]:
    """A class with those fields of a scene file's table that are plain values of the scene, none of them needed."""
    described, made = _TABLES[table]
    kept = _WHOLE_SCENE if table == "" else {field.name for field in fields(made)}
    chosen = {name: (info.annotation, info) for name, info in described.model_fields.items() if name in kept}
    chosen.pop("key", None)
    return create_model(table or "scene", __base__=Strict, **chosen)  # type: ignore[call-overload]
