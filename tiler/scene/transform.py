"""Where an object stands: the object-to-world matrix of its translation, rotation and scale."""

import numpy as np

from pipeline.types import F32
from tiler.scene.rounding import cos_turns, sin_turns

Vector = tuple[float, float, float]


def object_to_world(translate: Vector, rotate: Vector, scale: Vector) -> F32:
    """Matrix (3, 4) float32: first scale, then rotate about x, then about y, then about z, then translate.

    rotate : degrees. Sines and cosines are rounded to multiples of 2^-16, so that every machine gets the same matrix; a
    rotation is exact at multiples of 90 degrees, and elsewhere its axes are off unit length by 2^-16 at most.
    """
    rows = [[scale[0], 0.0, 0.0], [0.0, scale[1], 0.0], [0.0, 0.0, scale[2]]]
    for axis, degrees in enumerate(rotate):
        c, s = cos_turns(degrees / 360.0), sin_turns(degrees / 360.0)
        a, b = (axis + 1) % 3, (axis + 2) % 3  # the plane in which the rotation turns, from a to b
        rows[a], rows[b] = (
            [c * p - s * q for p, q in zip(rows[a], rows[b], strict=True)],
            [s * p + c * q for p, q in zip(rows[a], rows[b], strict=True)],
        )
    return np.array([[*row, offset] for row, offset in zip(rows, translate, strict=True)]).astype(np.float32)
