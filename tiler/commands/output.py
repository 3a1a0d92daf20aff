"""What commands print and write."""

import json
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.errors import TilerWarning

if TYPE_CHECKING:
    from tiler.comparison import Comparison
    from tiler.frame import Frame
    from tiler.scene import Scene

MOST_TOLD = 20  # violations of a frame that are printed


def write_result(value: Any, where: str | None) -> bool:
    """Write `value` where `--json` says; True if that is standard output, which then holds nothing else."""
    if where == "-":
        print(json.dumps(value))
    elif where is not None:
        from tiler.files import write_json

        write_json(Path(where), value)
    return where == "-"


def report_to(file: Path, shown: "Frame | Comparison", scene: "Scene") -> None:
    """Write the report of a frame or of machines side by side, with the command that was typed."""
    from tiler.report.command import command_line
    from tiler.report.write import write_report

    write_report(shown, file, scene=scene, command=command_line())


def tell_violations(where: str, record: dict[str, Any]) -> bool:
    """Print what verification found to standard error, and whether nothing is wrong; nothing where nothing was verified."""
    for name, word in (("violations", "violation"), ("false_culls", "false cull")):
        found = record.get(name, [])
        for k, fields in enumerate(found):
            if k == MOST_TOLD:
                print(f"{where}: {len(found) - k:,} more of {word}s", file=sys.stderr)
                break
            place = "" if fields["u"] is None else f" at (u, v) = ({fields['u']:.9g}, {fields['v']:.9g})"
            margin = "unknown" if fields["margin"] is None else f"{fields['margin']:.6g} {fields['unit']}"
            print(
                f"{word}: {where}, patch {fields['patch']}{place}: {fields['algorithm']}: {fields['what']}, margin {margin}",
                file=sys.stderr,
            )
    return not record.get("violations")


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: Any = None,
    line: str | None = None,
) -> None:
    """One line on standard error for what the input may not have meant; others as Python shows them."""
    if issubclass(category, TilerWarning):
        print(f"warning: {message}", file=sys.stderr)
    else:
        print(warnings.formatwarning(message, category, filename, lineno, line), file=sys.stderr, end="")
