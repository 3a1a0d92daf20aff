"""Frames of several machines, timed one after the other, and what they cost by the cost model.

A shared computer's load changes within seconds. So the machines take turns, frame by frame, in another order each round; the
processor time of all threads is taken besides the time that passes, as other programs change it least; the median counts,
and the middle half of the rounds says how far to trust it. The cost model's cycles follow from counters, and are exact.
"""

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from pipeline.types import F64
from tiler.config import Machine
from tiler.cost_model import cost, load_cost_model
from tiler.counters import Counters
from tiler.frame import Frame
from tiler.scene.model import Scene
from tiler.simulation import simulate

COST_MODEL = "wide"


class Timed(NamedTuple):
    """A machine's frame, and milliseconds of it in each round."""

    frame: Frame
    processor: F64  # of all threads together
    passed: F64


def time_frames(
    scene: Scene,
    machines: Mapping[str, Machine],
    rounds: int,
    threads: int | None,
    frame: float = 0,
    done: Callable[[float], None] = lambda part: None,
) -> dict[str, Timed]:
    """Draw a frame on each machine, `rounds` times in turns, after one round that is not timed."""
    names = list(machines)
    processor, passed = {name: np.empty(rounds) for name in names}, {name: np.empty(rounds) for name in names}
    frames = {name: simulate(scene, machines[name], frame=frame, threads=threads) for name in names}
    for k in range(rounds):
        for name in names[k % len(names) :] + names[: k % len(names)]:
            begin = time.process_time()
            passed[name][k] = 1e3 * simulate(scene, machines[name], frame=frame, threads=threads).seconds
            processor[name][k] = 1e3 * (time.process_time() - begin)
        done((k + 1) / rounds)
    return {name: Timed(frames[name], processor[name], passed[name]) for name in names}


class Middle(NamedTuple):
    """Median of the rounds, and the ends of their middle half."""

    median: float
    low: float
    high: float


def middle(values: F64) -> Middle:
    """Median and quartiles."""
    low, median, high = (float(x) for x in np.quantile(values, (0.25, 0.5, 0.75)))
    return Middle(median, low, high)


class Cycles(NamedTuple):
    """By the cost model, cull tests included."""

    frame: float  # of the slowest stage
    bottleneck: str


def cycles(counters: Counters, machine: Machine, tests: Mapping[str, float]) -> Cycles:
    """Cycles of a frame. tests : float operations a patch of the machine's cull tests, which the model itself leaves out.

    They are done where the bounds are, each patch of the hull shader once by each test, an operation a lane's cycle, as the
    model has it for bounds.
    """
    model = load_cost_model(COST_MODEL)
    report = cost(counters, machine, COST_MODEL)
    extra = counters["hs_invocations"] * sum(tests[name] for name in machine.cull)
    stages = {
        row.name: row.cycles + (extra / stage.units if stage.bounds else 0.0)
        for row, stage in zip(report.stages, model.stage, strict=True)
    }
    slowest = max(stages, key=lambda name: stages[name])
    return Cycles(stages[slowest], slowest)
