"""The session: draws what pages ask for on one thread of its own. Of each page the newest request wins.

A request that is replaced ends at once if it still waits, and else at the next batch or queue entry. What a few requests before
drew is kept, so that looking at another map or patch of the same frame draws nothing again.
"""

import contextlib
import sys
import threading
from collections import OrderedDict
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass, field

import numpy as np

from pipeline.types import F64, I32, I64, U8
from tiler.back_end import Bins
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.explore.patch_boxes import Box, part_boxes, whole_boxes
from tiler.explore.requests import Ask, Plan, plan
from tiler.explore.tile_queue import TileQueue, TileWatch
from tiler.frame import Frame
from tiler.front_end import Geometry
from tiler.grid import Grid, make_grid
from tiler.heatmaps import PIXEL_MAPS
from tiler.host import Host, available_threads
from tiler.machine import render_frame
from tiler.order import PATCH_SHIFT
from tiler.report.maps import MAPS
from tiler.scene.model import Scene
from tiler.tile import Target
from tiler.units import Units

KEPT = 4  # frames


class Superseded(Exception):
    """The page asked for something newer, or is gone, or the session was closed."""


@dataclass
class Job:
    """A request on its way. `done` gives its View, or raises Superseded, TilerError, or RuntimeError for a bug of ours."""

    plan: Plan
    done: "Future[View]" = field(default_factory=Future)
    stale: threading.Event = field(default_factory=threading.Event)

    def settle(self, result: "View | Exception") -> None:
        """Give the result, if it was not given before: one that nobody waits for comes too late."""
        with contextlib.suppress(InvalidStateError):
            if isinstance(result, Exception):
                self.done.set_exception(result)
            else:
                self.done.set_result(result)

    def drop(self) -> None:
        """End it: who waits is told at once, and the thread that draws it at its next check."""
        self.stale.set()
        self.settle(Superseded())

    def check(self) -> None:
        """Raise Superseded if nobody waits for it any more."""
        if self.stale.is_set():
            raise Superseded


@dataclass
class Drawn:
    """A frame, and what was seen while it was drawn."""

    frame: Frame
    under: I32  # (H, W) patch seen at the pixel's first sample that shows one, -1 for none
    units: Units
    tiles: dict[int, TileQueue] = field(default_factory=dict)  # by number of the tile
    pixel_maps: dict[str, I32] = field(default_factory=dict)


@dataclass(frozen=True)
class View:
    """What a page is told. tile : number of the tile that was asked about, with its queue."""

    plan: Plan
    frame: Frame
    under: I32
    pixel_map: I32 | None
    tile: int | None
    queue: TileQueue | None
    domain: F64 | None  # (entries, 4) u0 u1 v0 v1 of the queue's sub-domains
    boxes: list[Box]


class _Look:
    """The onlooker of a frame: keeps units and visibility, and hands all on to the watch of a tile."""

    def __init__(self, watch: TileWatch | None, check: "threading.Event") -> None:
        self.watch, self._stale = watch, check
        self.units: Units | None = None
        self.under: I32 = np.zeros((0, 0), np.int32)

    def see(
        self, number: int, phase: int, bins: Bins, batch: I32, units: Units, geometry: Geometry, order: I64
    ) -> None:
        if self._stale.is_set():
            raise Superseded
        if self.watch is not None:
            self.watch.see(number, phase, bins, batch, units, geometry, order)

    def end(self, units: Units, shaded: U8, target: Target) -> None:
        self.units = units
        patch = np.where(target.order >= 0, target.order >> PATCH_SHIFT, -1).astype(np.int32)
        first = (patch >= 0).argmax(axis=2)
        self.under = np.take_along_axis(patch, first[..., None], axis=2)[..., 0]
        if self.watch is not None:
            self.watch.end(units, shaded, target)


