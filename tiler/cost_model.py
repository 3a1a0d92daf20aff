"""What a frame costs by a model: cycles per event and units per stage, all from a data file (`tiler/_data/cost_models`).

A stage's work is the sum over its counters of events times cycles, and in the stage that has `bounds` the bound of every
patch and of every sub-domain, where the machine needs bounds at all. Its time is the work over its units. Stages work side by
side: the one with most time is the bottleneck, and a frame takes at least that long. Loads are taken as spread evenly.

Domain-shader equivalents are how Munkberg et al. 2010 (section 5.1, Table 1) weigh a bound: domain points shaded, plus the
cost of a bound in invocations of the domain shader times the bounds evaluated.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any, Literal

from pydantic import Field, model_validator

from pipeline.bounds import BOUNDS
from tiler.config import Machine
from tiler.counters import DEFINITIONS
from tiler.data_files import load_model, model_names
from tiler.errors import TilerError, unknown_name
from tiler.scene.model import Scene
from tiler.scene.problems import shown
from tiler.scene.strict import Faults, Strict, between, number
from tiler.shared import Shared
from tiler.simulation import simulate

KIND = "cost_models"
BOUNDED = "hs_bounds_evaluated"  # of patches, and in `subpatch` binning of their sub-domains

MOST = 1e9
COST_WORDS = f"a number from 0 to {MOST:g}"

Measure = Literal["domain_shader_equivalents", "frame_cycles", "total_cycles"]


def _is_cost(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= MOST


class StageFile(Strict):
    """Table [[stage]]: a stage, and the cycles that one of its units takes for each event of a counter."""

    name: str = Field(description="a text")
    units: float = between(1.0, 0.0, 1e6, " (units that work side by side)")
    bounds: bool = False
    cycles: dict[str, Any] = Field({}, description=f"a table of counters, each with {COST_WORDS} (cycles)")


class CostModel(Strict):
    """A cost model."""

    title: str = Field(description="a text")
    source: str = Field(description="a text: where the figures are from, and which are assumed")
    domain_shader_cycles: float = number(1.0, 1e-3, 1e6, " (cycles of one invocation)")
    bound: dict[str, Any] = Field(description="a table of bounds, each with its cost in domain-shader invocations")
    stage: list[StageFile] = Field(min_length=1, description="one or more tables [[stage]]")

    @model_validator(mode="after")
    def _names_are_known(self) -> "CostModel":
        faults: list[tuple[tuple[str | int, ...], str]] = []
        for name, invocations in self.bound.items():
            if name not in BOUNDS:
                faults.append((("bound", name), f"unknown bound; {unknown_name(name, BOUNDS)}"))
            elif not _is_cost(invocations):
                faults.append((("bound", name), f"{shown(invocations)} is not allowed; allowed: {COST_WORDS}"))
        for k, stage in enumerate(self.stage):
            for name, cycles in stage.cycles.items():
                if name not in DEFINITIONS:
                    faults.append((("stage", k, "cycles", name), f"unknown counter; {unknown_name(name, DEFINITIONS)}"))
                elif not _is_cost(cycles):
                    problem = f"{shown(cycles)} is not allowed; allowed: {COST_WORDS}"
                    faults.append((("stage", k, "cycles", name), problem))
            if stage.name in [other.name for other in self.stage[:k]]:
                faults.append((("stage", k, "name"), f"{stage.name!r} is named twice; allowed: each stage once"))
        if sum(stage.bounds for stage in self.stage) != 1:
            faults.append((("stage",), "bounds must be true in one stage; allowed: exactly one"))
        if faults:
            raise Faults(*faults)
        return self


@dataclass(frozen=True)
class StageCost:
    """One stage. events : of all its counters, bounds included. work : cycles. cycles : work over units. share : of all."""

    name: str
    events: int
    work: float
    cycles: float
    share: float


@dataclass(frozen=True)
class CostReport:
    """Cost of a frame.

    frame_cycles : of the slowest stage. total_cycles : of all stages, one after the other. bounding_equivalents : of
    domain_shader_equivalents those that are bounds.
    """

    model: str
    stages: tuple[StageCost, ...]
    bottleneck: str
    frame_cycles: float
    total_cycles: float
    domain_shader_equivalents: float
    bounding_equivalents: float

    def record(self) -> dict[str, Any]:
        """The report as JSON has it."""
        return asdict(self) | {"stages": [asdict(stage) for stage in self.stages]}


def cost_model_names() -> tuple[str, ...]:
    """Names of the models that are shipped."""
    return model_names(KIND)


def load_cost_model(source: str) -> CostModel:
    """A shipped model by name, or a file by its path (ending in .toml). Raises TilerError."""
    return load_model(KIND, source, CostModel, "cost")


def needed_bound(machine: Machine) -> str | None:
    """The bound that a machine computes of each patch; None where nothing asks for one."""
    asked = machine.binning != "triangle" or any(not name.startswith("backface:") for name in machine.cull)
    return machine.bounds if asked else None


def bound_cost(model: CostModel, machine: Machine, name: str) -> float:
    """Cost of the machine's bound, domain-shader invocations a patch. Raises TilerError where the model has none."""
    bound = needed_bound(machine)
    if bound is None:
        return 0.0
    if bound not in model.bound:
        raise TilerError(f"cost: model {name!r} has no cost for bounds {bound!r}; {unknown_name(bound, model.bound)}")
    return float(model.bound[bound])


