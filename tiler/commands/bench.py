"""`tiler bench`."""

import sys
from pathlib import Path
from typing import Literal

from tiler.commands.options import JsonPath, Quiet
from tiler.commands.output import write_result
from tiler.errors import TilerError


def bench(
    *,
    quick: bool = False,
    stages: bool = True,
    scaling: bool = True,
    million: bool = False,
    startup: bool = False,
    peer: Literal["llvmpipe"] | None = None,
    scene: tuple[str, ...] = ("torus",),
    factors: str = "8,16,32,64",
    size: str = "1920x1080",
    threads: int | None = None,
    rounds: int = 5,
    out: Path | None = None,
    page: Path | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Time the stages of a frame, and how its time grows; with --peer side by side with Mesa's llvmpipe.

    Examples: `tiler bench --quick`; `tiler bench --peer llvmpipe --no-stages --no-scaling --factors 16 --out pictures`.

    Parameters
    ----------
    quick
        Less of all: under a minute once the kernels are compiled.
    stages
        The stage table.
    scaling
        Frame time over factor, patches, pixels and threads.
    million
        Also time and peak memory of a million patches at factor 16, 3840x2160.
    startup
        Also the first frame with its compile, a second process, and the import.
    peer
        Also draw with this renderer, frame by frame in turn.
    scene
        What is drawn beside the peer: torus, a name that `tiler scenes` lists, or a scene file; give it again for more.
    factors
        Tessellation factors beside the peer, separated by commas.
    size
        Width and height of the picture in pixels.
    threads
        Threads of this computer to use at most; all by default.
    rounds
        Turns beside the peer.
    out
        Folder for the pictures of both.
    page
        Write the tables as a page of Markdown to this file.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No table and no progress.
    """
    from tiler.bench.report import as_json, as_page, as_text
    from tiler.bench.run import QUICK_SIZE, run_bench
    from tiler.files import write_bytes
    from tiler.host import available_threads
    from tiler.options import parse_factors, parse_size

    threads = available_threads() if threads is None else threads
    if not 1 <= threads <= 1024:
        raise TilerError(f"threads: {threads} is not allowed; allowed: 1 to 1024")
    if rounds < 1:
        raise TilerError(f"rounds: {rounds} is not allowed; allowed: 1 or more")
    results = run_bench(
        size=QUICK_SIZE if quick else parse_size(size), threads=threads, quick=quick, stages=stages, scales=scaling,
        million=million, startup=startup, peer=peer is not None, scenes=scene, factors=parse_factors(factors),
        rounds=1 if quick else rounds, out=out, progress=_tell_part if not quiet else lambda what: None,
    )  # fmt: skip
    if page is not None:
        write_bytes(page, as_page(results).encode())
    if not write_result(as_json(results), json) and not quiet:
        print(as_text(results))


def _tell_part(what: str) -> None:
    print(f"measuring {what} ...", file=sys.stderr)
