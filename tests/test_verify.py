"""The oracle finds what is planted, names it, and finds nothing else; `validate` counts, repeats itself, and can fail."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from pipeline.culling import CULL_TESTS, FLAG_OF
from pipeline.culling.offset import Offsets
from pipeline.hull import make_input
from pipeline.slopes import build_slopes
from pipeline.types import CullFlag, FaceCull
from tests.naive_domain import exact_surface
from tests.scenes import flat_patch, looking_along_y, patch_scene, sliced
from tests.shared_data import shared_file
from tests.test_domain import make_one, pack, random_map, rational_patch, smooth_patch
from tiler import cli, validation, verify
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.host import Host
from tiler.scene.camera import Camera
from tiler.scene.model import CameraKey, CameraPath, DisplacementMap

PLAIN = Machine(tile=8, bounds="cbox", cull=(), verify=True)
FRUSTUM = Machine(tile=8, bounds="cbox", cull=("frustum",), verify=True)


def plant(monkeypatch, change, name="cbox"):
    """Replace a bound by one whose result `change(stage, bounds)` has spoilt (it may also return other bounds)."""
    real = BOUNDS[name]

    def faulty(stage):
        bounds = real(stage)
        return change(stage, bounds) or bounds

    monkeypatch.setitem(BOUNDS, name, faulty)


def plant_cull(monkeypatch, name, faulty):
    monkeypatch.setitem(CULL_TESTS, name, faulty)
    monkeypatch.setitem(FLAG_OF, name, FLAG_OF.get(name, CullFlag.FRUSTUM))


def found(scene, machine):
    return tiler.simulate(scene, machine, threads=1).violations


def words(violations):
    return {violation.what for violation in violations}


@pytest.fixture
def square():
    """Two flat patches beside each other that face the camera."""
    return patch_scene([flat_patch(-1, -0.5, 0, 0.5), flat_patch(0, -0.5, 1, 0.5)], factor=4.0)


@pytest.fixture
def floor():
    """A floor that reaches from behind the camera to the far end of the view."""
    points = np.ones((4, 4, 4))
    points[..., 0] = np.linspace(-3, 3, 4)[:, None]
    points[..., 1] = np.linspace(-8, 8, 4)[None, :]
    points[..., 2] = -0.6
    return patch_scene([points], factor=12.0)


# Planted faults


def test_a_box_shrunk_by_one_part_in_a_million(monkeypatch):
    def shrink(stage, bounds):
        bounds.axes[:] *= 1 - 1e-6

    scene = patch_scene([flat_patch(-1, -1, 1, 1)])
    assert not found(scene, PLAIN)
    plant(monkeypatch, shrink)
    violations = found(scene, PLAIN)
    assert words(violations) == {"box axis 0", "box axis 2"} and {v.unit for v in violations} == {"world units"}
    assert all(v.algorithm == "cbox" and -1e-6 < v.margin < 0 for v in violations)
    assert {v.u for v in violations} | {v.v for v in violations} <= {0.0, 1.0}, "a corner sticks out most"


def eq_13_at_any_angle(stage):
    """A patch's box with the normals' range of eq. 13 of Munkberg et al. 2010, also where the cone is wider than 90 degrees."""
    bounds = BOUNDS["max_displacement" if "max_displacement" in BOUNDS else "cbox"](stage)
    for p, net in enumerate(stage.patches.control_points[..., :3].astype(float)):
        a, b = np.diff(net, axis=0).reshape(-1, 3), np.diff(net, axis=1).reshape(-1, 3)
        normals = np.cross(a[:, None], b[None]).reshape(-1, 3)
        normals = normals[np.linalg.norm(normals, axis=1) > 0]
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        cosine = normals[:, 2].min()
        sine = np.sqrt(1 - cosine**2)
        t = np.array(stage.pyramids.whole[stage.patches.map_id[p]])
        products = [np.outer(t, [-sine, sine]), np.outer(t, [-sine, sine]), np.outer(t, [cosine, 1])]
        points = net.reshape(-1, 3)
        lo = points.min(axis=0) + [x.min() for x in products] - 1e-5
        hi = points.max(axis=0) + [x.max() for x in products] + 1e-5
        bounds.center[p], bounds.axes[p] = (lo + hi) / 2, np.diag((hi - lo) / 2)
    return bounds


def arch(height, overhang):
    """A sheet bent over the y axis; its normals at the middle point up, at the ends sideways, with an overhang down."""
    middle = 0.5 + overhang
    profile = np.array([[-0.5, 0], [-middle, height], [middle, height], [0.5, 0]])
    points = np.ones((4, 4, 4))
    points[..., 0], points[..., 2] = profile[:, 0, None], profile[:, 1, None]
    points[..., 1] = np.linspace(-0.5, 0.5, 4)[None, :]
    return points


def test_equation_13_past_90_degrees(monkeypatch):
    thick = DisplacementMap(np.full((1, 1), 1.0, np.float32), scale=10.0)
    camera = looking_along_y(60.0, far=120.0)
    monkeypatch.setitem(BOUNDS, "eq13", eq_13_at_any_angle)
    machine = Machine(tile=8, bounds="eq13", cull=(), verify=True)
    fields = {"displacement": thick, "camera": camera, "factor": 16.0, "face_cull": "none"}
    assert "box axis 0" not in words(found(patch_scene([arch(0.4, -0.3)], **fields), machine)), (
        "up to 90 degrees it is right"
    )
    violations = found(patch_scene([arch(2.0, 1.0)], **fields), machine)
    assert "box axis 0" in words(violations)
    worst = min(v.margin for v in violations)
    assert worst < -0.05 and all(v.algorithm == "eq13" for v in violations)


def test_a_back_patch_cone_without_its_minus_sign(monkeypatch, load):
    """Loop et al. 2011 print v.a <= sin(alpha)."""

    def no_minus(stage, bounds, flags):
        for p, net in enumerate(stage.patches.control_points):
            points = (net[..., :3] / net[..., 3:]).astype(float)
            a, b = np.diff(points, axis=0).reshape(-1, 3), np.diff(points, axis=1).reshape(-1, 3)
            normals = np.cross(a[:, None], b[None]).reshape(-1, 3)
            normals = normals[np.linalg.norm(normals, axis=1) > 1e-9]
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            axis = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
            cosine = (normals @ axis).min()
            to_eye = stage.eye - points.reshape(-1, 3).mean(axis=0)
            if cosine > 0 and to_eye @ axis <= np.sqrt(1 - cosine**2) * np.linalg.norm(to_eye) and not flags[p]:
                flags[p] = CullFlag.FRUSTUM

    plant_cull(monkeypatch, "backface:no_minus", no_minus)
    machine = Machine(bounds="cbox", cull=("backface:no_minus",), verify=True)
    frame = tiler.simulate(load("teapot", size=(96, 64), factor=8), machine)
    assert {"culled, yet visible", "culled, yet the surface faces the eye"} == words(frame.violations)
    assert {v.algorithm for v in frame.violations} == {"backface:no_minus"}
    samples = [v for v in frame.violations if v.unit == "samples"]
    assert samples and all(v.margin <= -1 and v.margin == int(v.margin) for v in samples)


def without_footprint(stage, bounds):
    """The displacement from the texels that hold the texture coordinates; the filter reads their neighbours too."""
    maps, whole = stage.maps, stage.pyramids.whole.copy()
    (width, height), texels = maps.size[0], maps.texels
    s, t = stage.patches.texcoords[0].min(axis=0), stage.patches.texcoords[0].max(axis=0)
    i, j = np.floor(s * [width, height]).astype(int), np.ceil(t * [width, height]).astype(int)
    part = texels.reshape(height, width)[i[1] : j[1], i[0] : j[0]]
    whole[0] = part.min() * maps.scale[0] + maps.bias[0], part.max() * maps.scale[0] + maps.bias[0]
    return CBOX(stage._replace(pyramids=stage.pyramids._replace(whole=whole)))


CBOX = BOUNDS["cbox"]


def test_a_map_read_without_its_filter_footprint(monkeypatch):
    texels = np.zeros((4, 4), np.float32)
    texels[0, 0] = 1.0
    scene = patch_scene([flat_patch(-1, -1, 1, 1)], displacement=DisplacementMap(texels, "clamp"), factor=8.0)
    inner = np.array([[[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]]], np.float32)  # four texels, all zero
    scene = replace(scene, texcoords=inner)
    assert not found(scene, PLAIN)
    plant(monkeypatch, without_footprint)
    violations = found(scene, PLAIN)
    assert "box axis 1" in words(violations)
    assert min(v.margin for v in violations) == pytest.approx(-0.25, abs=0.01)
    worst = min(violations, key=lambda v: v.margin)
    assert (worst.u, worst.v) == (0.0, 0.0), "where the neighbour counts most"


def test_a_corner_behind_the_near_plane_divided(monkeypatch, floor):
    def divide(stage, bounds):
        x, y, _, w = np.moveaxis(bounds.corners, -1, 0)
        width, height = stage.viewport.width, stage.viewport.height
        x, y = (x / w + 1) * width / 2, (1 - y / w) * height / 2
        for column, values, most in ((0, x, width), (1, y, height)):
            bounds.rect[:, column] = np.clip(np.floor(values.min(axis=1)), 0, most)
            bounds.rect[:, column + 2] = np.clip(np.ceil(values.max(axis=1)), 0, most)

    assert not found(floor, PLAIN)
    plant(monkeypatch, divide)
    violations = found(floor, PLAIN)
    assert {"rectangle", "triangle's rectangle"} <= words(violations)
    assert {v.unit for v in violations if "rectangle" in v.what} == {"pixels"}


def test_slack_zero(monkeypatch):
    """A small patch far from the camera: the shader's rounding is larger than the box."""

    def no_slack(stage, bounds):
        bounds.slack[:] = 0

    key = CameraKey(0, (7.1, -1003.7, 13.3), (0.0, 0.0, 0.0))
    camera = CameraPath((key,), fov=0.001, near=500.0, far=2000.0)
    sizes = 1e-3 * 1.2 ** np.arange(16)
    scene = patch_scene([flat_patch(-size, -size, size, size) for size in sizes], camera=camera, factor=8.0)
    assert not found(scene, PLAIN)
    plant(monkeypatch, no_slack)
    violations = found(scene, PLAIN)
    assert violations and all(v.what.startswith("clip") and v.unit == "clip units" for v in violations)


