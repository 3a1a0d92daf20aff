"""Makes every picture, counter table and figure of README.md and docs/ again: `python docs/make_figures.py`.

Pictures go to docs/img. Text goes between the marks `<!-- begin NAME -->` and `<!-- end NAME -->` of the pages. All of it
is counted, not timed, so it is the same on every machine; tests/test_docs.py checks that the pages are up to date.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np
from PIL import Image
from pydantic import BaseModel

import tiler
from pipeline.bounds import BOUNDS
from tiler.comparison import MACHINES, compare
from tiler.config import Machine
from tiler.costs import PAPER, count_operations
from tiler.counters import DEFINITIONS
from tiler.files import write_bytes, write_png
from tiler.quality import quality_table
from tiler.scene import schema
from tiler.scene.builders import BUILDERS

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
    """The four built-in scenes."""
    names = ("teapot", "waves", "spikelog", "colonnade")
    return strip([tiler.simulate(tiler.load_scene(name, size=SIZE, samples=4)).image() for name in names], 2)


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


PICTURES: dict[str, Callable[[], Image.Image]] = {
    "scenes": scenes_picture,
    "shadings": shadings_picture,
    "queues": queues_picture,
}


def counters_table() -> str:
    """README: machines side by side on colonnade."""
    scene = tiler.load_scene("colonnade", size=(1920, 1080), factor=16)
    frames = compare(scene, {name: Machine(**fields) for name, fields in MACHINES.items()}).frames
    lines = ["| counter | " + " | ".join(frames) + " |", "| --- |" + " ---: |" * len(frames)]
    for name in README_COUNTERS:
        lines.append(f"| `{name}` | " + " | ".join(f"{frame.counters[name]:,}" for frame in frames.values()) + " |")
    return "\n".join(lines)


def definitions_table() -> str:
    """docs/counters.md: every counter with its definition."""
    lines = ["| counter | unit | what it counts | same as |", "| --- | --- | --- | --- |"]
    lines += [f"| `{name}` | {d.unit} | {d.stage}: {d.text} | {d.same_as} |" for name, d in DEFINITIONS.items()]
    return "\n".join(lines)


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
    rows = [row for name, builder in BUILDERS.items() for row in keys_table(builder.parameters, f"{name}: ")]
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


def costs_rows() -> str:
    """docs/bounds.md: operations of the bounds in invocations of the domain shader."""
    counts = count_operations(1)
    plain, mapped = counts["domain shader"], counts["domain shader, map"]
    lines = ["| bound | box | all | paper |", "| --- | ---: | ---: | ---: |"]
    for name in BOUNDS:
        paper = f"{PAPER[name][0]:g}" if name in PAPER else ""
        box, whole = counts[name].box / plain.total, counts[name].total / mapped.total
        lines.append(f"| `{name}` | {box:.1f} | {whole:.1f} | {paper} |")
    return "\n".join(lines)


TEXTS: dict[str, tuple[Path, Callable[[], str]]] = {
    "counters": (ROOT / "README.md", counters_table),
    "costs": (ROOT / "docs" / "bounds.md", costs_rows),
    "quality": (ROOT / "docs" / "bounds.md", quality_rows),
    "scene keys": (ROOT / "docs" / "scenes.md", scene_keys_table),
    "builders": (ROOT / "docs" / "scenes.md", builders_table),
    "definitions": (ROOT / "docs" / "counters.md", definitions_table),
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
    for name, (path, text) in TEXTS.items():
        write_bytes(path, replace_block(path.read_text(), name, text()).encode())


if __name__ == "__main__":
    main()
