"""`taylor` and `taylor_clamped`: bounds by Taylor models of the displaced surface, its normalization included.

Munkberg, Hasselgren, Toth, Akenine-Moller 2010, their bound "Taylor". In the oriented box's frame, over the patch's domain with
s, t in [-1, 1]: position p of bi-degree (3, 3), n = p_u x p_v of bi-degree (5, 5), both exact; models of bi-degree (5, 5)
of |n|^2, of 1 / |n| and of n^ = n / |n|; and with displacements in m +- r the surface p + t n^ is the model p + m n^ and
the interval r [-1, 1] n^. Its Bernstein range is the box. `taylor` is that. `taylor_clamped` also uses |n^| <= 1 on each
axis: it lies inside the box that `obbtex` makes, and no longer grows as the remainder of the normalization does.
Without displacement both are the range of p in Bernstein form of degree 5, inside that of the 16 control points.

The unit box stands for n^ where |n|^2 is not surely positive: there the normal may be anything, also the nudged one or the
zero that the shader falls back to. So it does for rational patches: their normals are no polynomials of that degree.

Why it holds for what float32 computes (u = 2^-24); terms of second order are covered by rounding constants up:

- position: `cbox.position_errors`; a displaced one rounds once more, t n^ once;
- tangents (any float32 u, v): difference 1 rounding, quadratic basis 3 or cubic basis 5, each with a product and a sum:
  16 u sum B_ij |d_ij|, at most 16 u A and 16 u B with A, B the longest differences of the patch;
- the cross product of two vectors adds 2 u (2 / sqrt 3) A B: altogether off by less than 35 u A B, and by what underflows:
  2^-149 a product, times the other tangent. Where it is used it is longer than 2^-50; where it is not, float64 is;
- a vector n off by e changes direction by at most asin(e / |n|), and its unit by at most sqrt 2 e / |n|; making it unit
  rounds by 4 u. Where e >= |n| is possible the unit box stands.

Patches with tangent patches (ACC) have n from those, nets of the same degrees; Gregory patches get the unit box. Normals that
patches share on their edges count as an error of n^ (`shared_normals`). The normal cone is that of `npatch`; the models
give none.

float64 rounding is carried along by the models (2^-46 of their coefficients); that of the control points over the domain
and in the frame, 2^-48 of the largest, is below the u that the constants leave.
"""

from typing import NamedTuple

import numpy as np

from pipeline.bounds import taylor_model as model
from pipeline.bounds.cbox import position_errors
from pipeline.bounds.fit import AXES, FLOAT64, HI, LO
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.normals import NPATCH, bound_normals
from pipeline.bounds.project import allocate, project_boxes
from pipeline.bounds.restrict import project_net, restrict_patch
from pipeline.bounds.shared_normals import slack_of
from pipeline.bounds.vector import grow_by_vectors
from pipeline.jit import helper, kernel
from pipeline.types import F64, U8, HullInput, PatchBounds

U = 2.0**-24
NORMAL_ERROR = 35.0  # of the cross product, in u A B


class Work(NamedTuple):
    """Scratch arrays of one thread."""

    points: F64  # (4, 4, 4) control points over the domain, the first three projected
    axes: F64  # (3, 3) rows: the oriented box's frame, of `fit`
    net: F64  # (3, 4, 4) the same points in the frame
    steps_u: F64  # (3, 3, 4) their differences along u, over the longest
    steps_v: F64  # (3, 4, 3)
    position: F64  # (6, 6) polynomials from here on
    along_u: F64  # (3, 6, 6)
    along_v: F64  # (3, 6, 6)
    normal: F64  # (3, 6, 6) p_u x p_v, then its unit
    rests: F64  # (3, 2) remainders of the unit normal
    square: F64  # (6, 6)
    series: F64  # (6, 6)
    inverse: F64  # (6, 6)
    wide: F64  # (11, 11)
    half: F64  # (12, 11)


def allocate_work() -> Work:
    """Scratch arrays, not initialized."""
    n = model.N
    return Work(
        points=np.empty((4, 4, 4)),
        axes=np.empty((3, 3)),
        net=np.empty((3, 4, 4)),
        steps_u=np.empty((3, 3, 4)),
        steps_v=np.empty((3, 4, 3)),
        position=np.empty((n, n)),
        along_u=np.empty((3, n, n)),
        along_v=np.empty((3, n, n)),
        normal=np.empty((3, n, n)),
        rests=np.empty((3, 2)),
        square=np.empty((n, n)),
        series=np.empty((n, n)),
        inverse=np.empty((n, n)),
        wide=np.empty(model.WIDE_SHAPE),
        half=np.empty(model.HALF_SHAPE),
    )


