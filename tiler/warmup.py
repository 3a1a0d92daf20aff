"""Compile every kernel once, on a picture of a few pixels, so that what follows is not slowed down by it."""

from dataclasses import replace

from tiler.config import Machine
from tiler.scene import load_scene
from tiler.scene.model import Scene, Tessellation
from tiler.simulation import simulate


def warm_up() -> None:
    """Run all kernels in the types that every scene uses; a second or less once they are in the disk cache."""
    scene = load_scene("teapot", size=(16, 16), samples=4)
    simulate(_few_patches(scene), Machine(binning="patch"), threads=1)


def _few_patches(scene: Scene) -> Scene:
    return replace(
        scene,
        control_points=scene.control_points[:2],
        texcoords=scene.texcoords[:2],
        map_id=scene.map_id[:2],
        object_id=scene.object_id[:2],
        tessellation=Tessellation(edge_pixels=4.0),
    )
