"""Frames to files: pictures, depth and counters of one frame or of a stretch of a camera path, resumable.

Every frame leaves color, depth and, last, its counters with a key: a digest of the scene, the machine, the frame and the
sources. A later call finds the counters of a frame with the same key and does not draw it again.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.jit import source_digest
from tiler import __version__
from tiler.config import Machine
from tiler.files import make_folder, write_json, write_npy, write_png
from tiler.frame import Frame
from tiler.heatmaps import heatmap_picture
from tiler.history import Reel
from tiler.host import available_threads
from tiler.provenance import provenance
from tiler.queue_models import load_queue_model
from tiler.scene.model import Scene
from tiler.simulation import check_request, simulate


def frame_key(scene: Scene, machine: Machine, number: float) -> str:
    """Digest of all that a frame depends on."""
    digest = hashlib.sha256(f"{__version__} {source_digest(Path(__file__).resolve())} {number!r}".encode())
    digest.update(machine.model_dump_json().encode())
    digest.update(load_queue_model(machine.queue_model).model_dump_json().encode())
    _digest_value(digest, scene)
    return digest.hexdigest()


def _digest_value(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        for field in fields(value):
            digest.update(field.name.encode())
            _digest_value(digest, getattr(value, field.name))
    elif isinstance(value, tuple):
        for item in value:
            _digest_value(digest, item)
    else:
        digest.update(repr(value).encode())


def frame_record(frame: Frame) -> dict[str, Any]:
    """What `--json` says of one frame; `violations` and `false_culls` where the machine verifies, `blame` where it blames."""
    record = {"frame": frame.number, "counters": dict(frame.counters), "seconds": round(frame.seconds, 6)}
    return record | verify_record(frame) | blame_record(frame)


def verify_record(frame: Frame) -> dict[str, Any]:
    """What `--json` says of a frame's verification; nothing where the machine does not verify."""
    if not frame.machine.verify:
        return {}
    return {
        "violations": [violation.record() for violation in frame.violations],
        "false_culls": [violation.record() for violation in frame.false_culls],
    }


def blame_record(frame: Frame) -> dict[str, Any]:
    """What `--json` says of a frame's blame; nothing where the machine does not blame."""
    return {} if frame.blame is None else {"blame": frame.blame.record()}


def render_to_folder(
    scene: Scene,
    machine: Machine,
    numbers: Sequence[float],
    folder: Path,
    heatmaps: Sequence[str] = (),
    threads: int | None = None,
    progress: Callable[[float], None] = lambda frames: None,
    drawn: Callable[[Frame], None] = lambda frame: None,
) -> list[dict[str, Any]]:
    """Draw the frames into `folder`; their records, in order.

    One frame gives color.png, depth.npy and counters.json; several give color_0007.png and so on, and one counters.json
    with all their records at the end. That one also says where they come from: versions, commit, processor.
    progress : called with the number of frames done. drawn : called with each frame that is drawn, not found.
    """
    threads = available_threads() if threads is None else threads
    check_request(scene, machine, threads)  # before anything is left in the folder
    make_folder(folder)
    records, reel = [], Reel()
    for done, number in enumerate(numbers):
        suffix = f"_{number:04g}" if len(numbers) > 1 else ""
        ledger = folder / f"counters{suffix}.json"
        key = frame_key(scene, machine, number)
        record = _finished(folder, ledger, key, suffix, heatmaps) if suffix else None
        if record is None:
            part = _offset(progress, done)
            frame = simulate(scene, machine, frame=number, threads=threads, progress=part, reel=reel)
            record = frame_record(frame)
            drawn(frame)
            write_png(folder / f"color{suffix}.png", frame.image())
            write_npy(folder / f"depth{suffix}.npy", frame.depth)
            for name in heatmaps:
                write_png(folder / f"{file_name(name)}{suffix}.png", heatmap_picture(scene, frame, name))
            if suffix:
                write_json(ledger, {"key": key} | record)
        records.append(record)
        progress(done + 1)
    write_json(folder / "counters.json", render_result(scene, machine, records) | {"provenance": provenance()})
    return records


def render_result(scene: Scene, machine: Machine, records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The JSON object of `tiler render`."""
    return {"scene": scene.name, "machine": machine.model_dump(mode="json"), "frames": list(records)}


def file_name(heatmap: str) -> str:
    """A map's name as a file's: without a colon."""
    return heatmap.replace(":", "_")


def _offset(progress: Callable[[float], None], done: int) -> Callable[[float], None]:
    return lambda part: progress(done + part)


def _finished(folder: Path, ledger: Path, key: str, suffix: str, heatmaps: Sequence[str]) -> dict[str, Any] | None:
    """The record of a frame that an earlier call has left whole, else None."""
    pictures = [f"color{suffix}.png", f"depth{suffix}.npy", *(f"{file_name(name)}{suffix}.png" for name in heatmaps)]
    if not all((folder / name).is_file() for name in pictures):
        return None
    try:
        record = json.loads(ledger.read_text())
    except (OSError, ValueError):
        return None
    if not isinstance(record, dict) or record.pop("key", None) != key:
        return None
    return record
