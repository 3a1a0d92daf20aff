"""Degenerate and rational patches: what each test answers, and that none culls a patch that is seen."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.types import B1, F64
from pipeline.vertex import make_patches
from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.loop2011.families import BUMPS, FAMILIES, UNEVEN_AND_COLLAPSED, Family, eyes_about, make_family
from tiler.reproduce.loop2011.models import TESTS
from tiler.reproduce.loop2011.rates import Prepared, culled, prepare
from tiler.reproduce.surface_samples import back_facing, sample_surfaces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PATCHES, QUICK_PATCHES = 256, 48
EYES, QUICK_EYES = 160, 40
CELLS = 20
N_RULE = "all 64 below 0"

# Stated before measuring. The paper says that its test takes degenerate and rational patches as they are: so it has to cull
# at least half of what it culls of ordinary ones. No test may cull what is seen. Lines and points have no side: kept.
SOUND = Tolerance(at_most=0)
TAKEN = Tolerance(at_least=0.5)
RATIONAL_ALONE = Tolerance(at_most=0.2)  # another implementation saw 0.1 % of ncone's culls of rational patches

UNITS = {
    "family": "kind of patches",
    "test": f"back-patch test; `{N_RULE}`: the tangent plane by the rule that every coefficient is below 0",
    "pairs": "patches times eyes",
    "back_facing": "pairs in which every sampled point of the patch faces away or is edge-on",
    "culled": "pairs in which the test culls the patch",
    "culled_percent": "culled, % of back_facing; empty where nothing is",
    "culled_and_seen": "culled pairs in which a sampled point faces the eye",
    "culled_alone": "culled pairs that the tangent plane does not cull",
}


def _all_below_zero(prepared: Prepared, eyes: F64) -> B1:
    """The N rule: every coefficient of e . T is below 0, bool[patches, eyes]."""
    planes = prepared.planes
    away = eyes[None] - planes.origin[:, None]
    value = np.einsum("pkc,pec->pek", planes.plane[..., :3], away) + planes.plane[:, None, :, 3]
    return np.asarray((value < 0.0).all(axis=2))


def _measure(family: Family, context: Context, seed: int) -> list[tuple[Any, ...]]:
    rng = np.random.default_rng([context.seed, seed])
    n, m = (QUICK_PATCHES, QUICK_EYES) if context.quick else (PATCHES, EYES)
    net = make_family(family, rng, n)
    none = np.full(n, -1, np.int32)
    prepared = prepare(make_patches(net, np.zeros((n, 4, 2), np.float32), none, np.zeros(n, np.int32)))
    eyes = eyes_about(rng, m)
    samples = sample_surfaces(net, CELLS)
    back = np.concatenate([back_facing(samples, some) for some in np.array_split(eyes, max(1, m // 20))], axis=1)
    answers = culled(prepared, eyes) | {N_RULE: _all_below_zero(prepared, eyes)}
    lines = []
    for test, answer in answers.items():
        share = 100.0 * float(answer.sum()) / float(back.sum()) if back.any() else None
        seen = int((answer & ~back).sum()) if family.surface else int(answer.sum())
        alone = int((answer & ~answers["tangent_plane"]).sum())
        lines.append((family.name, test, n * m, int(back.sum()), int(answer.sum()), share, seen, alone))
    return lines


def _rows(table: dict[str, list[Any]]) -> list[Row]:
    lines = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
    of = {(line["family"], line["test"]): line for line in lines}
    rational = {family.name for family in FAMILIES if family.weights is not None} - set(UNEVEN_AND_COLLAPSED)
    polynomial = {family.name for family in FAMILIES if family.smooth}
    ordinary = of["ordinary", "tangent_plane"]["culled_percent"]
    rows = []
    for test in TESTS:
        seen = sum(line["culled_and_seen"] for line in lines if line["test"] == test)
        rows.append(Row(f"{test}: culled and seen, all families", None, seen, "pairs", SOUND))
    for family in FAMILIES:
        for test in TESTS:
            line = of[family.name, test]
            what = f"{family.name}, {test}: culled"
            if not family.surface:
                rows.append(Row(what, None, line["culled"], "pairs", SOUND, "neither side: kept"))
            elif line["culled_percent"] is not None:
                rows.append(Row(what, None, line["culled_percent"], "% of back-facing", None))
        if family.surface and family.name != "ordinary":
            ratio = of[family.name, "tangent_plane"]["culled_percent"] / ordinary
            known = family.name in UNEVEN_AND_COLLAPSED
            note = "zeros of uneven weights do not come out as zero, and keep the patch" if known else ""
            what = f"{family.name}, tangent_plane: share of its rate on ordinary"
            rows.append(Row(what, None, ratio, "", TAKEN, note))
    for test, allowed in (("tcone", SOUND), ("ncone", SOUND)):
        alone = sum(x["culled_alone"] for x in lines if x["test"] == test and x["family"] in polynomial)
        rows.append(Row(f"polynomial: culled by {test}, not by tangent_plane", None, alone, "pairs", allowed))
    some = [line for line in lines if line["test"] == "ncone" and line["family"] in rational]
    share = 100.0 * sum(x["culled_alone"] for x in some) / max(1, sum(x["culled"] for x in some))
    rows.append(Row("rational: culled by ncone, not by tangent_plane", None, share, "% of ncone's", RATIONAL_ALONE))
    collapsed = sum(of[name, N_RULE]["culled"] for name in ("an edge is a point", "two edges are points"))
    rows.append(
        Row(f"collapsed edges, {N_RULE}: culled", None, collapsed, "pairs", SOUND, "why zeros must be let pass")
    )
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    """Rates by family and test."""
    figure.set_size_inches(7.4, 5.4)
    axes = figure.subplots()
    families = list(dict.fromkeys(table["family"]))
    series = [
        *((test, test, style.color_of(test)) for test in TESTS),
        (N_RULE, f"tangent plane, {N_RULE}", style.LIGHT),
    ]
    of = dict(zip(zip(table["family"], table["test"], strict=True), table["culled_percent"], strict=True))
    height = 0.8 / len(series)
    for s, (test, label, color) in enumerate(series):
        places = [k + (s - (len(series) - 1) / 2) * height for k in range(len(families))]
        values = [of[family, test] or 0.0 for family in families]
        axes.barh(places, values, height * 0.9, color=color, label=label)
        for place, family in zip(places, families, strict=True):
            if of[family, test] is not None:
                axes.text(of[family, test] + 0.8, place, f"{of[family, test]:.0f}", va="center", fontsize=6.5)
    for k, family in enumerate(families):
        if of[family, TESTS[0]] is None:
            axes.text(1.0, k, "neither front nor back: kept by all", va="center", fontsize=7.5, color=style.GREY)
    axes.set_yticks(range(len(families)), families)
    axes.set_ylim(len(families) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0.0, 104.0)
    axes.set_xlabel("culled (% of the pairs of patch and eye in which all of the patch faces away)")
    style.grid(axes, "x")
    figure.legend(loc="outside upper center", ncols=len(series))


TEXT = """
{n} patches of each kind, of size 1 with control points scattered by {bumps} of that (octants: exact quarter arcs
raised to bicubic, stretched by powers of two), each turned another way; {m} eyes from 0.8 to 20 sizes away.
*back-facing*: all of {points} sampled points face away or are edge-on, in float64 from the Bernstein polynomials,
which no test uses. Rates are of such pairs.

