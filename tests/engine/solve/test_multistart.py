"""Many runs: all are kept, failures never win, noise-free truths are found from nearly every start."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TILT, TILT_OMEGA, TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_array_equal

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.local_solver import Screened
from greybox.engine.solve.minima import find_minima
from greybox.engine.solve.multistart import FiniteStarts, multistart
from greybox.engine.solve.promising import Promising
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.engine.solve.runs import Outcome, Run
from greybox.engine.solve.search_method import solver_for
from greybox.models.tilt import Tilt

pytestmark = pytest.mark.usefixtures("unjudged_file")

NOISY = gb.Problem(LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.05))
CRITERIA = [
    gb.RelativeError(),
    gb.RelativeError(normalized="model"),
    gb.SquaredRelativeError(),
    gb.MagnitudePhase(),
    gb.MaximumLikelihood(),
]


@pytest.mark.parametrize("criterion", CRITERIA, ids=repr)
def test_two_lags_and_a_delay_are_found_from_nearly_every_start(criterion):
    exact = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS)
    data = measured(
        LagLagDelay(),
        TWO_LAGS_OMEGA,
        TWO_LAGS,
        columns={"variance": 1e-4 * np.abs(exact.response) ** 2},
    )
    ordered = [lambda p: p.T1 - p.T2]
    fit = gb.fit(
        gb.Problem(LagLagDelay(), data, criterion, constraints=ordered), 10, profiles=False
    )
    assert fit.agreeing >= 9
    assert fit.estimate == pytest.approx(TWO_LAGS, rel=1e-6)


@pytest.mark.parametrize("criterion", CRITERIA[:4], ids=repr)
def test_tilt_is_found_from_nearly_every_start(criterion):
    fit = gb.fit(
        gb.Problem(Tilt(), measured(Tilt(), TILT_OMEGA, TILT), criterion), 30, profiles=False
    )
    assert fit.agreeing >= 28
    assert {n: fit.estimate[n] for n in TILT} == pytest.approx(TILT, rel=1e-6)


def test_every_run_is_kept_with_its_story():
    fit = gb.fit(NOISY, gb.solve.Sobol(12, seed=5), search="multistart")
    assert [run.index for run in fit.runs] == list(range(12))
    assert_array_equal(
        [r.start for r in fit.runs], gb.solve.Sobol(12, seed=5).draw(NOISY.parameters)
    )
    for run in fit.runs:
        assert (run.status, run.stage) == ("Solve_Succeeded", "polished")
        assert run.converged
        assert run.iterations > 1
        assert 0 < run.seconds < fit.seconds
        values = dict(zip(fit.free, run.estimate, strict=True))
        assert gb.cost(NOISY, values) == pytest.approx(run.cost, rel=1e-12)


def test_without_a_converged_run_there_is_no_answer_and_it_says_why():
    fit = gb.fit(NOISY, starts=4, solver_options={"max_iter": 1})
    assert not fit.converged
    assert fit.minima == ()
    assert fit.agreeing == 0
    assert np.isnan(fit.cost)
    assert all(np.isnan(value) for value in (*fit.estimate.values(), *fit.standard_error.values()))
    assert fit.status == "no start converged (4 × Maximum_Iterations_Exceeded)"
    assert "FAILED: no start converged (4 × Maximum_Iterations_Exceeded)" in str(fit)
    assert len(fit.runs) == 4
    assert all(np.isfinite(run.cost) for run in fit.runs)


def test_a_failed_fit_with_ties_and_derived_quantities_is_a_result_too():
    class Derived(LagLagDelay):
        derived = {"sum": lambda p: p.T1 + p.T2}

    problem = gb.Problem(Derived(), NOISY.data, tied={"T2": lambda p: p.T1 / 10})
    fit = gb.fit(problem, starts=2, solver_options={"max_iter": 1})
    assert not fit.converged
    assert np.isnan(fit.estimate["T2"])
    assert np.isnan(fit.derived["sum"])
    assert "FAILED" in str(fit)


def test_a_run_that_did_not_converge_never_wins_however_cheap_it_is():
    exact = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS)
    nlp = compile_problem(gb.Problem(LagLagDelay(), exact))
    truth = np.array(list(TWO_LAGS.values()))
    stopped = multistart(solver_for(nlp, {"max_iter": 0}), 1.2 * truth[None])
    assert stopped.runs[0].status == "Maximum_Iterations_Exceeded"
    assert stopped.minima == ()
    worse = replace(stopped.runs[0], index=1, cost=9.0, converged=True, estimate=truth * 1.5)
    runs = [replace(stopped.runs[0], cost=0.0), worse]
    (only,) = find_minima(nlp, runs, nlp.judged(np.array([run.estimate for run in runs]))[1])
    assert (only.cost, only.runs) == (9.0, (1,))


def test_the_polish_ends_no_higher_than_the_best_run():
    fit = gb.fit(NOISY, starts=10)
    assert fit.cost <= min(run.cost for run in fit.runs)
    assert gb.cost(NOISY, {n: fit.estimate[n] for n in fit.free}) == pytest.approx(
        fit.cost, rel=1e-12
    )


def test_progress_is_told_after_every_run():
    told = []
    gb.fit(NOISY, starts=5, progress=lambda done, total: told.append((done, total)))
    assert told == [(k, 5) for k in range(1, 6)]


def test_the_same_seed_gives_the_same_runs_bit_by_bit():
    first, second, other = (gb.fit(NOISY, starts=8, seed=seed) for seed in (3, 3, 4))
    for a, b in zip(first.runs, second.runs, strict=True):
        assert_array_equal(a.start, b.start)
        assert_array_equal(a.estimate, b.estimate)
        assert (a.cost, a.status, a.iterations) == (b.cost, b.status, b.iterations)
    assert first.estimate == second.estimate
    assert first.standard_error == second.standard_error
    assert not np.array_equal(first.runs[1].start, other.runs[1].start)


def test_a_start_at_which_the_model_is_not_finite_is_moved_no_farther_than_it_must():
    """Toward the first start, along the straight line in the solver's variables, by halves of what is left."""
    nlp = compile_problem(NOISY)
    home, away = (nlp.scaling.to_parameters(np.full(len(nlp.free), z)) for z in (0.2, 0.8))
    began = []

    class Bounded(ResponseSolver):
        """Finite within 0.2 of its home, in the solver's variables."""

        def is_finite_at(self, start):
            return bool(np.all(np.abs(nlp.scaling.to_solver(start) - 0.2) < 0.2))

        def run(self, start, *_):
            began.append(start)
            return Outcome(start, "converged", 1, 0.0, True, 1.0, np.zeros(1))

        def judged(self, outcomes):
            return outcomes

    multistart(Bounded(nlp, batched=False), np.array([home, away]))
    moved = [nlp.scaling.to_solver(start) for start in began]
    assert any(np.allclose(z, 0.2) for z in moved)
    assert any(np.allclose(z, 0.2 + 0.6 / 4) for z in moved)  # 0.8 and 0.5 are too far, 0.35 is not


