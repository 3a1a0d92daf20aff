"""The tables of docs/backface.md, on a small model: sound tests lose nothing, and bad models are named."""

import numpy as np
import pytest

from tests.test_domain import smooth_patch
from tiler import cull_tables
from tiler.errors import TilerError
from tiler.host import Host


@pytest.fixture
def model(tmp_path):
    """Bumpy sheets side by side, all facing one way."""
    rng = np.random.default_rng(0)
    cp = np.stack([smooth_patch(rng, 0.05) for _ in range(12)])
    points = cp[..., :3] / cp[..., 3:] + 3 * np.arange(12)[:, None, None, None] * np.array([1, 0, 0])
    np.savez(tmp_path / "sheets.npz", P=points.astype(np.float32))
    return tmp_path / "sheets.npz"


def cells(text):
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in text.splitlines()[2:]]


def test_rates_and_false_culls_of_a_model(model):
    patches = cull_tables.read_model(model)
    with Host(1) as host:
        rates = {name: float(rate) for name, rate in cells(cull_tables.rates_table(patches, host))}
        rows = cells(cull_tables.false_table(patches, host))
    assert 30 < rates["`tangent_plane`"] < 50 and rates["`tcone`"] <= rates["`tangent_plane`"]
    assert [row[0] for row in rows] == ["1", "2", "4", "8", "16"]
    for row in rows:
        wrong, total = (int(n) for n in row[-1].split(" of "))
        assert wrong == 0 < total


def test_displaced_patches_that_are_dropped_are_back_facing(load):
    with Host(1) as host:
        row = cull_tables.displaced_row(load("waves"), 2, 0.05, host)
    assert row[0].startswith("waves") and int(row[2]) > 1000
    assert all(cell.endswith(" (0)") and int(cell.split()[0]) > 1000 for cell in row[4:])


def test_bad_models_and_names(model, tmp_path):
    np.savez(tmp_path / "flat.npz", P=np.zeros((3, 4, 4)))
    np.savez(tmp_path / "other.npz", Q=np.zeros(3))
    for path in (tmp_path / "flat.npz", tmp_path / "other.npz", tmp_path / "none.npz"):
        with pytest.raises(TilerError, match=r"model: .* is not allowed"):
            cull_tables.read_model(path)
    with pytest.raises(TilerError, match="table: 'rate' is not allowed; allowed: rates"):
        cull_tables.main([str(model), "rate"])
    with pytest.raises(TilerError, match="model: missing"):
        cull_tables.main([])
