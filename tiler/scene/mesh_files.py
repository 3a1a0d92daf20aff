"""Files with something to draw, by the end of their names: control meshes, and patches."""

from collections.abc import Callable
from pathlib import Path

from tiler.scene import arrays, bezier_files, triangles
from tiler.scene.arrays import ArrayFault
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.mesh import Mesh

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MESH_SUFFIXES = (".obj", *USD_SUFFIXES)
PATCH_SUFFIXES = (".npz", ".npy", ".bv", ".bpt", *triangles.SUFFIXES)


def read_mesh(path: Path) -> tuple[list[ControlMesh], tuple[str, ...]]:
    """The control meshes of a file, at least one, and warnings.

    Raises ArrayFault with what is wrong with the file, and what is allowed.
    """
    kind = path.suffix.lower()
    if kind == ".obj":
        from tiler.scene.obj import read_obj

        return read_obj(path)
    if kind in MESH_SUFFIXES:
        from tiler.scene.usd import read_usd

        return read_usd(path)
    raise ArrayFault(f"ends in {kind or 'nothing'}; allowed: {', '.join(MESH_SUFFIXES)}")


def read_patches(path: Path) -> tuple[Mesh, tuple[str, ...]]:
    """The bicubic patches of a file, at least one, and warnings. Triangle meshes become flat patches.

    Raises ArrayFault with what is wrong with the file, and what is allowed.
    """
    kind = path.suffix.lower()
    if kind not in PATCH_SUFFIXES:
        raise ArrayFault(f"ends in {kind or 'nothing'}; allowed: {', '.join(PATCH_SUFFIXES)}")
    if kind in triangles.SUFFIXES:
        return triangles.read_triangles(path)
    reader: Callable[[Path], Mesh] = bezier_files.READERS.get(kind, arrays.read_patches)
    return reader(path), ()
