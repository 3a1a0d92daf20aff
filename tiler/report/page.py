"""A page: data, style and script in one HTML file that asks no network for anything.

Its content security policy allows this script and this style alone, by their digests, and pictures in data URIs; so a name in a
scene file cannot become markup that runs, and nothing can be fetched.
"""

import base64
import hashlib
import html
import json
from importlib.resources import files
from typing import Any

from tiler.report.colors import ramp_text

STYLES = ("report.css",)
SCRIPTS = ("base.js", "table.js", "paint.js", "viewer.js", "frames.js", "plot.js", "study.js", "start.js")


def make_page(data: dict[str, Any]) -> str:
    """The page of collected data."""
    style = "".join(asset(name) for name in STYLES)
    script = "".join(asset(name) for name in SCRIPTS)
    return one_file(f"{data['title']} · tilesim report", data, style, script)[0]


def one_file(title: str, data: dict[str, Any], style: str, script: str, more_policy: str = "") -> tuple[str, str]:
    """A page of data, style and script, and its content security policy. more_policy : directives, each ended by `; `."""
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
        f"{more_policy}base-uri 'none'; form-action 'none'"
    )
    page = (
        "<!doctype html>\n"
        '<html lang="en">\n'
        "<head>\n"
        '<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{html.escape(title)}</title>\n"
        f"<style>{style}</style>\n"
        "</head>\n"
        "<body>\n"
        "<noscript>This page draws its maps and tables with a script of its own; please allow it.</noscript>\n"
        f'<script type="application/json" id="data">{_json(data | {"ramp": ramp_text()})}</script>\n'
        f"<script>{script}</script>\n"
        "</body>\n"
        "</html>\n"
    )
    return page, policy


def asset(name: str) -> str:
    """A part of reports: a style or a script."""
    return (files("tiler.report") / "assets" / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def _json(data: dict[str, Any]) -> str:
    """JSON that may stand in a script element: no < begins an end tag or a comment."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")
