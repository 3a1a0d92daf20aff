"""Counters balance: whatever enters a stage is charged to exactly one outcome. And each counter is defined, and moves."""

from collections import Counter
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

import tiler
from tests.scenes import flat_patch, looking_along_y, patch_scene, sliced
from tiler.config import Machine
from tiler.counters import DEFINITIONS, Counters
from tiler.frame import Frame
from tiler.queues import ENTRY_BYTES, PATCH_BYTES, TRIANGLE_BYTES, VERTEX_BYTES
from tiler.scene.model import Scene, Tessellation
from tiler.tally import TILE_COUNTERS

UNEVEN = (2, 3, 4, 5, 6, 2.5)
BINNING = (("triangle", "none"), ("patch", "none"), ("patch", "frame"))
CULL = ((), ("frustum",), ("frustum", "backface:tessellation_safe"))


# Scenes in which something rare happens.


def with_nan_patches(scene: Scene) -> Scene:
    """Two patches hold a NaN or an infinity."""
    points = scene.control_points.copy()
    points[1, 2, 3, 0], points[7, 0, 0, 2] = np.nan, np.inf
    return replace(scene, control_points=points)


RARE = {  # counter that moves: a flat patch all of whose triangles move it
    "rs_triangles": flat_patch(-1, -0.5, 1, 0.5),
    "su_culled_no_sample": flat_patch(-0.5, 0.003, 0.5, 0.004, y=-0.5),
    "su_culled_zero_area": flat_patch(-0.5, 0.25, 0.5, 0.25, y=-0.5),
    "su_culled_face": flat_patch(1, -0.5, -1, 0.5, y=0.3),
    "c_culled_outside": flat_patch(9, -0.5, 9.5, 0.5),
    "c_culled_nonfinite": flat_patch(2.5e38, 2.5e38, 3e38, 3e38),  # fits float32, its clip coordinates do not
}


def rare_events() -> Scene:
    """All of them, and one patch across the border of the picture."""
    return patch_scene([*RARE.values(), flat_patch(1.2, -0.5, 3.9, 0.5, y=-0.8)], factor=3.0)


