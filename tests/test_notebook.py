"""Results in a notebook: pictures and tables that are right and escaped, data frames, and the example notebooks run."""

import html.parser
import io
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tiler
from tests.conftest import TESTS
from tiler.comparison import Comparison, compare
from tiler.counters import DEFINITIONS
from tiler.errors import TilerError
from tiler.notebook import MOST_ROWS, table

NOTEBOOKS = sorted((TESTS.parent / "docs" / "notebooks").glob("*.ipynb"))


class Page(html.parser.HTMLParser):
    """Cells of all tables, row by row, and the tags; every tag that opens must close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.open: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag != "img":
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def comparison(load):
    scene = load("teapot", size=(64, 40), factor=2)
    machines = {"triangle": tiler.Machine(tile=16, binning="triangle"), "<b>&patch": tiler.Machine(tile=16)}
    return compare(scene, machines, threads=1)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return tiler.sweep(
        machines={"patch": {"binning": "patch"}}, settings={"picture.size": "32x24", "tessellation.factor": [1, 2]},
        out=tmp_path_factory.mktemp("study") / "s.db", threads=1,
    )  # fmt: skip


def test_a_frame_shows_its_picture_and_counters(comparison):
    frame = comparison.frames["triangle"]
    assert np.array_equal(Image.open(io.BytesIO(frame._repr_png_())), frame.color)
    page = Page(frame._repr_html_())
    assert ["ds_invocations", f"{frame.counters['ds_invocations']:,}"] in page.rows
    assert {row[0] for row in page.rows} >= set(DEFINITIONS) and page.tags.count("img") == 1


def test_counters_show_definitions(comparison):
    counters = comparison.frames["triangle"].counters
    page = Page(counters._repr_html_())
    assert page.rows[0] == ["counter", "value", "unit", "what"]
    assert [row[0] for row in page.rows[1:]] == list(counters)
    assert [int(row[1].replace(",", "")) for row in page.rows[1:]] == list(counters.values())
    assert [row[3] for row in page.rows[1:]] == [d.text for d in DEFINITIONS.values()]


def test_comparison_shows_machines_escaped_and_whether_pictures_agree(comparison):
    shown = comparison._repr_html_()
    page = Page(shown)
    assert page.rows[0] == ["counter", "triangle", "<b>&patch"] and "b" not in page.tags
    first, second = (frame.counters["queue_entries"] for frame in comparison.frames.values())
    assert ["queue_entries", f"{first:,}", f"{second:,} (x{second / first:.3g})"] in page.rows
    assert "pictures: bit-identical" in shown
    other = Comparison({"a": comparison.frames["triangle"], "b": dark(comparison.frames["<b>&patch"])})
    assert "pictures: DIFFERENT" in other._repr_html_()


def dark(frame):
    from dataclasses import replace

    return replace(frame, color=np.zeros_like(frame.color))


def test_study_shows_its_first_rows(study):
    page = Page(study._repr_html_())
    assert len(page.rows) == 3 and page.rows[0][-1] == "status" and "tessellation.factor" in page.rows[0]
    column = page.rows[0].index("ds_invocations")
    assert [row[column] for row in page.rows[1:]] == [f"{n:,}" for n in study.to_dict()["ds_invocations"]]
    assert study.head(1) == study.rows()[:1] and MOST_ROWS >= 2


def test_no_script_and_no_address(comparison, study):
    for shown in (comparison.frames["triangle"], comparison.frames["triangle"].counters, comparison, study):
        text = shown._repr_html_()
        page = Page(text)
        assert not {"script", "iframe", "link", "style"} & set(page.tags)
        assert not any(name.startswith("on") for name in page.attributes) and "http" not in text


def test_table_escapes_and_aligns():
    shown = table(("<a>", "n"), [("x<y", 1234567), ('"q"', 0.5), ("none", None), ("yes", True)], "a & b")
    assert "<caption>a &amp; b</caption>" in shown and "x&lt;y" in shown and "<a>" not in shown
    assert [row[1] for row in Page(shown).rows] == ["n", "1,234,567", "0.5", "", "True"]


def test_data_frames(comparison):
    pytest.importorskip("pandas")
    frame = comparison.frames["<b>&patch"]
    tiles = frame.to_dataframe()
    assert list(tiles.index.names) == ["x", "y"] and len(tiles) == 4 * 3 and set(tiles.columns) == set(frame.tiles)
    assert tiles.loc[(2, 1), "queue_entries"] == frame.tiles["queue_entries"][1, 2]
    assert tiles["ds_invocations"].sum() == frame.counters["ds_invocations"]
    assert tiles.attrs["machine"]["tile"] == 16 and tiles.attrs["scene"] == "teapot"
    table = comparison.to_dataframe()
    assert list(table.columns) == list(comparison.frames) and list(table.index) == list(DEFINITIONS)
    assert table.loc["ds_invocations", "<b>&patch"] == frame.counters["ds_invocations"]


def test_without_pandas_it_says_what_to_do(comparison, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    for shown in (comparison, comparison.frames["triangle"]):
        with pytest.raises(TilerError, match=r"to_dataframe: pandas is not installed; allowed: after `pip install"):
            shown.to_dataframe()


def test_there_are_example_notebooks():
    assert [file.stem for file in NOTEBOOKS] == ["a_study", "compare_machines", "first_frame"]


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_example_notebook_runs(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Kept without outputs; run in order in a new kernel, without an error, and the last lines of cells show something."""
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("PYTHONPATH", str(TESTS.parent))
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):  # nothing at home
        monkeypatch.setenv(name, str(tmp_path / name.lower()))
    book = nbformat.read(file, as_version=4)
    nbformat.validate(book)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert len(code) >= 4 and all(cell.outputs == [] and cell.execution_count is None for cell in code)
    start = time.monotonic()
    nbclient.NotebookClient(
        book, timeout=300, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    print(f"{file.stem}: {time.monotonic() - start:.1f} s")
    shown = [output for cell in code for output in cell.outputs]
    kinds = {kind for output in shown for kind in output.get("data", {})}
    assert {"text/html", "image/png"} <= kinds
    assert not [output for output in shown if output.output_type == "error"]
    assert file.stat().st_size < 20_000
