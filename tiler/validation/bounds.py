"""`tiler validate bounds`: scenes, then random and adversarial batches until there are enough samples."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from pipeline.bounds import BOUNDS
from tiler.errors import TilerError, unknown_name
from tiler.host import Host, available_threads
from tiler.scene import scene_names
from tiler.validation.campaign import Campaign
from tiler.validation.families import FAMILIES

SCENE_FACTORS = (2, 7, 16)
Progress = Callable[[float], None]

ADVERSARY_EACH = 3  # one batch in so many


def validate_bounds(
    samples: int,
    *,
    seed: int = 0,
    names: Sequence[str] | None = None,
    scenes: Sequence[str] | None = None,
    threads: int | None = None,
    progress: Progress = lambda samples: None,
) -> dict[str, Any]:
    """Check bounds and all cull tests at `samples` shaded points a bound at least: the JSON object of `tiler validate bounds`.

    names : entries of BOUNDS, all by default. scenes : built-in scenes, all by default. progress : called with the samples
    done. Raises TilerError for an unknown name or a number that is not allowed.
    """
    names = list(BOUNDS) if names is None else list(names)
    for name in names:
        if name not in BOUNDS:
            raise TilerError(f"bounds: {name!r} is not allowed; {unknown_name(name, BOUNDS)}")
    if not 1 <= samples <= 10**12:
        raise TilerError(f"samples: {samples} is not allowed; allowed: 1 to 10^12")
    if not 0 <= seed < 2**63:
        raise TilerError(f"seed: {seed} is not allowed; allowed: 0 to 2^63 - 1")
    threads = available_threads() if threads is None else threads
    start = time.perf_counter()
    with Host(threads) as host:
        campaign = Campaign(names, seed, host)

        def done() -> int:
            return min(tally.samples for tally in campaign.bounds.values())

        for name in scene_names() if scenes is None else scenes:
            for factor in SCENE_FACTORS:
                campaign.scene(name, factor, 0, threads)
                progress(min(done(), samples))
        number = 0
        while done() < samples:
            adversarial = number % ADVERSARY_EACH == ADVERSARY_EACH - 1
            (campaign.adversarial_batch if adversarial else campaign.random_batch)(number)
            number += 1
            progress(min(done(), samples))
            if all(tally.refused >= number > len(FAMILIES) for tally in campaign.bounds.values()):
                break
    tallies = [*campaign.bounds.values(), *campaign.culls.values()]
    seconds = time.perf_counter() - start
    return {
        "what": "bounds",
        "cases": sum(tally.cases for tally in tallies),
        "failed": sum(tally.failed for tally in tallies),
        "details": [tally.record() for tally in tallies],
        "seed": seed,
        "seconds": round(seconds, 3),
        "shaded_samples_per_second": round(campaign.shaded / max(campaign.shading_seconds, 1e-9)),
        "checked_samples_per_second": round(sum(t.samples for t in campaign.bounds.values()) / max(seconds, 1e-9)),
    }
