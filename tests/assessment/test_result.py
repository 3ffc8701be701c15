"""Runs grouped into minima: by cost and response, whatever the parameters."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, Parabola, measured

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.minima import (
    Multistart,
    best_unfinished,
    find_minima,
    same_cost,
)
from greybox.engine.solve.runs import SCREENED, TOO_COARSE, Run, Runs

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
    # The gain is (x² - 1)² + slope (1 - x) + 2 and 2 is measured: zero cost at x = 1, a local
    # minimum near x = -1.
    fit = gb.fit(gb.Problem(Parabola(), GAIN), starts=[{"x": x} for x in (-1.5, -0.8, 0.8, 1.4)])
    assert [round(float(m.estimate[0]), 1) for m in fit.minima] == [1.0, -1.0]
    assert [sorted(m.runs) for m in fit.minima] == [[2, 3], [0, 1]]
    assert fit.agreeing == 2
    gain = (fit.minima[1].estimate[0] ** 2 - 1) ** 2 + 0.1 * (1 - fit.minima[1].estimate[0]) + 2
    assert fit.minima[1].cost == pytest.approx(3 * (gain / 2 - 1), rel=1e-4)


def test_two_parameters_of_one_response_are_one_minimum():
    # Without the slope x and -x give the same gain.
    data = measured(Parabola(), [0.5, 1.0, 2.0], {"x": 1.3, "slope": 0.0})
    fit = gb.fit(
        gb.Problem(Parabola(), data, fixed={"slope": 0.0}), starts=[{"x": x} for x in (-1.5, 1.4)]
    )
    assert len(fit.minima) == 1
    assert fit.minima[0].variants == 2


def run(index, x, cost, converged=True, status="Solve_Succeeded"):
    return Run(index, np.array([0.1]), np.array([x]), cost, status, converged, 3, 0.1)


def test_runs_that_did_not_converge_are_in_no_minimum():
    nlp = compile_problem(gb.Problem(Parabola(), GAIN))
    runs = [
        run(0, 1.0, 0.0, False, "Invalid_Number_Detected"),
        run(1, -0.9, 0.31),
        run(2, 0.9, 0.2),
        run(3, 0.9, 0.2),
    ]
    signatures = nlp.judged(np.array([run.estimate for run in runs]))[1]
    minima = find_minima(nlp, runs, signatures)
    assert [m.runs for m in minima] == [(2, 3), (1,)]
    assert [m.cost for m in minima] == [0.2, 0.31]
    assert find_minima(nlp, runs[:1], signatures) == ()


def test_a_multistart_counts_its_failures_by_status():
    runs = (
        run(0, 1.0, 0.1),
        *(run(k, 1.0, np.nan, False, s) for k, s in enumerate("aba", start=1)),
    )
    search = Multistart(Runs.of(runs), ())
    assert search.converged == 1
    assert search.failures == "2 × a, 1 × b"


def test_runs_are_alike_to_a_ten_thousandth_of_the_cost_and_a_hundredth_of_the_response():
    nlp = compile_problem(gb.Problem(Parabola(), GAIN))
    signature = np.array([1.0, 2.0, -3.0, 0.1])
    away = np.array(
        [0.0, 0.0, 0.03, 0.0]
    )  # a hundredth of the third, which is half of that of all four

    def minima(costs, signatures):
        return [
            m.runs
            for m in find_minima(nlp, [run(k, 0.9, c) for k, c in enumerate(costs)], signatures)
        ]

    assert minima([1.0, 1.00009, 1.00011], [signature] * 3) == [(0, 1), (2,)]
    assert minima([1.0] * 3, [signature, signature + 1.9 * away, signature + 2.1 * away]) == [
        (0, 1),
        (2,),
    ]
    # What is below one counts as one: in units of the measured response.
    assert minima(
        [1.0] * 3, [signature, *(signature + np.array([0, 0, 0, d]) for d in (0.019, 0.021))]
    ) == [
        (0, 1),
        (2,),
    ]
    # Six numbers of 5e-4 are rounding: costs below are not told apart by less than a ten thousandth
    # of that.
    assert minima([0.0, 2.9e-7, 3.1e-7], [signature] * 3) == [(0, 1), (2,)]
    likely = compile_problem(gb.Problem(Parabola(), GAIN, gb.RelativeLikelihood()))
    assert same_cost(likely, -1e4) == pytest.approx(0.011)


def test_vectors_that_differ_by_a_twentieth_are_variants():
    nlp = compile_problem(gb.Problem(Parabola(), GAIN))
    size = float(nlp.scaling.to_solver(np.array([[2.0, 0.1]]))[0, 0])
    found = find_minima(
        nlp, [_at(k, x) for k, x in enumerate((2.0, 2.08, 2.2, -2.0, 2.21))], [np.ones(3)] * 5
    )
    assert size != 0
    assert [m.variants for m in found] == [3]


def _at(index, x):
    return Run(index, np.array([0.1]), np.array([x, 0.1]), 1.0, "Solve_Succeeded", True, 3, 0.1)


def test_the_best_run_that_did_not_end():
    runs = [
        run(0, 1.0, 1.0),
        replace(run(1, 1.0, 2.0, False), stage=SCREENED),
        run(2, 1.0, 4.0, False),
        run(3, 1.0, 3.0, False),
        run(4, 1.0, 0.5, False, TOO_COARSE),
        run(5, 1.0, -np.inf, False),
    ]
    assert best_unfinished(runs).index == 3
    assert best_unfinished(runs[:2]).index == 1
    assert best_unfinished(runs[:1]) is None
    search = Multistart(Runs.of(runs), ())
    assert [r.index for r in search.brought] == [0, 2, 3, 4, 5]
    assert repr(search) == "<Multistart 1 of 5 runs converged, 0 minima>"
