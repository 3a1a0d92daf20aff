"""`tiler warmup`, `tiler doctor` and `tiler completion`: the installation."""

import sys
from typing import Literal

from tiler.commands.options import JsonPath
from tiler.commands.output import write_result


def warmup(*, json: JsonPath = None) -> None:
    """Compile all kernels now and keep them on disk, so that the first frame does not wait for it.

    Examples: `tiler warmup`; `tiler warmup --json -`.

    Parameters
    ----------
    json
        Write the seconds taken as JSON to this file; - for standard output and nothing else there.
    """
    import time

    from tiler.warmup import warm_up

    start = time.monotonic()
    warm_up()
    seconds = time.monotonic() - start
    if not write_result({"seconds": round(seconds, 3)}, json):
        print(f"kernels are ready ({seconds:.1f} s)")


def doctor(*, json: JsonPath = None) -> None:
    """Check this installation: versions, the kernel cache, the scenes, and packages that overwrite ours.

    Examples: `tiler doctor`; `tiler doctor --json -`.
    The exit status is 1 if something is wrong.

    Parameters
    ----------
    json
        Write what was found as JSON to this file; - for standard output and nothing else there.
    """
    from tiler.doctor import diagnose, report_text

    found = diagnose()
    if not write_result(found, json):
        print(report_text(found))
    if found["problems"]:
        sys.exit(1)


def completion(shell: Literal["bash", "zsh", "fish"]) -> None:
    """Print what makes a shell complete commands and options; `tiler --install-completion` puts it where your shell looks.

    Examples: `tiler completion bash` (in a running shell: eval "$(tiler completion bash)"); `tiler completion fish`.

    Parameters
    ----------
    shell
        For which shell.
    """
    from tiler.cli import app

    print(app.generate_completion(shell=shell), end="")
