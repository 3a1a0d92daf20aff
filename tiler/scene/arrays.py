"""Arrays that scene files name: control points (.npz, .npy), and checks that all files share. Nothing in them is ever executed.

Every fault is an ArrayFault whose text says what is wrong and what is allowed; the caller adds the key and the file.
"""

import zipfile
import zlib
from pathlib import Path

import numpy as np

from pipeline.types import F32
from tiler.scene.mesh import Mesh, mesh_of

MAP_LIMIT = 16384  # texels along a side, as in Direct3D 11
_NOT_NUMPY = (ValueError, EOFError, MemoryError, KeyError, SyntaxError, zipfile.BadZipFile, zlib.error)


class ArrayFault(ValueError):
    """What is wrong with an array file."""


def read_patches(path: Path) -> Mesh:
    """Patches of a file.

    .npz : `P`, float32 or float64, (n, 4, 4, 3) points or (n, 4, 4, 4) homogeneous (wx, wy, wz, w) with w > 0,
        [patch, i along u, j along v]; optional `texcoords` (n, 4, 2) at (u, v) = (0,0) (1,0) (0,1) (1,1).
    .npy : the array P alone.
    """
    texcoords = None
    if path.suffix == ".npz":
        arrays = _load(path)
        if "P" not in arrays:
            raise ArrayFault(f"has no array P but {', '.join(arrays) or 'none'}; allowed: P, and texcoords")
        points, texcoords = arrays["P"], arrays.get("texcoords")
    else:
        points = array_of(path)
    return checked_mesh(points, texcoords)


def check_file(path: Path, limit: int | None = None) -> int:
    """Size in bytes of a file that is there. Raises ArrayFault where it is not, or larger than `limit` bytes."""
    try:
        if not path.exists():
            raise ArrayFault("does not exist")
        if not path.is_file():
            raise ArrayFault("is not a file")
        size = path.stat().st_size
    except OSError as error:
        raise ArrayFault(f"cannot be read ({error.strerror})") from None
    if limit is not None and size > limit:
        raise ArrayFault(f"has {size:,} bytes; allowed: at most {limit:,}")
    return size


def bytes_of(path: Path, limit: int) -> bytes:
    """Content of a file of at most `limit` bytes; nothing is read of a larger one."""
    check_file(path, limit)
    try:
        with path.open("rb") as file:
            return file.read(limit)
    except OSError as error:
        raise ArrayFault(f"cannot be read ({error.strerror})") from None


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name."""
    arrays = _load(path)
    if "" in arrays:
        raise ArrayFault("is one array; allowed: an archive of arrays (.npz)")
    return arrays


def _load(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file by name; that of an .npy file has the name ''."""
    check_file(path)
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"": loaded}
        with loaded:
            return {name: loaded[name] for name in loaded.files}
    except OSError as error:
        raise ArrayFault(f"cannot be read ({error.strerror or 'it is cut short'})") from None
    except _NOT_NUMPY:
        raise ArrayFault(f"is no {path.suffix} file of plain numbers") from None


def array_of(path: Path) -> np.ndarray:
    """The array of an .npy file."""
    arrays = _load(path)
    if "" not in arrays:
        raise ArrayFault("is an archive of arrays; allowed: one array")
    return arrays[""]


def checked_mesh(points: np.ndarray, texcoords: np.ndarray | None) -> Mesh:
    """Mesh of arrays from outside."""
    if points.ndim != 4 or points.shape[1:3] != (4, 4) or points.shape[3] not in (3, 4):
        raise ArrayFault(f"has P of shape {points.shape}; allowed: (n, 4, 4, 3) or (n, 4, 4, 4)")
    if len(points) == 0:
        raise ArrayFault("has an empty mesh; allowed: at least one patch in P")
    points = float32_of(points, "P")
    if points.shape[3] == 4 and not (points[..., 3] > 0).all():
        p, i, j = np.argwhere(~(points[..., 3] > 0))[0]
        raise ArrayFault(f"has w = {points[p, i, j, 3]:g} in P[{p}, {i}, {j}]; allowed: weights above 0")
    if texcoords is not None:
        if texcoords.shape != (len(points), 4, 2):
            raise ArrayFault(f"has texcoords of shape {texcoords.shape}; allowed: ({len(points)}, 4, 2)")
        texcoords = float32_of(texcoords, "texcoords")
    return mesh_of(points, texcoords)


def float32_of(values: np.ndarray, name: str) -> F32:
    """Finite floating-point values as contiguous float32."""
    if values.dtype.kind != "f":
        raise ArrayFault(f"has {name} of type {values.dtype}; allowed: float32, float64")
    with np.errstate(over="ignore"):
        single = np.array(values, np.float32, order="C")
    if not np.isfinite(single).all():
        first = tuple(int(k) for k in np.argwhere(~np.isfinite(single))[0])
        raise ArrayFault(f"has {values[first]} in {name}{list(first)}; allowed: finite float32 numbers")
    return single
