"""The camera: where the matrix takes the points that everyone can place, and that the path passes through its keys."""

import math

import numpy as np
import pytest

from tiler.errors import TilerError
from tiler.scene.camera import camera_at, eye_and_target
from tiler.scene.model import CameraKey, CameraPath

EYE, TARGET = (3.0, -7.0, 4.0), (0.5, 1.0, 1.25)
ASPECT = 16 / 9


def path_of(*keys, **camera):
    return CameraPath(tuple(CameraKey(*key) for key in keys), **camera)


STILL = path_of((0, EYE, TARGET), near=0.5, far=40.0, fov=50.0)


def clip(camera, point):
    return camera.clip_from_world.astype(np.float64) @ [*point, 1.0]


def forward_and_distance():
    forward = np.subtract(TARGET, EYE)
    return forward / np.linalg.norm(forward), np.linalg.norm(forward)


def test_types_and_shapes():
    camera = camera_at(STILL, 0, ASPECT)
    assert camera.clip_from_world.shape == (4, 4) and camera.clip_from_world.dtype == np.float32
    assert camera.clip_from_world.flags.c_contiguous
    assert camera.eye.dtype == np.float64 and tuple(camera.eye) == EYE
    assert (camera.near, camera.far) == (0.5, 40.0)


def test_w_is_the_distance_along_the_view():
    camera = camera_at(STILL, 0, ASPECT)
    forward, distance = forward_and_distance()
    assert clip(camera, EYE)[3] == pytest.approx(0, abs=1e-5)
    assert clip(camera, TARGET)[3] == pytest.approx(distance, rel=1e-6)
    assert clip(camera, np.array(EYE) - forward)[3] == pytest.approx(-1, rel=1e-5)


def test_depth_is_0_on_the_near_plane_and_w_on_the_far_plane():
    camera = camera_at(STILL, 0, ASPECT)
    forward, _ = forward_and_distance()
    near, far = (clip(camera, EYE + distance * forward) for distance in (0.5, 40.0))
    assert near[2] == pytest.approx(0, abs=1e-5)
    assert far[2] == pytest.approx(far[3], rel=1e-6)
    depths = [(p := clip(camera, EYE + d * forward))[2] / p[3] for d in (0.5, 1, 5, 20, 40)]
    assert depths == sorted(depths)


def test_target_is_in_the_middle_and_up_is_up():
    camera = camera_at(STILL, 0, ASPECT)
    x, y, _, w = clip(camera, TARGET)
    assert (x / w, y / w) == (pytest.approx(0, abs=1e-6), pytest.approx(0, abs=1e-6))
    x, y, _, w = clip(camera, np.add(TARGET, (0, 0, 0.5)))
    assert y / w > 0.01 and x / w == pytest.approx(0, abs=1e-6)
    right = np.cross(forward_and_distance()[0], (0, 0, 1))  # of a right-handed world
    assert clip(camera, TARGET + right)[0] > 0


@pytest.mark.parametrize("aspect", [0.5, 1.0, ASPECT])
def test_field_of_view_is_vertical(aspect):
    camera = camera_at(path_of((0, (0, 0, 0), (0, 1, 0)), fov=90.0), 0, aspect)
    x, y, _, w = clip(camera, (0, 5, 5))  # 45 degrees above the view direction
    assert (x, y) == (0, pytest.approx(w, rel=1e-6))
    x, y, _, w = clip(camera, (5 * aspect, 5, 0))
    assert (x, y) == (pytest.approx(w, rel=1e-6), 0)


