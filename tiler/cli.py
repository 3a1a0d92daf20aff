"""The command `tiler`. Results go to standard output, talk to standard error; how it ends is told in its help."""

import os
import sys
import warnings
from typing import NoReturn

from cyclopts import App, CycloptsError

from tiler import __version__
from tiler.commands.bench import bench
from tiler.commands.compare import compare, cost
from tiler.commands.explore import explore
from tiler.commands.export import export
from tiler.commands.listings import counters, info, machines, scenes
from tiler.commands.output import show_warning
from tiler.commands.plugins import load_named_plugins
from tiler.commands.render import render
from tiler.commands.studies import reproduce, sweep
from tiler.commands.upkeep import completion, doctor, warmup
from tiler.commands.validate import validate
from tiler.errors import TilerError

app = App(
    name="tiler",
    version=__version__,
    suppress_keyboard_interrupt=False,
    help="Simulate a tile-based sort-middle rasterizer with the Direct3D 11 tessellation pipeline.\n\n"
    "With `--plugin FILE.py` (or a module's name) anywhere: bounds and cull tests of your own (docs/extending.md).\n\n"
    "Exit status: 0 fine; 1 a check failed (pictures differ, a violation, a row that failed); 2 bad input; 130 interrupted; "
    "141 standard output was closed. Results go to standard output, or as JSON where --json says; talk goes to standard error.",
)
for command in (
    scenes, render, explore, compare, cost, sweep, reproduce, validate, export, info, bench, counters, machines, warmup,
    doctor, completion,
):  # fmt: skip
    app.command(command)
app.register_install_completion_command(help="Make your shell complete commands and options (bash, zsh, fish).")


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
