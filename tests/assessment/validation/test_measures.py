"""The rows of a comparison are those of the predictions and of the likelihood."""

import numpy as np
import pytest
from drag_flights import QUADRATIC, LinearDrag, QuadraticDrag, fitted, flight

import greybox as gb
from greybox.assessment.validation.measures import information_rows
from greybox.statistics.correlation_statistics import LAGS, whiteness

pytestmark = pytest.mark.usefixtures("unjudged_file")


@pytest.fixture(scope="module")
def quadratic():
    """Nonlinear truth: the quadratic and the linear model fitted to one flight, and another flight."""
    record = flight(QUADRATIC, 1)
    return fitted(QuadraticDrag(), record), fitted(LinearDrag(), record), flight(QUADRATIC, 2)


def test_the_measures_are_those_of_the_predictions(quadratic):
    right, wrong, other = quadratic
    found = gb.compare(right, wrong, records=other, window=2.0, lead=1.0)
    alone = gb.predict(wrong, record=other, horizon=2.0, lead=1.0)
    windows = {kind: len(of_fits[0][0]) for kind, of_fits in found.predictions.items()}
    assert windows == {"identification": 14, "held-out": 14}
    assert found.value("error (rms)", "LinearDrag", "held-out", "v") == pytest.approx(
        alone.rms("v"), rel=1e-6
    )
    assert found.value("fit", "LinearDrag", "held-out", "v") == pytest.approx(
        alone.fit_percent("v"), rel=1e-6
    )
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
    assert found.value("BIC", "QuadraticDrag") == pytest.approx(
        k * np.log(n) - 2 * logarithm, rel=1e-6
    )


def test_errors_one_step_ahead_are_cut_where_the_record_has_gaps(quadratic):
    right, wrong, other = quadratic
    apart = other.rows(np.r_[0:260, 320:600])
    found = gb.compare(right, wrong, records=apart)
    expected = []
    for prediction in (found.predictions["held-out"][k][0] for k in range(2)):
        along = np.full(len(apart), np.nan)
        along[prediction.rows.ravel()] = prediction.one_step[0].ravel()
        expected.append(whiteness([along[:260], along[260:]]))
    for name, test in zip(found.labels, expected, strict=True):
        assert found.value("  white (p)", name, "held-out", "v") == pytest.approx(test.p_value)


def test_gains_of_an_output_count_in_the_test_of_its_whiteness():
    record = flight(QUADRATIC, 1, duration=15.0)
    output, prediction = (
        fitted(QuadraticDrag(), record, criterion=c)
        for c in (gb.OutputError(), gb.PredictionError())
    )
    found = gb.compare(output, prediction, labels=("output", "prediction"))
    for label, fit, gains in zip(found.labels, (output, prediction), (0, 1), strict=True):
        (made,) = found.predictions["identification"][found.labels.index(label)]
        along = np.full(len(record), np.nan)
        along[made.rows.ravel()] = made.one_step[0].ravel()
        test = whiteness([along], fitted=gains)
        assert test.dof == LAGS - gains
        assert found.value("  white (p)", label, "identification", "v") == pytest.approx(
            test.p_value
        )
        assert sum(o == "v" for _, o in fit.records[0].gains) == gains


def test_criteria_of_information_are_their_formulas_and_count_from_the_least():
    """AICc as Burnham and Anderson have it, AIC + 2 k (k + 1) / (n - k - 1); none where n is k + 1 or less."""
    k, n, cost = np.array([2, 4, 9]), np.array([12, 12, 10]), np.array([5.0, 2.5, 1.0])
    rows = {row.measure: row.values for row in information_rows(cost, k.tolist(), n.tolist())}
    aic = 2 * k + 2 * cost
    corrected = aic[:2] + 2 * k[:2] * (k[:2] + 1) / (n[:2] - k[:2] - 1)
    assert rows["AIC"] == pytest.approx(aic)
    assert rows["AICc"][:2] == pytest.approx(corrected)
    assert rows["AICc"][2] is None
    assert rows["BIC"] == pytest.approx(k * np.log(n) + 2 * cost)
    assert rows["AIC less the least"] == pytest.approx(aic - aic.min())
    assert rows["AICc less the least"][:2] == pytest.approx(corrected - corrected.min())
    (last,) = [row for row in information_rows([1.0], [9], [11]) if row.measure == "AICc"]
    assert last.values == pytest.approx((2 * 9 * 11 / 1 + 2,))


def test_the_size_of_errors_one_step_ahead_is_their_root_mean_square(quadratic):
    right, _, other = quadratic
    found = gb.compare(right, right, records=other, labels=("a", "b"))
    (made,) = found.predictions["held-out"][0]
    assert found.value("one step ahead: error over noise", "a", "held-out", "v") == pytest.approx(
        np.sqrt(np.nanmean(made.one_step[0] ** 2))
    )
