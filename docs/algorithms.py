"""The tables of docs/algorithms.md: what each entry of `BOUNDS` and `CULL_TESTS` promises, costs, and where that is checked.

An entry without a line in `BOUND_FACTS` or `CULL_FACTS` fails the page's test: who adds an algorithm says what it is for.
"""

import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.costs import Operations, count_operations

ROOT = Path(__file__).resolve().parent.parent
ANY, CONE = "any direction", "cone of both tangents"
HOLDS, STAYS, LOSES, OFFSET, PLAIN = "holds", "stays", "may lose", "constant only", "without a map"


class BoundFacts(NamedTuple):
    """What a bound knows of the normal along which a patch is displaced, by kind of patch; all hold every kind."""

    source: str
    bezier: str
    rational: str
    acc: str
    gregory: str
    derived: str
    tested: str


class CullFacts(NamedTuple):
    """Of which surfaces a cull is right.

    HOLDS: a culled patch has nothing to show. STAYS: such patches are never culled. LOSES: a front-facing triangle may be lost.
    OFFSET: displaced by a constant, else STAYS. PLAIN: where there is no displacement, else STAYS.
    """

    source: str
    smooth: str
    tessellation: str
    displaced: str
    rational: str
    acc: str
    gregory: str
    derived: str
    tested: str


M10, S11, L11 = "Munkberg et al. 2010", "Sathe 2011", "Loop et al. 2011"

BOUND_FACTS = {
    "cbox": BoundFacts(f"{M10}, 3.1 and 5.1", ANY, ANY, ANY, ANY, "pipeline/bounds/cbox.py", "tests/test_bounds.py"),
    "max_displacement": BoundFacts(
        S11, ANY, ANY, ANY, ANY, "pipeline/bounds/cbox.py", "tests/test_box_bounds.py",
    ),
    "obbtex": BoundFacts(
        f"{M10}, 3.1.1, 3.2, 5.1", ANY, ANY, ANY, ANY, "pipeline/bounds/oriented.py", "tests/test_box_bounds.py",
    ),
    "tpatch": BoundFacts(
        f"{M10}, 3.2, eq. 13, 14", CONE, CONE, "cone of the tangent patches", ANY, "pipeline/bounds/cones.py",
        "tests/test_lane_bounds.py",
    ),
    "tpatch_tight": BoundFacts(
        "an extension of ours", f"{CONE}, by axis", f"{CONE}, by axis", "cone of the tangent patches, by axis", ANY,
        "pipeline/bounds/cones.py", "tests/test_lane_bounds.py",
    ),
    "npatch": BoundFacts(
        f"{M10}, 3.1.3, eq. 8 to 13", "cone of 36 normal vectors", "cone of normal vectors",
        "cone of the tangent patches' normal vectors", ANY, "pipeline/bounds/cones.py", "tests/test_single_bounds.py",
    ),
    "taylor": BoundFacts(
        f"{M10}, 3.4", "Taylor model of the unit normal", "unit box", "Taylor model of the unit normal", ANY,
        "pipeline/bounds/taylor.py", "tests/test_taylor.py",
    ),
    "taylor_clamped": BoundFacts(
        "an extension of ours", "the model, cut to the unit box", "unit box", "the model, cut to the unit box", ANY,
        "pipeline/bounds/taylor.py", "tests/test_taylor.py",
    ),
}  # fmt: skip

EVERY = (HOLDS,) * 6
CULL_FACTS = {
    "frustum": CullFacts(
        f"{S11}, without its division", *EVERY, "pipeline/culling/frustum.py", "tests/test_bounds.py",
    ),
    "frustum:world": CullFacts(
        "six planes", *EVERY, "pipeline/culling/frustum_planes.py", "tests/test_backface.py",
    ),
    "frustum:object": CullFacts(
        "six planes, one box an object", *EVERY, "pipeline/culling/frustum_planes.py", "tests/test_backface.py",
    ),
    "backface:ncone": CullFacts(
        "Shirman and Abi-Ezzi 1993, section 4", HOLDS, LOSES, OFFSET, PLAIN, PLAIN, STAYS,
        "pipeline/culling/ncone.py", "tests/test_backface.py",
    ),
    "backface:tcone": CullFacts(
        f"{M10}, eq. 14; {L11}", HOLDS, LOSES, OFFSET, PLAIN, PLAIN, STAYS, "pipeline/culling/tcone.py",
        "tests/test_backface.py",
    ),
    "backface:tangent_plane": CullFacts(
        f"{L11}, section 4", HOLDS, LOSES, STAYS, PLAIN, PLAIN, STAYS, "pipeline/culling/tangent_plane.py",
        "tests/test_backface.py",
    ),
    "backface:normal_box": CullFacts(
        "Kumar, Manocha, Lastra 1995", HOLDS, LOSES, STAYS, PLAIN, PLAIN, STAYS, "pipeline/culling/normal_box.py",
        "tests/test_backface.py",
    ),
    "backface:displaced": CullFacts(
        "an extension of ours", HOLDS, LOSES, HOLDS, PLAIN, PLAIN, STAYS, "pipeline/culling/displaced.py",
        "tests/test_displaced_culls.py",
    ),
    "backface:tessellation_safe": CullFacts(
        "an extension of ours", "not asked", HOLDS, HOLDS, PLAIN, PLAIN, STAYS,
        "pipeline/culling/tessellation_safe.py", "tests/test_backface.py",
    ),
}  # fmt: skip


@cache
def operations() -> dict[str, Operations]:
    """`tiler.costs.count_operations` of one patch; takes seconds, so once."""
    return count_operations(1)


def idea(module: str) -> str:
    """The first sentence of a module's docstring, without the names before it."""
    line = (sys.modules[module].__doc__ or "").splitlines()[0]
    return (line.partition(": ")[2] or line).rstrip(".").partition(" (")[0].replace("|", "\\|")


def table(heads: list[str], rows: list[list[str]]) -> str:
    """A table of text."""
    return "\n".join("| " + " | ".join(row) + " |" for row in [heads, ["---"] * len(heads), *rows])


def bounds_table() -> str:
    """What each bound knows of the normal, and what it costs."""
    counts = operations()
    shader = counts["domain shader, map"].total
    heads = [
        "bound", "what", "after", "Bézier", "rational", "ACC", "Gregory", "cost", "derived in", "attacked in",
    ]  # fmt: skip
    rows = []
    for name, bound in BOUNDS.items():
        f = BOUND_FACTS[name]
        cost = f"{counts[name].total / shader:.1f}"
        rows.append(
            [f"`{name}`", idea(bound.__module__), f.source, *f[1:5], cost, f"`{f.derived}`", f"`{f.tested}`"]
        )  # fmt: skip
    return table(heads, rows)


def cull_tests_table() -> str:
    """Of which surfaces each cull test is right."""
    heads = [
        "test", "what", "after", "smooth", "its triangles", "displaced", "rational", "ACC", "Gregory", "derived in",
        "checked in",
    ]  # fmt: skip
    rows = []
    for name, cull in CULL_TESTS.items():
        f = CULL_FACTS[name]
        rows.append([f"`{name}`", idea(cull.__module__), f.source, *f[1:7], f"`{f.derived}`", f"`{f.tested}`"])
    return table(heads, rows)
