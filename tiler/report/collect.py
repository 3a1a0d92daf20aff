"""What a report of frames says, as plain data: JSON values, and numbers of arrays in `Blobs`.

All that depends on when and where it was made lies under `provenance`; the rest follows from the frames alone.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from tiler.animation import frame_key
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.errors import TilerError
from tiler.frame import Frame
from tiler.provenance import provenance
from tiler.report.encode import Blobs, picture_uri
from tiler.report.maps import MAPS, PixelMaps, tile_maps
from tiler.report.patches import Seen, look, patch_facts
from tiler.report.waterfall import Step, invocation_steps, patch_steps
from tiler.scene.model import Scene

Data = dict[str, Any]

FIGURES = ("queue_entries", "queue_bytes", "ds_invocations", "c_invocations", "rs_samples_covered", "ps_invocations")
MOST_PATCHES = 200_000  # of more, only their numbers are told
MOST_TOLD = 50  # violations of a machine
MAP_CHARACTERS = 2_400_000  # maps beyond are left out, the last ones of `MAPS` first


def collect(frames: Mapping[str, Frame], blobs: Blobs, scene: Scene | None, command: str | None) -> Data:
    """Frames by the names of their machines, the baseline first. Without the scene there are no patches and no per-pixel maps.

    Raises TilerError for no frame, pictures of different sizes, and a scene of another size.
    """
    check(frames, scene)
    first = next(iter(frames.values()))
    height, width = first.depth.shape
    # A patch is told under the pointer where all frames are the same one: then they show the same patches.
    seen = look(scene, first.machine, first.number) if scene is not None and _one_frame(frames) else None
    facts = _Facts(scene, blobs)
    pictures: dict[bytes, int] = {}
    entries: list[Data] = []
    for name, frame in frames.items():
        picture = pictures.setdefault(frame.color.tobytes(), len(pictures))
        entries.append(
            {
                "name": name,
                "fields": frame.machine.model_dump(mode="json"),
                "frame": frame.number,
                "picture": picture,
                "same": bool(np.array_equal(frame.depth_samples, first.depth_samples)) and picture == 0,
                "counters": list(frame.counters.values()),
                "tile": frame.machine.tile,
                "grid": [frame.queues.entries.shape[1], frame.queues.entries.shape[0]],
                "patches": facts.of(frame) if seen is not None else None,
                "waterfalls": _waterfalls(frame, seen),
                "ideal": frame.blame.ideal if frame.blame is not None else None,
                "verified": _verified(frame),
            }
        )
    left_out = _add_maps(list(frames.values()), entries, blobs, scene)
    shown = {name for entry in entries for name in entry["maps"]}
    first_of = {entry["picture"]: frame for entry, frame in reversed(list(zip(entries, frames.values(), strict=True)))}
    return {
        "kind": "frames",
        "title": first.scene,
        "size": [width, height],
        "figures": FIGURES,
        "pictures": [picture_uri(first_of[number].color) for number in range(len(pictures))],
        "definitions": [{"name": name} | definition._asdict() for name, definition in DEFINITIONS.items()],
        "defaults": Machine().model_dump(mode="json"),
        "machines": entries,
        "maps": {name: info._asdict() for name, info in MAPS.items() if name in shown},
        "left_out": left_out,
        "under": blobs.add(seen.under) if seen is not None else None,
        "facts": _scene_facts(scene, first),
        "provenance": _provenance(frames, scene, command),
    }


def check(frames: Mapping[str, Frame], scene: Scene | None) -> None:
    """Raise TilerError where frames and scene do not belong together."""
    if not frames:
        raise TilerError("report: no frame is given; allowed: one or more")
    sizes = {name: (frame.depth.shape[1], frame.depth.shape[0]) for name, frame in frames.items()}
    if len(set(sizes.values())) > 1:
        told = ", ".join(f"{name}: {width}x{height}" for name, (width, height) in sizes.items())
        raise TilerError(f"report: pictures of different sizes ({told}); allowed: frames of one size")
    width, height = next(iter(sizes.values()))
    if scene is not None and (scene.picture.width, scene.picture.height) != (width, height):
        raise TilerError(
            f"scene: its picture is {scene.picture.width}x{scene.picture.height}, that of the frames {width}x{height}; "
            "allowed: the scene that the frames were drawn from"
        )


def _one_frame(frames: Mapping[str, Frame]) -> bool:
    return len({frame.number for frame in frames.values()}) == 1


class _Facts:
    """What the hull stage says of patches; machines with the same bounds and culls share it."""

    def __init__(self, scene: Scene | None, blobs: Blobs) -> None:
        self._scene, self._blobs = scene, blobs
        self._made: dict[tuple[Any, ...], Data] = {}

    def of(self, frame: Frame) -> Data | None:
        """Arrays of a machine's patches; None where the scene is not given, has no patch, or too many."""
        if self._scene is None or not 0 < self._scene.num_patches <= MOST_PATCHES:
            return None
        key = (frame.number, frame.machine.bounds, *frame.machine.hull_cull)
        if key not in self._made:
            facts = patch_facts(self._scene, frame.machine, frame.number)
            self._made[key] = {name: self._blobs.add(values) for name, values in facts._asdict().items()}
        return self._made[key]


