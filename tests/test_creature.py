"""The creature: what it is made of, refined as Catmull-Clark says, the same everywhere, its hide closed, its walk."""

import hashlib

import numpy as np
import pytest

from tiler.scene import creature, creature_walk
from tiler.scene.builders import MESH_BUILDERS
from tiler.scene.cage import refine, strip_texcoords
from tiler.scene.creature import Parameters
from tiler.scene.maps import MAPS
from tiler.scene.mesh_counts import count_mesh
from tiler.scene.skinning import strongest_four

FULL, SMALL, CAGE = Parameters(), Parameters(cage="small", steps=0), Parameters(steps=0)


@pytest.mark.parametrize(
    ("parameters", "faces", "valences"),
    [
        (FULL, 3104, {3: 68, 4: 2986, 5: 46, 6: 4, 7: 2}),
        (CAGE, 194, {3: 68, 4: 76, 5: 46, 6: 4, 7: 2}),
        (SMALL, 104, None),
    ],
)
def test_what_it_is_made_of(parameters, faces, valences):
    mesh = creature.build(parameters)
    counts = count_mesh(mesh)
    assert counts.faces == MESH_BUILDERS["creature"].num_faces(parameters) == faces
    assert counts.faces_of_size == {4: faces} and counts.components == 1
    assert counts.boundary_edges == counts.nonmanifold_edges == counts.flipped_edges == counts.split_vertices == 0
    assert counts.vertices - counts.edges + counts.faces == 2
    assert min(counts.interior_valences) == 3 and max(counts.interior_valences) == 7
    assert valences is None or counts.interior_valences == valences
    assert counts.faces_without_texcoords == 0 and counts.seam_edges > 0 and 0.3 < counts.texture_area < 1
    assert mesh.texcoords.min() >= 0 and mesh.texcoords.max() <= 1
    assert (mesh.vertices * 65536 == np.rint(mesh.vertices * 65536)).all()
    assert signed_volume(mesh) > 10  # the outside is outside


def signed_volume(mesh):
    p = mesh.vertices[creature.quads_of(mesh)].astype(np.float64)
    tetrahedra = [np.einsum("qc,qc->q", p[:, 0], np.cross(p[:, i], p[:, i + 1])) for i in (1, 2)]
    return sum(t.sum() for t in tetrahedra) / 6


def test_left_and_right_are_mirror_images():
    points = creature.build(FULL).vertices
    mirrored = points * np.array([1, -1, 1], np.float32)
    nearest = np.abs(points[:, None] - mirrored[None]).max(axis=2).min(axis=1)
    assert nearest.max() <= 2**-15


DIGESTS = {"full": "27e641d6e2b241dd", "small": "88b7f921d9bc3e31"}


@pytest.mark.parametrize(("kind", "digest"), DIGESTS.items())
def test_the_same_bits_everywhere(kind, digest):
    parameters = FULL if kind == "full" else SMALL
    mesh, skin = creature_walk.build_walking(parameters)
    content = hashlib.sha256()
    for array in (*mesh[1:6], *skin, MAPS["hide" if kind == "full" else "small_hide"](256, 1)):
        content.update(array.tobytes())
    assert content.hexdigest()[:16] == digest


def naive_step(points, faces):
    """Catmull-Clark vertex points by loops over faces and edges."""
    centre = [sum(points[v] for v in f) / 4 for f in faces]
    around, edges = {}, {}
    for f, face in enumerate(faces):
        for k in range(4):
            around.setdefault(face[k], []).append(f)
            edges.setdefault(frozenset((face[k], face[(k + 1) % 4])), []).append(f)
    vertex = []
    for v in range(len(points)):
        n = len(around[v])
        q = sum(centre[f] for f in around[v]) / n
        r = sum(sum(points[w] for w in e) / 2 for e in edges if v in e) / n
        vertex.append((q + 2 * r + (n - 3) * points[v]) / n)
    edge = {e: (sum(points[w] for w in e) + sum(centre[f] for f in both)) / 4 for e, both in edges.items()}
    return vertex, edge, centre


def test_a_step_is_catmull_clark():
    cage = creature.make_cage("small")
    points, faces, uv = np.array(cage.points), np.array(cage.faces), np.array(cage.texcoords)
    new, quads, new_uv = refine(points, faces, uv)
    vertex, edge, centre = naive_step(points, faces)
    assert len(new) == len(vertex) + len(edge) + len(centre) and len(quads) == 4 * len(faces)
    for f, face in enumerate(faces):
        for k in range(4):
            a, b, c, d = new[quads[4 * f + k]]
            before, after = frozenset((face[k - 1], face[k])), frozenset((face[k], face[(k + 1) % 4]))
            for got, wanted in ((a, vertex[face[k]]), (b, edge[after]), (c, centre[f]), (d, edge[before])):
                assert got == pytest.approx(wanted, abs=1e-12)
            corner, middle = uv[f, k], uv[f].mean(axis=0)
            ends = (corner + uv[f, (k + 1) % 4]) / 2, (corner + uv[f, k - 1]) / 2
            assert new_uv[4 * f + k] == pytest.approx(np.array([corner, ends[0], middle, ends[1]]), abs=1e-12)


