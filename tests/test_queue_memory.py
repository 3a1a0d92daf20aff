"""Queue memory: against a slow twin that allocates chunk by chunk, by hand, and at the ends of what is allowed."""

import math

import numpy as np
import pytest

from tests.naive_queue_memory import NaiveQueueMemory, Overflow
from tiler.binning import TileQueues, bin_boxes
from tiler.errors import TilerError
from tiler.grid import Grid, make_grid
from tiler.host import Host
from tiler.queue_memory import Items, QueueMemory, patch_items, split_queues, subpatch_items
from tiler.queue_models import QueueModel, load_queue_model, queue_model_names

SOURCE = {"title": "made for a test", "source": "invented"}
ODD = {
    "flat": QueueModel.model_validate(SOURCE | {
        "entry": {"triangle": 3, "patch": 5, "subpatch": 7},
        "record": {"triangle": 11, "vertex": 13, "patch": 17, "subpatch": 2, "block_bytes": 64},
        "level": [{"side": 1, "chunk_entries": 3, "link_bytes": 2, "header_bytes": 1}],
    }),
    "cascade": QueueModel.model_validate(SOURCE | {
        "scheme": "cascade", "record": {"triangle": 40, "vertex": 1},
        "level": [{"side": 1, "chunk_entries": 2, "static_chunks": 1},
                  {"side": 4, "chunk_entries": 4, "link_bytes": 3, "header_bytes": 5, "streams": 3, "stream_batch": 2}],
    }),
    "hierarchy": QueueModel.model_validate(SOURCE | {
        "scheme": "hierarchy", "spread": 2, "record": {"triangle": 1, "patch": 9, "block_bytes": 16},
        "level": [{"side": 1, "header_bytes": 2, "static_chunks": 1, "chunk_bytes": 25, "link_bytes": 1},
                  {"side": 2, "chunk_bytes": 40, "link_bytes": 4}, {"side": 8}],
    }),
}  # fmt: skip
MODELS = {name: load_queue_model(name) for name in queue_model_names()} | {f"odd-{k}": m for k, m in ODD.items()}


