"""Primitives and the depth test, against slow twins: outcome, vertices, box and flags of every triangle, exactly."""

from typing import NamedTuple

import numpy as np
import pytest

from pipeline import pixel, primitives
from pipeline.inside import make_lanes
from pipeline.pixel import Shade
from pipeline.primitives import BACK_FACE, Outcome
from pipeline.types import DomainPoints, FaceCull, Patterns, Triangles, Viewport, Window
from tests.naive_primitives import (
    exact_attributes,
    naive_assemble,
    naive_cut_segment,
    naive_depth_test,
    naive_planes,
    naive_window,
)
from tiler.back_end import NO_ORDER, make_coarse_z, make_rules, touched_blocks
from tiler.binning import bin_boxes
from tiler.coarse_z import depth_rows
from tiler.config import Machine
from tiler.grid import make_grid
from tiler.host import Host
from tiler.occlusion import make_sketch
from tiler.rasterizer import MARGIN, SAMPLE_X, SAMPLE_Y
from tiler.tile import NUM_TILE_COUNTS, Target, TileCount, Work, process_tiles

F = np.float32
VIEWPORTS = {
    "whole": Viewport(0, 0, 64, 48, 0.0, 1.0),
    "part": Viewport(5, 11, 37, 23, 0.25, 0.7),
}
by_viewport = pytest.mark.parametrize("viewport", VIEWPORTS.values(), ids=VIEWPORTS.keys())
by_samples = pytest.mark.parametrize("samples", [1, 4], ids=["1x", "4x"])


# Production, called alone


class Assembled(NamedTuple):
    points: DomainPoints
    window: Window
    triangles: Triangles
    outcomes: np.ndarray
    cuts: np.ndarray

    def of_patch(self, k):
        """Numbers of the triangles of patch k."""
        first = self.triangles.first[k]
        return range(first, first + self.triangles.used[k])

    def all(self):
        return [t for k in range(len(self.triangles.used)) for t in self.of_patch(k)]

    def vertex(self, v):
        """Position, depth and w, and the normal, of window vertex v, as bytes where floats."""
        window = self.window
        attributes = np.array([window.z[v], window.w[v], *self.points.normal[:, v]], F)
        return int(window.x[v]), int(window.y[v]), attributes.tobytes()


def assemble(clip, normal, viewport, samples=1, cull="NONE", per_patch=1):
    """Triangles clip (T, 3, 4), normal (T, 3, 3); `per_patch` of them in a row are a patch. Room for all to be cut."""
    patches = len(clip) // per_patch
    corners = 3 * per_patch
    n = corners * patches
    flat_normal = np.ascontiguousarray(normal.reshape(-1, 3).T, F)
    points = DomainPoints(
        np.arange(patches + 1, dtype=np.int64) * corners, np.ascontiguousarray(clip.reshape(-1, 4).T, F), flat_normal
    )
    patterns = Patterns(
        np.zeros(patches, np.int32), np.zeros((2, corners), F), np.array([0, corners], np.int64),
        np.arange(corners, dtype=np.uint16), np.array([0, per_patch], np.int64),
    )  # fmt: skip
    live, guard = np.arange(patches, dtype=np.int32), primitives.guard_band(viewport)
    window = Window(*(np.zeros(n, t) for t in (np.int32, np.int32, F, F, np.uint8)))
    primitives.project_points(0, n, points.clip, viewport, guard, window)
    cuts = np.full(patches, -1, np.int64)
    primitives.count_cuts(0, patches, live, patterns, points.first, window.code, cuts)
    first_spare = n + np.arange(patches + 1) * per_patch * primitives.MAX_CORNERS
    spare = int(first_spare[-1]) - n
    points = points._replace(normal=np.concatenate([flat_normal, np.zeros((3, spare), F)], axis=1))
    window = Window(*(np.concatenate([a, np.zeros(spare, a.dtype)]) for a in window))
    window.z[n:] = np.nan
    room = np.arange(patches + 1) * per_patch * (primitives.MAX_CORNERS - 2)
    triangles = Triangles(
        room, np.zeros(patches, np.int32), np.zeros((room[-1], 3), np.int32), np.zeros((room[-1], 4), np.int16),
        np.zeros(room[-1], np.uint16), np.zeros(room[-1], np.uint8), np.zeros(room[-1], np.int32), np.zeros(room[-1], np.int32),
    )  # fmt: skip
    outcomes = np.zeros((patches, primitives.NUM_OUTCOMES), np.int64)
    used, num_used = np.zeros(len(window.x), np.uint8), np.empty(patches, np.int64)
    bounds = (viewport.left, viewport.top, viewport.left + viewport.width - 1, viewport.top + viewport.height - 1)
    primitives.assemble(
        0, patches, live, patterns, points, first_spare, viewport, guard, bounds, MARGIN[samples], int(FaceCull[cull]),
        window, triangles, outcomes, used, num_used, np.empty((2 * primitives.MAX_CORNERS, primitives.POLYGON)),
        make_lanes(corners),
    )  # fmt: skip
    # The front end leaves no more room than this.
    assert (triangles.used <= per_patch + cuts * (primitives.MAX_CORNERS - 3)).all()
    written = ~np.isnan(window.z[n:].reshape(patches, -1))
    assert not written[np.arange(written.shape[1]) >= (cuts * primitives.MAX_CORNERS)[:, None]].any()
    for k in range(patches):
        vertices = triangles.vertex[triangles.first[k] : triangles.first[k] + triangles.used[k]]
        assert num_used[k] == len(np.unique(vertices)) and used[vertices].all()
    assert used.sum() == num_used.sum()
    return Assembled(points, window, triangles, outcomes, cuts)


