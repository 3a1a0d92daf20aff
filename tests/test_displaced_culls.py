"""Back-patch culls of displaced patches: the boxes of their chords, and every triangle that such a test lets drop."""

import time
from dataclasses import replace

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from pipeline.bounds.lookup import displacement_ranges
from pipeline.culling import CLASSIFIERS, apex, classify, control_planes, ncone, tcone, tessellation_safe
from pipeline.culling.backface import Facing
from pipeline.culling.chords import bound_part, make_scratch, measure_differences, place_patch
from pipeline.culling.offset import Offsets, constant_offsets, no_offsets
from pipeline.culling.part_displacement import PLACE, find_displacement, find_footprints, place_map, read_footprints
from pipeline.jit import kernel
from pipeline.minmax import build_pyramids
from pipeline.slopes import build_slopes, query_slopes
from pipeline.types import FaceCull, Partitioning, TessFactors, Viewport
from pipeline.wide import LANES, choose, store
from tests.naive_domain import NaiveMap
from tests.test_backface import bigguy, bigguy_view, cull, gentle, view_of
from tests.test_domain import make_one, pack, rational_patch, smooth_patch
from tiler import front_end, verify
from tiler.bench.scenes import torus
from tiler.bench.stages import hull_stage
from tiler.config import Machine
from tiler.host import Host

SAFE, SURFACE = "backface:tessellation_safe", "backface:displaced"
CONES = ("backface:ncone", "backface:tcone")
by_seed = pytest.mark.parametrize("seed", range(3), ids=lambda s: f"seed{s}")
CORNERS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)


def ripples(rng, height, address="wrap"):
    """A map of up to 24 x 24 texels, smooth or rough, of about this height."""
    h, w = rng.integers(1, 25, 2)
    texels = rng.normal(0, 1, (h, w))
    if rng.random() < 0.5:
        texels = np.cumsum(texels, axis=1) / np.sqrt(w)
    return NaiveMap(texels.astype(np.float32), address, height, float(rng.normal() * height * rng.integers(0, 2)))


def bumpy(rng, n, height=0.01, bumps=0.06):
    """n displaced patches, each with its map and a texture rectangle of its own, some folded over."""
    patches = gentle(rng, n, bumps=bumps)
    maps = [
        ripples(rng, height * 10 ** rng.uniform(-1, 0.5), rng.choice(["wrap", "mirror", "clamp"])) for _ in range(n)
    ]
    texcoords = CORNERS * rng.uniform(0.2, 2, (n, 1, 1)) + rng.normal(0, 0.1, (n, 4, 2)) + rng.uniform(-1, 1, (n, 1, 2))
    return patches._replace(texcoords=texcoords.astype(np.float32), map_id=np.arange(n, dtype=np.int32)), maps


# Slopes


def naive_slopes(image, s0, s1, t0, t1):
    """Differences of all pairs of texels that lookups in the rectangle blend, by counting texels, along s and along t."""
    h, w = image.texels.shape

    def texel(i, n):
        if image.address == "wrap":
            return i % n
        if image.address == "mirror":
            i %= 2 * n
            return i if i < n else 2 * n - 1 - i
        return min(max(i, 0), n - 1)

    columns = range(int(np.floor(s0 * w - 0.5)), int(np.floor(s1 * w - 0.5)) + 1)
    rows = range(int(np.floor(t0 * h - 0.5)), int(np.floor(t1 * h - 0.5)) + 1)
    at = lambda i, j: float(image.texels[texel(j, h), texel(i, w)])  # noqa: E731
    along_s = [at(i + 1, j) - at(i, j) for i in columns for j in (*rows, rows[-1] + 1)]
    along_t = [at(i, j + 1) - at(i, j) for j in rows for i in (*columns, columns[-1] + 1)]
    return np.array([[min(along_s), max(along_s)], [min(along_t), max(along_t)]])


