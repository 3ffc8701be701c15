"""The run of Gauss-Newton around its iteration: excerpts of long records, and the second attempt of a stalled run."""

import math
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve import Strategies
from greybox.solve.gauss_newton.damping import after_failure
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.homotopy import Progress
from greybox.solve.minima import Minimum, Multistart
from greybox.solve.outcome import Outcome


class Lag(gb.StateSpace):
    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(1.0, bounds=(0.01, 50))

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.x),)

    def output(self, x, u, p):
        return (x.x,)


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
    response = gb.FrequencyResponse(omega, 1 / (1j * omega / 2.2 + 1) * np.array([1.02, 0.97 + 0.05j, 1.1]), "u", "x")
    problem = gb.Problem(Lag(), record(0), HELD) + gb.Problem(Lag(), response, gb.RelativeLikelihood())
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
        assert minimum.cost == pytest.approx(solver.cost(nlp.all_values(minimum.estimate)), rel=1e-12)
        h = 1e-3 * minimum.estimate
        around = [solver.cost(nlp.all_values(minimum.estimate + step)) for step in (-h, h)]
        assert min(around) > minimum.cost
        assert around[0] - minimum.cost == pytest.approx(around[1] - minimum.cost, rel=0.02)


# --- decisions of the iteration, of steps and iterates that are stated ------------------------------------------------

SETTINGS = Strategies()


def deciding(*, continuous=True, explained=True, undamped=None):
    """A solver whose iterates are as stated, and whose undamped step is."""
    solver = object.__new__(GaussNewton)
    solver._settings = SETTINGS
    solver._is_discontinuous = np.array([False, True])
    solver._parts = SimpleNamespace(is_continuous=lambda _: continuous, explain_data=lambda _: explained)
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
def test_little_is_left_to_gain_also_without_damping(before, decrease, damping, undamped, continuous, settled):
    small = max(SETTINGS.tolerance, SETTINGS.cost_rounding * abs(before))
    progress = stage(damping=damping)
    solver = deciding(continuous=continuous, undamped=step(undamped * progress.undamped_decrease))
    assert solver._is_settled(None, step(decrease * small), before, progress, states_only=False) is settled
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
    unfinished = Outcome(np.array([1.0]), "iterations exceeded", 7, 1.5, False, 10.0, nodes=(np.zeros((1, 1)),))
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
