"""Bounds and culls on subdivision surfaces, displaced ones too: against the production shader, and with faults planted."""

from dataclasses import replace

import numpy as np
import pytest

import tiler
from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.bounds.normals import NPATCH, bound_normals
from pipeline.culling import CULL_TESTS, classify
from pipeline.culling.backface import MOST_SLACK
from pipeline.jit import kernel
from pipeline.subdivision import control_points, normal_slack
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.types import FaceCull
from tests.cages import BOX_FACES, BOX_POINTS, cage_of_faces, read_model
from tests.scenes import looking_along_y, patch_scene
from tests.test_bounds import VIEWPORT
from tests.test_domain import IDENTITY, pack, shade
from tests.test_surface_patches import bumps, patches_of
from tiler import validation
from tiler.host import Host
from tiler.scene.model import CameraKey, CameraPath, DisplacementMap, Picture, SceneMesh
from tiler.validation.attack import mutate, take
from tiler.validation.surfaces import MESHES, NETS

by_basis = pytest.mark.parametrize("basis", list(Basis), ids=lambda b: b.name.lower())
ON_NORMALS = ("tpatch", "tpatch_tight", "npatch", "taylor", "taylor_clamped")
NEW = [k for k, (shape, _, _) in enumerate(validation.FAMILIES) if shape in MESHES or shape.split()[-1] in NETS]
RIM = [(4, 5), (5, 7), (7, 6), (6, 4)]


def creased_box():
    """A cube with a crease around one face: on it the shared normal is between those of both sides."""
    return BOX_POINTS, cage_of_faces(BOX_FACES, 8, creases=RIM, sharpness=[10.0] * 4)


def mesh_scene(points, cage, basis=Basis.ACC, scale=0.0, bias=0.0, factor=4.0, eye=(0.0, -5.0, 0.0)):
    """A control mesh, displaced unless scale and bias are 0."""
    texels = np.random.default_rng(2).normal(0, 1, (16, 16)).astype(np.float32)
    surface, _ = make_surface(cage, basis)
    displaced = scale != 0.0 or bias != 0.0
    middle, size = (points.min(axis=0) + points.max(axis=0)) / 2, float(np.ptp(points, axis=0).max())
    camera = looking_along_y()
    key = CameraKey(0, tuple(map(float, middle + np.array(eye) * size / 2)), tuple(map(float, middle)))
    camera = CameraPath((key,), camera.up, 40.0, 0.1 * size, 10.0 * size)
    return replace(
        patch_scene([], camera=camera, factor=factor, face_cull="back"),
        meshes=(SceneMesh(surface, points, 0, 0 if displaced else -1),),
        maps=(DisplacementMap(texels, scale=scale * size, bias=bias * size),) if displaced else (),
        picture=Picture(96, 64, samples=1, shading="patch"),
    )


def violations(scene, **machine):
    return tiler.simulate(scene, tiler.Machine(verify=True, **machine), threads=1).violations


# Real and random


@pytest.mark.parametrize("number", NEW, ids=lambda k: validation.make_batch(0, k, 1).name)
def test_nothing_escapes(number, monkeypatch):
    """Every bound and every cull test against the float32 shader, on each new family of `tiler validate bounds`."""
    monkeypatch.setattr("tiler.validation.campaign.POINTS", 96)
    with Host(1) as host:
        campaign = validation.Campaign(list(BOUNDS), 1, host)
        campaign.random_batch(number)
    tallies = [*campaign.bounds.values(), *campaign.culls.values()]
    assert [t.violations for t in tallies if t.failed] == []
    assert all(t.samples >= 96 * 200 for t in tallies)


def test_the_adversary_moves_tangents_and_inner_points(monkeypatch):
    monkeypatch.setattr("tiler.validation.campaign.CLIMB_ROUNDS", 6)
    for name, table in (("smooth ACC noise", "tangent_u"), ("smooth Gregory noise", "inner")):
        number = next(k for k in NEW if validation.make_batch(0, k, 1).name == name)
        batch = validation.make_batch(0, number, 8)
        changed = mutate(batch, np.random.default_rng(1))
        assert (getattr(changed.patches, table) != getattr(batch.patches, table)).any()
        taken = take(batch, changed, [3])
        differ = (getattr(taken.patches, table) != getattr(batch.patches, table)).any(axis=(1, 2, 3))
        assert np.flatnonzero(differ).tolist() == [3]
        with Host(1) as host:
            campaign = validation.Campaign(list(BOUNDS), 2, host)
            campaign.adversarial_batch(number)
        assert not any(t.failed for t in campaign.bounds.values())
    mesh = validation.make_batch(0, next(k for k in NEW if "mesh noise" in validation.make_batch(0, k, 1).name), 8)
    kept = mutate(mesh, np.random.default_rng(1))
    np.testing.assert_array_equal(kept.control_points, mesh.control_points)
    assert any((a[0] != b[0]).any() for a, b in zip(kept.maps, mesh.maps, strict=True))


