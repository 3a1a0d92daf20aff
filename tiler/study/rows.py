"""One row of a study, run by its description. Every engine runs this and nothing else, so all give the same numbers.

A job is plain data, fit for JSON: {"row", "scene": {"source", "digest"}, "settings", "view", "frame", "machine"}. So is a
result: {"row", "error", "seconds", "counters", "violations", "false_culls"}; a frame that fails has its error and nothing else.
"""

import functools
import json
import traceback
from pathlib import Path
from typing import Any

from pipeline.jit import source_digest
from tiler.animation import frame_key
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.scene import Scene, load_scene
from tiler.shared import Shared
from tiler.simulation import simulate
from tiler.study.settings import apply_settings
from tiler.study.views import Sphere, bounding_sphere, look

Job = dict[str, Any]
Result = dict[str, Any]

KEPT_SCENES = 2  # as loaded
KEPT_VARIANTS = 4  # with settings applied


@functools.cache
def sources() -> str:
    """Digest of all our sources that a row's numbers depend on, and of the Numba version."""
    return source_digest(Path(__file__).resolve())


def scene_digest(scene: Scene) -> str:
    """Digest of all that a scene holds."""
    return frame_key(scene, Machine(), 0)[:16]


class RowRunner:
    """Runs rows; keeps the scenes that it used last, and the stages of the last frame, since consecutive rows share them.

    `seconds` of a row are what it took here, beside its neighbours: less than alone.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._threads = threads
        self._loaded: dict[str, Scene] = {}
        self._variants: dict[str, tuple[Scene, Sphere | None]] = {}
        self._machines: dict[str, Machine] = {}
        self._frames: dict[str, tuple[Scene, float, Shared]] = {}

    def run(self, job: Job) -> Result:
        """Simulate a job's frame. An exception becomes the row's error; interrupts pass through."""
        try:
            scene, frame, shared = self._frame(job)
            made = simulate(scene, self._machine(job["machine"]), frame=frame, threads=self._threads, shared=shared)
        except Exception as error:
            return {"row": job["row"], "error": describe_error(error)}
        verified = made.machine.verify
        return {
            "row": job["row"],
            "error": None,
            "seconds": round(made.seconds, 6),
            "counters": dict(made.counters),
            "violations": len(made.violations) if verified else None,
            "false_culls": len(made.false_culls) if verified else None,
        }

    def _frame(self, job: Job) -> tuple[Scene, float, Shared]:
        """The scene as the job looks at it, the number of the frame, and what other machines have left of it."""
        key = json.dumps([job[name] for name in ("scene", "settings", "view", "frame")])
        if key not in self._frames:
            self._frames.clear()
            _keep(self._frames, 1, key, (*look(*self._variant(job), job["view"], job["frame"]), Shared()))
        return self._frames[key]

    def _variant(self, job: Job) -> tuple[Scene, Sphere | None]:
        around = job["view"]["kind"] != "path"
        key = json.dumps([job["scene"], job["settings"], around])
        if key not in self._variants:
            scene = apply_settings(self._scene(job["scene"]), job["settings"])
            _keep(self._variants, KEPT_VARIANTS, key, (scene, bounding_sphere(scene) if around else None))
        return self._variants[key]

    def _scene(self, wanted: dict[str, str]) -> Scene:
        source = wanted["source"]
        if source not in self._loaded:
            scene = load_scene(source)
            if scene_digest(scene) != wanted["digest"]:
                raise TilerError(f"scene: {source} is not the same here as where the study was begun")
            _keep(self._loaded, KEPT_SCENES, source, scene)
        return self._loaded[source]

    def _machine(self, fields: dict[str, Any]) -> Machine:
        key = json.dumps(fields)
        if key not in self._machines:
            _keep(self._machines, 1024, key, Machine(**fields))
        return self._machines[key]


def describe_error(error: BaseException) -> str:
    """One line for the table: what is wrong, and where in the sources if it is a bug of ours."""
    text = " ".join(str(error).split())[:1000]
    if isinstance(error, TilerError):
        return f"TilerError: {text}"
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{where}"


def _keep(kept: dict[str, Any], most: int, key: str, value: Any) -> None:
    while len(kept) >= most:
        kept.pop(next(iter(kept)))
    kept[key] = value
