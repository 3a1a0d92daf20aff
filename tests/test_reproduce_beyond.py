"""What no paper shows: the items run quickly and hold what they state; their parts by hand."""

import copy
from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest
from matplotlib.figure import Figure

import tiler
from tiler.reproduce import style
from tiler.reproduce.beyond import figure_factor, figure_feedback, machines, panels, table_1, table_break_even
from tiler.reproduce.beyond.forest import COLUMNS, forest
from tiler.reproduce.catalog import item_names
from tiler.reproduce.item import Context, Result, row_ok
from tiler.scene.camera import camera_at

SMALL = (160, 90)


def quick(update: Callable[[float], None] = lambda part: None) -> Context:
    return Context(models=None, quick=True, threads=None, seed=0, update=update)


def check_result(result: Result, made: str) -> None:
    """Columns, units, and a figure that follows from the table alone, the same every time."""
    lengths = {len(values) for values in result.table.values()}
    assert len(lengths) == 1 and lengths.pop() > 0
    assert result.units.keys() == result.table.keys()
    assert result.draw is not None
    png, svg = style.figure_files(result.draw)
    assert png[:4] == b"\x89PNG" and b"</svg>" in svg
    module = import_module(made)
    kept = copy.deepcopy(result.table)
    assert style.figure_files(lambda figure: module._draw(kept, figure)) == (png, svg)


@pytest.mark.slow
@pytest.mark.parametrize("name", item_names("beyond"))
def test_every_item_holds_what_it_states(name: str) -> None:
    """All but the distance to the ideal, which the project is on its way to."""
    made = f"tiler.reproduce.beyond.{name.replace('-', '_')}"
    parts: list[float] = []
    result = import_module(made).ITEM.run(quick(parts.append))
    check_result(result, made)
    stated = [row for row in result.rows if row.tolerance is not None and " / ideal" not in row.what]
    assert len(stated) >= 3
    assert [row.what for row in stated if row_ok(row) is False] == []
    assert parts == sorted(parts) and parts[-1] == pytest.approx(1.0)


def test_over_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Triangle binning shades (factor + 1)^2 points of each patch; the ideal is below a machine of whole patches."""
    monkeypatch.setattr(figure_factor, "QUICK_SIZE", SMALL)
    result = figure_factor.ITEM.run(quick())
    check_result(result, "tiler.reproduce.beyond.figure_factor")
    patches = tiler.load_scene("colonnade").num_patches
    for factor in figure_factor.QUICK_FACTORS:

        def value(machine: str, column: str = "ds_invocations", factor: int = factor) -> int:
            return int(machines.value_of(result.table, column, machine=machine, factor=factor))

        assert value("triangle") == patches * (factor + 1) ** 2
        assert 0 < value("ideal, triangles") <= value("ideal") <= value("patch") <= value("triangle")
        assert 0 < value("ideal", "queue_bytes") <= value("patch", "queue_bytes") < value("triangle", "queue_bytes")
        assert machines.value_of(result.table, "cz_tests", machine="triangle", factor=factor) is None
        assert value("patch", "cz_tests") >= value("patch", "queue_entries")


def test_the_ideal_needs_blame() -> None:
    scene = tiler.load_scene("teapot", size=SMALL, factor=2)
    with pytest.raises(ValueError, match="blame"):
        machines.ideal_measures(tiler.simulate(scene, machines.machine_of("patch")))
    with pytest.raises(ValueError, match="0 rows"):
        machines.value_of({"machine": ["patch"], "x": [1]}, "x", machine="triangle")


def test_forest() -> None:
    """Rows of columns; a ray through the middle meets more of them the more there are, and only the first are seen."""
    one, many = forest(1, SMALL, 4), forest(12, SMALL, 4)
    assert one.num_patches == 3 * 4 * COLUMNS and many.num_patches == 12 * one.num_patches
    assert len(many.transforms) == len(np.unique(many.object_id)) == 36
    frame = tiler.simulate(many, machines.machine_of("patch", blame=True))
    assert frame.blame is not None
    assert 4 * frame.blame.ideal["ideal_patches"] < many.num_patches


@pytest.mark.parametrize("speed", [0, 1, 4, 32])
def test_the_view_is_the_same_at_any_speed(speed: int) -> None:
    """The camera of the frame itself; that of the frame before is farther away the faster it comes."""
    scene = tiler.load_scene("colonnade", size=SMALL)
    moved = figure_feedback.at_speed(scene, speed)
    here = [camera_at(s.camera, figure_feedback.FRAME, 16 / 9) for s in (scene, moved)]
    assert np.allclose(here[0].clip_from_world, here[1].clip_from_world, rtol=0, atol=1e-6)
    before = camera_at(moved.camera, figure_feedback.FRAME - 1, 16 / 9)
    away = camera_at(scene.camera, figure_feedback.FRAME - speed, 16 / 9)
    assert np.allclose(before.eye, away.eye, rtol=0, atol=1e-9)


def test_break_even_says_where_costs_cross() -> None:
    """By hand: a technique that costs 100 a frame and half as much a factor is cheaper from 200 / baseline's slope on."""
    rows = []
    for factor in (1, 2, 4):
        for technique, cost in (
            (table_break_even.BASELINE, 50.0 * factor),
            ("cheaper", 100.0),
            ("dearer", 60.0 * factor),
        ):
            rows.append({"scene": "s", "technique": technique, "model": "m", "factor": factor, "cost": cost})
    table = table_break_even._table(rows, (1, 2, 4))
    found = table_break_even._found(table)
    assert found["s", table_break_even.BASELINE, "m"] is None and found["s", "dearer", "m"] is None
    assert found["s", "cheaper", "m"] == pytest.approx(2.0)
    assert table["of_baseline"] == pytest.approx([1, 2, 1.2, 1, 1, 1.2, 1, 0.5, 1.2])
    (cheaper,) = [row for row in table_break_even._rows(table) if "cheaper" in row.what]
    (dearer,) = [row for row in table_break_even._rows(table) if "dearer" in row.what]
    assert cheaper.measured == pytest.approx(2.0) and cheaper.note == ""
    assert dearer.measured == table_break_even.NEVER and dearer.note.startswith("never")