@pytest.mark.parametrize(("kind", "steps", "name"), [("full", 2, "hide"), ("small", 0, "small_hide")])
@pytest.mark.parametrize("size", [256, 512])
def test_the_hide_is_zero_along_all_seams(kind, steps, name, size):
    """So a bilinear lookup gives 0 on both sides of every seam, and the displaced creature is closed."""
    texels = MAPS[name](size, 3)
    assert texels.max() > 0.8 and (texels > 0.1).mean() > 0.3
    ends = creature.seam_segments(Parameters(cage=kind, steps=steps))
    assert len(ends) > 40
    along = np.linspace(0, 1, 200)[None, :, None]
    at = (ends[:, :1] + along * (ends[:, 1:] - ends[:, :1])).reshape(-1, 2) * size - 0.5
    low = np.floor(at).astype(int)
    for dj, di in ((0, 0), (0, 1), (1, 0), (1, 1)):
        i, j = (low[:, 0] + di).clip(0, size - 1), (low[:, 1] + dj).clip(0, size - 1)
        assert not texels[j, i].any()


def test_charts_do_not_overlap():
    """Except through extruded features, which lie inside the faces that they came out of."""
    for kind in ("full", "small"):
        uv = np.array(creature.make_cage(kind).texcoords)
        cross = np.roll(uv, -1, axis=1)
        areas = (uv[..., 0] * cross[..., 1] - uv[..., 1] * cross[..., 0]).sum(axis=1) / 2
        assert (np.abs(areas) > 1e-6).all()
        samples = 0.9 * uv.mean(axis=1, keepdims=True)[:, 0] + 0.1 * uv[:, 0]
        inside = np.ones((len(samples), len(uv)), bool)
        for k in range(4):
            a, b = uv[:, k], uv[:, (k + 1) % 4]
            side = (b - a)[None, :, 0] * (samples[:, None, 1] - a[None, :, 1]) - (b - a)[None, :, 1] * (
                samples[:, None, 0] - a[None, :, 0]
            )
            inside &= side * np.sign(areas)[None] > 0
        assert (inside.sum(axis=1) == 1).all()


def test_strip_is_as_long_and_wide_as_the_tube():
    ring = np.array([(0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, -1)], float)
    uv = np.array(strip_texcoords(np.stack([ring, ring + [2, 0, 0]]), (0.25, 0.5), 0.125))
    assert uv.shape == (2, 5, 2) and uv[:, :, 0].tolist() == [[0.25] * 5, [0.5] * 5]
    assert np.diff(uv[0, :, 1]) == pytest.approx(np.sqrt(2) / 8, abs=1e-3) and uv[0, 2, 1] == 0.5


@pytest.mark.parametrize("parameters", [FULL, SMALL])
def test_walk(parameters):
    mesh, skin = creature_walk.build_walking(parameters)
    count = len(mesh.vertices)
    assert skin.bone_index.shape == skin.bone_weight.shape == (count, 4) and skin.bone_index.dtype == np.int32
    assert (skin.bone_weight.astype(np.float64).sum(axis=1) == 1).all() and (skin.bone_weight >= 0).all()
    assert (np.diff(skin.bone_weight, axis=1) <= 2**-15).all()
    keys, bones = skin.bone_transform.shape[:2]
    assert bones == len(creature.BONES) == 17 and skin.bone_index.max() < bones and len(skin.key_frame) == keys
    assert skin.key_frame[0] == 0 and skin.key_frame[-1] == creature_walk.FRAMES and (np.diff(skin.key_frame) > 0).all()
    turns = skin.bone_transform[..., :3].astype(np.float64)
    assert np.abs(turns @ turns.transpose(0, 1, 3, 2) - np.eye(3)).max() < 1e-3
    rest = np.concatenate([mesh.vertices, np.ones((count, 1))], axis=1)
    posed = np.einsum("vb,kvbrc,vc->kvr", skin.bone_weight, skin.bone_transform[:, skin.bone_index], rest)
    # It goes 2 strides along +x, comes back to the same pose, never sinks, and each leg is lifted once a cycle.
    cycle = creature_walk.CYCLE // creature_walk.KEY_EVERY
    shift = posed[cycle] - posed[0]
    assert np.abs(shift - [creature_walk.STRIDE, 0, 0]).max() < 1e-3
    assert posed[..., 2].min() > -0.2 and np.ptp(posed[..., 2].min(axis=1)) < 0.2
    for leg in creature.LEGS:
        foot = np.isin(skin.bone_index[:, 0], [creature.BONES.index(f"{leg} foot")])
        height = posed[:, foot, 2].min(axis=1)
        assert foot.any() and np.ptp(height) > 0.05


def test_strongest_four():
    weights = np.array([[0.5, 0, 0.25, 0.125, 0.125, 0], [0, 0, 0, 0, 0, 1], [0.1, 0.2, 0.1, 0.2, 0.2, 0.2]])
    index, weight = strongest_four(weights)
    assert index[0].tolist() == [0, 2, 3, 4] and weight[0].tolist() == [0.5, 0.25, 0.125, 0.125]
    assert index[1, 0] == 5 and weight[1].tolist() == [1, 0, 0, 0]
    assert index[2].tolist() == [1, 3, 4, 5] and weight[2].tolist() == [0.25] * 4
