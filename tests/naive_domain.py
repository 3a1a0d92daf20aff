"""Slow twins of pipeline/domain.py and pipeline/displacement.py, one point at a time.

`naive_shade` computes in float32 scalars, in the order of operations that the domain shader documents, and must give the
same bits. `exact_surface` and `exact_displacement` compute in float64 by other means (de Casteljau's algorithm, analytic
derivatives) and tell how far both may be from the truth.
"""

from itertools import pairwise
from math import comb
from typing import NamedTuple

import numpy as np

F = np.float32


class NaiveMap(NamedTuple):
    texels: np.ndarray  # float32[h, w]
    address: str  # wrap, mirror or clamp
    scale: float
    bias: float


# Bernstein polynomials and sums, in any number type


def cubic(t, number=F):
    s = number(1) - t
    return [(s * s) * s, (number(3) * t) * (s * s), (number(3) * s) * (t * t), (t * t) * t]


def quadratic(t, number=F):
    s = number(1) - t
    return [s * s, s * t + s * t, t * t]


def balanced_sum(terms):
    """Outer pair plus inner pair (or middle): the same whichever end one starts from."""
    if len(terms) == 4:
        return (terms[0] + terms[3]) + (terms[1] + terms[2])
    return (terms[0] + terms[2]) + terms[1]


def evaluate(net, bu, bv):
    """Value of net[i][j]: over i for each j, then over j."""
    columns = [balanced_sum([bu[i] * net[i][j] for i in range(len(bu))]) for j in range(len(bv))]
    return balanced_sum([bv[j] * columns[j] for j in range(len(bv))])


def coordinate(cp, c):
    return [[cp[i, j, c] for j in range(4)] for i in range(4)]


def step_u(net):
    return [[net[i + 1][j] - net[i][j] for j in range(4)] for i in range(3)]


def step_v(net):
    return [[net[i][j + 1] - net[i][j] for j in range(3)] for i in range(4)]


def tangents(cp, rational, u, v, number=F):
    """A third of both derivatives; times w where rational. The differences are float32 whatever the number type."""
    bu, bv, qu, qv = cubic(u, number), cubic(v, number), quadratic(u, number), quadratic(v, number)
    weights = coordinate(cp, 3)
    along_u, along_v = [], []
    for c in range(3):
        net = coordinate(cp, c)
        du, dv = evaluate(step_u(net), qu, bv), evaluate(step_v(net), bu, qv)
        if rational:
            x = evaluate(net, bu, bv) / evaluate(weights, bu, bv)
            du = du - evaluate(step_u(weights), qu, bv) * x
            dv = dv - evaluate(step_v(weights), bu, qv) * x
        along_u.append(du)
        along_v.append(dv)
    return along_u, along_v


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def square(a):
    return (a[0] * a[0] + a[1] * a[1]) + a[2] * a[2]


# The domain shader in float32


def scaled_unit(a):
    """Unit vector in float64, of any length; zero for no direction."""
    largest = max(abs(x) for x in a)
    if not 0 < largest < np.inf:
        return [0.0, 0.0, 0.0]
    a = [x / largest for x in a]
    return [x / np.sqrt(square(a)) for x in a]


def float64_normal(cp, rational, u, v):
    a, b = tangents(cp, rational, u, v, np.float64)
    return scaled_unit(cross(scaled_unit(a), scaled_unit(b)))


def base_normal(cp, rational, a, b, u, v):
    n = cross(a, b)
    if F(2.0**-100) < square(n) < F(2.0**100):
        length = np.sqrt(square(n))
        return [x / length for x in n]
    u, v = np.float64(u), np.float64(v)
    n = float64_normal(cp, rational, u, v)
    if n == [0, 0, 0]:  # move 2^-9 of the way to the middle
        n = float64_normal(cp, rational, u + (0.5 - u) / 512, v + (0.5 - v) / 512)
    return [F(x) for x in n]


