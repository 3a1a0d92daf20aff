"""Where the eyes of random views are. The paper says "random views" and no more, so the distribution is a parameter.

Back-facing is a matter of the eye's place alone: which way the camera looks changes nothing. R is the radius of the sphere
about the middle of the model's box that holds all control points.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from pipeline.types import F64
from tiler.reproduce.plain import Ball

NEAR = 1.2  # R: the sphere whose rates come nearest to those that are published


class Distribution(NamedTuple):
    """A way to draw eyes. distance : in R, where all are as far; None else."""

    name: str
    draw: Callable[[np.random.Generator, int, Ball], F64]
    distance: float | None = None


def _ways(rng: np.random.Generator, n: int) -> F64:
    """Unit vectors, even over the sphere, (n, 3)."""
    ways = rng.normal(size=(n, 3))
    return np.asarray(ways / np.sqrt((ways**2).sum(axis=1, keepdims=True)))


def on_sphere(distance: float, rng: np.random.Generator, n: int, ball: Ball) -> F64:
    """Even over a sphere of `distance` R about the middle."""
    return np.asarray(ball.center + distance * ball.radius * _ways(rng, n))


def _in_shell(inner: float, outer: float, rng: np.random.Generator, n: int, ball: Ball) -> F64:
    """Even over the volume between two spheres."""
    radius = np.cbrt(rng.uniform(inner**3, outer**3, (n, 1)))
    return np.asarray(ball.center + ball.radius * radius * _ways(rng, n))


def _in_cube(half: float, rng: np.random.Generator, n: int, ball: Ball) -> F64:
    """Even over a cube of half side `half` R, without the model's box."""
    eyes = np.empty((0, 3))
    while len(eyes) < n:
        more = half * ball.radius * rng.uniform(-1.0, 1.0, (2 * n, 3))
        eyes = np.concatenate([eyes, more[(abs(more) > ball.half).any(axis=1)]])
    return np.asarray(ball.center + eyes[:n])


def _on_box(scale: float, rng: np.random.Generator, n: int, ball: Ball) -> F64:
    """Even over directions, on the model's box made larger."""
    ways = _ways(rng, n)
    reach = (scale * ball.half / np.maximum(abs(ways), 1e-12)).min(axis=1, keepdims=True)
    return np.asarray(ball.center + reach * ways)


DISTANCES = (1.0, 1.1, NEAR, 1.35, 1.5, 2.0, 3.0, 5.0, 10.0, 100.0)
SPHERES = tuple(Distribution(f"on a sphere of {d:g} R", partial(on_sphere, d), d) for d in DISTANCES)
OTHERS = (
    Distribution("in a sphere of 1.2 R", partial(_in_shell, 0.0, NEAR)),
    Distribution("in a shell, 1 to 1.5 R", partial(_in_shell, 1.0, 1.5)),
    Distribution("in a shell, 1 to 3 R", partial(_in_shell, 1.0, 3.0)),
    Distribution("in a cube of 2.4 R, box left out", partial(_in_cube, 1.2)),
    Distribution("on the box, 1.5 times as large", partial(_on_box, 1.5)),
)
PAPER = SPHERES[DISTANCES.index(NEAR)]
