"""The run of Gauss-Newton around its iteration: excerpts of long records, and the second attempt of a stalled run."""

import math
import time
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from hard_models import direct_delay
from numpy.testing import assert_allclose
from rate_lag import Lag

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve import Strategies
from greybox.solve.gauss_newton import driver
from greybox.solve.gauss_newton.damping import after_failure
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.homotopy import Progress
from greybox.solve.minima import Minimum, Multistart
from greybox.solve.outcome import Outcome


def record(seed, samples=300):
    random = np.random.default_rng(seed)
    time = 0.05 * np.arange(samples)
    u = np.repeat(random.normal(size=samples // 10), 10)
    flown = gb.simulate(Lag(), {"a": 2.0}, gb.Record(time, {"u": u}), inputs="held")
    return gb.Record(time, {"u": u, "x": flown["x"] + 0.05 * random.normal(size=samples)})


HELD = gb.OutputError(inputs="held")


def test_what_is_long_is_the_sum_of_all_records_and_each_is_first_solved_on_excerpts():
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD) + gb.Problem(Lag(), record(1), HELD))
    long = GaussNewton(nlp, settings=replace(nlp.strategies, long_record=400))
    assert long._coarse is not None
    (together,) = long._coarse._parts.parts  # half as many as are long, by each record's share
    assert [part.samples for part in together.parts] == pytest.approx([100, 100], rel=0.15)
    assert GaussNewton(nlp, settings=replace(nlp.strategies, long_record=700))._coarse is None


@pytest.mark.parametrize("status", ["converged", "stalled"])
def test_a_stalled_run_begins_once_more_near_the_data_with_what_is_left_of_its_iterations(status):
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    parts, seen = solver._parts, []

    def iterated(iterate, linearizations, progress, iterations, *, states_only):
        assert not states_only
        seen.append((iterate, iterations))
        first = len(seen) == 1
        lost = parts.at(iterate.z + 0.1, [nodes + 1.0 for nodes in iterate.nodes])
        return (lost, "stalled", 7) if first else (iterate, status, 3)

    solver._iterate = iterated
    outcome = solver.run(np.array([1.0]), 50)
    (begun, most), (again, left) = seen
    assert (most, left) == (50, 43)
    assert_allclose(again.z, begun.z + 0.1)
    assert_allclose(again.nodes[0], parts.from_data(again.z).nodes[0])
    assert (outcome.status, outcome.iterations) == (status, 10)
    assert_allclose(outcome.nodes[0] - again.nodes[0], 0 if status == "converged" else 1, atol=0.5)


def test_a_polished_minimum_is_the_same_to_nine_digits_wherever_it_began():
    """Of a record and a response, whose cost is told without what smooths it."""
    omega = np.array([0.5, 2.0, 8.0])
    response = gb.FrequencyResponse(
        omega, 1 / (1j * omega / 2.2 + 1) * np.array([1.02, 0.97 + 0.05j, 1.1]), "u", "x"
    )
    problem = gb.Problem(Lag(), record(0), HELD) + gb.Problem(
        Lag(), response, gb.RelativeLikelihood()
    )
    nlp = compile_problem(problem)
    solver = GaussNewton(nlp)
    outcome = solver.run(np.array([1.0]))
    assert outcome.converged
    found = []
    for error in (1e-5, -2e-5):
        a = outcome.estimate * (1 + error)
        (first, second) = solver.profile(a).trajectories
        minimum = Minimum(solver.cost(nlp.all_values(a)), a, (0,), 1)
        search = Multistart((), (minimum,), 0.0, nodes=(first.nodes, second.nodes))
        found.append(solver.polished(search).minima[0])
    assert found[0].estimate == pytest.approx(found[1].estimate, rel=1e-9)
    assert found[0].estimate == pytest.approx(outcome.estimate, rel=1e-4)
    for minimum in found:
        assert minimum.cost == pytest.approx(
            solver.cost(nlp.all_values(minimum.estimate)), rel=1e-12
        )
        h = 1e-3 * minimum.estimate
        around = [solver.cost(nlp.all_values(minimum.estimate + step)) for step in (-h, h)]
        assert min(around) > minimum.cost
        assert around[0] - minimum.cost == pytest.approx(around[1] - minimum.cost, rel=0.02)


