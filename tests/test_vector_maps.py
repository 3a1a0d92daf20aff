"""Displacement by vectors: the shader bit for bit its slow twin, every bound round what it gives, no back-patch test."""

import numpy as np
import pytest

from pipeline import hull
from pipeline.bounds import BOUNDS
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.refine import gather_parts
from pipeline.culling import CLASSIFIERS, classify
from pipeline.culling.backface import Facing
from pipeline.displacement import map_ranges, pack_maps, vector_lengths
from pipeline.subdivision.surface import Basis
from pipeline.types import Address, Viewport
from pipeline.vertex import make_patches
from tests.cages import read_model
from tests.naive_domain import NaiveMap, naive_shade_patch
from tests.test_domain import bits, random_matrix, random_points
from tests.test_surface_patches import patches_of
from tiler import front_end, verify
from tiler.host import Host
from tiler.scene.camera import Camera
from tiler.validation import FAMILIES, Campaign, make_batch, make_stage

VECTORS = [k for k, (_, kind, _) in enumerate(FAMILIES) if kind == "vectors"]
VIEWPORT = Viewport(0, 0, 64, 48, 0.0, 1.0)


def vectors(seed=3, size=(12, 9), scale=0.3, bias=0.05):
    rng = np.random.default_rng(seed)
    return NaiveMap(rng.normal(0, 1, (*size, 3)).astype(np.float32), "wrap", scale, bias)


def pack(image, turn=None):
    maps = pack_maps([(image.texels, Address[image.address.upper()], image.scale, image.bias)])
    if turn is not None:
        maps.turn[0] = turn
    return maps


def shade(patches, uv, maps, matrix):
    """Clip (P, m, 4) and normals (P, m, 3) at uv float32[P, m, 2]."""
    patterns = verify.point_patterns(np.ascontiguousarray(uv.transpose(2, 0, 1)))
    with Host(1) as host:
        points = front_end.shade_domain_points(
            np.arange(len(uv), dtype=np.int32), patches, patterns, maps, Camera(matrix, None, 0.0, 0.0), host
        )
    return tuple(a.T.reshape(*uv.shape[:2], -1) for a in (points.clip, points.normal))


def sheets(n, seed=1):
    rng = np.random.default_rng(seed)
    cp = np.ones((n, 4, 4, 4), np.float32)
    cp[..., :2] = np.stack(np.meshgrid(range(4), range(4), indexing="ij"), -1) / 3
    cp[..., :3] += rng.normal(0, 0.1, (n, 4, 4, 3))
    texcoords = rng.uniform(-1, 2, (n, 4, 2)).astype(np.float32)
    return make_patches(cp, texcoords, np.zeros(n, np.int32), np.zeros(n, np.int32))


@pytest.mark.parametrize("kind", ["bezier", "acc", "gregory"])
def test_equals_twin(kind):
    rng = np.random.default_rng(5)
    if kind == "bezier":
        patches = sheets(8)
    else:
        patches = patches_of(*read_model("subdbox"), Basis[kind.upper()]).take(np.arange(0, 90, 11))
    image, matrix, turn = vectors(), random_matrix(rng), rng.normal(size=(3, 3)).astype(np.float32)
    uv = np.stack([random_points(rng, 24) for _ in patches.map_id])
    uv[:, :4] = [(0, 0), (1, 0), (0, 1), (1, 1)]
    clip, normal = shade(patches, uv, pack(image, turn), matrix)
    for p, i in np.ndindex(*uv.shape[:2]):
        expected = naive_shade_patch(patches, p, image, matrix, *uv[p, i], turn)
        np.testing.assert_array_equal(bits(clip[p, i]), bits(expected[0]), f"patch {p} at {uv[p, i]}")
        np.testing.assert_array_equal(bits(normal[p, i]), bits(expected[1]), f"patch {p} at {uv[p, i]}")


def test_normals_are_those_of_the_displaced_surface():
    """Against differences of shaded positions, within one texel."""
    image = vectors(size=(3, 3), scale=0.2)
    patches = sheets(4)
    patches = patches._replace(
        texcoords=(0.53 + 0.1 * np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32))[None].repeat(4, 0)
    )
    uv = np.random.default_rng(2).integers(40, 216, (4, 20, 2)).astype(np.float32) / 256
    step = np.float32(2.0**-7)
    maps, eye = pack(image), np.eye(4, dtype=np.float32)
    around = [
        shade(patches, uv + step * np.array(d, np.float32), maps, eye)[0][..., :3].astype(np.float64)
        for d in [(1, 0), (-1, 0), (0, 1), (0, -1)]
    ]
    expected = np.cross(around[0] - around[1], around[2] - around[3])
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    # Third derivatives (about 10 for a patch of size 1) times step^2, rounding over the step.
    assert abs(shade(patches, uv, maps, eye)[1] - expected).max() < 10 * step**2 + 2.0**-20 / step


