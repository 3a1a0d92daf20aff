"""From which tessellation factor each technique pays, by scene: culling, patch binning, occlusion, sub-patches."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tiler.comparison import MACHINES
from tiler.config import Machine
from tiler.cost_model import cost, crossing
from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.scene import load_scene
from tiler.scene.model import Scene
from tiler.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCENES = {"colonnade": 36, "creature": 72, "spikelog": 48, "waves": 36, "teapot": 36}  # the creature zoomed in
QUICK_SCENES = ("colonnade", "spikelog")
FACTORS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
QUICK_FACTORS = (1, 4, 16)
SIZE, QUICK_SIZE = (640, 360), (320, 180)

BASELINE = "triangle"
TECHNIQUES: dict[str, dict[str, Any]] = {
    BASELINE: {"binning": "triangle", "cull": ()},
    **{
        f"triangle, frustum by {bound}": {"binning": "triangle", "cull": ("frustum",), "bounds": bound}
        for bound in ("cbox", "obbtex", "tpatch", "npatch")
    },
    "triangle, frustum and back faces": {
        "binning": "triangle", "cull": ("frustum", "backface:tessellation_safe"), "bounds": "tpatch",
    },
    "patch, no cache": {"binning": "patch", "cull": ("frustum",), "bounds": "tpatch"},
    "patch, frame cache": {"binning": "patch", "cull": ("frustum",), "bounds": "tpatch", "domain_cache": "frame"},
    "patch, everything on": MACHINES["patch, all"],
    "subpatch, everything on": MACHINES["subpatch, all"],
}  # fmt: skip

# What is charged: (cost model, measure of its report, title).
MEASURES = (
    ("munkberg2010", "domain_shader_equivalents", "shading and bounds alone"),
    ("wide", "total_cycles", "all stages of a wide machine"),
)
NEVER = float(2 * FACTORS[-1])  # what stands for "at no factor simulated"

# Stated before measuring; shading and bounds alone, published cost of bounds.
PAYS = Tolerance(at_most=8.0)  # patch binning with everything on, on the deep scene
CULL_PAYS = Tolerance(at_most=8.0)  # frustum culling by cbox where part of the scene is out of the view
NEVER_PAYS = Tolerance(at_least=NEVER)  # shading a patch again in every tile

TEXT = """
Each technique against `triangle` binning without any test, at factors {factors} ({size}; the creature zoomed in, the
other scenes in the middle of their animation). A technique *pays from* the factor from which it stays cheaper, on a
straight line between the factors simulated: "1" where it does from the first; "never" where it does not at the last.

