"""Parameter vectors of one response, and the constraint that chooses one of them."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.estimate.equivalent_minima import equivalents_warning

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)


def same_response(fit):
    return [warning for warning in fit.warnings if "same response" in warning]


def test_lags_that_swap_are_shown_and_a_constraint_chooses_one(tmp_path):
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), progress=False)
    first, second = fit.equivalents
    i, j = fit.free.index("T1"), fit.free.index("T2")
    assert_allclose(second[[i, j]], first[[j, i]], rtol=1e-3)
    assert len(same_response(fit)) == 1
    high, low = ("T1", "T2") if fit.estimate["T1"] > fit.estimate["T2"] else ("T2", "T1")
    ordered = gb.fit(
        gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p[high] - p[low]]),
        starts=4,
        progress=False,
    )
    assert len(ordered.equivalents) == 1
    assert not same_response(ordered)
    assert ordered.estimate[high] == pytest.approx(fit.estimate[high], rel=1e-3)
    gb.save(fit, tmp_path / "fit.h5")
    assert_allclose(gb.load(tmp_path / "fit.h5").equivalents, fit.equivalents)


def test_the_table_shows_what_differs_in_the_first_four_vectors():
    vectors = np.array([[1.0, 2.0, 5.0], [2.0, 1.0, 5.0], [1.0, 2.5, 5.0], [3.0, 2.0, 5.1]])
    text = equivalents_warning(("a", "b", "c"), np.vstack([vectors, vectors[1] + 7]))
    assert text.startswith("at least 5 clearly different parameter vectors")
    table = text.splitlines()[1:]
    assert table[0].split() == ["reported", "also", "1", "also", "2", "also", "3"]
    assert [line.split()[0] for line in table[1:] if "-" not in line] == ["a", "b", "c"]
