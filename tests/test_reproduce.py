"""`tiler reproduce`: what the frame does with items, and what it says to bad input."""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from tiler import cli
from tiler.errors import TilerError
from tiler.reproduce import catalog, command, page, run, style, write
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance, row_ok, within_factor
from tiler.reproduce.models import MODELS, check_models, open_model

UNITS = {"algorithm": "name", "ratio": "measured / published"}
calls: list[Context] = []


def draw(figure: Any) -> None:
    axes = figure.subplots()
    axes.plot([1, 2], [3, 4], **style.line_style("tpatch"))
    axes.set_ylabel("a label of its own")


def run_small(context: Context) -> Result:
    calls.append(context)
    context.update(0.5)
    rows = (
        Row("cbox", 2.0, 2.1, "boxes", Tolerance(relative=0.1)),
        Row("obbtex", None, 7.0 if context.seed == 0 else math.nan, "boxes", Tolerance(at_most=8.0), "a note"),
        Row("tpatch", 3.0, 99.0, "boxes", None),
    )
    table = {"algorithm": ["cbox", "obbtex"], "ratio": [1.05, None]}
    return Result(rows, table, UNITS, draw, "What ran.")


SMALL = Item("munkberg2010", "figure-99", "A small figure", run_small)


@pytest.fixture(autouse=True)
def only_small(monkeypatch: pytest.MonkeyPatch) -> None:
    calls.clear()
    monkeypatch.setattr(catalog, "item_names", lambda paper: [SMALL.name])
    monkeypatch.setattr(command, "item_names", lambda paper: [SMALL.name])
    monkeypatch.setattr(run, "item_names", lambda paper: [SMALL.name])
    monkeypatch.setattr(command, "load_item", lambda paper, name: SMALL)


def reproduce(out: Path, *arguments: str, paper: str = "munkberg2010") -> int:
    """Exit status of the command, run in this process."""
    try:
        cli.app(["reproduce", paper, "--out", str(out), *arguments], exit_on_error=False)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def error_of(out: Path, *arguments: str, paper: str = "munkberg2010") -> str:
    with pytest.raises(TilerError) as caught:
        reproduce(out, *arguments, paper=paper)
    assert not calls
    return str(caught.value)


def test_writes_figure_numbers_and_page(tmp_path: Path) -> None:
    assert reproduce(tmp_path) == 0
    folder = tmp_path / "munkberg2010"
    names = {path.name for path in folder.iterdir()}
    assert {f"figure-99{end}" for end in (".png", ".svg", ".csv", ".json", ".md")} | {"index.md"} <= names
    assert not any(name.startswith(".") for name in names)
    rows = list(csv.DictReader((folder / "figure-99.csv").open()))
    assert rows == [{"algorithm": "cbox", "ratio": "1.05"}, {"algorithm": "obbtex", "ratio": ""}]
    text = (folder / "figure-99.md").read_text()
    assert "| cbox | 2 | 2.1 | boxes | +5.0 % | ±10 % | holds |" in text
    assert "What ran." in text and "all 2 hold" in text and "`tiler reproduce munkberg2010`" in text
    for target in re.findall(r"\]\(([^)]+)\)", text + (folder / "index.md").read_text()):
        assert (folder / target).is_file(), target
    assert "a label of its own" in (folder / "figure-99.svg").read_text()  # text stays text


