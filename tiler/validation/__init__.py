"""`tiler validate`: bounds and cull tests under attack, tessellator and limit surface against files of reference answers,
and whether a mesh is closed.

Bounds. Every entry of BOUNDS and CULL_TESTS is checked by `tiler.verify` over the built-in scenes at several factors, then
over batches of patches that are made to break it: smooth, rational, degenerate, flat, tiny, huge, far away, with weights
that no bound can take, on spiky and stepped maps, seen by cameras near, inside and beside them, over whole patches and
parts of them. Points are what a tessellator can make, multiples of 2^-16, many on the ends. Every third batch is an
adversary: it moves control points, texture coordinates, texels and (u, v) of each patch towards the smallest margin of one
check, in units of what rounding is allowed. All bounds share a batch's shaded points.

A batch is made from the seed and its number alone, so that a violation can be made again; it also comes with its patch.
"""

from tiler.validation.attack import attack_points
from tiler.validation.bounds import validate_bounds
from tiler.validation.campaign import Campaign
from tiler.validation.families import FAMILIES, Batch, make_batch, make_stage
from tiler.validation.limit import validate_limit
from tiler.validation.tally import Tally
from tiler.validation.tessellator import count_cases, validate_tessellator
from tiler.validation.watertight import settings_of, validate_watertight

__all__ = [
    "FAMILIES",
    "Batch",
    "Campaign",
    "Tally",
    "attack_points",
    "count_cases",
    "make_batch",
    "make_stage",
    "settings_of",
    "validate_bounds",
    "validate_limit",
    "validate_tessellator",
    "validate_watertight",
]
