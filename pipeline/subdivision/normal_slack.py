"""How far the normals that patches share on edges and corners are from a patch's own, as unit vectors: `normal_slack`.

The patch's own normals along a side are a curve of degree 5, like those of the edge: what is bounded is the distance between
the unit vectors of two curves. Patches are looked at side by side (`wide`), and by the functions for one patch where a first
look at the whole curves leaves more than FINE_SLACK. Both have the same bits.
"""

import math

import numpy as np

from pipeline.jit import helper
from pipeline.wide import choose, greater, lesser, load, root, spread, store

U = 2.0**-24
FINE_SLACK, SLACK_LEVELS = 2.0**-12, 4  # bounds of slack above the first are looked at again on halves of the edge

QUINTIC = (1.0, 5.0, 10.0, 10.0, 5.0, 1.0)
TENFOLD = (1.0, 10.0, 45.0, 120.0, 210.0, 252.0, 210.0, 120.0, 45.0, 10.0, 1.0)


# One patch


@helper
def _least_length(n):
    """Lower bound of the length of a curve of degree 5, from the Bernstein coefficients of its square."""
    least = np.inf
    for k in range(11):
        total = 0.0
        for i in range(max(0, k - 5), min(5, k) + 1):
            j = k - i
            total += QUINTIC[i] * QUINTIC[j] * (n[i, 0] * n[j, 0] + n[i, 1] * n[j, 1] + n[i, 2] * n[j, 2])
        least = min(least, total / TENFOLD[k])
    return math.sqrt(least) if least > 0.0 else 0.0


@helper
def _halve(curve, first, second):
    """Both halves of a curve of degree 5 (de Casteljau); `second` may be `curve`."""
    for c in range(3):
        a0, a1, a2, a3, a4, a5 = curve[0, c], curve[1, c], curve[2, c], curve[3, c], curve[4, c], curve[5, c]
        first[0, c], second[5, c] = a0, a5
        a0, a1, a2, a3, a4 = 0.5 * (a0 + a1), 0.5 * (a1 + a2), 0.5 * (a2 + a3), 0.5 * (a3 + a4), 0.5 * (a4 + a5)
        first[1, c], second[4, c] = a0, a4
        a0, a1, a2, a3 = 0.5 * (a0 + a1), 0.5 * (a1 + a2), 0.5 * (a2 + a3), 0.5 * (a3 + a4)
        first[2, c], second[3, c] = a0, a3
        a0, a1, a2 = 0.5 * (a0 + a1), 0.5 * (a1 + a2), 0.5 * (a2 + a3)
        first[3, c], second[2, c] = a0, a2
        a0, a1 = 0.5 * (a0 + a1), 0.5 * (a1 + a2)
        first[4, c], second[1, c] = a0, a1
        first[5, c] = second[0, c] = 0.5 * (a0 + a1)


@helper
def _greatest_length(n):
    most = 0.0
    for k in range(6):
        most = max(most, math.sqrt(n[k, 0] * n[k, 0] + n[k, 1] * n[k, 1] + n[k, 2] * n[k, 2]))
    return most


@helper
def edge_slack(n, row, with_edge, pieces):
    """Bound of the distance between the unit vectors of two curves of degree 5: n (6, 3), and `row`, the edge's.

    With M = row, N = n times what brings it closest to M: |N/|N| - M/|M|| <= 2 |N - M| / |M|. A difference is at most its
    greatest control vector. The rounding of the edge's six products and sums in float32, at most 16 u of the greatest
    control vector, counts as difference. Where the Bernstein coefficients do not show that M is well away from zero, the
    curves are halved, up to SLACK_LEVELS times. pieces : float64[3, SLACK_LEVELS + 1, 6, 3], scratch.
    """
    own, total = 0.0, 0.0
    difference, edge, most = pieces[0], pieces[1], 0.0
    for k in range(6):
        for c in range(3):
            edge[0, k, c] = row[k if with_edge else 5 - k, c]
            own += n[k, c] * edge[0, k, c]
            total += n[k, c] * n[k, c]
    if not (total > 0.0 and own > 0.0):  # a negative multiple of N would be close to M where N is opposite to it
        return 2.0
    scale = own / total
    for k in range(6):
        for c in range(3):
            difference[0, k, c] = scale * n[k, c] - edge[0, k, c]
    rounding = 16.0 * U * _greatest_length(edge[0])
    depth, top = pieces[2, :, 0, 0], 0  # a stack: its pieces' levels, and the piece to look at
    depth[0] = 0.0
    while top >= 0:
        least = _least_length(edge[top])
        slack = 2.0 * (_greatest_length(difference[top]) + rounding) / least if least > 0.0 else 2.0
        if slack > FINE_SLACK and depth[top] < SLACK_LEVELS:
            _halve(difference[top], difference[top + 1], difference[top])
            _halve(edge[top], edge[top + 1], edge[top])
            depth[top] += 1.0
            depth[top + 1] = depth[top]
            top += 1
            continue
        most = max(most, slack)
        top = top - 1 if most < 2.0 else -1
    return min(most + 4.0 * U, 2.0)


@helper
def corner_slack(x, y, z, corner):
    """Distance between the unit vector of (x, y, z) and a corner's, with what rounds."""
    size = math.sqrt(x * x + y * y + z * z)
    if not size > 0.0:
        return 2.0
    dx, dy, dz = x / size - corner[0], y / size - corner[1], z / size - corner[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz) + 4.0 * U


