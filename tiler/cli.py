"""The command `tiler`. Results go to standard output, talk to standard error.

Exit status: 0 fine, 1 a check failed, 2 bad input, 130 interrupted, 141 standard output was closed.
"""

import json
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

from cyclopts import App, CycloptsError, Parameter

from tiler import __version__
from tiler.errors import TilerError, TilerWarning
from tiler.options import (
    MachineOptions,
    SceneOptions,
    make_machine,
    open_scene,
    parse_factors,
    parse_frames,
    parse_machine,
)

if TYPE_CHECKING:
    from tiler.config import Machine

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
        Maps to draw as pictures with a scale beside the others, separated by commas: per-tile counters such as
        queue_entries, queue_bytes, wasted_samples, wasted_domain_points (with --blame), and per pixel overdraw,
        depth_complexity, bounds_overlap.
    threads
        Threads of this computer to use; all by default. The result does not depend on it.
    json
        Write the counters as JSON to this file; - for standard output and nothing else there.
    quiet
        No table and no progress.
    """
    from tiler.animation import render_result, render_to_folder
    from tiler.heatmaps import check_heatmaps
    from tiler.progress import Progress

    numbers: list[Any] = [frame] if frames is None else list(parse_frames(frames))
    names = check_heatmaps([] if heatmap is None else heatmap.split(","))
    opened = open_scene(scene, scene_options or SceneOptions())
    machine = make_machine(machine_options or MachineOptions())
    if "wasted_domain_points" in names and not machine.blame:
        raise TilerError("heatmap: 'wasted_domain_points' is not known of this machine; allowed: with --blame")
    with Progress(f"rendering {opened.name}", len(numbers), quiet) as bar:
        records = render_to_folder(opened, machine, numbers, out, names, threads, bar.update)
    if not _write_json(render_result(opened, machine, records), json) and not quiet:
        from tiler.counters import Counters

        for record in records[-1:]:
            print(Counters(record["counters"]).table())
            if "blame" in record:
                from tiler.blame import Blame, waterfall_table

                blame = Blame(record["blame"]["invocations"], {}, record["blame"]["ideal"])
                print(f"\n{waterfall_table({'': (Counters(record['counters']), blame)})}")
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
    cost: str | None = None,
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
    cost
        Cost model by which to weigh the counters: munkberg2010, wide, or a .toml file.
    frame
        Which frame of the camera path.
    threads
        Threads of this computer to use; all by default.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No progress.
    """
    from tiler.animation import blame_record, verify_record
    from tiler.comparison import compare as run
    from tiler.progress import Progress
    from tiler.simulation import simulate
    from tiler.warmup import warm_up

    opened = open_scene(scene, scene_options or SceneOptions())
    machines = _machines(machine, machine_options or MachineOptions())
    if cost is not None:
        from tiler import cost_model

        for made_of in machines.values():
            cost_model.bound_cost(cost_model.load_cost_model(cost), made_of, cost)  # before anything is drawn
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
            | blame_record(made)
            for name, made in comparison.frames.items()
        ],
    }
    if cost is not None:
        reports = {name: cost_model.cost(made.counters, made.machine, cost) for name, made in comparison.frames.items()}
        for entry in result["machines"]:
            entry["cost"] = reports[entry["name"]].record()
    if not _write_json(result, json):
        print(comparison.table())
        blamed = {n: (made.counters, made.blame) for n, made in comparison.frames.items() if made.blame is not None}
        if blamed:
            from tiler.blame import waterfall_table

            print(f"\n{waterfall_table(blamed)}")
        if cost is not None:
            print(f"\n{cost_model.cost_table(reports)}")
    held = [_tell_violations(f"machine {entry['name']}", entry) for entry in result["machines"]]
    if not all(same.values()) or not all(held):
        sys.exit(1)