# Control nets to polynomials over the domain


@helper
def _quadratic_powers(a, b):
    """Row k: quadratic Bernstein polynomial k at u = m + h s, coefficients of s^0 .. s^2; the ends s = -1, 1 are a, b."""
    m, h = 0.5 * (a + b), 0.5 * (b - a)
    n, hh = 1.0 - m, h * h
    return (
        (n * n, -2.0 * n * h, hh),
        (2.0 * m * n, 2.0 * (n - m) * h, -2.0 * hh),
        (m * m, 2.0 * m * h, hh),
    )


@helper
def _cubic_powers(a, b):
    """As `_quadratic_powers`, cubic."""
    m, h = 0.5 * (a + b), 0.5 * (b - a)
    n, hh = 1.0 - m, h * h
    return (
        (n * n * n, -3.0 * n * n * h, 3.0 * n * hh, -hh * h),
        (3.0 * m * n * n, 3.0 * n * (n - 2.0 * m) * h, 3.0 * (m - 2.0 * n) * hh, 3.0 * hh * h),
        (3.0 * m * m * n, 3.0 * m * (2.0 * n - m) * h, 3.0 * (n - 2.0 * m) * hh, -3.0 * hh * h),
        (m * m * m, 3.0 * m * m * h, 3.0 * m * hh, hh * h),
    )


@helper
def _polynomial_into(net, powers_u, powers_v, out):
    """Polynomial of a control net: sum of net[k, m] powers_u[k][i] powers_v[m][j] s^i t^j."""
    for i in range(model.N):
        for j in range(model.N):
            out[i, j] = 0.0
    for m in range(len(powers_v)):
        for i in range(len(powers_u)):
            along = 0.0
            for k in range(len(powers_u)):
                along += net[k, m] * powers_u[k][i]
            for j in range(len(powers_v)):
                out[i, j] += along * powers_v[m][j]


@helper
def _rotate(work):
    """Control points over the domain to the frame; returns the greatest length of one, up to rounding."""
    axes, points = work.axes, work.points
    square = 0.0
    for r in range(3):
        for i in range(4):
            for j in range(4):
                x, y, z = points[i, j, 0], points[i, j, 1], points[i, j, 2]
                work.net[r, i, j] = axes[r, 0] * x + axes[r, 1] * y + axes[r, 2] * z
                square = max(square, x * x + y * y + z * z)
    return np.sqrt(square)


@helper
def _rotate_step(x, y, z, axes, steps, i, j):
    """Vector (x, y, z) in the frame to steps[:, i, j]; returns the square of its length."""
    for r in range(3):
        steps[r, i, j] = axes[r, 0] * x + axes[r, 1] * y + axes[r, 2] * z
    return x * x + y * y + z * z


@helper
def _difference(p, q):
    return np.float64(q[0]) - p[0], np.float64(q[1]) - p[1], np.float64(q[2]) - p[2]


@helper
def _rotate_steps(cp, acc, tangent_u, tangent_v, work):
    """Control vectors of the tangents in the frame, divided by the longest along u and along v, which are returned.

    Differences of all control points, or (acc >= 0) the tangent patches of that row.
    """
    square_u = square_v = 0.0
    for i in range(4):
        for j in range(4):
            if i < 3:
                x, y, z = _difference(cp[i, j], cp[i + 1, j])
                if acc >= 0:
                    x, y, z = (
                        np.float64(tangent_u[acc, i, j, 0]),
                        np.float64(tangent_u[acc, i, j, 1]),
                        np.float64(tangent_u[acc, i, j, 2]),
                    )
                square_u = max(square_u, _rotate_step(x, y, z, work.axes, work.steps_u, i, j))
            if j < 3:
                x, y, z = _difference(cp[i, j], cp[i, j + 1])
                if acc >= 0:
                    x, y, z = (
                        np.float64(tangent_v[acc, i, j, 0]),
                        np.float64(tangent_v[acc, i, j, 1]),
                        np.float64(tangent_v[acc, i, j, 2]),
                    )
                square_v = max(square_v, _rotate_step(x, y, z, work.axes, work.steps_v, i, j))
    longest_u, longest_v = np.sqrt(square_u), np.sqrt(square_v)
    for r in range(3):
        for i in range(4):
            for j in range(3):
                work.steps_u[r, j, i] /= longest_u
                work.steps_v[r, i, j] /= longest_v
    return longest_u, longest_v


