"""The pages say what the code does: tables and pictures are made again and compared, links lead somewhere."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tiler
from docs import make_figures

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("name", make_figures.TEXTS)
def test_generated_text_is_up_to_date(name: str) -> None:
    path, text = make_figures.TEXTS[name]
    page = path.read_text()
    assert make_figures.replace_block(page, name, text()) == page, "run python docs/make_figures.py"


@pytest.mark.parametrize("name", make_figures.PICTURES)
def test_pictures_are_up_to_date(name: str) -> None:
    kept = np.asarray(Image.open(ROOT / "docs" / "img" / f"{name}.png").convert("RGB"))
    made = np.asarray(make_figures.PICTURES[name]().convert("RGB"))
    assert np.array_equal(kept, made), "run python docs/make_figures.py, and look at the picture"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_local_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"
    for name in re.findall(r"`((?:pipeline|tiler|tests|docs|scenes)/[\w./-]+)`", page.read_text()):
        assert (ROOT / name).exists(), f"{page.name} names {name}"


def test_the_scene_file_in_the_docs_draws(tmp_path: Path) -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "scenes.md").read_text(), re.S)
    file = tmp_path / "sea.toml"
    file.write_text(text)
    frame = tiler.simulate(tiler.load_scene(file, size=(96, 64)))
    assert frame.counters["ia_primitives"] == 4
    assert frame.counters["om_samples_visible"] > 1000


def test_the_python_in_the_readme_runs() -> None:
    code = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    code[0] = code[0].replace("(1920, 1080), factor=16", "(96, 64), factor=4").replace('.save("queue.png")', ".size")
    for block in code:
        exec(block, {})


def test_readme_runs_the_test_command_that_ci_runs() -> None:
    commands = re.findall(r"```\n(.*?)\n```", (ROOT / "README.md").read_text(), re.S)
    install, test = commands[0], commands[1]
    ci = (ROOT / ".ci" / "run").read_text()
    assert "pip install -e ." in install
    assert f"\n{test}\n" in ci
