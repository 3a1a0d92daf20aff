"""The command `tiler`. Results go to standard output, talk to standard error.

Exit status: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 standard output was closed.
"""

import os
import sys
import warnings
from typing import NoReturn

from cyclopts import App, CycloptsError

from tiler import __version__
from tiler.commands.bench import bench
from tiler.commands.compare import compare, cost
from tiler.commands.explore import explore
from tiler.commands.listings import counters, info, scenes
from tiler.commands.output import show_warning
from tiler.commands.plugins import load_named_plugins
from tiler.commands.render import render
from tiler.commands.studies import reproduce, sweep
from tiler.commands.upkeep import doctor, warmup
from tiler.commands.validate import validate
from tiler.errors import TilerError

app = App(
    name="tiler",
    version=__version__,
    suppress_keyboard_interrupt=False,
    help="Simulate a tile-based sort-middle rasterizer with the Direct3D 11 tessellation pipeline.\n\n"
    "With `--plugin FILE.py` (or a module's name) anywhere: bounds and cull tests of your own (docs/extending.md).",
)
for command in (
    scenes, render, explore, compare, cost, sweep, reproduce, validate, info, bench, counters, warmup, doctor,
):  # fmt: skip
    app.command(command)


def main() -> NoReturn:
    """Entry point of the command."""
    warnings.showwarning = show_warning
    try:
        app(load_named_plugins(sys.argv[1:]), exit_on_error=False)
        sys.stdout.flush()
        sys.exit(0)
    except (
        BrokenPipeError
    ):  # whoever reads has enough, as `head` does; nor may the interpreter flush into it at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except CycloptsError:
        sys.exit(2)  # it has told what is wrong with the options
    except TilerError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