@by_seed
@pytest.mark.parametrize("address", ["wrap", "mirror", "clamp"])
def test_slopes_hold_those_of_a_slow_twin(seed, address):
    rng = np.random.default_rng(seed)
    maps = [ripples(rng, 1.0, address) for _ in range(12)]
    packed = pack(maps)
    slopes = build_slopes(packed)
    loose = []
    for k in range(400):
        m = k % 12
        s0, t0 = rng.uniform(-1.5, 2, 2)
        s1, t1 = np.array([s0, t0]) + rng.choice([0.0, 0.05, 0.4, 1.5], 2)
        ((a, b),) = (query_slopes(packed, slopes, np.array([m]), np.array([[s0, s1, t0, t1]]))[0],)
        for got, exact in zip((a, b), naive_slopes(maps[m], s0, s1, t0, t1), strict=True):
            assert got[0] <= exact[0] and exact[1] <= got[1], (seed, k)
            loose.append((got[1] - got[0]) - (exact[1] - exact[0]))
    assert np.median(loose) < 1.5, "a query of 2 x 2 texels a piece is wider, but not without end"


# Chords


@kernel
def _boxes(cp, texcoords, maps, whole, first, size, texels, steps_s, steps_t, eye, part, box, middle):
    """The boxes of a block all of whose lanes are one patch with map 0; texels and so on: (lo, hi) of the pyramids."""
    s = make_scratch(0)
    for lane in range(LANES):
        place_patch(cp, 0.0, lane, s)
        place_map(0, texcoords, maps.address, maps.scale, maps.bias, whole, size, lane, s)
        for k in range(4):
            s[PLACE + k, lane] = part[k]
    find_footprints(s)
    read_footprints(s, np.zeros(LANES, np.int64), first, size, maps.address, *texels, *steps_s, *steps_t)
    find_displacement(s)
    measure_differences(s)
    known = bound_part(s, eye, 0.0)
    for row, vector in enumerate((known.middle_q, known.middle_a, known.middle_b)):
        for c in range(3):
            store(s, 0, vector[c])
            middle[row, c] = s[0, 0]
    for row, vector in enumerate((known.q, known.a, known.b)):
        for c in range(3):
            store(s, 0, vector[c][0])
            store(s, 1, vector[c][1])
            box[row, c, 0], box[row, c, 1] = s[0, 0], s[1, 0]
    store(s, 0, choose(known.fine, 1.0, 0.0))
    return s[0, 0] > 0.0


def displaced_grid(cp, image, texcoords, u, v):
    """Displaced points (len(u), len(v), 3) in float64, of the exact surface, by an evaluation of its own."""
    from tests.test_backface import comb

    def basis(t, n):
        return np.stack([comb(n, k) * t**k * (1 - t) ** (n - k) for k in range(n + 1)], -1)

    cp = cp[..., :3].astype(np.float64)
    p = np.einsum("ui,vj,ijc->uvc", basis(u, 3), basis(v, 3), cp)
    du = np.einsum("ui,vj,ijc->uvc", basis(u, 2), basis(v, 3), np.diff(cp, axis=0))
    dv = np.einsum("ui,vj,ijc->uvc", basis(u, 3), basis(v, 2), np.diff(cp, axis=1))
    n = np.cross(du, dv)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    corners = texcoords.astype(np.float64).reshape(2, 2, 2)  # [v, u, (s, t)]
    st = np.einsum("vj,ui,jic->uvc", np.stack([1 - v, v], -1), np.stack([1 - u, u], -1), corners)
    h, w = image.texels.shape
    x, y = st[..., 0] * w - 0.5, st[..., 1] * h - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)

    def texel(k, size):
        if image.address == "wrap":
            return k % size
        if image.address == "mirror":
            k = k % (2 * size)
            return np.where(k < size, k, 2 * size - 1 - k)
        return np.clip(k, 0, size - 1)

    t = np.zeros(x.shape)
    for a in range(2):
        for b in range(2):
            weight = (x - i if a else 1 - x + i) * (y - j if b else 1 - y + j)
            t += weight * image.texels[texel(j + b, h), texel(i + a, w)]
    return p + (image.scale * t + image.bias)[..., None] * n