class Work:
    """Random queues of one batch."""

    def __init__(self, seed: int, binning: str, grid: Grid, batches: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.grid, self.binning = grid, binning
        self.parts = []
        next_patch = int(rng.integers(0, 5))
        for _ in range(batches):
            patches = int(rng.integers(1, 12))
            owner = np.sort(rng.integers(0, patches, int(rng.integers(1, 60)))).astype(np.int32)
            if binning == "patch":
                owner = np.arange(len(owner), dtype=np.int32)
            live = (next_patch + np.cumsum(rng.integers(1, 3, len(owner) if binning == "patch" else patches))).astype(
                np.int32
            )
            next_patch = int(live[-1]) + 1
            box = self.boxes(rng, len(owner))
            with Host(1) as host:
                seen = (rng.random(len(owner)) < 0.9).astype(np.int32)
                queues = bin_boxes(np.arange(len(owner) + 1, dtype=np.int64), seen, box, grid, host)
            if binning == "triangle":
                corner = rng.integers(0, 4, (len(owner), 3)) + 4 * owner[:, None]
                items = Items(live[owner], corner.astype(np.int32), 4 * patches)
            elif binning == "subpatch":
                items = subpatch_items(live[owner])
            else:
                items = patch_items(live)
            self.parts.append((queues, items))

    def boxes(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Most items are small, some cover many tiles."""
        size = np.array([self.grid.width, self.grid.height])
        middle = rng.random((n, 2)) * size
        reach = rng.random((n, 2)) * size * rng.choice([0.01, 0.1, 1.0], (n, 1), p=[0.6, 0.3, 0.1])
        corners = np.concatenate([middle - reach / 2, middle + reach / 2], axis=1)
        return np.clip(corners, 0, np.tile(size - 1, 2)).astype(np.int16)


def tiles_by_item(queues: TileQueues, n: int, grid: Grid) -> list[list[tuple[int, int]]]:
    tiles = [[] for _ in range(n)]
    for tile in range(grid.num_tiles):
        for item in queues.item[queues.first[tile] : queues.first[tile + 1]]:
            tiles[item].append((tile % grid.tiles_x, tile // grid.tiles_x))
    return tiles


def run_naively(work: Work, model: QueueModel, **limits: object) -> NaiveQueueMemory:
    twin = NaiveQueueMemory(model, work.binning, work.grid.tiles_x, work.grid.tiles_y, **limits)
    for batch, (queues, items) in enumerate(work.parts):
        for i, tiles in enumerate(tiles_by_item(queues, len(items.owner), work.grid)):
            shared = [(batch, int(name)) for name in items.shared[i]]
            twin.append(i, int(items.owner[i]), tiles, shared)
    twin.finish()
    return twin


def assert_same(memory: QueueMemory, twin: NaiveQueueMemory, what: object) -> None:
    grid, report = memory.grid, memory.report()
    expected = twin.counters(1 << grid.tile_log2, grid.width, grid.height, memory.samples)
    assert report.counters() == expected, what
    assert (report.entries_written, report.entries_read) == (twin.entries_written, twin.entries_read), what
    shape = (grid.tiles_y, grid.tiles_x)
    assert np.array_equal(report.tile_bytes, np.reshape(list(twin.tile_bytes.values()), shape)), what
    assert np.array_equal(report.tile_passes, np.reshape(list(twin.tile_passes.values()), shape)), what
    assert (report.longest_tile, report.longest_patch) == twin.longest(), what
    ordered = sorted(twin.tile_bytes.values())
    for p, value in report.percentiles.items():
        assert value == ordered[max(1, math.ceil(p / 100 * len(ordered))) - 1], (what, p)
    assert int(memory.sums[10]) == twin.capacity, what


@pytest.mark.parametrize("binning", ["triangle", "patch", "subpatch"])
@pytest.mark.parametrize("name", MODELS)
def test_lists_are_those_of_the_slow_twin(name, binning):
    model = MODELS[name]
    for seed in range(8):
        grid = make_grid(*[(90, 70), (64, 8), (33, 129), (1, 1)][seed % 4], 8)
        work = Work(seed, binning, grid, batches=1 + seed % 3)
        memory = QueueMemory(model, binning, grid, samples=4)
        for part in work.parts:
            assert memory.append(*part) == [part[0]]
        twin = run_naively(work, model)
        assert_same(memory, twin, (name, binning, seed))
        report = memory.report()
        assert report.allocated_bytes == report.peak_bytes == report.bytes_written + report.wasted_bytes


@pytest.mark.parametrize("policy", ["grow", "flush"])
@pytest.mark.parametrize("name", MODELS)
def test_full_pools_are_those_of_the_slow_twin(name, policy):
    model, moved, failed = MODELS[name], 0, 0
    if model.record.block_bytes > 256:  # the work is small
        model = model.model_copy(update={"record": model.record.model_copy(update={"block_bytes": 256})})
    for seed in range(12):
        binning = ("triangle", "patch", "subpatch")[seed % 3]
        grid = make_grid(90, 70, 16)
        work = Work(100 + seed, binning, grid, batches=1 + seed % 2)
        unlimited = run_naively(work, model, policy="grow", pool=1 << 40)
        pool = unlimited.static + int((unlimited.peak - unlimited.static) * (0.2 + 0.1 * (seed % 6))) + 1
        memory = QueueMemory(model, binning, grid, pool=pool, policy=policy)
        try:
            twin = run_naively(work, model, policy=policy, pool=pool)
        except Overflow as overflow:
            with pytest.raises(TilerError, match=f"machine.queue_pool: {pool} .* need {overflow.needed} bytes"):
                for part in work.parts:
                    memory.append(*part)
            failed += 1
            continue
        parts = [memory.append(*part) for part in work.parts]
        assert_same(memory, twin, (name, policy, seed))
        moved += twin.flushes + twin.grows
        report = memory.report()
        if policy == "flush":
            assert report.peak_bytes <= pool
            assert sum(map(len, parts)) >= 1 + twin.flushes - len(work.parts)
        else:
            assert report.flushes == 0 and report.spilled_bytes == 0
    assert moved > 3, "no pool was full"
    assert failed < 10


def test_parts_hold_each_entry_once_in_order():
    work = Work(5, "patch", make_grid(90, 70, 8))
    ((queues, _),) = work.parts
    n = int(queues.item.max())
    cuts = np.array([0, 3, 4, n // 2 + 5, n + 7])
    parts = split_queues(queues, cuts)
    runs = [set(np.searchsorted(cuts, part.item, side="right").tolist()) for part in parts]
    assert all(len(run) == 1 for run in runs) and [min(run) for run in runs] == sorted(min(run) for run in runs)
    for tile in range(len(queues.first) - 1):
        whole = queues.item[queues.first[tile] : queues.first[tile + 1]]
        pieces = [part.item[part.first[tile] : part.first[tile + 1]] for part in parts]
        assert np.array_equal(np.concatenate(pieces), whole)
    assert split_queues(queues, cuts[:0])[0] is queues
    empty = TileQueues(np.zeros(5, np.int64), np.zeros(0, np.int32))
    assert split_queues(empty, cuts[:0]) == [empty]


def one_tile(items: int) -> TileQueues:
    return TileQueues(np.array([0, items]), np.arange(items, dtype=np.int32))


def test_a_list_by_hand():
    """30 commands in blocks of 29: two blocks of 280 bytes; 30 patch records of 24 in one block of 64 KiB."""
    model = load_queue_model("blocks29")
    memory = QueueMemory(model, "patch", make_grid(64, 64, 64))
    memory.append(one_tile(30), patch_items(np.arange(30, dtype=np.int32)))
    report = memory.report()
    assert report.chunks == 2
    assert report.peak_bytes == 2 * 280 + 65536
    assert report.bytes_written == 30 * 9 + 2 * 19 + 30 * 24
    assert report.bytes_read == 30 * 9 + 2 * 19 + 30 * 24
    assert report.wasted_bytes == 2 * 280 + 65536 - report.bytes_written
    assert report.tile_bytes.tolist() == [[30 * 9 + 2 * 19]]


def test_a_touched_tile_takes_a_block_of_4096():
    memory = QueueMemory(load_queue_model("blocks64"), "triangle", make_grid(32, 32, 32))
    items = Items(np.zeros(65, np.int32), np.tile(np.arange(3, dtype=np.int32), (65, 1)), 3)
    memory.append(one_tile(65), items)
    assert memory.report().peak_bytes == 2 * 4096 + 65 * 100


def test_a_flush_by_hand():
    """The pool holds two patches: five patches take three passes, and the tile is stored and loaded twice."""
    ideal = load_queue_model("ideal")
    memory = QueueMemory(ideal, "patch", make_grid(8, 8, 8), pool=56, policy="flush")
    parts = memory.append(one_tile(5), patch_items(np.arange(5, dtype=np.int32)))
    assert [part.item.tolist() for part in parts] == [[0, 1], [2, 3], [4]]
    report = memory.report()
    assert (report.flushes, report.peak_bytes, report.bytes_written) == (2, 56, 5 * 28)
    assert report.tile_passes.tolist() == [[3]] and report.spilled_bytes == 2 * 2 * 64 * 8


def test_a_pool_of_nothing_but_first_chunks():
    """Two entries fit into the chunk that the list has from the start; nothing is ever taken from the pool."""
    level = {"chunk_entries": 2, "static_chunks": 1}
    model = QueueModel.model_validate(SOURCE | {"level": [level]})
    memory = QueueMemory(model, "patch", make_grid(8, 8, 8), pool=8, policy="flush")
    parts = memory.append(one_tile(5), patch_items(np.arange(5, dtype=np.int32)))
    assert [part.item.tolist() for part in parts] == [[0, 1], [2, 3], [4]]
    report = memory.report()
    assert (report.flushes, report.chunks, report.peak_bytes, report.wasted_bytes) == (2, 3, 8, 4)


def test_the_patch_of_the_longest_queue():
    """Patch 7 has most triangles in it; of patches with as many, the one with more elsewhere; then the earlier."""
    owner = np.array([3, 3, 7, 7, 7, 9, 9, 9], np.int32)
    queues = TileQueues(np.array([0, 8, 9]), np.array([0, 1, 2, 3, 4, 5, 6, 7, 7], np.int32))
    grid = make_grid(16, 8, 8)
    for extra, expected in ((queues, 9), (TileQueues(np.array([0, 8, 8]), queues.item[:8]), 7)):
        memory = QueueMemory(load_queue_model("ideal"), "triangle", grid)
        memory.append(extra, Items(owner, np.zeros((8, 3), np.int32), 1))
        report = memory.report()
        assert (report.longest_tile, report.longest_patch) == (0, expected)
    nothing = QueueMemory(load_queue_model("ideal"), "patch", grid)
    nothing.append(TileQueues(np.zeros(3, np.int64), np.zeros(0, np.int32)), patch_items(np.zeros(0, np.int32)))
    assert (nothing.report().longest_tile, nothing.report().longest_patch) == (-1, -1)


# Extremes.


@pytest.mark.parametrize("name", queue_model_names())
def test_a_million_patches_in_one_tile(name):
    n = 1_000_000
    model = load_queue_model(name)
    memory = QueueMemory(model, "patch", make_grid(100, 40, 8), name=name)
    first = np.zeros(memory.grid.num_tiles + 1, np.int64)
    first[14:] = n
    memory.append(TileQueues(first, np.arange(n, dtype=np.int32)), patch_items(np.arange(n, dtype=np.int32)))
    report = memory.report()
    assert report.entries_written == (2 * n if model.scheme == "cascade" else n)
    assert report.longest_tile == 13 and report.longest_patch == 0
    assert report.percentiles[100] >= n * model.entry.patch
    assert report.tile_bytes.ravel()[13] == report.percentiles[100]


@pytest.mark.parametrize("name", queue_model_names())
def test_one_patch_over_every_tile(name):
    grid = make_grid(2048, 2048, 8)
    n = grid.num_tiles
    memory = QueueMemory(load_queue_model(name), "patch", grid, name=name)
    memory.append(TileQueues(np.arange(n + 1), np.zeros(n, np.int32)), patch_items(np.zeros(1, np.int32)))
    report = memory.report()
    assert report.longest_patch == 0 and report.tile_passes.sum() == n
    expected = {"hierarchy16": 32 * 32, "bins128": n + 16 * 16}.get(name, n)
    assert report.entries_written == expected


def test_pools_that_hold_nothing_are_refused():
    grid = make_grid(90, 70, 16)
    hierarchy = load_queue_model("hierarchy16")
    with pytest.raises(TilerError, match=r"machine.queue_pool: 100 is less than the \d+ bytes that the lists of h16"):
        QueueMemory(hierarchy, "patch", grid, name="h16", pool=100, policy="flush")
    assert QueueMemory(hierarchy, "patch", grid, pool=100, policy="grow").report().grows > 0
    one = one_tile(3), patch_items(np.array([4, 6, 9], np.int32))
    memory = QueueMemory(load_queue_model("ideal"), "patch", make_grid(8, 8, 8), pool=27, policy="flush")
    with pytest.raises(
        TilerError, match=r"machine.queue_pool: 27 is too small for an item of patch 4 .* need 28 bytes"
    ):
        memory.append(*one)
    memory = QueueMemory(load_queue_model("ideal"), "patch", make_grid(8, 8, 8), pool=60, policy="fail")
    with pytest.raises(
        TilerError, match=r"machine.queue_pool: 60 is full at patch 9: .* need 84 bytes; allowed: a larger"
    ):
        memory.append(*one)
