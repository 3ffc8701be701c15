"""The run of Gauss-Newton around its iteration.

Excerpts of long records, and the second attempt of a stalled run.
"""

import time
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from rate_lag import Lag
from slow_lag import SlowLag

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.segmented_part import SegmentedPart
from greybox.engine.compiled.segments import Segments
from greybox.engine.covariance.covariance import informations
from greybox.engine.solve.gauss_newton import driver
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.gauss_newton.settings import Settings
from greybox.engine.solve.minima import Minimum, Multistart
from greybox.engine.solve.runs import Runs

pytestmark = pytest.mark.usefixtures("unjudged_file")


def record(seed, samples=300):
    random = np.random.default_rng(seed)
    time = 0.05 * np.arange(samples)
    u = np.repeat(random.normal(size=samples // 10), 10)
    flown = gb.simulate(Lag(), {"a": 2.0}, gb.Record(time, {"u": u}), inputs="held")
    return gb.Record(time, {"u": u, "x": flown["x"] + 0.05 * random.normal(size=samples)})


HELD = gb.OutputError(inputs="held")


def test_a_polished_minimum_is_the_same_to_ten_digits_wherever_it_began():
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
        minimum = Minimum(solver.profile(a).cost, a, (0,), 1)
        search = Multistart(Runs.of(()), (minimum,), nodes=(first.nodes, second.nodes))
        found.append(solver.polished(search).minima[0])
    # Eleven digits on every processor: what is left of gaps, less than rounding, ends no steps.
    assert found[0].estimate == pytest.approx(found[1].estimate, rel=1e-10)
    assert found[0].estimate == pytest.approx(outcome.estimate, rel=1e-4)
    for minimum in found:
        assert minimum.cost == pytest.approx(solver.profile(minimum.estimate).cost, rel=1e-12)
        h = 1e-3 * minimum.estimate
        around = [solver.profile(minimum.estimate + step).cost for step in (-h, h)]
        assert min(around) > minimum.cost
        assert around[0] - minimum.cost == pytest.approx(around[1] - minimum.cost, rel=0.02)


def linearized(monkeypatch, samples):
    """Return a list of the samples of every linearization from now on; excerpts have these."""
    counted = []

    def linearize(part, *arguments):
        counted.append(part.samples)
        return SegmentedPart.linearize(part, *arguments)

    monkeypatch.setattr(driver, "EXCERPT", samples)
    monkeypatch.setattr(RecordPart, "linearize", linearize)
    return counted


def test_a_run_of_a_long_record_begins_where_excerpts_lead(monkeypatch):
    solver = GaussNewton(compile_problem(gb.Problem(Lag(), record(0), HELD)))
    counted = linearized(monkeypatch, 300)
    usual = solver.run(np.array([10.0]))
    steps = len(counted)
    counted.clear()
    monkeypatch.setattr(driver, "EXCERPT", 60)
    outcome = GaussNewton(solver.nlp).run(np.array([10.0]))
    assert outcome.converged
    assert outcome.estimate == pytest.approx(usual.estimate, rel=1e-6)
    assert counted.count(300) < steps
    assert {*counted} == {100, 300}


def test_starts_that_meet_at_a_minimum_of_the_excerpts_continue_once(monkeypatch):
    solver = GaussNewton(compile_problem(gb.Problem(Lag(), record(0), HELD)))
    counted = linearized(monkeypatch, 60)
    first = solver.run(np.array([10.0]))
    assert 300 in counted
    counted.clear()
    again = solver.run(np.array([0.5]))
    assert {*counted} == {100}
    assert again.converged
    assert_allclose(again.estimate, first.estimate, rtol=1e-9)
    assert again.cost == first.cost


def test_the_standard_errors_take_the_linearization_of_the_polished_minimum(monkeypatch):
    nlp = compile_problem(gb.Problem(Lag(), record(2), HELD))
    solver = GaussNewton(nlp)
    outcome = solver.run(np.array([1.0]))
    minimum = Minimum(outcome.cost, outcome.estimate, (0,), 1)
    search = solver.polished(Multistart(Runs.of(()), (minimum,), nodes=outcome.nodes))
    best = search.minima[0].estimate
    trajectories = solver.profile(best, search.nodes).trajectories
    computed = []

    def linearize(segments, *arguments):
        computed.append(segments.count)
        return Segments.linearize(segments, *arguments)

    monkeypatch.setattr(
        nlp.parts[0].segments, "linearize", partial(linearize, nlp.parts[0].segments)
    )
    (information,) = informations(nlp, best, trajectories)
    assert not computed
    others = solver.profile(best.copy(), search.nodes).trajectories
    (another,) = informations(nlp, best, others)
    assert computed
    assert_allclose(information.jacobian, another.jacobian, rtol=1e-9)


def test_excerpts_without_the_manoeuvre_do_not_mislead_a_run(monkeypatch):
    """The input moves between two of the five excerpts."""
    flown = record(0)
    u = np.where((np.arange(300) > 92) & (np.arange(300) < 110), flown["u"], 0.0)
    free = gb.simulate(Lag(), {"a": 2.0}, gb.Record(flown.time, {"u": u}), inputs="held")
    noise = 0.05 * np.random.default_rng(1).normal(size=300)
    still = gb.Record(flown.time, {"u": u, "x": free["x"] + noise})
    solver = GaussNewton(compile_problem(gb.Problem(Lag(), still, HELD)))
    usual = solver.run(np.array([1.0]))
    counted = linearized(monkeypatch, 60)
    outcome = GaussNewton(solver.nlp).run(np.array([1.0]))
    assert {*counted} == {100, 300}
    assert outcome.estimate == pytest.approx(usual.estimate, rel=1e-6)
    assert outcome.cost == pytest.approx(usual.cost, rel=1e-9)


def test_an_unfinished_run_is_continued_to_its_minimum():
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    unfinished = GaussNewton(nlp, settings=Settings(max_iter=2)).run(np.array([20.0]))
    assert unfinished.status == "iterations exceeded"
    outcome = solver.continued(unfinished)
    assert outcome.converged
    assert outcome.estimate == pytest.approx(solver.run(np.array([1.0])).estimate, rel=1e-5)
    assert outcome.iterations > unfinished.iterations >= 2
    assert outcome.seconds > unfinished.seconds
    nowhere = replace(unfinished, nodes=None)
    assert solver.continued(nowhere) is nowhere


def test_seconds_are_those_of_the_run():
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver, began = GaussNewton(nlp), time.perf_counter()
    first = solver.run(np.array([1.0]))
    again = solver.near(first.estimate, first.nodes)
    for outcome in (first, again):
        assert outcome.converged
        assert 0 < outcome.seconds <= time.perf_counter() - began
        assert outcome.cost == pytest.approx(first.cost, rel=1e-9)
    assert again.iterations <= first.iterations


@pytest.mark.parametrize(
    ("change", "kept"), [(0.0, True), (-1e-3, True), (-1.0, False), (1e-3, False)]
)
def test_what_leads_to_another_cost_has_left_the_minimum(change, kept):
    nlp = compile_problem(gb.Problem(Lag(), record(0), HELD))
    solver = GaussNewton(nlp)
    outcome = solver.run(np.array([1.0]))
    best = Minimum(outcome.cost - change, outcome.estimate, (0,), 1)
    polished = solver.polished(Multistart(Runs.of(()), (best,), nodes=outcome.nodes))
    (minimum,) = polished.minima
    assert (minimum is not best) == kept
    assert minimum.cost == (
        pytest.approx(min(best.cost, outcome.cost), abs=1e-6) if kept else best.cost
    )


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
    """The solver that they were asked of keeps its own limits."""
    nlp = compile_problem(gb.Problem(Gain(), record(0), HELD))
    solver = GaussNewton(nlp)
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
    again = solver.run(np.array([1.0, 1.0]))
    assert_allclose(again.estimate, free.estimate, rtol=1e-12)


def test_states_are_smoothed_at_given_parameters_where_the_model_is_finite():
    """Of a lag that is twice too slow the nodes stay at the outputs.

    Of the true one they are nearly continuous.
    """
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
    polished = solver.polished(Multistart(Runs.of(()), (best, *others), nodes=outcome.nodes))
    assert polished.minima[1:] == others
    assert polished.minima[0] is not best
    nothing = Multistart(Runs.of(()), ())
    assert solver.polished(nothing) is nothing


def test_another_value_of_what_is_fixed_is_refused():
    problem = gb.Problem(Gain(), record(0), HELD, fixed={"b": 2.0})
    assert np.isfinite(gb.cost(problem, {"a": 2.0, "b": 2.0}))
    with pytest.raises(
        ValueError, match=r"b is fixed at 2 here: give 2\.5 to the problem, fixed=\{'b': \.\.\.\}\."
    ):
        gb.cost(problem, {"a": 2.0, "b": 2.5})


@pytest.mark.parametrize("seed", [7, 13])
def test_a_run_that_still_converges_is_not_ended(seed):
    """Its last decrease is within noise, but far more than the next: the minimum is one step off.

    Of these four runs one ended 0.08 and 0.04 standard errors away, others of 60 draws at a second
    minimum.
    """
    random = np.random.default_rng(seed)
    t = 0.05 * np.arange(300)
    u = np.repeat(np.sign(random.normal(size=20)), 15)
    truth = {"K": 2.0, "tau": 5.0}
    flown = gb.simulate(SlowLag(), truth, gb.Record(t, {"u": u}), initial={"x": 0.0}, inputs="held")
    measured = flown["y"] + 0.03 * random.normal(size=300)
    problem = gb.Problem(SlowLag(), gb.Record(t, {"u": u, "y": measured}), HELD)
    fit = gb.fit(problem, starts=4, progress=False, profiles=False)
    assert len(fit.minima) == 1
    assert fit.agreeing == 4
    errors = np.array([fit.standard_error[name] for name in fit.free])
    ends = (fit.runs.estimate - fit.runs[0].estimate) / errors
    assert np.abs(ends).max() < 1e-3


class Arm(gb.StateSpace):
    """A propeller at the end of an arm that hangs on a hinge."""

    states, inputs, outputs = ("theta", "omega", "f"), ("u",), ("theta",)
    d = gb.Parameter(0.01, bounds=(0, 1))
    w = gb.Parameter(0.5, bounds=(0, 10))
    k = gb.Parameter(1.0, bounds=(0, 20))
    T = gb.Parameter(0.05, bounds=(0.005, 1))

    def derivative(self, x, u, p):
        moment = p.k * x.f - p.d * x.omega - p.w * gb.sin(x.theta)
        return x.omega, moment / 0.0184, (u.u - x.f) / p.T

    def output(self, x, u, p):
        return (x.theta,)


def test_a_run_that_has_just_closed_its_gaps_is_not_ended_by_noise():
    """Residuals with gaps show nothing of what is left to gain without them: here 2.7 units."""
    time = np.arange(0, 6, 0.02)
    u = np.where(time < 3, 0.42, 0.1) + 0.05 * np.sin(9 * time)
    truth = {"d": 0.031, "w": 0.62, "k": 1.35, "T": 0.07}
    noise = np.random.default_rng(1).normal(size=90 + time.size)[90:]
    theta = gb.simulate(Arm(), truth, gb.Record(time, {"u": u}))["theta"] + 0.01 * noise
    problem = gb.Problem(Arm(), gb.Record(time, {"u": u, "theta": theta}, hold={"u": 0.0}))
    far = {"d": 0.409949589, "w": 9.64120219, "k": 17.1530975, "T": 0.665444132}
    near, other = (gb.fit(problem, [start], progress=False) for start in (truth, far))
    assert_allclose(other.cost, near.cost, atol=1e-6)


class Reactors(gb.StateSpace):
    """A cascade of stirred reactors with recycle, a reaction of second order in each."""

    states = tuple(f"c{k}" for k in range(10))
    inputs, outputs = ("feed",), ("last", "first")
    flow = gb.Parameter(0.5, bounds=(0.01, 10), unit="1/s")
    rate = gb.Parameter(0.05, bounds=(0, 5))
    gain = gb.Parameter(1.3, bounds=(0.1, 10))
    recycle = gb.Parameter(0.1, bounds=(0, 2), unit="1/s")

    def derivative(self, x, u, p):
        c = [getattr(x, name) for name in self.states]
        inflow = [p.flow * p.gain * u.feed + p.recycle * c[-1]]
        inflow += [(p.flow + p.recycle) * before for before in c[:-1]]
        return tuple(
            i - (p.flow + p.recycle) * own - p.rate * own**2
            for i, own in zip(inflow, c, strict=True)
        )

    def output(self, x, u, p):
        return x.c9, x.c0


def test_initial_states_that_outputs_hardly_show_do_not_creep():
    """They are held where they begin: otherwise the run does not converge in 2000 iterations."""
    random = np.random.default_rng(0)
    feed = np.repeat(random.choice([0.0, 1.0, 2.0], 10), 10)
    truth = {"flow": 0.8, "rate": 0.15, "gain": 1.0, "recycle": 0.3}
    time = np.arange(100.0)
    exact = gb.simulate(Reactors(), truth, gb.Record(time, {"feed": feed}))
    noise = 0.01 * random.normal(size=(2, 100))
    outputs = {name: exact[name] + e for name, e in zip(Reactors.outputs, noise, strict=True)}
    fit = gb.fit(
        gb.Problem(Reactors(), gb.Record(time, {"feed": feed, **outputs})), starts=1, profiles=False
    )
    assert fit.converged
    assert fit.runs[0].iterations < 100
    for name, value in truth.items():
        assert abs(fit.estimate[name] - value) < 3.5 * fit.standard_error[name]


class HeatedRod(gb.StateSpace):
    """Ten cells with losses, heated at one end; two are measured."""

    states = tuple(f"T{k}" for k in range(10))
    inputs, outputs = ("power",), ("T0", "T9")
    k = gb.Parameter(2.0, bounds=(0.1, 20))
    h = gb.Parameter(0.02, bounds=(1e-4, 1))
    b = gb.Parameter(0.75, bounds=(0.05, 5))

    def derivative(self, x, u, p):
        T = [x[name] for name in self.states]
        wide = zip([T[0], *T[:-1]], T, [*T[1:], T[-1]], strict=True)
        rates = [p.k * (left - 2 * here + right) - p.h * here for left, here, right in wide]
        return (rates[0] + p.b * u.power, *rates[1:])

    def output(self, x, u, p):
        return (x.T0, x.T9)


def test_a_run_begins_with_a_simulation_that_explains_more_than_nodes_from_the_data():
    """Eight of ten states are not measured: their nodes from the data are far from the model's."""
    random = np.random.default_rng(0)
    inputs = gb.Record(np.arange(50.0), {"power": np.repeat(random.choice([0, 1, 2.0], 5), 10)})
    truth = {"k": 2.5, "h": 0.03, "b": 0.6}
    initial = dict.fromkeys(HeatedRod.states, 0.0)
    exact = gb.simulate(HeatedRod(), truth, inputs, initial=initial)
    signals = {name: exact[name] + 0.02 * random.normal(size=50) for name in HeatedRod.outputs}
    record = gb.Record(inputs.time, {"power": inputs["power"], **signals})
    problem = gb.Problem(HeatedRod(), record, gb.OutputError(initial=initial))
    outcome = GaussNewton(compile_problem(problem)).run(np.array([2.0, 0.02, 0.75]))
    assert outcome.converged
    assert_allclose(outcome.estimate, [*truth.values()], rtol=0.05)
    # From nodes of the data, it takes nine.
    assert outcome.iterations <= 7
