"""Commands that say what there is: `tiler scenes`, `tiler counters`, `tiler info`."""

from pathlib import Path

from tiler.commands.options import JsonPath
from tiler.commands.output import write_result


def scenes(*, json: JsonPath = None) -> None:
    """List the built-in scenes.

    Parameters
    ----------
    json
        Write the list as JSON to this file; - for standard output and nothing else there.
    """
    from tiler.scene.catalog import scene_summaries

    found = scene_summaries()
    if not write_result({"scenes": [scene._asdict() for scene in found]}, json):
        for scene in found:
            print(f"{scene.name:<12} {scene.patches:>6,} patches  {scene.frames:>4} frames  {scene.title}")


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
    if write_result({"counters": table}, json):
        return
    for row in table:
        same = f" ({row['same_as']})" if row["same_as"] else ""
        print(f"{row['name']:<29} {row['stage']}, {row['unit']}: {row['text']}{same}")


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
    if not write_result(found, json):
        print(info_text(found))
