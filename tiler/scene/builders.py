"""The tables of builders: meshes that a scene file calls by name. A new one is a module and a line."""

from collections.abc import Callable
from typing import Any, NamedTuple

from tiler.scene import colonnade, creature, creature_walk, spikelog, teapot, waves
from tiler.scene.control_mesh import ControlMesh
from tiler.scene.mesh import Mesh
from tiler.scene.skinning import Skinning
from tiler.scene.strict import Strict


class Builder(NamedTuple):
    """How to make one kind of mesh."""

    parameters: type[Strict]  # what a scene file may say in [object.parameters]
    num_patches: Callable[[Any], int]  # of the parameters, without building
    build: Callable[[Any], Mesh]


BUILDERS: dict[str, Builder] = {
    "teapot": Builder(teapot.Parameters, teapot.num_patches, teapot.build),
    "spikelog": Builder(spikelog.Parameters, spikelog.num_patches, spikelog.build),
    "columns": Builder(colonnade.Columns, colonnade.num_column_patches, colonnade.build_columns),
    "hall": Builder(colonnade.Hall, colonnade.num_hall_patches, colonnade.build_hall),
    "waves": Builder(waves.Parameters, waves.num_patches, waves.build),
}


class MeshBuilder(NamedTuple):
    """How to make one kind of control mesh. Its patches are made of it by subdivision, one or more a face."""

    parameters: type[Strict]
    num_faces: Callable[[Any], int]  # of the parameters, without building
    build: Callable[[Any], tuple[ControlMesh, Skinning | None]]  # the mesh, and how its vertices move, where they do


MESH_BUILDERS: dict[str, MeshBuilder] = {
    "creature": MeshBuilder(creature.Parameters, creature.num_faces, creature_walk.build_walking),
}

ALL_BUILDERS: dict[str, Builder | MeshBuilder] = {**BUILDERS, **MESH_BUILDERS}
