"""The papers and their items by name. An item's module is imported when it is asked for."""

from importlib import import_module

from tiler.errors import TilerError, unknown_name
from tiler.reproduce.item import Item

PAPERS = {
    "munkberg2010": "Munkberg, Hasselgren, Toth, Akenine-Möller 2010, Efficient Bounding of Displaced Bézier Patches",
    "sathe2011": "Sathe 2011, View Frustum Culling of Catmull-Clark Patches in DirectX 11",
    "loop2011": "Loop, Nießner, Eisenacher 2011, Effective Back-Patch Culling for Hardware Tessellation",
    "beyond": "Beyond the papers: patch and sub-patch binning against triangle binning and the ideal",
}


def item_names(paper: str) -> list[str]:
    """Names of a paper's items, in the paper's order. Raises TilerError for an unknown paper."""
    if paper not in PAPERS:
        raise TilerError(f"paper: {paper!r} is unknown; {unknown_name(paper, PAPERS)}")
    modules: tuple[str, ...] = import_module(f"tiler.reproduce.{paper}").ITEMS
    return [module.replace("_", "-") for module in modules]


def load_item(paper: str, name: str) -> Item:
    """An item. Raises TilerError for an unknown paper or item."""
    names = item_names(paper)
    if name not in names:
        raise TilerError(f"item: {name!r} is unknown in {paper}; {unknown_name(name, names)}")
    item: Item = import_module(f"tiler.reproduce.{paper}.{name.replace('-', '_')}").ITEM
    return item
