"""`tiler compare` and `tiler cost`: machines side by side."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from tiler.commands.options import JsonPath, Quiet
from tiler.commands.output import report_to, tell_violations, write_result
from tiler.config import Machine
from tiler.options import MachineOptions, SceneOptions, make_machine, open_scene, parse_factors, parse_machine


def compare(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    machine_options: MachineOptions | None = None,
    machine: tuple[str, ...] = (),
    cost: str | None = None,
    frame: float = 0,
    report: Path | None = None,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Put machines side by side on one frame, counters with their ratio to the first, which is the baseline.

    Examples: `tiler compare waves --size 1920x1080 --factor 16`;
    `tiler compare teapot --machine binning=triangle --machine binning=patch,tile=16`;
    `tiler compare teapot --machine preset=mali-like --machine preset=mali-like,binning=patch,bounds=tpatch`.
    The exit status is 1 if the machines draw different pictures, or if one verifies and finds a violation.

    Parameters
    ----------
    scene
        A name that `tiler scenes` lists, or the path of a scene file.
    machine
        A machine as key=value pairs separated by commas, among them preset=NAME or file=FILE.toml to start from; give it
        again for each. By default: triangle binning without cull tests, patch binning, with a domain cache for the frame,
        and patch and subpatch binning with everything on; with --machine-preset or --machine-file that machine beside the
        first of these.
    cost
        Cost model by which to weigh the counters: munkberg2010, wide, or a .toml file.
    frame
        Which frame of the camera path.
    report
        Write a report too: one .html file with the machines side by side, maps over the picture and a divider between them.
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
    from tiler.shared import Shared
    from tiler.simulation import simulate
    from tiler.warmup import warm_up

    opened = open_scene(scene, scene_options or SceneOptions())
    machines = chosen_machines(machine, machine_options or MachineOptions())
    if report is not None:
        from tiler.report.command import check_report

        check_report(report)
    if cost is not None:
        from tiler import cost_model

        for made_of in machines.values():
            cost_model.bound_cost(cost_model.load_cost_model(cost), made_of, cost)  # before anything is drawn
    with Progress(f"comparing on {opened.name}", len(machines), quiet) as bar:
        # What is done once must not be charged to the first machine: kernels, the scene's patterns and packed maps.
        warm_up(machines.values(), Shared())
        simulate(opened, next(iter(machines.values())), frame=frame, threads=threads)
        comparison = run(opened, machines, frame=frame, threads=threads, progress=bar.update)
    if report is not None:
        report_to(report, comparison, opened)
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
    if not write_result(result, json):
        print(comparison.table())
        blamed = {n: (made.counters, made.blame) for n, made in comparison.frames.items() if made.blame is not None}
        if blamed:
            from tiler.blame import waterfall_table

            print(f"\n{waterfall_table(blamed)}")
        if cost is not None:
            print(f"\n{cost_model.cost_table(reports)}")
    held = [tell_violations(f"machine {entry['name']}", entry) for entry in result["machines"]]
    if not all(same.values()) or not all(held):
        sys.exit(1)


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
    quiet: Quiet = False,
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
    machines, wanted = chosen_machines(machine, machine_options or MachineOptions()), parse_factors(factors)
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
    if not write_result(result, json):
        print(cost_model.break_even_table(found))


def chosen_machines(texts: tuple[str, ...], options: MachineOptions) -> dict[str, Machine]:
    """The machines of `--machine`, or the baseline and that of a preset or file, or those that are compared by default."""
    from tiler.comparison import MACHINES

    if texts:
        return {text: parse_machine(text, options) for text in texts}
    named = options.machine_preset or options.machine_file
    if named is not None:
        plain = replace(options, machine_preset=None, machine_file=None)
        return {"triangle": make_machine(plain, **MACHINES["triangle"]), str(named): make_machine(options)}
    return {name: make_machine(options, **fields) for name, fields in MACHINES.items()}
