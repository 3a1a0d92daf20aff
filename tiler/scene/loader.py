"""A scene file becomes a Scene: read and check the text, then build or read the meshes and maps, then put all together.

Every fault that can be found is found before the first error is raised, and all come in one TilerError.
"""

import re
import tomllib
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from pipeline.animate import Motion
from pipeline.subdivision.surface import Surface
from pipeline.types import F32
from tiler.errors import TilerError, TilerWarning
from tiler.scene import arrays, map_files, mesh_files, problems, schema, surfaces
from tiler.scene.arrays import ArrayFault
from tiler.scene.builders import ALL_BUILDERS, BUILDERS, MESH_BUILDERS
from tiler.scene.maps import MAPS
from tiler.scene.mesh import Mesh
from tiler.scene.model import CameraKey, CameraPath, DisplacementMap, Picture, Scene, SceneMesh, Tessellation
from tiler.scene.problems import Problem
from tiler.scene.strict import Strict
from tiler.scene.toml_lines import toml_lines
from tiler.scene.transform import object_to_world

SIZE_LIMIT = 16 * 2**20  # bytes of a scene file


class Checked(NamedTuple):
    """A scene file that says nothing wrong; the files that it names were not opened yet."""

    file: Path
    scene: schema.SceneFile
    parameters: list[Strict | None]  # of each object's builder
    lines: dict[problems.Path, int]


def read_scene_file(file: Path) -> Checked:
    """Read and check a scene file. Raises TilerError with all that is wrong in it."""
    text = _read_text(file)
    try:
        data = tomllib.loads(text)
        lines = toml_lines(text)
    except RecursionError:
        raise TilerError(f"{file}: is nested too deeply to be read") from None
    except tomllib.TOMLDecodeError as error:
        raise TilerError(_syntax_error(file, text, str(error))) from None
    except ValueError:  # Python's limit for the digits of a whole number
        raise TilerError(f"{file}: has a number of too many digits") from None
    found: list[Problem] = []
    scene = None
    try:
        scene = schema.SceneFile.model_validate(data)
    except ValidationError as error:
        found += problems.problems_of(error, schema.SceneFile)
    parameters = _check_parameters(data, found)
    if found or scene is None:
        raise problems.error_of(str(file), found, lines)
    return Checked(file, scene, parameters, lines)


def build_scene(checked: Checked, name: str) -> Scene:
    """Build or read what a checked file describes. Raises TilerError with all that is wrong with the files that it names."""
    found: list[Problem] = []
    patches: list[tuple[int, int, Mesh]] = []  # object, map, patches
    meshes: list[SceneMesh] = []
    motions: list[Motion | None] = []
    maps: list[DisplacementMap] = []
    for k, described in enumerate(checked.scene.object):
        displacement = _displacement(checked, k, found)
        map_id = -1 if displacement is None else len(maps)
        maps += [] if displacement is None else [displacement]
        num_vertices, own = 0, None
        if _is_surface(described):
            made = _surface(checked, k, found)
            if made is not None:
                num_vertices, own = len(made.vertices), made.motion
                seams = "keep" if described.displacement is None else described.displacement.seams
                meshes.append(SceneMesh(made.surface, made.vertices, k, map_id, seams))
        else:
            mesh = _mesh(checked, k, found)
            if mesh is not None:
                patches.append((k, map_id, mesh))
        motions.append(_motion(checked, k, num_vertices, own, found))
    if found:
        raise problems.error_of(str(checked.file), found, checked.lines)
    empty = np.empty((0, 4, 4, 4), np.float32), np.empty((0, 4, 2), np.float32)
    count = [len(mesh.control_points) for _, _, mesh in patches]
    scene = checked.scene
    return Scene(
        name=name,
        control_points=np.concatenate([empty[0], *(mesh.control_points for _, _, mesh in patches)]),
        texcoords=np.concatenate([empty[1], *(mesh.texcoords for _, _, mesh in patches)]),
        map_id=np.repeat(np.array([m for _, m, _ in patches], np.int32), count),
        object_id=np.repeat(np.array([k for k, _, _ in patches], np.int32), count),
        transforms=np.stack([object_to_world(o.translate, o.rotate, o.scale) for o in scene.object]),
        maps=tuple(maps),
        meshes=tuple(meshes),
        motions=tuple(motions) if any(motion is not None for motion in motions) else (),
        camera=camera_path(scene.camera),
        picture=Picture(**scene.picture.model_dump()),
        tessellation=Tessellation(**scene.tessellation.model_dump()),
        face_cull=scene.face_cull,
        light=scene.light,
        frames=scene.frames,
        title=scene.title,
    )


def count_patches(checked: Checked) -> int:
    """Patches of the scene; builders are asked and not run, files are read."""
    found: list[Problem] = []
    total = 0
    for k, described in enumerate(checked.scene.object):
        if _is_surface(described):
            made = _surface(checked, k, found)
            total += 0 if made is None else made.surface.num_patches
        elif described.builder is not None:
            total += BUILDERS[described.builder].num_patches(checked.parameters[k])
        else:
            mesh = _mesh(checked, k, found)
            total += 0 if mesh is None else len(mesh.control_points)
    if found:
        raise problems.error_of(str(checked.file), found, checked.lines)
    return total


def camera_path(camera: schema.CameraFile) -> CameraPath:
    """The camera path of a checked [camera] table."""
    keys = tuple(CameraKey(key.frame, key.eye, key.target) for key in camera.key)
    return CameraPath(keys, camera.up, camera.fov, camera.near, camera.far)