def test_a_frustum_cull_with_the_sign_of_a_plane_flipped(monkeypatch, square):
    def flipped(stage, bounds, flags):
        x, _, _, w = np.moveaxis(bounds.corners, -1, 0)
        flags[(flags == 0) & (w + x > 0).all(axis=1)] = CullFlag.FRUSTUM

    plant_cull(monkeypatch, "frustum", flipped)
    frame = tiler.simulate(square, FRUSTUM)
    assert [(v.patch, v.algorithm, v.what) for v in frame.violations] == [
        (p, "frustum", "culled, yet visible") for p in range(2)
    ]
    assert all(0 <= v.u <= 1 and 0 <= v.v <= 1 and v.margin < -20 for v in frame.violations)


@pytest.mark.parametrize("side", range(4))
def test_a_rectangle_one_pixel_short(monkeypatch, square, side):
    def short(stage, bounds):
        bounds.rect[:, side] += 1 if side < 2 else -1

    plant(monkeypatch, short)
    violations = found(square, PLAIN)
    assert "rectangle" in words(violations) or "triangle's rectangle" in words(violations)
    assert all(-1 <= v.margin < 0 and v.unit == "pixels" for v in violations)


@pytest.mark.parametrize(
    ("field", "value", "what"),
    [
        ("z_min", 1.0, {"depth", "triangle's depth"}),
        ("inside", 1, {"inside flag"}),
        ("center", 0.5, {"box axis 0", "box axis 1", "box axis 2"}),
        ("corners", 99.0, {"clip x", "clip z", "clip w", "clip w + x"}),
    ],
)
def test_each_field_is_checked(monkeypatch, floor, field, value, what):
    def spoil(stage, bounds):
        array = getattr(bounds, field)
        array[:] = array + value if field in ("center", "corners") else value

    plant(monkeypatch, spoil)
    assert what <= words(found(floor, PLAIN))


