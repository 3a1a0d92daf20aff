"""Slow twin of ideal and blame: every event kept with the depths that it met, and each asked by itself what it was for.

The machine is the slow one of `naive_machine`; what it did is written down as it happens. Nothing is sorted, packed or
replayed: visible triangles are looked up sample by sample, points are compared by their (u, v), blocks are read from the
depths that an event met.
"""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from tests.naive_machine import NaiveFrame, NaiveMachine, Triangle, Unit, simulate_naively
from tests.naive_near_planes import naive_nearest
from tiler.blame import BLAME, IDEAL
from tiler.config import Machine
from tiler.scene.camera import camera_at
from tiler.scene.model import Scene


@dataclass
class Event:
    """A unit shaded in a tile; `tile` is None in the front end."""

    unit: Unit
    tile: int | None
    cost: int
    before: np.ndarray  # depths that it met
    tested: bool
    drawn: list[Triangle] = field(default_factory=list)  # its triangles in the tile
    passed: int = 0


@dataclass
class Unblamed(NaiveMachine):
    """The slow machine, with a notebook."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.events: list[Event] = []
        self.units: dict[tuple[int, int], Unit] = {}  # by patch and number of a triangle
        self.shapes: dict[int, list[Triangle]] = {}  # by unit, what passes set-up
        self.fates: dict[int, dict[str, int]] = {}
        self.event: Event | None = None

    def primitives(self, unit: Unit, clip: np.ndarray):
        before = dict(self.counters)
        found = list(super().primitives(unit, clip))
        self.shapes[unit.number] = found
        self.fates[unit.number] = {n: self.counters[n] - before[n] for n in self.counters if n.startswith("su_")}
        for number in unit.triangles:
            self.units[unit.patch, number] = unit
        if self.machine.binning == "triangle":
            self.events.append(
                Event(unit, None, self.counters["ds_invocations"] - self.spent(), self.depth, False, found)
            )
        return iter(found)

    def spent(self) -> int:
        return sum(event.cost for event in self.events)

    def shade(self, unit: Unit, place: int) -> np.ndarray:
        before = self.counters["ds_invocations"]
        clip = super().shade(unit, place)
        first = self.machine.z_feedback == "previous_frame" and "occlusion" in self.machine.occlusion
        tested = "occlusion" in self.tests or first
        cost = self.counters["ds_invocations"] - before
        self.event = Event(unit, self.tile, cost, self.depth.copy(), tested)
        if cost:
            self.events.append(self.event)
        return clip

    def draw(self, triangle: Triangle, written: set) -> None:
        before = self.counters["om_samples_passed"]
        super().draw(triangle, written)
        passed = self.counters["om_samples_passed"] - before
        if self.machine.binning == "triangle":
            for event in self.events:
                if event.unit.patch == triangle.patch:
                    event.passed += passed
        else:
            self.event.drawn.append(triangle)
            self.event.passed += passed

    def covers(self, triangle: Triangle, tile: int | None) -> bool:
        """Whether the triangle covers a sample of the tile, or of the picture."""
        probe = Canvas(self.scene, self.machine, self.camera)
        columns, rows = range(self.viewport.width), range(self.viewport.height)
        if tile is not None:
            columns, rows = self.tile_pixels(tile)
        probe.rasterize(triangle, columns, rows)
        return probe.counters["rs_samples_covered"] > 0


class Canvas(NaiveMachine):
    """An empty picture to draw one triangle on."""


@dataclass
class NaiveBlame:
    invocations: dict[str, int]
    tiles: dict[str, np.ndarray]
    ideal: dict[str, int]


class Judge:
    """Asks the questions of `BLAME` of each event."""

    def __init__(self, machine: Unblamed) -> None:
        self.m = machine
        self.shown = set(machine.seen.values())  # patch and triangle
        self.at: dict[int, set[tuple[int, int]]] = defaultdict(set)  # triangles visible in each tile
        for (y, x, _), triangle in machine.seen.items():
            self.at[y // machine.machine.tile * machine.tiles_x + x // machine.machine.tile].add(triangle)
        self.covering: dict[int, bool] = {}

    def visible(self, unit: Unit, tile: int | None = None) -> bool:
        among = self.shown if tile is None else self.at[tile]
        return any((unit.patch, t) in among for t in unit.triangles)

    def points(self, unit: Unit) -> set[tuple]:
        """Points of visible triangles of a unit, by patch, u and v, and place in the pattern where two are at the same."""
        found = set()
        for k, t in enumerate(unit.triangles):
            if (unit.patch, t) in self.shown:
                found |= {(unit.patch, *self.names(unit)[i]) for i in unit.indices[3 * k : 3 * k + 3]}
        return found

    @staticmethod
    def names(unit: Unit) -> list[tuple]:
        return [tuple(point) for point in unit.uv.tolist()]

    def covers_anywhere(self, unit: Unit) -> bool:
        if unit.number not in self.covering:
            self.covering[unit.number] = any(self.m.covers(t, None) for t in self.m.shapes[unit.number])
        return self.covering[unit.number]

    def still_hidden(self, event: Event) -> bool:
        """Whether the machine's test of the unit would succeed with the depths of that moment."""
        m, unit = self.m, event.unit
        box = m.clipped(unit.rect)
        if m.machine.occlusion_area == "rect":
            return self.hidden(event, box, m.nearest(unit))
        reached, size = m.reached(unit), m.machine.coarse_z_block
        for by in range(box[1] // size, box[3] // size + 1):
            for bx in range(box[0] // size, box[2] // size + 1):
                x0, y0 = max(box[0], bx * size), max(box[1], by * size)
                part = (x0, y0, min(box[2], bx * size + size - 1), min(box[3], by * size + size - 1))
                if reached is not None and not reached(part):
                    continue
                if not self.hidden(event, part, naive_nearest(unit.bound, m.viewport, part)):
                    return False
        return True

    def hidden(self, event: Event, box: tuple[int, int, int, int], z: np.float32) -> bool:
        """By the depths of that moment, block by block."""
        columns, rows = self.m.tile_pixels(event.tile)
        size = self.m.machine.coarse_z_block
        for by in range(box[1] // size, box[3] // size + 1):
            for bx in range(box[0] // size, box[2] // size + 1):
                inside = [
                    event.before[y, x]
                    for y in rows if y // size == by for x in columns if x // size == bx
                ]  # fmt: skip
                far = np.max(inside)
                if not (z > far if self.m.strict else z >= far):
                    return False
        return True

    def reason(self, event: Event) -> str:
        """Of an event that was for nothing."""
        unit, tile, m = event.unit, event.tile, self.m
        if not self.covers_anywhere(unit):
            fate = m.fates[unit.number]
            if fate["su_culled_face"] and not fate["su_triangles"]:
                return "backface"
            others = (
                fate["su_culled_face"]
                + fate["su_triangles"]
                + fate["su_culled_zero_area"]
                + fate["su_culled_no_sample"]
            )
            return "no_sample" if others else "outside"
        if tile is not None and not any(m.covers(t, tile) for t in m.shapes[unit.number]):
            return "no_triangle_in_tile"
        if event.passed:
            return "occluded_order"
        if not event.tested:
            return "occluded_untested"
        m.tile = tile
        if self.still_hidden(event):
            return "occluded_stale"
        boxes = [m.clipped(t.shape.box) for t in event.drawn]
        around = (
            min(b[0] for b in boxes), min(b[1] for b in boxes), max(b[2] for b in boxes), max(b[3] for b in boxes),
        )  # fmt: skip
        if self.hidden(event, around, min(t.nearest() for t in event.drawn)):
            return "occluded_bound"
        return "occluded_coarse"

    def chosen(self) -> list[Event]:
        """Of each visible unit the event that is charged for what is useful."""
        found = []
        for number in dict.fromkeys(e.unit.number for e in self.m.events):
            mine = [e for e in self.m.events if e.unit.number == number]
            if self.visible(mine[0].unit):
                found.append(next((e for e in mine if e.tile is not None and self.visible(e.unit, e.tile)), mine[0]))
        return found

    def judge(self) -> NaiveBlame:
        m = self.m
        tiles = {name: [0] * (m.tiles_x * m.tiles_y) for name in BLAME}
        total = dict.fromkeys(BLAME, 0)

        def charge(event: Event, name: str, number: int) -> None:
            total[name] += number
            if event.tile is not None:
                tiles[name][event.tile] += number

        chosen = self.chosen()
        had: set[tuple] = set()
        share: dict[int, tuple[int, int]] = {}
        for unit in sorted({e.unit.number: e.unit for e in chosen}.values(), key=lambda unit: unit.number):
            mine = self.points(unit)
            share[unit.number] = len(mine - had), len(mine & had)
            had |= mine
        for event in m.events:
            cost = event.cost
            if event.tile is None:
                charge(event, "vertex_cache", cost - len(event.unit.uv))
                cost = len(event.unit.uv)
            if any(event is c for c in chosen):
                useful, shared = share[event.unit.number]
                charge(event, "useful", useful)
                charge(event, "shared_border", shared)
                charge(event, "granularity", cost - useful - shared)
            elif self.visible(event.unit, event.tile):
                charge(event, "redundant", cost)
            else:
                charge(event, self.reason(event), cost)
        units = {m.units[triangle].number: m.units[triangle] for triangle in self.shown}
        entries = sum(
            len(shown if m.machine.binning == "triangle" else {m.units[t].number for t in shown})
            for shown in self.at.values()
        )
        ideal = dict(
            zip(
                IDEAL,
                (
                    len({p for p, _ in self.shown}),
                    len(units),
                    len(had),
                    sum(len(u.uv) for u in units.values()),
                    entries,
                ),
                strict=True,
            )
        )
        shape = (m.tiles_y, m.tiles_x)
        return NaiveBlame(total, {n: np.array(v).reshape(shape) for n, v in tiles.items()}, ideal)


def blame_naively(scene: Scene, machine: Machine, frame: float = 0) -> NaiveBlame:
    """What `Frame.blame` is, the slow way; tiles are worked off one after the other, as the walk has them."""
    picture = scene.picture
    history: NaiveFrame | None = None
    if machine.phased and frame >= 1:
        history = simulate_naively(scene, machine.model_copy(update={"cull": machine.hull_cull}), frame - 1)
    m = Unblamed(scene, machine, camera_at(scene.camera, frame, picture.width / picture.height), frame)
    alive = m.hull_shader()
    if machine.binning == "triangle":
        m.run_triangle_binning(alive)
    else:
        m.run_unit_binning(alive, history)
    return Judge(m).judge()
