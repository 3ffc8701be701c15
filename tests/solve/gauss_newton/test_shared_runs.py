"""Runs that meet on excerpts of a record.

Each is what it would be alone, and the way on from there is gone once.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.shared_runs import SharedRuns, rounded
from greybox.solve.kept_runs import KeptRuns
from greybox.solve.multistart import multistart
from greybox.solve.runs import SEARCH_OVER

SHORT = 100


def solver_of(problem, **settings):
    nlp = compile_problem(problem)
    return GaussNewton(nlp, settings=replace(nlp.method.strategies, short_record=SHORT, **settings))


@pytest.fixture(scope="module")
def solver():
    return solver_of(lag_problem(samples=400))


@pytest.fixture(scope="module")
def starts(solver):
    problem = lag_problem(samples=400)
    return gb.solve.Sobol(4, 0).draw({name: problem.parameters[name] for name in solver.nlp.free})


@pytest.fixture
def shared(solver):
    found = SharedRuns.of(solver)
    assert found is not None
    return found


def counted(shared, monkeypatch):
    """Return the list of runs that are made on the whole record from now on, each with what it may take."""
    made, whole = [], shared.levels[0]
    run_from = whole.run_from

    def counting(z, **near):
        made.append(z)
        return run_from(z, **near)

    monkeypatch.setattr(whole, "run_from", counting)
    return made


def same(one, other):
    assert (one.status, one.cost, one.iterations) == (other.status, other.cost, other.iterations)
    assert_array_equal(one.estimate, other.estimate)
    assert_array_equal(one.signature, other.signature)
    assert_array_equal(one.nodes[0], other.nodes[0])


def test_runs_that_meet_go_on_once_and_each_is_what_it_is_alone(
    solver, shared, starts, monkeypatch
):
    made = counted(shared, monkeypatch)
    together = [shared.run(start) for start in starts]
    assert len(made) == 1
    for start, outcome in reversed(list(zip(starts, together, strict=True))):
        same(outcome, SharedRuns(solver).run(start))
        alone = solver.run(start)
        assert outcome.converged
        assert outcome.cost == pytest.approx(alone.cost, abs=1e-6)
        assert_allclose(outcome.estimate, alone.estimate, rtol=1e-4)


def test_a_run_that_does_not_arrive_is_made_alone_and_counts_all_iterations(
    solver, shared, starts, monkeypatch
):
    excerpts, whole = shared.levels[-1], shared.levels[0]
    run_from = excerpts.run_from

    def stalled(z):
        outcome, hessian = run_from(z)
        return replace(outcome, status="stalled", converged=False, iterations=7), hessian

    monkeypatch.setattr(excerpts, "run_from", stalled)
    alone = solver.run(starts[2])
    same(shared.run(starts[2]), replace(alone, iterations=alone.iterations + 7))

    monkeypatch.undo()
    whole_run = whole.run_from
    ends = iter(["stalled"])  # of the way from the excerpts, but not of the run alone

    def first_stalled(z, **near):
        outcome, hessian = whole_run(z, **near)
        status = next(ends, outcome.status)
        return replace(outcome, status=status, converged=status == "converged"), hessian

    monkeypatch.setattr(whole, "run_from", first_stalled)
    outcome = shared.run(starts[2])
    assert outcome.converged
    assert outcome.iterations > alone.iterations
    assert outcome.cost == alone.cost


def test_what_time_cuts_short_is_no_end_of_others_and_has_no_cost_of_excerpts(
    shared, starts, monkeypatch
):
    excerpts = shared.levels[-1]
    run_from = excerpts.run_from

    def cut(z):
        outcome, hessian = run_from(z)
        return replace(outcome, status=SEARCH_OVER, converged=False), hessian

    monkeypatch.setattr(excerpts, "run_from", cut)
    outcome = shared.run(starts[1])
    assert (outcome.status, outcome.cost, outcome.nodes) == (SEARCH_OVER, np.inf, None)
    monkeypatch.undo()
    assert shared.run(starts[1]).converged


def test_ends_are_rounded_to_a_share_of_their_errors_that_the_scatter_of_runs_does_not_reach():
    z = np.array([0.623456789, 1.3])
    errors = np.geomspace(1e-5, 1.0, len(z))
    ends = []
    for off in (0.0, 1e-4, -1e-4):
        ends.append(rounded(z + off * errors, np.diag(1 / ((1 + off) * errors) ** 2)))
        assert np.all(np.abs(ends[-1] - z) <= 1e-4 * errors + np.minimum(0.051 * errors, 5.1e-4))
    assert_array_equal(ends[1], ends[0])
    assert_array_equal(ends[2], ends[0])
    unknown = rounded(z, np.zeros((2, 2)))  # the data show nothing: it stays where it is
    assert_allclose(unknown, z, atol=1e-3)
    assert rounded(z, None) is z


def test_levels_end_where_excerpts_are_short_and_are_left_out_where_they_are_hardly_shorter():
    long = SharedRuns.of(solver_of(lag_problem(samples=2000), long_record=800))
    assert long is not None
    assert [level.samples for level in long.levels] == [
        2000,
        pytest.approx(400, rel=0.1),
        pytest.approx(100, rel=0.1),
    ]
    assert SharedRuns.of(solver_of(lag_problem(samples=80))) is None
    several = solver_of(lag_problem(0, 60) + lag_problem(1, 60))
    assert several.on_excerpts(30).samples > 60
    assert SharedRuns.of(several) is None


def test_predictors_are_run_on_whole_records():
    problem = lag_problem(samples=400).with_(criterion=gb.PredictionError(inputs="held"))
    assert SharedRuns.of(solver_of(problem)) is None


def test_the_answer_is_the_same_on_a_worker(solver, starts):
    here = multistart(solver.nlp, solver, starts)
    with ThreadPoolExecutor(1) as executor:
        there = multistart(solver.nlp, solver, starts, executor=executor)
    assert here.converged == len(here.runs)
    assert_array_equal(there.runs.cost, here.runs.cost)
    assert_array_equal(there.runs.estimate, here.runs.estimate)
    assert_array_equal(there.runs.iterations, here.runs.iterations)


class Kept(KeptRuns):
    """In memory, those of some numbers alone."""

    def __init__(self, before):
        self.before, self.made = before, {}

    def known(self, fingerprint):
        return self.before

    def add(self, number, start, outcome):
        self.made[number] = (start, outcome)

    def look(self):
        """Write nothing."""


def test_a_search_that_goes_on_ends_bit_for_bit_where_it_would_have(solver, starts):
    kept = Kept({})
    whole = multistart(solver.nlp, solver, starts, kept=kept)
    assert sorted(kept.made) == [*range(len(starts))]
    rest = {
        number: kept.made[number] for number in (0, 3)
    }  # the run on the whole record was that of another start
    later = multistart(solver.nlp, solver, starts, kept=Kept(rest))
    assert_array_equal(later.runs.cost, whole.runs.cost)
    assert_array_equal(later.runs.estimate, whole.runs.estimate)
    assert_array_equal(later.minima[0].estimate, whole.minima[0].estimate)


def test_a_search_runs_its_first_start_alone_and_starts_of_ones_own_as_they_are(
    solver, starts, monkeypatch
):
    by = []
    for kind in (GaussNewton, SharedRuns):
        monkeypatch.setattr(
            kind,
            "run_together",
            lambda self, points: by.append(type(self)) or [self.run(points[0])],
        )
    many = multistart(solver.nlp, solver, starts)
    assert by == [GaussNewton, *[SharedRuns] * 3]
    one = multistart(solver.nlp, solver, starts[:1])
    assert (many.runs[0].cost, many.runs[0].iterations) == (
        one.runs[0].cost,
        one.runs[0].iterations,
    )
    by.clear()
    multistart(solver.nlp, solver, starts[:2], movable=False)
    assert by == [GaussNewton] * 2


def test_a_run_counts_the_iterations_of_its_whole_way(solver, starts, monkeypatch):
    shared, spent = SharedRuns.of(solver), []
    for level in shared.levels:

        def counting(z, run_from=level.run_from, **near):
            outcome, hessian = run_from(z, **near)
            spent.append(outcome.iterations)
            return outcome, hessian

        monkeypatch.setattr(level, "run_from", counting)
    outcome = shared.run(starts[1])
    assert len(spent) == len(shared.levels) == 2
    assert min(spent) > 0
    assert outcome.iterations == sum(spent)
    assert shared.run(starts[1]).iterations == sum(spent[:2])
