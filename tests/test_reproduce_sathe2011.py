"""`tiler reproduce sathe2011`: the items run, their rows hold, and the views are what they are called."""

from itertools import pairwise

import numpy as np
import pytest

from tiler.reproduce.catalog import item_names, load_item
from tiler.reproduce.item import Context, row_ok
from tiler.reproduce.over_factors import curve, relative
from tiler.reproduce.patch_pictures import seen_patches
from tiler.reproduce.sathe2011.figure_9 import HEIGHT, WIDTH
from tiler.reproduce.sathe2011.views import MACHINES, QUICK_SIZE, moved_view, open_subject, outside, shift_for
from tiler.reproduce.style import figure_files
from tiler.reproduce.write import check_table
from tiler.simulation import simulate

QUICK = Context(models=None, quick=True, threads=1, seed=0, update=lambda part: None)
ITEMS = item_names("sathe2011")


@pytest.fixture(scope="module")
def small():
    """The items run on the small creature, whose frames are a tenth as long."""
    with pytest.MonkeyPatch.context() as patch:
        from tiler.reproduce import models

        patch.setitem(models.MODELS, "monsterfrog", models.MODELS["monsterfrog"]._replace(stand_in="creature_small"))
        yield


@pytest.fixture(scope="module")
def results(small):
    return {name: load_item("sathe2011", name).run(QUICK) for name in ITEMS}


@pytest.fixture(scope="module")
def subject(small):
    return open_subject(QUICK)


def halves(row):
    """Rows about half of the patches: 104 of them do not always part so evenly."""
    return "half" in row.what and row.unit == "%"


@pytest.mark.parametrize("name", ITEMS)
def test_items_run_hold_and_are_drawn(name, results):
    result = results[name]
    check_table(result)
    wrong = [row for row in result.rows if row_ok(row) is False and not halves(row)]
    assert not wrong and sum(row_ok(row) is True for row in result.rows) >= 4, wrong
    png, svg = figure_files(result.draw)
    assert png.startswith(b"\x89PNG") and len(png) > 10_000
    assert b"<text" in svg
    assert "{" not in result.text and "creature" in result.text


def test_views_have_as_much_outside_as_is_asked_for(subject):
    n = subject.scene.num_patches
    for share in (0.0, 0.25, 0.5, 1.0):
        gone = outside(moved_view(subject, shift_for(subject, share, QUICK_SIZE), QUICK_SIZE)).sum()
        assert share * n <= gone <= share * n + 2


def test_the_cull_drops_nothing_of_the_picture(subject):
    scene = moved_view(subject, shift_for(subject, 0.5, QUICK_SIZE), QUICK_SIZE)
    pictures = {name: simulate(scene, machine, threads=1) for name, machine in MACHINES.items()}
    gone = {name: int(frame.counters["hs_culled_frustum"]) for name, frame in pictures.items()}
    assert gone["none"] == 0 and gone["max_displacement"] == outside(scene).sum() > 0
    assert gone["tpatch"] >= gone["max_displacement"]
    for frame in pictures.values():
        np.testing.assert_array_equal(frame.color, pictures["none"].color)


def test_cycles_are_the_same_every_time_and_fall_with_the_factor(results, small):
    table = results["figure-6"].table
    again = load_item("sathe2011", "figure-6").run(QUICK).table
    assert table["cycles"] == again["cycles"] and table["ds_invocations"] == again["ds_invocations"]
    for name in list(MACHINES)[1:]:
        more = relative(table, name, "cycles")
        assert all(a > b > 1.0 for a, b in pairwise(more)), more
        assert curve(table, name, "ds_invocations") == curve(table, "none", "ds_invocations")


def test_what_the_camera_sees_is_not_culled(results, subject):
    """Patches with a pixel in the view are kept; and the picture is that of the view."""
    table = results["figure-9"].table
    seen = [bool(text) for text in table["pixels_camera"]]
    culled = table["culled"]
    half = [view == "half outside" for view in table["view"]]
    assert any(c for c, h in zip(culled, half, strict=True) if h)
    assert not any(s and c for s, c in zip(seen, culled, strict=True))
    assert not any(c for c, h in zip(culled, half, strict=True) if not h)
    view = moved_view(subject, 0.0, (WIDTH, HEIGHT), plain=True)
    numbers = set(np.unique(seen_patches(view, 1))) - {-1}
    assert numbers == {p for p, s, h in zip(table["patch"], seen, half, strict=True) if s and not h}
