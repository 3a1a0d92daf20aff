"""A small study, tables to compare, and the command as a user runs it; shared by the tests of studies."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import tiler
from tiler.study.ledger import NOT_COMPARED

TINY = """
[study]
name = "tiny"
seed = 3

[sweep]
scene = ["teapot"]
picture.size = "64x36"
tessellation.factor = [2, 3]
view = ["walk", "anywhere", "around"]
machine.name = ["triangle", "small"]
machine.cores = [1, 4]

[machine.small]
tile = 8
binning = "patch"

[view.walk]
kind = "path"
frames = "0..{last}"

[view.anywhere]
kind = "random"
count = 4

[view.around]
kind = "orbit"
steps = 3
"""


def write_study(folder: Path, last: int = 4, name: str = "tiny.toml") -> Path:
    """The small study as a file: 8 * (last + 8) rows."""
    file = folder / name
    file.write_text(TINY.format(last=last))
    return file


def compared(path: Path) -> dict[str, list[Any]]:
    """The table of a results file without the columns in which two runs may differ."""
    table = tiler.load_study(path).to_dict()
    return {name: values for name, values in table.items() if name not in NOT_COMPARED}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "tiler", "sweep", *map(str, arguments)]


def run(*arguments: object, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=dict(os.environ, **(env or {})),
    )