@by_basis
@pytest.mark.parametrize("scale", [0.0, 0.02, -0.2])
def test_verified_frames_of_a_creased_box(basis, scale):
    scene = mesh_scene(*creased_box(), basis, scale=scale, eye=(1.5, -2.5, 3.0))
    for bound in BOUNDS:
        assert not violations(scene, bounds=bound, cull=("frustum",))
    for cull in CULL_TESTS:
        assert not violations(scene, bounds="tpatch", cull=(cull,))


@pytest.mark.parametrize("scale", [0.0, 0.01])
@pytest.mark.parametrize("name", ["bigguy", "monsterfrog"])
def test_verified_frames_of_models(name, scale):
    scene = mesh_scene(*read_model(name), scale=scale, factor=2.0, eye=(1.0, 0.7, 2.2))
    for bound in BOUNDS:
        assert not violations(scene, bounds=bound, cull=("frustum", "backface:displaced"))


@pytest.mark.parametrize("scale", [0.0, 0.003])
def test_culls_of_meshes_do_cull(scale):
    scene = mesh_scene(*read_model("bigguy"), scale=scale, factor=8.0, eye=(1.0, 0.7, 2.2))
    machine = tiler.Machine(cull=("backface:tessellation_safe",), verify=True)
    frame = tiler.simulate(scene, machine, threads=1)
    assert not frame.violations and not frame.false_culls
    assert frame.counters["hs_culled_backface"] > (250 if scale == 0.0 else 100)


# Normals that patches share


def stage_of(patches, maps=(), domains=None):
    return hull.make_input(patches, pack(list(maps)), IDENTITY, VIEWPORT, domain=domains)


@by_basis
def test_bounds_of_normals_are_wider_by_the_slack_on_edges_only(basis):
    patches = patches_of(*creased_box(), basis)
    n = len(patches.map_id)
    rows = np.repeat(np.arange(n), 4)
    domains = np.tile([[0, 1, 0, 1], [0.25, 0.5, 0.5, 0.75], [0, 0.5, 0.25, 0.5], [0.5, 0.75, 0.5, 1]], (n, 1))
    many = patches.take(rows)
    stage = stage_of(many, [bumps()], domains)
    wide = bound_normals(stage, NPATCH)[1][:, : 4 * n]
    alone = many._replace(normal_slack=np.zeros(4 * n, np.float32))
    own = bound_normals(stage._replace(patches=alone), NPATCH)[1][:, : 4 * n]
    s = many.normal_slack.astype(np.float64)
    assert (s > 0.1).any() and (s < 1e-4).any()
    s = np.where(np.arange(4 * n) % 4 == 1, 0.0, s)
    np.testing.assert_array_equal(wide[:2], np.minimum(own[:2] + s, 1.0))
    np.testing.assert_array_equal(wide[2], np.where(s > 0, np.maximum(own[2] - s, -1.0), own[2]))
    angle = np.arccos(own[3]) + 2 * np.arcsin(np.minimum(s / 2, 1))
    known = (own[3] > -1) & (angle < np.pi / 2 - 1e-6)
    np.testing.assert_allclose(wide[3, known], np.cos(angle[known]), atol=1e-9)
    assert (wide[3, (angle > np.pi / 2)] == -1).all() and (s == 0).any()


@pytest.mark.parametrize("name", ["bigguy", "monsterfrog", "animated_head"])
@by_basis
def test_slack_of_models_is_small(basis, name):
    """Halving the edges leaves no patch of which nothing is known."""
    slack = patches_of(*read_model(name), basis).normal_slack
    assert slack.max() < 2.0**-11 and np.median(slack) < 2e-5


@kernel
def _slack_one_by_one(
    layer, sharing, basis, first, irregular, edge_base, corner_base, nets, out, edge_normals, corner_normals, slack
):
    pieces = np.empty((3, control_points.SLACK_LEVELS + 1, 6, 3))
    for m in range(len(layer.quad)):
        value = control_points._patch_slack(
            layer, sharing, basis, m, irregular, edge_base, corner_base, out.control_points[first + m], nets, out,
            edge_normals, corner_normals, pieces,
        )  # fmt: skip
        irregular += layer.regular[m] == 0
        slack[first + m] = np.float32(value * (1.0 + 4.0 * control_points.U))


@pytest.mark.parametrize("name", ["bigguy", "animated_head", "box"])
@by_basis
def test_slack_of_patches_side_by_side_is_that_of_one_after_the_other(basis, name, monkeypatch):
    """Bit for bit, also where creases leave edges to the halving of curves."""
    mesh = creased_box() if name == "box" else read_model(name)
    slack = patches_of(*mesh, basis).normal_slack
    monkeypatch.setattr(control_points, "_fill_slack", _slack_one_by_one)
    np.testing.assert_array_equal(slack, patches_of(*mesh, basis).normal_slack)
    assert (slack > normal_slack.FINE_SLACK).any() == (name == "box") and (slack > 0).all()


