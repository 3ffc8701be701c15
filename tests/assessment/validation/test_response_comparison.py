"""Fits of frequency responses side by side: one likelihood, one verdict, and points that a fit was not given."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from scipy.optimize import minimize

import greybox as gb

SQUARED = gb.SquaredRelativeError()


def fitted(model, data, criterion=None, **stated):
    return gb.fit(gb.Problem(model, data, criterion, **stated), starts=4)


class Second(LagLagDelay):
    """Two lags and a delay, and a pair of zeros that the data do not have."""

    zeros = gb.Parameter(0.0, bounds=(-1, 1), unit="s²")

    def response(self, s, p):
        return super().response(s, p) * (1 + p.zeros * s**2)


@pytest.fixture(scope="module")
def data():
    return measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)


@pytest.fixture(scope="module")
def compared(data):
    fits = (
        fitted(Lag(), data),
        fitted(LagLagDelay(), data, SQUARED),
        fitted(Second(), data, gb.MagnitudePhase()),
    )
    return fits, gb.compare(*fits)


def test_fits_by_different_criteria_have_the_information_criteria_of_one_likelihood(data, compared):
    fits, found = compared

    def log_likelihood(
        x,
    ):  # of circular normal errors of the relative variance v, as of a textbook, without constants
        model = (
            x[0]
            / ((1 + 1j * x[1] * data.omega) * (1 + 1j * x[2] * data.omega))
            * np.exp(-1j * x[3] * data.omega)
        )
        relative = np.abs(data.response / model - 1) ** 2
        v = relative.mean()
        return -np.sum(np.log(v * np.abs(model / data.response) ** 2) + relative / v)

    start = [fits[1].estimate[name] for name in ("K", "T1", "T2", "tau")]
    best = minimize(
        lambda x: -log_likelihood(x),
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-9},
    )
    k, n = 5, 60  # parameters and the variance; real numbers
    name = "LagLagDelay"
    assert found.value("AIC", name) == pytest.approx(2 * k + 2 * best.fun, abs=1e-4)
    assert found.value("AICc", name) == pytest.approx(
        2 * k + 2 * best.fun + 2 * k * (k + 1) / (n - k - 1), abs=1e-4
    )
    assert found.value("BIC", name) == pytest.approx(k * np.log(n) + 2 * best.fun, abs=1e-4)
    assert found.value("relative residual (rms)", name) == pytest.approx(
        100 * np.sqrt(np.mean(np.abs(fits[1].responses[0].response / data.response - 1) ** 2))
    )
    for fit, label in zip(fits, found.labels, strict=True):
        assert found.value(f"cost: {fit.criterion}", label) == pytest.approx(fit.cost)
    (said,) = [s for s in found.statements if s.startswith("Costs are not compared")]
    assert "they are of different criteria" in said
    (said,) = [
        s
        for s in found.statements
        if s.startswith("AIC, AICc and BIC are those of RelativeLikelihood")
    ]


def test_the_verdict_names_the_true_structure(compared):
    _, found = compared
    assert found.supported == "LagLagDelay"
    assert found.verdict.startswith("LagLagDelay (4 free) is supported")
    assert found.verdict in str(found)
    assert any(
        s.startswith("LagLagDelay fits the data better than Lag (AIC differs by 39")
        for s in found.statements
    )
    assert len(str(found).splitlines()) < 60  # a page


def test_costs_by_different_criteria_have_no_nested_test(data, compared):
    (_, both, _), found = compared
    assert not any("contains LagLagDelay" in s for s in found.statements)
    with_zeros = fitted(Second(), data, SQUARED)
    found = gb.compare(both, with_zeros)
    assert any("Second contains LagLagDelay" in s for s in found.statements)


def test_alike_structures_and_mistakes_are_told(data, compared):
    (_, both, _), _ = compared
    twice = gb.compare(both, fitted(LagLagDelay(), data), labels=("a", "b"))
    assert twice.verdict.startswith("a and b (4 free) are supported alike")


def test_given_variances_make_the_likelihood():
    likely = measured(Lag(), TWO_LAGS_OMEGA, noise=0.02, columns={"variance": np.full(30, 1e-4)})
    likelihood = fitted(Lag(), likely, gb.MaximumLikelihood())
    found = gb.compare(likelihood, fitted(LagLagDelay(), likely, gb.MaximumLikelihood()))
    assert found.value("AIC", "Lag") == pytest.approx(2 * likelihood.cost + 4)
    relative = fitted(Lag(), likely)
    found = gb.compare(likelihood, relative, labels=("likelihood", "relative"))
    assert found.value("AIC", "relative") == pytest.approx(
        found.value("AIC", "likelihood"), abs=1e-5
    )


def test_that_no_model_explains_the_data_comes_first(data, compared):
    free = fitted(Lag(), data, gb.RelativeLikelihood())
    held = fitted(Lag(), data, gb.RelativeLikelihood(), fixed={"T": 0.5})
    assert not any(fit.misfit.explains for fit in (free, held))
    verdict = gb.compare(free, held, labels=("free", "held")).verdict
    assert verdict.startswith("None of these models explains its data")
    assert "free (2 free) is supported" in verdict
    assert compared[1].verdict.startswith("LagLagDelay (4 free) is supported")
