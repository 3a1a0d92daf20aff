"""A tile-based sort-middle rasterizer with the Direct3D 11 tessellation pipeline, simulated.

The names below are what users call; each is loaded at its first use, so that importing this package stays light.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tiler.config import Machine as Machine
    from tiler.errors import TilerError as TilerError
    from tiler.extensions import register_bound as register_bound
    from tiler.extensions import register_cull_test as register_cull_test
    from tiler.extensions import unregister as unregister
    from tiler.frame import Frame as Frame
    from tiler.glb import export_glb as export_glb
    from tiler.presets import load_machine as load_machine
    from tiler.report.write import write_report as write_report
    from tiler.scene import Scene as Scene
    from tiler.scene import load_scene as load_scene
    from tiler.scene import scene_names as scene_names
    from tiler.shared import Shared as Shared
    from tiler.simulation import simulate as simulate
    from tiler.study.results import load_study as load_study
    from tiler.study.run import sweep as sweep
    from tiler.trace.write import write_trace as write_trace

__version__ = "0.1.0"

_HOME = {
    "Frame": "tiler.frame",
    "Machine": "tiler.config",
    "Scene": "tiler.scene",
    "Shared": "tiler.shared",
    "TilerError": "tiler.errors",
    "export_glb": "tiler.glb",
    "load_machine": "tiler.presets",
    "load_scene": "tiler.scene",
    "load_study": "tiler.study.results",
    "register_bound": "tiler.extensions",
    "register_cull_test": "tiler.extensions",
    "scene_names": "tiler.scene",
    "simulate": "tiler.simulation",
    "sweep": "tiler.study.run",
    "unregister": "tiler.extensions",
    "write_report": "tiler.report.write",
    "write_trace": "tiler.trace.write",
}

__all__ = [
    "Frame",
    "Machine",
    "Scene",
    "Shared",
    "TilerError",
    "__version__",
    "export_glb",
    "load_machine",
    "load_scene",
    "load_study",
    "register_bound",
    "register_cull_test",
    "scene_names",
    "simulate",
    "sweep",
    "unregister",
    "write_report",
    "write_trace",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'tiler' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
