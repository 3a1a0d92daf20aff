"""The camera: a point on a camera path becomes the matrix that takes world space to clip space.

Spaces. The world is right-handed. In view space the camera sits at the origin, x to the right, y up, and looks along -z.
Clip space is Direct3D's: column vectors, `clip = M @ (x, y, z, 1)`, visible where `-w <= x, y <= w` and `0 <= z <= w`;
z is 0 on the near plane and w on the far plane, and w is the distance along the view direction.

All arithmetic is done here on Python floats, one operation after the other, with + - * / sqrt only (the one tangent is
rounded to a grid): a matrix product of NumPy may go to a BLAS that fuses or reorders, and then the last bit of every
picture would depend on the machine.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pipeline.types import F32, F64
from tiler.errors import TilerError
from tiler.scene.model import CameraPath
from tiler.scene.rounding import round_to_grid

Vector = tuple[float, float, float]


class Camera(NamedTuple):
    """One view of the world, complete: what the machine needs to place a vertex on the screen."""

    clip_from_world: F32  # (4, 4), column vectors
    eye: F64  # (3,) world space
    near: float  # distance of the near plane, world units
    far: float  # distance of the far plane, world units


def camera_at(path: CameraPath, frame: float, aspect: float) -> Camera:
    """Camera at `frame` (frames may be fractions) for a picture `aspect` times as wide as high.

    Raises TilerError where no view is defined: the eye is on its target, or looks along `up`, or numbers overflow.
    """
    if not (math.isfinite(aspect) and aspect > 0):
        raise TilerError(f"aspect: {aspect!r} is not allowed; allowed: width / height, a finite number above 0")
    if not math.isfinite(frame):
        raise TilerError(f"frame: {frame!r} is not allowed; allowed: a finite number")
    eye, target = eye_and_target(path, frame)
    axes = view_axes(eye, target, path.up)
    if axes is None:
        raise TilerError(f"camera: at frame {frame:g} the eye {eye} must not lie on the line through {target} along up")
    with np.errstate(over="ignore"):
        matrix = np.array(_clip_rows(eye, axes, path, aspect)).astype(np.float32)
    if not np.isfinite(matrix).all():
        raise TilerError(
            f"camera: the matrix of frame {frame:g} does not fit float32; allowed: eye, near and far of usual size"
        )
    return Camera(matrix, np.array(eye), float(path.near), float(path.far))


def eye_and_target(path: CameraPath, frame: float) -> tuple[Vector, Vector]:
    """Eye and target at `frame`, world space: exactly the keys at the keys, and standing still outside of them.

    Between keys runs the cubic Hermite curve whose tangent at a key is the slope from the key before to the key after:
    Catmull-Rom where keys are evenly spaced, and without jumps of speed where they are not. At the first and the last
    key the slope is that of their only segment; where the last key repeats the first, the path is a loop, smooth there too.
    """
    keys = path.keys
    if frame <= keys[0].frame:
        return keys[0].eye, keys[0].target
    if frame >= keys[-1].frame:
        return keys[-1].eye, keys[-1].target
    k = max(i for i, key in enumerate(keys) if key.frame <= frame)
    eyes, targets = [key.eye for key in keys], [key.target for key in keys]
    times = [float(key.frame) for key in keys]
    loop = len(keys) > 2 and eyes[0] == eyes[-1] and targets[0] == targets[-1]
    return _hermite(times, eyes, k, frame, loop), _hermite(times, targets, k, frame, loop)


def _hermite(times: list[float], points: list[Vector], k: int, time: float, loop: bool) -> Vector:
    """Point at `time` on the segment from key k to key k + 1."""
    span = times[k + 1] - times[k]
    x = (time - times[k]) / span
    from_start, from_end = _slope(times, points, k, loop), _slope(times, points, k + 1, loop)
    h1 = x * x * (3.0 - 2.0 * x)
    h0 = 1.0 - h1
    g0 = x * (1.0 - x) * (1.0 - x) * span
    g1 = x * x * (x - 1.0) * span
    p0, p1 = points[k], points[k + 1]
    return _vector(h0 * p0[c] + h1 * p1[c] + g0 * from_start[c] + g1 * from_end[c] for c in range(3))


def _slope(times: list[float], points: list[Vector], k: int, loop: bool) -> Vector:
    """Tangent at key k, world units a frame."""
    last = len(points) - 1
    before, after = max(k - 1, 0), min(k + 1, last)
    span = times[after] - times[before]
    if loop and k in (0, last):
        before, after = last - 1, 1
        span = (times[last] - times[last - 1]) + (times[1] - times[0])
    return _vector((points[after][c] - points[before][c]) / span for c in range(3))


def view_axes(eye: Vector, target: Vector, up: Vector) -> tuple[Vector, Vector, Vector] | None:
    """Unit axes of view space in world space: right, up, and back (from target to eye); None where they are undefined."""
    back = _unit(_vector(eye[c] - target[c] for c in range(3)))
    upward = _unit(up)
    if back is None or upward is None:
        return None
    right = _unit(_cross(upward, back))
    if right is None:
        return None
    return right, _cross(back, right), back


def _clip_rows(eye: Vector, axes: tuple[Vector, Vector, Vector], path: CameraPath, aspect: float) -> list[list[float]]:
    """The four rows of clip-from-world: the projection's few non-zero entries times the view matrix."""
    half_height = round_to_grid(math.tan(math.radians(path.fov) / 2.0))  # of the picture, at distance 1
    near, far = path.near, path.far
    right, up, back = ([*axis, -_dot(axis, eye)] for axis in axes)
    # With view depth d = -z_view: z_clip = (d - near) far / (far - near), which is 0 at near, and far at far.
    slope = far / (far - near)
    return [
        [entry / (aspect * half_height) for entry in right],
        [entry / half_height for entry in up],
        [-slope * entry for entry in back[:3]] + [-slope * (back[3] + near)],
        [-entry for entry in back],
    ]


def _vector(components: Iterable[float]) -> Vector:
    x, y, z = components
    return x, y, z


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(a: Vector) -> Vector | None:
    """`a` at length 1, or None where it has (nearly) no direction of its own, or overflows."""
    length = math.sqrt(_dot(a, a))
    if not 1e-9 < length < math.inf:
        return None
    return a[0] / length, a[1] / length, a[2] / length
