"""`tiler render`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.commands.options import JsonPath, Quiet
from tiler.commands.output import report_to, tell_violations, write_result
from tiler.errors import TilerError
from tiler.options import MachineOptions, SceneOptions, make_machine, open_scene, parse_frames

if TYPE_CHECKING:
    from tiler.frame import Frame


def render(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    machine_options: MachineOptions | None = None,
    out: Path = Path("out"),
    frame: float = 0,
    frames: str | None = None,
    heatmap: str | None = None,
    report: Path | None = None,
    trace: Path | None = None,
    trace_model: str = "wide",
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Draw a frame: color.png, depth.npy and counters.json in a folder, and a table of counters.

    Examples: `tiler render teapot`; `tiler render waves --size 1920x1080 --binning triangle`;
    `tiler render spikelog --frames 0..47 --out walk` (interrupted, it goes on where it stopped);
    `tiler render teapot --cores 8 --trace trace.json.gz` (open it at https://ui.perfetto.dev).

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
    report
        Write a report too: one .html file with the picture, maps over it, counters and where the work goes (one frame).
    trace
        Write a timeline too, .json or .json.gz for Perfetto: front end, simulated cores with their tiles and patches, queues
        (one frame, drawn once more for it).
    trace_model
        Cost model that the timeline's cycles are from: munkberg2010, wide, or a .toml file.
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
    if report is not None and len(numbers) > 1:
        raise TilerError(f"report: {len(numbers)} frames are asked for; allowed: one, or tiler sweep for many")
    if report is not None:
        from tiler.report.command import check_report

        check_report(report)
    if trace is not None and len(numbers) > 1:
        raise TilerError(f"trace: {len(numbers)} frames are asked for; allowed: one")
    opened = open_scene(scene, scene_options or SceneOptions())
    machine = make_machine(machine_options or MachineOptions())
    if trace is not None:
        from tiler.trace.write import check_trace, write_trace

        check_trace(trace, machine, trace_model)
    if "wasted_domain_points" in names and not machine.blame:
        raise TilerError("heatmap: 'wasted_domain_points' is not known of this machine; allowed: with --blame")
    drawn: list[Frame] = []
    with Progress(f"rendering {opened.name}", len(numbers), quiet) as bar:
        keep = drawn.append if report is not None else lambda frame: None
        records = render_to_folder(opened, machine, numbers, out, names, threads, bar.update, keep)
    if report is not None:
        report_to(report, drawn[0], opened)
    if trace is not None:
        write_trace(opened, machine, trace, frame=numbers[0], model=trace_model, threads=threads)
    if not write_result(render_result(opened, machine, records), json) and not quiet:
        from tiler.counters import Counters

        for record in records[-1:]:
            print(Counters(record["counters"]).table())
            if "blame" in record:
                from tiler.blame import Blame, waterfall_table

                blame = Blame(record["blame"]["invocations"], {}, record["blame"]["ideal"])
                print(f"\n{waterfall_table({'': (Counters(record['counters']), blame)})}")
            print(f"\n{record['seconds'] * 1e3:,.0f} ms; {_say(len(records))} in {out}")
    held = [tell_violations(f"frame {record['frame']:g}", record) for record in records]
    if not all(held):
        sys.exit(1)


def _say(frames: int) -> str:
    return "color.png, depth.npy, counters.json" if frames == 1 else f"{frames} frames"