What the tests answer. **Collapsed edges and corners**: control vectors of length zero are left out of the cones; the
tangent plane has coefficients that are exactly zero there, which may not save the patch, so its rule is that none is
above 0 and some is below (not that all 64 are below 0, which never culls such a patch: the grey bars). **Zero
derivatives along an edge**: those zeros come out of products that cancel, so they are noise, and are taken for zero.
**Lines and points** have no side and are kept. **Rational** patches need no other tangent plane; the cones are of the
derivatives' numerators, and wider the more uneven the weights are. **Both at once**, an edge that is a point with
uneven weights: our `tangent_plane` keeps most such patches. Its homogeneous differences are multiples of each other
there and not zero, so the coefficients that should be zero are rounding noise of either sign, and it takes no chance;
`ncone`, of projected points, culls more of them, and these families are left out of the row that compares the two.
Weights that are not above 0 are answered by none of them.

The paper says in its text that its test handles both kinds and gives no rates. Allowed, stated beforehand: no pair
culled that is seen; the tangent plane takes at least half as much of each kind as of ordinary patches, which it does
not of both at once: a shortcoming of ours, as exact zeros are to be had from projected points; nothing that the cones
cull alone of polynomial patches, and 0.2 % of what `ncone` culls of rational ones (another implementation saw 0.1 %).
"""


def run(context: Context) -> Result:
    """Test each family from many eyes."""
    lines = []
    for k, family in enumerate(FAMILIES):
        lines += _measure(family, context, k)
        context.update((k + 1) / len(FAMILIES))
    table: dict[str, list[Any]] = {
        name: list(column) for name, column in zip(UNITS, zip(*lines, strict=True), strict=True)
    }
    n, m = (QUICK_PATCHES, QUICK_EYES) if context.quick else (PATCHES, EYES)
    text = TEXT.format(n=n, m=m, bumps=BUMPS, points=(CELLS + 1) ** 2)
    return Result(tuple(_rows(table)), table, UNITS, lambda figure: _draw(table, figure), text)


ITEM = Item("loop2011", "degenerate", "Degenerate and rational patches", run)
