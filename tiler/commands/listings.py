"""Commands that say what there is: `tiler scenes`, `tiler machines`, `tiler counters`, `tiler info`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.commands.options import JsonPath
from tiler.commands.output import write_result

if TYPE_CHECKING:
    from tiler.presets import Preset


def scenes(*, json: JsonPath = None) -> None:
    """List the built-in scenes.

    Examples: `tiler scenes`; `tiler scenes --json -`.

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


def machines(name: str | None = None, *, toml: bool = False, json: JsonPath = None) -> None:
    """List the machines that `--machine-preset` takes, or show one of them: what it has that the default machine has not.

    Examples: `tiler machines`; `tiler machines mali-like`; `tiler machines mali-like --toml` (with > mine.toml, a file to edit
    for `--machine-file mine.toml`); `tiler machines openswr-like --json -`.

    Parameters
    ----------
    name
        One of them, or a .toml file that holds a machine.
    toml
        Print the whole machine as such a file.
    json
        Write the list or the machine as JSON to this file; - for standard output and nothing else there.
    """
    from tiler.config import Machine
    from tiler.errors import TilerError
    from tiler.presets import load_preset, machine_toml, preset_names

    if name is None:
        if toml:
            raise TilerError(f"name: missing with --toml; allowed: {', '.join(preset_names())}, or FILE.toml")
        found = [load_preset(each) for each in preset_names()]
        records = [_machine_record(preset) for preset in found]
        if not write_result({"machines": records}, json):
            for preset in found:
                print(f"{preset.name:<16} {preset.title}")
        return
    preset = load_preset(name)
    if write_result(_machine_record(preset), json):
        return
    if toml:
        print(machine_toml(preset.machine(), preset.title, preset.source), end="")
        return
    print(f"{preset.name}: {preset.title}\nsource: {preset.source}")
    plain = Machine().model_dump(mode="json")
    for field, value in preset.machine().model_dump(mode="json").items():
        if value != plain[field]:
            print(f"  {field:<16} {value if not isinstance(value, list) else ', '.join(value) or 'none'}")


def _machine_record(preset: "Preset") -> dict[str, Any]:
    record = {"name": preset.name, "title": preset.title, "source": preset.source}
    return record | {"machine": preset.machine().model_dump(mode="json")}


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
