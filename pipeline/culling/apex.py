"""Cones of normals with an apex, and the test of eyes against them (Shirman and Abi-Ezzi 1993, section 4).

All normals of a cone of axis a and half angle alpha are back-facing at p where (e - p) . a <= -sin(alpha) |e - p|. A cone
about the line along a through the middle of the points' lateral extent, opening along a, holds the points if its apex l
is at the least height h_i - r_i tan(alpha); then (e - l) . a <= -sin(alpha) |e - l| answers for their whole hull.
Front-facing: the apex at the greatest h_i + r_i tan(alpha), and >= +sin(alpha).

Points that are moved by t along a normal of the cone, t0 <= t <= t1, have their height within t cos(alpha) .. t of what it
was, and are up to |t| sin(alpha) farther from the line (Munkberg et al. 2010, section 5.3, put the corners of the
displaced box in place of the points, which is wider).

Cones do not depend on the eye: many eyes may be tested against the same ones, with the answers that each gets alone.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.culling.backface import BACK, FRONT, SILHOUETTE, eye_or_none, turn_mirrored
from pipeline.culling.cones import PAD
from pipeline.culling.offset import Offsets, constant_offsets
from pipeline.jit import helper, kernel
from pipeline.types import F64, I64, U8, HullInput, Patches


class Cones(NamedTuple):
    """Cones of normals of n patches, world space."""

    axis: F64  # (n, 3)
    sine: F64  # (n,) of the half angle, widened; infinite where there is no cone: then nothing is told
    behind: F64  # (n, 3) apex of the back-facing test
    before: F64  # (n, 3) apex of the front-facing test


MakeCones = Callable[[Patches, I64, Offsets], Cones]


def allocate(n: int) -> Cones:
    """Room for n cones."""
    return Cones(np.empty((n, 3)), np.empty(n), np.empty((n, 3)), np.empty((n, 3)))


@helper
def find_apexes(points, ax, ay, az, cos, sin, t0, t1, cones, k):
    """Fill row k of cones for control points float64[16, 3] moved by t0 .. t1 along normals within (cos, sin) of axis a."""
    cos, sin = cos - PAD, sin + PAD
    cones.sine[k] = np.inf
    for c in range(3):
        cones.axis[k, c] = cones.behind[k, c] = cones.before[k, c] = 0.0
    if not cos > 0.0:
        return
    tan = sin / cos * (1.0 + PAD)
    # Two axes across a.
    if abs(ax) < 0.6:
        ux, uy, uz = 0.0, az, -ay
    else:
        ux, uy, uz = -az, 0.0, ax
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    vx, vy, vz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    ox, oy, oz = points[0, 0], points[0, 1], points[0, 2]
    u0 = u1 = v0 = v1 = size = 0.0
    for i in range(16):
        px, py, pz = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        u, v = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        size = max(size, abs(px), abs(py), abs(pz))
    mid_u, mid_v = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    lo, hi = np.inf, -np.inf
    for i in range(16):
        px, py, pz = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        u, v = px * ux + py * uy + pz * uz - mid_u, px * vx + py * vy + pz * vz - mid_v
        h, r = px * ax + py * ay + pz * az, math.sqrt(u * u + v * v)
        lo, hi = min(lo, h - r * tan), max(hi, h + r * tan)
    moved = max(abs(t0), abs(t1))
    lo += min(t0, t0 * cos) - moved * sin * tan
    hi += max(t1, t1 * cos) + moved * sin * tan
    slack = (PAD * (size + moved) + 2e-15 * (abs(ox) + abs(oy) + abs(oz))) * (1.0 + tan)
    mx, my, mz = ox + (mid_u * ux + mid_v * vx), oy + (mid_u * uy + mid_v * vy), oz + (mid_u * uz + mid_v * vz)
    lo, hi = lo - slack, hi + slack
    cones.sine[k] = sin
    cones.axis[k, 0], cones.axis[k, 1], cones.axis[k, 2] = ax, ay, az
    cones.behind[k, 0], cones.behind[k, 1], cones.behind[k, 2] = mx + lo * ax, my + lo * ay, mz + lo * az
    cones.before[k, 0], cones.before[k, 1], cones.before[k, 2] = mx + hi * ax, my + hi * ay, mz + hi * az


@kernel
def _face_eyes(cones, x, y, z, out):
    """Facing of each cone's patch to eyes (x, y, z): uint8[eyes, patches]; branch-free, so that eyes are lanes."""
    for k in range(len(cones.sine)):
        ax, ay, az, sine = cones.axis[k, 0], cones.axis[k, 1], cones.axis[k, 2], cones.sine[k]
        bx, by, bz = cones.behind[k, 0], cones.behind[k, 1], cones.behind[k, 2]
        fx, fy, fz = cones.before[k, 0], cones.before[k, 1], cones.before[k, 2]
        row = out[k]
        for e in range(len(x)):
            dx, dy, dz = x[e] - bx, y[e] - by, z[e] - bz
            back = dx * ax + dy * ay + dz * az < -sine * np.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = x[e] - fx, y[e] - fy, z[e] - fz
            front = dx * ax + dy * ay + dz * az > sine * np.sqrt(dx * dx + dy * dy + dz * dz)
            row[e] = np.uint8(BACK) if back else (np.uint8(FRONT) if front else np.uint8(SILHOUETTE))


def face_eyes(cones: Cones, eyes: F64) -> U8:
    """Facing of each patch to each eye, uint8[patches, eyes]; eyes : float64[eyes, 3]."""
    out = np.empty((len(cones.sine), len(eyes)), np.uint8)
    _face_eyes(cones, *np.ascontiguousarray(eyes.T, np.float64), out)
    return out


def classify_by_cones(make: MakeCones, stage: HullInput, numbers: I64) -> U8:
    """Facing of the patches `numbers`, uint8: of undisplaced ones, and of those displaced by a constant little enough."""
    facing = np.zeros(len(numbers), np.uint8)
    eye = eye_or_none(stage)
    if eye is None:
        return facing
    offsets = constant_offsets(stage, numbers)
    at = np.flatnonzero(offsets.known)
    cones = make(stage.patches, numbers[at], offsets.of(at))
    facing[at] = turn_mirrored(stage, face_eyes(cones, eye[None])[:, 0])
    return facing
