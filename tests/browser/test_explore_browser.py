"""The explorer in a real browser: the camera turns, parameters change what is counted, tiles and patches are looked into."""

import importlib
import threading
from collections.abc import Iterator
from typing import Any

import pytest

import tiler
from tiler.explore.server import Explorer

pytestmark = pytest.mark.browser

SIZE = (480, 270)  # larger than a draft
WAIT = 300_000  # milliseconds, where kernels must be compiled first


@pytest.fixture(scope="module")
def explorer(load) -> Iterator[Explorer]:
    pytest.importorskip("uvicorn")
    pytest.importorskip("starlette")
    made = Explorer(load("waves", size=SIZE, factor=3), tiler.Machine(), threads=2)
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join(10)
    assert not thread.is_alive() and made.close()


@pytest.fixture
def open_explorer(browser, explorer) -> Iterator[Any]:
    """Opens the explorer; at the end no error was on the console, and nobody else was asked for anything."""
    contexts, problems = [], []
    own = explorer.url.partition("?")[0]

    def open_page(state: str = "", width: int = 1280, height: int = 900, **settings: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": height}, **settings)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(WAIT)
        page.on("console", lambda said: problems.append(f"{said.type}: {said.text}"))
        page.on("pageerror", lambda error: problems.append(f"error: {error}"))
        page.on("request", lambda made: problems.append(made.url) if not made.url.startswith((own, "data:")) else None)
        page.goto(f"{explorer.url}#{state}")
        settled(page)
        return page

    open_page.problems = problems
    yield open_page
    for context in contexts:
        context.close()
    assert not problems


def settled(page) -> None:
    page.wait_for_selector("#stage[data-settled=true]")


def place(page, x: float, y: float) -> tuple[float, float]:
    """Where on the screen a part of the picture is."""
    page.locator("#stage").scroll_into_view_if_needed()
    box = page.locator("#stage").bounding_box()
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def pixels(page) -> str:
    return page.evaluate("document.querySelector('#stage canvas').toDataURL()")


def counter(page, name: str) -> int:
    return int(page.locator(f"[data-counter={name}]").inner_text().replace(",", ""))


def expect(found: Any) -> Any:
    return importlib.import_module("playwright.sync_api").expect(found)


def drag(page, right: float, down: float, shift: bool = False) -> None:
    x, y = place(page, 0.5, 0.5)
    page.mouse.move(x, y)
    if shift:
        page.keyboard.down("Shift")
    page.mouse.down()
    for k in range(1, 5):
        page.mouse.move(x + k * right / 4, y + k * down / 4)
    page.mouse.up()
    if shift:
        page.keyboard.up("Shift")
    settled(page)


def test_the_first_view_is_the_scene_s_own(open_explorer, load):
    page = open_explorer()
    frame = tiler.simulate(load("waves", size=SIZE, factor=3))
    assert counter(page, "queue_entries") == frame.counters["queue_entries"]
    assert page.locator("#counted").inner_text().startswith("480 × 270 pixels;")
    assert page.locator("#counter-table tbody tr").count() == sum(value > 0 for value in frame.counters.values())


def test_hand_wheel_and_keys_turn_the_camera(open_explorer):
    page = open_explorer()
    seen = {pixels(page)}
    for move in (lambda: drag(page, 90, 20), lambda: drag(page, 0, 30, True), lambda: page.mouse.wheel(0, -240)):
        move()
        page.wait_for_timeout(50)
        settled(page)
        assert pixels(page) not in seen
        seen.add(pixels(page))
    page.locator("#stage").focus()
    for key in ("ArrowLeft", "ArrowUp", "Shift+ArrowRight", "-"):
        page.keyboard.press(key)
        settled(page)
        assert pixels(page) not in seen, key
        seen.add(pixels(page))
    page.keyboard.press("Home")
    settled(page)
    assert pixels(page) in seen, "the first view again"


def test_a_drag_shows_drafts_before_the_full_size(open_explorer):
    page = open_explorer()
    x, y = place(page, 0.5, 0.5)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y)
    page.wait_for_selector("#stage[data-full=false]")
    assert "320 × 180 draft" in page.locator("#status").inner_text()
    page.wait_for_timeout(300)
    assert page.locator("#stage").get_attribute("data-full") == "false", "not while the hand holds it"
    page.mouse.up()
    settled(page)
    assert page.locator("#status").inner_text().startswith("480 × 270 ·")


def test_a_changed_parameter_changes_the_counters(open_explorer, load):
    page = open_explorer()
    scene = load("waves", size=SIZE, factor=3)
    page.locator("#keep").click()
    page.locator("#field-binning").select_option(label="triangle")
    settled(page)
    page.locator("#field-tile").select_option(label="16")
    settled(page)
    frame = tiler.simulate(scene, tiler.Machine(binning="triangle", tile=16))
    assert counter(page, "queue_entries") == frame.counters["queue_entries"]
    assert counter(page, "ds_invocations") == frame.counters["ds_invocations"]
    assert "×" in page.locator(".figure .ratio").first.inner_text(), "beside what was kept"
    page.get_by_label("occlusion", exact=True).check()
    settled(page)
    frame = tiler.simulate(scene, tiler.Machine(binning="triangle", tile=16, cull=("frustum", "occlusion")))
    row = page.locator("#counter-table tr", has=page.get_by_text("cz_pairs_occluded", exact=True))
    assert int(row.locator("td").first.inner_text().replace(",", "")) == frame.counters["cz_pairs_occluded"]
    page.locator("#preset").select_option("as started")
    settled(page)
    assert counter(page, "queue_entries") == tiler.simulate(scene).counters["queue_entries"]


