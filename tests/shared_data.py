"""Where the reference data lies that is too large for the repository: in the folder `shared` beside it."""

import os
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


def shared_file(*parts: str) -> Path:
    """Path of `shared/<parts>`. Where it is missing the test is skipped; in CI (variable CI set) it fails."""
    path = SHARED.joinpath(*parts)
    if not path.exists():
        reason = f"reference data missing: {Path('shared', *parts)} beside the repository"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return path