def _read_text(file: Path) -> str:
    """Text of a scene file."""
    try:
        if file.is_dir():
            raise TilerError(f"{file}: is a folder; allowed: a scene file (.toml)")
        if not file.exists():
            raise TilerError(f"{file}: no such scene file")
        if not file.is_file() or file.stat().st_size > SIZE_LIMIT:
            raise TilerError(f"{file}: is not a text file of at most {SIZE_LIMIT} bytes")
        return file.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise TilerError(f"{file}:{line}: byte 0x{error.object[error.start]:02x} is not UTF-8 text") from None
    except (OSError, ValueError) as error:
        if isinstance(error, TilerError):
            raise
        raise TilerError(f"{file}: cannot be read ({error})") from None


def _syntax_error(file: Path, text: str, message: str) -> str:
    """tomllib's message with its place moved to the front."""
    lines = text.rstrip("\n").split("\n")
    message = message.replace("(at end of document)", f"(at line {len(lines)}, column {len(lines[-1]) + 1})")
    match = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    if match:
        return f"{file}:{match[2]}:{match[3]}: not valid TOML: {match[1]}"
    return f"{file}: not valid TOML: {message}"


def _check_parameters(data: dict[str, Any], found: list[Problem]) -> list[Strict | None]:
    """Read each object's builder parameters; objects that are wrong in other ways are left to the schema."""
    objects = data.get("object")
    checked: list[Strict | None] = []
    for k, described in enumerate(objects if isinstance(objects, list) else []):
        builder = described.get("builder") if isinstance(described, dict) else None
        given = described.get("parameters", {}) if isinstance(described, dict) else None
        checked.append(None)
        if isinstance(builder, str) and builder in ALL_BUILDERS and isinstance(given, dict):
            model = ALL_BUILDERS[builder].parameters
            try:
                checked[-1] = model.model_validate(given)
            except ValidationError as error:
                found += problems.problems_of(error, model, ("object", k, "parameters"))
    return checked


def _mesh(checked: Checked, k: int, found: list[Problem]) -> Mesh | None:
    """The patches of object k; None, and a problem more, where its file is wrong."""
    described = checked.scene.object[k]
    if described.builder is not None:
        return BUILDERS[described.builder].build(checked.parameters[k])
    path = checked.file.parent / str(described.patches)
    try:
        mesh, told = mesh_files.read_patches(path)
    except ArrayFault as fault:
        found.append(Problem(("object", k, "patches"), f"{path} {fault}"))
        return None
    _warn(str(path), told)
    return mesh


def _warn(source: str, told: tuple[str, ...]) -> None:
    for text in told:
        warnings.warn(f"{source}: {text}", TilerWarning, stacklevel=2)


def _is_surface(described: schema.ObjectFile) -> bool:
    """Whether an object is a subdivision surface: of a mesh file, or of a builder of control meshes."""
    return described.mesh is not None or described.builder in MESH_BUILDERS


class Made(NamedTuple):
    """A subdivision surface with its points, and how its builder or file moves them."""

    surface: Surface
    vertices: F32
    motion: Motion | None = None


def _surface(checked: Checked, k: int, found: list[Problem]) -> Made | None:
    """Surface of object k; None, and a problem more, where its file is wrong. Warnings are warned of."""
    described = checked.scene.object[k]
    if described.builder is not None:
        built, skinning = MESH_BUILDERS[described.builder].build(checked.parameters[k])
        surface, vertices, told = surfaces.surface_of([built], described.basis, described.refine)
        _warn(f"builder {described.builder}", told)
        return Made(surface, vertices, None if skinning is None else surfaces.motion_of(skinning))
    path = checked.file.parent / str(described.mesh)
    try:
        surface, vertices, motion, told = surfaces.read_surface(
            path, described.basis, described.refine, described.displacement is not None
        )
    except arrays.ArrayFault as fault:
        found.append(Problem(("object", k, "mesh"), f"{path} {fault}"))
        return None
    _warn(str(path), told)
    return Made(surface, vertices, motion)


def _motion(checked: Checked, k: int, num_vertices: int, own: Motion | None, found: list[Problem]) -> Motion | None:
    """How object k moves: as its animation says, else by itself. None where it stands still, or, with a problem more, where
    its file is wrong."""
    described = checked.scene.object[k]
    if described.animation is None and own is not None:
        return own
    if described.animation is None or (described.mesh is not None and num_vertices == 0):
        return None
    path = checked.file.parent / described.animation
    try:
        return surfaces.read_motion(path, num_vertices)
    except arrays.ArrayFault as fault:
        found.append(Problem(("object", k, "animation"), f"{path} {fault}"))
        return None


def _displacement(checked: Checked, k: int, found: list[Problem]) -> DisplacementMap | None:
    """The displacement of object k; None where it has none, or where, a problem more, its file is wrong."""
    described = checked.scene.object[k].displacement
    if described is None:
        return None
    texels: F32
    if schema.is_map_file(described.map):
        path = checked.file.parent / described.map
        try:
            vector = described.kind == "vector"
            texels = map_files.read_vector_map(path) if vector else map_files.read_map(path, described.channel)
        except ArrayFault as fault:
            found.append(Problem(("object", k, "displacement", "map"), f"{path} {fault}"))
            return None
    else:
        texels = MAPS[described.map](described.size, described.seed)
    return DisplacementMap(texels, described.address, described.scale, described.bias, described.space)