def cases(load) -> dict[str, Scene]:
    small = {"size": (104, 60), "factor": 3}
    scenes = {name: load(name, **small) for name in tiler.scene_names()}
    teapot = load("teapot", **small)
    return scenes | {f"{name}-sliced": sliced(scene) for name, scene in scenes.items()} | {
        "teapot-4x": load("teapot", size=(104, 60), factor=5, samples=4),
        "waves-screen-space": load("waves", size=(104, 60), edge_pixels=9.0, partitioning="fractional_odd"),
        "spikelog-fractional-even": load("spikelog", **small | {"factor": UNEVEN, "partitioning": "fractional_even"}),
        "teapot-nan": with_nan_patches(teapot),
        "teapot-factor-0": replace(teapot, tessellation=Tessellation(factor=(3.0, 0.0, 3.0, 3.0, 3.0, 3.0))),
        "teapot-factor-nan": replace(teapot, tessellation=Tessellation(factor=(np.nan,) * 6)),
        "rare": rare_events(),
        "rare-both-faces": replace(rare_events(), face_cull="none"),
        "empty": patch_scene([]),
    }  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One simulated frame."""

    what: str
    scene: Scene
    machine: Machine
    frame: Frame

    @property
    def by_patch(self) -> bool:
        return self.machine.binning == "patch"


@pytest.fixture(scope="module")
def runs(load) -> list[Run]:
    """Every case on both binning modes, both domain caches, with and without culling."""
    made = []
    for name, scene in cases(load).items():
        for (binning, cache), cull in product(BINNING, CULL):
            machine = Machine(tile=16, binning=binning, domain_cache=cache, cull=cull, cores=5)
            frame = tiler.simulate(scene, machine, threads=1)
            made.append(Run(f"{name}, {binning}, cache {cache}, cull {cull}", scene, machine, frame))
    for (binning, cache), policy in product(BINNING, ("flush", "grow")):  # pools that are full
        machine = Machine(tile=16, binning=binning, domain_cache=cache, queue_pool=50_000, queue_policy=policy,
                          queue_model="blocks64", cores=5)  # fmt: skip
        scene = load("teapot", size=(104, 60), factor=3)
        if binning == "triangle":
            machine = machine.model_copy(update={"queue_pool": 90_000})
        frame = tiler.simulate(scene, machine, threads=1)
        made.append(Run(f"teapot, {binning}, cache {cache}, pool {policy}", scene, machine, frame))
    return made


def balance(run: Run, what: str, expected: int, measured: int) -> None:
    deviation = int(measured) - int(expected)
    assert deviation == 0, f"{run.what}: {what}: expected {expected}, measured {measured}, deviation {deviation:+}"


def test_patches_have_one_fate_each(runs):
    for run in runs:
        c = run.frame.counters
        balance(run, "patches of the scene", run.scene.num_patches, c["ia_primitives"])
        vertices = 16 * len(run.scene.control_points) + sum(mesh.surface.used_vertices for mesh in run.scene.meshes)
        balance(run, "control points", vertices, c["ia_vertices"])
        balance(run, "vertex shader", c["ia_vertices"], c["vs_invocations"])
        if run.scene.meshes:  # Gregory patches have 20
            assert 16 * c["hs_invocations"] <= c["hs_control_points"] <= 32 * c["hs_invocations"], run.what
        else:
            balance(run, "control-point phase", 16 * c["hs_invocations"], c["hs_control_points"])
        balance(run, "hull shader", c["ia_primitives"], c["hs_invocations"])
        culled = [name for name in DEFINITIONS if name.startswith("hs_culled_")]
        assert len(culled) >= 3
        fates = sum(c[name] for name in culled) + c["ts_culled_factor"] + c["ts_patches"]
        balance(run, "culled + tessellated patches", c["hs_invocations"], fates)
        binned = c["bin_patches"] + c["bin_patches_offscreen"]
        balance(run, "binned + offscreen patches", c["ts_patches"] if run.by_patch else 0, binned)


def test_pairs_are_queue_entries(runs):
    for run in runs:
        c, entries = run.frame.counters, run.frame.queues.entries
        balance(run, "sum of queue lengths", entries.sum(), c["queue_entries"])
        balance(run, "longest queue", entries.max(), c["queue_longest"])
        balance(run, "pairs", c["queue_entries"], c["bin_patch_tile_pairs"] + c["bin_triangle_tile_pairs"])
        balance(
            run, "pairs of the other kind", 0, c["bin_triangle_tile_pairs" if run.by_patch else "bin_patch_tile_pairs"]
        )
        assert c["bin_patches"] <= c["bin_patch_tile_pairs"] <= c["bin_patches"] * entries.size, run.what
        height, width = run.frame.depth.shape
        assert entries.shape == (-(-height // 16), -(-width // 16)) and entries.dtype == np.int64


def test_queue_memory_is_written_or_wasted(runs):
    for run in runs:
        c, memory = run.frame.counters, run.frame.queues.memory
        given = c["queue_bytes_written"] + c["queue_wasted_bytes"]
        balance(run, "bytes given out", memory.allocated_bytes, given)
        if c["queue_flushes"] == 0:
            balance(run, "peak of one pass", given, c["queue_peak_bytes"])
            balance(run, "tiles with a queue", np.count_nonzero(run.frame.queues.entries), c["queue_tile_passes"])
        if run.machine.queue_model == "ideal":
            balance(run, "bytes of the ideal", c["queue_bytes"], c["queue_bytes_written"])
        if run.machine.queue_policy == "flush":
            assert c["queue_flushes"] > 0 and c["queue_peak_bytes"] <= run.machine.queue_pool, run.what


def test_queue_bytes_follow_the_stated_layout(runs):
    for run in runs:
        c, queues = run.frame.counters, run.frame.queues
        balance(run, "bytes of the queues", queues.bytes, c["queue_bytes"])
        records = c["queue_bytes"] - ENTRY_BYTES * c["queue_entries"]
        if run.by_patch:
            balance(run, "patch records", PATCH_BYTES * c["bin_patches"], records)
        else:
            vertices, rest = divmod(records - TRIANGLE_BYTES * c["su_triangles"], VERTEX_BYTES)
            balance(run, "vertex records", 0, rest)
            assert min(3, c["su_triangles"]) <= vertices <= 3 * c["su_triangles"], run.what
            if c["c_cut"] == 0:
                assert vertices <= c["ts_domain_points"], run.what


def test_domain_points_follow_from_the_factors(runs):
    """Whole factors, all six equal to n: (n + 1)^2 points and 2 n^2 triangles a patch."""
    for run in runs:
        t, c = run.scene.tessellation, run.frame.counters
        if t.edge_pixels is None and t.partitioning == "integer" and len(set(t.factor)) == 1 and t.factor[0] > 1:
            n = int(t.factor[0])
            balance(run, "domain points", (n + 1) ** 2 * c["ts_patches"], c["ts_domain_points"])
            balance(run, "triangles", 2 * n * n * c["ts_patches"], c["ts_triangles"])


def test_domain_points_are_shaded_as_often_as_the_machine_says(runs, load):
    for run in runs:
        c = run.frame.counters
        if not run.by_patch:
            balance(run, "each live patch once", c["ts_domain_points"], c["ds_invocations"])
            continue
        t = run.scene.tessellation
        if t.edge_pixels is None and c["ts_patches"]:
            points = c["ts_domain_points"] // c["ts_patches"]  # fixed factors: the same for all
            times = c["bin_patches"] if run.machine.domain_cache == "frame" else c["bin_patch_tile_pairs"]
            balance(run, "points of a patch, each time it is shaded", points * times, c["ds_invocations"])


def test_frame_cache_shades_each_binned_patch_once(runs):
    """Also where patches differ in their points: then at most all live ones' points, and exactly where all are binned."""
    seen = 0
    for run in runs:
        c = run.frame.counters
        if run.by_patch and run.machine.domain_cache == "frame":
            assert c["ds_invocations"] <= c["ts_domain_points"], run.what
            if c["bin_patches_offscreen"] == 0:
                balance(run, "each binned patch once", c["ts_domain_points"], c["ds_invocations"])
                seen += c["bin_patch_tile_pairs"] > c["bin_patches"]
    assert seen > 5, "too few runs in which the cache could have been hit"