def test_unit_normals_of_edges_are_as_long_as_any():
    """`cbox` and `obbtex` count on |n| <= 1 + 4 u: by the shader's displaced points, displaced by 1 exactly."""
    patches = patches_of(*read_model("subdbox"), Basis.ACC)
    edge = [np.array([(0, t), (1, t), (t, 0), (t, 1)], np.float32) for t in (0.0, 0.3, 0.5, 0.91, 1.0)]
    uv = [np.concatenate(edge)] * len(patches.map_id)
    constant = bumps()._replace(texels=np.zeros((1, 1), np.float32), scale=0.0, bias=1.0)
    at_rest, _ = shade(patches._replace(map_id=np.full_like(patches.map_id, -1)), uv)
    moved, _ = shade(patches, uv, [constant])
    way = np.concatenate(moved)[:, :3].astype(np.float64) - np.concatenate(at_rest)[:, :3]
    size = abs(np.concatenate(at_rest)).max()
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), 1.0, rtol=0, atol=4 * 2.0**-24 * (2 + size))


def test_the_slack_of_opposite_normals_is_all_there_is():
    """A patch whose edge's normal points the other way: no multiple of one is close to the other."""
    points, cage = BOX_POINTS.copy(), cage_of_faces([BOX_FACES[0], BOX_FACES[2]], 8, creases=[(0, 1)], sharpness=[10.0])
    points[4:6] = points[2:4] + [0, 0, 0.05]  # two sheets, folded onto each other; one is much larger
    points[2:4] += np.float32(30.0) * (points[2:4] - points[:2])
    slack = patches_of(points, cage, Basis.ACC).normal_slack
    assert slack.max() > 0.5


def test_culls_refuse_patches_with_large_slack():
    """A displaced patch that is one net, but shares the normals of a crease, is no single surface up to its edge."""
    points, cage = read_model("osd_torus")
    patches = patches_of(points, cage, Basis.ACC)
    assert (patches.tangent_id < 0).all() and patches.normal_slack.max() < MOST_SLACK
    flat = [bumps(scale=0.0)._replace(bias=0.01)]
    eye = np.array([2.0, 3.0, 9.0])
    tests = [name for name in CULL_TESTS if name.startswith("backface")]

    def known(patches):
        stage = stage_of(patches, flat)._replace(eye=eye, face_cull=int(FaceCull.BACK))
        return {name: int((classify(stage, name) != 0).sum()) for name in tests}

    assert known(patches)["backface:displaced"] > 5
    torn = patches._replace(normal_slack=np.full_like(patches.normal_slack, 2 * MOST_SLACK))
    assert not any(known(torn).values())


# Planted faults


def plant(monkeypatch, change):
    """Bounds that see other patches than the shader: `change(patches)` of each."""
    for name, real in list(BOUNDS.items()):
        monkeypatch.setitem(BOUNDS, name, lambda stage, real=real: real(stage._replace(patches=change(stage.patches))))


def failures(names, monkeypatch):
    """Which bounds fail on these families."""
    monkeypatch.setattr("tiler.validation.campaign.POINTS", 96)
    with Host(1) as host:
        campaign = validation.Campaign(list(BOUNDS), 1, host)
        for number, (shape, kind, place) in enumerate(validation.FAMILIES):
            if " ".join(filter(None, (shape, kind, place))) in names:
                campaign.random_batch(number)
    return {name for name, tally in campaign.bounds.items() if tally.failed}


def drop_slack(patches):
    return patches._replace(normal_slack=np.zeros_like(patches.normal_slack))


def use_derivatives(patches):
    return patches._replace(tangent_id=np.full_like(patches.tangent_id, -1))


def drop_inner(patches):
    return patches._replace(gregory_id=np.full_like(patches.gregory_id, -1))


def test_normal_slack_dropped(monkeypatch):
    scene = mesh_scene(*creased_box(), bias=0.5, factor=8.0)
    before = {name: violations(scene, bounds=name, cull=()) for name in ON_NORMALS}
    assert not any(before.values())
    plant(monkeypatch, drop_slack)
    for name in ON_NORMALS:
        named = violations(scene, bounds=name, cull=())
        assert any(v.what.startswith("box axis") and {v.u, v.v} & {0.0, 1.0} for v in named), name
    assert failures(["ACC mesh noise"], monkeypatch) >= {"npatch", "taylor_clamped"}


def test_tangent_patches_replaced_by_derivatives(monkeypatch):
    assert not failures(["smooth ACC noise"], monkeypatch)
    plant(monkeypatch, use_derivatives)
    assert failures(["smooth ACC noise"], monkeypatch) == set(ON_NORMALS)


def test_the_reach_of_gregory_points_dropped(monkeypatch):
    names = ["smooth Gregory plain", "smooth Gregory noise"]
    assert not failures(names, monkeypatch)
    plant(monkeypatch, drop_inner)
    assert failures(names, monkeypatch) == set(BOUNDS)


def test_the_widening_stands_in_one_place(monkeypatch):
    """Without it the bounds of normals are those of the patches' own tangents."""
    scene = mesh_scene(*creased_box(), bias=0.5, factor=8.0)
    monkeypatch.setattr("pipeline.bounds.normals.widen_normals", lambda stage, out: None)
    assert violations(scene, bounds="npatch", cull=())