def test_matrix_is_affine_times_perspective():
    """Rows 0, 1 and 3 are orthogonal, and row 2 is parallel to row 3: nothing is sheared."""
    rows = camera_at(STILL, 0, ASPECT).clip_from_world[:, :3].astype(np.float64)
    for a, b in ((0, 1), (0, 3), (1, 3)):
        assert rows[a] @ rows[b] == pytest.approx(0, abs=1e-6)
    assert np.linalg.norm(np.cross(rows[2], rows[3])) == pytest.approx(0, abs=1e-6)
    assert np.linalg.norm(rows[3]) == pytest.approx(1, rel=1e-6)
    assert np.linalg.norm(rows[1]) == pytest.approx(1 / math.tan(math.radians(25)), rel=1e-4)


KEYS = [(0, (0, -9, 1), (0, 0, 0)), (10, (5, -6, 2), (1, 0, 0)), (13, (6, 0, 2), (1, 1, 0)), (40, (0, 9, 1), (0, 0, 1))]


def test_path_passes_through_its_keys_and_stands_still_outside():
    path = path_of(*KEYS)
    for frame, eye, target in KEYS:
        assert eye_and_target(path, frame) == (eye, target)
    assert eye_and_target(path, -5) == eye_and_target(path, 0)
    assert eye_and_target(path, 99) == eye_and_target(path, 40)


def test_path_has_no_jumps_of_place_or_speed():
    path = path_of(*KEYS)
    eyes = np.array([eye_and_target(path, f)[0] for f in np.arange(0, 40, 1 / 64)])
    speed = np.diff(eyes, axis=0) * 64
    assert np.abs(speed).max() < 3
    assert np.abs(np.diff(speed, axis=0)).max() < 0.05


def test_even_keys_give_catmull_rom():
    points = [(0, 0, 0), (1, 2, 0), (3, 1, 1), (4, 4, 2)]
    path = path_of(*((8 * k, p, (9, 9, 9)) for k, p in enumerate(points)))
    p0, p1, p2, p3 = (np.array(p, float) for p in points)
    for x in (0.25, 0.5, 0.75):
        expected = 0.5 * (
            2 * p1 + (p2 - p0) * x + (2 * p0 - 5 * p1 + 4 * p2 - p3) * x**2 + (3 * p1 - p0 - 3 * p2 + p3) * x**3
        )
        assert eye_and_target(path, 8 + 8 * x)[0] == pytest.approx(tuple(expected), abs=1e-12)


def test_a_loop_is_smooth_where_it_closes():
    square = [(9, 0, 1), (0, 9, 1), (-9, 0, 1), (0, -9, 1), (9, 0, 1)]
    path = path_of(*((12 * k, p, (0, 0, 0)) for k, p in enumerate(square)))
    step = 1e-4
    leaving = np.subtract(eye_and_target(path, step)[0], square[0]) / step
    arriving = np.subtract(square[0], eye_and_target(path, 48 - step)[0]) / step
    assert leaving == pytest.approx(arriving, abs=1e-3)
    assert abs(leaving[1]) > 0.5


@pytest.mark.parametrize(
    ("path", "frame", "aspect", "words"),
    [
        (path_of((0, (1, 1, 1), (1, 1, 1))), 0, 1.0, "frame 0"),
        (path_of((0, (1, 1, 1), (1, 1, 5))), 0, 1.0, "along up"),
        (path_of((0, (1e39, 0, 0), (0, 0, 0))), 0, 1.0, "float32"),
        (STILL, math.nan, 1.0, "frame: nan"),
        (STILL, 0, 0.0, "aspect: 0.0"),
        (STILL, 0, math.inf, "aspect: inf"),
    ],
)
def test_no_view_is_one_clear_error(path, frame, aspect, words):
    with pytest.raises(TilerError, match=words):
        camera_at(path, frame, aspect)


def test_same_bits_everywhere():
    """The matrix is made of + - * / sqrt in a fixed order, and of one rounded tangent; these are its bits."""
    rows = camera_at(path_of(*KEYS), 11.25, ASPECT).clip_from_world.view(np.uint32)
    assert [f"{word:08x}" for word in rows[:, 0]] == ["3f64faaf", "bf149d56", "bf36b4fd", "bf368638"]
