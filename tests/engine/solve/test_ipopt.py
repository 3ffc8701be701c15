"""One IPOPT run: options, failures that stay results, poles on the imaginary axis, silence."""

import casadi as ca
import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, Oscillator, measured

import greybox as gb
from greybox.engine.solve.ipopt import StopCheck

PROBLEM = gb.Problem(LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS))
OSCILLATOR = measured(Oscillator(), [1.0, 2.0, 4.0, 8.0], {"w0": 3.0, "K": 2.0})
CRITERIA = [gb.RelativeError(), gb.SquaredRelativeError(), gb.MagnitudePhase()]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_itr": 3}, "solver_options 'max_itr' = 3 is not accepted by IPOPT"),
        (
            {"max_iter": 50, "tolerance": 1e-9},
            "solver_options 'tolerance' = 1e-09 is not accepted by IPOPT",
        ),
        ({"tol": "small"}, "solver_options 'tol' = 'small' is not accepted by IPOPT"),
        ({"max_iter": -3}, "solver_options 'max_iter' = -3"),
        ({"linear_solver": "nope"}, "solver_options 'linear_solver' = 'nope'"),
    ],
)
def test_an_option_that_ipopt_does_not_take_is_named(options, words):
    with pytest.raises(ValueError, match=words):
        gb.fit(PROBLEM, starts=1, solver_options=options)


@pytest.mark.parametrize("most", [0, 1, 4])
def test_max_iter_is_respected(most):
    fit = gb.fit(PROBLEM, starts=5, solver_options={"max_iter": most})
    assert not any(run.converged for run in fit.runs)
    assert [run.iterations for run in fit.runs] == [most] * 5


def test_tolerance_reaches_the_solver():
    coarse, fine = (gb.fit(PROBLEM, starts=5, solver_options={"tol": tol}) for tol in (1e-1, 1e-11))
    assert sum(run.iterations for run in coarse.runs) < sum(run.iterations for run in fine.runs)
    assert min(run.cost for run in fine.runs) < min(run.cost for run in coarse.runs)


@pytest.mark.parametrize("criterion", CRITERIA, ids=repr)
def test_a_start_whose_pole_lies_on_a_data_frequency_fails_and_never_wins(criterion):
    fit = gb.fit(
        gb.Problem(Oscillator(), OSCILLATOR, criterion),
        starts=[{"w0": 2.0}, {"w0": 4.0}, {"w0": 3.2}],
    )
    for run in fit.runs[:2]:
        assert run.status == "Invalid_Number_Detected" or (run.converged and np.isfinite(run.cost))
    assert fit.runs[2].converged
    assert fit.minima[0].runs[0] == 2 or fit.runs[fit.minima[0].runs[0]].converged
    assert fit.estimate == pytest.approx({"w0": 3.0, "K": 2.0}, rel=1e-6)


def test_only_failures_are_an_answer_too():
    fit = gb.fit(gb.Problem(Oscillator(), OSCILLATOR), starts=[{"w0": 2.0}, {"w0": 4.0}])
    assert not fit.converged
    assert "1 × Invalid_Number_Detected (no finite response at omega = 2 rad/s)" in fit.status
    assert "1 × Invalid_Number_Detected (no finite response at omega = 4 rad/s)" in fit.status


def test_failed_and_good_runs_print_nothing(capfd):
    gb.fit(gb.Problem(Oscillator(), OSCILLATOR), starts=[{"w0": 2.0}, {"w0": 3.2}], progress=False)
    assert capfd.readouterr() == ("", "")


def test_estimates_stay_inside_their_bounds_to_the_last_bit():
    data = measured(
        LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS | {"tau": 0.0, "T2": 0.001}, noise=0.02, seed=3
    )
    fit = gb.fit(gb.Problem(LagLagDelay(), data), starts=20)
    for run in fit.runs:
        assert np.all(run.estimate >= [0, 0.001, 0.001, 0])
        assert np.all(run.estimate <= [100, 10, 10, 0.5])


def check(equations=0):
    """What stops a run on a problem of two variables."""
    sizes = {"x": 2, "p": 1, "f": 1, "g": equations}
    return StopCheck({name: ca.SX.sym(name, size) for name, size in sizes.items()})


@pytest.mark.parametrize(
    ("fall", "waits"), [(0.9e-6, True), (1.1e-6, False), (-1.0, True), (0.0, True)]
)
@pytest.mark.parametrize("size", [3.0, -3.0])
def test_a_run_is_stagnant_after_eighty_iterations_without_a_millionth_less(fall, waits, size):
    stop, x = check(), np.array([1.0, 2.0])
    assert not stop.is_stagnant(x, np.inf)
    assert not stop.is_stagnant(x, size)
    told = [stop.is_stagnant(x, size - fall * abs(size)) for _ in range(80)]
    assert told == [False] * 79 + [waits]
    assert stop.is_stagnant(x, size - fall * abs(size))


def test_the_lowest_point_is_kept_and_a_run_begins_anew():
    stop = check()
    for x, cost in ((1.0, 5.0), (2.0, 4.0), (3.0, 4.5), (4.0, 4.0)):
        stop.is_stagnant(np.array([x, -x]), cost)
    assert stop.best.tolist() == [2.0, -2.0]
    stop.begin()
    assert (stop.best, stop.reason) == (None, "")
    assert not stop.is_stagnant(np.array([9.0, 9.0]), 6.0)
    assert stop.best.tolist() == [9.0, 9.0]


def test_with_equations_nothing_is_stagnant():
    stop = check(equations=3)
    assert not any(stop.is_stagnant(np.zeros(2), 1.0) for _ in range(200))
    assert stop.best is None
