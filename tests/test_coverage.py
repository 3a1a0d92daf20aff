"""Triangle coverage: the slow twin against llvmpipe, and the production rasterizer against both, exactly."""

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

from tests.coverage_cases import CELL, FAMILIES, Family, make_family
from tests.gl import llvmpipe
from tests.naive import naive_coverage, naive_snap
from tests.raster_adapter import production_coverage

TARGET = 1024  # pixels, the side of the target whose cells the production rasterizer fills


@dataclass
class Case:
    """One family with 1 or 4 samples a pixel, and what each rasterizer makes of it: bool[T, cell, cell, samples]."""

    name: str
    samples: int

    @cached_property
    def family(self) -> Family:
        return FAMILIES[self.name]

    @cached_property
    def triangles(self) -> np.ndarray:
        return make_family(self.name, self.family.count[self.samples])

    @cached_property
    def naive(self) -> np.ndarray:
        return naive_all(self.triangles, self.family.cell, self.samples)

    @cached_property
    def llvmpipe(self) -> np.ndarray:
        coverage = {1: llvmpipe.coverage_1x, 4: llvmpipe.coverage_4x}[self.samples]
        return coverage(self.triangles, self.family.cell, self.family.cell)

    @cached_property
    def production(self) -> np.ndarray:
        target = TARGET if self.family.cell == CELL else self.family.cell
        return production_coverage(self.triangles, target, target, self.samples, self.family.cell)


def naive_all(triangles: np.ndarray, cell: int, samples: int) -> np.ndarray:
    covered = np.empty((len(triangles), cell, cell, samples), dtype=bool)
    for t, triangle in enumerate(triangles):
        covered[t] = naive_coverage(triangle[:, 0], triangle[:, 1], cell, cell, samples)
    return covered


def case_id(param: tuple[str, int]) -> str:
    return f"{param[0]}-{param[1]}x"


CASES = [(name, samples) for name in FAMILIES for samples in (1, 4)]
TILINGS = [param for param in CASES if FAMILIES[param[0]].tiles_window]


# One case at a time: pytest runs all tests of a case in a row, so that its images are made once and then forgotten.
@pytest.fixture(scope="module", params=CASES, ids=case_id)
def case(request: pytest.FixtureRequest) -> Case:
    return Case(*request.param)


@pytest.fixture(scope="module")
def needs_llvmpipe() -> None:
    reason = llvmpipe.available()
    if reason is None:
        return
    if os.environ.get("CI"):
        pytest.fail(f"{reason} (a failure because CI is set)")
    pytest.skip(reason)


def assert_same(case: Case, ours: np.ndarray, theirs: np.ndarray) -> None:
    __tracebackhide__ = True
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype == bool
    wrong = np.flatnonzero((ours != theirs).any(axis=(1, 2, 3)))
    if wrong.size:
        t = wrong[0]
        row, column, sample = np.argwhere(ours[t] != theirs[t])[0]
        pytest.fail(
            f"{wrong.size} of {len(ours)} triangles of {case.name} differ with {case.samples} samples a pixel; the "
            f"first is {t}, {case.triangles[t].tolist()}: sample {sample} of pixel ({column}, {row}) is "
            f"{ours[t, row, column, sample]}, expected {theirs[t, row, column, sample]}"
        )


@pytest.mark.gl
def test_naive_matches_llvmpipe(needs_llvmpipe: None, case: Case) -> None:
    assert case.naive.any(), "an oracle that covers nothing tells nothing"
    assert_same(case, case.naive, case.llvmpipe)


def test_production_matches_naive(case: Case) -> None:
    assert_same(case, case.production, case.naive)


@pytest.mark.gl
def test_production_matches_llvmpipe(needs_llvmpipe: None, case: Case) -> None:
    assert_same(case, case.production, case.llvmpipe)


@pytest.mark.parametrize("rasterizer", ["naive", "production"])
@pytest.mark.parametrize("case", TILINGS, indirect=True, ids=case_id)
def test_adjacent_triangles_cover_each_sample_once(case: Case, rasterizer: str) -> None:
    covered = getattr(case, rasterizer)
    count = covered.reshape(-1, case.family.tiles_window, *covered.shape[1:]).sum(axis=1)
    assert (count == 1).all(), f"{np.count_nonzero(count == 0)} gaps, {np.count_nonzero(count > 1)} samples drawn twice"


def test_snap_rounds_to_nearest_even_and_saturates() -> None:
    halves = [0.5, 1.5, 2.5, -0.5, -1.5, 127.5]
    assert [naive_snap(h / 256) for h in halves] == [0, 2, 2, 0, -2, 128]
    assert naive_snap(1e9) == 32767 * 256 + 255 and naive_snap(-1e9) == -32768 * 256


def test_naive_keeps_top_and_left_edges_only() -> None:
    """A rectangle with its corners on pixel centres (0.5, 0.5) to (2.5, 3.5), cut along its diagonal."""
    x, y = np.array([0.5, 2.5, 2.5, 0.5]), np.array([0.5, 0.5, 3.5, 3.5])
    both = [naive_coverage(x[k], y[k], 4, 5, 1)[..., 0] for k in ([0, 1, 2], [0, 2, 3])]
    expected = np.zeros((5, 4), dtype=bool)
    expected[0:3, 0:2] = True
    assert not (both[0] & both[1]).any()
    np.testing.assert_array_equal(both[0] | both[1], expected)


def test_naive_uses_the_standard_pattern() -> None:
    """The upper half of a pixel holds samples 0 and 1, the left half 0 and 2."""
    upper = naive_coverage(np.array([-9.0, 9.0, 0.0]), np.array([0.5, 0.5, -9.0]), 1, 1, 4)
    left = naive_coverage(np.array([0.5, 0.5, -9.0]), np.array([-9.0, 9.0, 0.0]), 1, 1, 4)
    assert upper[0, 0].tolist() == [True, True, False, False]
    assert left[0, 0].tolist() == [True, False, True, False]


@pytest.mark.parametrize("rounded", [np.floor, lambda p: np.floor(p + 0.5)], ids=["floor", "half up"])
def test_cases_tell_nearest_even_from_other_roundings(rounded: np.ufunc) -> None:
    triangles = make_family("grid_512", 500)
    right, wrong = (naive_all(t, CELL, 1) for t in (triangles, rounded(triangles * 256) / 256))
    assert np.count_nonzero((right != wrong).any(axis=(1, 2, 3))) > 20


@pytest.mark.parametrize("name", [n for n in FAMILIES if FAMILIES[n].cell == CELL])
def test_families_stay_in_their_cell(name: str) -> None:
    triangles = make_family(name, 1000)
    assert triangles.min() >= 0 and triangles.max() <= CELL
