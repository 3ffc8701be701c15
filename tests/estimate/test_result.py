"""Runs grouped into minima: by cost and response, whatever the parameters."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, Parabola, measured

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve.minima import Multistart, find_minima
from greybox.solve.outcome import Run

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)
GAIN = measured(Parabola(), [0.5, 1.0, 2.0], {"x": 1.0, "slope": 0.0})


def test_lags_that_swap_are_one_minimum_with_two_variants():
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), starts=40)
    (minimum,) = fit.minima
    assert minimum.variants == 2
    assert sorted(minimum.runs) == list(range(40))
    estimates = np.array([run.estimate for run in fit.runs])
    swapped = estimates[:, 1] < estimates[:, 2]
    assert 5 < swapped.sum() < 35
    assert estimates[swapped][0] == pytest.approx(estimates[~swapped][0][[0, 2, 1, 3]], rel=1e-3)


def test_two_minima_of_different_response_are_two():
    # The gain is (x² - 1)² + slope (1 - x) + 2 and 2 is measured: zero cost at x = 1, a local minimum near x = -1.
    fit = gb.fit(gb.Problem(Parabola(), GAIN), starts=[{"x": x} for x in (-1.5, -0.8, 0.8, 1.4)])
    assert [round(float(m.estimate[0]), 1) for m in fit.minima] == [1.0, -1.0]
    assert [sorted(m.runs) for m in fit.minima] == [[2, 3], [0, 1]]
    assert fit.agreeing == 2
    gain = (fit.minima[1].estimate[0] ** 2 - 1) ** 2 + 0.1 * (1 - fit.minima[1].estimate[0]) + 2
    assert fit.minima[1].cost == pytest.approx(3 * (gain / 2 - 1), rel=1e-4)


def test_two_parameters_of_one_response_are_one_minimum():
    # Without the slope x and -x give the same gain.
    data = measured(Parabola(), [0.5, 1.0, 2.0], {"x": 1.3, "slope": 0.0})
    fit = gb.fit(gb.Problem(Parabola(), data, fixed={"slope": 0.0}), starts=[{"x": x} for x in (-1.5, 1.4)])
    assert len(fit.minima) == 1
    assert fit.minima[0].variants == 2


def run(index, x, cost, converged=True, status="Solve_Succeeded"):
    return Run(index, np.array([0.1]), np.array([x]), cost, status, converged, 3, 0.1)


def test_runs_that_did_not_converge_are_in_no_minimum():
    nlp = compile_problem(gb.Problem(Parabola(), GAIN))
    runs = [run(0, 1.0, 0.0, False, "Invalid_Number_Detected"), run(1, -0.9, 0.31), run(2, 0.9, 0.2), run(3, 0.9, 0.2)]
    signatures = nlp.signatures(np.array([run.estimate for run in runs]))
    minima = find_minima(nlp, runs, signatures)
    assert [m.runs for m in minima] == [(2, 3), (1,)]
    assert [m.cost for m in minima] == [0.2, 0.31]
    assert find_minima(nlp, runs[:1], signatures) == ()


def test_a_multistart_counts_its_failures_by_status():
    runs = (run(0, 1.0, 0.1), *(run(k, 1.0, np.nan, False, s) for k, s in enumerate("aba", start=1)))
    search = Multistart(runs, (), 1.0)
    assert search.converged == 1
    assert search.failures == "2 × a, 1 × b"