def test_parquet_holds_the_same_table(tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    reproduce(tmp_path)
    file = tmp_path / "munkberg2010" / "figure-99.parquet"
    assert duckdb.sql(f"SELECT * FROM '{file}'").fetchall() == [("cbox", 1.05), ("obbtex", None)]
    meta = dict(duckdb.sql(f"SELECT key, value FROM parquet_kv_metadata('{file}')").fetchall())
    assert json.loads(meta[b"tiler.columns"]) == UNITS
    assert json.loads(meta[b"tiler.meta"])["item"] == "figure-99"


def test_json_is_one_object_with_a_row_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert reproduce(tmp_path, "--json", "-", "--seed", "1") == 1  # a value that is not finite is within no tolerance
    found = json.loads(capsys.readouterr().out)
    assert (found["paper"], found["item"], found["failed"]) == ("munkberg2010", "figure-99", 1)
    assert [(row["what"], row["published"], row["measured"], row["ok"]) for row in found["rows"]] == [
        ("cbox", 2.0, 2.1, True), ("obbtex", None, None, False), ("tpatch", 3.0, 99.0, None),
    ]  # fmt: skip
    assert found["rows"][0]["tolerance"] == {"relative": 0.1} and found["rows"][2]["tolerance"] is None
    assert all(Path(file).is_file() for file in found["items"][0]["files"])


def test_what_stands_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for arguments, runs in (((), 1), ((), 1), (("--quick",), 2), (("--quick",), 2), (("--quick", "--again"), 3)):
        reproduce(tmp_path, *arguments)
        assert len(calls) == runs, arguments
    (tmp_path / "munkberg2010" / "figure-99.svg").unlink()  # incomplete
    reproduce(tmp_path, "--quick")
    assert len(calls) == 4
    record = tmp_path / "munkberg2010" / "figure-99.json"
    record.write_text(record.read_text()[:40])  # broken
    reproduce(tmp_path, "--quick")
    assert len(calls) == 5
    monkeypatch.setattr(run, "source_digest", lambda path: "other sources")
    reproduce(tmp_path, "--quick")
    assert len(calls) == 6


def test_a_failing_item_leaves_nothing_that_looks_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reproduce(tmp_path)

    def broken(figure: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(
        command, "load_item", lambda paper, name: SMALL._replace(run=lambda c: run_small(c)._replace(draw=broken))
    )
    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path, "--again")
    assert write.read_record(tmp_path / "munkberg2010", "figure-99") is None


def test_files_are_the_same_every_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        reproduce(tmp_path / name)
    for end in (".png", ".svg", ".csv"):
        a, b = ((tmp_path / name / "munkberg2010" / f"figure-99{end}").read_bytes() for name in ("a", "b"))
        assert a == b, end


def test_page_takes_the_table_between_its_marks(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    document.write_text("before\n<!-- begin munkberg2010 -->\nold\n<!-- end munkberg2010 -->\nafter\n")
    assert reproduce(tmp_path, "--page", str(document)) == 0
    text = document.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "\nold\n" not in text
    assert "| figure-99 | cbox | 2 | 2.1 | boxes | +5.0 % | ±10 % | holds |" in text
    assert "| 1 other check of what has no printed value |" in text
    (picture,) = re.findall(r"\]\(([^)]+)\)", text)
    assert (tmp_path / picture).read_bytes() == (tmp_path / "munkberg2010" / "figure-99.png").read_bytes()
    document.write_text("no marks")
    with pytest.raises(TilerError, match="begin munkberg2010"):
        reproduce(tmp_path, "--page", str(document))


@pytest.mark.parametrize(
    ("arguments", "paper", "said"),
    [
        ((), "munkberg2011", ["paper: 'munkberg2011' is unknown", "did you mean 'munkberg2010'", "loop2011"]),
        (("--figure", "98"), "munkberg2010", ["figure: '98' is unknown in munkberg2010", "allowed: 99"]),
        (("--table", "99"), "munkberg2010", ["table: '99' is unknown in munkberg2010", "allowed: none"]),
        (("--item", "figure-9"), "munkberg2010", ["item: 'figure-9'", "did you mean 'figure-99'"]),
        (("--figure", "99", "--table", "1"), "munkberg2010", ["figure: stands beside --table"]),
        (("--figure", "99"), "all", ["figure: stands beside all papers"]),
        (("--models", "nowhere"), "munkberg2010", ["models: nowhere is not allowed", "monsterfrog.obj"]),
        (("--threads", "0"), "munkberg2010", ["threads: 0 is not allowed"]),
        (("--seed", "-1"), "munkberg2010", ["seed: -1 is not allowed"]),
        (("--page", "nowhere.md"), "munkberg2010", ["page: nowhere.md is not allowed"]),
    ],
)
def test_bad_input_is_one_error_before_any_work(
    tmp_path: Path, arguments: tuple[str, ...], paper: str, said: list[str]
) -> None:
    message = error_of(tmp_path, *arguments, paper=paper)
    for part in said:
        assert part in message
    assert not list(tmp_path.iterdir())


def test_out_that_is_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    assert "out:" in error_of(file / "below")


@pytest.mark.parametrize(
    ("allowed", "published", "measured", "ok"),
    [
        (Tolerance(relative=0.1), 10.0, 11.0, True),
        (Tolerance(relative=0.1), -10.0, -8.9, False),
        (Tolerance(absolute=0.5), 10.0, 10.6, False),
        (Tolerance(absolute=0.5, relative=0.1), 10.0, 10.6, True),
        (Tolerance(at_most=1.0), None, 1.0, True),
        (Tolerance(at_least=1.0), None, 0.999, False),
        (Tolerance(at_least=0.0, at_most=1.0), None, 2.0, False),
        (Tolerance(relative=0.1, at_most=10.0), 10.0, 10.5, False),
        (within_factor(10.0, 2.0), 10.0, 5.0, True),
        (within_factor(10.0, 2.0), 10.0, 20.1, False),
        (Tolerance(at_most=math.inf), None, math.nan, False),
        (None, 10.0, 99.0, None),
    ],
)
def test_verdicts(allowed: Tolerance | None, published: float | None, measured: float, ok: bool | None) -> None:
    assert row_ok(Row("it", published, measured, "", allowed)) is ok


def test_a_tolerance_needs_what_it_is_around() -> None:
    with pytest.raises(ValueError, match="none was published"):
        row_ok(Row("it", None, 1.0, "", Tolerance(relative=0.1)))


@pytest.mark.parametrize(
    ("table", "units", "said"),
    [
        ({"a": [1], "b": [1, 2]}, {"a": "", "b": ""}, "unequal length"),
        ({"a": [1]}, {}, "are not the columns"),
        ({"a": [math.nan]}, {"a": ""}, "not finite"),
    ],
)
def test_tables_are_checked(table: dict[str, list[Any]], units: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        write.check_table(Result((), table, units, None, ""))


def test_numbers_in_words() -> None:
    assert [page.say_number(value) for value in (None, 0.0333333, 2.0, 61.25, 123.45, 12345.6)] == [
        "", "0.0333", "2", "61.2", "123.5", "12,346",
    ]  # fmt: skip
    assert page.say_tolerance(Tolerance(0.5, 0.1, 3.0, 1.0)) == "±10 % or ±0.5, at least 1, at most 3"
    assert page.say_deviation(Row("it", 0.0, 0.25, "", None)) == "+0.25"


def test_a_folder_of_models_holds_one_of_them(tmp_path: Path) -> None:
    with pytest.raises(TilerError, match=r"bigguy\.obj"):
        check_models(tmp_path)
    (tmp_path / "bigguy.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    check_models(tmp_path)
    context = Context(tmp_path, True, 1, 0, lambda done: None)
    assert open_model(context, "bigguy").original
    frog = open_model(context, "monsterfrog")  # not there: ours runs, and the page says so
    assert not frog.original and frog.name == "creature" and "monsterfrog.obj" in frog.told


def test_every_stand_in_is_a_built_in_scene() -> None:
    from tiler.scene import scene_names

    assert {model.stand_in for model in MODELS.values()} <= set(scene_names())


def test_colours_are_one_each_within_a_kind() -> None:
    from pipeline.bounds import BOUNDS
    from pipeline.culling import CULL_TESTS

    assert len({style.STYLES[name] for name in BOUNDS}) == len(BOUNDS)
    tests = [name for name in CULL_TESTS if name.startswith("backface:")]
    assert len({style.color_of(name) for name in tests}) == len(tests)


def test_every_listed_item_is_there(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.undo()
    cli.app(["reproduce", "--list"], exit_on_error=False, result_action="return_value")
    listed = capsys.readouterr().out
    document = (Path(__file__).resolve().parent.parent / "docs" / "reproduce.md").read_text()
    for paper, title in catalog.PAPERS.items():
        assert f"{paper}: {title}" in listed
        assert f"<!-- begin {paper} -->\n" in document and f"<!-- end {paper} -->" in document
        for name in catalog.item_names(paper):
            item = catalog.load_item(paper, name)
            assert (item.paper, item.name) == (paper, name)
            assert item.title and item.title in listed