@app.command
def cost(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    machine_options: MachineOptions | None = None,
    machine: tuple[str, ...] = (),
    model: str = "munkberg2010",
    factors: str = "1,2,4,8,16",
    measure: Literal["domain_shader_equivalents", "frame_cycles", "total_cycles"] = "domain_shader_equivalents",
    frame: float = 0,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Weigh machines by a cost model at several tessellation factors, and say from which factor each beats the first.

    Examples: `tiler cost colonnade --size 640x360`; `tiler cost waves --model wide --measure frame_cycles
    --machine binning=triangle,cull=none --machine bounds=tpatch --factors 2,4,8,16,32`.

    Parameters
    ----------
    scene
        A name that `tiler scenes` lists, or the path of a scene file.
    machine
        As for `tiler compare`.
    model
        Cost model: munkberg2010, wide, or a .toml file.
    factors
        Tessellation factors to simulate, rising.
    measure
        What is compared: domain-shader equivalents (bounds included), cycles of the slowest stage, or of all stages.
    frame
        Which frame of the camera path.
    threads
        Threads of this computer to use; all by default.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No progress.
    """
    from tiler import cost_model
    from tiler.progress import Progress

    opened = open_scene(scene, scene_options or SceneOptions())
    machines, wanted = _machines(machine, machine_options or MachineOptions()), parse_factors(factors)
    with Progress(f"weighing on {opened.name}", len(machines) * len(wanted), quiet) as bar:
        found = cost_model.break_even(
            opened, machines, wanted, model, measure=measure, frame=frame, threads=threads, progress=bar.update
        )
    result = {
        "scene": opened.name, "model": model, "measure": measure, "factors": wanted,
        "machines": [
            {"name": name, "machine": made.model_dump(mode="json"), "break_even": found.factor[name],
             "cost": [report.record() for report in found.reports[name]]}
            for name, made in machines.items()
        ],
    }  # fmt: skip
    if not _write_json(result, json):
        print(cost_model.break_even_table(found))


@app.command
def sweep(
    study: Path | None = None,
    *,
    out: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    threads: int | None = None,
    csv: Path | None = None,
    parquet: Path | None = None,
    status: bool = False,
    merge: Annotated[tuple[Path, ...], Parameter(consume_multiple=True)] = (),
    retry_failed: bool = False,
    yes_run: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Run a study: a grid of scenes, views, frames and machines into one table; interrupted, it goes on where it stopped.

    Examples: `tiler sweep bounds.toml --out bounds.db --workers 8 --csv bounds.csv`;
    `tiler sweep --status --out bounds.db`; as job 3 of an array of 64 `tiler sweep bounds.toml --shard 3/64 --out part3.db`,
    and afterwards `tiler sweep bounds.toml --out bounds.db --merge part*.db`.
    The exit status is 1 if rows have failed.

    Parameters
    ----------
    study
        A study file (docs/studies.md); for --status and exports the results file is enough.
    out
        Results file, an SQLite database; by default the study's name with .db.
    workers
        Processes of this computer; by default rows run in this one.
    scheduler
        Address of a Dask scheduler to run on, such as tcp://host:8786.
    shard
        Run part I of N only, as I/N with I from 1 to N.
    threads
        Threads of this computer for each frame; all by default, one in workers.
    csv
        Write the table as CSV too, and a .json beside it with what its columns mean.
    parquet
        Write the table as Parquet too (needs duckdb).
    status
        Say how far a study is, and run nothing.
    merge
        Take over the rows of other results files of this study, and run nothing.
    retry_failed
        Run failed rows again.
    yes_run
        Confirm a large study by its number of rows.
    json
        Write a summary as JSON to this file; - for standard output and nothing else there.
    quiet
        No summary and no progress.
    """
    from tiler.study.command import SweepRequest, run_command

    request = SweepRequest(
        study, out, workers, scheduler, shard, threads, csv, parquet, status, merge, retry_failed, yes_run, quiet
    )
    summary = run_command(request)
    if not _write_json(summary, json) and not quiet:
        print(summary["text"])
    if summary["failed"]:
        sys.exit(1)


@app.command
def reproduce(
    paper: str | None = None,
    *,
    table: str | None = None,
    figure: str | None = None,
    item: str | None = None,
    list_items: Annotated[bool, Parameter(name="--list", negative=())] = False,
    models: Path | None = None,
    out: Path = Path("reproduced"),
    page: Path | None = None,
    quick: bool = False,
    again: bool = False,
    seed: int = 0,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Compute the tables and figures of a paper anew, published beside measured, with a verdict against a stated tolerance.

    Examples: `tiler reproduce munkberg2010 --figure 6`; `tiler reproduce loop2011 --models models`;
    `tiler reproduce all --quick`; `tiler reproduce --list`.
    The exit status is 1 if a measured value is beyond its tolerance. Interrupted, it goes on with the first item that
    does not stand yet.

    Parameters
    ----------
    paper
        munkberg2010, sathe2011, loop2011, beyond (what no paper shows), or all.
    table
        Only this table of the paper, by its number.
    figure
        Only this figure.
    item
        Only this item, by the name that --list gives.
    list_items
        List the items, and run nothing.
    models
        Folder of the papers' models (docs/reproduce.md); scenes of ours stand in for those that are not there.
    out
        Folder for the results: figure, numbers and page of each item in a folder for each paper.
    page
        Put rows and figures between the marks of this page, too, pictures into `img` beside it.
    quick
        Fewer views, frames and factors.
    again
        Run items that stand already.
    seed
        Of random views.
    threads
        Threads of this computer to use; all by default. Only times depend on it.
    json
        Write the rows as JSON to this file; - for standard output and nothing else there.
    quiet
        No tables and no progress.
    """
    from tiler.reproduce import command

    request = command.ReproduceRequest(
        paper, table, figure, item, models, out, page, quick, again, seed, threads, quiet
    )
    if list_items:
        found = command.list_items(request)
        if not _write_json({"papers": found["papers"]}, json):
            print(found["text"])
        return
    silent = quiet or json == "-"
    result = command.run_command(request, lambda text: None if silent else print(f"{text}\n", flush=True))
    _write_json(result, json)
    if result["failed"]:
        sys.exit(1)


@app.command
def validate(
    what: Literal["bounds", "tessellator", "limit", "watertight"],
    scene: str | None = None,
    *,
    factor: str | None = None,
    edge_pixels: float | None = None,
    partitioning: Literal["integer", "pow2", "fractional_odd", "fractional_even"] | None = None,
    displacement: str | None = None,
    frame: float = 0,
    samples: int = 10_000_000,
    seed: int = 0,
    bounds: str | None = None,
    reference: Path | None = None,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
) -> None:
    """Check what must hold: bounds and cull tests against shaded points, the tessellator and the limit surface against
    reference answers, a mesh for cracks.

    Examples: `tiler validate bounds --samples 100000000`; `tiler validate tessellator --reference answers.npz`;
    `tiler validate watertight creature --factor 16 --partitioning fractional_odd`.
    The exit status is 1 if something failed.

    Parameters
    ----------
    what
        bounds: all bounds and cull tests, on the built-in scenes, on random patches and on patches that are moved towards
        violation. tessellator: points and indices of every case in a file, bit for bit. limit: positions and normals of
        subdivision patches against limit positions in a file. watertight: both sides of every edge of a scene, bit for bit.
    scene
        A name that `tiler scenes` lists, or the path of a scene file or model (watertight); without the next three options
        at several factors in every partitioning.
    factor
        Tessellation factor, or six: edges u=0, v=0, u=1, v=1, then inside u, v (watertight).
    edge_pixels
        Wished length of an edge's segments on the screen in pixels, instead of a fixed factor (watertight).
    partitioning
        How factors become segments (watertight).
    displacement
        Displacement map of a model file, as for `tiler render` (watertight).
    frame
        Which frame of the scene (watertight).
    samples
        Shaded points that each bound is checked at, at least (bounds).
    seed
        Of the random patches; the same seed makes the same ones (bounds).
    bounds
        Only these bounds, separated by commas (bounds).
    reference
        An .npz file of reference answers (tessellator, limit).
    threads
        Threads of this computer to use; all by default.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No table and no progress.
    """
    from tiler import validation
    from tiler.progress import Progress
    from tiler.validation import count_cases, validate_bounds, validate_limit, validate_tessellator

    if what == "watertight":
        if scene is None:
            raise TilerError(
                "scene: missing; allowed: a name that `tiler scenes` lists, or the path of a scene or model"
            )
        chosen = SceneOptions(
            factor=factor, edge_pixels=edge_pixels, partitioning=partitioning, displacement=displacement
        )
        opened = open_scene(scene, chosen)
        settings = validation.settings_of(opened, any(x is not None for x in (factor, edge_pixels, partitioning)))
        with Progress(f"looking for cracks in {opened.name}", len(settings), quiet) as bar:
            result = validation.validate_watertight(
                opened, settings, number=frame, threads=threads, progress=bar.update
            )
    elif what == "bounds":
        names = None if bounds is None else [name.strip() for name in bounds.split(",")]
        with Progress("validating bounds", samples, quiet) as bar:
            result = validate_bounds(samples, seed=seed, names=names, threads=threads, progress=bar.update)
    elif reference is None:
        raise TilerError("reference: missing; allowed: the path of an .npz file of reference answers")
    elif what == "limit":
        with Progress("validating the limit surface", 1, quiet):
            result = validate_limit(reference)
    else:
        with Progress("validating the tessellator", count_cases(reference), quiet) as bar:
            result = validate_tessellator(reference, bar.update)
    if not _write_json(result, json) and not quiet:
        _print_validation(result)
    if result["failed"]:
        sys.exit(1)


@app.command
def info(file: Path, *, json: JsonPath = None) -> None:
    """Say what is in a mesh, patch or displacement map file: faces, valences, boundaries, texture coordinates, ranges.

    Examples: `tiler info bigguy.obj`; `tiler info height.png --json -`.

    Parameters
    ----------
    file
        The file; the end of its name says what it is.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    """
    from tiler.scene.info import file_info, info_text

    found = file_info(file)
    if not _write_json(found, json):
        print(info_text(found))


@app.command
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
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"))] = False,
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
    if not _write_json(as_json(results), json) and not quiet:
        print(as_text(results))


@app.command
def counters(*, json: JsonPath = None) -> None:
    """Say what every counter counts: stage, unit, definition, and the counter of D3D11, Vulkan or GL that it equals.

    Example: `tiler counters --json -`.

    Parameters
    ----------
    json
        Write the definitions as JSON to this file; - for standard output and nothing else there.
    """
    from tiler.counters import DEFINITIONS

    table = [{"name": name} | definition._asdict() for name, definition in DEFINITIONS.items()]
    if _write_json({"counters": table}, json):
        return
    for row in table:
        same = f" ({row['same_as']})" if row["same_as"] else ""
        print(f"{row['name']:<29} {row['stage']}, {row['unit']}: {row['text']}{same}")


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


def _machines(texts: tuple[str, ...], options: MachineOptions) -> "dict[str, Machine]":
    """The machines of `--machine`, or those that are compared by default."""
    from tiler.comparison import MACHINES

    if texts:
        return {text: parse_machine(text, options) for text in texts}
    return {name: make_machine(options, **fields) for name, fields in MACHINES.items()}


def _tell_part(what: str) -> None:
    print(f"measuring {what} ...", file=sys.stderr)


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
    if result["what"] == "watertight":
        print(
            f"{result['edges']:,} edges of two patches, {result['boundary_edges']:,} of one; {result['seams']:,} seams; open: "
            f"{result['open_seams']:,} seams and {result['open_edges']:,} other edges; widest {result['largest_crack']:.6g} "
            f"({result['largest_relative']:.3g} of the diagonal)"
        )
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


def _show_warning(
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


def main() -> NoReturn:
    """Entry point of the command."""
    warnings.showwarning = _show_warning
    try:
        app(exit_on_error=False)
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
