"""The smallest cone about control vectors, for LANES patches at a time.

Badoiu and Clarkson 2003: the centre of the smallest ball of the unit vectors, approached by steps of 1/2, 1/3, ... towards
the farthest one; the best axis seen is taken. A lane does what it would do alone: which patches share a block changes no bit.
"""

import math
from typing import NamedTuple

import numpy as np

from pipeline.culling.cones import MAX_VECTORS
from pipeline.jit import helper
from pipeline.types import F64, I64

LANES = 16
STEPS = 32  # the half angle is then within a hundredth of the smallest one

# Rows of LANES in one scratch array, at constant distances: LLVM sees which of them a store cannot meet.
AX, AY, AZ, LEAST, AT, CX, CY, CZ, BEST, FAR, LIVE = (k * LANES for k in range(11))


class Bundle(NamedTuple):
    """Unit control vectors of LANES patches."""

    units: F64  # (MAX_VECTORS, 3 LANES) x of all lanes, then y, then z
    rows: F64  # (11 LANES,) scratch
    number: I64  # (LANES,) of vectors; what lies beyond repeats the first one


@helper
def make_bundle():
    """A bundle of nothing."""
    return Bundle(np.zeros((MAX_VECTORS, 3 * LANES)), np.zeros(11 * LANES), np.zeros(LANES, np.int64))


@helper
def set_lane(bundle, lane, v, n):
    """Put the units of v[:n] into a lane, zero vectors left out; none at all where one is not finite. Returns their number."""
    left = 0
    for k in range(n):
        m = max(abs(v[k, 0]), abs(v[k, 1]), abs(v[k, 2]))
        if m == 0.0:
            continue
        x, y, z = v[k, 0] / m, v[k, 1] / m, v[k, 2] / m
        length = math.sqrt(x * x + y * y + z * z)
        if not (m < np.inf and length > 0.0):
            left = 0
            break
        unit = bundle.units[left]
        unit[lane], unit[LANES + lane], unit[2 * LANES + lane] = x / length, y / length, z / length
        left += 1
    bundle.number[lane] = left
    first = bundle.units[0]
    for k in range(left, MAX_VECTORS):
        unit = bundle.units[k]
        for c in range(3):
            unit[c * LANES + lane] = first[c * LANES + lane]
    return left


@helper
def _find_farthest(units, count, rows):
    """Rows LEAST and AT: the least dot product of each lane's vectors with its axis (A), and whose it is."""
    for lane in range(LANES):
        rows[LEAST + lane] = np.inf
        rows[AT + lane] = 0.0
    for k in range(count):
        unit, number = units[k], np.float64(k)
        for lane in range(LANES):
            dot = unit[lane] * rows[AX + lane] + unit[LANES + lane] * rows[AY + lane]
            dot += unit[2 * LANES + lane] * rows[AZ + lane]
            less = dot < rows[LEAST + lane]
            rows[LEAST + lane] = dot if less else rows[LEAST + lane]
            rows[AT + lane] = number if less else rows[AT + lane]


@helper
def fit_cones(bundle, count, cones):
    """Fill cones float64[5, LANES]: axis x, y, z, cosine and sine of the half angle; cosine -1 where there is none.

    count : the largest number of vectors in a lane. A cone of 90 degrees or more is none.
    """
    units, rows = bundle.units, bundle.rows
    for lane in range(LANES):
        x = y = z = 0.0
        n = bundle.number[lane]
        for k in range(n):
            unit = units[k]
            x, y, z = x + unit[lane], y + unit[LANES + lane], z + unit[2 * LANES + lane]
        least = max(n, 1)
        rows[CX + lane], rows[CY + lane], rows[CZ + lane] = x / least, y / least, z / least
        rows[BEST + lane], rows[FAR + lane], rows[LIVE + lane] = -1.0, 0.0, 1.0 if n > 0 else 0.0
        cones[:, lane] = 0.0
    for step in range(STEPS):
        for lane in range(LANES):
            x, y, z = rows[CX + lane], rows[CY + lane], rows[CZ + lane]
            length = np.sqrt(x * x + y * y + z * z)
            rows[AX + lane], rows[AY + lane], rows[AZ + lane] = x / length, y / length, z / length
            rows[LIVE + lane] = rows[LIVE + lane] if length > 1e-3 else 0.0
        _find_farthest(units, count, rows)
        pull = 1.0 / (step + 2.0)
        for lane in range(LANES):
            if rows[LIVE + lane] == 0.0:
                continue
            if rows[LEAST + lane] > rows[BEST + lane]:
                rows[BEST + lane], rows[FAR + lane] = rows[LEAST + lane], rows[AT + lane]
                cones[0, lane], cones[1, lane], cones[2, lane] = rows[AX + lane], rows[AY + lane], rows[AZ + lane]
            unit = units[np.uint32(rows[AT + lane])]
            rows[CX + lane] += pull * (unit[lane] - rows[CX + lane])
            rows[CY + lane] += pull * (unit[LANES + lane] - rows[CY + lane])
            rows[CZ + lane] += pull * (unit[2 * LANES + lane] - rows[CZ + lane])
    for lane in range(LANES):
        cones[3, lane] = -1.0
        if rows[BEST + lane] > 1e-6:
            # The sine from the cross product: sqrt(1 - cos^2) loses all digits of a narrow cone.
            unit = units[np.uint32(rows[FAR + lane])]
            x, y, z = unit[lane], unit[LANES + lane], unit[2 * LANES + lane]
            bx, by, bz = cones[0, lane], cones[1, lane], cones[2, lane]
            sx, sy, sz = y * bz - z * by, z * bx - x * bz, x * by - y * bx
            cones[3, lane], cones[4, lane] = rows[BEST + lane], math.sqrt(sx * sx + sy * sy + sz * sz)
