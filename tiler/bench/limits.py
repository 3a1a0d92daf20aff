"""The machine's limits, measured: arithmetic and memory bandwidth of one thread, by kernels that do nothing else.

The arithmetic is what the stages may use too: float32, a multiply and an add that are never fused, no reassociation. So
the limit is half of what the data sheet promises with fused multiply-adds.
"""

import time
from collections.abc import Callable

import numpy as np

from pipeline.jit import kernel

LANES = 256  # independent sums: enough to hide the latency of an add in the widest vectors
SWEEPS = 20_000
COPIED = 1 << 26  # bytes, several times a cache's share


@kernel
def multiply_add(x, a, b, sweeps):
    """x = x a + b, `sweeps` times, in place: float32[LANES], which stay in registers or the nearest cache."""
    for _ in range(sweeps):
        for k in range(len(x)):
            y = x[k]
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            x[k] = y


@kernel
def copy(source, target):
    """target = source, entry by entry."""
    for k in range(len(source)):
        target[k] = source[k]


def best_seconds(run: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of several runs, after one that may compile and that fills the caches."""
    run()
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return float(best)


def arithmetic_limit(repeats: int = 5) -> float:
    """float32 operations a second of one thread, multiplies and adds in equal numbers."""
    x = np.linspace(0.0, 1.0, LANES).astype(np.float32)
    a, b = np.float32(0.5), np.float32(0.25)
    return 16.0 * LANES * SWEEPS / best_seconds(lambda: multiply_add(x, a, b, SWEEPS), repeats)


def bandwidth_limit(repeats: int = 5) -> float:
    """Bytes a second of one thread that copies: what is read and what is written, together."""
    source = np.ones(COPIED // 4, np.float32)
    target = np.zeros_like(source)
    return 2.0 * COPIED / best_seconds(lambda: copy(source, target), repeats)
