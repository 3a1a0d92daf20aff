"""Reports in a real browser: what hand, eye and ear get, on wide and narrow screens, in both themes."""

import importlib
import io
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

import tiler
from tests.scenes import patch_scene
from tests.study_tools import run as run_sweep
from tests.study_tools import write_study
from tiler.comparison import EVERYTHING, compare
from tiler.counters import DEFINITIONS
from tiler.heatmaps import overdraw_map
from tiler.report.colors import ramp

pytestmark = pytest.mark.browser

SIZE = (200, 120)
EVIL = "<b onclick=x>all</b>"


@pytest.fixture(scope="module")
def made(tmp_path_factory, load):
    """Frames of three machines, and their report."""
    scene = load("waves", size=SIZE, factor=3)
    machines = {
        "triangle": tiler.Machine(binning="triangle", cull=(), blame=True),
        "patch": tiler.Machine(tile=16, blame=True),
        EVIL: tiler.Machine(tile=16, blame=True, **EVERYTHING),
    }
    frames = compare(scene, machines).frames
    file = tmp_path_factory.mktemp("report") / "r.html"
    tiler.write_report(frames, file, scene=scene, command="tiler compare waves")
    return frames, file


@pytest.fixture
def page(made, open_report):
    return open_report(made[1])


def playwright() -> ModuleType:
    """Loaded late: without it the tests are skipped, not broken."""
    return importlib.import_module("playwright.sync_api")


def place(page, x: float, y: float) -> tuple[float, float]:
    """Where on the screen the pixel (x, y) of the picture is."""
    page.locator("#stage").scroll_into_view_if_needed()
    box = page.locator("#stage").bounding_box()
    return box["x"] + (x + 0.5) / SIZE[0] * box["width"], box["y"] + (y + 0.5) / SIZE[1] * box["height"]


def line(page, title: str) -> list[str]:
    """The numbers of a line of the read-out."""
    return (
        page.locator("#readout tr", has=page.get_by_role("rowheader", name=title, exact=True))
        .locator("td")
        .all_inner_texts()
    )


def colour(page, x: int, y: int) -> list[int]:
    """RGBA of the map's canvas, read from a copy: many readings of one canvas make the browser complain."""
    return page.evaluate(
        """([x, y]) => {
            const one = document.createElement("canvas").getContext("2d");
            one.drawImage(document.querySelector("#stage canvas"), -x, -y);
            return [...one.getImageData(0, 0, 1, 1).data];
        }""",
        [x, y],
    )


def number(text: str) -> int:
    return int(text.replace(",", ""))