Two ways to charge. *Shading and bounds alone*: domain-shader invocations, and for each bound evaluated, those of
sub-domains too, the published cost in invocations (Munkberg et al. 2010, Table 1: CBOX 1.5, OBBTEX 2.7, TPATCH 4.5,
NPATCH 11). The back-patch test is free in that model, which knows nothing of it. *All stages*: the cycles of all stages
of the model `wide`, one after the other, with clipping, binning, rasterization and the memory of queues
(docs/cost-model.md). In the numbers "never" is empty.
"""


def _at_factor(scene: Scene, factor: float) -> Scene:
    return replace(scene, tessellation=replace(scene.tessellation, factor=(float(factor),) * 6, edge_pixels=None))


def _costs(
    context: Context, scenes: dict[str, int], factors: Sequence[int], size: tuple[int, int]
) -> list[dict[str, Any]]:
    """A row for each scene, technique, measure and factor."""
    machines = {name: Machine(**fields) for name, fields in TECHNIQUES.items()}
    rows = []
    total, done = len(scenes) * len(factors) * len(machines), 0
    for name, number in scenes.items():
        scene = load_scene(name, size=size)
        for factor in factors:
            for technique, machine in machines.items():
                counters = simulate(_at_factor(scene, factor), machine, frame=number, threads=context.threads).counters
                for model, measure, _ in MEASURES:
                    value = getattr(cost(counters, machine, model), measure)
                    rows.append(
                        {"scene": name, "technique": technique, "model": model, "factor": factor, "cost": value}
                    )
                done += 1
                context.update(done / total)
    return rows


def _table(rows: list[dict[str, Any]], factors: Sequence[int]) -> dict[str, list[Any]]:
    """The costs, and with each the factor from which its technique pays."""
    of: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        of.setdefault((row["scene"], row["technique"], row["model"]), []).append(row["cost"])
    for row in rows:
        scene, technique, model = row["scene"], row["technique"], row["model"]
        baseline, own = of[scene, BASELINE, model], of[scene, technique, model]
        row["pays_from"] = None if technique == BASELINE else crossing(factors, baseline, own)
        row["of_baseline"] = row["cost"] / baseline[factors.index(row["factor"])]
    return {column: [row[column] for row in rows] for column in rows[0]}


def _found(table: dict[str, list[Any]]) -> dict[tuple[str, str, str], float | None]:
    """Pays from, by (scene, technique, model)."""
    keys = zip(table["scene"], table["technique"], table["model"], strict=True)
    return dict(zip(keys, table["pays_from"], strict=True))


def _rows(table: dict[str, list[Any]]) -> list[Row]:
    limits = {
        ("colonnade", "patch, everything on"): PAYS,
        ("colonnade", "subpatch, everything on"): PAYS,
        ("colonnade", "triangle, frustum by cbox"): CULL_PAYS,
        ("colonnade", "patch, no cache"): NEVER_PAYS,
    }
    rows = []
    for (scene, technique, model), factor in _found(table).items():
        if technique == BASELINE:
            continue
        limit = limits.get((scene, technique)) if model == MEASURES[0][0] else None
        note = "" if factor is not None else f"never: it does not at factor {max(table['factor'])}"
        measured = NEVER if factor is None else factor
        rows.append(Row(f"{scene}, {technique}: pays from, {model}", None, measured, "factor", limit, note))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    scenes = list(dict.fromkeys(table["scene"]))
    techniques = [name for name in dict.fromkeys(table["technique"]) if name != BASELINE]
    figure.set_size_inches(10.5, 4.0)
    panels = figure.subplots(1, len(MEASURES), sharey=True)
    found = _found(table)
    for axes, (model, _, title) in zip(panels, MEASURES, strict=True):
        axes.set_title(f"pays from factor: {title}", loc="left", fontweight="bold", pad=22)
        axes.set_xlim(-0.5, len(scenes) - 0.5)
        axes.set_ylim(len(techniques) - 0.5, -0.5)
        axes.set_yticks(range(len(techniques)), techniques)
        axes.set_xticks(range(len(scenes)), scenes)
        axes.tick_params(length=0, labeltop=True, labelbottom=False)
        for spine in axes.spines.values():
            spine.set_visible(False)
        for y, technique in enumerate(techniques):
            for x, scene in enumerate(scenes):
                _cell(axes, x, y, found[scene, technique, model], min(table["factor"]))


def _cell(axes: "Axes", x: int, y: int, factor: float | None, first: float) -> None:
    """A cell: the darker, the earlier it pays; empty where never."""
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle

    late = 1.0 if factor is None else min(1.0, max(0.0, (factor / first)) ** 0.5 / (FACTORS[-1] / first) ** 0.5)
    color = "#f4f4f4" if factor is None else colormaps["GnBu"](0.9 - 0.75 * late)
    axes.add_patch(Rectangle((x - 0.47, y - 0.44), 0.94, 0.88, facecolor=color, edgecolor="none"))
    text = "never" if factor is None else f"{factor:g}" if factor == first else f"{factor:.3g}"
    ink = style.GREY if factor is None else "white" if late < 0.42 else style.BLACK
    axes.text(x, y, text, ha="center", va="center", color=ink, fontsize=9)


def run(context: Context) -> Result:
    """All techniques on all scenes at all factors."""
    scenes = {name: frame for name, frame in SCENES.items() if not context.quick or name in QUICK_SCENES}
    factors, size = (QUICK_FACTORS, QUICK_SIZE) if context.quick else (FACTORS, SIZE)
    table = _table(_costs(context, scenes, factors, size), factors)
    units = {
        "scene": "built-in scene",
        "technique": "what is done beside, or in place of, triangle binning without any test",
        "model": "cost model; munkberg2010: domain-shader equivalents, wide: cycles of all stages",
        "factor": "tessellation factor, all six of every patch",
        "cost": "of the frame by the model",
        "pays_from": "factor from which the technique is cheaper than triangle binning; none: at no factor",
        "of_baseline": "cost relative to triangle binning at this factor",
    }
    text = TEXT.format(factors=", ".join(map(str, factors)), size="x".join(map(str, size)))
    return Result(tuple(_rows(table)), table, units, lambda figure: _draw(table, figure), text)


ITEM = Item("beyond", "table-break-even", "From which factor each technique pays", run)
