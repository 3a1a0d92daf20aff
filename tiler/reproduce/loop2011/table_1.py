"""Table 1: the share of patches that each test culls, over 10,000 random views, and what that owes to where the eyes are."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.loop2011.eyes import NEAR, OTHERS, PAPER, SPHERES, Distribution
from tiler.reproduce.loop2011.models import KNOWN, PUBLISHED, TESTS, Subject, subjects
from tiler.reproduce.loop2011.rates import culled, prepare, rates
from tiler.reproduce.plain import patches_of
from tiler.reproduce.surface_samples import back_facing, sample_surfaces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VIEWS, QUICK_VIEWS = 10_000, 300  # of the paper's row
IDEAL_VIEWS, QUICK_IDEAL_VIEWS = 500, 20  # of these, the first are sampled
CELLS = 8  # of the sampled surface, along each side of a patch

# Stated before measuring. The paper does not say where its eyes are nor how it finds the axes of its cones, and either moves
# the rates by two to three points; another implementation with our choice of both is to be met more closely; a model of
# ours in place of the paper's has but its character, a closed animal of about as many patches.
OF_PAPER = Tolerance(absolute=2.5)
OF_KNOWN = Tolerance(absolute=0.7)
OF_STAND_IN = Tolerance(absolute=8.0)
NONE_ALONE = Tolerance(at_most=0)  # tcone: a theorem for polynomial patches; ncone: no counter-example is known

UNITS = {
    "model": "model",
    "distribution": "where the eyes are; R is the radius about the middle of the model's box",
    "distance_r": "distance of all eyes from that middle, R; empty where they differ",
    "test": "back-patch test; `ideal` has every sampled point back-facing or edge-on",
    "views": "eyes",
    "culled_percent": "mean share of patches culled, % of all patches",
    "standard_error": "of the mean, from the scatter of the views, points",
    "published_percent": "Loop et al. 2011, Table 1",
}


def _measure(
    subject: Subject, chosen: list[Distribution], context: Context, part: tuple[float, float]
) -> tuple[Any, ...]:
    """(lines of the table, tcone's and ncone's culls that the tangent plane does not make) of a model."""
    patches = patches_of(subject.scene)
    prepared = prepare(patches)
    published = dict(zip(TESTS, PUBLISHED.get(subject.stands_for or "", (None,) * 3), strict=True))
    lines: list[tuple[Any, ...]] = []
    alone = dict.fromkeys(TESTS[:2], 0)

    def add(where: Distribution, test: str, each: np.ndarray) -> None:
        error = float(each.std() / np.sqrt(len(each)))
        told = published.get(test) if where is PAPER else None
        lines.append((subject.name, where.name, where.distance, test, len(each), float(each.mean()), error, told))

    for k, where in enumerate(chosen):
        rng = np.random.default_rng([context.seed, k])
        views = QUICK_VIEWS if context.quick else VIEWS if where is PAPER else VIEWS // 5
        eyes = where.draw(rng, views, subject.ball)
        found = rates(prepared, eyes, context.threads)
        for test, each in found.culled.items():
            add(where, test, each)
        for test, count in found.alone.items():
            alone[test] += count
        if where is PAPER:
            samples = sample_surfaces(patches.control_points, CELLS)
            some = eyes[: QUICK_IDEAL_VIEWS if context.quick else IDEAL_VIEWS]
            chunks = np.array_split(some, max(1, len(some) // 20))
            add(where, "ideal", np.concatenate([100.0 * back_facing(samples, c).mean(axis=0) for c in chunks]))
            seen = 100.0 * culled(prepared, some)["tangent_plane"].mean(axis=0)
            add(where, "tangent_plane, ideal's views", seen)
        context.update(part[0] + (part[1] - part[0]) * (k + 1) / len(chosen))
    return lines, alone


def _rows(subject: Subject, table: dict[str, list[Any]], alone: dict[str, int]) -> list[Row]:
    of = _values(table, subject.name)
    at = of[PAPER.name]
    rows = []
    for k, test in enumerate(TESTS):
        if subject.stands_for is not None:
            allowed = OF_PAPER if subject.original else OF_STAND_IN
            note = "" if subject.original else f"{subject.name} for {subject.stands_for}"
            what = f"{subject.name}, {test}: culled"
            rows.append(Row(what, PUBLISHED[subject.stands_for][k], at[test], "%", allowed, note))
            if subject.original:
                told = "beside another implementation, smallest cones, 1.2 R"
                rows.append(
                    Row(f"{what}, again", KNOWN[subject.stands_for][k], at[test], "%", OF_KNOWN, told)
                )  # fmt: skip
        else:
            rows.append(Row(f"{subject.name}, {test}: culled", None, at[test], "%", None, "a model of ours"))
    missed = at["ideal"] - at["tangent_plane, ideal's views"]
    rows.append(Row(f"{subject.name}, ideal less tangent_plane", None, missed, "points", Tolerance(at_least=0.0)))
    for low, high in (TESTS[:2], TESTS[1:]):
        least = min(rate[high] - rate[low] for rate in of.values())
        what = f"{subject.name}, {high} less {low}: least of all distributions"
        rows.append(Row(what, None, least, "points", Tolerance(at_least=0.0)))
    for test, count in alone.items():
        rows.append(Row(f"{subject.name}, culled by {test} alone", None, count, "patches", NONE_ALONE))
    return rows


def _values(table: dict[str, list[Any]], model: str) -> dict[str, dict[str, float]]:
    """Per cent culled by distribution and test."""
    found: dict[str, dict[str, float]] = {}
    for name, where, test, percent in zip(
        table["model"], table["distribution"], table["test"], table["culled_percent"], strict=True
    ):
        if name == model:
            found.setdefault(where, {})[test] = percent
    return found


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    """For each model: over the eye's distance, and beside it the other distributions; published values as lines."""
    models = list(dict.fromkeys(table["model"]))
    figure.set_size_inches(7.6, 0.5 + 2.6 * len(models))
    grid = figure.subplots(len(models), 2, squeeze=False, width_ratios=(1.2, 1.0))
    lines = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
    for model, (left, right) in zip(models, grid, strict=True):
        mine = [line for line in lines if line["model"] == model and line["test"] in TESTS]
        _draw_distances(left, [line for line in mine if line["distance_r"] is not None], model)
        _draw_others(right, [line for line in mine if line["distance_r"] is None or line["distribution"] == PAPER.name])
        values = [line["culled_percent"] for line in mine]
        ends = max(0.0, min(values) - 2.0), max(values) + 2.0
        left.set_ylim(*ends)
        right.set_xlim(*ends)
        style.grid(left)
        style.grid(right, "x")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))