def test_hover_tells_the_tile_the_pixel_and_the_patch(page, made):
    frames, _ = made
    expect, live = playwright().expect, page.locator("#live")
    for x, y in ((30, 50), (170, 90)):  # left and right of the divider
        page.mouse.move(*place(page, x, y))
        tile = 32 if x < 100 else 16
        assert page.locator("#readout h3").first.inner_text().startswith(f"Tile {x // tile}, {y // tile}")
        triangle, everything = frames["triangle"], frames[EVIL]
        expected = [triangle.queues.entries[y // 32, x // 32], everything.queues.entries[y // 16, x // 16]]
        assert [number(text) for text in line(page, "Queue length")] == expected
        assert line(page, "Domain-shader invocations")[0] == "–", "triangle binning shades in no tile"
        assert number(line(page, "Wasted invocations")[1]) == everything.blame.wasted_domain_points[y // 16, x // 16]
        assert f"Pixel {x}, {y}" in page.locator("#readout").inner_text()
        assert page.locator(".patch").inner_text().startswith("Patch ")
        assert page.locator(".bound-box").is_visible() and page.locator(".tile-box").is_visible()
        expect(live).to_contain_text(
            f"Tile {x // tile}, {y // tile}. Queue length, entries: {expected[0]:,} in triangle;"
        )


def test_a_click_holds_the_place(page):
    page.mouse.click(*place(page, 30, 50))
    page.mouse.move(*place(page, 60, 100))
    assert "Pixel 30, 50" in page.locator("#readout").inner_text() and "held" in page.locator("#readout").inner_text()
    page.mouse.click(*place(page, 60, 100))
    page.mouse.move(*place(page, 61, 100))
    assert "Pixel 61, 100" in page.locator("#readout").inner_text()


def test_another_map_changes_picture_scale_and_definition(page, made, load):
    frames, _ = made
    scene = load("waves", size=SIZE, factor=3)
    page.locator("#opacity").fill("100")
    tiles = frames["triangle"].tiles["ps_invocations"][:, :3]
    row, column = np.argwhere((tiles > 0) & (tiles < tiles.max()))[0]
    x, y = int(column) * 32 + 3, int(row) * 32 + 3
    before = colour(page, x, y)
    page.locator("#map-choice").select_option("ps_invocations")
    assert DEFINITIONS["ps_invocations"].text[:40] in page.locator("#map-text").inner_text()
    most = max(frames[name].tiles["ps_invocations"].max() for name in ("triangle", EVIL))
    assert page.locator(".ends span").last.inner_text() == f"{most:,} pixels a tile"
    value = frames["triangle"].tiles["ps_invocations"][row, column]
    assert colour(page, x, y)[:3] == ramp()[round(float(value / most) * 255)].tolist() != before[:3]
    page.get_by_label("Logarithmic").check()
    assert colour(page, x, y)[:3] == ramp()[round(float(np.log1p(value) / np.log1p(most)) * 255)].tolist()
    page.get_by_label("Logarithmic").uncheck()
    page.locator("#map-choice").select_option("overdraw")
    assert page.locator(".ends span").last.inner_text().endswith("samples a pixel")
    told = page.locator("#map-numbers tbody tr > :nth-child(2)").all_inner_texts()
    values = np.sort(overdraw_map(scene, frames["triangle"].machine).ravel())
    at = [int(values[min(len(values) - 1, int(part * len(values)))]) for part in (0.95, 0.5)]
    assert [number(text) for text in told[:4]] == [values.sum(), values.max(), *at]
    assert float(told[4]) == pytest.approx(values.mean(), rel=1e-3)
    assert told[5] == f"{100 * (values > 0).mean():.1f} %"
    page.locator("#map-choice").select_option("")
    assert colour(page, x, y)[:3] == frames["triangle"].color[y, x, :3].tolist(), "only the picture"


def test_each_side_may_have_a_scale_of_its_own(page, made):
    frames, _ = made
    assert page.locator(".scale").count() == 1
    page.get_by_label("One scale for both").uncheck()
    tops = [frames[name].queues.entries.max() for name in ("triangle", EVIL)]
    assert page.locator(".ends span:last-child").all_inner_texts() == [f"{top:,} entries a tile" for top in tops]


def test_the_divider_is_dragged(page, made):
    page.locator("#opacity").fill("100")
    divider = page.locator(".divider")
    assert divider.get_attribute("aria-valuenow") == "50"
    before = colour(page, 60, 60)
    x, y = place(page, 100, 60)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(place(page, 20, 60)[0], y, steps=4)
    page.mouse.up()
    assert divider.get_attribute("aria-valuenow") in ("10", "11")
    after = colour(page, 60, 60)
    assert after != before, "the other machine's map is there now"
    page.locator("#left-choice").select_option("2")
    assert divider.is_hidden(), "one machine on both sides needs no divider"
    assert page.locator(".side").all_inner_texts() == [EVIL, ""]


def test_counters_are_sorted_searched_and_explained(page, made):
    frames, _ = made
    values = frames["triangle"].counters
    shown = [name for name in DEFINITIONS if any(frame.counters[name] for frame in frames.values())]
    names = page.locator("#counter-table tbody th")
    heading = page.locator("#counter-table thead").get_by_role("button", name="triangle", exact=True)
    column = page.locator("#counter-table thead th", has=page.get_by_role("button", name="triangle", exact=True))
    assert names.all_inner_texts() == shown
    heading.click()
    assert column.get_attribute("aria-sort") == "descending"
    assert [values[name] for name in names.all_inner_texts()] == sorted((values[name] for name in shown), reverse=True)
    heading.click()
    assert column.get_attribute("aria-sort") == "ascending"
    assert [values[name] for name in names.all_inner_texts()] == sorted(values[name] for name in shown)
    heading.click()
    assert column.get_attribute("aria-sort") == "none" and names.all_inner_texts() == shown
    page.locator("#counters").get_by_label("Search").fill("d3d11 DSINV")
    assert names.all_inner_texts() == ["ds_invocations"]
    base, other = values["ds_invocations"], frames["patch"].counters["ds_invocations"]
    cells = page.locator("#counter-table tbody td").all_inner_texts()
    assert cells[2:5] == [f"{base:,}", f"{other:,}", f"×{float(f'{other / base:.3g}'):g}"]
    page.get_by_role("button", name="ds_invocations").click()
    assert DEFINITIONS["ds_invocations"].text[:20] in page.locator("#counter-table .more").inner_text()
    page.locator("#counters").get_by_label("Search").fill("no such counter")
    assert page.locator("#counter-table tbody").inner_text() == "No counter has these words."


def test_waterfalls_tell_the_numbers(page, made):
    frames, _ = made
    falls = page.locator("table.fall")
    assert falls.count() == 2
    last = falls.nth(1).locator("tr.left td span").all_inner_texts()
    assert [number(text) for text in last] == [frame.blame.invocations["useful"] for frame in frames.values()]
    bar = falls.nth(1).locator("tr.left i").nth(1)
    own = bar.evaluate("bar => bar.style.getPropertyValue('--long')")
    page.get_by_label("Bars of all machines on one scale").check()
    shared = falls.nth(1).locator("tr.left i").nth(0).evaluate("bar => bar.style.getPropertyValue('--long')")
    counts = [frame.counters["ds_invocations"] for frame in frames.values()]
    useful = frames["patch"].blame.invocations["useful"]
    assert float(own) == pytest.approx(useful / counts[1]) and float(shared) == pytest.approx(useful / max(counts))
    assert not page.get_by_text("Points of triangles with a visible sample, each").is_visible()
    page.locator("#waterfall").get_by_label("Definitions").check()
    assert page.get_by_text("Points of triangles with a visible sample, each").is_visible()


def focused(page) -> str:
    return page.evaluate("(e => e.id || e.className || e.tagName)(document.activeElement)")


def ring(page) -> str:
    """The outline of what has the focus, or of the divider's knob."""
    return page.evaluate("""() => {
        const here = document.activeElement;
        return getComputedStyle(here.matches(".divider") ? here.firstChild : here).outlineStyle;
    }""")


def test_keys_do_what_the_pointer_does(page, made):
    frames, _ = made
    reached = []
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.append(focused(page))
        assert ring(page) == "solid", f"the focus on {reached[-1]} is seen"
        if reached[-1] == "stage":
            break
    assert {"theme", "map-choice", "left-choice", "right-choice", "opacity"} < set(reached) and reached[-1] == "stage"
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    heading = page.locator("#readout h3").first
    before = heading.inner_text().split("\n")[0]
    row = int(before.split(", ")[1])
    assert before == f"Tile 1, {row}"
    page.keyboard.press("ArrowRight")
    assert heading.inner_text().startswith(f"Tile 2, {row}")
    value = frames["triangle"].queues.entries[row, 2]
    playwright().expect(page.locator("#live")).to_contain_text(f"Queue length, entries: {value:,} in triangle")
    pixel = page.locator("#readout h3").nth(1)
    at = int(pixel.inner_text().split()[1].rstrip(","))
    page.keyboard.press("Shift+ArrowRight")
    assert pixel.inner_text().startswith(f"Pixel {at + 1},")
    for _ in range(12):
        page.keyboard.press("ArrowRight")
    assert pixel.inner_text().startswith("Pixel 199,"), "the picture has an end"
    page.keyboard.press("]")
    assert page.locator("#map-choice").input_value() == "queue_bytes"
    page.keyboard.press("[")
    page.keyboard.press("Tab")
    assert focused(page) == "divider" and ring(page) == "solid"
    for key, value in (("ArrowRight", "51"), ("PageUp", "61"), ("Home", "0"), ("End", "100"), ("ArrowLeft", "99")):
        page.keyboard.press(key)
        assert page.locator(".divider").get_attribute("aria-valuenow") == value
    page.get_by_role("button", name="Go to the largest").focus()
    page.keyboard.press("Enter")
    assert number(line(page, "Queue length")[0]) == frames["triangle"].queues.entries.max()
    page.locator("#numbers, .numbers").locator("summary").focus()
    page.keyboard.press("Enter")
    assert number(page.locator("#largest-tiles td").first.inner_text()) == frames["triangle"].queues.entries.max()


def brightness(shot: bytes) -> float:
    """Median of a screenshot's border on the left, which is paper: 0 to 255."""
    return float(np.median(np.asarray(Image.open(io.BytesIO(shot)).convert("L"))[:, :8]))


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_themes_and_widths(made, open_report, theme, width):
    page = open_report(made[1], width, color_scheme=theme)
    shot = page.screenshot(full_page=True)
    assert (brightness(shot) > 200) == (theme == "light")
    assert len(np.unique(np.asarray(Image.open(io.BytesIO(shot)).convert("L")))) > 60
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out"
    other = "dark" if theme == "light" else "light"
    page.locator("#theme").select_option(other)
    assert (brightness(page.screenshot()) > 200) == (other == "light")
    stage, aside = page.locator("#stage").bounding_box(), page.locator("aside").bounding_box()
    beside = aside["x"] >= stage["x"] + stage["width"]
    assert beside == (width == 1440)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_has_contrast(made, open_report, theme):
    page = open_report(made[1], color_scheme=theme)
    pairs = page.evaluate("""() => {
        const paint = (colour) => {
            const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
            context.fillStyle = colour;
            context.fillRect(0, 0, 1, 1);
            return [...context.getImageData(0, 0, 1, 1).data].slice(0, 3);
        };
        const paper = paint(getComputedStyle(document.body).backgroundColor);
        return ["body", ".about", "nav a", ".good", "#figures small", ".ratio", "dt", "#map-text"].map((where) =>
            [where, paint(getComputedStyle(document.querySelector(where)).color), paper]);
    }""")
    for where, ink, paper in pairs:
        linear = [((np.array(c) / 255 + 0.055) / 1.055) ** 2.4 @ (0.2126, 0.7152, 0.0722) for c in (ink, paper)]
        assert (max(linear) + 0.05) / (min(linear) + 0.05) >= 4.5, f"{where}: WCAG 2 asks for 4.5"


def test_nothing_moves_for_who_asked_for_that(made, open_report):
    behaviour = "getComputedStyle(document.documentElement).scrollBehavior"
    assert open_report(made[1], reduced_motion="reduce").evaluate(behaviour) == "auto"
    assert open_report(made[1], reduced_motion="no-preference").evaluate(behaviour) == "smooth"


def test_names_are_text(page):
    assert page.locator("#figures tbody th").all_inner_texts() == ["triangle", "patch", EVIL]
    assert page.locator("b").count() == 0
    assert page.title() == "waves · tilesim report"


def test_a_frame_with_no_patch_and_one_without_its_scene(open_report, tmp_path, load):
    empty = patch_scene([])
    tiler.write_report(tiler.simulate(empty, tiler.Machine(blame=True)), tmp_path / "a.html", scene=empty)
    page = open_report(tmp_path / "a.html")
    page.locator("#stage").focus()
    page.keyboard.press("ArrowRight")
    assert "No patch is seen here." in page.locator("#readout").inner_text()
    tiler.write_report(tiler.simulate(load("teapot", size=(64, 48), factor=2)), tmp_path / "b.html")
    page = open_report(tmp_path / "b.html")
    page.mouse.move(*place(page, 100, 60))
    assert "Tile 1, 0" in page.locator("#readout").inner_text() and page.locator("#left-choice").count() == 0
    assert page.locator("table.fall").count() == 1 and "patches alive" in page.locator("table.fall").inner_text()


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    text = (
        write_study(folder, 1).read_text()
        + '\n[machine.full]\nbinning = "triangle"\nqueue_pool = 5000\nqueue_policy = "fail"\n'
    )
    (folder / "s.toml").write_text(text.replace('["triangle", "small"]', '["triangle", "small", "full"]'))
    run_sweep(folder / "s.toml", "--out", folder / "s.db", "--report", folder / "s.html", "-q")
    return tiler.load_study(folder / "s.db"), folder / "s.html"


def test_a_study_is_plotted_filtered_and_sorted(study, open_report):
    results, file = study
    page = open_report(file)
    rows, _, failed = results.tally()
    assert page.locator("h1").inner_text() == "tiny" and f"{failed} failed" in page.locator(".about").inner_text()
    assert page.locator("#failure-table td").first.inner_text() == str(failed)
    assert (
        page.locator("#plot-y").input_value() == "ds_invocations"
        and page.locator("#plot-x").input_value() == "tessellation.factor"
    )
    named = page.locator(".keys-of-plot li").all_inner_texts()
    assert named == ["triangle", "small", "full"] and page.locator("svg.plot .curve").count() == 3
    page.locator("#plot summary").click()
    page.locator("#plot-table td").first.wait_for(state="visible")  # what is folded has no text

    def mean(machine: str, factor: int, counter: str) -> float | None:
        where = {"machine": machine, "tessellation.factor": factor, "status": "ok"}
        values = [row[counter] for row in results.rows([counter], **where)]
        return sum(values) / len(values) if values else None

    def plotted() -> list[float | None]:
        cells = page.locator("#plot-table td").all_inner_texts()
        return [None if text == "–" else float(text.replace(",", "")) for text in cells]

    for counter in ("ds_invocations", "queue_bytes"):
        page.locator("#plot-y").select_option(counter)
        expected = [mean(machine, factor, counter) for factor in (2, 3) for machine in named]
        assert plotted() == [None if value is None else pytest.approx(value, rel=1e-3) for value in expected]
        assert expected[-1] is None, "what failed has no point"
    assert results.columns["queue_bytes"].text[:30] in page.locator("#plot p").inner_text()
    page.locator("[data-filter=view]").select_option("around")
    around = results.rows(["row"], view="around")
    assert page.locator("#rows .found").inner_text() == f"{len(around)} of {rows} rows"
    page.locator("#study-table thead").get_by_role("button", name="queue_bytes").click()
    titles = [text.strip("↓↑ \n") for text in page.locator("#study-table thead th").all_inner_texts()]
    cells = page.locator(f"#study-table tbody tr > :nth-child({titles.index('queue_bytes') + 1})").all_inner_texts()
    values = [number(text) for text in cells if text != "–"]
    assert values == sorted(values, reverse=True) and len(set(values)) > 1 and cells[-1] == "–", (
        "what has no value is last"
    )
    page.get_by_label("Failed only").check()
    assert page.locator("#rows .found").inner_text() == f"{len(around) // 3} of {rows} rows"
    assert page.locator("#plot").get_by_text("No value to plot.").is_visible()


def test_a_long_study_has_pages(study, open_report, made):
    page = open_report(study[1], 390, color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    rows = study[0].tally().rows
    assert page.locator("#study-table tbody tr").count() == 100
    page.get_by_role("button", name="Next").click()
    assert (
        page.locator("#study-table tbody tr").count() == rows - 100
        and page.get_by_role("button", name="Next").is_disabled()
    )
    assert page.locator("#study-table tbody th").first.inner_text() == "100"


def test_a_report_that_cannot_be_unpacked_says_so(made, browser, tmp_path: Path):
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script("delete window.DecompressionStream")
    page.goto(made[1].as_uri())
    page.wait_for_selector("#map-text.bad")
    assert "a browser of 2023 or newer can" in page.locator("#map-text").inner_text()
    assert page.locator("#counter-table tbody th").count() > 20, "the tables are there all the same"
    context.close()
