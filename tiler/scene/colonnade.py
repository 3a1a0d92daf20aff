"""A hypostyle hall: a forest of tall columns on a grid, in a box of floor, ceiling and walls that faces inwards.

Scenes with many layers behind each other, for occlusion culling: a ray of length L among columns of radius R with
distance D between them meets 2 R L / D^2 of them on average.

All control points are whole multiples of 2^-16 and below 128 in size, so they and their differences are exact in
float32 (see `bspline`). A column's quarter circle has the control points (1, 0) (1, 1/2) (1/2, 1) (0, 1) times its radius:
the periodic cubic B-spline through four points, round to 3 %. Its differences at the seams are equal in every bit.
"""

from typing import Literal

import numpy as np
from pydantic import model_validator

from pipeline.types import F64
from tiler.scene.mesh import Mesh, grid_texcoords, mesh_of
from tiler.scene.rounding import round_to_grid
from tiler.scene.strict import Faults, Strict, number, whole

QUARTER = np.array([(1.0, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 1.0)])
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # row vectors times this turn by +90 degrees
SLIMMING = 0.875  # radius of the shaft's top; its foot has 1

# Profiles (r, z) of one patch: r in column radii; z of base and capital in column radii up from the foot, down from the top.
BASE = [(1.5, 0.0), (1.6875, 0.5), (1.5, 0.875), (0.9375, 0.875)]
CAPITAL = [(0.8125, 2.0), (1.0, 1.5), (1.0, 0.625), (1.75, 0.0)]


class Columns(Strict):
    """A grid of columns, centred on the z axis, standing on z = 0. World units."""

    part: Literal["base", "shaft", "capital"] = "shaft"
    along: int = whole(20, 1, 32, " (columns in a row along x)")
    across: int = whole(12, 1, 32, " (rows along y)")
    nave: int = whole(1, -1, 31, " (the row that is left out, -1: none)")
    spacing: float = number(3.0, 0.01, 6.0)
    radius: float = number(0.85, 0.01, 4.0)
    height: float = number(7.5, 0.01, 120.0)

    @model_validator(mode="after")
    def _has_a_row(self) -> "Columns":
        if self.across == 1 and self.nave == 0:
            raise Faults((("nave",), "leaves out the only row; allowed: -1, or more rows across"))
        return self


class Hall(Strict):
    """A box centred on the z axis, its floor at z = 0. World units."""

    part: Literal["floor", "ceiling", "walls"] = "floor"
    along: int = whole(10, 1, 32, " (patches along x)")
    across: int = whole(6, 1, 32, " (patches along y)")
    up: int = whole(1, 1, 32, " (patches along z)")
    patch: float = number(6.0, 0.01, 6.0, " (side of a patch of floor or ceiling)")
    height: float = number(7.5, 0.01, 120.0)
    per_map: Literal[1, 2, 4, 8] = 2  # patches along a side of the map, which repeats


def num_column_patches(parameters: Columns) -> int:
    """Four patches a column."""
    return 4 * len(_centres(parameters))


def num_hall_patches(parameters: Hall) -> int:
    """Patches of the wanted faces."""
    along, across, up = parameters.along, parameters.across, parameters.up
    return 2 * (along + across) * up if parameters.part == "walls" else along * across


def build_columns(parameters: Columns) -> Mesh:
    """One part of all columns, front side out; u runs around (the map once), v up (the map once). Rows from -y to +y."""
    r, z = np.array(_profile(parameters)).T
    quarters = [QUARTER @ np.linalg.matrix_power(TURN, k) for k in range(4)]
    column = np.zeros((4, 4, 4, 3))
    column[..., :2] = np.array(quarters)[:, :, None, :] * r[:, None]
    column[..., 2] = z
    centres = _centres(parameters)
    points = column[None] + np.pad(centres, ((0, 0), (0, 1)))[:, None, None, None, :]
    texcoords = grid_texcoords(np.arange(5) / 4, np.arange(2))
    return mesh_of(points.reshape(-1, 4, 4, 3), np.tile(texcoords, (len(centres), 1, 1)))


def build_hall(parameters: Hall) -> Mesh:
    """Floor, ceiling or the four walls, front side in."""
    side = round_to_grid(parameters.patch / 6) * 2  # between control points, a multiple of 2^-15: half of it is used
    step = np.array([side, side, round_to_grid(parameters.height / (3 * parameters.up))])
    along, across, up = 3 * parameters.along, 3 * parameters.across, 3 * parameters.up
    x, y = along / 2, across / 2
    faces = {
        "floor": [((-x, -y, 0), (along, 0, 0), (0, across, 0))],
        "ceiling": [((-x, -y, up), (0, across, 0), (along, 0, 0))],
        "walls": [
            ((-x, y, 0), (along, 0, 0), (0, 0, up)),
            ((x, y, 0), (0, -across, 0), (0, 0, up)),
            ((x, -y, 0), (-along, 0, 0), (0, 0, up)),
            ((-x, -y, 0), (0, across, 0), (0, 0, up)),
        ],
    }  # (corner, side along u, side along v) in control-point steps; u x v points into the hall
    meshes = [_face(*face, step, parameters.per_map) for face in faces[parameters.part]]
    return Mesh(*(np.concatenate(arrays) for arrays in zip(*meshes, strict=True)))


def _face(corner: tuple, u: tuple, v: tuple, step: F64, per_map: int) -> Mesh:
    """A flat rectangle of patches. corner, u, v in steps; step (3,) between control points along x, y, z."""
    m, n = (sum(abs(c) for c in side) // 3 for side in (u, v))
    along = np.array(u) // (3 * m)
    up = np.array(v) // (3 * n)
    i = 3 * np.arange(m)[:, None] + np.arange(4)  # (m, 4) control-point numbers along u
    j = 3 * np.arange(n)[:, None] + np.arange(4)
    points = np.array(corner) + i[:, None, :, None, None] * along + j[None, :, None, :, None] * up
    return mesh_of(
        (points * step).reshape(-1, 4, 4, 3), grid_texcoords(np.arange(m + 1) / per_map, np.arange(n + 1) / per_map)
    )


def _profile(parameters: Columns) -> list[tuple[float, float]]:
    """Control points (r, z) of the part from bottom to top, world units, multiples of 2^-15 (their halves are used)."""
    radius, height = parameters.radius, parameters.height
    if parameters.part == "base":
        points = [(r * radius, z * radius) for r, z in BASE]
    elif parameters.part == "capital":
        points = [(r * radius, height - z * radius) for r, z in CAPITAL]
    else:
        points = [(radius * (1 + (SLIMMING - 1) * k / 3), height * k / 3) for k in range(4)]
    return [(2 * round_to_grid(r / 2), round_to_grid(z)) for r, z in points]


def _centres(parameters: Columns) -> F64:
    """Centres (n, 2) of the columns, row by row along x."""
    spacing = round_to_grid(parameters.spacing / 2)  # halves, so that an even number of columns can be centred
    x = [spacing * (2 * i - parameters.along + 1) for i in range(parameters.along)]
    y = [spacing * (2 * j - parameters.across + 1) for j in range(parameters.across) if j != parameters.nave]
    return np.array([(a, b) for b in y for a in x]).reshape(-1, 2)