class Drawn(NamedTuple):
    depth: np.ndarray  # (H, W, S)
    visible: np.ndarray  # (H, W, S) place in submit order, -1 for none
    color: np.ndarray  # (H, W, S, 4)
    counts: np.ndarray  # summed over tiles


def draw(assembled, width, height, samples, depth_range=(0.0, 1.0), tile=32, shading=Shade.LAMBERT):
    """Bin, rasterize and shade set-up triangles."""
    _, window, triangles, outcomes, _ = assembled
    grid, patches = make_grid(width, height, tile), len(triangles.used)
    shape = (height, width, samples)
    target = Target(
        np.full(shape, np.nan, F), np.zeros(shape, np.int32), np.zeros((*shape, 4), np.uint8),
        np.zeros((height, width, 4), np.uint8), np.empty((0, 0, 0), np.int64),
    )  # fmt: skip
    with Host(1) as host:
        queue = bin_boxes(triangles.first, triangles.used, triangles.box, grid, host)
    machine = Machine(tile=tile, binning="triangle")
    coarse = make_coarse_z(machine, grid)
    boxes = np.empty((0, 8, 4)), np.empty((0, 4))
    work = Work(np.zeros((patches, 4), np.int32), np.zeros(patches, F), np.zeros((patches, 3, 3)), *boxes, outcomes)
    viewport = Viewport(0, 0, width, height, 0.0, 1.0)
    counts = np.zeros((grid.num_tiles, NUM_TILE_COUNTS), np.int64)
    process_tiles(
        0, grid.num_tiles, grid, make_rules(machine), queue, queue, work, viewport, triangles, NO_ORDER, window,
        assembled.points.normal, (SAMPLE_X[samples], SAMPLE_Y[samples], MARGIN[samples]),
        tuple(F(d) for d in depth_range), np.array([9, 8, 7, 6], np.uint8), int(shading), (0.0, 0.0, 1.0), True, True,
        target, coarse, depth_rows(target.depth), touched_blocks(coarse), make_sketch(),
        np.zeros(len(queue.item), np.uint8), counts, np.empty(pixel.SCRATCH, F),
    )  # fmt: skip
    place = np.full(len(triangles.vertex) + 1, -1)
    place[assembled.all()] = np.arange(triangles.used.sum())
    return Drawn(target.depth, place[target.visible], target.color, counts.sum(axis=0))


# Families of clip-space triangles: (T, 3, 4), any float32


def from_ndc(xy, z, w):
    """Clip positions of points with normalized x, y (n, 3, 2), z (n, 3), seen at w (n, 3)."""
    return np.concatenate([xy * w[..., None], (z * w)[..., None], w[..., None]], -1)