def test_what_the_machine_does_not_allow_is_told(open_explorer):
    page = open_explorer()
    page.locator("#field-binning").select_option(label="triangle")
    settled(page)
    page.locator("#field-queue_order").select_option(label="front_to_back")
    expect(page.locator("#alert")).to_contain_text(
        "queue_order: 'front_to_back'; allowed with binning='triangle': 'submit'"
    )
    page.locator("#field-cores").fill("many")
    page.locator("#field-cores").press("Enter")
    assert page.locator("#field-cores").get_attribute("aria-invalid") == "true"
    page.locator("#field-queue_order").select_option(label="submit")
    settled(page)
    assert not page.locator("#alert").is_visible()
    refused = [text for text in open_explorer.problems if "422" in text]
    open_explorer.problems[:] = [text for text in open_explorer.problems if text not in refused]
    assert refused, "the browser notes the refusal, and nothing else"


def test_a_click_lists_the_queue_and_draws_the_patch(open_explorer, load):
    page = open_explorer()
    page.mouse.click(*place(page, 0.5, 0.6))
    settled(page)
    frame = tiler.simulate(load("waves", size=SIZE, factor=3))
    row, column = int(0.6 * SIZE[1]) // 32, int(0.5 * SIZE[0]) // 32
    length = int(frame.queues.entries[row, column])
    assert page.locator("#queue h2 ~ .bar small").inner_text().startswith(f"{length:,} entr")
    assert page.locator("#queue-table tbody tr").count() == min(length, 100)
    assert [page.locator(".tile-number").nth(k).input_value() for k in (0, 1)] == [str(column), str(row)]
    assert page.locator(".boxes .box").count() == 1, "of the patch clicked on"
    assert page.locator(".boxes .box .edge").get_attribute("d").count("M") == 12
    page.locator("#patches [data-bound=tpatch]").check()
    settled(page)
    assert page.locator(".boxes .box").evaluate_all("all => all.map((one) => one.dataset.bound)") == ["cbox", "tpatch"]
    button = page.locator("#queue-table tbody button[aria-pressed=false]").first
    other = button.get_attribute("data-patch")
    button.click(modifiers=["Control"])
    settled(page)
    assert page.locator(f".boxes [data-patch='{other}']").count() == 2 and page.locator(".boxes .box").count() == 4
    chip = page.locator(".fates .chip").first
    chip.click()
    fates = set(page.locator("#queue-table .fate").all_inner_texts())
    assert len(fates) == 1 and chip.inner_text().startswith(fates.pop())
    page.locator(".tile-number").first.fill("0")
    page.locator(".tile-number").first.press("Enter")
    settled(page)
    assert (
        int(page.locator("#queue .bar small").inner_text().split()[0].replace(",", "")) == frame.queues.entries[row, 0]
    )
    page.locator("#stage").focus()
    page.keyboard.press("Escape")
    settled(page)
    assert page.locator(".boxes .box").count() == 0 and not page.locator("#queue-table").is_visible()


def test_a_page_loaded_again_shows_the_same(open_explorer):
    page = open_explorer()
    drag(page, 70, -20)
    page.locator("#field-tile").select_option(label="64")
    page.mouse.click(*place(page, 0.4, 0.7))
    settled(page)
    page.wait_for_timeout(300)
    before = [counter(page, name) for name in ("queue_entries", "ds_invocations")], pixels(page)
    assert "machine.tile=64" in page.url and "eye=" in page.url and "point=" in page.url
    page.reload()
    settled(page)
    assert ([counter(page, name) for name in ("queue_entries", "ds_invocations")], pixels(page)) == before
    assert page.locator("#field-tile").evaluate("one => one.selectedOptions[0].text") == "64"
    page.reload(wait_until="commit")
    try:
        page.reload()
    except importlib.import_module("playwright.sync_api").Error:  # the browser was just changing pages
        page.reload()
    settled(page)
    page.locator("#reset").click()
    settled(page)
    assert page.locator("#field-tile").evaluate("one => one.selectedOptions[0].text") == "32"


def test_an_address_that_makes_no_sense_shows_the_scene(open_explorer):
    page = open_explorer(
        "frame=x&eye=1,2&machine.tile=%7B&machine.nothing=1&map=%22no%22&point=7,8&patches=99999,a&bounds=z&opacity=[]"
    )
    assert page.locator("#field-tile").evaluate("one => one.selectedOptions[0].text") == "32"
    assert page.locator(".boxes .box").count() == 0


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_nothing_sticks_out(open_explorer, theme, width):
    page = open_explorer("point=0.5,0.6&patches=500&bounds=tpatch", width, color_scheme=theme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert (page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)") == (
        theme == "light"
    )
    stage, machine = page.locator("#stage").bounding_box(), page.locator("#machine").bounding_box()
    assert (machine["x"] + machine["width"] <= stage["x"]) == (width == 1440)


def test_a_server_that_is_gone_is_told(browser, load):
    made = Explorer(load("teapot", size=(64, 48), factor=2), threads=1)
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    context = browser.new_context()
    page = context.new_page()
    page.set_default_timeout(WAIT)
    page.goto(made.url)
    settled(page)
    made.stop()
    thread.join(10)
    made.close()
    page.locator("#field-tile").select_option(label="64")
    expect(page.locator("#alert")).to_contain_text("does not answer")
    context.close()
