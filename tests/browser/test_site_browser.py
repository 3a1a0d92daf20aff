"""The documentation site in a real browser: pictures are there, nothing is asked of a network, nothing is on the console."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.browser


@pytest.mark.parametrize("name", ["index", "how-it-works", "counters", "api"])
def test_a_page_opens(name: str, site: Path, open_report: Callable[..., Any]) -> None:
    page = open_report(site / f"{name}.html", ready="h1")
    assert page.locator("h1").count() == 1
    assert page.evaluate("[...document.images].filter(i => !i.complete || i.naturalWidth === 0).length") == 0
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