def test_runs_are_told_apart_by_their_response_in_units_of_the_signals():
    """Of one cost: two at which a signal is rounding, and one with another response."""
    nlp = compile_problem(NOISY)
    x = nlp.scaling.to_parameters(np.full(len(nlp.free), 0.3))
    signatures = [
        np.array([3.0, 1e-9]),
        np.array([3.0, -2e-9]),
        np.array([3.3, 0.0]),
        np.array([3.0, 0.1]),
    ]
    runs = [Run(k, x, x, 1.0, "converged", True, 1, 0.0) for k in range(4)]
    assert [minimum.runs for minimum in find_minima(nlp, runs, signatures)] == [(0, 1), (2,), (3,)]


def finite_below(limit, asked):
    """A solver whose model is finite where the first parameter is below a limit, or is 50."""
    return SimpleNamespace(
        nlp=of_logarithms(),
        is_finite_at=lambda x: asked.append(float(x[0])) or bool(x[0] < limit or x[0] == 50),
    )


def of_logarithms():
    """The solver's variables are the logarithms of the parameters, which are within 0.01 and 60."""
    scaling = SimpleNamespace(to_solver=np.log)
    return SimpleNamespace(scaling=scaling, estimate_at=lambda z: np.clip(np.exp(z), 0.01, 60.0))


