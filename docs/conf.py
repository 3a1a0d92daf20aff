"""Sphinx makes the documentation site of the pages beside this file: `python -m sphinx -W docs site`.

Pages are plain Markdown that reads on a code host too. Nothing is fetched, neither when the site is made nor when it is read.
"""

from pathlib import Path

from sphinx.application import Sphinx

import tiler

HERE = Path(__file__).resolve().parent

project = "tilesim"
author = "the tilesim authors"
copyright = author
version = release = tiler.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_heading_anchors = 4
exclude_patterns = ["img", "examples", "**/*.py", "_build"]
html_theme = "furo"
html_title = "tilesim"
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False

autodoc_typehints = "signature"
autodoc_preserve_defaults = True
add_module_names = False


def keep_plain(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Docstrings are plain text for people at a prompt: shown line by line as they stand, names in a fixed width."""
    text = [line.replace("`", "``") if line else "" for line in lines]
    lines[:] = [f"| {line}" if line.strip() else "" for line in text]


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_plain)
