"""What a verification found."""

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple


@dataclass(frozen=True)
class Violation:
    """One promise that did not hold.

    patch : patch number in submit order. u, v : where on the patch; NaN where no domain point can be named. algorithm :
    name of the bound or cull test. what : the promise that was broken. margin : by how much, negative, in `unit`.
    """

    patch: int
    u: float
    v: float
    algorithm: str
    what: str
    margin: float
    unit: str

    def __str__(self) -> str:
        place = f" at (u, v) = ({self.u:.9g}, {self.v:.9g})" if math.isfinite(self.u + self.v) else ""
        return f"patch {self.patch}{place}: {self.algorithm}: {self.what}, margin {self.margin:.6g} {self.unit}"

    def record(self) -> dict[str, Any]:
        """The violation as JSON has it; null for what is not a finite number."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(self).items()
        }


class Report(NamedTuple):
    """What the verification of a frame found."""

    violations: tuple[Violation, ...]
    false_culls: tuple[Violation, ...]
