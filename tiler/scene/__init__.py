"""Scenes: what is drawn. `load_scene` reads a built-in name or a scene file; `scene_names` lists the built-in ones."""

from tiler.scene.catalog import load_scene, scene_names
from tiler.scene.model import Scene

__all__ = ["Scene", "load_scene", "scene_names"]
