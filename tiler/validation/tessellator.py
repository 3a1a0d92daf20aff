"""The tessellator, bit for bit and in order, against a file of reference answers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import tessellator
from tiler.errors import TilerError
from tiler.validation.tally import KEPT

Progress = Callable[[float], None]

REFERENCE_ARRAYS = (
    "domain", "partitioning", "output", "tag", "legal", "num_edge_factors", "num_inside_factors", "factors_bits",
    "culled", "point_offset", "index_offset", "points", "indices",
)  # fmt: skip


def validate_tessellator(reference: Path, progress: Progress = lambda cases: None) -> dict[str, Any]:
    """Compare the tessellator, bit for bit and in order, with a file of reference answers.

    reference : an .npz whose arrays, a row a case, hold domain, partitioning, output, factors and the answer: points
    (float32) and indices of case k lie at point_offset[k] .. point_offset[k + 1] and index_offset[k] .. index_offset[k + 1].
    Returns the JSON object of `tiler validate tessellator`. Raises TilerError for a file that is not so.
    """
    answers = _load_reference(reference)
    details: list[dict[str, Any]] = []
    failed, cases = 0, len(answers["domain"])
    for k in range(cases):
        wrong = _compare_case(answers, k)
        if wrong:
            failed += 1
            if len(details) < 4 * KEPT:
                words = {name: str(answers[name][k]) for name in ("domain", "partitioning", "output", "tag")}
                factors = [repr(float(f)) for f in answers["factors_bits"][k].view(np.float32)]
                details.append({"case": k} | words | {"factors": factors, "wrong": wrong})
        if k % 32 == 31:
            progress(k + 1)
    return {"what": "tessellator", "cases": cases, "failed": failed, "details": details}


def count_cases(reference: Path) -> int:
    """Number of cases in a file of reference answers. Raises TilerError for a file that is none."""
    return len(_load_reference(reference)["domain"])


def _load_reference(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in REFERENCE_ARRAYS if name not in file.files]
            if missing:
                raise TilerError(
                    f"reference: {path} has no array {', '.join(missing)}; allowed: a file of reference answers"
                )
            return {name: file[name] for name in REFERENCE_ARRAYS}
    except TilerError:
        raise
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise TilerError(f"reference: cannot read {path} as an .npz file ({error})") from None


def _compare_case(answers: dict[str, Any], k: int) -> list[str]:
    """What differs in case k."""
    domain, partitioning, output = (str(answers[name][k]) for name in ("domain", "partitioning", "output"))
    edges, insides = int(answers["num_edge_factors"][k]), int(answers["num_inside_factors"][k])
    factors = answers["factors_bits"][k].view(np.float32)
    edge, inside = factors[:edges], factors[edges : edges + insides]
    answer = tessellator.tessellate if answers["legal"][k] else tessellator._tessellate
    points, indices = answer(domain, partitioning, edge, inside, output)
    expected = answers["points"][slice(*answers["point_offset"][k : k + 2])].astype(np.float32)
    same = {
        "culled": bool(answers["culled"][k]) == (len(points) == 0),
        "points": np.array_equal(points.view(np.uint32), expected.view(np.uint32)),
        "indices": np.array_equal(indices, answers["indices"][slice(*answers["index_offset"][k : k + 2])]),
    }
    return [name for name, equal in same.items() if not equal]