def test_different_pictures_fail() -> None:
    table: dict[str, list[object]] = {"scene": [], "machine": [], "ds_invocations": [], "queue_bytes": []}
    for machine in (*table_1.MACHINES, "ideal"):
        for column, value in zip(table.values(), ("waves", machine, 10, 10), strict=True):
            column.append(value)
    for same in (True, False):
        rows = table_1._rows(table, {"waves": same})
        assert [row_ok(row) for row in rows if "identical" in row.what] == [same]


def test_names_are_moved_apart() -> None:
    """As little as is needed, in order, and not at all where there is room."""
    assert panels.spread_apart([0.1, 0.5, 0.9], [0.1] * 3) == pytest.approx([0.1, 0.5, 0.9])
    assert panels.spread_apart([0.5, 0.5], [0.1, 0.1]) == pytest.approx([0.45, 0.55])
    assert panels.spread_apart([0.2, 0.25, 0.26], [0.1, 0.2, 0.1]) == pytest.approx([0.0867, 0.2367, 0.3867], abs=1e-3)
    rng = np.random.default_rng(5)
    for _ in range(50):
        places, sizes = np.sort(rng.random(6)), 0.02 + 0.1 * rng.random(6)
        spread = np.array(panels.spread_apart(list(places), list(sizes)))
        assert (np.diff(spread) >= (sizes[1:] + sizes[:-1]) / 2 - 1e-12).all()


@pytest.mark.parametrize(("value", "text"), [(0.5, "0.5"), (20, "20"), (2000, "2 k"), (5e6, "5 M"), (1e9, "1 G")])
def test_counts_are_said_shortly(value: float, text: str) -> None:
    assert panels.short_count(value) == text


def test_a_panel_names_its_lines() -> None:
    """Each machine's name and how many times fewer; a machine without the measure has none."""
    table: dict[str, list[object]] = {
        "factor": [],
        "machine": [],
        "ds_invocations": [],
        "queue_bytes": [],
        "cz_tests": [],
    }
    for factor in (4, 8):
        for machine, shaded, tests in (("triangle", 1000, None), ("patch", 100, 7), ("ideal", 50, None)):
            for column, value in zip(table.values(), (factor, machine, shaded, shaded, tests), strict=True):
                column.append(value)
    figure = Figure()
    panels.draw_panels(table, figure, "factor", "factor")
    texts = [[text.get_text() for text in axes.texts] for axes in figure.axes]
    assert texts == [["ideal:\nvisible patches", "patch\n10x fewer", "triangle"]] * 2 + [["patch"]]