def test_a_normal_cone_too_narrow(monkeypatch, load):
    def narrow(stage, bounds):
        bounds.cone_axis[:], bounds.cone_cos[:] = [0, 0, 1], 0.9

    plant(monkeypatch, narrow)
    violations = found(load("teapot", size=(40, 24), factor=4), PLAIN)
    assert words(violations) == {"normal cone"}
    assert all(-2 < v.margin < 0 and v.unit == "cosine" for v in violations)


def test_a_picture_that_lacks_a_patch(monkeypatch, square):
    """The rectangle of a patch is lost: nothing bins it, so the picture differs too."""

    def empty(stage, bounds):
        bounds.rect[0, 2:] = bounds.rect[0, :2]

    plant(monkeypatch, empty)
    violations = found(square, PLAIN)
    assert {"rectangle", "triangle's rectangle"} <= words(violations)
    (differs,) = [v for v in violations if v.what.startswith("the picture differs")]
    assert differs.patch == 0 and differs.margin < -20


def test_unknown_is_no_violation(monkeypatch, floor):
    def unknown(stage, bounds):
        bounds.center[:] = bounds.axes[:] = bounds.corners[:] = bounds.slack[:] = np.nan
        bounds.rect[:], bounds.z_min[:], bounds.inside[:] = [0, 0, 40, 24], 0, 0
        bounds.cone_axis[:], bounds.cone_cos[:] = 0, -1

    plant(monkeypatch, unknown)
    assert not found(floor, PLAIN)


