"""A log with rounded ends, 8 patches around and 12 along: low curvature, to be displaced by spikes longer than a patch.

After the model of that name in Figure 10 of Munkberg et al. 2010 (96 patches; theirs was not published): the case in which
bounds that know the normals win, and bounds that only know the size of the displacement lose.
"""

import numpy as np

from pipeline.types import F64
from tiler.scene.bspline import bezier_patches, on_grid
from tiler.scene.mesh import Mesh, grid_texcoords, mesh_of
from tiler.scene.noise import uniform
from tiler.scene.rounding import cos_turns, sin_turns
from tiler.scene.strict import Strict, number, whole

AROUND = 8
# De Boor points (x, r) of the half from the middle of the log to its end; the other half mirrors it.
PROFILE = [(0.0, 1.06), (0.8, 1.08), (1.6, 1.1), (2.4, 1.1), (3.2, 1.06), (3.9, 0.8), (4.15, 0.0)]


class Parameters(Strict):
    """How far the log is from a straight and even one."""

    bend: float = number(0.35, 0.0, 2.0, " (how far the middle is off the line through the ends)")
    bumps: float = number(0.12, 0.0, 0.5, " (part of the radius by which it varies)")
    seed: int = whole(1, 0, 2**31 - 1)


def num_patches(parameters: Parameters) -> int:
    """8 around times 12 along."""
    return AROUND * 2 * (len(PROFILE) - 1)


def build(parameters: Parameters) -> Mesh:
    """The log, 8.3 units long along x, of radius 1, front side out; u runs around it, v along; the map covers it once.

    The ends are poles, where edges collapse to a point. A net that is odd across the axis there (row -1 is row 1 with
    the other sign) makes them smooth, and the control points of a collapsed edge equal in every bit. Patches at a pole
    agree in position only where the displacement is 0, so the map is to be 0 at t = 0 and t = 1, as `spikes` is.
    """
    net = _net(parameters)
    points = bezier_patches(net, periodic_u=True)
    rows = net.shape[1] - 3
    return mesh_of(points, grid_texcoords(np.arange(AROUND + 1) / AROUND, np.arange(rows + 1) / rows))


def _net(parameters: Parameters) -> F64:
    """De Boor points (8, 15, 3)."""
    profile = [(-x, r) for x, r in reversed(PROFILE[1:])] + PROFILE
    ring = np.array([(cos_turns(k / AROUND), sin_turns(k / AROUND)) for k in range(AROUND)])
    last = len(profile) - 1
    k = np.arange(last + 1)
    bumps = 1.0 + parameters.bumps * (uniform(parameters.seed, np.arange(AROUND)[:, None], k[None, :]) - 0.5)
    rows = np.empty((AROUND, last + 1, 3))
    rows[..., 0] = [x for x, _ in profile]
    rows[..., 1:] = np.array([r for _, r in profile])[None, :, None] * bumps[..., None] * ring[:, None, :]
    rows = on_grid(rows)
    before, after = _through_axis(rows[:, 1]), _through_axis(rows[:, last - 1])
    net = np.concatenate([before[:, None], rows, after[:, None]], axis=1)
    across = 4.0 * k * (last - k) / last**2  # 0 at the ends, 1 in the middle
    along = np.concatenate([across[1:2], across, across[1:2]])
    net[..., 2] += on_grid(parameters.bend * (along - 0.5))
    return net


def _through_axis(row: F64) -> F64:
    """A row of the net mirrored in the axis, so that with it the pole between them is smooth."""
    return row * np.array([1.0, -1.0, -1.0])