def test_starts_at_which_the_model_is_not_finite_move_toward_the_first_at_which_it_is():
    """Half of the way in the solver's variables, a quarter, and so on.

    What was finite or is hopeless stays.
    """
    asked = []
    starts = np.array([[100.0], [64.0], [2.0], [1.0], [32.0], [50.0]])

    def moved_to_finite(limit, starts):
        points = FiniteStarts(finite_below(limit, asked), starts)
        return np.array([points[k] for k in range(len(starts))])

    moved = moved_to_finite(6.0, starts)
    # From 2: half of the way to 100 and to 64 is too far, a quarter is not; half of that to 32
    # would be 8.
    assert moved.ravel() == pytest.approx(
        [2 * 50**0.25, 2 * 32**0.25, 2.0, 1.0, 2 * 16**0.25, 50.0]
    )
    assert_array_equal(moved_to_finite(0.0, starts[:5]), starts[:5])
    # Where only home is finite, a start stays after six halvings.
    asked.clear()
    assert_array_equal(moved_to_finite(2.001, starts[2:5:2]), starts[2:5:2])
    assert asked[3:] == pytest.approx(
        [2 * 16.0**share for share in (0.5, 0.25, 0.125, 1 / 16, 1 / 32, 1 / 64)]
    )


class Compared(ResponseSolver):
    """Ends where it begins, at the cost of its start; the last starts are the most promising."""

    def screened(self, starts):
        order = np.arange(len(starts))[::-1]
        return Screened(order, np.full(len(starts), 7.0))

    def run(self, start):
        return Outcome(start, "converged", 1, 0.0, True, float(start[0]), np.zeros(1))

    def run_together(self, starts):
        return [self.run(start) for start in starts]

    def judged(self, outcomes):
        return outcomes


@pytest.mark.parametrize(("agreeing", "count"), [(2, 3), (3, 6)])
def test_the_others_follow_where_not_enough_of_the_promising_starts_agree(agreeing, count):
    nlp = compile_problem(NOISY)
    starts = np.tile([1.5, 0.1, 0.2, 0.3], (6, 1))
    starts[3, 0] = 1.9  # the third of the promising ones ends higher
    search = multistart(Compared(nlp), starts, promising=Promising((3,), agreeing))
    assert len(search.brought) == count
    assert [run.index for run in search.runs] == [*range(6)]
    assert [run.stage for run in search.runs] == ["screened"] * (6 - count) + ["polished"] * count
    assert all(run.cost == 7.0 for run in search.runs[:3]) == (count == 3)
    assert set(search.minima[0].runs) == {0, 1, 2, 4, 5} - ({0, 1, 2} if count == 3 else set())
    every = multistart(Compared(nlp), starts, promising=Promising((6,), agreeing))
    assert len(every.brought) == 6


@pytest.mark.parametrize(("agreeing", "count"), [(3, 5), (4, 8)])
def test_runs_agree_within_a_tenth_of_a_unit_of_likelihood(agreeing, count):
    """Of costs of 2 n numbers, 0.1 / 2 n of their size."""
    nlp = compile_problem(NOISY)
    share = 0.1 / sum(part.numbers for part in nlp.parts)
    starts = np.tile([1.5, 0.1, 0.2, 0.3], (8, 1))
    starts[3:, 0] *= np.array([1 + 0.9 * share, 1 + 1.1 * share, 1 + 0.5 * share, 2.0, 1.0])
    search = multistart(Compared(nlp), starts, promising=Promising((5,), agreeing))
    assert len(search.brought) == count