# The real ones


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("name", ["teapot", "waves", "spikelog"])
def test_real_bounds_hold(load, name, bound):
    machine = Machine(bounds=bound, cull=("frustum",), verify=True)
    scene = load(name, size=(96, 54), factor=5)
    assert found(scene, machine) == ()
    assert found(sliced(scene), machine) == ()


@pytest.mark.parametrize("cull", CULL_TESTS)
@pytest.mark.parametrize("name", ["teapot", "waves"])
def test_real_culls_hold(load, name, cull):
    scene = load(name, size=(96, 54), factor=8)
    frame = tiler.simulate(scene, Machine(cull=(cull,), verify=True))
    assert frame.violations == ()
    assert cull.startswith("backface") or frame.false_culls == ()
    both_faces = tiler.simulate(replace(scene, face_cull="none"), Machine(cull=(cull,), verify=True))
    assert both_faces.violations == () and both_faces.false_culls == ()


@pytest.mark.parametrize("binning", ["triangle", "patch"])
def test_verification_changes_no_result(load, binning):
    scene = load("spikelog", size=(96, 54), factor=6, samples=4)
    one, two = (tiler.simulate(scene, Machine(binning=binning, verify=v)) for v in (False, True))
    assert np.array_equal(one.color, two.color) and np.array_equal(one.depth_samples, two.depth_samples)
    assert dict(one.counters) == dict(two.counters) and np.array_equal(one.queues.entries, two.queues.entries)
    assert one.violations == two.violations == one.false_culls == ()


def test_without_verify_nothing_is_looked_at(monkeypatch, square):
    plant(monkeypatch, lambda stage, bounds: bounds.axes.__imul__(0.5) is None)
    assert tiler.simulate(square, Machine(verify=False)).violations == ()
    assert found(square, PLAIN)


# False culls

# A bent sheet whose surface is seen from behind everywhere, while one of its two triangles at factor 1 is seen from the front.
TURNED = [
    [[-0.327, -0.632, 0.028], [-0.405, 0.029, 0.104], [-0.394, 0.088, -0.044], [-0.427, 0.652, -0.142]],
    [[-0.126, -0.322, 0.119], [-0.125, -0.243, 0.001], [-0.282, 0.278, 0.074], [-0.126, 0.51, -0.182]],
    [[0.14, -0.599, 0.226], [-0.032, -0.186, 0.209], [0.126, 0.177, 0.194], [0.077, 0.61, 0.139]],
    [[0.579, -0.394, -0.446], [0.295, -0.139, -0.017], [0.66, 0.177, -0.023], [0.531, 0.554, 0.031]],
]
TURNED_EYE = (-0.422, -0.424, -0.672)


