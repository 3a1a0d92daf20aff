"""Files that appear whole or not at all: written beside their place under another name, then renamed into it."""

import io
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.errors import TilerError

if TYPE_CHECKING:
    import numpy as np
    from PIL.Image import Image


def make_folder(folder: Path) -> None:
    """Make `folder` and its parents. Raises TilerError where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TilerError(
            f"out: {folder} is not allowed; allowed: a folder that can be written ({error.strerror})"
        ) from None


def check_target(path: Path, option: str) -> None:
    """Raise TilerError where a file cannot be written, before hours are spent on what it is to hold."""
    if path.is_dir() or not path.absolute().parent.is_dir() or not os.access(path.absolute().parent, os.W_OK):
        raise TilerError(f"{option}: {path} is not allowed; allowed: a file in a folder that can be written")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file. Interrupted at any point it leaves what was there before."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(content)
        beside.replace(path)
    except OSError as error:
        raise TilerError(f"out: cannot write {path} ({error.strerror})") from None
    finally:
        beside.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Write a value as indented JSON."""
    write_bytes(path, (json.dumps(value, indent=2) + "\n").encode())


def write_png(path: Path, image: "Image") -> None:
    """Write a picture as PNG."""
    content = io.BytesIO()
    image.save(content, "PNG")
    write_bytes(path, content.getvalue())


def write_npy(path: Path, array: "np.ndarray") -> None:
    """Write an array in NumPy's format, without pickled objects."""
    import numpy as np

    content = io.BytesIO()
    np.save(content, array, allow_pickle=False)
    write_bytes(path, content.getvalue())