def cost(counters: Mapping[str, int], machine: Machine, model: str = "munkberg2010") -> CostReport:
    """Cost of a frame with these counters on this machine. model : a name, or a .toml file. Raises TilerError."""
    table = load_cost_model(model)
    bounding = bound_cost(table, machine, model)
    bounded = counters[BOUNDED] if needed_bound(machine) else 0
    rows = []
    for stage in table.stage:
        events = sum(counters[name] for name in stage.cycles) + (bounded if stage.bounds else 0)
        work = sum(counters[name] * cycles for name, cycles in stage.cycles.items())
        work += bounded * bounding * table.domain_shader_cycles if stage.bounds else 0.0
        rows.append(StageCost(stage.name, events, work, work / stage.units, 0.0))
    total = sum(row.cycles for row in rows)
    rows = [replace(row, share=row.cycles / total if total else 0.0) for row in rows]
    slowest = max(rows, key=lambda row: row.cycles)
    return CostReport(
        model=model,
        stages=tuple(rows),
        bottleneck=slowest.name,
        frame_cycles=slowest.cycles,
        total_cycles=total,
        domain_shader_equivalents=counters["ds_invocations"] + bounded * bounding,
        bounding_equivalents=bounded * bounding,
    )


@dataclass(frozen=True)
class BreakEven:
    """Costs over factors, and from which factor each machine is cheaper than the first; None: at none of those simulated."""

    factors: tuple[float, ...]
    measure: Measure
    reports: dict[str, tuple[CostReport, ...]]
    factor: dict[str, float | None]

    def costs(self, name: str) -> list[float]:
        """The measure of a machine at each factor."""
        return [getattr(report, self.measure) for report in self.reports[name]]


def crossing(factors: Sequence[float], baseline: Sequence[float], costs: Sequence[float]) -> float | None:
    """The factor from which `costs` stay below `baseline`; between two factors by a straight line. None: not at the last."""
    differences = [c - b for c, b in zip(costs, baseline, strict=True)]
    if differences[-1] >= 0:
        return None
    found = factors[0]
    for (f, g), (d, e) in zip(pairwise(factors), pairwise(differences), strict=True):
        if d >= 0 > e:
            found = f + (g - f) * d / (d - e)
    return found


def break_even(
    scene: Scene,
    machines: Mapping[str, Machine],
    factors: Sequence[float],
    model: str = "munkberg2010",
    *,
    measure: Measure = "domain_shader_equivalents",
    frame: float = 0,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda frames: None,
) -> BreakEven:
    """Cost of each machine at each tessellation factor (all six alike), and where it falls below the first machine's.

    factors : rising, each above 0 and at most 64. progress : called with the number of frames done. Raises TilerError.
    """
    if not factors or any(not 0 < f <= 64 for f in factors) or any(not f < g for f, g in pairwise(factors)):
        raise TilerError(f"factors: {list(factors)} is not allowed; allowed: rising numbers above 0 and at most 64")
    if not machines:
        raise TilerError("machines: none is given; allowed: one or more, the baseline first")
    for machine in machines.values():
        bound_cost(load_cost_model(model), machine, model)  # before anything is simulated
    reports: dict[str, list[CostReport]] = {name: [] for name in machines}
    for done, factor in enumerate(factors):
        policy = replace(scene.tessellation, factor=(float(factor),) * 6, edge_pixels=None)
        drawn, shared = replace(scene, tessellation=policy), Shared()
        for k, (name, machine) in enumerate(machines.items()):
            counted = simulate(drawn, machine, frame=frame, threads=threads, shared=shared).counters
            reports[name].append(cost(counted, machine, model))
            progress(done * len(machines) + k + 1)
    fixed = {name: tuple(rows) for name, rows in reports.items()}
    curves = {name: [float(getattr(row, measure)) for row in rows] for name, rows in fixed.items()}
    first = next(iter(curves.values()))
    found = {name: crossing(factors, first, curve) for name, curve in curves.items()}
    return BreakEven(tuple(factors), measure, fixed, found)


def cost_table(reports: Mapping[str, CostReport]) -> str:
    """Costs of several machines as aligned text, a column a machine: cycles and share of each stage, and the sums."""
    made = list(reports.values())
    rows = [[f"cost, {made[0].model}", *reports]]
    for k, stage in enumerate(made[0].stages):
        rows.append([stage.name, *(f"{r.stages[k].cycles:,.0f} {r.stages[k].share:6.1%}" for r in made)])
    rows.append(["bottleneck", *(r.bottleneck for r in made)])
    rows.append(["frame cycles", *(f"{r.frame_cycles:,.0f}" for r in made)])
    rows.append(["domain-shader equivalents", *(f"{r.domain_shader_equivalents:,.0f}" for r in made)])
    rows.append(["of them bounds", *(f"{r.bounding_equivalents:,.0f}" for r in made)])
    return _aligned(rows)


def break_even_table(found: BreakEven) -> str:
    """The measure of each machine at each factor as aligned text, and from where it is below the first."""
    rows = [["factor", *found.reports]]
    columns = [found.costs(name) for name in found.reports]
    for k, factor in enumerate(found.factors):
        rows.append([f"{factor:g}", *(f"{column[k]:,.0f}" for column in columns)])
    first, *others = found.reports
    pays = [break_even_text(found, name) for name in others]
    rows.append(["pays from", "", *pays])
    return f"{found.measure} by {found.reports[first][0].model}\n" + _aligned(rows)


def break_even_text(found: BreakEven, name: str) -> str:
    """From which factor a machine pays, in words."""
    factor = found.factor[name]
    if factor is None:
        return "never here"
    return f"{factor:g} or less" if factor == found.factors[0] else f"{factor:.2f}"


def _aligned(rows: list[list[str]]) -> str:
    widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
    return "\n".join("  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows)
