"""Compile every kernel once, on a picture of a few pixels, so that what follows is not slowed down by it."""

from collections.abc import Iterable
from dataclasses import replace

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.config import Machine
from tiler.scene import load_scene
from tiler.scene.model import Scene, Tessellation
from tiler.shared import Shared
from tiler.simulation import simulate


def warm_up(machines: Iterable[Machine] = (), shared: Shared | None = None) -> None:
    """Run every kernel of a frame, and all that the machines take besides; every bound and cull test by default.

    shared : as in `simulate`, for machines whose frames will share stages. A second or less for a machine once its kernels are
    in the disk cache.
    """
    scene = _few_patches(load_scene("teapot", size=(16, 16), samples=4))
    chosen = list(machines) or [
        Machine(binning="triangle"),
        *(Machine(bounds=name) for name in BOUNDS),
        *(Machine(cull=(name,)) for name in CULL_TESTS),
    ]
    for machine in chosen:
        plain = machine.model_copy(update={"verify": False, "queue_pool": None})
        # Frame 1 has a last frame, which some machines draw too.
        simulate(scene, plain, frame=1, threads=1, shared=shared)


def _few_patches(scene: Scene) -> Scene:
    return replace(
        scene,
        control_points=scene.control_points[:2],
        texcoords=scene.texcoords[:2],
        map_id=scene.map_id[:2],
        object_id=scene.object_id[:2],
        tessellation=Tessellation(edge_pixels=4.0),
    )