# --- decisions of the iteration, of steps and iterates that are stated

SETTINGS = Strategies()


def deciding(*, continuous=True, explained=True, undamped=None):
    """A solver whose iterates are as stated, and whose undamped step is."""
    solver = object.__new__(GaussNewton)
    solver._settings = SETTINGS
    solver._is_discontinuous = np.array([False, True])
    solver._parts = SimpleNamespace(
        is_continuous=lambda _: continuous, explain_data=lambda _: explained
    )
    solver._undamped_step = lambda *_, **__: undamped
    return solver


def step(decrease, distance=0.0):
    return SimpleNamespace(decrease=decrease, distance=distance)


def stage(**values):
    progress = Progress.exact(SETTINGS)
    for name, value in values.items():
        setattr(progress, name, value)
    return progress


@pytest.mark.parametrize(
    ("factor", "last", "length", "damping", "continuous", "converged"),
    [
        (0.9, 1e-2, 1.0, 0.0, True, True),
        (1.1, 1e-2, 1.0, 0.0, True, False),
        (0.9, 1e-2, 1.0, 0.0, False, False),
        (0.9, 1e-2, 0.5, 0.0, True, False),
        (0.9, 1e-2, 1.0, 1e-3, True, False),
        (0.9, 1.1, 1.0, 0.0, True, False),  # far away nothing is extrapolated
        (0.9, math.nan, 1.0, 0.0, True, False),
    ],
)
@pytest.mark.parametrize("by_distance", [False, True])
def test_a_step_was_the_last_where_the_next_decrease_follows_from_two(
    factor, last, length, damping, continuous, converged, by_distance
):
    """Quadratic convergence: the decrease squared over the last one, of full undamped steps."""
    decrease = np.sqrt(SETTINGS.tolerance * factor * np.nan_to_num(last, nan=1.0))
    progress = stage(last_decrease=last, damping=damping)
    taken = step(0.1 * decrease, decrease) if by_distance else step(decrease, 0.1 * decrease)
    solver = deciding(continuous=continuous)
    assert bool(solver._has_converged(None, taken, progress, length)) is converged
    if length < 1 or damping:
        assert np.isnan(progress.last_decrease)
    else:
        assert progress.last_decrease == decrease


@pytest.mark.parametrize(
    ("before", "decrease", "damping", "undamped", "continuous", "settled"),
    [
        (1.0, 0.9, 0.0, 0.0, True, True),  # in units of what is small
        (1.0, 1.1, 0.0, 0.0, True, False),
        (-1e12, 0.9, 0.0, 0.0, True, True),
        (-1e12, 1.1, 0.0, 0.0, True, False),
        (1.0, 0.9, 0.0, 0.0, False, False),
        (1.0, 0.6, 1.0, 0.9, True, False),  # damping made it small
        (1.0, 0.4, 1.0, 0.9, True, True),
        (1.0, 0.4, 1.0, 1.1, True, False),
    ],
)
def test_little_is_left_to_gain_also_without_damping(
    before, decrease, damping, undamped, continuous, settled
):
    small = max(SETTINGS.tolerance, SETTINGS.cost_rounding * abs(before))
    progress = stage(damping=damping)
    solver = deciding(continuous=continuous, undamped=step(undamped * progress.undamped_decrease))
    assert (
        solver._is_settled(None, step(decrease * small), before, progress, states_only=False)
        is settled
    )
    relaxed = stage(damping=damping, gap_scale=0.5)
    assert not solver._is_settled(None, step(decrease * small), before, relaxed, states_only=False)


@pytest.mark.parametrize(
    ("distance", "decrease", "continuous", "explained", "hidden"),
    [
        (1e-3, 9e-3, True, True, True),  # of two unknowns: a hundredth of a unit of log-likelihood
        (1e-3, 1.1e-2, True, True, False),
        (4e-3, 9e-3, True, True, True),
        (5.1e-3, 1e-2, True, True, False),  # a tenth of a standard error
        (4.6e-3, 9e-3, True, True, False),  # no bound stops it
        (1e-3, 9e-3, False, True, False),
        (1e-3, 9e-3, True, False, False),
    ],
)
def test_noise_hides_what_bounds_leave_to_gain(distance, decrease, continuous, explained, hidden):
    solver = deciding(continuous=continuous, explained=explained, undamped=step(decrease, distance))
    iterate = SimpleNamespace(z=np.zeros(2))
    assert solver._is_within_noise(iterate, step(1.0), stage()) is hidden
    assert not solver._is_within_noise(iterate, step(1.0), stage(gap_scale=0.5))


