"""Sphinx makes the documentation site of the pages beside this file: `python -m sphinx -W docs site`.

Pages are plain Markdown that reads on a code host too. Nothing is fetched, neither when the site is made nor when it is read.
"""

import re

from sphinx.application import Sphinx

import tiler

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
    """Docstrings are plain text for people at a prompt: shown as they stand, a line for each argument."""
    begins = True  # a paragraph, and there a line of its own
    for k, line in enumerate(lines):
        named = re.match(r"[\w, ]+ : ", line)
        lines[k] = (("| " if begins or named else "  ") + line.strip().replace("`", "``")) if line.strip() else ""
        begins = not line.strip()


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_plain)