def test_a_coarse_triangle_lost_is_a_false_cull(monkeypatch):
    cp = np.concatenate([np.array(TURNED), np.ones((4, 4, 1))], -1).astype(np.float32)

    def smooth(stage, bounds, flags):
        grid = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 21)]), -1).reshape(1, -1, 2)
        for p, net in enumerate(stage.patches.control_points):
            if verify.surface_facing(net[None], grid, stage.eye).max() < 0:
                flags[p] = CullFlag.FRUSTUM

    plant_cull(monkeypatch, "backface:smooth", smooth)
    camera = CameraPath((CameraKey(0, TURNED_EYE, (0.1, 0.1, -0.1)),), fov=100, near=0.01, far=9.0)
    scene = patch_scene([cp], size=(160, 120), factor=1.0, camera=camera, face_cull="back")
    frame = tiler.simulate(scene, Machine(cull=("backface:smooth",), verify=True))
    assert frame.violations == ()
    (lost,) = frame.false_culls
    assert (lost.patch, lost.algorithm, lost.what) == (0, "backface:smooth", "culled, yet visible")
    assert lost.margin == -tiler.simulate(scene, Machine(cull=())).counters["om_samples_visible"] < -10
    # The same test where both faces are drawn drops what is seen: no excuse then.
    frame = tiler.simulate(replace(scene, face_cull="none"), Machine(cull=("backface:smooth",), verify=True))
    assert words(frame.violations) == {"culled, yet visible"} and frame.false_culls == ()


def test_a_displaced_patch_dropped_though_it_faces_the_eye(monkeypatch):
    def all_displaced(stage, bounds, flags):
        flags[stage.patches.map_id >= 0] = CullFlag.FRUSTUM

    plant_cull(monkeypatch, "backface:all", all_displaced)
    bumps = DisplacementMap(np.array([[0.0, 0.1], [0.1, 0.0]], np.float32))
    scene = patch_scene([flat_patch(-1, -1, 1, 1)], displacement=bumps, face_cull="back")
    frame = tiler.simulate(scene, Machine(cull=("backface:all",), verify=True))
    assert "culled, yet the surface faces the eye" in words(frame.violations)


def test_a_test_that_answers_for_triangles_has_no_false_culls(monkeypatch):
    """What is a false cull of another test is a violation of one of `TRIANGLE_SAFE`."""
    name = "backface:tessellation_safe"
    cp = np.concatenate([np.array(TURNED), np.ones((4, 4, 1))], -1).astype(np.float32)
    camera = CameraPath((CameraKey(0, TURNED_EYE, (0.1, 0.1, -0.1)),), fov=100, near=0.01, far=9.0)
    scene = patch_scene([cp], size=(160, 120), factor=1.0, camera=camera, face_cull="back")
    assert found(scene, Machine(cull=(name,), verify=True)) == ()

    def all_of_them(stage, bounds, flags):
        flags[:] = CullFlag.BACKFACE

    plant_cull(monkeypatch, name, all_of_them)
    frame = tiler.simulate(scene, Machine(cull=(name,), verify=True))
    assert frame.false_culls == ()
    assert words(frame.violations) == {"culled, yet visible"}


# Its parts


def test_surface_facing_is_that_of_the_exact_surface():
    rng = np.random.default_rng(2)
    cp = np.stack([make(rng) for make in (smooth_patch, rational_patch) for _ in range(4)])
    uv, eye = rng.integers(0, 65537, (8, 20, 2)) / 65536, rng.normal(size=3) * 9
    cosines = verify.surface_facing(cp, uv, eye)
    for k in range(8):
        for i, (u, v) in enumerate(uv[k]):
            p, along_u, along_v, _ = exact_surface(cp[k].astype(float), u, v)
            n = np.cross(along_u, along_v)
            expected = (eye - p) @ n / np.linalg.norm(eye - p) / np.linalg.norm(n)
            assert cosines[k, i] == pytest.approx(expected, abs=1e-9)


def naive_margins(bounds, p, clip, world):
    """Margins of box and clip checks of a patch, by loops; float64[n, 12]."""
    rows = []
    for c, x in zip(clip.astype(float), world.astype(float), strict=True):
        row = []
        for axis in bounds.axes[p]:
            length = np.linalg.norm(axis)
            row.append(length - abs((x - bounds.center[p]) @ axis / length))
        for f in ("1000", "0100", "0010", "0001", "+001", "-001", "0+01", "0-01", "00-1"):
            q = np.array([{"0": 0, "1": 1, "+": 1, "-": -1}[s] for s in f])
            corners, slack = bounds.corners[p] @ q, bounds.slack[p] @ abs(q)
            row.append(min(c @ q - corners.min() + slack, corners.max() + slack - c @ q))
        rows.append(row)
    return np.array(rows)


