"""The Utah teapot: Martin Newell's 32 bicubic patches of 1975, z up, with the bottom that was added later.

The published tables list about three hundred vertices. This layout keeps what they say and no more. Three quarters of
the pot are a profile turned about the z axis by a fixed "quarter circle" of four control points, (0, r) (0.56 r, r)
(r, 0.56 r) (r, 0); handle and spout are half tubes, mirrored. So mirrored neighbours share their edges bit for bit.
"""

import numpy as np

from pipeline.types import F64
from tiler.scene.mesh import Mesh, mesh_of
from tiler.scene.strict import Strict

ROUNDNESS = 0.56  # of Newell's quarter circle; the best cubic has 0.5523
KNOB = 0.45  # the one number that departs from it: where the top of the knob is widest, in place of 0.56 * 0.8

# Profiles (r, z), four points a patch; the last of a patch is the first of the next.
BODY = [
    [(1.4, 2.4), (1.3375, 2.53125), (1.4375, 2.53125), (1.5, 2.4)],  # rim
    [(1.5, 2.4), (1.75, 1.875), (2.0, 1.35), (2.0, 0.9)],
    [(2.0, 0.9), (2.0, 0.45), (1.5, 0.225), (1.5, 0.15)],
]
LID = [
    [(0.0, 3.15), (0.8, 3.15), (0.0, 2.85), (0.2, 2.7)],  # knob
    [(0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4)],
]
BOTTOM = [[(1.5, 0.15), (1.5, 0.075), (1.425, 0.0), (0.0, 0.0)]]

# Half tubes: stations (outer x, outer z, inner x, inner z, half width), four a patch.
HANDLE = [
    [
        (-1.5, 2.25, -1.6, 2.025, 0.3),
        (-2.5, 2.25, -2.3, 2.025, 0.3),
        (-3.0, 2.25, -2.7, 2.025, 0.3),
        (-3.0, 1.8, -2.7, 1.8, 0.3),
    ],
    [
        (-3.0, 1.8, -2.7, 1.8, 0.3),
        (-3.0, 1.35, -2.7, 1.575, 0.3),
        (-2.65, 0.9375, -2.5, 1.125, 0.3),
        (-1.9, 0.6, -2.0, 0.9, 0.3),
    ],
]
SPOUT = [
    [
        (1.7, 0.6, 1.7, 1.425, 0.66),
        (3.1, 0.825, 2.6, 1.425, 0.66),
        (2.4, 2.025, 2.3, 2.1, 0.25),
        (3.3, 2.4, 2.7, 2.4, 0.25),
    ],
    [
        (3.3, 2.4, 2.7, 2.4, 0.25),
        (3.525, 2.49375, 2.8, 2.475, 0.25),
        (3.45, 2.5125, 2.9, 2.475, 0.15),
        (3.2, 2.4, 2.8, 2.4, 0.15),
    ],
]


class Parameters(Strict):
    """Nothing to choose but whether the pot has its bottom, which the first one lacked."""

    bottom: bool = True


def num_patches(parameters: Parameters) -> int:
    """32, or 28 without the bottom."""
    return 32 if parameters.bottom else 28


def build(parameters: Parameters) -> Mesh:
    """The pot, 3.15 units high, its axis on z, its foot at z = 0, the spout towards +x: body, handle, spout, lid, bottom."""
    parts = [*_turned(BODY), *_tube(HANDLE), *_tube(SPOUT), *_turned(LID)]
    if parameters.bottom:
        parts += _turned(BOTTOM)
    return mesh_of(np.array(parts))


def _turned(profile: list[list[tuple[float, float]]]) -> list[F64]:
    """Patches of a surface of revolution: u along the profile, v around; each piece in the four quadrants."""
    patches = []
    for piece in profile:
        quarter = np.array([[(0.0, r, z), (_side(r, z), r, z), (r, _side(r, z), z), (r, 0.0, z)] for r, z in piece])
        # From +y to +x is clockwise seen from above, and the profile runs down: du x dv would point inwards.
        quarter = quarter[:, ::-1]
        for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
            patches.append(_mirrored(quarter, x, y))
    return patches


def _side(r: float, z: float) -> float:
    """The middle control points' smaller coordinate; six decimals hold the product exactly."""
    return KNOB if (r, z) == (0.8, 3.15) else round(ROUNDNESS * r, 6)


def _tube(pieces: list[list[tuple[float, float, float, float, float]]]) -> list[F64]:
    """Patches of a tube along the xz plane: u along it, v half way around from inside to outside; then the mirror image."""
    patches = []
    for piece in pieces:
        half = np.array([[(xi, 0.0, zi), (xi, w, zi), (xo, w, zo), (xo, 0.0, zo)] for xo, zo, xi, zi, w in piece])
        patches += [_mirrored(half, 1, 1), _mirrored(half, 1, -1)]
    return patches


def _mirrored(patch: F64, x: int, y: int) -> F64:
    """Patch with x or y negated; a mirror image runs backwards along v, so that its front stays outside."""
    image = patch * np.array([x, y, 1.0]) + 0.0  # + 0.0 turns -0.0 into 0.0: shared edges are to be equal in every bit
    return image[:, ::-1] if x * y < 0 else image