@pytest.mark.parametrize("name", tiler.scene_names())
def test_domain_cache_means_nothing_in_triangle_binning(name, load):
    scene = load(name, size=(104, 60), factor=3)
    plain, cached = (
        tiler.simulate(scene, Machine(binning="triangle", domain_cache=cache)) for cache in ("none", "frame")
    )
    assert dict(plain.counters) == dict(cached.counters)
    assert np.array_equal(plain.color, cached.color)


def test_triangles_have_one_fate_each(runs):
    for run in runs:
        c = run.frame.counters
        if not run.by_patch:
            balance(run, "triangles into the clipper", c["ts_triangles"], c["c_invocations"])
        elif run.scene.tessellation.edge_pixels is None and c["ts_patches"]:
            triangles = c["ts_triangles"] // c["ts_patches"]
            balance(run, "triangles of every pair", triangles * c["bin_patch_tile_pairs"], c["c_invocations"])
        whole = c["c_invocations"] - c["c_culled_outside"] - c["c_culled_nonfinite"] - c["c_cut"]
        fans = c["c_primitives"] - whole  # triangles that cut ones left as: 1 to 7 each
        assert whole >= 0 and c["c_cut"] <= fans <= 7 * c["c_cut"], f"{run.what}: {whole} whole, {fans} of fans"
        culled = [name for name in DEFINITIONS if name.startswith("su_culled_") and name != "su_culled_outside_tile"]
        assert len(culled) == 4
        balance(run, "set-up", c["c_primitives"], sum(c[name] for name in culled) + c["su_triangles"])
        if run.by_patch:
            balance(
                run,
                "set up = in the tile + outside",
                c["su_triangles"],
                c["rs_triangles"] + c["su_culled_outside_tile"],
            )
        else:
            balance(run, "rasterized = pairs", c["bin_triangle_tile_pairs"], c["rs_triangles"])
            balance(run, "outside a tile", 0, c["su_culled_outside_tile"])


def test_samples_have_one_fate_each(runs):
    for run in runs:
        c = run.frame.counters
        balance(
            run, "covered = passed + failed", c["rs_samples_covered"], c["om_samples_passed"] + c["om_samples_failed"]
        )
        balance(run, "visible samples", np.count_nonzero(run.frame.depth_samples < 1.0), c["om_samples_visible"])
        samples = run.scene.picture.samples
        assert c["om_samples_visible"] <= c["om_samples_passed"] <= samples * c["ps_invocations"], run.what
        assert c["ps_invocations"] <= c["om_samples_passed"], run.what
        if samples == 1:
            balance(run, "pixels = samples passed", c["om_samples_passed"], c["ps_invocations"])


def test_tiles_and_cores_add_up_to_the_totals(runs):
    for run in runs:
        frame, c = run.frame, run.frame.counters
        assert set(frame.tiles) == set(frame.cores) == set(TILE_COUNTERS)
        for name, tiles in frame.tiles.items():
            assert tiles.shape == frame.queues.entries.shape and frame.cores[name].shape == (5,)
            # In `triangle` binning the front end shades; tiles do not.
            total = 0 if name == "ds_invocations" and not run.by_patch else c[name]
            balance(run, f"{name} over all tiles", total, tiles.sum())
            balance(run, f"{name} over all cores", total, frame.cores[name].sum())
            for core in range(5):  # tile t is worked off by core t modulo cores
                balance(run, f"{name} of core {core}", tiles.ravel()[core::5].sum(), frame.cores[name][core])


def test_modes_agree_on_what_is_drawn(runs):
    """Per case: the rasterizer covers, and the output merger passes, the same samples in every mode and cull set."""
    first: dict[str, Run] = {}
    for run in runs:
        before = first.setdefault(run.what.split(",")[0], run)
        for name in ("rs_samples_covered", "om_samples_passed", "ps_invocations", "om_samples_visible"):
            balance(run, f"{name}, as in '{before.what}'", before.frame.counters[name], run.frame.counters[name])


