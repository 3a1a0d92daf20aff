"""Control meshes to patches: against the limit surface of OpenSubdiv, against plain subdivision, and refused where wrong."""

import re

import numpy as np
import pytest

from pipeline import hull
from pipeline.subdivision.refine import make_step, move_points, refine_cage
from pipeline.subdivision.surface import Basis, make_surface
from pipeline.subdivision.topology import TopologyFault, make_rings, make_topology
from tests.cages import BOX_FACES, Reference, box, cage_of_faces, control_mesh, read_model
from tests.naive_domain import bernstein
from tests.naive_subdivision import NaiveSurface
from tiler.scene.arrays import ArrayFault
from tiler.scene.surfaces import surface_of
from tiler.validation.limit import PUBLISHED, child_of

U = 2.0**-24
SMOOTH = (
    "bigguy_subset", "boundary_valence_3_to_6", "cube", "grid_edge_and_corner", "grid_edge_only", "noisy_torus",
    "nonquads_open", "open_cube_corner_cut", "pole8", "pyramid_closed", "torus",
)  # fmt: skip
by_basis = pytest.mark.parametrize("basis", list(Basis), ids=lambda b: b.name.lower())


def evaluate(net, u, v):
    """Tensor-product Bezier net (m, n, 3) at (u, v), float64."""
    return np.einsum("i,ijc,j->c", bernstein(len(net) - 1, u), net.astype(np.float64), bernstein(net.shape[1] - 1, v))


def at(patches, p, u, v):
    """Position and normal (not unit) of a patch that is no Gregory patch; of one that is, on its edges."""
    b = patches.control_points[p][..., :3].astype(np.float64)
    tu, tv = np.diff(b, axis=0), np.diff(b, axis=1)
    if patches.tangent_id[p] >= 0:
        tu, tv = patches.tangent_u[patches.tangent_id[p]], patches.tangent_v[patches.tangent_id[p]]
    return evaluate(b, u, v), np.cross(evaluate(tu, u, v), evaluate(tv, u, v))


def evaluate_at(patches, face, uv):
    """Positions (n, m, 3) of the Bezier nets of patches `face` (n, m) at uv (n, m, 2)."""
    b = [
        np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3], -1) for t in (uv[..., 0], uv[..., 1])
    ]
    return np.einsum("nmi,nmj,nmijc->nmc", *b, patches.control_points[face][..., :3].astype(np.float64))


def unit(a):
    return a / np.linalg.norm(a)


@by_basis
@pytest.mark.parametrize("name", SMOOTH)
def test_patches_against_the_limit_surface(name, basis):
    reference = Reference(name)
    surface, _ = make_surface(reference.cage, basis)
    patches = hull.surface_patches(surface, reference.V.astype(np.float32), 0, 0)
    farthest = 0.0
    for row, p in zip(reference.ptex_rows, reference.patch, strict=True):
        irregular = surface.irregular_id[p] >= 0
        net = patches.control_points[p][..., :3].astype(np.float64)
        longest = max(np.linalg.norm(np.diff(net, axis=axis), axis=-1).max() for axis in (0, 1))
        for i, (u, v) in enumerate(reference.uv):
            on_edge, corner = {u, v} & {0, 1}, u in (0, 1) and v in (0, 1)
            position, normal = at(patches, p, u, v)
            off = np.linalg.norm(position - reference.P[row, i])
            if not irregular or corner:  # float32 control points of float32 vertices: a rounding each
                assert off <= 4 * U * abs(reference.V).max(), f"{name}, patch {p} at ({u}, {v})"
            elif on_edge or basis == Basis.ACC:
                farthest = max(farthest, off / reference.diagonal)
            exact = reference.N[row, i]
            if np.isfinite(exact).all() and (not irregular or (corner and basis == Basis.ACC)):
                # Two tangents, each a difference of points that are rounded twice.
                error = 24 * U * abs(reference.V).max() * longest / np.linalg.norm(normal)
                assert np.linalg.norm(unit(normal) - exact) <= error + 4 * U, f"{name}, patch {p} at ({u}, {v})"
    if (name, basis) in PUBLISHED:
        assert farthest <= PUBLISHED[name, basis]


def quads_of(name):
    """Points in float32 and cage of a reference model; after a step where it has other polygons."""
    reference = Reference(name)
    points, cage = reference.V.astype(np.float32), reference.cage
    if (np.diff(cage.face_first) != 4).any():
        topology, _ = make_topology(cage)
        points = move_points(make_step(topology), points.astype(np.float64)).astype(np.float32)
        cage = refine_cage(cage, topology)
    return points, cage


