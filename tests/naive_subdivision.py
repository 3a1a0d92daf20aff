"""Slow twin of the control-point phase: ACC and Gregory patches of a quad mesh, section by section of the spec, in float64.

Loops over dictionaries; no creases or corner tags but what the boundary makes.
"""

from math import cos, pi, sin, sqrt

import numpy as np


class NaiveSurface:
    """points float64[V, 3], faces: lists of four; boundary vertices of one face stay in place if keep_corners."""

    def __init__(self, points, faces, keep_corners):
        self.points, self.faces, self.keep = points, faces, keep_corners
        self.face_at = {(f[k], f[k - 3]): i for i, f in enumerate(faces) for k in range(4)}
        self.rings = {v: self.ring(v) for v in {v for f in faces for v in f}}

    def ring(self, v):
        """Section 1: e_0.. and d_0.. counter-clockwise, and whether the vertex is inside."""
        around = [i for i, f in enumerate(self.faces) if v in f]
        first = next((i for i in around if (self.neighbours(i, v)[0], v) not in self.face_at), around[0])
        e, d, i = [], [], first
        while True:
            after, over, before = self.neighbours(i, v)
            e.append(after)
            d.append(over)
            i = self.face_at.get((v, before))
            if i is None:
                return [*e, before], d, False
            if i == first:
                return e, d, True

    def neighbours(self, i, v):
        f = self.faces[i]
        k = f.index(v)
        return f[k - 3], f[k - 2], f[k - 1]

    def limit(self, v):
        """Section 3."""
        (e, d, inside), p = self.rings[v], self.points
        n = len(d)
        if inside:
            return (n * n * p[v] + 4 * sum(p[x] for x in e) + sum(p[x] for x in d)) / (n * (n + 5))
        if n == 1 and self.keep:
            return p[v]
        return (p[e[0]] + 4 * p[v] + p[e[-1]]) / 6

    def tangent(self, a, b):
        """Section 3: the limit tangent at a along its edge to b."""
        (e, d, inside), p = self.rings[a], self.points
        n, i = len(d), e.index(b)
        if inside:
            s = 1 / sqrt(4 + cos(pi / n) ** 2)
            total = 0
            for j in range(n):
                total = total + (1 + s * cos(pi / n)) / n * cos(2 * pi * j / n) * p[e[(i + j) % n]]
                total = total + s / n * cos((2 * j + 1) * pi / n) * p[d[(i + j) % n]]
            return total
        if n == 1:
            return p[b] - p[a]
        th = pi / n
        r0 = (p[e[0]] - p[e[-1]]) / 2
        r1 = -4 * sin(th) * p[a]
        r1 = r1 - (1 + 2 * cos(th)) * sqrt((1 + cos(th)) / (1 - cos(th))) * (p[e[0]] + p[e[-1]])
        r1 = r1 + 4 * sum(sin(j * th) * p[e[j]] for j in range(1, n))
        r1 = r1 + sum((sin(j * th) + sin((j + 1) * th)) * p[d[j]] for j in range(n))
        return cos(i * th) * r0 + sin(i * th) * r1 / (3 * n + cos(th))

    def c(self, v):
        _, d, inside = self.rings[v]
        return cos(2 * pi / len(d)) if inside else 0.0 if len(d) == 1 else cos(pi / len(d))

    def inner(self, i, v):
        """Section 4: the interior point next to corner v of face i."""
        (_, d, inside), p = self.rings[v], self.points
        n, (after, over, before) = len(d) if inside else 4, self.neighbours(i, v)
        return (n * p[v] + 2 * p[after] + p[over] + 2 * p[before]) / (n + 5)

    def edge_point(self, a, b):
        """Section 4: the point next to a on its edge to b."""
        sides = [self.face_at.get(pair) for pair in ((a, b), (b, a))]
        if None in sides:
            return (2 * self.points[a] + self.points[b]) / 3
        return (self.inner(sides[0], a) + self.inner(sides[1], a)) / 2

    def geometry(self, i):
        """b[4][4] of face i."""
        v0, v1, v2, v3 = self.faces[i]
        b = np.empty((4, 4, 3))
        for v, x, y, along_u, along_v in (
            (v0, 0, 0, v1, v3),
            (v1, 3, 0, v0, v2),
            (v2, 3, 3, v3, v1),
            (v3, 0, 3, v2, v0),
        ):
            near_x, near_y = abs(x - 1), abs(y - 1)
            b[x, y], b[near_x, near_y] = self.limit(v), self.inner(i, v)
            b[near_x, y], b[x, near_y] = self.edge_point(v, along_u), self.edge_point(v, along_v)
        return b

    def acc(self, i):
        """Sections 4 and 5: b (4, 4, 3), tu (3, 4, 3), tv (4, 3, 3)."""
        b, (v0, v1, v2, v3) = self.geometry(i), self.faces[i]
        tu, tv = 3 * np.diff(b, axis=0), 3 * np.diff(b, axis=1)
        t = self.tangent
        tu[0, 0], tu[2, 0], tu[0, 3], tu[2, 3] = t(v0, v1), -t(v1, v0), t(v3, v2), -t(v2, v3)
        tv[0, 0], tv[0, 2], tv[3, 0], tv[3, 2] = t(v0, v3), -t(v3, v0), t(v1, v2), -t(v2, v1)

        def turns(a, b):
            return (self.c(a), self.c(b)) if (a, b) in self.face_at and (b, a) in self.face_at else (0, 0)

        c0, c3 = turns(v0, v3)
        tu[0, 1] = (2 * c0 * tv[0, 1] - c3 * tv[0, 0]) / 3 + 3 * (b[1, 1] - b[0, 1])
        tu[0, 2] = (c0 * tv[0, 2] - 2 * c3 * tv[0, 1]) / 3 + 3 * (b[1, 2] - b[0, 2])
        c1, c2 = turns(v1, v2)
        tu[2, 1] = -(2 * c1 * tv[3, 1] - c2 * tv[3, 0]) / 3 + 3 * (b[3, 1] - b[2, 1])
        tu[2, 2] = -(c1 * tv[3, 2] - 2 * c2 * tv[3, 1]) / 3 + 3 * (b[3, 2] - b[2, 2])
        c0, c1 = turns(v0, v1)
        tv[1, 0] = (2 * c0 * tu[1, 0] - c1 * tu[0, 0]) / 3 + 3 * (b[1, 1] - b[1, 0])
        tv[2, 0] = (c0 * tu[2, 0] - 2 * c1 * tu[1, 0]) / 3 + 3 * (b[2, 1] - b[2, 0])
        c3, c2 = turns(v3, v2)
        tv[1, 2] = -(2 * c3 * tu[1, 3] - c2 * tu[0, 3]) / 3 + 3 * (b[1, 3] - b[1, 2])
        tv[2, 2] = -(c3 * tu[2, 3] - 2 * c2 * tu[1, 3]) / 3 + 3 * (b[2, 3] - b[2, 2])
        return b, tu, tv

    def gregory_edge(self, a, b):
        """Section 7: the point e next to a on its edge to b."""
        _, d, inside = self.rings[a]
        if (a, b) not in self.face_at or (b, a) not in self.face_at:
            return (2 * self.points[a] + self.points[b]) / 3
        reach, n = 1 / 3, len(d)
        if inside:
            reach = 2 / 3 * (5 + cos(2 * pi / n) + cos(pi / n) * sqrt(18 + 2 * cos(2 * pi / n))) / 16
        return self.limit(a) + reach * self.tangent(a, b)

    def gregory(self, i):
        """Section 7: b (4, 4, 3), its inner points the means of f+ and f-, and f (4, 2, 3)."""
        face, p, b, f = self.faces[i], self.points, np.empty((4, 4, 3)), np.empty((4, 2, 3))
        corners = [(0, 0), (3, 0), (3, 3), (0, 3)]
        for k, (x, y) in enumerate(corners):
            v, ends = face[k], (face[k - 3], face[k - 1])
            places = [(abs(x - 1), y), (x, abs(y - 1))]
            for end, place in zip(ends if k % 2 == 0 else ends[::-1], places, strict=True):
                b[place] = self.gregory_edge(v, end)
            b[x, y] = self.limit(v)
            for s, end in enumerate(ends):
                across = self.face_at.get((end, v) if s == 0 else (v, end))
                if across is None:
                    f[k, s] = self.inner(i, v)
                    continue
                beside, there = ends[1 - s], self.neighbours(across, v)
                other = there[0] if there[0] != end else there[2]
                m, m2 = (p[v] + p[beside]) / 2, (p[v] + p[other]) / 2
                middle, middle2 = (sum(p[w] for w in self.faces[j]) / 4 for j in (i, across))
                r = (m - m2) / 3 + 2 * (middle - middle2) / 3
                near, far = self.c(v), self.c(end)
                f[k, s] = far * self.limit(v) + (3 - 2 * near - far) * self.gregory_edge(v, end)
                f[k, s] = (f[k, s] + 2 * near * self.gregory_edge(end, v) + r) / 3
            b[abs(x - 1), abs(y - 1)] = f[k].mean(axis=0)
        return b, f
