"""The command `tiler`. Results go to standard output, talk to standard error.

Exit status: 0 fine, 1 a check failed, 2 bad input, 130 interrupted.
"""

import json
import sys
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

from cyclopts import App, CycloptsError, Parameter

from tiler import __version__
from tiler.errors import TilerError
from tiler.options import (
    MachineOptions,
    SceneOptions,
    make_machine,
    open_scene,
    parse_frames,
    parse_machine,
)

app = App(
    name="tiler",
    version=__version__,
    suppress_keyboard_interrupt=False,
    help="Simulate a tile-based sort-middle rasterizer with the Direct3D 11 tessellation pipeline.",
)

MOST_TOLD = 20  # violations of a frame that are printed

JsonPath = Annotated[str | None, Parameter(allow_leading_hyphen=True)]


@app.command
def scenes(*, json: JsonPath = None) -> None:
    """List the built-in scenes.

    Parameters
    ----------
    json
        Write the list as JSON to this file; - for standard output and nothing else there.
    """
    from tiler.scene.catalog import scene_summaries

    found = scene_summaries()
    if not _write_json({"scenes": [scene._asdict() for scene in found]}, json):
        for scene in found:
            print(f"{scene.name:<12} {scene.patches:>6,} patches  {scene.frames:>4} frames  {scene.title}")