@by_basis
@pytest.mark.parametrize("name", SMOOTH)
def test_patches_that_are_not_regular_equal_the_twin(name, basis):
    """Every control point and vector is that of the spec's formulas in float64, rounded once."""
    points, cage = quads_of(name)
    naive = NaiveSurface(points.astype(np.float64), cage.face_vertices.reshape(-1, 4).tolist(), cage.keep_corners)
    surface, _ = make_surface(cage, basis)
    patches = hull.surface_patches(surface, points, -1, 0)
    rows = np.flatnonzero(surface.irregular_id >= 0)[:100]
    tables = (patches.tangent_u, patches.tangent_v) if basis == Basis.ACC else (patches.inner,)
    for p in rows:
        expected = naive.acc(p) if basis == Basis.ACC else naive.gregory(p)
        found = patches.control_points[p, ..., :3], *(table[surface.irregular_id[p]] for table in tables)
        for a, b in zip(found, expected, strict=True):
            # Weights hold cosines rounded to 2^-41: up to 12 of a valence, each at most 1 on a vertex.
            assert (abs(a - b) <= U * abs(b) + 2.0**-36 * abs(points).max()).all(), f"{name}, patch {p}"


@by_basis
@pytest.mark.parametrize("name", ["cube", "boundary_valence_3_to_6", "open_cube_corner_cut", "pole8", "pyramid_closed"])
def test_steps_bring_patches_nearer_to_the_limit(name, basis):
    """Three steps make every sample a corner, so exact. One step brings them nearer as the vertices' neighbourhoods shrink.

    What a patch lacks is linear in the net around a vertex, and that shrinks with every step by the subdominant eigenvalue
    lambda(n) of subdivision (spec section 7), ordinary neighbours by 1/2.
    """
    reference = Reference(name)
    points, cage = quads_of(name)
    points = points.astype(np.float64)
    valence = np.bincount(cage.face_vertices).max()
    c1, c2 = np.cos(np.pi / valence), np.cos(2 * np.pi / valence)
    slowest = (5 + c2 + c1 * np.sqrt(18 + 2 * c2)) / 16
    face = np.repeat(reference.patch[:, None], 16, axis=1)
    uv = np.repeat(reference.uv[None], len(face), axis=0)
    far = []
    for _ in range(4):
        surface, _ = make_surface(cage, basis)
        patches = hull.surface_patches(surface, points.astype(np.float32), -1, 0)
        position = evaluate_at(patches, face, uv)
        off = np.linalg.norm(position - reference.P[reference.ptex_rows], axis=2)
        inside = ((uv > 0) & (uv < 1)).all(axis=2) & (surface.irregular_id[face] >= 0) & (basis == Basis.GREGORY)
        far.append(np.where(inside, 0, off).max())
        topology, _ = make_topology(cage)
        points, cage = move_points(make_step(topology), points), refine_cage(cage, topology)
        face, uv = child_of(face, uv)
    assert 0 < far[1] <= max(slowest, 0.5) * far[0]
    assert far[3] <= 4 * U * abs(reference.V).max()


@pytest.mark.parametrize("name", ["bigguy_subset", "boundary_valence_3_to_6", "pole8"])
def test_corner_limits_of_vertices(name):
    reference = Reference(name)
    surface, _ = make_surface(reference.cage)
    patches = hull.surface_patches(surface, reference.V.astype(np.float32), 0, 0)
    if not surface.steps:
        corners = surface.layers[0].quad[:, [0, 1, 3, 2]]
        found = patches.control_points[:, [0, 3, 0, 3], [0, 0, 3, 3], :3]
        assert abs(found - reference.vertex_limit[corners]).max() <= 4 * U * abs(reference.V).max()
    normals = patches.corner_normals[: len(reference.V)]
    known = np.isfinite(reference.vertex_normal).all(1)
    assert abs(normals[known] - reference.vertex_normal[known]).max() < 1e-5 if not surface.steps else len(normals)


def stepped(cage, points, steps):
    """Cage and points after plain steps."""
    for _ in range(steps):
        topology, _ = make_topology(cage)
        points, cage = move_points(make_step(topology), points), refine_cage(cage, topology)
    return cage, points


def corner_points(surface, points, num_vertices):
    """Limit positions of the first vertices of the surface's cage, from a patch that each belongs to."""
    patches = hull.surface_patches(surface, points.astype(np.float32), -1, 0)
    quad = surface.layers[0].quad
    vertex, first = np.unique(quad, return_index=True)
    patch, k = np.unravel_index(first[vertex < num_vertices], quad.shape)
    return patches.control_points[patch, np.array([0, 3, 3, 0])[k], np.array([0, 0, 3, 3])[k], :3]


