"""Parameter vectors of one response, and the constraint that chooses one of them."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured

import greybox as gb
from greybox.estimate.equivalent_minima import equivalents_warning

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)


def same_response(fit):
    return [warning for warning in fit.warnings if "same response" in warning]


def test_lags_that_swap_are_shown_and_a_constraint_chooses_one():
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), progress=False)
    (text,) = same_response(fit)
    rows = {line.split()[0]: line.split()[1:] for line in text.splitlines()[3:]}
    values = [[float(value) for value in rows[name]] for name in ("T1", "T2")]
    assert values[0] == pytest.approx(values[1][::-1], rel=1e-3)
    high, low = ("T1", "T2") if fit.estimate["T1"] > fit.estimate["T2"] else ("T2", "T1")
    ordered = gb.fit(
        gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p[high] - p[low]]),
        starts=4,
        progress=False,
    )
    assert not same_response(ordered)
    assert ordered.estimate[high] == pytest.approx(fit.estimate[high], rel=1e-3)


def test_the_table_shows_what_differs_in_the_first_four_vectors():
    vectors = np.array([[1.0, 2.0, 5.0], [2.0, 1.0, 5.0], [1.0, 2.5, 5.0], [3.0, 2.0, 5.1]])
    text = equivalents_warning(("a", "b", "c"), np.vstack([vectors, vectors[1] + 7]))
    assert text.startswith("at least 5 clearly different parameter vectors")
    table = text.splitlines()[1:]
    assert table[0].split() == ["reported", "also", "1", "also", "2", "also", "3"]
    assert [line.split()[0] for line in table[1:] if "-" not in line] == ["a", "b", "c"]