def _add_maps(frames: list[Frame], entries: list[Data], blobs: Blobs, scene: Scene | None) -> list[str]:
    """Give each entry its `maps`, by name the number of an array, map by map in the order of `MAPS`; titles of those left out.

    A map is left out on all machines or on none.
    """
    made: list[dict[str, np.ndarray]] = []
    by_frame: dict[float, PixelMaps] = {}
    for frame in frames:
        made.append(dict(tile_maps(frame)))
        if scene is not None:
            made[-1] |= by_frame.setdefault(frame.number, PixelMaps(scene, frame.number)).of(frame.machine)
    for entry in entries:
        entry["maps"] = {}
    left_out = []
    for name, info in MAPS.items():
        if blobs.size() > MAP_CHARACTERS:
            left_out += [info.title] if any(name in maps for maps in made) else []
            continue
        for entry, maps in zip(entries, made, strict=True):
            if name in maps:
                entry["maps"][name] = blobs.add(maps[name])
    return left_out


def _waterfalls(frame: Frame, seen: Seen | None) -> dict[str, list[Data]]:
    visible = seen.visible if seen is not None else None
    if frame.blame is not None:
        visible = frame.blame.ideal["ideal_patches"]
    falls = {"patches": _steps(patch_steps(frame.counters, visible))}
    if frame.blame is not None:
        falls["domain-shader invocations"] = _steps(invocation_steps(frame.counters, frame.blame))
    return falls


def _steps(steps: list[Step]) -> list[Data]:
    return [step._asdict() for step in steps]


def _verified(frame: Frame) -> Data | None:
    if not frame.machine.verify:
        return None
    told = [str(violation) for violation in (*frame.violations, *frame.false_culls)]
    counts = {"violations": len(frame.violations), "false_culls": len(frame.false_culls)}
    return counts | {"told": told[:MOST_TOLD], "more": max(0, len(told) - MOST_TOLD)}


def _scene_facts(scene: Scene | None, frame: Frame) -> dict[str, str]:
    """Lines of what is drawn."""
    height, width, samples = frame.depth_samples.shape
    facts = {"scene": frame.scene, "frame": f"{frame.number:g}"}
    if scene is not None:
        factor = scene.tessellation.factor
        edge = scene.tessellation.edge_pixels
        same = len(set(factor)) == 1
        facts |= {
            "what": scene.title,
            "patches": f"{scene.num_patches:,}",
            "tessellation factor": f"{factor[0]:g}" if same else ", ".join(f"{value:g}" for value in factor),
            "edge length": f"{edge:g} pixels" if edge else "",
            "partitioning": scene.tessellation.partitioning,
            "shading": scene.picture.shading,
            "face cull": scene.face_cull,
        }
    facts |= {"picture": f"{width} × {height} pixels, {samples} sample{'s' if samples > 1 else ''} a pixel"}
    return {name: value for name, value in facts.items() if value}


def _provenance(frames: Mapping[str, Frame], scene: Scene | None, command: str | None) -> Data:
    first = next(iter(frames.values()))
    key = {} if scene is None else {"key of the baseline": frame_key(scene, first.machine, first.number)[:16]}
    return {
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": command or _python(frames),
        "milliseconds": {name: round(frame.seconds * 1e3, 1) for name, frame in frames.items()},
        "versions": key | {name: value for name, value in provenance().items() if value},
    }


def _python(frames: Mapping[str, Frame]) -> str:
    """The calls that make the frames, where no command did."""
    usual = Machine()
    lines = []
    for name, frame in frames.items():
        changed = {key: value for key, value in frame.machine if value != getattr(usual, key)}
        fields = ", ".join(f"{key}={value!r}" for key, value in changed.items())
        lines.append(f"{name!r}: tiler.simulate(scene, tiler.Machine({fields}), frame={frame.number:g}),")
    return "\n".join(["{", *(f"    {line}" for line in lines), "}"])