# Normals


@helper
def _add_tangent_product(a, b, sign, out):
    """Add sign a b, for a of bi-degree (2, 3) and b of bi-degree (3, 2)."""
    for i in range(3):
        for k in range(4):
            for j in range(4):
                for m in range(3):
                    out[i + k, j + m] += sign * a[i, j] * b[k, m]


@helper
def _normal_model(u0, u1, v0, v1, work):
    """Polynomials of n = p_u x p_v; returns their remainder: nothing but rounding."""
    quadratic_u, quadratic_v = _quadratic_powers(u0, u1), _quadratic_powers(v0, v1)
    cubic_u, cubic_v = _cubic_powers(u0, u1), _cubic_powers(v0, v1)
    size_u = size_v = 0.0
    for r in range(3):
        _polynomial_into(work.steps_u[r], quadratic_u, cubic_v, work.along_u[r])
        _polynomial_into(work.steps_v[r], cubic_u, quadratic_v, work.along_v[r])
        size_u, size_v = size_u + model.magnitude(work.along_u[r]), size_v + model.magnitude(work.along_v[r])
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        model.clear(work.normal[r])
        _add_tangent_product(work.along_u[s], work.along_v[t], 1.0, work.normal[r])
        _add_tangent_product(work.along_u[t], work.along_v[s], -1.0, work.normal[r])
    pad = model.ROUND * size_u * size_v
    return -pad, pad


@helper
def _unit_normal_model(u0, u1, v0, v1, longest_u, longest_v, work):
    """Models of n^ to `work.normal` and `work.rests`; returns (valid, error of the shader's unit normal)."""
    if not (longest_u > 0.0 and longest_v > 0.0 and longest_u < np.inf and longest_v < np.inf):
        return False, 0.0
    n, wide, half = work.normal, work.wide, work.half
    n_rest = _normal_model(u0, u1, v0, v1, work)
    square_rest, (least, most) = model.square_length_into(n, n_rest, wide, half, work.square)
    if not least > 0.0:
        return False, 0.0
    turned = NORMAL_ERROR * U / np.sqrt(least) + 2.0**-90 * (longest_u + longest_v + 1.0)
    if not turned < 1.0:
        return False, 0.0
    rest = model.rsqrt_into(work.square, square_rest, (least, most), work.series, wide, half, work.inverse)
    inverse_range = (1.0 - model.ROUND) / np.sqrt(most), (1.0 + model.ROUND) / np.sqrt(least)
    for r in range(3):
        work.rests[r] = model.multiply_into(n[r], n_rest, work.inverse, rest, inverse_range, wide, half, n[r])
    return True, 1.5 * turned + 4.0 * U


# The box


@helper
def _displaced_range(position, p_range, normal, n_rest, n_error, t_lo, t_hi, clamped, work):
    """Range of p + t n^ along one axis, n^ off by n_error at most. Destroys the polynomial `normal`."""
    reach = max(abs(t_lo), abs(t_hi))
    middle, radius = 0.5 * (t_lo + t_hi), 0.5 * (t_hi - t_lo)
    n_range = model.add_intervals(model.range_of(normal, work.half), n_rest)
    spread = radius * (min(model.largest(n_range), 1.0) if clamped else model.largest(n_range))
    rest = model.scale_into(normal, n_rest, middle, normal)
    rest = model.add_into(position, (0.0, 0.0), normal, rest, normal)
    lo, hi = model.add_intervals(model.range_of(normal, work.half), rest)
    lo, hi = lo - spread - reach * n_error, hi + spread + reach * n_error
    if clamped:
        lo, hi = max(lo, p_range[0] - reach), min(hi, p_range[1] + reach)
    return lo, hi


@helper
def _net_range(net):
    """Least and greatest of 4 x 4 control values."""
    lo, hi = np.inf, -np.inf
    for i in range(4):
        for j in range(4):
            lo, hi = min(lo, net[i, j]), max(hi, net[i, j])
    return lo, hi


