"""Run items one after the other; what stands already, of the same settings, sources and models, is not run again."""

import hashlib
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.jit import source_digest
from tiler import data_files
from tiler.files import make_folder, write_bytes
from tiler.provenance import provenance
from tiler.reproduce import page
from tiler.reproduce.catalog import PAPERS, item_names
from tiler.reproduce.item import Context, Item
from tiler.reproduce.models import model_files
from tiler.reproduce.write import read_record, rows_of, write_item, write_page
from tiler.scene.catalog import scene_names, scene_path


class Done(NamedTuple):
    """An item that stands."""

    record: dict[str, Any]
    reused: bool  # it stood before


def run_item(item: Item, context: Context, folder: Path, command: str, again: bool = False) -> Done:
    """Run an item and write its files into `folder`, or take those that stand there; its page is written in any case."""
    key = item_key(item, context)
    kept = None if again else read_record(folder, item.name)
    if kept is not None and kept.get("key") == key and kept.get("paper") == item.paper:
        write_page(folder, kept)
        return Done(kept, True)
    make_folder(folder)
    start = time.monotonic()
    result = item.run(context)
    record = {
        "paper": item.paper, "item": item.name, "title": item.title, "key": key, "command": command,
        "seed": context.seed, "quick": context.quick, "seconds": round(time.monotonic() - start, 3),
        "provenance": provenance() | {"seed": str(context.seed), "quick": "yes" if context.quick else "no"},
    }  # fmt: skip
    return Done(write_item(folder, record, result), False)


def item_key(item: Item, context: Context) -> str:
    """Digest of all that an item's numbers depend on: settings, our sources that it reaches, scenes, the models' files."""
    digest = hashlib.sha256(source_digest(Path(item.run.__code__.co_filename)).encode())
    for file in sorted({scene_path(name) for name in scene_names()} | set(data_files.FOLDER.rglob("*.toml"))):
        digest.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    for file in model_files(context.models) if context.models is not None else []:
        digest.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    digest.update(json.dumps([context.quick, context.seed]).encode())
    return digest.hexdigest()


def write_index(paper: str, out: Path) -> None:
    """Write a paper's index from the records of its folder."""
    records = standing(paper, out)
    write_bytes(out / paper / "index.md", page.paper_page(PAPERS[paper], [(r, rows_of(r)) for r in records]).encode())


def standing(paper: str, out: Path) -> list[dict[str, Any]]:
    """Records of the items of a paper that stand in a folder, in the paper's order."""
    found = (read_record(out / paper, name) for name in item_names(paper))
    return [record for record in found if record is not None]
