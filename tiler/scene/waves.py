"""An open sea: a square grid of patches over a gentle swell. The waves on it come from a displacement map."""

import numpy as np

from tiler.scene.bspline import bezier_patches
from tiler.scene.mesh import Mesh, grid_texcoords, mesh_of
from tiler.scene.noise import uniform
from tiler.scene.strict import Strict, number, whole


class Parameters(Strict):
    """The grid and its swell; world units: a patch is 1 x 1."""

    n: int = whole(32, 1, 128, " (patches along a side)")
    swell: float = number(1.0, 0.0, 8.0, " (height of the swell)")
    seed: int = whole(1, 0, 2**31 - 1)


def num_patches(parameters: Parameters) -> int:
    """Patches of the grid."""
    return parameters.n**2


def build(parameters: Parameters) -> Mesh:
    """Grid of n x n patches over the square [-n/2, n/2]^2 of the xy plane, front side up; the map covers it once."""
    n = parameters.n
    lattice = np.arange(n + 3)
    knots = lattice - (n / 2 + 1)  # de Boor point 1 lies over the first knot
    net = np.empty((n + 3, n + 3, 3))
    net[..., 0] = knots[:, None]
    net[..., 1] = knots[None, :]
    net[..., 2] = parameters.swell * _swell(parameters.seed, lattice)
    along = np.arange(n + 1) / n
    return mesh_of(bezier_patches(net), grid_texcoords(along, along))


def _swell(seed: int, lattice: np.ndarray) -> np.ndarray:
    """Heights in [-0.5, 0.5] for each pair of lattice points: bilinear noise, which the spline then makes smooth."""
    x, y = lattice[:, None], lattice[None, :]
    coarse = uniform(seed, x // 4, y // 4)
    fx, fy = (x % 4) / 4, (y % 4) / 4
    right, above = uniform(seed, x // 4 + 1, y // 4), uniform(seed, x // 4, y // 4 + 1)
    both = uniform(seed, x // 4 + 1, y // 4 + 1)
    return (1 - fy) * ((1 - fx) * coarse + fx * right) + fy * ((1 - fx) * above + fx * both) - 0.5
