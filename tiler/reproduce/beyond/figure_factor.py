"""Work of the three binning modes over the tessellation factor."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tiler.reproduce.beyond.machines import UNITS, Step, run_steps, value_of
from tiler.reproduce.beyond.panels import draw_panels
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.scene import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACTORS = (4, 8, 16, 32, 64)
QUICK_FACTORS = (4, 8, 16)
SIZE, QUICK_SIZE = (1920, 1080), (480, 270)
FRAME = 36  # the middle of the walk

# Stated before measuring. A queue of patches holds no tessellation; only the cull tests know the factor.
CONSTANT = Tolerance(at_most=1.05)
GROWS = Tolerance(at_least=4.0)  # triangles grow 16-fold from factor 4 to 16; those between samples are binned nowhere
FEWER = Tolerance(at_least=5.0)

TEXT = """
`colonnade`, the middle of its walk, {size}: 4,896 displaced patches, many layers deep; every factor of every patch the
same. *Ideal* is a machine that shades the patches with a visible sample, whole, once in the frame, and queues them in
the tiles where they are seen; *visible triangles* is the least that any picture of this tessellation needs.

A tessellation factor costs the machine of today twice: it shades every point of every patch, seen or not, and it writes
every triangle to memory and reads it again. A queue of patches does not know the factor. A test against coarse Z saves
the more, the more it hides at once: the tests of queue entries are as many at every factor, those of triangles grow
with what is left.
"""


def _rows(table: dict[str, list[Any]], factors: Sequence[int]) -> list[Row]:
    def value(machine: str, factor: int, column: str) -> float:
        return float(value_of(table, column, machine=machine, factor=factor))

    rows = []
    for mode, allowed in (("patch", CONSTANT), ("subpatch", None)):
        written = [value(mode, factor, "queue_bytes") for factor in factors]
        note = "" if allowed else "the finer the tessellation, the more sub-domains, up to the budget of a patch"
        rows.append(
            Row(f"{mode}: queue bytes, largest over smallest", None, max(written) / min(written), "", allowed, note)
        )
    grown = value("triangle", 16, "queue_bytes") / value("triangle", 4, "queue_bytes")
    rows.append(Row("triangle: queue bytes, factor 16 over 4", None, grown, "", GROWS))
    for mode in ("patch", "subpatch"):
        for factor in factors:
            fewer = value("triangle", factor, "ds_invocations") / value(mode, factor, "ds_invocations")
            what = f"triangle / {mode}: domain-shader invocations, factor {factor}"
            rows.append(Row(what, None, fewer, "times", FEWER))
        for factor in factors:
            over = value(mode, factor, "ds_invocations") / value("ideal", factor, "ds_invocations")
            rows.append(Row(f"{mode} / ideal: domain-shader invocations, factor {factor}", None, over, "times", None))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    draw_panels(table, figure, "factor", "tessellation factor")


def run(context: Context) -> Result:
    """All modes at each factor."""
    factors, size = (QUICK_FACTORS, QUICK_SIZE) if context.quick else (FACTORS, SIZE)
    steps = [Step({"factor": f}, load_scene("colonnade", size=size, factor=f), FRAME, {}) for f in factors]
    table = run_steps(context, steps)
    units = {"factor": "tessellation factor, all six of every patch", **UNITS}
    text = TEXT.format(size="x".join(map(str, size)))
    return Result(tuple(_rows(table, factors)), table, units, lambda figure: _draw(table, figure), text)


ITEM = Item("beyond", "figure-factor", "Work over the tessellation factor", run)