@app.command
def render(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    machine_options: MachineOptions | None = None,
    out: Path = Path("out"),
    frame: float = 0,
    frames: str | None = None,
    heatmap: str | None = None,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Draw a frame: color.png, depth.npy and counters.json in a folder, and a table of counters.

    Examples: `tiler render teapot`; `tiler render waves --size 1920x1080 --binning triangle`;
    `tiler render spikelog --frames 0..47 --out walk` (interrupted, it goes on where it stopped).

    Parameters
    ----------
    scene
        A name that `tiler scenes` lists, or the path of a scene file.
    out
        Folder for the results, made if need be.
    frame
        Which frame of the camera path.
    frames
        Several frames instead: FIRST..LAST, or numbers separated by commas.
    heatmap
        Per-tile counters to draw as pictures beside the others, separated by commas, such as queue_entries.
    threads
        Threads of this computer to use; all by default. The result does not depend on it.
    json
        Write the counters as JSON to this file; - for standard output and nothing else there.
    quiet
        No table and no progress.
    """
    from tiler.animation import render_result, render_to_folder
    from tiler.progress import Progress
    from tiler.tally import check_heatmaps

    numbers: list[Any] = [frame] if frames is None else list(parse_frames(frames))
    names = check_heatmaps([] if heatmap is None else heatmap.split(","))
    opened = open_scene(scene, scene_options or SceneOptions())
    machine = make_machine(machine_options or MachineOptions())
    with Progress(f"rendering {opened.name}", len(numbers), quiet) as bar:
        records = render_to_folder(opened, machine, numbers, out, names, threads, bar.update)
    if not _write_json(render_result(opened, machine, records), json) and not quiet:
        from tiler.counters import Counters

        for record in records[-1:]:
            print(Counters(record["counters"]).table())
            print(f"\n{record['seconds'] * 1e3:,.0f} ms; {_say(len(records))} in {out}")
    held = [_tell_violations(f"frame {record['frame']:g}", record) for record in records]
    if not all(held):
        sys.exit(1)


@app.command
def compare(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    machine_options: MachineOptions | None = None,
    machine: tuple[str, ...] = (),
    frame: float = 0,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Put machines side by side on one frame, counters with their ratio to the first, which is the baseline.

    Examples: `tiler compare waves --size 1920x1080 --factor 16`;
    `tiler compare teapot --machine binning=triangle --machine binning=patch,tile=16`.
    The exit status is 1 if the machines draw different pictures, or if one verifies and finds a violation.

    Parameters
    ----------
    scene
        A name that `tiler scenes` lists, or the path of a scene file.
    machine
        A machine as key=value pairs separated by commas; give it again for each. By default: triangle binning without
        cull tests, patch binning, with a domain cache for the frame, and patch and subpatch binning with everything on.
    frame
        Which frame of the camera path.
    threads
        Threads of this computer to use; all by default.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No progress.
    """
    from tiler.animation import verify_record
    from tiler.comparison import MACHINES
    from tiler.comparison import compare as run
    from tiler.progress import Progress
    from tiler.simulation import simulate
    from tiler.warmup import warm_up

    opened = open_scene(scene, scene_options or SceneOptions())
    options = machine_options or MachineOptions()
    if machine:
        machines = {text: parse_machine(text, options) for text in machine}
    else:
        machines = {name: make_machine(options, **fields) for name, fields in MACHINES.items()}
    with Progress(f"comparing on {opened.name}", len(machines), quiet) as bar:
        # What is done once must not be charged to the first machine: kernels, the scene's patterns and packed maps.
        warm_up(machines.values())
        simulate(opened, next(iter(machines.values())), frame=frame, threads=threads)
        comparison = run(opened, machines, frame=frame, threads=threads, progress=bar.update)
    same = comparison.same_picture()
    result: dict[str, Any] = {
        "scene": opened.name,
        "machines": [
            {
                "name": name,
                "machine": made.machine.model_dump(mode="json"),
                "counters": dict(made.counters),
                "seconds": round(made.seconds, 6),
                "same_picture": same[name],
            }
            | verify_record(made)
            for name, made in comparison.frames.items()
        ],
    }
    if not _write_json(result, json):
        print(comparison.table())
    held = [_tell_violations(f"machine {entry['name']}", entry) for entry in result["machines"]]
    if not all(same.values()) or not all(held):
        sys.exit(1)


@app.command
def validate(
    what: Literal["bounds", "tessellator"],
    *,
    samples: int = 10_000_000,
    seed: int = 0,
    bounds: str | None = None,
    reference: Path | None = None,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Check what must hold: every bound and cull test against shaded points, or the tessellator against reference answers.

    Examples: `tiler validate bounds --samples 100000000`; `tiler validate tessellator --reference answers.npz`.
    The exit status is 1 if something failed.

    Parameters
    ----------
    what
        bounds: all bounds and cull tests, on the built-in scenes, on random patches and on patches that are moved towards
        violation. tessellator: points and indices of every case in a file, bit for bit.
    samples
        Shaded points that each bound is checked at, at least (bounds).
    seed
        Of the random patches; the same seed makes the same ones (bounds).
    bounds
        Only these bounds, separated by commas (bounds).
    reference
        An .npz file of reference answers (tessellator).
    threads
        Threads of this computer to use; all by default.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No table and no progress.
    """
    from tiler.progress import Progress
    from tiler.validation import count_cases, validate_bounds, validate_tessellator

    if what == "bounds":
        names = None if bounds is None else [name.strip() for name in bounds.split(",")]
        with Progress("validating bounds", samples, quiet) as bar:
            result = validate_bounds(samples, seed=seed, names=names, threads=threads, progress=bar.update)
    elif reference is None:
        raise TilerError("reference: missing; allowed: the path of an .npz file of reference answers")
    else:
        with Progress("validating the tessellator", count_cases(reference), quiet) as bar:
            result = validate_tessellator(reference, bar.update)
    if not _write_json(result, json) and not quiet:
        _print_validation(result)
    if result["failed"]:
        sys.exit(1)


@app.command
def warmup() -> None:
    """Compile all kernels now and keep them on disk, so that the first frame does not wait for it."""
    import time

    from tiler.warmup import warm_up

    start = time.monotonic()
    warm_up()
    print(f"kernels are ready ({time.monotonic() - start:.1f} s)")


@app.command
def doctor() -> None:
    """Check this installation: versions, the kernel cache, the scenes, and packages that overwrite ours."""
    from tiler.doctor import diagnose

    report, healthy = diagnose()
    print(report)
    if not healthy:
        sys.exit(1)


def _say(frames: int) -> str:
    return "color.png, depth.npy, counters.json" if frames == 1 else f"{frames} frames"


def _tell_violations(where: str, record: dict[str, Any]) -> bool:
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


def _print_validation(result: dict[str, Any]) -> None:
    """A line an algorithm, or a failed case; and what failed."""
    for row in result["details"]:
        if "algorithm" not in row:
            print(row)
            continue
        print(
            f"{row['algorithm']:<26} {row['samples']:>15,} samples  {row['cases']:>11,} cases  {row['failed']:>6,} failed"
        )
        for violation in row["violations"]:
            print(f"    {violation}")
    print(f"{result['what']}: {result['cases']:,} cases, {result['failed']:,} failed")


def _write_json(value: Any, where: str | None) -> bool:
    """Write `value` where `--json` says; True if that is standard output, which then holds nothing else."""
    if where == "-":
        print(json.dumps(value))
    elif where is not None:
        from tiler.files import write_json

        write_json(Path(where), value)
    return where == "-"


def main() -> NoReturn:
    """Entry point of the command."""
    try:
        app(exit_on_error=False)
        sys.exit(0)
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
