"""Picture and tessellation of a scene file, with what the caller of `load_scene` gives in their place, checked likewise."""

from typing import Any

import numpy as np
from pydantic import ValidationError

from tiler.errors import TilerError
from tiler.scene.model import Picture, Tessellation
from tiler.scene.problems import problems_of
from tiler.scene.schema import PictureFile, TessellationFile
from tiler.scene.strict import Strict


def override_picture(picture: PictureFile, size: Any, samples: Any, shading: Any) -> Picture:
    """The file's [picture] with the arguments that are not None."""
    given = {"samples": samples, "shading": shading}
    if size is not None:
        if isinstance(size, str) or not hasattr(size, "__len__") or len(size) != 2 or None in size:
            raise TilerError(f"size: {size!r} is not allowed; allowed: (width, height)")
        given["width"], given["height"] = size
    return Picture(**_checked(picture, PictureFile, given, {"width": "size", "height": "size"}))


def override_tessellation(
    tessellation: TessellationFile, factor: Any, edge_pixels: Any, partitioning: Any
) -> Tessellation:
    """The file's [tessellation] with the arguments that are not None; `factor` and `edge_pixels` replace each other."""
    given = {"factor": factor, "edge_pixels": edge_pixels, "partitioning": partitioning}
    dropped = [key for key, other in (("factor", edge_pixels), ("edge_pixels", factor)) if other is not None]
    return Tessellation(**_checked(tessellation, TessellationFile, given, {}, dropped))


def _checked(
    table: Strict,
    model: type[Strict],
    given: dict[str, Any],
    argument: dict[str, str],
    dropped: list[str] | None = None,
) -> dict[str, Any]:
    """All values of the table, with the given ones that are not None; those of `dropped` keys fall back to their defaults."""
    values = {key: value for key, value in table.model_dump(exclude_unset=True).items() if key not in (dropped or [])}
    values |= {key: _plain(value) for key, value in given.items() if value is not None}
    try:
        return model.model_validate(values).model_dump()
    except ValidationError as error:
        found = problems_of(error, model)
        raise TilerError("\n".join(f"{argument.get(str(p.path[0]), p.path[0])}: {p.text}" for p in found)) from None


def _plain(value: Any) -> Any:
    """A NumPy number as Python's; other values as they are."""
    return value.item() if isinstance(value, np.generic) else value
