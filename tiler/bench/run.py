"""The parts of a bench, one after the other."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tiler.bench.facts import host_facts, load_average, spin
from tiler.bench.limits import arithmetic_limit, bandwidth_limit
from tiler.bench.scaling import Memory, Point, million_patches, scaling
from tiler.bench.stages import Stage, measure_stages
from tiler.bench.startup import Wait, measure_startup
from tiler.bench.views import Views, measure_views

QUICK_SIZE = (960, 540)


class Limits(NamedTuple):
    """What one thread can do at most, and what that means for a stage."""

    operations: float  # float32 operations a second
    bandwidth: float  # bytes a second
    domain_operations: float  # of one displaced domain-shader invocation, without comparisons
    clear_bytes: int  # of a pixel: depth, colour, visible triangle

    @property
    def domain_ns(self) -> float:
        """Nanoseconds of an invocation at the arithmetic limit."""
        return self.domain_operations / self.operations * 1e9

    @property
    def clear_ns(self) -> float:
        """Nanoseconds of a pixel's clear at the bandwidth limit."""
        return self.clear_bytes / self.bandwidth * 1e9


class Results(NamedTuple):
    """All that was measured; what was not asked for is empty."""

    host: dict[str, Any]
    limits: Limits | None
    stages: list[Stage]
    scaling: list[Point]
    memory: Memory | None
    startup: list[Wait]
    peer_name: str
    peer: list[dict[str, Any]]
    views: Views | None = None


def measure_limits() -> Limits:
    """Measure the limits, and count the operations of the domain shader."""
    from tiler.costs import count_operations

    counts = count_operations(1)["domain shader, map"]
    return Limits(arithmetic_limit(), bandwidth_limit(), counts.arithmetic, 12)


def run_bench(
    *,
    size: tuple[int, int],
    threads: int,
    quick: bool = False,
    stages: bool = True,
    scales: bool = True,
    million: bool = False,
    startup: bool = False,
    peer: bool = False,
    scenes: Sequence[str] = (),
    factors: Sequence[float] = (),
    rounds: int = 5,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> Results:
    """Measure what is asked for. progress : called with the name of each part before it starts."""
    host = host_facts(threads) | {"load_before": load_average(), "spin_before_ms": round(spin() * 1e3, 3)}
    found_limits, found_stages, points, memory = None, [], [], None
    times: list[Wait] = []
    many: Views | None = None
    name = ""
    rows: list[dict[str, Any]] = []
    if peer:
        from tiler.bench.peer import compare_with_llvmpipe

        progress("llvmpipe")
        name, rows = compare_with_llvmpipe(scenes, factors, size, threads, rounds, out=out)
    if stages:
        progress("stages")
        found_limits, found_stages = measure_limits(), measure_stages(size, threads, quick)
        progress("views")
        many = measure_views(quick)
    if scales:
        progress("scaling")
        points = scaling(size, threads, quick)
    if million:
        progress("a million patches")
        memory = million_patches(threads)
    if startup:
        progress("start-up")
        times = measure_startup()
    host |= {"load_after": load_average(), "spin_after_ms": round(spin() * 1e3, 3)}
    return Results(host, found_limits, found_stages, points, memory, times, name, rows, many)
