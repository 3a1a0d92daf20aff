"""The documentation site: it builds without a warning, its links lead somewhere, it asks no network.

And what it tells users to type runs.
"""

import re
import shlex
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

import tiler
from docs import walkthrough
from tiler import cli

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
LOADED = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src"), ("source", "src"), ("object", "data")}
NOT_FETCHED = {
    "canonical",
    "index",
    "search",
    "next",
    "prev",
    "author",
    "copyright",
}  # relations of links that are no files


class Page(HTMLParser):
    """Anchors of a page, what it links to, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        if "id" in found:
            self.anchors.add(found["id"])
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        for name, value in found.items():
            if (tag, name) in LOADED and not (tag == "link" and found.get("rel") in NOT_FETCHED):
                self.loads.append(value)


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text()) for path in sorted(site.rglob("*.html"))}


def target(page: Path, link: str) -> tuple[Path, str] | None:
    """The file and the anchor that a link of a page leads to; None: to another host."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return None
    return (page.parent / unquote(parts.path)).resolve() if parts.path else page, unquote(parts.fragment)


def test_every_link_leads_somewhere(pages: dict[Path, Page]) -> None:
    count = 0
    for path, page in pages.items():
        for link in page.links:
            found = target(path, link)
            if found is None:
                continue
            file, anchor = found
            assert file.exists(), f"{path.name} links to {link}"
            if anchor and file.suffix == ".html":
                assert anchor in pages[file].anchors, f"{path.name} links to {link}"
            count += 1
    assert count > 1000


def test_nothing_is_loaded_from_another_host(site: Path, pages: dict[Path, Page]) -> None:
    for path, page in pages.items():
        for link in page.loads:
            found = None if link.startswith("data:") else target(path, link)
            assert link.startswith("data:") or (found and found[0].exists()), f"{path.name} loads {link}"
    for sheet in site.rglob("*.css"):
        for link in re.findall(r"(?:url\(|@import)\s*['\"]?([^'\")\s]+)", sheet.read_text()):
            assert not urlsplit(link).netloc, f"{sheet.name} loads {link}"


def test_every_page_is_reached_from_the_index(site: Path, pages: dict[Path, Page]) -> None:
    reached, waiting = set(), [site / "index.html"]
    while waiting:
        path = waiting.pop()
        if path in reached or path not in pages:
            continue
        reached.add(path)
        waiting += [found[0] for link in pages[path].links if (found := target(path, link))]
    for page in DOCS.rglob("*.md"):
        built = site / page.relative_to(DOCS).with_suffix(".html")
        assert built in pages, f"{page.name} is not built"
        assert built in reached, f"no way from the index to {page.name}"


def test_the_reference_names_what_is_public(pages: dict[Path, Page], site: Path) -> None:
    anchors = pages[site / "api.html"].anchors
    for name in tiler.__all__:
        if name != "__version__":
            assert any(a == f"tiler.{name}" or (a.startswith("tiler.") and a.endswith(f".{name}")) for a in anchors), (
                name
            )
    for name in ("pipeline.tessellator.tessellate", "pipeline.bounds.BOUNDS", "pipeline.culling.CULL_TESTS"):
        assert name in anchors
    assert "pipeline.types.PatchBounds" in anchors


# What the pages tell users to type.


def commands(name: str) -> list[list[str]]:
    """The commands of a page's code blocks, on small pictures."""
    blocks = [
        text for kind, text in re.findall(r"^```(.*?)\n(.*?)^```", (DOCS / name).read_text(), re.S | re.M) if not kind
    ]
    lines = [line for block in blocks for line in block.splitlines() if line.startswith(("tiler ", "python "))]
    small = {
        r"--size \d+x\d+": "--size 96x64",
        r"--factors [\d,]+": "--factors 1,2",
        r"^tiler (\w+) colonnade": r"tiler \1 colonnade --factor 2",
    }
    for old, new in small.items():
        lines = [re.sub(old, new, line) for line in lines]
    return [shlex.split(line) for line in lines]


@pytest.mark.parametrize("page", ["getting-started.md", "your-model.md"])
def test_the_commands_run_as_written(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / page).read_text()
    for block in re.findall(r"```toml\n(.*?)```", text, re.S):
        Path("ring.toml").write_text(block)
    listed = [c for c in commands(page) if c[:3] != ["python3", "-m", "venv"]]
    assert len(listed) >= 7
    if page == "your-model.md":
        listed.insert(0, ["python", "docs/examples/make_model.py"])
    for command in listed:
        if command[0] == "python":
            exec((ROOT / command[1]).read_text(), {})
            continue
        monkeypatch.setattr(sys, "argv", command)
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code == 0, f"{command}: {capsys.readouterr().err}"
        capsys.readouterr()
    for block in re.findall(r"```python\n(.*?)```", text, re.S):
        exec(block, {})
    assert {path.name for path in tmp_path.glob("*.html")} == set(re.findall(r"--report ([\w.]+)", text))
    assert Path("out/color.png").exists()


def test_the_walkthrough_is_of_the_machine_that_it_names() -> None:
    page = (DOCS / "how-it-works.md").read_text()
    (command,) = re.findall(r"^tiler render (.*)$", page, re.M)
    walk, machine = walkthrough.walk(), walkthrough.MACHINE
    frame = tiler.simulate(walkthrough.load(), machine)
    assert np.array_equal(frame.color, walk.canvas.target.resolved)
    assert frame.counters["queue_entries"] == len(walk.queue.item)
    assert frame.counters["cz_pairs_occluded"] == walk.outcome.sum()
    for option in ("--bounds tpatch", "--overlap exact", "--cull frustum,occlusion", "--queue-order front_to_back"):
        assert option in command
