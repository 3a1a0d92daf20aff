"""`--plugin`, which any command takes: bounds and cull tests of the user's own."""

import os
from importlib.metadata import entry_points
from pathlib import Path

from tiler.errors import TilerError


def load_named_plugins(arguments: list[str]) -> list[str]:
    """Import the plug-ins that the arguments, TILER_PLUGINS and installed packages name; the other arguments.

    Those of the arguments are added to TILER_PLUGINS, by absolute path, for processes that this one starts.
    """
    rest, named = [], []
    words = iter(arguments)
    for word in words:
        if word == "--plugin":
            named.append(next(words, ""))
        elif word.startswith("--plugin="):
            named.append(word.removeprefix("--plugin="))
        else:
            rest.append(word)
    if "" in named:
        raise TilerError("plugin: missing; allowed: the path of a .py file, or a module's name")
    if named:
        known = [part for part in os.environ.get("TILER_PLUGINS", "").split(",") if part]
        paths = [str(Path(name).absolute()) if name.endswith(".py") else name for name in named]
        os.environ["TILER_PLUGINS"] = ",".join([*known, *paths])
    if os.environ.get("TILER_PLUGINS") or entry_points(group="tilesim.plugins"):
        from tiler.extensions import load_plugins  # slow: only where there is something to load

        load_plugins()
    return rest
