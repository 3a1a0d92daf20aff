"""The explorer's page: one HTML file, made of parts of reports and its own, that asks nothing but this server."""

from importlib.resources import files
from typing import Any, get_args

from tiler import __version__
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.explore.forms import machine_form, presets
from tiler.explore.requests import draft_size
from tiler.explore.tile_queue import FATES, MOST_ENTRIES
from tiler.report.collect import FIGURES
from tiler.report.maps import MAPS
from tiler.report.page import asset, one_file
from tiler.scene.camera import eye_and_target
from tiler.scene.model import Scene, Shading

REPORT_SCRIPTS = ("base.js", "table.js", "paint.js")
SCRIPTS = ("state.js", "stage.js", "forms.js", "look.js", "explore.js")


def make_explorer(scene: Scene, machine: Machine) -> tuple[str, str]:
    """The page, and the content security policy that it needs."""
    own = files("tiler.explore") / "assets"
    script = "".join(asset(name) for name in REPORT_SCRIPTS)
    script += "".join((own / name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = asset("report.css") + (own / "explore.css").read_text(encoding="utf-8")
    page, policy = one_file(
        f"{scene.name} · tilesim explorer", _data(scene, machine), style, script, "connect-src 'self'; "
    )  # fmt: skip
    return page.replace("<title>", '<link rel="icon" href="data:,">\n<title>', 1), policy  # or browsers ask for one


def _data(scene: Scene, machine: Machine) -> dict[str, Any]:
    """What does not change while the explorer runs."""
    picture, path = scene.picture, scene.camera
    eye, target = eye_and_target(path, 0)
    edge, factor = scene.tessellation.edge_pixels, scene.tessellation.factor
    return {
        "kind": "explorer",
        "title": scene.name,
        "about": scene.title,
        "version": __version__,
        "patches": scene.num_patches,
        "frames": scene.frames,
        "size": [picture.width, picture.height],
        "draft": draft_size(picture.width, picture.height),
        "samples": picture.samples,
        "shading": picture.shading,
        "shadings": get_args(Shading),
        "factor": f"edges of {edge:g} pixels"
        if edge is not None
        else ", ".join(f"{v:g}" for v in dict.fromkeys(factor)),
        "camera": {"eye": eye, "target": target, "up": path.up, "fov": path.fov},
        "form": machine_form(machine),
        "presets": presets(machine),
        "figures": FIGURES,
        "definitions": [{"name": name} | d._asdict() for name, d in DEFINITIONS.items()],
        "maps": {name: info._asdict() for name, info in MAPS.items()},
        "fates": {name: fate._asdict() for name, fate in FATES.items()},
        "most_entries": MOST_ENTRIES,
    }
