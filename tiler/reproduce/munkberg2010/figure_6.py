"""Figure 6: volume and screen area of five bounds relative to the sampled surface's own box."""

from typing import TYPE_CHECKING, Any

from tiler.quality import SAMPLES, measure, stage_of
from tiler.reproduce import style
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.reproduce.munkberg2010.subjects import ALGORITHMS, CLAMPED, subjects

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

READING = 0.95  # stated before measuring: bars that differ by less than a twentieth are not told apart in the figure

BOUNDED = (*ALGORITHMS, CLAMPED)
ROOM = 3.0  # how far above the largest other bar the axis goes for TAYLOR's

UNITS = {
    "scene": "what is displaced",
    "algorithm": "bounding algorithm",
    "patches": "number of patches",
    "volume": "summed volume of the boxes / summed volume of the reference boxes",
    "area": "summed screen area of the boxes / summed screen area of the reference boxes",
    "cones": "share of patches whose normals have a known cone",
}

TEXT = f"""
Boxes of whole patches, relative to the box of the displaced surface itself: {SAMPLES} x {SAMPLES} outputs of the domain shader,
in the patch's oriented frame. A ratio is the sum over all patches divided by the sum of their references; 1 is the ideal.
Areas are those of the rectangles around the projected corners, the reference's too.

The figure's values are not printed in the paper, so what is checked is its order, CBOX > OBBTEX >= TPATCH >= NPATCH, up to
what can be read from bars (5 %); the last two are nested boxes and may not change places at all. Under a constant displacement
the screen areas of CBOX and OBBTEX are not held against each other: both are patches grown by the same cube or more, and a box
that is turned against the screen's axes has the larger rectangle.

TAYLOR is the tightest where the displacement is small (Figure 9). Where the square of the normal's length comes near zero in a
patch, the remainder of its inverse root is large without limit, and a few such patches decide the whole sum: of the 2,063
patches of the animated head (with `--models`) one makes nine tenths of it. TAYLOR_CLAMPED, which the paper does not have, cuts
the components of the normal to [-1, 1]. A bar that leaves the axis is cut and its value written on it.
"""


def _table(context: Context) -> tuple[dict[str, list[Any]], str]:
    table: dict[str, list[Any]] = {name: [] for name in UNITS}
    chosen = subjects(context)
    for k, subject in enumerate(chosen):
        for row in measure(subject.name, stage_of(subject.scene), BOUNDED):
            values = (row.scene.replace("\n", " "), row.bound, row.patches, row.volume, row.area, row.cones)
            for column, value in zip(table.values(), values, strict=True):
                column.append(value)
        context.update((k + 1) / len(chosen))
    return table, "\n".join(f"- {subject.told}" for subject in chosen)


def _rows(table: dict[str, list[Any]]) -> list[Row]:
    """Each ratio, and that it is not below the next tighter algorithm's."""
    rows = []
    for scene in dict.fromkeys(table["scene"]):
        for column in ("volume", "area"):
            value = {name: table[column][k] for k, name in enumerate(table["algorithm"]) if table["scene"][k] == scene}
            for name in BOUNDED:
                tighter = {"cbox": "obbtex", "obbtex": "tpatch", "tpatch": "npatch"}.get(name)
                allowed, note = None, ""
                if name == "cbox" and column == "area" and scene.endswith("constant"):
                    note = "a box along the axes may have the smaller rectangle"
                elif tighter is not None:
                    nested = name == "tpatch"
                    allowed = Tolerance(at_least=value[tighter] * (1.0 if nested else READING))
                    note = f"not below {tighter}"
                rows.append(Row(f"{scene}, {name}: {column}", None, value[name], "of the reference", allowed, note))
    return rows


def _bars(axes: "Axes", table: dict[str, list[Any]], column: str, title: str) -> None:
    scenes = list(dict.fromkeys(table["scene"]))
    others = [value for value, name in zip(table[column], table["algorithm"], strict=True) if name != "taylor"]
    top = ROOM * max(others)
    width = 0.88 / len(BOUNDED)
    for k, (scene, name) in enumerate(zip(table["scene"], table["algorithm"], strict=True)):
        place, value = BOUNDED.index(name), table[column][k]
        x = scenes.index(scene) + (place - (len(BOUNDED) - 1) / 2) * width
        shown = min(value, 0.6 * top)
        label = name if scene == scenes[0] else None
        axes.bar(x, shown - 1, width * 0.9, bottom=1, color=style.color_of(name), label=label)
        text = f"{value:.1f}" if value < 10 else f"{value:.0f}" if value < 1000 else f"{value:.0e}".replace("e+0", "e")
        axes.text(x, shown, text if value == shown else f"↑{text}", ha="center", va="bottom", fontsize=6)
    axes.set_yscale("log")
    axes.set_ylim(1, top)
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50, 100, 200, 500) if tick <= top]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_xticks(range(len(scenes)), [scene.replace(", ", ",\n") for scene in scenes])
    axes.tick_params(axis="x", length=0)
    axes.set_title(title)
    style.grid(axes)


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    figure.set_size_inches(9.6, 3.8)
    volume, area = figure.subplots(1, 2)
    _bars(volume, table, "volume", "Volume of the boxes")
    _bars(area, table, "area", "Screen area of the boxes")
    volume.set_ylabel("relative to the sampled surface's box")
    handles, labels = volume.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def run(context: Context) -> Result:
    """Bound all patches of all scenes."""
    table, told = _table(context)
    return Result(tuple(_rows(table)), table, UNITS, lambda figure: _draw(table, figure), f"{TEXT}\n{told}\n")


ITEM = Item("munkberg2010", "figure-6", "Volume and screen area of the bounds, relative to the sampled reference", run)
