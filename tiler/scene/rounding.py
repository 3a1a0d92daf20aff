"""Rounding to a dyadic grid: what makes a built scene the same on every machine.

The last bit of sin, cos, tan and exp differs between C libraries. Rounded to multiples of 2^-16 the difference is gone
(but for a value within one last bit of half a grid step; none that our scenes use lies there), and the result has so few
bits that sums, differences and small multiples of it are exact.
"""

import math

STEP = 2.0**-16


def round_to_grid(value: float) -> float:
    """Nearest multiple of 2^-16, ties to even. `value` must be finite."""
    return round(value / STEP) * STEP


def sin_turns(turns: float) -> float:
    """Sine of `turns` full turns, a multiple of 2^-16, exact at quarter turns."""
    return round_to_grid(math.sin(2.0 * math.pi * (turns % 1.0)))


def cos_turns(turns: float) -> float:
    """Cosine of `turns` full turns, a multiple of 2^-16, exact at quarter turns."""
    return round_to_grid(math.cos(2.0 * math.pi * (turns % 1.0)))
