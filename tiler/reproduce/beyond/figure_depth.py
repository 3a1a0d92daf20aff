"""Work of the three binning modes over the depth complexity."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tiler.config import Machine
from tiler.heatmaps import depth_complexity_map
from tiler.reproduce.beyond.forest import forest
from tiler.reproduce.beyond.machines import UNITS, Step, run_steps, value_of
from tiler.reproduce.beyond.panels import TICKS, draw_panels
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAYERS = (1, 2, 4, 8, 16, 32, 64)
QUICK_LAYERS = (1, 8, 16)
SIZE, QUICK_SIZE = (1920, 1080), (480, 270)
FACTOR = 16

# Stated before measuring (the view was narrowed after it): what lies behind the visible adds tests, not shading.
STEADY = Tolerance(at_most=2.0)  # from 8 rows on; the patches that stand free at the top are seen through the forest
FEWER = Tolerance(at_least=10.0)  # in the deepest forest

TEXT = """
Rows of 12 columns of `colonnade`, each row three units behind the one before and shifted so that no lane stays open;
{size}, factor {factor}; seen from far before the first row, at half the height of a column. A ray meets a column in 57
% of the rows, so what is visible is in the first rows, and all rows behind are layers for nothing. The axis is
measured: the mean number of surfaces behind a pixel of the picture, front and back faces, with nothing culled.

The machine of today pays for each row the same. A machine that tests patches against coarse Z pays for a hidden row
with tests, and shades about what the first rows show.
"""


def _rows(table: dict[str, list[Any]], layers: Sequence[int]) -> list[Row]:
    def value(machine: str, rows: int, column: str) -> float:
        return float(value_of(table, column, machine=machine, rows=rows))

    deepest = layers[-1]
    middle = min(rows for rows in layers if rows >= 8)
    rows = []
    for mode in ("patch", "subpatch"):
        for column, name, allowed in (
            ("ds_invocations", "domain-shader invocations", FEWER), ("queue_bytes", "queue bytes", None),
        ):  # fmt: skip
            fewer = value("triangle", deepest, column) / value(mode, deepest, column)
            rows.append(Row(f"triangle / {mode}: {name}, {deepest} rows", None, fewer, "times", allowed))
        grown = value(mode, deepest, "ds_invocations") / value(mode, middle, "ds_invocations")
        what = f"{mode}: domain-shader invocations, {deepest} rows over {middle}"
        rows.append(Row(what, None, grown, "", STEADY))
        over = value(mode, deepest, "ds_invocations") / value("ideal", deepest, "ds_invocations")
        rows.append(Row(f"{mode} / ideal: domain-shader invocations, {deepest} rows", None, over, "times", None))
    grown = value("triangle", deepest, "ds_invocations") / value("triangle", middle, "ds_invocations")
    rows.append(Row(f"triangle: domain-shader invocations, {deepest} rows over {middle}", None, grown, "", None))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    draw_panels(table, figure, "depth_complexity", "depth complexity: surfaces behind a pixel", TICKS)


def run(context: Context) -> Result:
    """All modes at each number of rows."""
    layers, size = (QUICK_LAYERS, QUICK_SIZE) if context.quick else (LAYERS, SIZE)
    steps = []
    for rows in layers:
        coarse = forest(rows, (240, 135), 8)
        depth = round(float(np.mean(depth_complexity_map(coarse, Machine()))), 3)
        steps.append(Step({"rows": rows, "depth_complexity": depth}, forest(rows, size, FACTOR), 0, {}))
    table = run_steps(context, steps)
    units = {
        "rows": "rows of columns behind each other",
        "depth_complexity": "surfaces behind a pixel, front and back faces, mean over a picture of 240x135 pixels",
        **UNITS,
    }
    text = TEXT.format(size="x".join(map(str, size)), factor=FACTOR)
    return Result(tuple(_rows(table, layers)), table, units, lambda figure: _draw(table, figure), text)


ITEM = Item("beyond", "figure-depth", "Work over depth complexity", run)
