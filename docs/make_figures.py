"""Makes every picture, counter table and figure of README.md and docs/ again: `python docs/make_figures.py`.

Pictures go to docs/img. Text goes between the marks `<!-- begin NAME -->` and `<!-- end NAME -->` of the pages. All of it but
`TEXTS_OF_A_MACHINE` is counted, not timed, so it is the same on every machine; tests/test_docs.py checks that the pages are up
to date.
"""

import ast
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
from PIL import Image
from pydantic import BaseModel

import tiler
from docs import algorithms, walk_pictures, walkthrough
from pipeline.bounds import BOUNDS
from tiler.blame import BLAME, IDEAL, waterfall
from tiler.comparison import EVERYTHING, MACHINES, compare
from tiler.config import Machine
from tiler.cost_model import break_even, break_even_text, cost_model_names, load_cost_model
from tiler.costs import PAPER, box_name, measure_times
from tiler.counters import DEFINITIONS
from tiler.files import write_bytes, write_png
from tiler.heatmaps import heatmap_picture
from tiler.quality import quality_table
from tiler.queue_models import load_queue_model, queue_model_names
from tiler.scene import schema
from tiler.scene.builders import BUILDERS, MESH_BUILDERS
from tiler.scene.model import Scene

ROOT = Path(__file__).resolve().parent.parent
SIZE = (640, 360)

README_COUNTERS = (
    "ia_primitives",
    "ts_domain_points",
    "queue_entries",
    "queue_bytes",
    "ds_invocations",
    "c_invocations",
    "rs_samples_covered",
    "ps_invocations",
)


def strip(images: list[Image.Image], columns: int) -> Image.Image:
    """Pictures of one size side by side."""
    rows = [images[k : k + columns] for k in range(0, len(images), columns)]
    return Image.fromarray(np.vstack([np.hstack([np.asarray(image.convert("RGB")) for image in row]) for row in rows]))


def scenes_picture() -> Image.Image:
    """The built-in scenes."""
    frames = (("teapot", 0), ("waves", 0), ("spikelog", 0), ("colonnade", 0), ("creature", 20), ("creature", 84))
    scenes = [(tiler.load_scene(name, size=SIZE, samples=4), number) for name, number in frames]
    return strip([tiler.simulate(scene, frame=number).image() for scene, number in scenes], 2)


def shadings_picture() -> Image.Image:
    """The shadings of the pixel stage."""
    images = []
    for shading in ("normal", "patch", "wireframe", "tile_grid"):
        scene = tiler.load_scene("teapot", size=SIZE, samples=4, shading=shading, factor=8)
        images.append(tiler.simulate(scene, tiler.Machine(tile=32)).image())
    return strip(images, 2)


def queues_picture() -> Image.Image:
    """Queue lengths of waves in both binning modes, each with its own scale."""
    scene = tiler.load_scene("waves", size=SIZE)
    machines = (tiler.Machine(tile=16, binning="triangle"), tiler.Machine(tile=16))
    return strip([tiler.simulate(scene, machine).heatmap("queue_entries") for machine in machines], 2)


def heatmaps_picture() -> Image.Image:
    """docs/cost-model.md: overlap of two bounds, and overdraw of two scenes."""
    waves, colonnade = (tiler.load_scene(name, size=(480, 270)) for name in ("waves", "colonnade"))
    cases = (
        (waves, "cbox", "bounds_overlap"), (waves, "tpatch", "bounds_overlap"), (waves, "cbox", "overdraw"),
        (colonnade, "cbox", "overdraw"),
    )  # fmt: skip
    frames = [(scene, tiler.simulate(scene, tiler.Machine(bounds=bounds)), name) for scene, bounds, name in cases]
    return strip([heatmap_picture(*case) for case in frames], 2)


PICTURES: dict[str, Callable[[], Image.Image]] = {
    "scenes": scenes_picture,
    "shadings": shadings_picture,
    "queues": queues_picture,
    "heatmaps": heatmaps_picture,
    **walk_pictures.PICTURES,
}


def load_colonnade() -> Scene:
    """The scene at full size."""
    return tiler.load_scene("colonnade", size=(1920, 1080), factor=16)


