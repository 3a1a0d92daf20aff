"""Slow twin of pipeline/tessellator.py: plain Python integers and lists, all sides and rows spelled out, own tables.

It computes each point by its number, and each stitch from explicit rows; nothing is counted beforehand.
"""

import math
from typing import NamedTuple

ONE = 1 << 16
HALF = 1 << 15
LIM = 1 + 2.0**-17
RANGE = {"integer": (1, 64), "pow2": (1, 64), "fractional_odd": (1, 63), "fractional_even": (2, 64)}
NEVER = 10**9

# Slot -> birth, written out; the kernels compute it.
ORDER = [0, 32, 16, 8, 17, 4, 18, 9, 19, 2, 20, 10, 21, 5, 22, 11, 23]
ORDER += [1, 24, 12, 25, 6, 26, 13, 27, 3, 28, 14, 29, 7, 30, 15, 31]


class Side(NamedTuple):
    odd: bool
    points: int  # on the whole side
    half_points: int
    frac: int
    step_low: int
    step_high: int
    split: int


def reciprocal(segments):
    return math.floor(ONE / segments + 0.5)


def make_side(factor, odd):
    h = (factor + 1) // 2
    if odd or h == HALF:
        h += HALF
    p = int(odd)
    low, high, frac = h >> 16, (h + 65535) >> 16, h & 0xFFFF
    if frac == 0:
        split = NEVER
    elif low - p == 0:
        split = 0
    else:
        split = 2 * (low - p - 2 ** int(math.log2(low - p))) + 1
    points = 2 * high if odd else 2 * high + 1
    return Side(odd, points, high, frac, reciprocal(2 * low - p), reciprocal(2 * high - p), split)


def place(side, i):
    mirrored = i >= side.half_points
    if mirrored:
        i = 2 * side.half_points - i - int(side.odd)
    if i == side.half_points:
        return HALF
    parent = i - 1 if i > side.split else i
    x = (parent * side.step_low * (ONE - side.frac) + i * side.step_high * side.frac + HALF) >> 16
    return ONE - x if mirrored else x


def fix_factors(domain, partitioning, edge, inside):
    """16.16 factors, edges first, or None for a culled patch. All floats must be exact float32 values."""
    if not all(x > 0 for x in edge):
        return None
    lo, hi = RANGE[partitioning]
    whole = partitioning in ("integer", "pow2")

    def clamp(x, lo, hi):
        return lo if math.isnan(x) else min(hi, max(lo, x))

    fixed = []
    lo_inside = lo
    for e, x in enumerate(edge):
        density = domain == "isoline" and e == 0
        x = clamp(x, 1, 64) if density else clamp(x, lo, hi)
        if partitioning == "fractional_odd" and x > LIM:
            lo_inside = 1 + 2.0**-16
        fixed.append(math.ceil(x) if whole or density else x)
    if partitioning == "fractional_odd" and domain == "quad" and any(x > LIM for x in inside):
        lo_inside = 1 + 2.0**-16
    for x in inside:
        x = clamp(x, lo_inside, hi)
        fixed.append(math.ceil(x) if whole else x)
    return [round(x * ONE) for x in fixed]  # Python rounds ties to even