class Session:
    """Draws for pages; `submit` from any thread."""

    def __init__(self, scene: Scene, machine: Machine, threads: int | None = None) -> None:
        """Start the thread that draws. threads : of the host, all by default."""
        self.scene, self.machine = scene, machine
        self.threads = threads or available_threads()
        self._change = threading.Condition()
        self._waiting: OrderedDict[str, Job] = OrderedDict()
        self._running: Job | None = None
        self._closed = False
        self._kept: OrderedDict[str, Drawn] = OrderedDict()
        self._thread = threading.Thread(target=self._work, name="tiler explore", daemon=True)
        self._thread.start()

    def submit(self, ask: Ask) -> Job:
        """Draw this next; what the page asked for before is dropped. Raises TilerError for what cannot be drawn."""
        job = Job(plan(ask, self.scene, self.machine, self.threads))
        with self._change:
            if self._closed:
                raise TilerError("explorer: it is closed")
            before = self._waiting.pop(ask.page, None)
            if before is not None:
                before.drop()
            if self._running is not None and self._running.plan.ask.page == ask.page:
                self._running.drop()
            self._waiting[ask.page] = job
            self._change.notify()
        return job

    def cancel(self, job: Job) -> None:
        """Nobody waits for it any more."""
        with self._change:
            job.drop()
            if self._waiting.get(job.plan.ask.page) is job:
                del self._waiting[job.plan.ask.page]

    def close(self, seconds: float = 0.0) -> bool:
        """Drop all requests, and wait so long for the thread to end; whether it did."""
        with self._change:
            self._closed = True
            for job in (*self._waiting.values(), *([self._running] if self._running else [])):
                job.drop()
            self._waiting.clear()
            self._change.notify()
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while True:
            with self._change:
                while not self._waiting and not self._closed:
                    self._change.wait()
                if self._closed:
                    return
                _, job = self._waiting.popitem(last=False)
                self._running = job
            try:
                job.settle(self._view(job))
            except (Superseded, TilerError) as error:
                job.settle(error)
            except MemoryError:
                job.settle(TilerError("memory: there is not enough of it for this picture and machine"))
            except Exception as error:  # a bug of ours: told in the page and here, and the session goes on
                print(f"explorer: {type(error).__name__}: {error}", file=sys.stderr)
                job.settle(RuntimeError(f"{type(error).__name__}: {error}"))
            finally:
                self._running = None

    def _view(self, job: Job) -> View:
        plan, ask, scene = job.plan, job.plan.ask, job.plan.scene
        grid = make_grid(scene.picture.width, scene.picture.height, plan.machine.tile)
        tile = None if ask.point is None else _tile_at(grid, *ask.point)
        drawn = self._drawn(job, grid, tile)
        queue = None if tile is None else drawn.tiles[tile]
        domain = None
        if queue is not None and plan.machine.binning == "subpatch":
            domain = np.where((queue.unit >= 0)[:, None], drawn.units.domain[queue.unit], 0.0)
        return View(
            plan, drawn.frame, drawn.under, self._pixel_map(job, drawn), tile, queue, domain, _boxes(plan, drawn)
        )  # fmt: skip

    def _drawn(self, job: Job, grid: Grid, tile: int | None) -> Drawn:
        """The frame, from those kept where it is there and the tile was looked into."""
        job.check()
        plan = job.plan
        kept = self._kept.pop(plan.key, None)
        if kept is None or not (tile is None or tile in kept.tiles):
            watch = None if tile is None else TileWatch(plan.scene, plan.machine, grid, tile, job.check)
            look = _Look(watch, job.stale)
            with Host(self.threads) as host:
                frame = render_frame(
                    plan.scene, plan.machine, plan.ask.frame, host, lambda part: job.check(), onlooker=look
                )
            assert look.units is not None
            kept = Drawn(frame, look.under, look.units, {} if kept is None else kept.tiles)
            if watch is not None and watch.queue is not None and tile is not None:
                kept.tiles[tile] = watch.queue
        self._kept[plan.key] = kept
        while len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return kept

    def _pixel_map(self, job: Job, drawn: Drawn) -> I32 | None:
        """Values of the map asked for, int32[H, W], if it is one of pixels."""
        name = job.plan.ask.map
        if not name or MAPS[name].per != "pixel":
            return None
        if name not in drawn.pixel_maps:
            job.check()
            drawn.pixel_maps[name] = PIXEL_MAPS[name](job.plan.scene, job.plan.machine, job.plan.ask.frame)
        return drawn.pixel_maps[name]


def _tile_at(grid: Grid, x: float, y: float) -> int:
    column, row = min(int(x * grid.width), grid.width - 1), min(int(y * grid.height), grid.height - 1)
    return (row >> grid.tile_log2) * grid.tiles_x + (column >> grid.tile_log2)


def _boxes(plan: Plan, drawn: Drawn) -> list[Box]:
    """Boxes of the patches asked for: by the machine's own bound and the others, and of sub-domains."""
    patches, own = plan.ask.patches, plan.machine.bounds
    if not patches:
        return []
    bounds = list(dict.fromkeys([own, *plan.ask.bounds]))
    boxes = whole_boxes(plan.scene, plan.ask.frame, patches, own, bounds)
    if plan.machine.binning == "subpatch":
        boxes += part_boxes(patches, own, drawn.units.owner, drawn.units.bounds)
    return boxes