def address(i, n, mode):
    """The texel that is read for texel number i of an axis with n texels."""
    if mode == "wrap":
        return i % n
    if mode == "mirror":
        return i % n if (i // n) % 2 == 0 else n - 1 - i % n
    return sorted((0, i, n - 1))[1]


def fetch(image, x, y):
    """Bilinear value at texel coordinates (x, y) and its derivatives along both."""
    height, width = image.texels.shape
    if not (abs(x) < 2**30 and abs(y) < 2**30):
        x, y = F(0), F(0)
    i, j = int(np.floor(x)), int(np.floor(y))
    right, below = x - np.floor(x), y - np.floor(y)
    left, above = F(1) - right, F(1) - below
    (t00, t10), (t01, t11) = (
        [image.texels[address(row, height, image.address), address(i + k, width, image.address)] for k in (0, 1)]
        for row in (j, j + 1)
    )
    upper, lower = left * t00 + right * t10, left * t01 + right * t11
    return above * upper + below * lower, above * (t10 - t00) + below * (t11 - t01), lower - upper


def texture_coordinate(corners, u, v):
    """Of one axis; corners in the order (0,0) (1,0) (0,1) (1,1)."""
    u0, v0 = F(1) - u, F(1) - v
    return v0 * (u0 * corners[0] + u * corners[1]) + v * (u0 * corners[2] + u * corners[3])


def texture_slopes(corners, u, v):
    """Its derivatives along u and v."""
    u0, v0 = F(1) - u, F(1) - v
    along_u = v0 * (corners[1] - corners[0]) + v * (corners[3] - corners[2])
    return along_u, u0 * (corners[2] - corners[0]) + u * (corners[3] - corners[1])


def displacement(image, texcoords, u, v):
    """Displacement and its derivatives along u and v."""
    height, width = (F(n) for n in image.texels.shape)
    scale, bias = F(image.scale), F(image.bias)
    x = texture_coordinate(texcoords[:, 0], u, v) * width - F(0.5)
    y = texture_coordinate(texcoords[:, 1], u, v) * height - F(0.5)
    value, along_x, along_y = fetch(image, x, y)
    slopes = []
    for s, t in zip(texture_slopes(texcoords[:, 0], u, v), texture_slopes(texcoords[:, 1], u, v), strict=True):
        slopes.append((scale * width) * (along_x * s) + (scale * height) * (along_y * t))
    return scale * value + bias, *slopes


def owner_coordinates(patches, p, u, v):
    """(s, t) of the patch that owns the edge or corner at (u, v), where patch p touches a closed seam; else None."""
    row = patches.seam_id[p]
    if row < 0 or (0 < u < 1 and 0 < v < 1):
        return None
    if u in (0, 1) and v in (0, 1):
        return patches.seam_corners[row, int(u) + 2 * int(v)]
    edge, w = ({0: 0, 1: 2}[int(u)], v) if u in (0, 1) else ({0: 1, 1: 3}[int(v)], u)
    low, high = patches.seam_edges[row, edge]
    return [(F(1) - w) * low[c] + w * high[c] for c in range(2)]


def value_at(image, s, t):
    height, width = (F(n) for n in image.texels.shape)
    return F(image.scale) * fetch(image, s * width - F(0.5), t * height - F(0.5))[0] + F(image.bias)


def vector_displacement(image, turn, texcoords, owner, u, v):
    """Vector in world space, and its derivatives along u and v. image: texels (h, w, 3); owner: (s, t) or None."""
    parts = [image._replace(texels=np.ascontiguousarray(image.texels[..., c])) for c in range(3)]
    d, du, dv = zip(*(displacement(part, texcoords, u, v) for part in parts), strict=True)
    if owner is not None:
        d = [value_at(part, *owner) for part in parts]
    moved = [(row[0] * d[0] + row[1] * d[1]) + row[2] * d[2] for row in turn]
    return (
        moved,
        [[row[c] * du[c] for c in range(3)] for row in turn],
        [[row[c] * dv[c] for c in range(3)] for row in turn],
    )


def displaced_by_vector(image, turn, texcoords, owner, u, v, point, a, b, n, scale):
    """Point and unit normal. a, b: derivatives divided by scale."""
    moved, du, dv = vector_displacement(image, turn, texcoords, owner, u, v)
    a = [((scale * a[r] + du[r][0]) + du[r][1]) + du[r][2] for r in range(3)]
    b = [((scale * b[r] + dv[r][0]) + dv[r][1]) + dv[r][2] for r in range(3)]
    m = cross(a, b)
    n = [x / np.sqrt(square(m)) for x in m] if F(2.0**-100) < square(m) < F(2.0**100) else n
    return [point[r] + moved[r] for r in range(3)], n


def displaced_normal(a, b, n, along_u, along_v, scale=3):
    """Unit of 3 (A x B) + t_v (A x n) + t_u (n x B), where A and B are thirds of the derivatives; or wholes, scale 1."""
    base, by_v, by_u = cross(a, b), cross(a, n), cross(n, b)
    m = [F(scale) * base[c] + (along_v * by_v[c] + along_u * by_u[c]) for c in range(3)]
    if not (square(base) > F(2.0**-100) and F(2.0**-100) < square(m) < F(2.0**100)):
        return n
    return [x / np.sqrt(square(m)) for x in m]


def gregory_net(cp, inner, c, u, v):
    """Net of one coordinate with the inner points of (u, v), and a third of what their change adds to both derivatives."""
    net, one, s, r = coordinate(cp, c), F(1), F(1) - u, F(1) - v
    add_u, add_v = [], []
    third = one / (one + one + one)
    bu, bv = cubic(u), cubic(v)
    # Corner: indices, weights of f+ and f-, and the factors of the slope along u and v (the sign comes with the sum).
    corners = [((1, 1), u, v, v, u), ((2, 1), v, s, v, s), ((2, 2), s, r, r, s), ((1, 2), r, u, r, u)]
    for (plus, minus), ((i, j), a, b, _, _) in zip(inner[:, :, c], corners, strict=True):
        d = one / (a + b if a + b > 0 else one)
        net[i][j] = (a * plus + b * minus) * d
        slope = (plus - minus) * (d * d) * (bu[i] * bv[j])
        add_u.append(slope)
        add_v.append(slope)
    along_u = (v * (add_u[0] + add_u[1]) - r * (add_u[2] + add_u[3])) * third
    along_v = (s * (add_v[1] + add_v[2]) - u * (add_v[0] + add_v[3])) * third
    return net, along_u, along_v


def edge_normal(net, t):
    """Unit normal of an edge's six control vectors (float32[6, 3]) at t."""
    s = F(1) - t
    tt, ss = t * t, s * s
    basis = [(ss * ss) * s, (F(5) * t) * (ss * ss), (F(10) * tt) * (ss * s), (F(10) * ss) * (tt * t)]
    basis += [(F(5) * s) * (tt * tt), (tt * tt) * t]
    b = [[basis[k] * net[k, c] for k in range(6)] for c in range(3)]
    n = [((x[0] + x[5]) + (x[1] + x[4])) + (x[2] + x[3]) for x in b]
    if square(n) > F(2.0**-20):
        return [x / np.sqrt(square(n)) for x in n]
    return None


def shared_normal(patches, p, u, v):
    """The normal that patch p shares with its neighbours at (u, v); None inside, and where the edge's is uncertain."""
    row = patches.normal_id[p]
    if row < 0 or (0 < u < 1 and 0 < v < 1):
        return None
    if u in (0, 1) and v in (0, 1):
        return list(patches.corner_normals[patches.corner_row[row, int(u) + 2 * int(v)]])
    e = {(True, 0): 0, (True, 1): 2, (False, 0): 1, (False, 1): 3}[u in (0, 1), int(u) if u in (0, 1) else int(v)]
    t, edge = (v if u in (0, 1) else u), patches.edge_row[row, e]
    return edge_normal(patches.edge_normals[edge] if edge >= 0 else patches.edge_normals[~edge][::-1], t)


def naive_shade_patch(patches, p, image, matrix, u, v, turn=None):
    """As `naive_shade`, for patch p of any kind whose normals do not vanish. turn: float32[3, 3] for a map of vectors."""
    with np.errstate(all="ignore"):
        u, v = F(u), F(v)
        cp, bu, bv, qu, qv = patches.control_points[p], cubic(u), cubic(v), quadratic(u), quadratic(v)
        nets, scale = [coordinate(cp, c) for c in range(3)], F(3)
        if patches.tangent_id[p] >= 0:
            tu, tv = patches.tangent_u[patches.tangent_id[p]], patches.tangent_v[patches.tangent_id[p]]
            a = [evaluate([[tu[i, j, c] for j in range(4)] for i in range(3)], qu, bv) for c in range(3)]
            b = [evaluate([[tv[i, j, c] for j in range(3)] for i in range(4)], bu, qv) for c in range(3)]
            scale = F(1)
        else:
            added = [(F(0), F(0))] * 3
            if patches.gregory_id[p] >= 0:
                made = [gregory_net(cp, patches.inner[patches.gregory_id[p]], c, u, v) for c in range(3)]
                nets, added = [m[0] for m in made], [m[1:] for m in made]
            a = [evaluate(step_u(nets[c]), qu, bv) + added[c][0] for c in range(3)]
            b = [evaluate(step_v(nets[c]), bu, qv) + added[c][1] for c in range(3)]
        point = [evaluate(net, bu, bv) for net in nets]
        n = base_normal(cp, False, a, b, u, v)
        owner = owner_coordinates(patches, p, u, v)
        if image is not None and turn is not None:
            point, n = displaced_by_vector(image, turn, patches.texcoords[p], owner, u, v, point, a, b, n, scale)
        elif image is not None:
            n = shared_normal(patches, p, u, v) or n
            t, along_u, along_v = displacement(image, patches.texcoords[p], u, v)
            t = t if owner is None else value_at(image, *owner)
            point = [point[c] + t * n[c] for c in range(3)]
            n = displaced_normal(a, b, n, along_u, along_v, scale)
        else:
            n = shared_normal(patches, p, u, v) or n
        clip = [((row[0] * point[0] + row[1] * point[1]) + row[2] * point[2]) + row[3] for row in matrix]
        return np.array(clip, F), np.array(n, F)


def naive_shade(cp, texcoords, image, matrix, u, v):
    """Clip position and normal at (u, v), float32. image: a NaiveMap or None. cp float32[4, 4, 4]."""
    with np.errstate(all="ignore"):
        u, v = F(u), F(v)
        rational = bool((cp[..., 3] != 1).any())
        bu, bv = cubic(u), cubic(v)
        p = [evaluate(coordinate(cp, c), bu, bv) for c in range(3)]
        a, b = tangents(cp, rational, u, v)
        if rational:
            w = evaluate(coordinate(cp, 3), bu, bv)
            p, a, b = [x / w for x in p], [x / w for x in a], [x / w for x in b]
        n = base_normal(cp, rational, a, b, u, v)
        if image is not None:
            t, along_u, along_v = displacement(image, texcoords, u, v)
            p = [p[c] + t * n[c] for c in range(3)]
            n = displaced_normal(a, b, n, along_u, along_v)
        clip = [((row[0] * p[0] + row[1] * p[1]) + row[2] * p[2]) + row[3] for row in matrix]
        return np.array(clip, F), np.array(n, F)


# The truth, in float64


def bernstein(degree, t):
    """All Bernstein polynomials of a degree at t."""
    return np.array([comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)])


