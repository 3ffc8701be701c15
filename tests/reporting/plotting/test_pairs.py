"""Pairs of parameters of draws and replicates."""

import numpy as np
import pytest

import greybox as gb


def test_each_pair_has_its_points_and_correlation_and_the_diagonal_histograms():
    rng = np.random.default_rng(0)
    a = rng.normal(size=500)
    columns = {"a": a, "fixed": np.ones(500), "b": -2 * a + rng.normal(size=500)}
    axes = gb.plotting.pairs(columns)

    # Constants are left out: two parameters make four panels, row by row.
    assert [ax.get_xlabel() for ax in axes] == ["a", "b", "a", "b"]
    assert [ax.get_ylabel() for ax in axes] == ["Number", "a", "b", "Number"]
    assert f"{np.corrcoef(a, columns['b'])[0, 1]:.2f}" in axes[1].get_title()
    (points,) = axes[2].get_lines()
    assert np.array_equal(points.get_xydata(), np.column_stack([a, columns["b"]]))
    # The histogram counts all draws.
    steps = axes[0].collections[0].get_paths()[0].vertices[:, 1]
    assert steps.max() == np.histogram(a, "auto")[0].max()


def test_a_table_of_pandas_has_columns_too():
    pd = pytest.importorskip("pandas")
    columns = {"a": np.arange(9.0), "b": np.arange(9.0) ** 2}
    assert len(gb.plotting.pairs(pd.DataFrame(columns))) == 4


def test_constants_alone_cannot_be_drawn():
    with pytest.raises(ValueError, match="give at least one"):
        gb.plotting.pairs({"fixed": np.ones(3)})