@by_seed
def test_boxes_hold_every_chord(seed):
    """Of any length, along u and along v, across creases at texel borders; and they are not much larger."""
    rng = np.random.default_rng(10 + seed)
    patches, maps = bumpy(rng, 60, 0.02, 0.15)
    box, middle, tight = np.empty((3, 3, 2)), np.empty((3, 3)), []
    for p in range(60):
        eye = rng.normal(0, 3, 3)
        size = rng.choice([1.0, 0.25, 1 / 16])
        u0, v0 = rng.uniform(0, 1 - size, 2)
        part = (u0, u0 + size, v0, v0 + size)
        packed = pack(maps[p : p + 1])
        pyramids, slopes = build_pyramids(packed), build_slopes(packed)
        fine = _boxes(
            patches.control_points[p], patches.texcoords[p], packed, pyramids.whole, pyramids.first, pyramids.size,
            *((pyramid.lo, pyramid.hi) for pyramid in (pyramids, *slopes)), eye, part, box, middle,
        )  # fmt: skip
        if not fine:
            continue
        u, v = (np.sort(np.append(rng.uniform(a, a + size, 30), [a, a + size])) for a in (u0, v0))
        d = displaced_grid(patches.control_points[p], maps[p], patches.texcoords[p], u, v)
        inverse = np.linalg.inv(middle[[1, 2, 0]].T)  # to coordinates of the boxes
        way = (d - eye).reshape(-1, 3)
        chords = []
        for axis, at in ((0, u), (1, v)):
            few = [(i, j) for i in range(32) for j in range(i + 1, 32) if at[j] - at[i] > 1e-6 * size]
            i, j = np.array(few).T
            step = (at[j] - at[i]) / size
            along = np.moveaxis(d, axis, 0)
            chords.append(((along[j] - along[i]) / step[:, None, None]).reshape(-1, 3))
        for row, vectors in enumerate((way, *chords)):
            coordinates = vectors @ inverse.T
            room = 1e-7 + 1e-9 / size
            assert (coordinates.min(axis=0) >= box[row, :, 0] - room).all(), (seed, p, row)
            assert (coordinates.max(axis=0) <= box[row, :, 1] + room).all(), (seed, p, row)
        tight.append(np.ptp(chords[0] @ inverse.T, axis=0).max() / np.ptp(box[1], axis=1).max())
    assert len(tight) > 30 and np.median(tight) > 0.1, (len(tight), np.median(tight))


# Whole patches