def de_casteljau(points, t):
    """Value at t of a cubic Bezier curve, and a third of its derivative: the difference of the last two points."""
    points = [np.asarray(p, np.float64) for p in points]
    while len(points) > 2:
        points = [(1 - t) * p + t * q for p, q in pairwise(points)]
    return (1 - t) * points[0] + t * points[1], points[1] - points[0]


def exact_surface(cp, u, v):
    """Position, a third of both derivatives, and the weight, by de Casteljau's algorithm in float64."""
    rows = [de_casteljau(cp[i], v) for i in range(4)]
    value, along_u = de_casteljau([row[0] for row in rows], u)
    along_v = de_casteljau([row[1] for row in rows], u)[0]
    position, weight = value[:3] / value[3], value[3]
    along_u, along_v = ((d[:3] - d[3] * position) / weight for d in (along_u, along_v))
    return position, along_u, along_v, weight


def exact_displacement(image, texcoords, u, v):
    """Displacement and its derivatives along u and v; and the distance of the texel coordinates from a texel's border."""
    corners = texcoords.astype(np.float64)
    at = (1 - v) * ((1 - u) * corners[0] + u * corners[1]) + v * ((1 - u) * corners[2] + u * corners[3])
    at_u = (1 - v) * (corners[1] - corners[0]) + v * (corners[3] - corners[2])
    at_v = (1 - u) * (corners[2] - corners[0]) + u * (corners[3] - corners[1])
    height, width = image.texels.shape
    size = np.array([width, height])
    x, y = at * size - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    block = np.array(
        [
            [image.texels[address(r, height, image.address), address(c, width, image.address)] for c in (i, i + 1)]
            for r in (j, j + 1)
        ],
        np.float64,
    )
    wx, wy = np.array([i + 1 - x, x - i]), np.array([j + 1 - y, y - j])
    slope = np.array([wy @ (block[:, 1] - block[:, 0]), (block[1] - block[0]) @ wx]) * size * float(F(image.scale))
    value = float(F(image.scale)) * (wy @ block @ wx) + float(F(image.bias))
    border = min(x - i, i + 1 - x, y - j, j + 1 - y)
    return value, slope @ at_u, slope @ at_v, border
