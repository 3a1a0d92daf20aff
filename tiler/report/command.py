"""What the command line does about reports: the file checked before hours are spent, and the command told in it."""

import shlex
import sys
from pathlib import Path

from tiler.errors import TilerError
from tiler.files import check_target


def check_report(file: Path) -> None:
    """Make the folder of a report. Raises TilerError where the file cannot be written."""
    try:
        file.absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TilerError(
            f"report: {file} is not allowed; allowed: a file in a folder that can be written ({error.strerror})"
        ) from None
    check_target(file, "report")


def command_line() -> str:
    """The arguments of this process, as a shell takes them again."""
    return shlex.join(["tiler", *sys.argv[1:]])