@helper
def _set_axis(p, r, lo, hi, axis, bounds):
    """Half-extent vector r of box p from its range along the unit vector `axis`, and its part of the center."""
    for c in range(3):
        bounds.axes[p, r, c] = 0.5 * (hi - lo) * axis[c]
        bounds.center[p, c] = (bounds.center[p, c] if r > 0 else 0.0) + 0.5 * (lo + hi) * axis[c]


@helper
def _bound(p, patches, domain, boxes, reach, normals, clamped, work, bounds):
    """Box of patch p; returns whether its normals have a model; also False where none is needed."""
    cp, rational = patches.control_points[p], patches.rational[p] != 0
    u0, u1, v0, v1 = domain[p]
    t_lo, t_hi = reach[0, p], reach[1, p]
    t_most = max(abs(t_lo), abs(t_hi)) + (t_lo - t_lo) + (t_hi - t_hi)
    restrict_patch(cp, u0, u1, v0, v1, work.points)
    if rational:
        project_net(work.points)
    for r in range(3):
        for c in range(3):
            work.axes[r, c] = boxes[AXES + 3 * r + c, p]
    size = _rotate(work)
    valid, n_error = False, 0.0
    # A displacement that is nothing beside the rounding of positions needs no normals.
    if not rational and patches.gregory_id[p] < 0 and t_most > 2.0**-60 * size:
        longest_u, longest_v = _rotate_steps(cp, patches.tangent_id[p], patches.tangent_u, patches.tangent_v, work)
        valid, n_error = _unit_normal_model(u0, u1, v0, v1, longest_u, longest_v, work)
        n_error += slack_of(patches, domain, p)
        valid &= n_error < 1.0
    errors = position_errors(cp, patches.rational[p])
    for r in range(3):
        axis = work.axes[r]
        fitted = boxes[LO + r, p], boxes[HI + r, p]
        pad = abs(axis[0]) * errors[0] + abs(axis[1]) * errors[1] + abs(axis[2]) * errors[2] + FLOAT64 * size
        if rational or patches.gregory_id[p] >= 0:
            span, pad = fitted, 0.0
        else:
            _polynomial_into(work.net[r], _cubic_powers(0.0, 1.0), _cubic_powers(0.0, 1.0), work.position)
            span = model.range_of(work.position, work.half)
        if valid:
            rest = work.rests[r, 0], work.rests[r, 1]
            span = _displaced_range(work.position, span, work.normal[r], rest, n_error, t_lo, t_hi, clamped, work)
        else:
            span = span[0] - t_most, span[1] + t_most
        pad += 8.0 * U * t_most + (2.0 * U * size if t_most > 0.0 else 0.0)
        pad += (fitted[0] - fitted[0]) + (fitted[1] - fitted[1])  # NaN where there is no bound
        _set_axis(p, r, span[0] - pad, span[1] + pad, axis, bounds)
    cosine = normals[3, p]
    bounds.cone_cos[p] = cosine
    for c in range(3):
        bounds.cone_axis[p, c] = work.axes[2, c] if cosine > -1.0 else 0.0
    return valid


@kernel
def _bound_patches(patches, domain, boxes, reach, normals, clamped, work, bounds, valid):
    for p in range(len(patches.control_points)):
        valid[p] = 1 if _bound(p, patches, domain, boxes, reach, normals, clamped, work, bounds) else 0


def bound_and_validity(stage: HullInput, clamped: bool) -> tuple[PatchBounds, U8]:
    """Bounds, and for each patch 1 where its normals have a model; 0 where they have none or none was needed."""
    n = len(stage.patches.control_points)
    bounds, valid = allocate(n), np.empty(n, np.uint8)
    reach = displacement_ranges(stage)
    boxes, normals = bound_normals(stage, NPATCH)
    _bound_patches(stage.patches, stage.domain, boxes, reach, normals, clamped, allocate_work(), bounds, valid)
    grow_by_vectors(stage, boxes, bounds.center, bounds.axes)
    project_boxes(stage.clip_from_world, stage.viewport, bounds)
    return bounds, valid


def bound_patches(stage: HullInput) -> PatchBounds:
    """`taylor`: bound every patch over its domain. A weight <= 0 gives a NaN box, which culls nothing."""
    return bound_and_validity(stage, False)[0]


def bound_patches_clamped(stage: HullInput) -> PatchBounds:
    """`taylor_clamped`: as `bound_patches`, with every normal's component cut to [-1, 1]."""
    return bound_and_validity(stage, True)[0]
