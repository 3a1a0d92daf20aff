"""The table of builders: meshes that a scene file calls by name. A new one is a module and a line."""

from collections.abc import Callable
from typing import Any, NamedTuple

from tiler.scene import colonnade, spikelog, teapot, waves
from tiler.scene.mesh import Mesh
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