def test_margins_equal_a_slow_twin():
    rng = np.random.default_rng(4)
    batch = validation.make_batch(0, 1, 5)
    stage, uv = validation.make_stage(batch), validation.attack_points(batch.domain, 30, rng)
    bounds, live = BOUNDS["cbox"](stage), np.arange(5, dtype=np.int32)
    with Host(1) as host:
        patterns = verify.point_patterns(uv)
        shaded = verify.shade_all(live, stage.patches, patterns, stage.maps, batch.camera, batch.viewport, host)
        margins = verify.measure_margins(bounds, live, shaded, batch.viewport, host)
    for p in range(5):
        rows = slice(30 * p, 30 * p + 30)
        slow = naive_margins(bounds, p, shaded.clip.clip[:, rows].T, shaded.world.clip[:3, rows].T)
        np.testing.assert_allclose(margins.margin[p, :12], slow.min(axis=0), rtol=1e-6, atol=1e-9)
        where = margins.at[p, :12]
        np.testing.assert_allclose(slow[where, np.arange(12)], slow.min(axis=0), rtol=1e-6, atol=1e-9)


def test_facing_of_displaced_and_plain_patches_agree_where_displacement_is_zero():
    rng = np.random.default_rng(6)
    cp = np.stack([smooth_patch(rng, 0.1) for _ in range(12)])
    flat = [random_map(rng)._replace(scale=0.0, bias=0.0)]
    answers = {}
    for face_cull in (FaceCull.BACK, FaceCull.FRONT):
        for map_id in (-1, 0):
            patches = make_one(cp, map_id=map_id)
            stage = make_input(
                patches, pack(flat), np.eye(4, dtype=np.float32), validation.make_batch(0, 0, 1).viewport,
                eye=np.array([1e4, 2e4, 3e5]), face_cull=face_cull,
            )  # fmt: skip
            with Host(1) as host:
                answers[face_cull, map_id] = verify.facing(stage, np.arange(12, dtype=np.int32), stage.maps, host)[0]
        difference = answers[face_cull, -1] - verify.DENSE_NOISE - answers[face_cull, 0]
        # Cells are seen a little less extremely than the points where the surface is seen best.
        assert difference.min() > -0.03 and np.median(difference) < 0.05
    assert (np.maximum(answers[FaceCull.BACK, -1], answers[FaceCull.FRONT, -1]) > -1e-6).all()


def test_a_violation_reads_well():
    violation = verify.Violation(7, 0.25, 1.0, "tpatch", "box axis 1", -0.5, "world units")
    assert str(violation) == "patch 7 at (u, v) = (0.25, 1): tpatch: box axis 1, margin -0.5 world units"
    nowhere = replace(violation, u=float("nan"), v=float("nan"))
    assert "(u, v)" not in str(nowhere) and nowhere.record()["u"] is None
    assert json.loads(json.dumps(nowhere.record()))["margin"] == -0.5


# The command line


def test_render_tells_violations(monkeypatch, tmp_path, capsys):
    from tiler.options import MachineOptions, SceneOptions

    options = {"scene_options": SceneOptions(size="48x32", factor="4"), "out": tmp_path / "out", "json": "-"}
    cli.render("teapot", machine_options=MachineOptions(verify=True), **options)
    (record,) = json.loads(capsys.readouterr().out)["frames"]
    assert record["violations"] == [] and record["false_culls"] == []
    cli.render("teapot", machine_options=MachineOptions(), **options)
    assert "violations" not in json.loads(capsys.readouterr().out)["frames"][0]
    plant(monkeypatch, lambda stage, bounds: bounds.axes.__imul__(0.9) is None)
    with pytest.raises(SystemExit) as stopped:
        cli.render("teapot", machine_options=MachineOptions(bounds="cbox", verify=True), **options)
    out, err = capsys.readouterr()
    assert stopped.value.code == 1
    assert json.loads(out)["frames"][0]["violations"][0]["algorithm"] == "cbox"
    assert "violation: frame 0, patch 0 at (u, v) = (" in err and "more of violations" in err
    with pytest.raises(SystemExit):
        cli.compare(
            "teapot", machine_options=MachineOptions(verify=True), scene_options=options["scene_options"], json="-"
        )
    machines = json.loads(capsys.readouterr().out)["machines"]
    assert all(machine["violations"] for machine in machines if machine["machine"]["bounds"] == "cbox")