FULL = [
    Machine(
        tile=64, coarse_z_block=4, cull=("occlusion", "occlusion:triangle", "occlusion:block"), domain_cache="lru:90"
    ),
    Machine(binning="subpatch", tile=8, subpatch_extent=2.0, bounds="tpatch"),
    Machine(binning="subpatch", tile=8, subpatch_extent=2.0, bounds="tpatch", cull=()),
    Machine(bounds="tpatch", cull=("frustum", "occlusion"), z_feedback="previous_frame", tile=8),
    Machine(bounds="tpatch", cull=("frustum", "occlusion"), occlusion_area="hull", coarse_z_block=4),
]


def test_every_counter_moves(runs, load):
    """In some run each counter is not zero: no identity holds because nothing happened."""
    total = Counter()
    frames = [run.frame for run in runs]
    scenes = load("colonnade", size=(104, 60), factor=3), sliced(load("waves", size=(104, 60), factor=3))
    frames += [tiler.simulate(scene, machine, frame=9) for scene, machine in product(scenes, FULL)]
    for frame in frames:
        total.update({name: int(value > 0) for name, value in frame.counters.items()})
    still = [name for name in DEFINITIONS if not total[name]]
    assert not still, f"never moved: {still}"


@pytest.mark.parametrize("counter", RARE)
def test_rare_events_are_charged_where_they_belong(counter):
    scene = patch_scene([RARE[counter]], factor=3.0)
    frame = tiler.simulate(scene, Machine(binning="triangle", cull=(), tile=64))
    moved = {name: value for name, value in frame.counters.items() if value and name in RARE}
    assert moved == {counter: 18}


def test_definitions_are_complete():
    assert len(DEFINITIONS) > 30
    for name, definition in DEFINITIONS.items():
        assert name == name.lower() and name.isidentifier()
        assert definition.stage and definition.unit, name
        assert definition.text.endswith(".") or definition.text.endswith(")."), name
        assert len(definition.text) > 15, name
    texts = [definition.text for definition in DEFINITIONS.values()]
    assert len(set(texts)) == len(texts)


def test_counters_that_direct3d_has_say_so():
    """All of D3D11_QUERY_DATA_PIPELINE_STATISTICS but geometry and compute shader, which this pipeline lacks."""
    fields = ("IAVertices", "IAPrimitives", "VSInvocations", "CInvocations", "CPrimitives", "PSInvocations", "HSInvocations",
              "DSInvocations")  # fmt: skip
    named = {name: d.same_as for name, d in DEFINITIONS.items() if d.same_as}
    assert sorted(part.split()[1] for text in named.values() for part in text.split(",") if "D3D11" in part) == sorted(
        fields
    )
    for name, text in named.items():
        field = next(f for f in fields if f in text)
        assert field.lower() == name.replace("_", ""), name


def test_counters_are_a_complete_mapping():
    values = dict.fromkeys(DEFINITIONS, 3)
    counters = Counters(values)
    assert list(counters) == list(DEFINITIONS) and len(counters) == len(DEFINITIONS)
    assert dict(counters) == values and all(type(v) is int for v in Counters({n: np.int64(2) for n in values}).values())
    with pytest.raises(KeyError):
        counters["no_such_counter"]
    with pytest.raises(TypeError):
        counters["ia_vertices"] = 1
    with pytest.raises(ValueError, match="ia_vertices"):
        Counters({name: 1 for name in DEFINITIONS if name != "ia_vertices"})
    with pytest.raises(ValueError, match="spare"):
        Counters(values | {"spare": 1})


def test_table_shows_each_counter_once():
    counters = Counters({name: 1234567 + i for i, name in enumerate(DEFINITIONS)})
    lines = counters.table().splitlines()
    assert len(lines) == len(DEFINITIONS)
    for i, (line, (name, definition)) in enumerate(zip(lines, DEFINITIONS.items(), strict=True)):
        words = line.split()
        assert name in words and f"{1234567 + i:,}" in words and line.endswith(definition.unit)


def test_cut_triangles_leave_fans():
    """A patch across the near plane: its cut triangles are known by hand."""
    # One quad, two triangles; u runs along y, through the near plane at y = -3.5 (4 - 0.5 in front of the eye).
    patch = flat_patch(-0.1, -0.1, 0.1, 0.1)
    patch[..., 1] = np.linspace(-3.75, -3.0, 4)[:, None]
    patch[..., 2] += np.linspace(0, 0.05, 4)[:, None]
    scene = patch_scene([patch], factor=1.0, camera=looking_along_y(4.0, near=0.5), face_cull="none")
    c = tiler.simulate(scene, Machine(binning="triangle")).counters
    assert (c["c_invocations"], c["c_cut"], c["c_primitives"]) == (2, 2, 3)  # one loses a corner, the other loses two
