"""What a fixed-step integrator does to an estimate is seen, also where it feigns knowledge."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hard_models import Swing, stiff_lag, swung
from numpy.testing import assert_allclose
from rate_lag import Lag
from scipy.optimize import least_squares

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.discretization_error import (
    DiscretizationError,
    _in_standard_errors,
    _is_rounding,
    _widened,
    discretization_error,
    quadratic_model,
    refine_discretization,
    with_finer_steps,
    without_aliases,
)
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.minima import Minimum, Multistart
from greybox.engine.solve.runs import TOO_COARSE, Outcome, Run, Runs

pytestmark = pytest.mark.usefixtures("unjudged_file")

COARSE = gb.MultipleShooting(integrator=gb.RungeKutta(1))


def test_a_rate_at_the_limit_of_stability_is_not_believed():
    """The data hold nothing of k.

    Runge-Kutta steps of 2.78 / k would determine it to 0.2 %, whatever their length.
    """
    fit = gb.fit(stiff_lag(), starts=1, progress=False, profiles=False)
    believed = fit.standard_error["k"] < 0.05 * fit.estimate["k"]
    assert not believed or any("integration is too coarse" in warning for warning in fit.warnings)


def test_a_short_record_has_the_estimate_of_an_exact_integration():
    """Thirty samples, 0.7 time constants apart; SciPy with the solution of the equation."""
    time = np.linspace(0, 10, 30)
    u = np.repeat([1.0, 2, 0, -1, 1, 0, 2, -1, 0, 1], 3)

    def exact(K, tau):
        x = [0.0]
        for value in u[:-1]:
            x.append(K * value + math.exp(-time[1] / tau) * (x[-1] - K * value))
        return np.array(x)

    class FirstOrder(gb.StateSpace):
        states, inputs, outputs = ("x",), ("u",), ("y",)
        K = gb.Parameter(1.5, bounds=(0.1, 10))
        tau = gb.Parameter(0.8, bounds=(0.05, 10))

        def derivative(self, x, u, p):
            return ((p.K * u.u - x.x) / p.tau,)

        def output(self, x, u, p):
            return (x.x,)

    y = exact(2.0, 0.5) + 0.05 * np.random.default_rng(0).normal(size=30)
    record = gb.Record(time, {"u": u, "y": y}, hold={"u": math.inf})
    fit = gb.fit(gb.Problem(FirstOrder(), record, gb.OutputError(initial={"x": 0.0})), starts=1)
    reference = least_squares(lambda p: exact(*p) - y, [2.0, 0.5], "3-point", xtol=1e-15).x
    assert_allclose([fit.estimate["K"], fit.estimate["tau"]], reference, rtol=1e-6)


def test_many_states_are_integrated_as_finely_as_is_cheap():
    """Ten modes of a beam: what exact steps would need costs more than they are allowed."""
    order = np.arange(1, 11)
    shape = {"y1": np.sin(order), "y2": np.sin(2.4 * order)}

    class Beam(gb.StateSpace):
        states = (*(f"q{k}" for k in order), *(f"v{k}" for k in order))
        inputs, outputs = ("F",), tuple(shape)
        w = gb.Parameter(3.1, bounds=(2, 5), unit="rad/s")
        z = gb.Parameter(0.012, bounds=(0.001, 0.1))

        def derivative(self, x, u, p):
            pole = [p.w * float(k) ** 1.1 for k in order]
            q, v = ([getattr(x, f"{name}{k}") for k in order] for name in "qv")
            forces = (
                5 * u.F - w**2 * a - 2 * p.z * w * b for w, a, b in zip(pole, q, v, strict=True)
            )
            return (*v, *forces)

        def output(self, x, u, p):
            q = [getattr(x, f"q{k}") for k in order]
            return tuple(
                sum(float(c) * a for c, a in zip(row, q, strict=True)) for row in shape.values()
            )

    time = np.arange(0, 10, 0.05)  # s
    random = np.random.default_rng(0)
    force = gb.Record(time, {"F": np.repeat(random.normal(size=40), 5)}, hold={"F": math.inf})
    motion = gb.simulate(Beam(), {"w": 3.0, "z": 0.01}, force)
    noisy = {name: motion[name] + 0.01 * random.normal(size=200) for name in shape}
    rest = gb.OutputError(initial=dict.fromkeys(Beam.states, 0.0))
    problem = gb.Problem(Beam(), force.with_signals(**noisy), rest)
    fine = gb.MultipleShooting(integrator=gb.RungeKutta(16))
    usual, exact = (gb.fit(problem, starts=1, method=method) for method in (None, fine))
    shift = [(usual.estimate[n] - exact.estimate[n]) / exact.standard_error[n] for n in "wz"]
    assert_allclose(shift, 0, atol=2e-3)


def test_runs_and_minima_tell_the_same_when_substeps_were_refined():
    """What the fit says of its runs is what a fit with as many substeps from the start says."""
    problem = gb.Problem(Swing(), swung(n=200), gb.OutputError(inputs="held"))
    starts = [{"k1": 90, "k2": 20}, {"k1": 95, "k2": 25, "c": 1.0}]
    fit = gb.fit(problem, starts=starts, progress=False, profiles=False)
    count = int(fit.records[0].method.split("RK4, ")[1].split()[0])
    method = gb.MultipleShooting(integrator=gb.RungeKutta(count))
    fixed, coarse = (
        gb.fit(problem, starts=starts, progress=False, profiles=False, method=m)
        for m in (method, COARSE)
    )
    assert abs(fixed.cost - coarse.cost) > 0.05  # the refinement did change the cost
    costs = [fit.runs[m.runs[0]].cost for m in fit.minima]
    assert costs == pytest.approx([m.cost for m in fit.minima], abs=1e-6)  # the best is polished
    assert costs[0] == pytest.approx(fit.cost, abs=1e-6)
    assert len(fit.minima[0].runs) == 2
    for run, other in zip(fit.runs, fixed.runs, strict=True):
        assert run.cost == pytest.approx(other.cost, abs=1e-5)
        assert_allclose(run.estimate, other.estimate, rtol=1e-5)


def coarse_warnings(record, integrator=None):
    method = gb.MultipleShooting(integrator=integrator or gb.RungeKutta())
    problem = gb.Problem(Swing(), record, gb.OutputError(inputs="held"))
    fit = gb.fit(problem, starts=1, progress=False, profiles=False, method=method)
    return [w for w in fit.warnings if "integration is too coarse" in w]


PROPOSED = re.compile(r"RungeKutta\(substeps=(\d+)")


@pytest.mark.parametrize("few", [2, 5])
def test_the_numbers_of_substeps_that_are_proposed_lead_to_enough(few):
    record, tried = swung(), [few]
    while said := coarse_warnings(record, gb.RungeKutta(tried[-1])):
        tried.append(int(PROPOSED.search(said[0])[1]))
    assert 2 <= len(tried) <= 3
    assert tried[-1] <= 64


def test_where_the_cap_is_reached_the_proposed_number_of_substeps_is_enough():
    """With hardly any noise, the number of substeps that the warning proposes is enough."""
    record = swung(step=1.6, noise=1e-8, n=20)
    (said,) = coarse_warnings(record)
    assert "Radau()" in said
    assert not coarse_warnings(record, gb.RungeKutta(int(PROPOSED.search(said)[1])))


def made_run(index, x, cost, converged=True):
    return Run(
        index,
        np.zeros(2),
        np.array(x, dtype=float),
        cost,
        "converged" if converged else "x",
        converged,
        3,
        0.1,
    )


# A problem whose variables are those of the solver.
PLAIN = SimpleNamespace(
    scaling=SimpleNamespace(to_solver=np.asarray),
    parts=[SimpleNamespace(is_likelihood=True)],
)


def test_a_step_in_standard_errors_leaves_out_what_the_data_do_not_determine():
    """-H⁻¹ g over the roots of the diagonal of H⁻¹, in any units."""
    hessian, change = np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([2.0, -3.0])
    inverse = np.linalg.inv(hessian)
    wanted = -(inverse @ change) / np.sqrt(np.diag(inverse))
    assert_allclose(_in_standard_errors(hessian, change), wanted)
    units = np.array([1e4, 1e-5])
    assert_allclose(_in_standard_errors(hessian * units * units[:, None], change * units), wanted)
    assert_allclose(_in_standard_errors(np.diag([4.0, 0.0]), np.array([2.0, 0.0])), [-1.0, 0.0])
    both = _in_standard_errors(
        np.ones((2, 2)), np.array([2.0, 2.0])
    )  # of which the sum alone is determined
    assert_allclose(both, [-2.0, -2.0])
    assert np.isinf(_in_standard_errors(hessian, np.array([np.inf, 0.0]))).all()


def test_errors_that_finer_steps_widen_or_narrow_count():
    widened = _widened(np.diag([4.0, 4.0, 0.0, 1.0]), np.diag([9.0, 1.0, 1.0, -1.0]))
    assert_allclose(widened[:3], [0.5, 1.0, 0.0])
    assert widened[3] > 1e9  # what finer steps no longer determine
    error = DiscretizationError(np.array([0.2, -0.8]), 4)
    assert error.largest == 0.8
    assert error.matters
    assert error.growth == 2  # 16 times as small
    assert not DiscretizationError(np.array([0.1, -0.08]), 4).matters
    assert DiscretizationError(np.zeros(0), 4).largest == 0


class Solver:
    """Ends where each start leads; the first component is the cost there."""

    nlp = PLAIN

    def __init__(self, ends):
        self.ends, self.asked, self.begun = ends, [], []

    def near(self, start, nodes=None):
        self.asked.append(float(start[0]))
        self.begun.append(nodes)
        cost = self.ends.get(float(start[0]), math.inf)
        converged = math.isfinite(cost)
        signature, nodes = np.array([cost]), (np.full((1, 1), cost),)
        return Outcome(start + 0.5, "moved", 2, 0.0, converged, cost, signature, nodes)

    def profile(self, x, nodes=None):
        trajectory = SimpleNamespace(nodes=np.full((1, 1), x[0]), moves=x[0] in self.ends)
        return SimpleNamespace(trajectories=(trajectory,), converged=True)


def search_of(*minima):
    """Runs and minima from lists of (first component, cost)."""
    runs, found = [], []
    for some in minima:
        members = [made_run(len(runs) + k, (x, 1.0), cost) for k, (x, cost) in enumerate(some)]
        found.append(
            Minimum(
                members[0].cost, members[0].estimate, tuple(run.index for run in members), len(some)
            )
        )
        runs += members
    runs.append(made_run(len(runs), (99.0, 1.0), 0.0, converged=False))
    return Multistart(Runs.of(runs), tuple(found), nodes=(np.zeros((1, 1)),))


def test_rivals_move_to_finer_steps_with_their_runs_and_may_change_places():
    search = search_of(
        [(1.0, 10.0), (1.001, 10.0), (2.0, 10.0)], [(3.0, 12.0)], [(4.0, 20.1)], [(5.0, 30.0)]
    )
    solver = Solver({1.0: 14.0, 2.0: 14.5, 3.0: 11.0})
    found = with_finer_steps(search, solver)
    assert solver.asked == [1.0, 2.0, 3.0]  # those of one end together, and none that is no rival
    assert solver.begun == [search.nodes, None, None]  # the states of the best run alone are known
    assert [run.cost for run in found.runs] == [14.0, 14.0, 14.5, 11.0, 20.1, 30.0, 0.0]
    assert [run.status for run in found.runs[:4]] == ["moved"] * 4
    assert [float(run.estimate[0]) for run in found.runs[:5]] == [1.5, 1.5, 2.5, 3.5, 4.0]
    assert [m.cost for m in found.minima] == [11.0, 14.0, 14.5, 20.1, 30.0]
    assert [m.runs for m in found.minima] == [(3,), (0, 1), (2,), (4,), (5,)]
    assert found.nodes[0].item() == 11.0


@pytest.mark.parametrize(("shift", "keeps"), [(0.05, True), (50.0, False)])
def test_states_of_coarse_steps_are_kept_where_their_error_does_not_matter(
    monkeypatch, shift, keeps
):
    """From states of much too coarse steps, a model with kinks ends in a worse minimum."""
    module = "greybox.engine.solve.discretization_error"
    errors = [DiscretizationError(np.array([size]), 4) for size in (shift, 0.0)]
    monkeypatch.setattr(f"{module}.discretization_error", lambda *_: errors.pop(0))
    monkeypatch.setattr(f"{module}._cheap_growth", lambda _, error: 2 if error.largest else 1)
    solver, search = Solver({1.0: 10.0}), search_of([(1.0, 10.0)])
    method = SimpleNamespace(scheme=SimpleNamespace(substeps=None))
    facts = {"substeps": 1, "method": method, "has_stable_steps": lambda *_: True}
    facts["refined"] = lambda _: solver.nlp
    solver.nlp = SimpleNamespace(**vars(PLAIN), **facts)
    solver.with_problem = lambda _: solver
    refine_discretization(search, solver)
    assert solver.begun == [search.nodes if keeps else None]


def test_what_is_no_rival_is_followed_where_all_that_are_end_above_it():
    search = search_of([(1.0, 10.0)], [(3.0, 21.0)], [(4.0, 22.0)])
    solver = Solver({1.0: 21.5, 3.0: 25.0})
    assert [m.cost for m in with_finer_steps(search, solver).minima] == [21.5, 22.0, 25.0]
    assert solver.asked == [1.0, 3.0]
    assert with_finer_steps(search, Solver({})) is None
    many = search_of(*[[(float(k), 10.0 + k / 10)] for k in range(1, 6)])
    solver = Solver({float(k): 10.0 + k / 10 for k in range(1, 6)})
    with_finer_steps(many, solver)
    assert solver.asked == [1.0, 2.0, 3.0]  # three at most


@pytest.mark.parametrize(
    ("aliases", "minima", "is_same"),
    [
        ((), [(0, 1, 2), (3,), (4,)], True),
        ((1.0,), [(2,), (3,), (4,)], False),  # with the run beside it
        ((2.0,), [(0, 1), (3,), (4,)], True),
        ((1.0, 2.0), [(3,), (4,)], False),
        ((1.0, 2.0, 3.0), [(0, 1, 2), (3,), (4,)], True),  # there is nothing else within ten
    ],
)
def test_aliases_of_the_integrator_are_no_minima_where_there_is_another(
    monkeypatch, aliases, minima, is_same
):
    search = search_of([(1.0, 10.0), (1.001, 10.0), (2.0, 10.2)], [(3.0, 12.0)], [(4.0, 20.1)])
    shift = {
        True: DiscretizationError(np.array([1.1]), 4),
        False: DiscretizationError(np.array([0.9]), 4),
    }
    monkeypatch.setattr(
        "greybox.engine.solve.discretization_error.discretization_error",
        lambda _, t: shift[t[0].moves],
    )
    found = without_aliases(search, Solver(dict.fromkeys(aliases, 0.0)))
    assert [m.runs for m in found.minima] == minima
    assert [m.cost for m in found.minima] == [found.runs[m.runs[0]].cost for m in found.minima]
    lost = {run.index for run in found.runs if run.status == TOO_COARSE}
    assert lost == ({0, 1, 2, 3, 4} - {k for m in minima for k in m})
    assert all(found.runs[k].converged for m in minima for k in m)
    assert found.nodes[0].item() == (0.0 if is_same else found.minima[0].estimate[0])
    if aliases == (1.0,):
        assert found.minima[0].variants == 1
        assert_allclose(found.minima[0].estimate, [2.0, 1.0])


def test_of_two_ends_one_may_be_an_alias(monkeypatch):
    search = search_of([(1.0, 10.0)], [(2.0, 10.2)])
    shift = {
        True: DiscretizationError(np.array([1.1]), 4),
        False: DiscretizationError(np.array([0.9]), 4),
    }
    monkeypatch.setattr(
        "greybox.engine.solve.discretization_error.discretization_error",
        lambda _, t: shift[t[0].moves],
    )
    found = without_aliases(search, Solver({1.0: 0.0}))
    assert [m.runs for m in found.minima] == [(1,)]
    assert found.nodes[0].item() == 2.0
    alone = search_of([(1.0, 10.0)], [(2.0, 20.5)])  # no rival: the only one is left
    assert without_aliases(alone, Solver({1.0: 0.0})) is alone


@pytest.mark.parametrize(
    ("moved", "is_rounding"),
    [
        ((1.9e-7, 0.0), True),
        ((2.1e-7, 0.0), False),
        ((0.0, -0.4e-7), True),
        ((0.0, -0.6e-7), False),
    ],
)
def test_what_finer_steps_change_in_the_eighth_digit_is_rounding(moved, is_rounding):
    """Of states that reach 2 and 0.5, each by itself."""
    nodes, ends = (
        np.array([[1.0, 0.1], [-2.0, 0.5], [0.5, -0.2]]),
        np.array([[3.0, 0.3], [1.0, 9.0], [0.0, 0.0]]),
    )
    coarse = SimpleNamespace(states=nodes.T, ends=ends)
    change = np.array([[0.0, 0.0], moved, [0.0, 0.0]])
    assert _is_rounding(coarse, SimpleNamespace(states=nodes.T, ends=ends + change)) is is_rounding
    assert (
        _is_rounding(coarse, SimpleNamespace(states=nodes.T + change.T, ends=ends)) is is_rounding
    )
    none = SimpleNamespace(states=np.zeros((0, 2)), ends=np.zeros((2, 0)))
    assert _is_rounding(none, none)
    still = SimpleNamespace(states=np.zeros((2, 3)), ends=ends)
    assert not _is_rounding(still, SimpleNamespace(states=np.zeros((2, 3)), ends=ends + 1e-12))


def decaying(seed, samples):
    random = np.random.default_rng(seed)
    time, u = 0.5 * np.arange(samples), np.repeat(random.normal(size=samples // 4), 4)
    flown = gb.simulate(Lag(), {"a": 1.6}, gb.Record(time, {"u": u}), inputs="held")
    return gb.Record(time, {"u": u, "x": flown["x"] + 0.1 * random.normal(size=samples)})


def test_derivatives_of_finer_steps_that_overflow_are_an_infinite_shift(monkeypatch):
    nlp = compile_problem(gb.Problem(Lag(), decaying(0, 60), gb.OutputError(inputs="held")), COARSE)
    solver = GaussNewton(nlp)

    def overflowing(part, *arguments):
        if part.substeps > 1:
            raise np.linalg.LinAlgError
        return quadratic_model(part, *arguments)

    monkeypatch.setattr("greybox.engine.solve.discretization_error.quadratic_model", overflowing)
    error = discretization_error(nlp, solver.profile(np.array([1.6])).trajectories)
    assert error.largest == np.inf


def test_the_shift_is_that_of_a_fit_with_twice_the_steps():
    """Of two records of unlike weights.

    A standard error is where the cost is half a unit higher.
    """
    held = gb.OutputError(inputs="held")
    problem = gb.Problem(Lag(), decaying(0, 60), held, weight=2.0) + gb.Problem(
        Lag(), decaying(1, 40), held, weight=5.0
    )
    nlp = compile_problem(problem, COARSE)
    solver = GaussNewton(nlp)
    end = solver.run(np.array([2.0]))
    error = discretization_error(nlp, solver.profile(end.estimate, end.nodes).trajectories)
    finer = GaussNewton(nlp.refined(2))
    moved = finer.run(end.estimate)
    away = 0.004
    heights = [solver.profile(end.estimate * (1 + sign * away)).cost - end.cost for sign in (1, -1)]
    standard_error = away * end.estimate[0] / np.sqrt(2 * np.mean(heights))
    wanted = (moved.estimate[0] - end.estimate[0]) / standard_error
    assert abs(wanted) > 0.1
    assert error.shift[0] == pytest.approx(wanted, rel=0.2)  # to first order
    assert error.order == 4