def inside(rng, n):
    return from_ndc(rng.uniform(-1, 1, (n, 3, 2)), rng.uniform(0, 1, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def small(rng, n):
    """A few pixels down to less than the distance of samples."""
    size = 10 ** rng.uniform(-4, -1, (n, 1, 1))
    xy = rng.uniform(-1, 1, (n, 1, 2)) + rng.normal(0, 1, (n, 3, 2)) * size
    return from_ndc(xy, rng.uniform(0, 1, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def crossing_near(rng, n):
    return from_ndc(rng.uniform(-1, 1, (n, 3, 2)), rng.uniform(-1, 1, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def crossing_far(rng, n):
    return from_ndc(rng.uniform(-1, 1, (n, 3, 2)), rng.uniform(0, 2, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def crossing_both(rng, n):
    return from_ndc(rng.uniform(-1, 1, (n, 3, 2)), rng.uniform(-2, 3, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def crossing_the_eye(rng, n):
    """Any x, y, z, w of either sign; behind the eye as well."""
    return rng.normal(0, 1, (n, 3, 4)) * 10 ** rng.uniform(-1, 1, (n, 1, 4))


def behind(rng, n):
    clip = inside(rng, n)
    clip[..., 2:] *= -1
    return clip


def huge(rng, n):
    """Out to past the guard band, and far past it."""
    xy = rng.normal(0, 1, (n, 3, 2)) * 10 ** rng.uniform(0, 9, (n, 3, 1))
    return from_ndc(xy, rng.uniform(-0.2, 1.2, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def offscreen(rng, n):
    """Around the picture's corners: no plane has all of a triangle outside, and yet it may miss the picture."""
    side = rng.choice([-1, 1], (n, 1, 2))
    xy = side * (1 + rng.normal(0, 1, (n, 3, 2)) * rng.choice([0.05, 0.5, 3], (n, 1, 1)))
    return from_ndc(xy, rng.uniform(0, 1, (n, 3)), rng.uniform(0.5, 8, (n, 3)))


def at_zero_w(rng, n):
    clip = crossing_the_eye(rng, n)
    clip[rng.random((n, 3)) < 0.4, 3] = 0
    clip[rng.random((n, 3)) < 0.2, 2] = 0
    clip[rng.random((n, 3)) < 0.1] = 0
    return clip


def on_planes(rng, n):
    """Vertices exactly on planes of the frustum and on the guard band's."""
    clip = crossing_both(rng, n)
    clip[..., 3] = 2.0 ** rng.integers(-2, 3, (n, 3))
    for c in range(3):
        limit = rng.choice([-1, 0, 1, 1, 32767.0 * 2 / 64 - 1, -32768.0 * 2 / 64 - 1][: 6 if c == 0 else 4], (n, 3))
        clip[..., c] = np.where(rng.random((n, 3)) < 0.5, limit * clip[..., 3], clip[..., c])
    return clip


def no_area(rng, n):
    """Two equal vertices, three on a line, and three that snap to one."""
    clip = inside(rng, n)
    third = n // 3
    clip[:third, 2] = clip[:third, 0]
    clip[third : 2 * third, :, 1] = 0.125 * clip[third : 2 * third, :, 3]
    clip[2 * third :, 1:] = clip[2 * third :, :1] * (1 + 1e-6 * rng.normal(0, 1, (n - 2 * third, 2, 1)))
    return clip


def not_finite(rng, n):
    clip = crossing_near(rng, n)
    where = rng.random((n, 3, 4)) < 0.08
    clip[where] = rng.choice([np.nan, np.inf, -np.inf], where.sum())
    return clip


def extreme(rng, n):
    """Finite, but so large or small that a product or a quotient of them is not."""
    return rng.normal(0, 1, (n, 3, 4)) * 10 ** rng.uniform(-42, 38, (n, 3, 1))


# Family: what it must show, so that it tests what it is for.
FAMILIES = {
    inside: {"SETUP", "FACE"},
    small: {"SETUP", "NO_SAMPLE", "FACE"},
    crossing_near: {"SETUP", "CUT", "CLIPPED", "FACE"},
    crossing_far: {"SETUP", "CUT", "CLIPPED", "FACE"},
    crossing_both: {"SETUP", "CUT", "CLIPPED", "FACE"},
    crossing_the_eye: {"SETUP", "CUT", "CLIPPED", "OFFSCREEN"},
    behind: {"CLIPPED"},
    huge: {"SETUP", "CUT", "CLIPPED", "OFFSCREEN"},
    offscreen: {"SETUP", "OFFSCREEN", "CLIPPED"},
    at_zero_w: {"SETUP", "CUT", "CLIPPED", "INVALID", "OFFSCREEN"},
    on_planes: {"SETUP", "CUT", "CLIPPED"},
    no_area: {"ZERO_AREA"},
    not_finite: {"SETUP", "INVALID", "CUT"},
    extreme: {"CLIPPED", "CUT"},
}
by_family = pytest.mark.parametrize("family", FAMILIES, ids=lambda f: f.__name__)


def make(family, n, seed=0):
    rng = np.random.default_rng([seed, list(FAMILIES).index(family)])
    with np.errstate(over="ignore"):
        return family(rng, n).astype(F), rng.normal(0, 1, (n, 3, 3)).astype(F)


def twin_inputs(clip, normal):
    return [tuple(float(a) for a in row) for row in np.concatenate([clip, normal], -1)]


def found_counts(outcomes):
    return {o.name: int(outcomes[o]) for o in Outcome if outcomes[o]}


def found_triangle(assembled, t):
    """As `expected_triangle`."""
    tri = assembled.triangles
    edges = int(tri.edges[t])
    return [assembled.vertex(v) for v in tri.vertex[t]], tri.box[t].tolist(), edges


def vertex_key(v):
    """As `Assembled.vertex`."""
    return v.x, v.y, np.array([v.z, v.w, *v.attributes], F).tobytes()


def expected_triangle(triangle):
    vertices = [vertex_key(v) for v in triangle.vertices]
    edges = sum(1 << i for i in range(3) if triangle.edges[i]) + (BACK_FACE if triangle.back else 0)
    return vertices, list(triangle.box), edges


@by_family
@by_samples
@by_viewport
def test_equals_twin(viewport, samples, family):
    clip, normal = make(family, 120)
    seen = set()
    for cull in ("NONE", "BACK", "FRONT"):
        assembled = assemble(clip, normal, viewport, samples, cull)
        for k in range(len(clip)):
            vertices = twin_inputs(clip[k], normal[k])
            counts, triangles = naive_assemble(vertices, viewport, MARGIN[samples], cull)
            context = f"{family.__name__}, triangle {k}, cull {cull}: {vertices}"
            assert found_counts(assembled.outcomes[k]) == counts, context
            found = [found_triangle(assembled, t) for t in assembled.of_patch(k)]
            assert found == [expected_triangle(t) for t in triangles], context
            assert (assembled.triangles.patch[assembled.of_patch(k)] == k).all()
            seen |= set(counts)
    assert seen >= FAMILIES[family], "the family does not try what it is for"


@by_family
def test_every_triangle_has_one_outcome(family):
    clip, normal = make(family, 600)
    for samples in (1, 4):
        for cull in ("NONE", "BACK", "FRONT"):
            assembled = assemble(clip, normal, VIEWPORTS["whole"], samples, cull)
            o = assembled.outcomes
            whole = o[:, Outcome.C_IN] - o[:, Outcome.CLIPPED] - o[:, Outcome.INVALID]
            assert ((whole == 0) | (whole == 1)).all()
            fan = o[:, Outcome.C_OUT]
            np.testing.assert_array_equal(fan > 0, whole == 1)
            assert (fan[o[:, Outcome.CUT] == 0] <= 1).all() and fan.max() <= primitives.MAX_CORNERS - 2
            ends = (Outcome.ZERO_AREA, Outcome.FACE, Outcome.NO_SAMPLE, Outcome.OFFSCREEN, Outcome.SETUP)
            np.testing.assert_array_equal(fan, o[:, ends].sum(axis=1))
            np.testing.assert_array_equal(o[:, Outcome.SETUP], assembled.triangles.used)
            assert (o[:, Outcome.CUT] <= assembled.cuts).all()


def test_patches_of_several_triangles_equal_triangles_alone():
    clip, normal = (np.concatenate(a) for a in zip(*(make(f, 40) for f in FAMILIES), strict=True))
    order = np.random.default_rng(1).permutation(len(clip))
    clip, normal = clip[order], normal[order]
    for per_patch in (2, 5, 7):
        n = len(clip) // per_patch * per_patch
        alone = assemble(clip[:n], normal[:n], VIEWPORTS["whole"])
        together = assemble(clip[:n], normal[:n], VIEWPORTS["whole"], per_patch=per_patch)
        one, other = ([found_triangle(a, t) for t in a.all()] for a in (alone, together))
        assert one == other
        np.testing.assert_array_equal(alone.outcomes.reshape(-1, per_patch, 10).sum(axis=1), together.outcomes)
        np.testing.assert_array_equal(alone.cuts.reshape(-1, per_patch).sum(axis=1), together.cuts)


def test_a_range_of_patches_is_written_to_its_own_places():
    """The stages work on begin .. end-1 only: two halves equal the whole."""
    clip, normal = make(crossing_both, 50)
    viewport = VIEWPORTS["whole"]
    whole = assemble(clip, normal, viewport)
    window = Window(*(np.full(150, 77, t) for t in (np.int32, np.int32, F, F, np.uint8)))
    primitives.project_points(60, 90, whole.points.clip, viewport, primitives.guard_band(viewport), window)
    for a, b in zip(window, whole.window, strict=True):
        np.testing.assert_array_equal(a[60:90], b[60:90])
        assert (a[:60] == 77).all() and (a[90:] == 77).all()


# Snap and guard band, by hand


def test_snap_rounds_ties_to_even():
    """A viewport of 2 x 2 pixels: window x = ndc + 1, exactly."""
    halves = np.array([0.5, 1.5, 2.5, 3.5, 128.5]) / 256
    for h in halves:
        clip = np.array([[[h - 1, 1 - h, 0.5, 1], [1, 1, 0.5, 1], [0, -1, 0.5, 1]]], F)
        window = assemble(clip, np.zeros((1, 3, 3), F), Viewport(0, 0, 2, 2, 0.0, 1.0)).window
        assert window.x[0] == window.y[0] == np.rint(h * 256)


def test_guard_band_keeps_the_16_8_range_and_no_more():
    viewport = VIEWPORTS["part"]
    planes = naive_planes(viewport)
    lo_x, hi_x, lo_y, hi_y = primitives.guard_band(viewport)
    for plane, (x, y) in zip(planes[2:], [(lo_x, 0), (hi_x, 0), (0, hi_y), (0, lo_y)], strict=True):
        assert plane(x, y, 0.5, 1) == 0
        at = naive_window((x, y, 0.5, 1), viewport)
        assert max(abs(at.x), abs(at.y)) in (32767 * 256, 32768 * 256)


def test_nothing_inside_the_guard_band_is_cut():
    rng = np.random.default_rng(3)
    clip = from_ndc(rng.uniform(-500, 500, (200, 3, 2)), rng.uniform(0, 1, (200, 3)), rng.uniform(0.5, 8, (200, 3)))
    assembled = assemble(clip.astype(F), np.zeros((200, 3, 3), F), VIEWPORTS["whole"])
    assert (assembled.cuts == 0).all() and (assembled.outcomes[:, Outcome.C_OUT] <= 1).all()


# Cut edges


def rotations_and_mirrors(a, b, c):
    return [(a, b, c), (b, c, a), (c, a, b), (a, c, b), (c, b, a), (b, a, c)]


@pytest.mark.parametrize("family", [crossing_near, crossing_both, huge, crossing_the_eye], ids=lambda f: f.__name__)
def test_triangles_sharing_an_edge_share_its_cut_vertices(family):
    """In every order of vertices, whatever the third vertex is, and also where only one of the two is cut."""
    viewport = VIEWPORTS["whole"]
    clip, normal = make(family, 60, seed=5)
    rest, rest_normal = make(family, 60, seed=6)
    rest[::3], rest_normal[::3] = make(inside, 20)
    planes = naive_planes(viewport)
    checked = cut = 0
    for k in range(60):
        a, b, c = np.concatenate([clip[k], normal[k]], -1)
        d = np.concatenate([rest[k, 0], rest_normal[k, 0]])
        both = [np.stack(t) for t in rotations_and_mirrors(a, b, c) + rotations_and_mirrors(b, a, d)]
        vertices = np.stack(both)
        assembled = assemble(vertices[..., :4], vertices[..., 4:], viewport)
        with np.errstate(all="ignore"):
            ends = naive_cut_segment(tuple(map(float, a)), tuple(map(float, b)), planes)
            if ends is None:
                continue
            expected = {vertex_key(naive_window(end, viewport)) for end in ends}
        for t in range(12):
            ids = {v for f in assembled.of_patch(t) for v in assembled.triangles.vertex[f]}
            found = {assembled.vertex(v) for v in ids}
            o = assembled.outcomes[t]
            if o[Outcome.SETUP] and o[Outcome.SETUP] == o[Outcome.C_OUT]:  # otherwise not all vertices are there to see
                checked += 1
                cut += o[Outcome.CUT]
                assert expected <= found, f"{family.__name__} {k}, order {t}"
    assert checked > 40 and cut > 20


@pytest.mark.parametrize("family", [crossing_near, crossing_far, crossing_both, huge], ids=lambda f: f.__name__)
def test_only_original_edges_are_flagged(family):
    """With barycentric coordinates for normals: an edge is the triangle's where one coordinate is 0 at both its ends."""
    clip, _ = make(family, 300, seed=8)
    assembled = assemble(clip, np.tile(np.eye(3, dtype=F), (300, 1, 1)), VIEWPORTS["whole"])
    tri, normal = assembled.triangles, assembled.points.normal
    seen = {True: 0, False: 0}
    for t in assembled.all():
        for i in range(3):
            a, b = normal[:, tri.vertex[t, (i + 1) % 3]], normal[:, tri.vertex[t, (i + 2) % 3]]
            original = bool(((a == 0) & (b == 0)).any())
            assert bool(tri.edges[t] & (1 << i)) == original, f"triangle {t}, edge {i}: from {a} to {b}"
            seen[original] += 1
    assert min(seen.values()) > 50


def test_cut_attributes_are_linear_in_clip_space():
    """Normals that are made of the position stay so: x, y, z of the clip position."""
    clip, _ = make(crossing_both, 200, seed=9)
    assembled = assemble(clip, clip[..., :3], VIEWPORTS["whole"])
    n = clip.size // 4
    new = np.flatnonzero(assembled.window.w[n:] > 0) + n
    assert len(new) > 300
    x, y, z = assembled.points.normal[:, new].astype(np.float64)
    w = assembled.window.w[new]
    np.testing.assert_allclose(assembled.window.z[new], z / w, atol=1e-6)
    np.testing.assert_allclose(assembled.window.x[new] / 256, (x / w + 1) * 32, atol=1 / 256)
    np.testing.assert_allclose(assembled.window.y[new] / 256, (1 - y / w) * 24, atol=1 / 256)


# The depth test


def overlapping(rng, n, spread, lattice):
    """Triangles through each other, some twice (the first stays), some in a plane of constant depth, some cut.

    lattice: vertices on pixels' centres and corners (of a viewport 32 pixels wide), so that samples lie on edges.
    """
    xy, w = rng.uniform(-spread, spread, (n, 3, 2)), rng.uniform(0.5, 4, (n, 3))
    if lattice:
        xy, w = np.rint(xy * 32) / 32, 2.0 ** np.rint(w)
    clip = from_ndc(xy, rng.uniform(-0.1, 1.1, (n, 3)), w).astype(F)
    clip[1::7] = clip[::7][: len(clip[1::7])]
    clip[2::7, :, 2] = clip[2::7, :, 3] / 2
    clip[3::7, :, 2] = clip[3::7, :, 3] / 2
    return clip, rng.normal(0, 1, (n, 3, 3)).astype(F)


def naive_triangles(clip, normal, viewport, samples):
    triangles = []
    for k in range(len(clip)):
        triangles += naive_assemble(twin_inputs(clip[k], normal[k]), viewport, MARGIN[samples], "NONE")[1]
    return triangles


CASES = {  # width, height, tile, triangles, spread of their vertices, whether on a lattice
    "small": (24, 17, 8, 40, 0.3, False),
    "medium": (33, 40, 32, 20, 1.2, False),
    "large": (70, 61, 16, 7, 2.5, False),
    "lattice": (32, 32, 8, 40, 0.4, True),
}


@by_samples
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("depth_range", [(0.0, 1.0), (0.25, 0.7)], ids=["0..1", "0.25..0.7"])
def test_depth_test_equals_brute_force(depth_range, case, samples):
    width, height, tile, count, spread, lattice = CASES[case]
    viewport = Viewport(0, 0, width, height, *depth_range)
    for seed in range(2):
        clip, normal = overlapping(np.random.default_rng(seed), count, spread, lattice)
        assembled = assemble(clip, normal, viewport, samples)
        drawn = draw(assembled, width, height, samples, depth_range, tile)
        triangles = naive_triangles(clip, normal, viewport, samples)
        expected = naive_depth_test(triangles, width, height, samples, depth_range)
        np.testing.assert_array_equal(drawn.visible, expected.visible, f"seed {seed}")
        np.testing.assert_array_equal(drawn.depth.view(np.uint32), expected.depth.view(np.uint32), f"seed {seed}")
        assert len(set(drawn.visible.ravel())) > 3
        for name, number in (
            (TileCount.SAMPLES_COVERED, expected.covered),
            (TileCount.SAMPLES_PASSED, expected.passed),
            (TileCount.PS_INVOCATIONS, expected.pixels),
        ):
            assert drawn.counts[name] == number, f"seed {seed}, {name.name}"


@by_samples
def test_depth_stays_in_the_range_of_its_triangle(samples):
    """Rounding may not leave it. Where z0 + (z1 - z0) is taken and z1 = 1e-30, it is 0 without a clamp."""
    rng = np.random.default_rng(4)
    viewport, at_ends = Viewport(0, 0, 64, 64, 0.0, 1.0), 0
    offset = np.array([SAMPLE_X[samples][0], SAMPLE_Y[samples][0]]) / 256
    for depths in ([0.3, 1e-30, 0.9], [0.7, 0.9, 1e-20], [1 / 3] * 3, [0.7, 0.1, 0.1], [1.0, 0.99999994, 1.0]):
        for _ in range(20):
            position = rng.integers(0, 64, (1, 3, 2)) + 0.5 + offset  # vertices on samples
            clip = from_ndc(position / 32 - 1, np.array([depths]), np.ones((1, 3))) * [1, -1, 1, 1]
            assembled = assemble(clip.astype(F), np.zeros((1, 3, 3), F), viewport, samples)
            z = draw(assembled, 64, 64, samples).depth
            z = z[z < 1]
            low, high = F(min(depths)), F(max(depths))
            assert ((z >= low) & (z <= high)).all(), f"{depths}: {z.min()} .. {z.max()}"
            at_ends += (z == low).any() and low < 0.1
    assert at_ends >= 3


def test_of_equal_depths_the_first_stays():
    clip, normal = make(inside, 1)
    clip, normal = np.repeat(clip, 3, 0), np.repeat(normal, 3, 0)
    drawn = draw(assemble(clip, normal, VIEWPORTS["whole"]), 64, 48, 1)
    assert set(drawn.visible.ravel()) == {-1, 0}
    assert drawn.counts[TileCount.SAMPLES_COVERED] == 3 * drawn.counts[TileCount.SAMPLES_PASSED] > 0


@by_samples
@pytest.mark.parametrize("family", [inside, crossing_near, huge], ids=lambda f: f.__name__)
def test_normals_are_interpolated_with_perspective(family, samples):
    """Colours 0.5 + 0.5 n at the pixel's centre, to half a step; both faces show the side towards the viewer."""
    viewport = VIEWPORTS["whole"]
    checked = fronts = backs = 0
    for k in range(12):
        clip, normal = (a[k : k + 1, [0, 2, 1] if k % 2 else [0, 1, 2]] for a in make(family, 12, seed=10))
        assembled = assemble(clip, normal, viewport, samples)
        drawn = draw(assembled, 64, 48, samples, shading=Shade.NORMAL)
        triangles = naive_triangles(clip, normal, viewport, samples)
        fronts += sum(not t.back for t in triangles)
        backs += sum(t.back for t in triangles)
        for row, column, s in np.argwhere(drawn.visible >= 0)[::5]:
            triangle = triangles[drawn.visible[row, column, s]]
            vertices = triangle.vertices
            x, y = 256 * column + 128, 256 * row + 128
            (x0, x1), (y0, y1) = ([f(getattr(v, a) for v in vertices) for f in (min, max)] for a in ("x", "y"))
            if not (x0 <= x <= x1 and y0 <= y <= y1):
                continue  # extrapolated, perhaps through infinity
            n = exact_attributes(vertices, x, y)
            if np.linalg.norm(n) < 1e-2:
                continue
            n = n / np.linalg.norm(n) * (-1 if triangle.back else 1)
            assert (abs(drawn.color[row, column, s, :3] - (0.5 + 0.5 * n) * 255) <= 0.5 + 255 * 16 * 2.0**-24).all()
            checked += 1
    assert checked > 200 and fronts and backs


def test_background_stays_where_nothing_is_drawn():
    clip, normal = make(small, 3)
    drawn = draw(assemble(clip, normal, VIEWPORTS["whole"]), 64, 48, 1)
    nothing = drawn.visible < 0
    assert (drawn.color[nothing] == [9, 8, 7, 6]).all() and (drawn.depth[nothing] == 1).all()
