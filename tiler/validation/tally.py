"""What was checked, and what failed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tiler.validation.families import Batch
from tiler.verify import Violation

KEPT = 8  # violations of an algorithm that are reported in full


@dataclass
class Tally:
    """What was checked of one algorithm, and what failed."""

    algorithm: str
    samples: int = 0
    cases: int = 0  # patches, or parts of them
    failed: int = 0
    refused: int = 0  # batches that the algorithm says it cannot take
    seconds: float = 0.0  # spent on this algorithm, without its share of the shading
    closest: float = np.inf  # least margin of the box, in roundings (2^-24) of its largest coordinate
    false_culls: int = 0
    violations: list[dict[str, Any]] = field(default_factory=list)

    def add(self, found: Sequence[Violation], where: dict[str, Any], batch: Batch | None = None) -> None:
        """Count the patches of these violations, and keep the first few."""
        self.failed += len({violation.patch for violation in found})
        for violation in found:
            if len(self.violations) >= KEPT:
                break
            record = violation.record() | where
            if batch is not None:
                p, patches = violation.patch, batch.patches
                record |= {
                    "control_points": patches.control_points[p].tolist(),
                    "texcoords": patches.texcoords[p].tolist(),
                    "domain": batch.domain[p].tolist(),
                }
                for name, row in (("tangent_u", "tangent_id"), ("tangent_v", "tangent_id"), ("inner", "gregory_id")):
                    if getattr(patches, row)[p] >= 0:
                        record[name] = getattr(patches, name)[getattr(patches, row)[p]].tolist()
            self.violations.append(record)

    def record(self) -> dict[str, Any]:
        """For JSON."""
        record: dict[str, Any] = {
            "algorithm": self.algorithm,
            "samples": self.samples,
            "cases": self.cases,
            "failed": self.failed,
            "seconds": round(self.seconds, 3),
        }
        if np.isfinite(self.closest):
            record["closest"] = self.closest
        if self.refused:
            record["refused_batches"] = self.refused
        return record | {"false_culls": self.false_culls, "violations": self.violations}