# Patches side by side. Rows of the scratch array: nets of the tangents (tu (3, 4, 3), tv (4, 3, 3)); the patch's own normals
# along a side, their difference to the edge's, and those (6, 3 each); the corner's normal; products of two vectors (6, 6).

TU, TV, OWN, DIFFERENCE, EDGE, CORNER, PRODUCTS = 0, 36, 72, 90, 108, 126, 129
ROWS = 165


@helper
def load_differences(cp, lane, s):
    """Nets of a lane's patch that is bicubic: control points (4, 4, 4)."""
    for i in range(3):
        for j in range(4):
            for c in range(3):
                s[TU + 3 * (4 * i + j) + c, lane] = 3.0 * (np.float64(cp[i + 1, j, c]) - np.float64(cp[i, j, c]))
                s[TV + 3 * (3 * j + i) + c, lane] = 3.0 * (np.float64(cp[j, i + 1, c]) - np.float64(cp[j, i, c]))


@helper
def load_nets(tu, tv, lane, s):
    """Nets of a lane's patch that has some of its own."""
    for i in range(3):
        for j in range(4):
            for c in range(3):
                s[TU + 3 * (4 * i + j) + c, lane] = tu[i, j, c]
                s[TV + 3 * (3 * j + i) + c, lane] = tv[j, i, c]


@helper
def _add_product(s, k, w, y, x):
    """Own control vector k += w * y x x, of the vectors in rows y .. and x .. ."""
    y0, y1, y2, x0, x1, x2 = load(s, y), load(s, y + 1), load(s, y + 2), load(s, x), load(s, x + 1), load(s, x + 2)
    row = OWN + 3 * k
    store(s, row, load(s, row) + w * (y1 * x2 - y2 * x1))
    store(s, row + 1, load(s, row + 1) + w * (y2 * x0 - y0 * x2))
    store(s, row + 2, load(s, row + 2) + w * (y0 * x1 - y1 * x0))


@helper
def _find_own(k, s):
    """Rows OWN on side k, as `control_points._edge_normal_net`."""
    quadratic, cubic = (1.0, 2.0, 1.0), (1.0, 3.0, 3.0, 1.0)
    for row in range(18):
        store(s, OWN + row, spread(0.0))
    far = k == 1 or k == 2
    along, across = (3, 2) if far else (0, 0)
    for i in range(3):
        for j in range(4):
            w = quadratic[i] * cubic[j] / QUINTIC[i + j]
            if k == 0 or k == 2:
                _add_product(s, i + j, w, TU + 3 * (4 * i + along), TV + 3 * (3 * j + across))
            else:
                _add_product(s, i + j, -w, TV + 3 * (3 * along + i), TU + 3 * (4 * across + j))


@helper
def _vector(s, row, k):
    row = row + 3 * k
    return load(s, row), load(s, row + 1), load(s, row + 2)


@helper
def _greatest(s, row):
    """As `_greatest_length` of the curve in rows row .. ."""
    most = spread(0.0)
    for k in range(6):
        x, y, z = _vector(s, row, k)
        most = greater(most, x * x + y * y + z * z)
    return root(most)


@helper
def _least_square(s):
    """As `_least_length` of the edge's curve, squared where it is positive."""
    for i in range(6):
        a, b, c = _vector(s, EDGE, i)
        for j in range(i, 6):
            x, y, z = _vector(s, EDGE, j)
            product = QUINTIC[i] * QUINTIC[j] * (a * x + b * y + c * z)
            store(s, PRODUCTS + 6 * i + j, product)
            store(s, PRODUCTS + 6 * j + i, product)
    least = spread(np.inf)
    for k in range(11):
        total = spread(0.0)
        for i in range(max(0, k - 5), min(5, k) + 1):
            total = total + load(s, PRODUCTS + 6 * i + k - i)
        least = lesser(least, total / TENFOLD[k])
    return least


@helper
def _edge_slacks(s):
    """As `edge_slack`, and 1 where it looks at halves, else 0."""
    own, total = spread(0.0), spread(0.0)
    for row in range(18):
        n = load(s, OWN + row)
        own, total = own + n * load(s, EDGE + row), total + n * n
    scale = own / total
    for row in range(18):
        store(s, DIFFERENCE + row, scale * load(s, OWN + row) - load(s, EDGE + row))
    least, rounding = _least_square(s), 16.0 * U * _greatest(s, EDGE)
    slack = choose(least > 0.0, 2.0 * (_greatest(s, DIFFERENCE) + rounding) / root(least), 2.0)
    same_way = (total > 0.0) & (own > 0.0)
    slack_or_none = lesser(greater(spread(0.0), slack) + 4.0 * U, 2.0)
    return choose(same_way, slack_or_none, 2.0), choose(same_way & (slack > FINE_SLACK), 1.0, 0.0)


@helper
def _corner_slacks(s, h):
    """As `corner_slack`, of own control vector h."""
    x, y, z = _vector(s, OWN, h)
    cx, cy, cz = load(s, CORNER), load(s, CORNER + 1), load(s, CORNER + 2)
    size = root(x * x + y * y + z * z)
    dx, dy, dz = x / size - cx, y / size - cy, z / size - cz
    return choose(size > 0.0, root(dx * dx + dy * dy + dz * dz) + 4.0 * U, 2.0)


@helper
def side_slack(k, s):
    """Slacks on side k and in the corner that it starts from, and 1 where one patch after the other has to be looked at.

    Rows TU and TV, EDGE and CORNER are given; no slack is negative.
    """
    _find_own(k, s)
    slack, unsure = _edge_slacks(s)
    return greater(slack, _corner_slacks(s, 0 if k < 2 else 5)), unsure