def test_a_machine_as_text_may_verify():
    from tiler.options import MachineOptions, parse_machine

    assert parse_machine("verify=true,tile=16", MachineOptions()).verify
    with pytest.raises(TilerError, match=r"machine\.verify"):
        parse_machine("verify=yes", MachineOptions())


# validate


def test_validate_bounds_finds_nothing_in_the_real_ones(capsys):
    result = validation.validate_bounds(700_000, seed=5, names=["cbox"], scenes=["teapot"], threads=1)
    assert result["failed"] == 0 and result["what"] == "bounds"
    assert [row["algorithm"] for row in result["details"]] == ["cbox", *CULL_TESTS]
    assert result["details"][0]["samples"] >= 700_000
    assert all(row["samples"] > 500_000 and row["cases"] > 500 for row in result["details"])
    json.dumps(result)


def test_validate_bounds_finds_planted_faults(monkeypatch, capsys):
    def shrink(stage, bounds):
        bounds.axes[:] *= 1 - 1e-6

    plant(monkeypatch, shrink)
    result = validation.validate_bounds(600_000, seed=3, names=["cbox"], scenes=[], threads=1)
    violation = result["details"][0]["violations"][0]
    assert result["failed"] > 0 and violation["what"].startswith("box axis")
    assert np.array(violation["control_points"]).shape == (4, 4, 4)
    batch = validation.make_batch(violation["seed"], violation["batch"])
    np.testing.assert_array_equal(batch.control_points[violation["patch"]], violation["control_points"])
    monkeypatch.setattr("tiler.validation.bounds.scene_names", list)
    with pytest.raises(SystemExit) as stopped:
        cli.validate("bounds", samples=200_000, bounds="cbox", json="-")
    assert stopped.value.code == 1
    assert json.loads(capsys.readouterr().out).keys() >= {"what", "cases", "failed", "details"}


def failures(batches, cull):
    """Violations of a cull test over some random batches."""
    with Host(1) as host:
        campaign = validation.Campaign(["cbox"], 0, host)
        for number in batches:
            campaign.random_batch(number)
    return campaign.culls[cull].failed, {v["what"] for v in campaign.culls[cull].violations}


# Batches of the families "smooth noise" and "smooth constant".
NOISE, CONSTANT = ([family + k * len(validation.FAMILIES) for k in range(n)] for family, n in ((1, 5), (4, 3)))


def test_slopes_of_nothing_are_found(monkeypatch):
    """The bound of the displaced normal without the map's slope: by the surface, and by triangles at the batch's factors."""
    assert failures(NOISE, "backface:displaced") == failures(NOISE, "backface:tessellation_safe") == (0, set())

    def flat(maps):
        return build_slopes(maps._replace(texels=np.zeros_like(maps.texels)))

    monkeypatch.setattr("pipeline.culling.displaced.build_slopes", flat)
    failed, what = failures(NOISE, "backface:displaced")
    assert failed > 5 and "culled, yet the surface faces the eye" in what
    failed, what = failures(NOISE, "backface:tessellation_safe")
    assert failed > 5 and what


def test_an_offset_past_the_centre_of_curvature_is_found(monkeypatch):
    """The same batches, displaced by several times their size."""

    def far_out(*arguments):
        batch = validation.make_batch(*arguments)
        return batch._replace(maps=[(*m[:3], m[3] + 5.0 * (-1) ** k) for k, m in enumerate(batch.maps)])

    monkeypatch.setattr("tiler.validation.campaign.make_batch", far_out)
    assert failures(CONSTANT, "backface:ncone") == failures(CONSTANT, "backface:tcone") == (0, set())

    def any_offset(stage, numbers):
        return Offsets(np.ones(len(numbers), bool), stage.pyramids.whole[stage.patches.map_id[numbers]])

    monkeypatch.setattr("pipeline.culling.apex.constant_offsets", any_offset)
    for name in ("backface:ncone", "backface:tcone"):
        failed, what = failures(CONSTANT, name)
        assert failed > 0 and what == {"culled, yet the surface faces the eye"}


