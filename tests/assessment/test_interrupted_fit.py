"""Ctrl-C during a fit, wherever it is: a real signal, and the best fit so far."""

import threading

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from sampled_lag import lag_problem

import greybox as gb
from greybox.assessment import fit as fitting
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.engine.solve.transcribed_program import TranscribedProgram

pytestmark = pytest.mark.usefixtures("unjudged_file")

RECORD_PROBLEM = lag_problem(samples=40)
MANY = 20_000  # starts that would take minutes
RESPONSE_PROBLEM = gb.Problem(
    LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)
)
CASES = [
    pytest.param(RESPONSE_PROBLEM, None, ResponseSolver, "multistart", id="response"),
    pytest.param(RECORD_PROBLEM, None, GaussNewton, "batched", id="record"),
    pytest.param(
        RECORD_PROBLEM, gb.Collocation(), TranscribedProgram, "batched", id="record by IPOPT"
    ),
]


@pytest.mark.parametrize(("problem", "method", "solver", "search"), CASES)
def test_the_fit_of_the_starts_that_were_done_is_attached(
    press_ctrl_c, problem, method, solver, search
):
    def progress(done, _):
        if done == 3:
            press_ctrl_c()

    with pytest.raises(KeyboardInterrupt) as stopped:
        gb.fit(problem, MANY, method=method, search=search, progress=progress)
    partial = stopped.value.fit
    whole = gb.fit(problem, 3, method=method, search=search)
    assert "after 3 starts" in str(stopped.value)
    assert len(partial.runs) == 3
    assert partial.warnings[0].startswith(f"interrupted after 3 of {MANY} starts")
    assert partial.estimate == pytest.approx(whole.estimate, rel=1e-4)
    assert partial.standard_error == pytest.approx(whole.standard_error, rel=1e-3)


@pytest.mark.parametrize(("problem", "method", "solver", "search"), CASES)
def test_the_run_at_hand_ends_at_its_next_iteration(
    press_ctrl_c, monkeypatch, problem, method, solver, search
):
    """Within IPOPT, where CasADi would swallow an exception, as within Gauss-Newton steps."""
    run = solver.run
    begun = []

    def pressed_at_the_third(self, *arguments):
        begun.append(arguments)
        if len(begun) == 3:
            press_ctrl_c()
        return run(self, *arguments)

    monkeypatch.setattr(solver, "run", pressed_at_the_third)
    with pytest.raises(KeyboardInterrupt) as stopped:
        gb.fit(problem, MANY, method=method, search=search, progress=False)
    runs = stopped.value.fit.runs
    assert [run.status == "interrupted" for run in runs] == [False, False, True]
    assert not runs[2].converged
    assert runs[2].iterations <= 1
    assert stopped.value.fit.converged == any(run.converged for run in runs)


@pytest.mark.parametrize(("problem", "method", "solver", "search"), CASES)
def test_it_ends_whenever_the_signal_comes(press_ctrl_c, problem, method, solver, search):
    def progress(done, _):
        if done == 1:
            threading.Timer(0.02, press_ctrl_c).start()

    with pytest.raises(KeyboardInterrupt) as stopped:
        gb.fit(problem, MANY, method=method, search=search, progress=progress)
    assert 1 <= len(stopped.value.fit.runs) < 1000


def test_before_the_first_start_there_is_no_fit(press_ctrl_c):
    """The draw is finished: SciPy prints a traceback of an interrupt while it loads its numbers."""
    drawn = []

    class Pressing(gb.Starts):
        def draw(self, parameters):
            press_ctrl_c()
            drawn.append(np.ones((1, len(parameters))))
            return drawn[0]

        def __str__(self):
            return "none"

    with pytest.raises(KeyboardInterrupt, match="before the first start") as stopped:
        gb.fit(RESPONSE_PROBLEM, Pressing())
    assert stopped.value.fit is None
    assert drawn


def test_while_it_is_judged_the_fit_is_finished(press_ctrl_c, monkeypatch):
    assess = fitting.assess

    def pressed(*arguments, **options):
        press_ctrl_c()
        return assess(*arguments, **options)

    monkeypatch.setattr(fitting, "assess", pressed)
    with pytest.raises(KeyboardInterrupt) as stopped:
        gb.fit(RESPONSE_PROBLEM, 4)
    assert len(stopped.value.fit.runs) == 4
    assert not any("interrupted" in warning for warning in stopped.value.fit.warnings)
