"""The rows of a comparison are those of the predictions and of the likelihood."""

import numpy as np
import pytest
from drag_flights import QUADRATIC, LinearDrag, QuadraticDrag, fitted, flight

import greybox as gb


@pytest.fixture(scope="module")
def quadratic():
    """Nonlinear truth: the quadratic and the linear model fitted to one flight, and another flight."""
    record = flight(QUADRATIC, 1)
    return fitted(QuadraticDrag(), record), fitted(LinearDrag(), record), flight(QUADRATIC, 2)


def test_the_measures_are_those_of_the_predictions(quadratic):
    right, wrong, other = quadratic
    found = gb.compare(right, wrong, records=other, window=2.0, lead=1.0)
    alone = gb.predict(wrong, record=other, horizon=2.0, lead=1.0)
    assert found.windows == {"identification": 14, "held-out": 14}
    assert found.value("error (rms)", "LinearDrag", "held-out", "v") == pytest.approx(alone.rms("v"), rel=1e-6)
    assert found.value("  1 s ahead", "LinearDrag", "held-out", "v") == pytest.approx(alone.rms("v", 0.5), rel=1e-6)
    assert found.value("fit", "LinearDrag", "held-out", "v") == pytest.approx(alone.fit_percent("v"), rel=1e-6)
    first, second = (p[0] for p in found.predictions["held-out"])
    assert np.array_equal(first.rows, second.rows)


def test_aic_and_bic_are_those_of_the_likelihood(quadratic):
    right, wrong, _ = quadratic
    found = gb.compare(right, wrong)
    e = right.parts[0].residual("v")
    n, variance = e.size, np.mean(e**2)
    logarithm = -0.5 * n * (np.log(2 * np.pi * variance) + 1)
    k = 1 + 1 + 1  # C_x, the initial state, the variance
    assert found.value("AIC", "QuadraticDrag") == pytest.approx(2 * k - 2 * logarithm, rel=1e-6)
    assert found.value("BIC", "QuadraticDrag") == pytest.approx(k * np.log(n) - 2 * logarithm, rel=1e-6)
