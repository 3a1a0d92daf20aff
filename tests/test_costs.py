"""Costs of the bounds: exact counts of operations, in the paper's order, and a table that says so."""

import ast
import sys

import numpy as np
import pytest

import pipeline.bounds
from pipeline.bounds import BOUNDS
from pipeline.jit import helper
from tiler import costs

ORDER = ["cbox", "obbtex", "tpatch", "npatch", "taylor"]


@pytest.fixture(scope="module")
def counts():
    return costs.count_operations(1)


def test_counts_are_the_same_every_time(counts):
    assert costs.count_operations(1) == counts
    assert set(counts) == {*BOUNDS, "domain shader", "domain shader, map"}


def test_counts_rise_in_the_papers_order(counts):
    known = [name for name in ORDER if name in counts]
    boxes = [counts[name].box for name in known]
    assert boxes == sorted(boxes) and len(set(boxes)) == len(boxes), dict(zip(known, boxes, strict=True))


def test_parts_add_up(counts):
    for name, count in counts.items():
        assert count.total == pytest.approx(sum(count.kinds.values())), name
        assert count.arithmetic == pytest.approx(count.total - count.kinds["compare"]), name
    assert all(counts[name].project > 0 for name in BOUNDS)
    assert counts["domain shader"].lookup == 0 < counts["domain shader, map"].lookup
    assert counts["cbox"].lookup == 0


def test_shader_count_is_that_of_its_formulas(counts):
    """Per coordinate: 5 sums of 4 for the point, 4 of 3 and 1 of 4 for one tangent, 3 of 4 and 1 of 3 for the other."""
    sum4, sum3, basis = 7, 5, 2 * (2 + 3 + 3 + 2 + 1) + 2 * (1 + 2 + 1)
    point, along_u, along_v = 5 * sum4, 4 * sum3 + sum4, 3 * sum4 + sum3
    cross, unit, clip = 9, 5 + 1 + 3, 4 * 6
    least = 3 * (point + along_u + along_v) + basis + cross + unit + clip
    assert least < counts["domain shader"].total < 2 * least  # bases are made anew for each pass


def tally_of(source):
    """Operations of a piece of code."""
    tally = costs.Tally()
    tree = ast.fix_missing_locations(costs._Rewrite().visit(ast.parse(source)))
    names = {"_counting": costs._Counting("m", tally), "np": np}
    with np.errstate(all="ignore"):
        exec(compile(tree, "source", "exec"), names)
    return {kind: count for (_, kind), count in tally.items()}, names


def test_every_float_operation_is_counted_and_no_other():
    counts, names = tally_of(
        """
x = 3.0
i = 2
y = x * x + 1.0 - x / i
y += x
j = i * 2 + 1
A, B = 2.0, 3.0
c = A * B
big = x < y <= 9.0
same = i < j and i == 2
z = max(x, y, 1.0) - min(i, j)
a = np.zeros(5) + 1.0
a[1:] *= x
r = np.sqrt(z) + np.floor(x) + np.sqrt(a)[0]
inf = (x - 2.0) / (x - 3.0)
"""
    )
    assert counts == {
        "mul": 1 + 4,
        "add": 2 + 5 + 2,
        "div": 2,
        "sub": 1 + 1 + 2,
        "compare": 2 + 2,
        "sqrt": 6,
        "round": 1,
    }
    assert names["y"] == 11.5 and not names["big"] and names["inf"] == float("inf")


def test_counting_leaves_the_compiled_pipeline_in_place(counts):
    assert sys.modules["pipeline.bounds"] is pipeline.bounds and pipeline.bounds.BOUNDS is BOUNDS
    assert type(helper(lambda: 1)).__name__ == "Helper"
    assert not any(type(finder).__name__ == "_CountingFinder" for finder in sys.meta_path)


def test_table_has_a_line_for_each_bound(counts, monkeypatch):
    """With invented times."""
    times = dict.fromkeys([*BOUNDS, "lookup", "projection", "domain shader, map"], 1e-6) | {"domain shader": 1e-8}
    monkeypatch.setattr(costs, "measure_times", lambda: times)
    monkeypatch.setattr(costs, "count_operations", lambda: counts)
    lines = costs.cost_table().splitlines()
    for name in BOUNDS:
        (line,) = [line for line in lines if line.startswith(name + " ")]
        assert "nan" not in line and f"{counts[name].box / counts['domain shader'].total:.1f}" in line.split()


@pytest.mark.timing
def test_times_are_measured_for_each_bound():
    times = costs.measure_times(64, 1)
    assert set(BOUNDS) <= set(times) and all(t > 0 for t in times.values())
