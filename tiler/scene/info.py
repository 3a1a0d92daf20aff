"""What is in a file: control meshes, patches, or a displacement map. `tiler info` prints it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tiler.errors import TilerError
from tiler.scene import map_files, mesh_files
from tiler.scene.arrays import ArrayFault
from tiler.scene.map_files import Image, read_image
from tiler.scene.mesh import Mesh
from tiler.scene.mesh_counts import count_mesh

KINDS = (*mesh_files.MESH_SUFFIXES, *mesh_files.PATCH_SUFFIXES, *map_files.SUFFIXES[1:])


def file_info(path: Path) -> dict[str, Any]:
    """What is in a mesh, patch or map file, as plain values for JSON. Raises TilerError that names the file.

    An .npy array of four axes is a patch set, any other a map.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise TilerError(f"file: {path} is not allowed; allowed: a file that ends in {', '.join(KINDS)}")
    try:
        if kind in mesh_files.MESH_SUFFIXES:
            return _mesh_info(path)
        if kind in mesh_files.PATCH_SUFFIXES and not (kind == ".npy" and _is_map(path)):
            mesh, warnings = mesh_files.read_patches(path)
            return _patches_info(path, mesh, warnings)
        return _map_info(path, read_image(path))
    except ArrayFault as fault:
        raise TilerError(f"{path}: {fault}") from None


def info_text(info: dict[str, Any]) -> str:
    """The same as a table for people."""
    lines = [f"{info['file']}: {info['kind']}"]
    for part in info.get("objects", [info]):
        if part is not info:
            lines += ["", f"object {part['name']}"]
        lines += [f"  {name:<28} {text}" for name, text in _rows(part)]
    lines += [f"warning: {warning}" for warning in info["warnings"]]
    return "\n".join(lines)


def _rows(part: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and text of each value that is not told elsewhere."""
    for name, value in part.items():
        if name in ("file", "kind", "name", "warnings", "objects"):
            continue
        label = name.replace("_", " ")
        if isinstance(value, dict):
            yield label, "  ".join(f"{k}: {v:,}" for k, v in value.items()) or "none"
        elif isinstance(value, list):
            yield label, ", ".join(f"{v:.6g}" if isinstance(v, float) else str(v) for v in value)
        elif isinstance(value, float):
            yield label, f"{value:.6g}"
        else:
            yield label, f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)


def _mesh_info(path: Path) -> dict[str, Any]:
    meshes, warnings = mesh_files.read_mesh(path)
    found, objects = list(warnings), []
    for mesh in meshes:
        counts = count_mesh(mesh)
        found += [f"{mesh.name}: {warning}" for warning in counts.warnings]
        if counts.faces_without_texcoords:
            found.append(f"{mesh.name}: {counts.faces_without_texcoords} faces have no texture coordinates")
        fields: dict[str, Any] = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in counts._asdict().items()
            if name != "warnings"
        }
        for name in ("faces_of_size", "interior_valences", "boundary_faces"):
            fields[name] = {str(k): v for k, v in fields[name].items()}
        objects.append({"name": mesh.name, **fields, "boundary_rule": mesh.boundary})
    return {"file": str(path), "kind": "control meshes", "objects": objects, "warnings": found}


def _patches_info(path: Path, mesh: Mesh, warnings: tuple[str, ...]) -> dict[str, Any]:
    points = mesh.control_points.astype(np.float64)
    straight = points[..., :3] / points[..., 3:]
    edges = [straight[:, 0], straight[:, 3], straight[:, :, 0], straight[:, :, 3]]
    collapsed = sum(int((edge == edge[:, :1]).all(axis=(1, 2)).sum()) for edge in edges)
    return {
        "file": str(path),
        "kind": "patches",
        "patches": len(points),
        "rational_patches": int((points[..., 3] != points[:, :1, :1, 3]).any(axis=(1, 2)).sum()),
        "distinct_patches": len(np.unique(points.reshape(len(points), -1), axis=0)),
        "collapsed_edges": collapsed,
        "low": straight.min(axis=(0, 1, 2)).tolist(),
        "high": straight.max(axis=(0, 1, 2)).tolist(),
        "warnings": list(warnings),
    }


def _map_info(path: Path, image: Image) -> dict[str, Any]:
    """Sizes and ranges; the numbers of a channel are those that a lookup returns, before scale and bias."""
    full = map_files.full_value(image.texels)
    ranges, warnings = {}, []
    for k, name in enumerate(image.channels):
        channel = image.texels[..., k].astype(np.float64) / full
        if not np.isfinite(channel).all():
            warnings.append(f"channel {name} has {int((~np.isfinite(channel)).sum())} texels that are not finite")
            channel = channel[np.isfinite(channel)]
        ranges[name] = [float(channel.min()), float(channel.max())] if channel.size else []
    return {
        "file": str(path),
        "kind": "displacement map",
        "width": image.texels.shape[1],
        "height": image.texels.shape[0],
        "channels": list(image.channels),
        "values": image.values,
        **{f"range_{name}": value for name, value in ranges.items()},
        "warnings": warnings,
    }


def _is_map(path: Path) -> bool:
    """Whether an .npy file holds no patches."""
    from tiler.scene.arrays import array_of

    return array_of(path).ndim != 4
