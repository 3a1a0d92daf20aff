"""What a report of a study says, as plain data: its columns as arrays, its failures, where it comes from."""

import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from tiler.report.encode import Blobs

if TYPE_CHECKING:
    from tiler.study.results import Study

Data = dict[str, Any]

FIGURES = ("queue_entries", "queue_bytes", "ds_invocations", "ps_invocations")
VERSIONS = (
    "begun", "seed", "sources", "version", "commit", "python", "numpy", "numba", "llvmlite", "platform", "cpu", "cores",
)  # fmt: skip
NOT_SHOWN = ("key",)
MOST_FAILURES = 100  # different errors that are told
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def collect_study(study: "Study", blobs: Blobs, command: str | None) -> Data:
    """The table of a study, finished or still running. Its wall times, a column, differ between runs as `provenance` does."""
    names = [name for name in study.columns if name not in NOT_SHOWN]
    table = study.to_dict(names)
    rows, done, failed = study.tally()
    meta = study.meta
    return {
        "kind": "study",
        "title": study.name,
        "rows": rows,
        "done": done,
        "failed": failed,
        "figures": FIGURES,
        "columns": [{"name": name} | study.columns[name]._asdict() | _column(table[name], blobs) for name in names],
        "failures": _failures(table),
        "machines": study.machines,
        "text": meta["study"],
        "provenance": {
            "made": datetime.now(UTC).isoformat(timespec="seconds"),
            "command": command,
            "versions": {name: meta[name] for name in VERSIONS if meta.get(name)},
        },
    }  # fmt: skip


def _column(values: list[Any], blobs: Blobs) -> Data:
    """A column as arrays: numbers, or codes of its texts; and which rows have no value, where some have none."""
    missing = np.array([value is None for value in values], bool)
    absent = {"missing": blobs.add(missing)} if missing.any() else {}
    present = [value for value in values if value is not None]
    if all(isinstance(value, int) for value in present):
        made = np.array([0 if value is None else value for value in values], np.int64)
        return {"values": blobs.add(made)} | absent
    if all(isinstance(value, int | float) for value in present):
        return {
            "values": blobs.add(np.array([0.0 if value is None else value for value in values], np.float64))
        } | absent
    texts = list(dict.fromkeys(str(value) for value in present))
    code = {text: k for k, text in enumerate(texts)}
    codes = np.array([0 if value is None else code[str(value)] for value in values], np.int64)
    return {"texts": texts, "values": blobs.add(codes)} | absent


def _failures(table: dict[str, list[Any]]) -> list[Data]:
    """Errors that are the same but for their numbers, the commonest first: the first of each, its row, how many there are."""
    found: dict[str, Data] = {}
    for row, error in zip(table["row"], table["error"], strict=True):
        if error:
            kind = found.setdefault(NUMBER.sub("#", error), {"error": error, "rows": 0, "first": row, "differ": False})
            kind["rows"] += 1
            kind["differ"] |= error != kind["error"]
    return sorted(found.values(), key=lambda kind: (-kind["rows"], kind["first"]))[:MOST_FAILURES]
