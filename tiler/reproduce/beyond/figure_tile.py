"""Work of the three binning modes over the side of a tile."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tiler.reproduce.beyond.machines import UNITS, Step, run_steps, value_of
from tiler.reproduce.beyond.panels import draw_panels
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.scene import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TILES = (8, 16, 32, 64, 128)
QUICK_TILES = (8, 32, 128)
SIZE, QUICK_SIZE = (1920, 1080), (480, 270)
FRAME = 36

# Stated before measuring.
FEWER_BYTES = Tolerance(at_least=1.0)  # patch binning writes no more than triangle binning at any tile
STEADY = Tolerance(at_most=1.5)  # with a domain cache, a tile's side moves little of the shading

TEXT = """
`colonnade`, the middle of its walk, {size}, factor 16; the finest blocks of coarse Z are 8x8 pixels at every tile.

Small tiles repeat a patch in many queues: bytes and tests of queue entries go up with the square of 1 / side, down to
where a tile is smaller than a patch's bound by far. Large tiles lose occlusion: a patch that reaches a tile is hidden
as a whole there or not at all. The domain cache of these machines holds a frame, so what is shaded depends little on
the tile.
"""


def _rows(table: dict[str, list[Any]], tiles: Sequence[int]) -> list[Row]:
    def value(machine: str, tile: int, column: str) -> float:
        return float(value_of(table, column, machine=machine, tile=tile))

    rows = []
    for mode in ("patch", "subpatch"):
        for tile in tiles:
            fewer = value("triangle", tile, "queue_bytes") / value(mode, tile, "queue_bytes")
            allowed = FEWER_BYTES if mode == "patch" else None
            rows.append(Row(f"triangle / {mode}: queue bytes, tile {tile}", None, fewer, "times", allowed))
        shaded = [value(mode, tile, "ds_invocations") for tile in tiles]
        what = f"{mode}: domain-shader invocations, largest over smallest"
        rows.append(Row(what, None, max(shaded) / min(shaded), "", STEADY))
        for tile in tiles:
            over = value(mode, tile, "ds_invocations") / value("ideal", tile, "ds_invocations")
            rows.append(Row(f"{mode} / ideal: domain-shader invocations, tile {tile}", None, over, "times", None))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    draw_panels(table, figure, "tile", "side of a tile, pixels")


def run(context: Context) -> Result:
    """All modes at each tile size."""
    tiles, size = (QUICK_TILES, QUICK_SIZE) if context.quick else (TILES, SIZE)
    scene = load_scene("colonnade", size=size, factor=16)
    table = run_steps(context, [Step({"tile": tile}, scene, FRAME, {"tile": tile}) for tile in tiles])
    units = {"tile": "side of a tile, pixels", **UNITS}
    text = TEXT.format(size="x".join(map(str, size)))
    return Result(tuple(_rows(table, tiles)), table, units, lambda figure: _draw(table, figure), text)


ITEM = Item("beyond", "figure-tile", "Work over the size of a tile", run)