def test_three_equal_maps_of_one_component_move_along_an_axis():
    """A map with two components of zero moves points along one axis by what the scalar map says."""
    patches, uv = sheets(5), np.random.default_rng(3).random((5, 30, 2)).astype(np.float32)
    texels = vectors().texels.copy()
    texels[..., [0, 2]] = 0
    maps = pack_maps([(texels, Address.WRAP, 0.25, 0.0)])
    scalar = pack_maps([(np.ascontiguousarray(texels[..., 1]), Address.WRAP, 0.25, 0.0)])
    flat = patches._replace(map_id=np.full(5, -1, np.int32))
    eye = np.eye(4, dtype=np.float32)
    moved, base = (shade(some, uv, maps, eye)[0] for some in (patches, flat))
    np.testing.assert_array_equal(moved[..., [0, 2, 3]], base[..., [0, 2, 3]])
    along = np.linalg.norm((shade(patches, uv, scalar, eye)[0] - base)[..., :3], axis=-1)
    np.testing.assert_allclose(abs(moved - base)[..., 1], along, atol=2.0**-22)


def violations(stage, bounds, uv):
    with Host(1) as host:
        live, patterns = (
            np.arange(len(uv), dtype=np.int32),
            verify.point_patterns(np.ascontiguousarray(uv.transpose(2, 0, 1))),
        )
        camera = Camera(stage.clip_from_world, None, 0.0, 0.0)
        shaded = verify.shade_all(live, stage.patches, patterns, stage.maps, camera, VIEWPORT, host)
        margins = verify.measure_margins(bounds, live, shaded, VIEWPORT, host)
    return verify.name_violations("it", margins, live, patterns)


def make(turn=None, domain=None):
    patches, matrix = sheets(24), np.eye(4, dtype=np.float32)
    matrix[3, 3] = 4  # w = 4 everywhere
    return hull.make_input(patches, pack(vectors(), turn), matrix, VIEWPORT, domain=domain)


@pytest.mark.parametrize("name", BOUNDS)
def test_bounds_hold_and_a_planted_fault_is_found(name):
    rng = np.random.default_rng(8)
    turn = rng.normal(size=(3, 3)).astype(np.float32)
    uv = np.stack([random_points(rng, 400) for _ in range(24)])
    stage = make(turn)
    stage = stage._replace(pyramids=stage.pyramids._replace(whole=vector_lengths(stage.maps, stage.pyramids.whole)))
    assert violations(stage, BOUNDS[name](stage), uv) == []
    wrong = make(np.zeros((3, 3), np.float32))  # as if the vectors were forgotten
    assert len(violations(stage, BOUNDS[name](wrong), uv)) > 24


@pytest.mark.parametrize("name", [name for name in BOUNDS if name != "cbox"])
def test_parts_are_bounded_tighter_and_by_components(name):
    domain = np.tile([0.25, 0.375, 0.5, 0.625], (24, 1))
    rng = np.random.default_rng(9)
    whole, part = make(), make(domain=domain)
    uv = (domain[:, None, [0, 2]] + 0.125 * rng.random((24, 400, 2))).astype(np.float32)
    bounds = BOUNDS[name](part)
    assert violations(part, bounds, uv) == []
    volume, large = (np.prod(np.linalg.norm(b.axes, axis=2), axis=1).sum() for b in (bounds, BOUNDS[name](whole)))
    assert volume < 0.5 * large
    if name != "max_displacement":  # by length instead
        by_length = np.prod(np.linalg.norm(BOUNDS["max_displacement"](part).axes, axis=2), axis=1).sum()
        assert volume < 0.8 * by_length


def test_length_is_that_of_the_longest_vector():
    image = NaiveMap(np.array([[[3, 0, 0], [0, 4, 0]]], np.float32), "clamp", 1.0, 0.0)
    turn = np.array([[1, 0, 0], [0, 0, 2], [0, 2, 0]], np.float32)
    maps = pack(image, turn)
    np.testing.assert_allclose(map_ranges(maps)[0], [-np.sqrt(9 + 64), np.sqrt(9 + 64)], rtol=1e-5)
    maps.texels[-1] = np.nan
    assert np.isnan(map_ranges(maps)[0]).all()
    stage = make()
    assert (
        displacement_ranges(stage)[1] >= displacement_ranges(make(domain=np.tile([0.2, 0.3, 0.2, 0.3], (24, 1))))[1]
    ).all()


def test_broken_maps_are_flagged():
    stage = make()
    stage.maps.texels[-3] = np.inf
    flags = hull.flag_nonfinite(stage.patches, map_ranges(stage.maps))
    assert flags.all()


def test_parts_keep_their_vectors():
    """Refinement drops maps where they add nothing; a map of vectors is not looked at as if it were a scalar one."""
    stage = make()
    parts = gather_parts(stage, np.arange(24, dtype=np.int32), stage.domain)
    assert (parts.patches.map_id == 0).all()


@pytest.mark.parametrize("name", CLASSIFIERS)
def test_back_patch_tests_answer_for_none(name):
    stage = make()._replace(eye=np.array([0.5, 0.5, 50.0]))
    assert (classify(stage, name) == Facing.SILHOUETTE).all()


@pytest.mark.parametrize("number", VECTORS)
def test_validation_has_families_of_vectors(number):
    batch = make_batch(4, number, 8)
    assert (make_stage(batch).maps.planes[:8, 0] >= 0).all()
    with Host(1) as host:
        campaign = Campaign(["cbox", "obbtex", "tpatch", "taylor"], 4, host)
        campaign.random_batch(number)
        assert [tally.failed for tally in (*campaign.bounds.values(), *campaign.culls.values())] == [0] * (
            4 + len(campaign.culls)
        )
        assert all(tally.samples > 0 for tally in campaign.bounds.values())
