"""Writes `tangent_plane_table.py`: `python -m pipeline.culling.make_tangent_plane_table`. A test makes it again.

The tangent plane of a patch S of bi-degree (m, n) is T = cross4(S, S_u, S_v), of bi-degree (3m - 2, 3n - 2) (Loop,
Niessner, Eisenacher 2011, section 4). Its control planes are sums of weighted cross4 products of control points. With
P(s) = S_i B_i B_j of three points s = 1, 2, 3 one gets, for each unordered triple of grid indices (i, j),

    det of rows (1, i_s, j_s)  *  product of the C(m, i_s) C(n, j_s)  /  (C(3m-2, row) C(3n-2, column)),
    row = i_1 + i_2 + i_3 - 1,  column = j_1 + j_2 + j_3 - 1,

so a triple goes to exactly one control plane, and collinear triples vanish: 560 - 44 = 516 for a bicubic patch.
"""

from itertools import combinations
from math import comb
from pathlib import Path

Term = tuple[int, int, int, int, int, int]  # three points (numbers (n + 1) i + j, ascending), row, column, numerator


def make_terms(m: int, n: int) -> list[Term]:
    """All products of bi-degree (m, n), in ascending order of their points.

    The weight is numerator / (C(3m-2, row) C(3n-2, column)); `divisor` gives the latter.
    """
    terms = []
    for triple in combinations(range((m + 1) * (n + 1)), 3):
        i, j = zip(*(divmod(k, n + 1) for k in triple), strict=True)
        turn = (i[1] - i[0]) * (j[2] - j[0]) - (i[2] - i[0]) * (j[1] - j[0])
        if turn == 0:
            continue
        numerator = turn
        for k in range(3):
            numerator *= comb(m, i[k]) * comb(n, j[k])
        terms.append((*triple, sum(i) - 1, sum(j) - 1, numerator))
    return terms


def divisor(m: int, n: int, row: int, column: int) -> int:
    """What a numerator of control plane (row, column) is divided by."""
    return comb(3 * m - 2, row) * comb(3 * n - 2, column)


HEAD = '''"""The 516 products of the tangent plane of a bicubic patch. Made by `make_tangent_plane_table.py`; do not edit.

Rows of TERMS: three control points, numbers 4 i + j, ascending; row and column of the control plane, 0 to 7 each; the
weight times C(7, row) C(7, column), an integer.
"""

from math import comb

import numpy as np

'''

TAIL = """
_terms = np.array(TERMS, np.int64)
POINTS = np.ascontiguousarray(_terms[:, :3])  # int64 (516, 3)
TARGET = np.ascontiguousarray(8 * _terms[:, 3] + _terms[:, 4])  # int64 (516,): control plane 8 row + column
WEIGHT = _terms[:, 5] / np.array([comb(7, row) * comb(7, column) for row, column in _terms[:, 3:5]], np.float64)
"""


def text() -> str:
    """The whole file."""
    terms = make_terms(3, 3)
    rows = []
    for k in range(0, len(terms), 4):
        rows.append("    " + " ".join(f"({', '.join(map(str, term))})," for term in terms[k : k + 4]))
    return HEAD + "# fmt: off\nTERMS = (\n" + "\n".join(rows) + "\n)\n# fmt: on\n" + TAIL


def main() -> None:
    """Write it beside this script."""
    (Path(__file__).parent / "tangent_plane_table.py").write_text(text())


if __name__ == "__main__":
    main()