def test_the_adversary_gets_closer_than_chance(monkeypatch):
    """A box too small by less than what random points show: the climb finds it."""

    def closest(rounds):
        monkeypatch.setattr("tiler.validation.campaign.CLIMB_ROUNDS", rounds)
        with Host(1) as host:
            campaign = validation.Campaign(["cbox"], 11, host)
            campaign.adversarial_batch(16)
            return campaign.bounds["cbox"].closest

    assert closest(40) < closest(1)


def test_batches_repeat_themselves_and_differ():
    one, two = validation.make_batch(3, 9, 8), validation.make_batch(3, 9, 8)
    np.testing.assert_array_equal(one.control_points, two.control_points)
    assert not np.array_equal(one.control_points, validation.make_batch(4, 9, 8).control_points)
    assert len({validation.make_batch(0, k, 4).name for k in range(len(validation.FAMILIES))}) == len(
        validation.FAMILIES
    )


def test_attack_points_are_domain_points():
    rng = np.random.default_rng(0)
    domain = np.array([[0, 1, 0, 1], [0.25, 0.5, 0.75, 0.75], [3 / 65536, 4 / 65536, 0, 1]])
    uv = validation.attack_points(domain, 200, rng).astype(float)
    assert (uv * 65536 == np.rint(uv * 65536)).all()
    for p, (u0, u1, v0, v1) in enumerate(domain):
        assert (uv[0, p] >= u0).all() and (uv[0, p] <= u1).all() and (uv[1, p] >= v0).all() and (uv[1, p] <= v1).all()
        assert {(u, v) for u, v in uv[:, p].T} >= {(u, v) for u in (u0, u1) for v in (v0, v1)}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"samples": 0}, "samples: 0"),
        ({"samples": 9, "names": ["cbx"]}, "did you mean 'cbox'"),
        ({"samples": 9, "seed": -1}, "seed: -1"),
    ],
)
def test_validate_refuses_bad_input(arguments, said):
    with pytest.raises(TilerError, match=said):
        validation.validate_bounds(**arguments)


def test_an_interrupt_ends_the_validation():
    def interrupt(samples):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        validation.validate_bounds(10**9, names=["cbox"], scenes=[], threads=2, progress=interrupt)


def test_validate_tessellator(tmp_path, capsys):
    path = shared_file("data", "tessellator_reference.npz")
    with np.load(path) as file:
        arrays = dict(file)
    few = {name: a[:40] if len(a) == len(arrays["domain"]) else a for name, a in arrays.items()}
    few["point_offset"], few["index_offset"] = arrays["point_offset"][:41], arrays["index_offset"][:41]
    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    np.savez(good, **few)
    points = few["points"].copy()
    points[few["point_offset"][7]] += 1 / 65536
    np.savez(bad, **(few | {"points": points}))
    cli.validate("tessellator", reference=good, json="-")
    assert json.loads(capsys.readouterr().out) == {"what": "tessellator", "cases": 40, "failed": 0, "details": []}
    with pytest.raises(SystemExit) as stopped:
        cli.validate("tessellator", reference=bad, json="-")
    result = json.loads(capsys.readouterr().out)
    assert stopped.value.code == 1 and result["failed"] == 1
    assert result["details"][0]["case"] == 7 and result["details"][0]["wrong"] == ["points"]


def test_a_file_that_is_no_reference_is_named(tmp_path):
    np.savez(tmp_path / "other.npz", domain=np.zeros(3))
    (tmp_path / "text.npz").write_text("hello")
    for name in ("other.npz", "text.npz", "missing.npz"):
        with pytest.raises(TilerError, match=name):
            validation.validate_tessellator(Path(tmp_path, name))
    with pytest.raises(TilerError, match="reference: missing"):
        cli.validate("tessellator")


def test_a_camera_is_right_handed():
    """So that what faces the eye is what the rasterizer draws."""
    for k in range(6):
        camera: Camera = validation.make_batch(1, k, 4).camera
        assert np.linalg.det(camera.clip_from_world[[0, 1, 3], :3].astype(float)) < 0
