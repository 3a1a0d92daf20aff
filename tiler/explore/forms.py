"""The page's forms, made from the fields of Machine: what kind of control each is, what it may hold, and what it means."""

import inspect
import re
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS
from tiler.comparison import MACHINES
from tiler.config import BLOCK_SIZES, OCCLUSION_TESTS, TILE_SIZES, Machine
from tiler.queue_models import queue_model_names

Data = dict[str, Any]


def machine_form(machine: Machine) -> list[Data]:
    """A control a field: `kind` is choice, list, tick, number or text; `none`: it may be left empty.

    machine : the one that the explorer was started with; a queue model from a file is among the choices only there.
    """
    models = list(dict.fromkeys([machine.queue_model, *queue_model_names()]))
    known: dict[str, list[Any]] = {
        "tile": list(TILE_SIZES),
        "coarse_z_block": list(BLOCK_SIZES),
        "bounds": list(BOUNDS),
        "queue_model": models,
    }
    texts = field_texts()
    return [
        {"name": name, "text": texts.get(name, "")} | _control(name, info.annotation, known)
        for name, info in Machine.model_fields.items()
    ]


def _control(name: str, annotation: Any, known: dict[str, list[Any]]) -> Data:
    parts = [part for part in get_args(annotation) if part is not NoneType]
    none = NoneType in get_args(annotation)
    kind = parts[0] if none else annotation
    if name == "cull":
        return {"kind": "list", "choices": [*CULL_TESTS, *OCCLUSION_TESTS]}
    if name in known:
        return {"kind": "choice", "choices": known[name], "none": none}
    if get_origin(kind) is Literal:
        return {"kind": "choice", "choices": list(get_args(kind)), "none": none}
    if kind is bool:
        return {"kind": "tick"}
    if kind in (int, float):
        return {"kind": "number", "whole": kind is int, "none": none}
    return {"kind": "text", "none": none}


def field_texts() -> dict[str, str]:
    """What Machine's docstring says of each field: paragraphs `name, name : text`, continued by lines set in."""
    texts: dict[str, str] = {}
    names: list[str] = []
    for line in inspect.cleandoc(Machine.__doc__ or "").splitlines():
        begin = re.match(r"(\w+(?:, \w+)*) : (.*)", line)
        if begin:
            names = begin[1].split(", ")
            texts |= dict.fromkeys(names, begin[2])
        elif line.startswith(" ") and names:
            texts |= {name: f"{texts[name]} {line.strip()}" for name in names}
        else:
            names = []
    return texts


def presets(machine: Machine) -> dict[str, Data]:
    """Machines by name, each all fields: the one that the explorer was started with, and those of `tiler compare`."""
    made = {"as started": machine} | {name: Machine(**fields) for name, fields in MACHINES.items()}
    return {name: preset.model_dump(mode="json") for name, preset in made.items()}