@pytest.mark.parametrize("name", ["cube_semisharp_creases", "torus_creases"])
def test_semi_sharp_steps_lead_to_the_limit_surface(name):
    """After 5 steps nothing is left of 4.7 and 5: the limit positions are exact."""
    reference = Reference(name)
    quads = reference.cage.face_vertices.reshape(-1, 4)
    cage, points = stepped(reference.cage, reference.V, 5)
    assert not (cage.crease_sharpness > 0).any()
    found = corner_points(make_surface(cage)[0], points, len(reference.V))
    assert abs(found[quads[:, 0]] - reference.P[:, 0]).max() <= 4 * U * abs(reference.V).max()


@pytest.mark.parametrize("name", ["cube_semisharp_creases", "torus_creases"])
def test_what_is_left_of_semi_sharp_tags_is_smooth_or_infinite(name):
    """The surface takes 4 steps: its 5, of which 1 is left, is one that never ends; its 4.7, of which 0.7 is left, is a 4."""
    reference = Reference(name)
    surface, warnings = make_surface(reference.cage)
    assert len(surface.steps) == 4 and "infinite" in warnings[0]
    sharpness = reference.cage.crease_sharpness
    told = np.select([sharpness >= 5, sharpness >= 4], [10, 4], sharpness).astype(np.float32)
    assert (told != sharpness).any()
    cage, points = stepped(reference.cage._replace(crease_sharpness=told), reference.V, 4)
    assert not ((cage.crease_sharpness > 0) & (cage.crease_sharpness < 6)).any()
    found, expected = (
        hull.surface_patches(s, p.astype(np.float32), -1, 0)
        for s, p in ((surface, reference.V), (make_surface(cage)[0], points))
    )
    largest = abs(reference.V).max()
    assert abs(found.control_points - expected.control_points).max() <= 4 * U * largest


def test_sharp_creases_split_the_limit():
    """A box with a ring of infinitely sharp edges: the ring is a cubic B-spline curve, whatever lies beside it."""
    top = [(4, 5), (5, 7), (7, 6), (6, 4)]
    points, cage = box(creases=top, sharpness=[10] * 4)
    surface, _ = make_surface(cage)
    patches = hull.surface_patches(surface, points, 0, 0)
    limit = patches.control_points[1, [0, 3, 3, 0], [0, 0, 3, 3], :3]  # face 1 is the top
    ring = points[[4, 5, 7, 6]].astype(np.float64)
    expected = (np.roll(ring, 1, axis=0) + 4 * ring + np.roll(ring, -1, axis=0)) / 6
    np.testing.assert_allclose(limit, expected, atol=4 * U)
    assert surface.irregular_id[1] >= 0  # one face between two sharp edges, but no corner
    _, far = stepped(cage, points.astype(np.float64), 8)
    np.testing.assert_allclose(far[[4, 5, 7, 6]], expected, atol=1e-4)
    # Its normals are the mean of both sides.
    assert (patches.corner_normals[4:8, 2] > 0.2).all() and (abs(patches.corner_normals[4:8, :2]).max(1) > 0.2).all()


def test_all_edges_sharp_make_a_polyhedron():
    edges = sorted({tuple(sorted(pair)) for f in BOX_FACES for pair in zip(f, f[1:] + f[:1], strict=True)})
    points, cage = box(creases=edges, sharpness=[10] * len(edges))
    surface, _ = make_surface(cage)
    patches = hull.surface_patches(surface, points, -1, 0)
    assert (surface.irregular_id < 0).all()
    i = np.arange(4) / 3
    for net, face in zip(patches.control_points, BOX_FACES, strict=True):
        a, b, c, d = points[face].astype(np.float64)
        u, v = i[:, None, None], i[None, :, None]
        np.testing.assert_allclose(
            net[..., :3], (1 - u) * ((1 - v) * a + v * d) + u * ((1 - v) * b + v * c), atol=4 * U
        )


@by_basis
@pytest.mark.parametrize("refine", ["none", "uniform", "adaptive"])
def test_refinement_keeps_the_limit_at_vertices(refine, basis):
    points, cage = read_model("subdbox")
    plain, _ = make_surface(cage, basis)
    surface, _ = make_surface(cage, basis, refine)
    assert surface.num_patches == {"none": 90, "uniform": 360, "adaptive": 36 + 4 * 54}[refine]
    before = hull.surface_patches(plain, points, -1, 0).control_points[:, 0, 0]
    after = hull.surface_patches(surface, points, -1, 0).control_points[:, 0, 0]
    for corner in before:
        assert abs(after - corner).max(axis=1).min() <= 8 * U * abs(points).max()


def test_models_refine_as_published():
    """Loop 2011: MonsterFrog has 5168 patches after one step, BigGuy 3226 different ones after an adaptive one."""
    _, frog = read_model("monsterfrog")
    _, guy = read_model("bigguy")
    assert make_surface(frog)[0].num_patches == 1292
    assert make_surface(frog, refinement="uniform")[0].num_patches == 5168
    adaptive, _ = make_surface(guy, refinement="adaptive")
    assert adaptive.num_patches == 3226 and len(adaptive.layers[0].quad) == 858