def counters_table() -> str:
    """README: machines side by side on colonnade."""
    frames = compare(load_colonnade(), {name: Machine(**fields) for name, fields in MACHINES.items()}).frames
    lines = ["| counter | " + " | ".join(frames) + " |", "| --- |" + " ---: |" * len(frames)]
    for name in README_COUNTERS:
        lines.append(f"| `{name}` | " + " | ".join(f"{frame.counters[name]:,}" for frame in frames.values()) + " |")
    return "\n".join(lines)


def definitions_table() -> str:
    """docs/counters.md: every counter with its definition."""
    lines = ["| counter | unit | what it counts | same as |", "| --- | --- | --- | --- |"]
    lines += [f"| `{name}` | {d.unit} | {d.stage}: {d.text} | {d.same_as} |" for name, d in DEFINITIONS.items()]
    return "\n".join(lines)


def blame_definitions() -> str:
    """docs/blame.md: what each line of blame means."""
    lines = ["| line | key | points charged |", "| --- | --- | --- |"]
    return "\n".join(lines + [f"| {reason.title} | `{name}` | {reason.text} |" for name, reason in BLAME.items()])


def ideal_definitions() -> str:
    """docs/blame.md: what the ideal figures mean."""
    return "\n".join(["| key | what |", "| --- | --- |"] + [f"| `{name}` | {text} |" for name, text in IDEAL.items()])


def blame_machines() -> dict[str, Machine]:
    """The machines of docs/blame.md."""
    rect, fine = {"occlusion_area": "rect"}, {"coarse_z_block": 4}
    parts = {"binning": "subpatch", "tile": 64}
    kinds: dict[str, dict[str, object]] = {
        "triangle": {"binning": "triangle", "cull": ()},
        "patch, `rect`": EVERYTHING | rect,
        "patch": EVERYTHING,
        "patch, `tpatch`": EVERYTHING | {"bounds": "tpatch"},
        "patch, blocks of 4": EVERYTHING | fine,
        "patch, tiles of 128": EVERYTHING | {"tile": 128},
        "patch, `previous_frame`": EVERYTHING | {"z_feedback": "previous_frame"},
        "subpatch, `rect`": EVERYTHING | parts | rect,
        "subpatch": EVERYTHING | parts,
        "subpatch, `tpatch`": EVERYTHING | parts | {"bounds": "tpatch"},
        "subpatch, `previous_frame`": EVERYTHING | parts | {"z_feedback": "previous_frame"},
    }
    return {name: Machine(**({"blame": True} | fields)) for name, fields in kinds.items()}


def distance_machines() -> dict[str, Machine]:
    """Machines that docs/blame.md compares with the ideal; the first is the baseline."""
    patch, parts = ({**MACHINES[name], "blame": True} for name in ("patch, all", "subpatch, all"))
    small: dict[str, object] = {"tile": 64, "subpatch_extent": 32.0}
    kinds: dict[str, dict[str, object]] = {
        "triangle": {**MACHINES["triangle"], "blame": True},
        "patch, all, `rect`": patch | {"occlusion_area": "rect"},
        "patch, all, `tpatch`": patch | {"bounds": "tpatch"},
        "patch, all": patch,
        "patch, all, `two_phase`": patch | {"z_feedback": "two_phase"},
        "subpatch, all": parts,
        "subpatch, all, tiles of 64, parts of 32": parts | small,
        "subpatch, all, tiles of 64, parts of 32, `tpatch`": parts | small | {"bounds": "tpatch"},
    }
    return {name: Machine(**fields) for name, fields in kinds.items()}


