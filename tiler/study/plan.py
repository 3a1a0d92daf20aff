"""A plan: a study that says nothing wrong, with its scenes seen once; it describes any of its rows."""

import hashlib
import json
from dataclasses import dataclass
from typing import Any

from tiler.study.grid import Grid
from tiler.study.rows import Job, sources
from tiler.study.views import ViewFile

AXES = ("scene", "view", "frame", "machine")  # every row has these; other columns are settings or fields of the machine


@dataclass(frozen=True)
class Plan:
    """What a study will do.

    scenes : where each scene is loaded from, and the digest of what it holds. machines : all fields of each machine, by
    name. text : the study as its author wrote it.
    """

    name: str
    seed: int
    text: str
    grid: Grid
    scenes: dict[str, dict[str, str]]
    machines: dict[str, dict[str, Any]]
    views: dict[str, ViewFile]

    def job(self, row: int) -> Job:
        """Full description of a row."""
        values = self.grid.values(row)
        view = values["view"]
        own = {name.removeprefix("machine."): value for name, value in values.items() if name.startswith("machine.")}
        return {
            "row": row,
            "scene": self.scenes[values["scene"]],
            "settings": {n: v for n, v in values.items() if n not in AXES and not n.startswith("machine.")},
            "view": self.views[view].described(f"{self.seed}/{view}"),
            "frame": values["frame"],
            "machine": self.machines[values["machine"]] | own,
        }

    def identity(self) -> str:
        """Digest of all rows and of the sources: a results file belongs to one of them."""
        used = {block.view for block in self.grid.blocks}
        whole = {
            "name": self.name,
            "seed": self.seed,
            "blocks": [
                [
                    b.scene,
                    b.view,
                    [[a.name, repr(a.values) if isinstance(a.values, range) else a.values] for a in b.axes],
                ]
                for b in self.grid.blocks
            ],
            "scenes": {name: scene["digest"] for name, scene in self.scenes.items()},
            "machines": self.machines,
            "views": {name: self.views[name].described(f"{self.seed}/{name}") for name in sorted(used)},
            "sources": sources(),
        }
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:32]


def row_key(job: Job) -> str:
    """Digest of a row's description and of the sources, the same wherever and whenever the row is run."""
    described = job | {"row": None, "scene": job["scene"]["digest"], "sources": sources()}
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:24]
