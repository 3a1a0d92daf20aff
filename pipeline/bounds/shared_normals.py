"""Displaced patches that share normals on their edges: how much wider that makes a bound of their normals.

On an edge the domain shader displaces along the edge's own normal, and at a corner along the vertex's: unit vectors, to the
same rounding as all normals, at most s = `Patches.normal_slack` away from those of the patch's own tangents, which a bound
knows. So each component is wider by s, and a cone by the angle of a chord of length s; a bound that takes a normal times a
displacement t is wider by s |t|. Domains that touch no edge are left alone. Boxes that need |n| <= 1 only stay as they are.
"""

import math

import numpy as np

from pipeline.jit import helper, kernel
from pipeline.types import F64, HullInput

ROUND = 2.0**-50


@helper
def slack_of(patches, domain, p):
    """How far normals of patch p over its domain may be from those of its tangents, as unit vectors: 0 inside."""
    if patches.normal_id[p] < 0 or patches.map_id[p] < 0:
        return 0.0
    inside = domain[p, 0] > 0.0 and domain[p, 1] < 1.0 and domain[p, 2] > 0.0 and domain[p, 3] < 1.0
    return 0.0 if inside else float(patches.normal_slack[p])


@helper
def _wider_cone(cosine, s):
    """Cosine of a cone's half angle and that of a chord of length s; -1 from 90 degrees on."""
    half = 0.5 * s
    chord = s * math.sqrt(max((1.0 - half) * (1.0 + half), 0.0))
    wider = cosine * (1.0 - 2.0 * half * half) - math.sqrt(max((1.0 - cosine) * (1.0 + cosine), 0.0)) * chord - ROUND
    return wider if cosine > 0.0 and wider > 0.0 else -1.0


@helper
def widen_column(out, p, s):
    """Widen column p of rows as `normals.bound_normals` has them by the slack s."""
    if s != 0.0:  # also a NaN
        for row in range(2):
            out[row, p] = out[row, p] + s if out[row, p] + s < 1.0 else 1.0
        out[2, p] = out[2, p] - s if out[2, p] - s > -1.0 else -1.0
        out[3, p] = _wider_cone(out[3, p], s)


@kernel
def _widen(patches, domain, out):
    for p in range(len(patches.map_id)):
        widen_column(out, p, slack_of(patches, domain, p))


@kernel
def _find_slacks(patches, domain, out):
    for p in range(len(out)):
        out[p] = slack_of(patches, domain, p)


def find_slacks(stage: HullInput) -> F64:
    """Slack of each patch, float64[P]; of no patch, float64[0], where none shares normals."""
    slacks = np.empty(len(stage.patches.map_id) if len(stage.patches.edge_row) else 0)
    if len(slacks):
        _find_slacks(stage.patches, stage.domain, slacks)
    return slacks


def widen_normals(stage: HullInput, out: F64) -> None:
    """Widen the rows of `normals.bound_normals`, float64[4, at least P], in place."""
    if len(stage.patches.edge_row):
        _widen(stage.patches, stage.domain, out)