def _published(draw: Any, lines: list[dict[str, Any]], **settings: Any) -> None:
    """A dotted line, by axhline or axvline, at what was published of each test."""
    for line in lines:
        if line["published_percent"] is not None:
            draw(
                line["published_percent"], color=style.color_of(line["test"]), linestyle=":", linewidth=1.2, **settings
            )


def _draw_distances(axes: Any, lines: list[dict[str, Any]], model: str) -> None:
    for test in TESTS:
        mine = sorted((line for line in lines if line["test"] == test), key=lambda line: line["distance_r"])
        axes.plot(
            [line["distance_r"] for line in mine], [line["culled_percent"] for line in mine], **style.line_style(test)
        )
    _published(axes.axhline, lines)
    if any(line["published_percent"] is not None for line in lines):
        axes.plot([], [], color=style.GREY, linestyle=":", linewidth=1.2, label="published")
    axes.axvline(NEAR, color=style.LIGHT, linewidth=0.9, zorder=0)
    axes.set_xscale("log")
    axes.set_xticks([1, 1.2, 2, 3, 5, 10, 100], ["1", "", "2", "3", "5", "10", "100"])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("distance of the eye, bounding radii R")
    axes.set_ylabel("patches culled (%)")
    axes.set_title(model, loc="left")


def _draw_others(axes: Any, lines: list[dict[str, Any]]) -> None:
    names = list(dict.fromkeys(line["distribution"] for line in lines))[::-1]
    for test in TESTS:
        mine = {line["distribution"]: line["culled_percent"] for line in lines if line["test"] == test}
        axes.plot(
            [mine[name] for name in names], range(len(names)), linestyle="", color=style.color_of(test),
            marker=style.marker_of(test),
        )  # fmt: skip
    _published(axes.axvline, lines)
    axes.set_yticks(range(len(names)), [name.replace(", ", ",\n") for name in names], fontsize=7.5)
    axes.set_ylim(-0.5, len(names) - 0.5)
    axes.set_xlabel("patches culled (%)")
    axes.set_title("eyes otherwise", loc="left")


TEXT = """
{told}

Undisplaced patches, and eyes alone: back-facing does not depend on where a camera looks. The paper gives neither the
eyes' distribution nor the axes of its cones. Here cones are the smallest ones, and the row that is compared has
{views:,} eyes even over a sphere of 1.2 bounding radii, which is where the three published rates lie together; the
figure shows how they move with the distance and with {others} other distributions ({fewer:,} eyes each). All tests
see the same eyes. *ideal* calls a patch back-facing where all of {points} sampled points are; it was counted on the
first {ideal} eyes.

Allowed, stated beforehand: 2.5 points about the published rates (distance and axes each move them by two to three);
0.7 points about those of another implementation that made the same two choices; 8 points where a model of ours stands
in. Smallest cones explain why `tcone` culls more than printed: mean axes give 2 to 3 points less. No patch may be
culled by a cone and not by the tangent plane: of `tcone` that is a theorem for polynomial patches, of `ncone` no
counter-example is known. Killeroo (32.9, 40.6, 45.1 % published) is not to be had and has no stand-in: it is a spline
model of 11,532 patches.
"""


def run(context: Context) -> Result:
    """Count culls over random eyes."""
    chosen = [PAPER, *(d for d in (*SPHERES, *OTHERS) if d is not PAPER)]
    if context.quick:
        chosen = [PAPER, SPHERES[0], SPHERES[-1], OTHERS[0]]
    models = subjects(context)
    lines: list[tuple[Any, ...]] = []
    counts = []
    for k, subject in enumerate(models):
        more, alone = _measure(subject, chosen, context, (k / len(models), (k + 1) / len(models)))
        lines += more
        counts.append(alone)
    table: dict[str, list[Any]] = {
        name: list(column) for name, column in zip(UNITS, zip(*lines, strict=True), strict=True)
    }
    rows = [row for s, alone in zip(models, counts, strict=True) for row in _rows(s, table, alone)]
    views = QUICK_VIEWS if context.quick else VIEWS
    text = TEXT.format(
        told=" ".join(subject.told for subject in models), views=views, others=len(chosen) - 1,
        fewer=QUICK_VIEWS if context.quick else VIEWS // 5, points=(CELLS + 1) ** 2,
        ideal=QUICK_IDEAL_VIEWS if context.quick else IDEAL_VIEWS,
    )  # fmt: skip
    return Result(tuple(rows), table, UNITS, lambda figure: _draw(table, figure), text)


ITEM = Item("loop2011", "table-1", "Patches culled over random views", run)
