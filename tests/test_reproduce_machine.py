"""The machine of Munkberg et al. 2010: Table 2 and Figure 11, an animation with each bound; Figure 8, overlap of bounds."""

import numpy as np
import pytest

import tiler
from tests.test_reproduce_beyond import quick
from tiler.reproduce import style
from tiler.reproduce.item import row_ok
from tiler.reproduce.munkberg2010 import animation, figure_8, figure_11, table_2

SMALL = (160, 90)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small pictures, two factors, nothing measured yet."""
    monkeypatch.setattr(animation, "QUICK_SIZE", SMALL)
    monkeypatch.setattr(animation, "QUICK_FACTORS", (4, 32))
    monkeypatch.setattr(animation, "QUICK_FRAMES", (0, 96))
    monkeypatch.setattr(animation, "REPEATS", 1)
    monkeypatch.setattr(animation, "_MEASURED", {})


@pytest.mark.parametrize("number", [0, 64, 96])
def test_every_bound_draws_the_same_animation(number: int) -> None:
    """And culls what it should: nothing by a box while all is in view, and more the tighter it is in the zoom."""
    scene = animation.animation(SMALL, 4)
    frames = {name: tiler.simulate(scene, machine, frame=number) for name, machine in animation.MACHINES.items()}
    for frame in frames.values():
        assert np.array_equal(frame.color, frames["none"].color)
        assert np.array_equal(frame.depth_samples, frames["none"].depth_samples)
    shaded = {name: frame.counters["ds_invocations"] for name, frame in frames.items()}
    assert shaded["tpatch"] < 0.75 * shaded["none"]
    if number == 0:
        assert shaded["cbox"] == shaded["obbtex"] == shaded["none"]
    else:
        assert shaded["tpatch"] < shaded["obbtex"] <= shaded["cbox"] < 0.85 * shaded["none"]


def test_published_beside_measured(small: None) -> None:
    """Ratios of the paper's times; work that a model says holds its limits; one measurement serves both items."""
    first, second = table_2.ITEM.run(quick()), figure_11.ITEM.run(quick())
    published = {row.what: row.published for row in first.rows}
    assert published["factor 4, tpatch / none: frame time"] == pytest.approx(3.89 / 2.75)
    assert published["factor 32, cbox / none: frame time"] == pytest.approx(93.5 / 125)
    assert published["factor 32, tpatch / cbox: frame time"] == pytest.approx(86 / 93.5)
    assert published["factor 32, tpatch / none: domain-shader work with bounds"] is None
    work = [row for row in (*first.rows, *second.rows) if row.tolerance is not None and "work" in row.what]
    assert len(work) == 3 + 1 + 2 * 3
    assert [
        row.what for row in work if row_ok(row) is False
    ] == []  # frame times are not counted here: they are of this moment
    assert second.table is animation.measure(quick())
    for result in (first, second):
        assert result.units.keys() == result.table.keys()
        assert result.draw is not None
        assert style.figure_files(result.draw) == style.figure_files(result.draw)
    mean = animation.means(second.table, "ds_invocations", 4)
    rows = zip(first.table["factor"], first.table["machine"], first.table["ds_invocations"], strict=True)
    assert {machine: value for factor, machine, value in rows if factor == 4} == mean


def test_overlap_of_bounds() -> None:
    """Tighter bounds lie over fewer pixels, none over less than its surface; the figure follows from its table."""
    result = figure_8.ITEM.run(quick())
    assert [row.what for row in result.rows if row_ok(row) is False] == []
    assert any("creature" in row.what for row in result.rows) and "ran in place of monsterfrog" in result.text
    assert result.units.keys() == result.table.keys()
    loose, tight, surface = (np.array(result.table[name]) for name in ("cbox", "tpatch", "surface"))
    assert loose.sum() > 1.5 * tight.sum() > 1.5 * surface.sum()
    assert result.draw is not None
    assert style.figure_files(result.draw)[0][:4] == b"\x89PNG"


def test_a_pixel_without_a_box_fails() -> None:
    """The rows see a bound that leaves one pixel of the surface out."""
    values = {name: np.full((4, 4), 2, np.int32) for name in (figure_8.SURFACE, *figure_8.BOUNDS)}
    assert not [row for row in figure_8._rows(figure_8.Maps("m", values)) if row_ok(row) is False]
    values["npatch"][1, 2] = 0
    wrong = [row.what for row in figure_8._rows(figure_8.Maps("m", values)) if row_ok(row) is False]
    assert "m, npatch: pixels with surface and without a box" in wrong