def test_after_a_line_search_without_progress_damping_grows_and_then_delays_are_held():
    solver, iterate, trial = deciding(), object(), object()
    progress = stage()
    assert solver._recover(iterate, trial, 1.0, progress) is None
    assert progress.damping == 0
    assert solver._recover(iterate, None, 0.0, progress) is iterate
    assert progress.damping == after_failure(SETTINGS, 0.0) > 0
    progress.damping = SETTINGS.blocked_damping
    assert solver._recover(iterate, trial, 1.0, progress) is iterate
    assert (progress.delays_held, progress.damping) == (True, 0.0)
    progress.damping = max(SETTINGS.blocked_damping, 2 * SETTINGS.largest_damping)
    assert solver._recover(iterate, None, 0.0, progress) is None  # held already
    solver._is_discontinuous = np.zeros(2, dtype=bool)
    assert solver._recover(iterate, trial, 1.0, stage(damping=SETTINGS.blocked_damping)) is None


@pytest.mark.parametrize(("samples", "most"), [(1, 2000), (None, 2000), (10**9, 1)])
def test_a_run_goes_on_with_as_many_iterations_as_its_samples_allow(samples, most):
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    unfinished = Outcome(
        np.array([1.0]), "iterations exceeded", 7, 1.5, False, 10.0, nodes=(np.zeros((1, 1)),)
    )
    seen = []

    def solved(iterate, progress, iterations):
        seen.append(iterations)
        return replace(unfinished, cost=9.0 if len(seen) == 1 else 11.0, iterations=5, seconds=0.0)

    solver._at, solver._solve = (lambda *_: None), solved
    count = sum(part.samples for part in nlp.parts) if samples is None else samples
    solver._nlp = SimpleNamespace(parts=[SimpleNamespace(samples=count)])
    better, worse = solver.continued(unfinished), solver.continued(unfinished)
    wanted = max(1, min(SETTINGS.continued_samples // count, most))
    assert seen == [max(wanted, SETTINGS.max_iterations)] * 2
    assert (better.cost, worse.cost) == (9.0, 10.0)
    assert [found.iterations for found in (better, worse)] == [12, 12]
    assert all(1.5 <= found.seconds < 60 for found in (better, worse))
    nowhere = replace(unfinished, nodes=None)
    assert solver.continued(nowhere) is nowhere


def test_seconds_are_those_of_the_run():
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver, began = GaussNewton(nlp), time.perf_counter()
    first = solver.run(np.array([1.0]))
    again = solver.solved_from(first.estimate, first.nodes)
    simulated = solver.run_simulated(first.estimate, first.nodes, 20)
    for outcome in (first, again, simulated):
        assert outcome.converged
        assert 0 < outcome.seconds <= time.perf_counter() - began
        assert outcome.cost == pytest.approx(first.cost, rel=1e-9)
    assert again.iterations <= first.iterations


@pytest.mark.parametrize("before", [10.0, -10.0])
@pytest.mark.parametrize(
    ("promise", "length", "predicts", "done"),
    [
        (0.9, 1.0, False, True),  # in units of what a stage must promise to go on
        (1.1, 1.0, False, False),
        (1.1, 0.0, False, True),
        (1.1, 0.9 * SETTINGS.brief_step, False, False),
        (1.1, 0.9 * SETTINGS.brief_step, True, True),
        (1.1, 1.1 * SETTINGS.brief_step, True, False),
    ],
)
def test_a_stage_is_done_where_its_steps_promise_little_or_are_not_taken(
    before, promise, length, predicts, done
):
    solver, progress, iterate, seen = deciding(), stage(gap_scale=0.5, damping=0.1), object(), []
    solver._all_predict = predicts
    progress.advance = lambda *stated, done: seen.append((*stated, done))
    taken = step(promise * SETTINGS.kept_promise * abs(before))
    assert (
        solver._tighten(iterate, taken, progress, 3.0, length, before, states_only=False) is iterate
    )
    assert seen == [(iterate, taken, 3.0, length, done)]
    assert progress.damping == (0.1 if length else 0.0)


@pytest.mark.parametrize("states_only", [True, False])
def test_gains_are_chosen_once_continuity_is_exact(states_only):
    solver, progress = deciding(), stage(gap_scale=0.5)
    solver._all_predict = False
    progress.advance = lambda *_, **__: setattr(progress, "gap_scale", 0.0)
    solver._with_gains, solver._simulate_predictors = (
        (lambda at, _: f"{at}, gains"),
        (lambda at: f"{at}, simulated"),
    )
    found = solver._tighten("end", step(1.0), progress, 1.0, 1.0, 1.0, states_only=states_only)
    assert found == ("end, simulated" if states_only else "end, gains, simulated")


@pytest.mark.parametrize(("stable", "predicting"), [(True, True), (False, True), (False, False)])
def test_without_stable_gains_continuity_is_tightened_more_slowly(monkeypatch, stable, predicting):
    solver = deciding()
    solver._parts.at = lambda z, nodes: SimpleNamespace(z=z, nodes=nodes)
    monkeypatch.setattr(
        driver, "best_gains", lambda parts, iterate, variances: (iterate.z, variances)
    )
    monkeypatch.setattr(driver, "are_stable", lambda parts, iterate: stable)
    last = SETTINGS.prediction_gap if predicting else SETTINGS.last_gap
    progress = stage(last_scale=last, gap_variance="sizes")
    begun = SimpleNamespace(z="z", nodes="nodes")
    solver._has_free_gains = False
    assert solver._with_gains(begun, progress) is begun
    solver._has_free_gains = True
    found = solver._with_gains(begun, progress)
    assert (found.z, found.nodes) == (("z", "sizes"), "nodes")
    slower = (SETTINGS.gap_reduction, SETTINGS.last_gap)
    assert (progress.gap_scale, progress.last_scale) == (
        slower if predicting and not stable else (0.0, last)
    )


@pytest.mark.parametrize(("near", "stable"), [(True, True), (False, True), (True, False)])
def test_the_better_simulation_stands_in_for_steps_that_do_not_close_the_gaps(
    monkeypatch, near, stable
):
    """From where continuity became exact, or from the start; once in a run."""
    solver = deciding()
    monkeypatch.setattr(driver, "are_stable", lambda parts, iterate: stable)
    solver._parts = SimpleNamespace(
        simulated=lambda cost, nodes: SimpleNamespace(cost=cost, nodes=nodes),
        cost=lambda iterate: iterate.cost,
        stays_near_data=lambda iterate: near,
    )
    assert solver._simulate_instead(stage(start=(1.0, "start"))) is None
    for costs, wanted in (((2.0, 1.0), "start"), ((1.0, 2.0), "end")):
        start, multipliers = (costs[1], "start"), [np.ones(2)]
        progress = stage(
            homotopy_end=(costs[0], "end"), start=start, damping=0.5, last_decrease=1.0
        )
        progress.multipliers = multipliers
        found = solver._simulate_instead(progress)
        assert progress.homotopy_end is None
        if not near or not stable:
            assert found is None
            continue
        assert (found.cost, found.nodes) == (1.0, wanted)
        assert progress.damping == 0
        assert np.isnan(progress.last_decrease)
        assert_allclose(progress.multipliers[0], [0, 0])


def test_gaps_that_curvature_left_are_closed_until_there_are_none_or_all_is_lost():
    solver = deciding()
    solver._parts = SimpleNamespace(
        is_continuous=lambda iterate: iterate.left == 0,
        close_gaps=lambda iterate, *_: SimpleNamespace(
            left=iterate.left - 1, finite=iterate.left - 1 != iterate.lost
        ),
    )

    def left(gaps, lost=-1, finite=True):
        begun = SimpleNamespace(left=gaps, lost=lost, finite=finite)
        solver._parts.close_gaps = lambda iterate, *_: SimpleNamespace(
            left=iterate.left - 1, lost=lost, finite=iterate.left - 1 != lost
        )
        return solver._continuous(begun, step(1.0), stage()).left

    most = SETTINGS.gap_closings
    assert [left(0), left(2), left(most), left(most + 2)] == [0, 0, 0, 2]
    assert left(3, finite=False) == 3
    assert left(4, lost=2) == 2


class Iterated:
    """An iteration over iterates that are numbers, whose merit is their magnitude, by stated steps and trials."""

    def __init__(self, monkeypatch, trials, *, decreases, settled=False, **progress):
        self.curvatures, self.ratios, self.weights, self.looked, self.tightened = [], [], [], [], []
        solver = self.solver = deciding()
        solver._parts = SimpleNamespace(
            initial_weights=lambda: "initial",
            residual_weights=lambda iterate: "own",
            linearize=self.linearized,
        )
        solver._is_settled = lambda *_, **__: settled
        solver._is_within_noise = lambda iterate, taken, _: self.looked.append(iterate) or False
        solver._recover = lambda *_: None
        solver._simulate_predictors = lambda iterate: iterate
        solver._has_converged = lambda *_: False
        solver._tighten = self.tighten
        solver._step = lambda *_, **__: next(self.steps)
        self.steps = iter(decreases)
        self.trials = iter(trials)
        monkeypatch.setattr(driver, "merit_function", lambda parts, weights, progress: abs)
        monkeypatch.setattr(driver, "line_search", lambda *_: next(self.trials))
        monkeypatch.setattr(driver, "next_damping", self.damping_after)
        self.progress = stage(**progress)

    def linearized(self, iterate, weights, *, covariance_curvature):
        self.curvatures.append(bool(covariance_curvature))
        self.weights.append(weights)
        return ["linearized"]

    def damping_after(self, settings, damping, length, ratio, last_full):
        self.ratios.append(ratio)
        return damping

    def tighten(self, iterate, taken, progress, gained, length, before, *, states_only):
        self.tightened.append((iterate, gained, length, before))
        return iterate

    def run(self, iterations, begin=8.0):
        return self.solver._iterate(begin, None, self.progress, iterations, states_only=False)


def test_every_step_is_judged_by_what_it_gained_of_what_it_promised(monkeypatch):
    trials = [(-6.0, 1.0), (5.0, 0.5), (4.0, 1.0)]
    made = Iterated(monkeypatch, trials, decreases=[step(4.0), step(0.5), step(0.0)], damping=0.25)
    assert made.run(3) == (4.0, "iterations exceeded", 3)
    assert made.ratios == [0.5, 2.0, 1.0]
    assert made.weights == ["own"] * 3
    assert made.progress.full_damping == 0.25
    relaxed = Iterated(
        monkeypatch, [(6.0, 1.0), (None, 0.0)], decreases=[step(4.0), step(4.0)], gap_scale=0.5
    )
    before = relaxed.progress.full_damping
    assert relaxed.run(2) == (6.0, "iterations exceeded", 2)
    assert relaxed.tightened == [(6.0, 2.0, 1.0, 8.0), (6.0, 0.0, 0.0, 6.0)]
    assert relaxed.weights == ["initial"] * 2
    assert relaxed.progress.full_damping == before  # without damping there is none to go back to


@pytest.mark.parametrize(
    ("last", "near"), [(math.nan, False), (0.9, True), (1.1, False)]
)  # in units of the decrease below which the covariance follows
def test_the_hessian_accounts_for_an_estimated_covariance_near_the_end(monkeypatch, last, near):
    last *= SETTINGS.covariance_decrease
    made = Iterated(monkeypatch, [(6.0, 1.0)], decreases=[step(4.0)], last_decrease=last)
    made.run(1)
    assert made.curvatures == [near]
    made.solver._settings = replace(SETTINGS, covariance_curvature=False)
    made.steps, made.trials = iter([step(4.0)]), iter([(6.0, 1.0)])
    made.run(1)
    assert made.curvatures == [near, False]


def test_a_run_is_stalled_without_a_step_or_where_damping_has_grown_beyond_all(monkeypatch):
    most = SETTINGS.largest_damping
    for trial, damping, status in [
        ((None, 0.0), 0.0, "stalled"),
        ((6.0, 1.0), 2 * most, "stalled"),
        ((6.0, 1.0), most, "iterations exceeded"),
    ]:
        made = Iterated(monkeypatch, [trial], decreases=[step(4.0)], damping=damping)
        assert made.run(1)[1] == status
        relaxed = Iterated(
            monkeypatch, [trial], decreases=[step(4.0)], damping=damping, gap_scale=0.5
        )
        assert relaxed.run(1)[1] == "iterations exceeded"


@pytest.mark.parametrize(
    ("settled", "distance", "trial", "status"),
    [
        (True, 0.9, (7.9, 1.0), "converged"),  # in units of the tolerance
        (True, 1.1, (7.9, 1.0), "iterations exceeded"),
        (False, 0.9, (7.9, 1.0), "iterations exceeded"),
        (True, 900.0, (None, 0.0), "converged"),  # rounding of the merit
        (True, 1100.0, (None, 0.0), "stalled"),
        (False, 900.0, (None, 0.0), "stalled"),
    ],
)
def test_little_left_to_gain_by_a_short_step_is_the_end(
    monkeypatch, settled, distance, trial, status
):
    taken = step(1e-3, distance * SETTINGS.tolerance)
    made = Iterated(monkeypatch, [trial], decreases=[taken], settled=settled)
    assert made.run(1)[1] == status


def test_a_long_run_looks_every_fiftieth_time_whether_noise_hides_what_is_left(monkeypatch):
    made = Iterated(monkeypatch, [(8.0 - k, 1.0) for k in range(101)], decreases=[step(1.0)] * 101)
    made.run(101)
    assert made.looked == [8.0 - 48, 8.0 - 98]  # the iterates of steps 50 and 100


@pytest.mark.parametrize(
    ("violation", "stable", "cost", "status"),
    [
        (0.0, True, 3.0, "converged"),
        (1e-3, True, 3.0, "constraints violated"),
        (0.0, False, 3.0, "unstable predictor"),
        (0.0, True, math.inf, "converged"),
    ],
)
def test_an_end_is_an_answer_within_the_constraints_with_stable_predictors_and_a_finite_cost(
    monkeypatch, violation, stable, cost, status
):
    monkeypatch.setattr(driver, "are_stable", lambda *_: stable)
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    end = solver._parts.from_data(nlp.scaling.to_solver(np.array([60.0])))  # beyond its bound
    solver._descend = lambda *_, **__: (end, "converged", 5)
    monkeypatch.setattr(solver._parts, "cost", lambda iterate, smoothing: cost + smoothing)
    monkeypatch.setattr(type(solver._limits), "violation", lambda *_: violation)
    outcome = solver._solve(end, stage(), None)
    assert (outcome.status, outcome.converged) == (status, status == "converged" and cost == 3.0)
    assert (outcome.cost, outcome.iterations) == (cost, 5)
    assert outcome.estimate == pytest.approx([50.0], rel=1e-12)

    def singular(*_, **__):
        raise np.linalg.LinAlgError

    solver._descend = singular
    outcome = solver._solve(end, stage(), None)
    assert (outcome.status, outcome.converged, outcome.cost) == ("singular", False, math.inf)


@pytest.mark.parametrize(
    ("change", "kept"), [(0.0, True), (-1e-3, True), (-1.0, False), (1e-3, False)]
)
def test_what_leads_to_another_cost_has_left_the_minimum(change, kept):
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    outcome = solver.run(np.array([1.0]))
    best = Minimum(outcome.cost - change, outcome.estimate, (0,), 1)
    polished = solver.polished(Multistart((), (best,), 0.0, nodes=outcome.nodes))
    (minimum,) = polished.minima
    assert (minimum is not best) == kept
    assert minimum.cost == (
        pytest.approx(min(best.cost, outcome.cost), abs=1e-6) if kept else best.cost
    )


@pytest.mark.parametrize(
    ("decreases", "trials", "bound", "end"),
    [
        (
            [1.0, 1.0, 0.9],
            [1.0, 2.0],
            -1.0,
            2.0,
        ),  # in units of the tolerance, but for the first two
        ([1.0, 1.0], [1.0, None], -1.0, 1.0),
        ([1.0, 1.0], [1.0, -2.0], -1.0, 1.0),  # where a predictor is not stable
        ([1.0], [], 1e-3, 0.0),  # beyond a bound
    ],
)
def test_exact_steps_go_on_within_all_limits_as_long_as_they_are_taken(
    monkeypatch, decreases, trials, bound, end
):
    solver, left, waiting = deciding(), iter(decreases), iter(trials)
    solver._nlp = None
    solver._parts = SimpleNamespace(residual_weights=lambda _: None)
    solver._limits = SimpleNamespace(linearized=lambda z: (np.eye(1), np.array([bound])))
    solver._exact_step = lambda iterate, progress, first: first
    solver._continuous = lambda trial, taken, progress: trial

    def exact(nlp, parts, iterate, first):
        assert first == (iterate.z == 0)
        decrease = next(left)
        return SimpleNamespace(
            decrease=decrease if decrease == 1 else decrease * SETTINGS.tolerance, dz=np.zeros(1)
        )

    def searched(*_):
        z = next(waiting)
        return (None if z is None else SimpleNamespace(z=z)), 1.0

    monkeypatch.setattr(driver, "sharp_step", exact)
    monkeypatch.setattr(driver, "merit_function", lambda *_: lambda iterate: 0.0)
    monkeypatch.setattr(driver, "line_search", searched)
    monkeypatch.setattr(driver, "are_stable", lambda parts, iterate: iterate.z >= 0)
    assert solver._sharpened(SimpleNamespace(z=0.0)).z == end


def test_nodes_move_alone_as_long_as_a_run_begins_so(monkeypatch):
    made = Iterated(
        monkeypatch, [(7.0, 1.0), (6.0, 1.0)], decreases=[], gap_scale=0.5, state_iterations=1
    )
    alone = []

    def taken(iterate, linearizations, progress, *, states_only):
        alone.append(states_only)
        progress.state_iterations = 0
        return step(1.0)

    made.solver._step = taken
    made.run(2)
    assert alone == [True, False]


def test_where_short_steps_do_not_close_the_gaps_a_simulation_is_gone_on_from():
    solver, iterate, trial = deciding(), object(), object()
    solver._simulate_instead = lambda progress: "simulated"
    assert solver._recover(iterate, trial, 0.9 * SETTINGS.short_step, stage()) == "simulated"
    assert solver._recover(iterate, trial, 1.1 * SETTINGS.short_step, stage()) is None
    assert solver._recover(iterate, None, 0.0, stage()) is iterate  # more damping comes before
    assert (
        solver._recover(iterate, None, 0.0, stage(damping=2 * SETTINGS.largest_damping))
        == "simulated"
    )
    solver._simulate_instead = lambda progress: None
    assert solver._recover(iterate, trial, 0.0, stage()) is None


@pytest.mark.parametrize(
    ("status", "stable", "found"),
    [("converged", True, True), ("stalled", True, False), ("converged", False, False)],
)
def test_a_cost_at_given_parameters_is_that_of_the_best_nodes_or_unknown(
    monkeypatch, status, stable, found
):
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver, x = GaussNewton(nlp), np.array([2.0])
    cost = solver.cost(nlp.all_values(x))
    descend = solver._descend
    solver._descend = lambda *words, **more: (descend(*words, **more)[0], status, 1)
    monkeypatch.setattr(driver, "are_stable", lambda *_, **__: stable)
    profile = solver.profile(x)
    assert profile.converged is found
    assert profile.cost == pytest.approx(cost)
    assert solver.cost(nlp.all_values(x)) == pytest.approx(cost if found else np.nan, nan_ok=True)
    assert (solver.signature(x) is None) == (not found)


def test_delays_of_inputs_that_reach_an_output_directly_may_be_held():
    solver = GaussNewton(compile_problem(direct_delay()))
    jumping = {name for part in solver._parts.parts for name in part.discontinuous_delays}
    assert jumping == {"d"}
    assert dict(zip(solver._nlp.free, solver._is_discontinuous.tolist(), strict=True)) == {
        name: name == "d" for name in solver._nlp.free
    }


class Gain(gb.StateSpace):
    """A lag and a gain, whose product an equation may hold."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(1.0, bounds=(0.01, 50))
    b = gb.Parameter(1.0, bounds=(0.1, 30))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.a * x.x,)

    def output(self, x, u, p):
        return (x.x,)


def test_within_other_bounds_and_an_equation_runs_keep_to_them():
    """Also those on excerpts; the solver that they were asked of keeps its own."""
    nlp = compile_problem(gb.Problem(Gain(), record(0), HELD))
    for settings in (nlp.strategies, replace(nlp.strategies, long_record=200)):
        solver = GaussNewton(nlp, settings=settings)
        free = solver.run(np.array([1.0, 1.0]))
        low, high = solver.limits.low.copy(), solver.limits.high.copy()
        here = nlp.scaling.to_solver(free.estimate)
        high[0] = here[0] - 0.02
        bounded = solver.within(low, high)
        end = bounded.run(np.array([1.0, 1.0]))
        assert end.converged
        assert nlp.scaling.to_solver(end.estimate)[0] == pytest.approx(high[0], abs=1e-9)
        assert end.cost > free.cost
        z = ca.SX.sym("z", 2)
        sum_of = ca.Function("sum", [z], [z[0] + 2 * z[1] - (here[0] + 2 * here[1] + 0.03)])
        held = solver.within(solver.limits.low, solver.limits.high, sum_of)
        end = held.run(np.array([1.0, 1.0]))
        assert end.converged
        assert float(sum_of(nlp.scaling.to_solver(end.estimate))) == pytest.approx(0, abs=1e-7)
        assert solver.limits.high[0] > here[0]
        if solver._coarse is None:
            assert bounded._coarse is None
        else:
            assert bounded._coarse.limits.high[0] == high[0]
            assert held._coarse.limits.constraints.numel_out(0) == 2
            assert solver._coarse.limits.constraints.numel_out(0) == 0
        again = solver.run(np.array([1.0, 1.0]))
        assert_allclose(again.estimate, free.estimate, rtol=1e-12)


def test_an_iteration_without_nodes_is_exact_from_its_beginning():
    response = gb.FrequencyResponse(np.array([0.5, 2.0]), np.array([1.0, 0.5 - 0.5j]), "u", "x")
    assert not GaussNewton(compile_problem(gb.Problem(Lag(), record(0), HELD)))._progress().is_exact
    assert GaussNewton(compile_problem(gb.Problem(Lag(), response)))._progress().is_exact


def test_states_are_smoothed_at_given_parameters_where_the_model_is_finite():
    """Of a lag that is twice too slow the nodes stay at the outputs; of the true one they are nearly continuous."""
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    z = nlp.scaling.to_solver(np.array([1.0]))
    (smoothed,) = solver.smoothed(z)
    assert smoothed.finite
    (true,) = solver.smoothed(nlp.scaling.to_solver(np.array([2.0])))
    assert np.abs(true.gaps).max() < 0.15 < 0.5 * np.abs(smoothed.gaps).max()
    measured, _ = nlp.parts[0].at_nodes
    assert (
        np.sqrt(np.mean((smoothed.nodes.ravel() - measured.ravel()) ** 2))
        < 0.2
        < 0.5 * np.std(measured)
    )
    assert solver.smoothed(z * np.nan) is None


def test_other_minima_are_kept_when_the_best_is_polished():
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    outcome = solver.run(np.array([1.0]))
    others = tuple(Minimum(outcome.cost + k, outcome.estimate + k, (k,), 1) for k in (1, 2))
    best = Minimum(outcome.cost, outcome.estimate * (1 + 1e-6), (0,), 1)
    polished = solver.polished(Multistart((), (best, *others), 0.0, nodes=outcome.nodes))
    assert polished.minima[1:] == others
    assert polished.minima[0] is not best
    # The iterate of the polished minimum is known, with its own nodes alone.
    (minimum, *_), nodes = polished.minima, polished.nodes
    assert solver._at(minimum.estimate, nodes) is solver._polished[2]
    assert solver._at(minimum.estimate, outcome.nodes) is not solver._polished[2]
    assert solver._at(minimum.estimate * (1 + 1e-12), nodes) is not solver._polished[2]
    nothing = Multistart((), (), 0.0, nodes=outcome.nodes)
    assert solver.polished(nothing) is nothing


def test_another_value_of_what_is_fixed_is_refused():
    nlp = compile_problem(gb.Problem(Gain(), record(0), HELD, fixed={"b": 2.0}))
    solver = GaussNewton(nlp)
    assert np.isfinite(solver.cost(np.array([2.0, 2.0])))
    with pytest.raises(
        ValueError, match=r"b is fixed at 2 here: give 2\.5 to the problem, fixed=\{'b': \.\.\.\}\."
    ):
        solver.cost(np.array([2.0, 2.5]))