def stages(rng, n, height):
    """Displaced patches a view, with factors, partitionings and picture sizes of all kinds."""
    for _ in range(n):
        patches, maps = bumpy(rng, 40, height)
        points = patches.control_points[..., :3].reshape(-1, 3)
        eye = points.mean(axis=0) + rng.normal(size=3) * 10 ** rng.uniform(0.3, 1.3)
        size = int(10 ** rng.uniform(1.5, 3.5))
        viewport = Viewport(0, 0, size, max(4, size * 3 // 4), 0.0, 1.0)
        six = rng.choice([1, 2, 3, 5, 8, 16], (40, 6)) + rng.choice([0, 0, 0.01, 0.5], (40, 6))
        six[:30] = six[:30, :1]
        factors = TessFactors(six[:, :4].astype(np.float32), six[:, 4:].astype(np.float32))
        for partitioning in Partitioning:
            stage = view_of(patches, eye, 1.0, viewport, maps=maps)._replace(
                partitioning=int(partitioning), factors=factors
            )
            yield stage._replace(face_cull=int(rng.choice([FaceCull.BACK, FaceCull.FRONT])))


@by_seed
def test_no_triangle_of_a_displaced_patch_is_lost(seed):
    rng = np.random.default_rng(20 + seed)
    culled = 0
    with Host(1) as host:
        for stage in stages(rng, 6, 0.003):
            rows = np.flatnonzero(cull(SAFE, stage)).astype(np.int32)
            assert not verify.front_triangles(stage, rows, host).any(), seed
            culled += len(rows)
    assert culled > 40, culled


@by_seed
def test_no_point_of_a_displaced_surface_is_lost(seed):
    rng = np.random.default_rng(30 + seed)
    culled = 0
    with Host(1) as host:
        for stage in stages(rng, 4, 0.01):
            rows = np.flatnonzero(cull(SURFACE, stage)).astype(np.int32)
            cosine, _ = verify.facing(stage, rows, stage.maps, host)
            assert (cosine <= 0).all(), seed
            culled += len(rows)
    assert culled > 60, culled


def test_smoothly_displaced_patches_are_culled():
    """Of those that show no triangle, at a height of some hundredths of a patch: most."""
    rng = np.random.default_rng(3)
    seen = {SAFE: 0, SURFACE: 0}
    ideal = 0
    with Host(1) as host:
        for _ in range(6):
            patches, maps = bumpy(rng, 40, 0.002)
            stage = view_of(patches, rng.normal(size=3) * 6, 8.0, Viewport(0, 0, 1280, 960, 0.0, 1.0), maps=maps)
            stage = stage._replace(partitioning=int(Partitioning.INTEGER))
            ideal += (verify.front_triangles(stage, np.arange(40, dtype=np.int32), host) == 0).sum()
            for name in seen:
                seen[name] += (cull(name, stage) > 0).sum()
    assert seen[SURFACE] > 0.6 * ideal and seen[SAFE] > 0.4 * ideal, (seen, ideal)


@pytest.mark.parametrize("factor", [3, (2, 3, 4, 5, 6, 2.5), 16])
@pytest.mark.parametrize("partitioning", ["integer", "fractional_odd"])
def test_pictures_of_waves_from_below_stay(load, factor, partitioning):
    """Through the machine: waves with back faces dropped, seen from where most of them face away."""
    scene = load("waves", size=(160, 90), factor=factor)
    scene = replace(scene, face_cull="front", tessellation=replace(scene.tessellation, partitioning=partitioning))
    frames = [tiler.simulate(scene, Machine(cull=cull, verify=bool(cull))) for cull in ((), (SAFE,))]
    assert np.array_equal(frames[0].color, frames[1].color)
    assert np.array_equal(frames[0].depth_samples, frames[1].depth_samples)
    assert frames[1].violations == () and frames[1].false_culls == ()
    if factor == 16:
        assert frames[1].counters["hs_culled_backface"] > 0


# Constant displacement


def constant(t):
    return NaiveMap(np.full((3, 2), 1.0, np.float32), "mirror", t, 0.0)


def trough(depth):
    """A trough that opens along +z, the way its normal points: displaced by more than its radius it turns over.

    (A bowl would turn over twice, and face the way that it did.)
    """
    i = np.linspace(-0.5, 0.5, 4)
    points = np.ones((4, 4, 4))
    points[..., 0], points[..., 1] = i[:, None], i[None, :]
    points[..., 2] = depth * points[..., 0] ** 2
    return points


@pytest.mark.parametrize("name", CONES)
def test_offset_surfaces_are_culled_until_they_may_turn_over(name):
    eye = np.array([0.1, 0.2, -9.0])
    for t, culled in ((0.3, True), (-0.3, True), (2.0, False)):
        stage = view_of(make_one(trough(0.6), map_id=0), eye, maps=[constant(t)])
        assert (cull(name, stage)[0] > 0) == culled, t
    varying = NaiveMap(np.array([[0.1, 0.1001]], np.float32), "clamp", 1.0, 0.0)
    assert not cull(name, view_of(make_one(trough(0.6), map_id=0), eye, maps=[varying])).any()


@by_seed
def test_points_of_offset_surfaces_face_as_told(seed):
    rng = np.random.default_rng(40 + seed)
    told = 0
    for _ in range(80):
        image = constant(float(rng.normal() * 10 ** rng.uniform(-2, -0.5)))
        patches = make_one(smooth_patch(rng, 0.03), map_id=0)
        middle = patches.control_points[0, ..., :3].mean(axis=(0, 1))
        eye = middle + rng.normal(size=3) * 10 ** rng.uniform(0, 1)
        stage = view_of(patches, eye, maps=[image])
        t = np.linspace(0, 1, 40)
        d = displaced_grid(patches.control_points[0], image, CORNERS, t, t)
        normal = np.cross(d[1:, :-1] - d[:-1, :-1], d[:-1, 1:] - d[:-1, :-1])
        to_eye = eye - d[:-1, :-1]
        cosine = (normal * to_eye).sum(-1) / np.linalg.norm(normal, axis=-1) / np.linalg.norm(to_eye, axis=-1)
        for name in (*CONES, SURFACE):
            (side,) = classify(stage, name)
            told += side != Facing.SILHOUETTE
            if side != Facing.SILHOUETTE:
                assert (cosine if side == Facing.BACK else -cosine).max() < 0.1, (seed, name)
    assert told > 30


def test_without_the_curvature_condition_the_oracle_objects():
    """A planted fault: the cone test of a patch displaced past its centres of curvature."""
    stage = view_of(make_one(trough(0.6), map_id=0), np.array([0.1, 0.2, -9.0]), maps=[constant(3.0)])
    t = np.full((1, 2), 3.0)
    cones = ncone.make_cones(stage.patches, np.arange(1), Offsets(np.ones(1, bool), t))
    assert apex.face_eyes(cones, stage.eye[None])[0, 0] == Facing.BACK
    with Host(1) as host:
        assert verify.facing(stage, np.arange(1, dtype=np.int32), stage.maps, host)[0][0] > 0.1
    assert not constant_offsets(stage, np.arange(1)).known.any()


@pytest.mark.parametrize("name", [SURFACE, SAFE])
def test_slopes_without_the_filter_footprint_are_found_out(name):
    """A planted fault: the map's only step lies between the last texel of the rectangle and the one beyond it."""
    texels = np.zeros((4, 8), np.float32)
    texels[:, 4:] = 0.5
    image = NaiveMap(texels, "clamp", 1.0, 0.0)
    flat = np.ones((4, 4, 4))
    flat[..., 0], flat[..., 1], flat[..., 2] = np.linspace(0, 1, 4)[:, None], np.linspace(0, 1, 4)[None], 0.0
    patches = make_one(flat, map_id=0)._replace(texcoords=(CORNERS * [0.5, 1.0]).astype(np.float32)[None])
    # Seen from below and from the side: the rising strip at u = 1 faces the eye, the rest does not.
    stage = view_of(patches, np.array([-4.0, 0.5, -0.3]), 64.0, Viewport(0, 0, 2000, 1500, 0.0, 1.0), maps=[image])
    stage = stage._replace(face_cull=int(FaceCull.BACK), partitioning=int(Partitioning.INTEGER))
    one = np.arange(1, dtype=np.int32)
    with Host(1) as host:
        shows = verify.front_triangles(stage, one, host)[0] > 0
        cosine = verify.facing(stage, one, stage.maps, host)[0][0]
    away = classify(stage, name)[0]
    none = pack([NaiveMap(np.zeros((4, 8), np.float32), "clamp", 1.0, 0.0)])
    faulty = classify(stage._replace(slopes=build_slopes(none)), name)[0]
    assert shows == (cosine > 0) and shows
    assert away == Facing.SILHOUETTE and faulty == Facing.BACK


# Which patches are answered for


def test_kinds_of_patches():
    """Gregory patches: by no test. ACC and rational ones: undisplaced only."""
    rng = np.random.default_rng(6)
    patches = gentle(rng, 30)
    stage = view_of(patches, np.array([4.0, 1, 2]), 8, maps=[constant(1e-4)])
    rows = np.zeros(30, np.int32)
    for name in (*CONES, "backface:tangent_plane", "backface:normal_box", SURFACE, SAFE):
        before = classify(stage, name)
        assert (before > 0).any()
        assert not classify(stage._replace(patches=patches._replace(gregory_id=rows)), name).any()
        np.testing.assert_array_equal(classify(stage._replace(patches=patches._replace(tangent_id=rows)), name), before)
        displaced = patches._replace(map_id=rows)
        told = classify(stage._replace(patches=displaced), name)
        assert told.any() == (name in (*CONES, SURFACE, SAFE))
        for kind in ({"tangent_id": rows}, {"rational": rows.astype(np.uint8) + 1}):
            assert not classify(stage._replace(patches=displaced._replace(**kind)), name).any()


@pytest.mark.parametrize("name", [SURFACE, SAFE, *CONES])
def test_bad_maps_texture_coordinates_and_sizes(name):
    rng = np.random.default_rng(7)
    patches = gentle(rng, 12)._replace(map_id=np.zeros(12, np.int32))
    eye = np.array([4.0, 1, 2])
    for bad in (np.nan, np.inf, 1e30):
        image = NaiveMap(np.array([[1e-4, bad], [1e-4, 1e-4]], np.float32), "wrap", 1.0, 0.0)
        assert not classify(view_of(patches, eye, maps=[image]), name).any()
        broken = patches.texcoords.copy()
        broken[:, 1, 0] = bad
        varying = NaiveMap(np.array([[1e-4, 0.0]], np.float32), "wrap", 1.0, 0.0)
        assert not classify(view_of(patches._replace(texcoords=broken), eye, maps=[varying]), name).any()
    point = make_one(np.ones((4, 4, 4)), map_id=0)
    assert not classify(view_of(point, eye, maps=[constant(1e-3)]), name).any()
    for size in (1e-30, 1e30):
        cp = patches.control_points * np.float32([size, size, size, 1])
        small = view_of(make_one(cp, map_id=[0] * 12), eye * size, maps=[constant(1e-4 * size)])
        flat = classify(small, name)
        if flat.any():
            np.testing.assert_array_equal(
                flat[flat > 0], classify(view_of(patches, eye, maps=[constant(1e-4)]), name)[flat > 0]
            )


# Many eyes


@by_seed
def test_many_eyes_are_told_what_each_is_told_alone(seed):
    """Bit for bit, on models, rational and degenerate patches, near and far eyes, and eyes on the tangent planes."""
    rng = np.random.default_rng(50 + seed)
    some = [smooth_patch(rng, 0.04) for _ in range(20)] + [rational_patch(rng, 0.04, 1.3) for _ in range(20)]
    some += [np.repeat(smooth_patch(rng)[:1], 4, 0), np.ones((4, 4, 4))]
    flat = np.ones((4, 4, 4))
    flat[..., 0], flat[..., 1], flat[..., 2] = np.linspace(0, 1, 4)[:, None], np.linspace(0, 1, 4)[None], 0.0
    patches = make_one([*some, flat])
    eyes = rng.normal(size=(70, 3)) * 10 ** rng.uniform(-1, 5, (70, 1))
    eyes[::7, 2] = 0.0  # in the plane of the flat one
    eyes[::9] = patches.control_points[::5, 0, 0, :3][: len(eyes[::9])]  # on the patches
    numbers = np.arange(len(some) + 1)
    planes = control_planes.make_planes(patches, numbers)
    got = {"tangent_plane": control_planes.face_eyes(planes, patches, eyes)}
    for name, make in (("ncone", ncone.make_cones), ("tcone", tcone.make_cones)):
        got[name] = apex.face_eyes(make(patches, numbers, no_offsets(len(numbers))), eyes)
    stage = view_of(patches, np.array([3.0, 2, 9]))
    for k, eye in enumerate(eyes):
        for name, facing in got.items():
            np.testing.assert_array_equal(facing[:, k], classify(stage._replace(eye=eye), f"backface:{name}"), name)
    assert all((facing > 0).mean() > 0.1 for facing in got.values())


def test_patches_that_no_test_answers_for_are_silhouettes_to_many_eyes():
    patches = gentle(np.random.default_rng(8), 6)
    patches.control_points[1, 2, 2, 3] = -1
    patches.control_points[2, 0, 0, 0] = np.nan
    patches.control_points[3, 0, 0, 0] = np.inf
    patches.map_id[4] = 0
    eyes = np.array([[9.0, 1, 2], [np.nan, 0, 0], [-9.0, -1, 2]])
    planes = control_planes.make_planes(patches, np.arange(6))
    facing = control_planes.face_eyes(planes, patches, eyes)
    assert not facing[1:5].any() and not facing[:, 1].any()
    cones = ncone.make_cones(patches, np.arange(6), no_offsets(6))
    assert not apex.face_eyes(cones, eyes)[1:4].any() and not apex.face_eyes(cones, eyes)[:, 1].any()


@pytest.mark.timing
def test_ten_thousand_views_take_seconds():
    """BigGuy seen from a sphere of 1.2 radii, as Loop et al. 2011, Table 1: three tests, two seconds and a bit."""
    patches, points = bigguy()
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    way = np.random.default_rng(11).normal(size=(10000, 3))
    radius = np.linalg.norm(points - middle, axis=1).max()
    eyes = middle + 1.2 * radius * way / np.linalg.norm(way, axis=1)[:, None]
    everyone = np.arange(len(patches.map_id))
    start = time.perf_counter()
    rates = []
    cones = [make(patches, everyone, no_offsets(len(everyone))) for make in (tcone.make_cones, ncone.make_cones)]
    planes = control_planes.make_planes(patches, everyone)
    for part in np.array_split(eyes, 20):
        facing = [*(apex.face_eyes(some, part) for some in cones), control_planes.face_eyes(planes, patches, part)]
        rates.append([100 * (f == Facing.BACK).mean() for f in facing])
    assert time.perf_counter() - start < 30
    np.testing.assert_allclose(np.mean(rates, axis=0), [37.2, 45.3, 49.0], atol=0.3)


# Partitioning


def test_the_frames_partitioning_culls_no_less_than_any():
    patches, points = bigguy()
    viewport = Viewport(0, 0, 1280, 720, 0.0, 1.0)
    stage = bigguy_view(patches, points, np.array([1.0, 0.4, 0.7]), 16.0, viewport=viewport)
    any_of_them = classify(stage, SAFE) > 0
    more = {}
    for partitioning in list(Partitioning)[1:]:
        told = classify(stage._replace(partitioning=int(partitioning)), SAFE) > 0
        assert (told | ~any_of_them).all()
        more[partitioning.name] = told.mean() - any_of_them.mean()
    assert more["INTEGER"] == more["POW2"] > 0.02, more


def test_a_patch_that_its_displacement_may_take_through_the_near_plane_stays():
    """The points of the base are all beyond it: what the map adds is looked up for whole patches first, in every lane."""
    scene = torus(600, 4, (640, 360))
    key = scene.camera.keys[0]
    stage = hull_stage(scene)
    everyone = np.arange(scene.num_patches)
    back = np.flatnonzero(classify(stage, SAFE) == Facing.BACK)
    reach = abs(displacement_ranges(stage)).max(axis=0)
    forward = np.array(key.target) - key.eye
    depth = (stage.patches.control_points[..., :3] - np.array(key.eye)) @ (forward / np.linalg.norm(forward))
    assert len(back) > 80
    for p in back[::8]:
        nearest = depth[p].min()
        for part, kept in ((0.25, True), (1.5, False)):
            path = replace(scene.camera, near=float(nearest - part * reach[p]))
            closer = hull_stage(replace(scene, camera=path))
            facing = tessellation_safe.classify_patches(closer, everyone)[p]
            assert (facing == Facing.SILHOUETTE) == kept, (p, part)


@pytest.mark.parametrize("name", [SAFE, SURFACE])
def test_an_answer_depends_on_no_neighbour_and_on_no_thread(name):
    """Patches take turns in lanes, and chunks of them in threads."""
    stage = hull_stage(torus(1300, 16, (640, 360)))
    n = len(stage.patches.map_id)
    flags, bounds = np.zeros(n, np.uint8), BOUNDS["cbox"](stage)
    alone, shared = (front_end.cull(name, stage, bounds, flags, Host(threads)) for threads in (1, 3))
    np.testing.assert_array_equal(alone, shared)
    order = np.random.default_rng(0).permutation(n)
    facing = CLASSIFIERS[name](stage, order)
    np.testing.assert_array_equal(facing == Facing.BACK, alone[order] != 0)
    one_by_one = np.concatenate([CLASSIFIERS[name](stage, order[k : k + 1]) for k in range(100)])
    np.testing.assert_array_equal(one_by_one, facing[:100])
    assert 0.2 < (alone != 0).mean() < 0.6