def distance_table() -> str:
    """docs/blame.md: how far the best machines are from the ideal and from the baseline."""
    scene = load_colonnade()
    rows, baseline = [], None
    for name, machine in distance_machines().items():
        frame = tiler.simulate(scene, machine, frame=1)
        assert frame.blame is not None
        c, ideal = frame.counters, frame.blame.ideal
        baseline = baseline or c
        shaded, used = c["ds_invocations"], c["queue_bytes"]
        whole = ideal["ideal_patches"] * (c["ts_domain_points"] // c["ts_patches"])
        rows.append(
            [
                name, f"{shaded:,}", f"1/{baseline['ds_invocations'] / shaded:.1f}", f"{shaded / whole:.2f}",
                f"{shaded / ideal['ideal_unit_points']:.2f}", f"{used:,}", f"1/{baseline['queue_bytes'] / used:,.0f}",
                f"{c['cz_units_tested'] + c['cz_pairs_tested']:,}", f"{c['cz_cells_read']:,}",
            ]
        )  # fmt: skip
    heads = [
        "", "invocations", "of baseline", "/ ideal of patches", "/ ideal of units", "queue bytes", "of baseline",
        "units and pairs tested", "cells read",
    ]  # fmt: skip
    return aligned_table(heads, rows)


def blame_table() -> str:
    """docs/blame.md: waterfalls side by side, with queue bytes."""
    scene = tiler.load_scene("colonnade", size=(480, 270), factor=8)
    columns = []
    for machine in blame_machines().values():
        frame = tiler.simulate(scene, machine, frame=1)
        assert frame.blame is not None
        lines = dict(waterfall(frame.counters, frame.blame)) | frame.blame.ideal
        columns.append(lines | {"queue bytes": frame.counters["queue_bytes"]})
    rows = [[title, *(f"{c[title]:,}" for c in columns)] for title in columns[0] if any(c[title] for c in columns)]
    return aligned_table(["", *blame_machines()], rows)


def keys_table(model: type[BaseModel], prefix: str) -> list[str]:
    """Rows of a table of keys: name, what is allowed, default."""
    rows = []
    for name, field in model.model_fields.items():
        allowed = field.description or _choices(field.annotation)
        if field.is_required():
            default = "required"
        elif isinstance(field.default, BaseModel):
            default = ""
        else:
            default = "" if field.default is None else f"`{json.dumps(field.default)}`"
        rows.append(f"| `{prefix}{name}` | {allowed} | {default} |")
    return rows


def _choices(annotation: object) -> str:
    choices = (True, False) if annotation is bool else get_args(annotation)
    return "one of " + ", ".join(f"`{json.dumps(choice)}`" for choice in choices)


HEAD = ["| key | allowed | default |", "| --- | --- | --- |"]


def scene_keys_table() -> str:
    """docs/scenes.md: the keys of a scene file."""
    tables = {
        "": schema.SceneFile,
        "picture.": schema.PictureFile,
        "tessellation.": schema.TessellationFile,
        "camera.": schema.CameraFile,
        "camera.key.": schema.KeyFile,
        "object.": schema.ObjectFile,
        "object.displacement.": schema.DisplacementFile,
    }
    return "\n".join(HEAD + [row for prefix, model in tables.items() for row in keys_table(model, prefix)])


def builders_table() -> str:
    """docs/scenes.md: the parameters of the builders."""
    rows = [row for name, b in (BUILDERS | MESH_BUILDERS).items() for row in keys_table(b.parameters, f"{name}: ")]
    return "\n".join(HEAD + rows)


def quality_rows() -> str:
    """docs/bounds.md: how tight the bounds are, volume / screen area relative to the shaded surface's own box."""
    rows = quality_table()
    scenes = list(dict.fromkeys(row.scene for row in rows))
    lines = ["| bound | " + " | ".join(scenes) + " |", "| --- |" + " ---: |" * len(scenes)]
    for name in dict.fromkeys(row.bound for row in rows):
        cells = [f"{row.volume:.2f} / {row.area:.2f}" for row in rows if row.bound == name]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def aligned_table(head: list[str], rows: list[list[str]]) -> str:
    """A table whose columns but the first are numbers."""
    lines = ["| " + " | ".join(head) + " |", "| --- |" + " ---: |" * (len(head) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def queue_models_table() -> str:
    """docs/queue-memory.md: the models that are shipped."""
    lines = ["| model | tile | lists | source |", "| --- | ---: | --- | --- |"]
    for name in queue_model_names():
        model = load_queue_model(name)
        lines.append(f"| `{name}` | {model.tile} | {model.title} | {model.source} |")
    return "\n".join(lines)


def queue_memory_table() -> str:
    """docs/queue-memory.md: memory of one frame by every model."""
    scene = tiler.load_scene("waves", size=SIZE, factor=16)
    head = ["binning, model", "written", "read", "peak", "wasted", "chunks", "50 %", "99 %", "longest", "by patch"]
    rows = []
    for binning in ("triangle", "patch"):
        for name in queue_model_names():
            frame = tiler.simulate(scene, Machine(binning=binning, queue_model=name))
            m = frame.queues.memory
            numbers = (m.bytes_written, m.bytes_read, m.peak_bytes, m.wasted_bytes, m.chunks)
            ends = (m.percentiles[50], m.percentiles[99], frame.counters["queue_longest"])
            cells = [f"{n:,}" for n in (*numbers, *ends)] + [str(m.longest_patch)]
            rows.append([f"{binning}, `{name}`", *cells])
    return aligned_table(head, rows)


def queue_pools_table() -> str:
    """docs/queue-memory.md: a frame whose pool is too small."""
    scene = tiler.load_scene("waves", size=SIZE, factor=16)
    names = ("queue_peak_bytes", "queue_bytes_written", "queue_flushes", "queue_tile_passes", "om_spilled_bytes")
    rows = []
    for binning in ("triangle", "patch"):
        needed = tiler.simulate(scene, Machine(binning=binning)).counters["queue_peak_bytes"]
        for part in (1, 2, 8, 32):
            machine = Machine(binning=binning, queue_pool=-(-needed // part), queue_policy="flush")
            counters = tiler.simulate(scene, machine).counters
            rows.append([f"{binning}, 1/{part} of what is needed", *(f"{counters[name]:,}" for name in names)])
    return aligned_table(["binning, pool", *(f"`{name}`" for name in names)], rows)


def cost_models_table() -> str:
    """docs/cost-model.md: the models that are shipped."""
    lines = ["| model | what | source |", "| --- | --- | --- |"]
    for name in cost_model_names():
        model = load_cost_model(name)
        lines.append(f"| `{name}` | {model.title} | {model.source} |")
    return "\n".join(lines)


def break_even_rows() -> str:
    """docs/cost-model.md: where machines become cheaper than the baseline."""
    machines = {
        "triangle": Machine(binning="triangle", cull=()),
        "triangle, frustum by cbox": Machine(binning="triangle"),
        "patch, cbox, frame cache": Machine(domain_cache="frame"),
        "patch, npatch, frame cache": Machine(bounds="npatch", domain_cache="frame"),
        "patch, cbox, no cache": Machine(),
    }
    found = break_even(tiler.load_scene("colonnade", size=SIZE), machines, (1, 2, 4, 8))
    columns = [found.costs(name) for name in machines]
    rows = [[f"{f:g}", *(f"{column[k]:,.0f}" for column in columns)] for k, f in enumerate(found.factors)]
    pays = [break_even_text(found, name) for name in machines][1:]
    return aligned_table(["factor", *machines], [*rows, ["pays from", "", *pays]])


def costs_rows() -> str:
    """docs/bounds.md: operations of the bounds in invocations of the domain shader."""
    counts = algorithms.operations()
    plain, mapped = counts["domain shader"], counts["domain shader, map"]
    lines = ["| bound | box | all | paper |", "| --- | ---: | ---: | ---: |"]
    for name in BOUNDS:
        paper = f"{PAPER[name][0]:g}" if name in PAPER else ""
        box, whole = counts[name].box / plain.total, counts[name].total / mapped.total
        lines.append(f"| `{name}` | {box:.1f} | {whole:.1f} | {paper} |")
    return "\n".join(lines)


def compiled_costs_rows() -> str:
    """docs/bounds.md: the same, counted in this machine's code; how many lanes are padding hangs on its vectors."""
    from tiler.compiled_costs import count_compiled

    counts = count_compiled()
    plain, mapped = counts["domain shader"], counts["domain shader, map"]
    lines = ["| bound | box | all | paper |", "| --- | ---: | ---: | ---: |"]
    lines += [
        f"| `{name}` | {counts[name].box / plain.total:.1f} | {counts[name].total / mapped.total:.1f} | {PAPER[name][0]:g} |"
        for name in PAPER
    ]
    return "\n".join([*lines, "", f"One invocation: {plain.total:.0f} operations, {mapped.total:.0f} with a map."])


def box_times_rows() -> str:
    """docs/bounds.md: times of the boxes alone, beside an invocation of the shader without a map."""
    times = measure_times()
    shader = times["domain shader"]
    lines = ["| bound | ns a patch | invocations | paper |", "| --- | ---: | ---: | ---: |"]
    for name in PAPER:
        box = times[box_name(name)]
        lines.append(f"| `{name}` | {box * 1e9:.1f} | {box / shader:.1f} | {PAPER[name][1]:g} |")
    mapped, lookup, projection = (times[name] * 1e9 for name in ("domain shader, map", "lookup", "projection"))
    return "\n".join(
        [
            *lines,
            "",
            f"An invocation took {shader * 1e9:.1f} ns, with a map {mapped:.1f} ns. Beside the boxes stand the pyramid lookup, "
            f"{lookup:.0f} ns a patch, and the projection, {projection:.0f} ns.",
        ]
    )


EXAMPLE = ROOT / "docs" / "examples" / "diagonal.py"


def example_text(name: str) -> str:
    """docs/extending.md: a function of the example, or its call of a function `register_...`."""
    source = EXAMPLE.read_text()
    for node in ast.parse(source).body:
        found = node.name if isinstance(node, ast.FunctionDef) else ast.unparse(node).partition("(")[0]
        if found in (name, f"tiler.{name}"):
            return f"```python\n{ast.get_source_segment(source, node)}\n```"
    raise ValueError(f"{EXAMPLE.name} has no {name}")


EXAMPLE_PARTS = ("diagonal_box", "register_bound", "all_products", "register_cull_test")

TEXTS: dict[str, tuple[Path, Callable[[], str]]] = {
    "counters": (ROOT / "README.md", counters_table),
    "costs": (ROOT / "docs" / "bounds.md", costs_rows),
    "quality": (ROOT / "docs" / "bounds.md", quality_rows),
    "scene keys": (ROOT / "docs" / "scenes.md", scene_keys_table),
    "builders": (ROOT / "docs" / "scenes.md", builders_table),
    "queue models": (ROOT / "docs" / "queue-memory.md", queue_models_table),
    "queue memory": (ROOT / "docs" / "queue-memory.md", queue_memory_table),
    "queue pools": (ROOT / "docs" / "queue-memory.md", queue_pools_table),
    "cost models": (ROOT / "docs" / "cost-model.md", cost_models_table),
    "break even": (ROOT / "docs" / "cost-model.md", break_even_rows),
    "blame": (ROOT / "docs" / "blame.md", blame_definitions),
    "ideal": (ROOT / "docs" / "blame.md", ideal_definitions),
    "blame table": (ROOT / "docs" / "blame.md", blame_table),
    **{f"example: {part}": (ROOT / "docs" / "extending.md", partial(example_text, part)) for part in EXAMPLE_PARTS},
    "distance table": (ROOT / "docs" / "blame.md", distance_table),
    "definitions": (ROOT / "docs" / "counters.md", definitions_table),
    **{name: (ROOT / "docs" / "how-it-works.md", text) for name, text in walkthrough.TEXTS.items()},
    "bounds": (ROOT / "docs" / "algorithms.md", algorithms.bounds_table),
    "cull tests": (ROOT / "docs" / "algorithms.md", algorithms.cull_tests_table),
}

# What differs from machine to machine: made like the rest, and not held to the pages by a test.
TEXTS_OF_A_MACHINE = {
    "compiled costs": (ROOT / "docs" / "bounds.md", compiled_costs_rows),
    "times of boxes": (ROOT / "docs" / "bounds.md", box_times_rows),
}


def replace_block(page: str, name: str, text: str) -> str:
    """The page with the text between its marks replaced."""
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    head, rest = page.split(begin)
    return f"{head}{begin}{text}\n{end}{rest.split(end)[1]}"


def main() -> None:
    """Make all again."""
    for name, picture in PICTURES.items():
        write_png(ROOT / "docs" / "img" / f"{name}.png", picture())
    for name, (path, text) in (TEXTS | TEXTS_OF_A_MACHINE).items():
        write_bytes(path, replace_block(path.read_text(), name, text()).encode())


if __name__ == "__main__":
    main()