def make_sides(domain, partitioning, num_edges, fixed):
    sides = []
    for s, factor in enumerate(fixed):
        if partitioning in ("integer", "pow2") or (domain == "isoline" and s == 0):
            odd = (factor // ONE) % 2 == 1
            if s >= num_edges and factor == ONE:
                odd = False
        else:
            odd = partitioning == "fractional_odd"
        sides.append(make_side(factor, odd))
    return sides


def quad_points(sides):
    e0, e1, e2, e3, in_u, in_v = sides
    points = [(0, place(e0, i)) for i in range(e0.points - 1, 0, -1)]
    points += [(place(e1, i), 0) for i in range(e1.points - 1)]
    points += [(ONE, place(e2, i)) for i in range(e2.points - 1)]
    points += [(place(e3, i), ONE) for i in range(e3.points - 1, 0, -1)]
    rings = min(in_u.points, in_v.points) // 2
    for r in range(1, rings):
        end_u, end_v = in_u.points - 1 - r, in_v.points - 1 - r
        points += [(place(in_u, r), place(in_v, i)) for i in range(end_v, r, -1)]
        points += [(place(in_u, i), place(in_v, r)) for i in range(r, end_u)]
        points += [(place(in_u, end_u), place(in_v, i)) for i in range(r, end_v)]
        points += [(place(in_u, i), place(in_v, end_v)) for i in range(end_u, r, -1)]
    if in_u.points > in_v.points:
        if not in_v.odd:
            points += [(place(in_u, i), HALF) for i in range(rings, in_u.points - rings)]
    elif not in_u.odd:
        points += [(HALF, place(in_v, i)) for i in range(in_v.points - 1 - rings, rings - 1, -1)]
    return points


def tri_points(sides):
    e0, e1, e2, inner = sides
    points = [(0, place(e0, i)) for i in range(e0.points - 1, 0, -1)]
    points += [(place(e1, i), 0) for i in range(e1.points - 1)]
    points += [(place(e2, i), ONE - place(e2, i)) for i in range(e2.points - 1, 0, -1)]
    for r in range(1, inner.points // 2):
        q = (place(inner, r) * 0xAAAA + HALF) >> 16
        end = inner.points - 1 - r
        t = [place(inner, i) - ((q + 1) >> 1) for i in range(inner.points)]
        points += [(q, t[i]) for i in range(end, r, -1)]
        points += [(t[i], q) for i in range(r, end)]
        points += [(t[i], ONE - t[i] - q) for i in range(end, r, -1)]
    if not inner.odd:
        points.append((0x5555, 0x5555))
    return points


def transition(out, inn, outer, inner):
    h_out = outer.half_points - int(outer.odd)
    h_in = inner.half_points - int(inner.odd)
    triangles = []
    a = b = 0

    def step_out():
        nonlocal b
        triangles.append((out[b], out[b + 1], inn[a]))
        b += 1

    def step_in():
        nonlocal a
        triangles.append((inn[a], out[b], inn[a + 1]))
        a += 1

    if h_out > 0:
        step_out()
    for i in range(1, 33):
        if ORDER[i] < h_in:
            step_in()
        if ORDER[i] < h_out:
            step_out()
    if inner.odd and outer.odd:
        triangles.append((inn[a], out[b], inn[a + 1]))
        triangles.append((inn[a + 1], out[b], out[b + 1]))
        a, b = a + 1, b + 1
    elif outer.odd:
        triangles.append((inn[a], out[b], out[b + 1]))
        b += 1
    elif inner.odd:
        triangles.append((inn[a], out[b], inn[a + 1]))
        a += 1
    for i in range(32, 0, -1):
        if ORDER[i] < h_out:
            step_out()
        if ORDER[i] < h_in:
            step_in()
    if h_out > 0:
        step_out()
    assert (a, b) == (len(inn) - 1, len(out) - 1)  # both rows are used up
    return triangles


def regular(out, inn):
    assert len(out) == len(inn) + 2
    triangles = [(out[0], out[1], inn[0])]
    b = 1
    for k in range(len(inn) - 1):
        if k < len(inn) // 2:
            triangles += [(out[b], inn[k + 1], inn[k]), (out[b], out[b + 1], inn[k + 1])]
        else:
            triangles += [(inn[k], out[b], out[b + 1]), (inn[k], out[b + 1], inn[k + 1])]
        b += 1
    return [*triangles, (out[b], out[b + 1], inn[-1])]


def loop_rows(first, lengths):
    """Rows of the closed ring that starts at point `first`; lengths: points on each side, both corners included."""
    total = sum(length - 1 for length in lengths)
    rows, start = [], 0
    for length in lengths:
        rows.append([first + (start + x) % total for x in range(length)])
        start += length - 1
    return rows, first + total


def ring_rows(domain, sides):
    """Rows of every ring, outermost first; the number of the first point after the last full ring, and of that ring."""
    if domain == "quad":
        u, v = sides[4].points, sides[5].points
        edges, along = sides[:4], [v, u, v, u]
    else:
        edges, along = sides[:3], [sides[3].points] * 3
    rows, after = loop_rows(0, [s.points for s in edges])
    rings, first = [rows], 0
    for r in range(1, min(along) // 2):
        first = after
        rows, after = loop_rows(first, [n - 2 * r for n in along])
        rings.append(rows)
    if min(along) % 2:  # folded flat
        if domain == "tri":
            rings.append([[after]] * 3)
        else:
            line = list(range(after, after + abs(u - v) + 1))
            if u > v:
                rings.append([line[:1], line, line[-1:], line[::-1]])
            else:
                rings.append([line, line[-1:], line[::-1], line[:1]])
    return rings, first


def centre(domain, sides, f):
    if domain == "tri":
        return [(f, f + 1, f + 2)] if sides[3].odd else []
    u, v = sides[4], sides[5]
    if (v if u.points > v.points else u).points % 2:
        return []
    m = abs(u.points - v.points) + 2
    if u.points > v.points:
        out = [f + 1 + x for x in range(m)]
        inn = [f] + [f + 2 * m - x for x in range(1, m)]
        style_b = False
    else:
        out = [f + x for x in range(m)]
        inn = [f + 2 * m - 1 - x for x in range(m)]
        style_b = v.odd
    triangles = []
    for a in range(m - 1):
        if not style_b:
            triangles += [(inn[a], out[a], out[a + 1]), (inn[a], out[a + 1], inn[a + 1])]
        elif a == m // 2 - 1:
            triangles += [(out[a], inn[a + 1], inn[a]), (out[a], out[a + 1], inn[a + 1])]
        else:
            triangles += [(out[a], out[a + 1], inn[a]), (inn[a], out[a + 1], inn[a + 1])]
    return triangles


def clockwise_triangles(domain, sides):
    rings, last_full = ring_rows(domain, sides)
    triangles = []
    for r in range(1, len(rings)):
        for e in range(len(rings[0])):
            inner = sides[3] if domain == "tri" else sides[5 - e % 2]
            if r == 1:
                triangles += transition(rings[0][e], rings[1][e], sides[e], inner)
            else:
                triangles += regular(rings[r - 1][e], rings[r][e])
    return triangles + centre(domain, sides, last_full)


def naive_tessellate(domain, partitioning, edge, inside):
    """Points in 16.16 and a dict output -> index list, for all four outputs, also the forbidden ones."""
    fixed = fix_factors(domain, partitioning, edge, inside)
    outputs = ("point", "line", "triangle_cw", "triangle_ccw")
    if fixed is None:
        return [], {output: [] for output in outputs}
    sides = make_sides(domain, partitioning, len(edge), fixed)
    if domain == "isoline":
        density, detail = sides
        lines = density.points - 1
        points = [(place(detail, i), place(density, k)) for k in range(lines) for i in range(detail.points)]
        pairs = [(k, k + 1) for k in range(len(points) - 1) if (k + 1) % detail.points]
        clockwise = None
    else:
        if all(factor == ONE for factor in fixed) and partitioning != "fractional_even":
            if domain == "quad":
                points, clockwise = [(0, 0), (ONE, 0), (ONE, ONE), (0, ONE)], [(0, 1, 3), (1, 2, 3)]
            else:
                points, clockwise = [(0, ONE), (0, 0), (ONE, 0)], [(0, 1, 2)]
        else:
            points = quad_points(sides) if domain == "quad" else tri_points(sides)
            clockwise = clockwise_triangles(domain, sides)
        pairs = [(k, k + 1) for k in range(len(points) - 1)]
    line = [k for pair in pairs for k in pair]
    return points, {
        "point": list(range(len(points))),
        "line": line,
        "triangle_cw": line if clockwise is None else [k for t in clockwise for k in t],
        "triangle_ccw": line if clockwise is None else [k for x, y, z in clockwise for k in (x, z, y)],
    }
