"""From all patches to those visible, and from all domain-shader invocations to the useful ones, by reason.

Each line is taken from what the lines above leave. What was drawn and is not visible is known of a machine with `blame`, or
where the scene is given; else the patches end with those that reach the tiles.
"""

from typing import NamedTuple

from tiler.blame import BLAME, Blame
from tiler.counters import DEFINITIONS, Counters

LOST = {
    "hs_culled_nonfinite": "not finite",
    "hs_culled_frustum": "culled by the frustum",
    "hs_culled_backface": "culled as back faces",
    "ts_culled_factor": "culled by a factor",
}


class Step(NamedTuple):
    """A line. kind : `all` (what there is), `lost` (taken away) or `left`. text : what it counts."""

    kind: str
    title: str
    value: int
    text: str


def patch_steps(counters: Counters, visible: int | None) -> list[Step]:
    """Patches by what became of them. visible : patches with a visible sample, where known."""
    steps = [Step("all", "patches", counters["ia_primitives"], DEFINITIONS["ia_primitives"].text)]
    steps += [Step("lost", title, counters[name], DEFINITIONS[name].text) for name, title in LOST.items()]
    alive = counters["ts_patches"]
    if visible is None:
        return [*steps, Step("left", "patches alive", alive, DEFINITIONS["ts_patches"].text)]
    hidden = (
        "Patches alive of which no sample is visible at the end of the frame: perfect knowledge would drop them too."
    )
    return [
        *steps,
        Step("lost", "alive, not visible", alive - visible, hidden),
        Step("left", "visible patches", visible, "Patches with a visible sample."),
    ]


def invocation_steps(counters: Counters, blame: Blame) -> list[Step]:
    """Domain-shader invocations by what they were for."""
    steps = [Step("all", "domain-shader invocations", counters["ds_invocations"], DEFINITIONS["ds_invocations"].text)]
    steps += [
        Step("lost", BLAME[name].title, value, BLAME[name].text)
        for name, value in blame.invocations.items()
        if name != "useful"
    ]
    useful = BLAME["useful"]
    return [*steps, Step("left", "useful invocations", blame.invocations["useful"], useful.text)]
