"""Rows of which some entries are kept: both ways that they are compiled, against NumPy."""

import numpy as np
import pytest

from pipeline import compact as compact_module
from pipeline.compact import _compact_listed, _compact_packed, compact, lanes_of, packs_vectors
from pipeline.jit import kernel

ROW = 96
ALIVE, FIRST_ROW, SECOND_ROW = 0, ROW, 2 * ROW


@kernel
def chosen(values, first, last, to):
    return compact(values, ALIVE, first, last, to, (FIRST_ROW, SECOND_ROW))


_listed = kernel(_compact_listed)


def listed(values, first, last, to):
    return _listed(values, ALIVE, first, last, to, (FIRST_ROW, SECOND_ROW))


def plain(values, first, last, to):
    return compact(values, ALIVE, first, last, to, (FIRST_ROW, SECOND_ROW))


@pytest.mark.parametrize("how", [chosen, listed, plain])
@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_what_is_kept_keeps_its_order(how, dtype):
    rng = np.random.default_rng(0)
    most = ROW - lanes_of(32)
    for part in (0.0, 0.1, 0.5, 0.9, 1.0):
        for _ in range(20):
            first, last = np.sort(rng.integers(0, most + 1, 2))
            to = int(rng.integers(0, first + 1))
            rows = rng.integers(-(1 << 31), 1 << 31, (3, ROW)).astype(dtype)
            rows[0] = np.where(rng.random(ROW) < part, rng.integers(1, 9, ROW) * rng.choice([-1, 1], ROW), 0)
            kept = first + np.flatnonzero(rows[0, first:last])
            values = rows.ravel().copy()
            found = how(values, int(first), int(last), to)
            after = values.reshape(3, ROW)
            assert found == len(kept)
            for row in (1, 2):
                np.testing.assert_array_equal(after[row, to : to + found], rows[row, kept])
                np.testing.assert_array_equal(after[row, :to], rows[row, :to], "what stands before is left alone")
                end = last + lanes_of(8 * values.itemsize)
                np.testing.assert_array_equal(after[row, end:], rows[row, end:], "so is what lies a vector behind")


def test_the_processor_decides(monkeypatch):
    """Numba compiles for the features that it is told; the same ones are part of the cache's key."""
    found = compact_module._compact(*[None] * 6)
    assert found is (_compact_packed if packs_vectors() else _compact_listed)
    for features, packs in (
        ("+avx2,+avx512f,+avx512vl", True),
        ("+avx2,-avx512f", False),
        ("+avx512fp16", False),
        ("", False),
    ):
        codegen = type("Codegen", (), {"magic_tuple": lambda self, features=features: ("triple", "cpu", features)})()
        monkeypatch.setattr(compact_module.cpu_target.target_context, "codegen", lambda codegen=codegen: codegen)
        assert packs_vectors() == packs
        assert compact_module._compact(*[None] * 6) is (_compact_packed if packs else _compact_listed)
