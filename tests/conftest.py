"""Fixtures that several files share, and the option that writes golden files anew."""

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

import tiler
from tests.golden_images import Golden

TESTS = Path(__file__).resolve().parent


def may_update(environment: Mapping[str, str]) -> bool:
    """Goldens are for people to look at and commit; where nobody looks (variable CI is set) they stay as they are."""
    return not environment.get("CI")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="write the golden pictures and counters anew instead of comparing with them (not where CI is set)",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--update-golden") and not may_update(os.environ):
        raise pytest.UsageError("--update-golden: refused where the variable CI is set; run it by hand, and look")


@pytest.fixture(scope="session")
def golden(request: pytest.FixtureRequest) -> Golden:
    """Compares frames with `tests/golden/`."""
    return Golden(TESTS / "golden", TESTS / "failed", request.config.getoption("--update-golden"))


@pytest.fixture(scope="session")
def load() -> Callable[..., tiler.Scene]:
    """`tiler.load_scene`, each combination of arguments once a session: scenes are never written after they are made."""
    loaded: dict[str, tiler.Scene] = {}

    def load_once(name: str, **arguments: object) -> tiler.Scene:
        key = f"{name} {sorted(arguments.items())}"
        if key not in loaded:
            loaded[key] = tiler.load_scene(name, **arguments)
        return loaded[key]

    return load_once


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation site, built with warnings as errors; its folder."""
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package)
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-d", folder / "kept", "docs", folder / "html"],
        cwd=TESTS.parent, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder / "html"