def test_texture_seams_stay():
    """Each face has its own square; after a step each of its four children has a quarter of it."""
    _, cage = box()
    surface, _ = make_surface(cage, refinement="uniform")
    texcoords = surface.texcoords.reshape(6, 4, 4, 2)
    centre = np.array([0.5, 0.5])
    for child, corner in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)]):
        for face in range(6):
            np.testing.assert_array_equal(texcoords[face, child, 0], corner)
            np.testing.assert_array_equal(texcoords[face, child, 3], centre)


FAULTS = {
    "face 1 has 2 vertices": ([[0, 1, 2, 3], [4, 5]], 6),
    "face 0 names vertex 9; allowed: 0 to 5": ([[0, 1, 2, 9]], 6),
    "face 0 names vertex -1": ([[0, 1, 2, -1]], 6),
    "face 0 has vertex 1 twice": ([[0, 1, 2, 1]], 6),
    r"edge \(0, 1\) belongs to faces \[0, 1, 2\]": ([[0, 1, 2, 3], [1, 0, 4, 5], [0, 1, 6, 7]], 8),
    r"faces 0 and 1 run along their edge \(0, 1\) in the same direction": ([[0, 1, 2, 3], [0, 1, 4, 5]], 6),
    "vertex 0 joins two fans": ([[0, 1, 2, 3], [0, 4, 5, 6]], 7),
    "vertex 4 is inside the mesh and has two faces": ([[0, 1, 4, 3], [1, 2, 3, 4]], 5),
    "the mesh has no face": ([], 3),
}


@pytest.mark.parametrize("text", FAULTS)
def test_what_is_no_surface_is_refused(text):
    faces, num_vertices = FAULTS[text]
    cage = cage_of_faces(faces or [[]], num_vertices)
    cage = cage if faces else cage._replace(face_first=np.zeros(1, np.int32))
    with pytest.raises(TopologyFault, match=text):
        make_surface(cage)
    joined = re.sub("(names vertex [-0-9]+)", r"\1 in made for a test", text)
    with pytest.raises(ArrayFault, match="is no surface: .*" + joined):
        surface_of([control_mesh(np.zeros((num_vertices, 3)), cage)], "acc", "none")


def test_warnings():
    points, cage = box(creases=[(0, 7), (0, 1)], sharpness=[2, 10])
    cage = cage._replace(
        num_vertices=10, corner_vertices=np.array([77], np.int32), corner_sharpness=np.ones(1, np.float32)
    )
    surface, warnings = make_surface(cage)
    assert surface.used_vertices == 8 and surface.num_vertices == 10
    texts = " | ".join(warnings)
    assert "2 vertices belong to no face, the first is 8: dropped" in texts
    assert "1 creases lie on no edge, the first on (0, 7)" in texts and "1 corner tags name no vertex" in texts
    alone = hull.surface_patches(surface, np.concatenate([points, np.full((2, 3), np.nan, np.float32)]), 0, 0)
    assert np.isfinite(alone.control_points).all()


@by_basis
@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38])
def test_nonfinite_points_flag_their_patches_only(value, basis):
    points, cage = read_model("subdbox")
    surface, _ = make_surface(cage, basis)
    points[5, 1] = value
    with np.errstate(over="ignore", invalid="ignore"):
        patches = hull.surface_patches(surface, points, -1, 0)
    flags = hull.flag_nonfinite(patches, np.zeros((0, 2)))
    near = (surface.layers[0].quad == 5).any(axis=1)
    assert flags[near].all() == (not np.isfinite(value)) and not flags.all()  # of 3e38 a share is finite in float32
    alive = np.flatnonzero(flags == 0)
    for table, row in ((patches.tangent_u, patches.tangent_id), (patches.inner, patches.gregory_id)):
        assert np.isfinite(table[row[alive][row[alive] >= 0]]).all()


def test_rings_are_in_order():
    """Each corner's ring continues across the edge to the vertex before it, counter-clockwise."""
    _, cage = read_model("osd_gregory_test1")
    topology, _ = make_topology(cage)
    rings = make_rings(topology)
    assert sorted(rings.corner) == list(range(len(topology.vertex)))
    for s, closed in enumerate(rings.closed):
        ring = rings.corner[rings.first[s] : rings.first[s + 1]]
        assert len(set(topology.vertex[ring])) == 1
        ahead = topology.vertex[topology.next[np.roll(ring, -1)]]
        behind = topology.vertex[topology.prev[ring]]
        np.testing.assert_array_equal(ahead[: None if closed else -1], behind[: None if closed else -1])
