"""Solvers of users: they find what the included ones find, and a false one never wins."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from declared_models import LagLagDelay
from numpy.testing import assert_allclose
from recipes import Slsqp
from sampled_lag import SampledLag, lag_problem, lag_record
from scipy.optimize import least_squares

import greybox as gb
from greybox.problems import pitch_hover

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(0.3, 30, 12)
QUIET = {"profiles": False, "progress": False}


@dataclass(frozen=True)
class LeastSquares(gb.Solver):
    """SciPy's trust regions on the residuals."""

    def solve(self, objective, start):
        bounds = objective.lower, objective.upper
        inside = np.clip(start, bounds[0] + 1e-9, bounds[1] - 1e-9)
        end = least_squares(objective.residuals, inside, objective.jacobian, bounds=bounds)
        return gb.Solution(end.x, end.message, end.nfev)


@dataclass(frozen=True)
class Ending(gb.Solver):
    """Ends at once: at the start, or what `kind` says, and calls it a success."""

    kind: str = "start"

    def solve(self, objective, start):
        if self.kind == "error":
            raise ArithmeticError("no solution today")
        if self.kind == "middle":  # between the bounds
            return gb.Solution((objective.lower + objective.upper) / 2, "success")
        ends = {
            "start": start,
            "NaN": np.full(len(start), math.nan),
            "corner": np.where(np.isfinite(objective.upper), objective.upper, 1.0),
            "far outside": start + 1e6,
        }
        return gb.Solution(ends[self.kind], "success", 1)


@dataclass(frozen=True)
class Untyped(gb.Solver):
    """Returns a vector."""

    def solve(self, objective, start):
        return start


@dataclass(frozen=True)
class Short(gb.Solver):
    """Returns too few values."""

    def solve(self, objective, start):
        return gb.Solution(start[:1])


@dataclass(frozen=True)
class ToSaddle(gb.Solver):
    """Ends where the two lags are equal: the best of such points is a saddle."""

    def solve(self, objective, start):
        def joined(free):
            return np.array([free[0], free[1], free[1], free[2]])

        def slope(free):
            by = objective.gradient(joined(free))
            return np.array([by[0], by[1] + by[2], by[3]])

        from scipy.optimize import minimize

        bounds = [*zip(objective.lower[[0, 1, 3]], objective.upper[[0, 1, 3]], strict=True)]
        end = minimize(
            lambda free: objective.value(joined(free)),
            start[[0, 1, 3]],
            jac=slope,
            bounds=bounds,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 300},
        )
        return gb.Solution(joined(end.x), "success", end.nit)


def lags(T1=0.5, T2=0.1, **options):
    model = gb.frequency_response(LagLagDelay(), {"K": 2.0, "T1": T1, "T2": T2}, OMEGA)
    random = np.random.default_rng(0)
    noise = 0.02 * (random.normal(size=12) + 1j * random.normal(size=12))
    variance = 2 * np.abs(0.02 * model.response) ** 2
    data = gb.FrequencyResponse(OMEGA, model.response * (1 + noise), "u", "y", variance=variance)
    # From a gain of zero, where other starts lead, no other parameter has an effect.
    near = {"K": (0.5, 4), "T1": (0.05, 1), "T2": (0.05, 1), "tau": (0, 0.05)}
    return gb.Problem(LagLagDelay(), data, gb.MaximumLikelihood(), starts=near, **options)


def lag_response():
    model = gb.frequency_response(SampledLag(), {"K": 2.0, "T": 0.3}, OMEGA)
    noise = 0.02 * np.random.default_rng(1).normal(size=(2, 12))
    return gb.FrequencyResponse(
        OMEGA, model.response * (1 + noise[0] + 1j * noise[1]), input="u", output="y"
    )


def both():
    """A record and a response together."""
    return lag_problem(samples=40) + gb.Problem(SampledLag(), lag_response())


PROBLEMS = {
    "a response": pitch_hover.problem,
    "a response with given variances": lags,
    "a record": lambda: lag_problem(samples=40),
    "a response and a record": both,
}


def require_same(fit, included):
    assert fit.converged
    assert fit.agreeing >= 2
    assert fit.cost == pytest.approx(included.cost, rel=1e-9)
    for name in fit.free:
        error = included.standard_error[name]
        assert fit.estimate[name] == pytest.approx(included.estimate[name], abs=1e-3 * error)
        assert fit.standard_error[name] == pytest.approx(error, rel=1e-3)


@pytest.mark.parametrize("name", PROBLEMS)
def test_it_finds_what_the_included_solver_finds(name):
    problem = PROBLEMS[name]()
    require_same(gb.fit(problem, 3, search=Slsqp(), **QUIET), gb.fit(problem, 3, **QUIET))


def test_least_squares_on_the_residuals():
    for problem in (lags(), lag_problem(samples=40, noise={"y": 0.02})):
        fit = gb.fit(problem, 3, search=LeastSquares(), **QUIET)
        require_same(fit, gb.fit(problem, 3, **QUIET))


def test_by_default_its_starts_are_those_of_the_included_solver():
    fit = gb.fit(pitch_hover.problem(), search=Slsqp(), progress=False)
    assert fit.agreeing >= 3
    assert fit.cost == pytest.approx(pitch_hover.minimum, rel=1e-6)


@pytest.mark.parametrize("kind", ["start", "NaN", "corner", "far outside", "middle", "error"])
@pytest.mark.parametrize("name", ["a response with given variances", "a record"])
def test_a_false_solver_never_wins(name, kind):
    problem = PROBLEMS[name]()
    if kind == "error":
        with pytest.raises(ArithmeticError, match="no solution today"):
            gb.fit(problem, 4, search=Ending(kind), **QUIET)
        return
    fit = gb.fit(problem, 4, search=Ending(kind), **QUIET)
    assert not fit.converged
    assert not fit.runs.converged.any()
    assert all(math.isnan(value) for value in fit.estimate.values() if value not in (0.0, 0.02))


def test_a_solver_that_fails_from_some_starts():
    @dataclass(frozen=True)
    class Moody(gb.Solver):
        def solve(self, objective, start):
            if start[0] > 1:
                raise ArithmeticError("not from there")
            return Slsqp().solve(objective, start)

    starts = [{"K": 1.0, "T": 1.0}, {"K": 9.9, "T": 1.0}, {"K": 1.5, "T": 0.5}]
    problem = gb.Problem(SampledLag(), lag_record(samples=60), starts={"K": (0.1, 1.6)})
    fit = gb.fit(problem, starts, search=Moody(), **QUIET)
    assert fit.converged
    assert [*fit.runs.converged] == [True, False, True]
    assert "not from there" in fit.runs[1].status


def test_a_saddle_is_no_minimum():
    problem = lags()
    search = ToSaddle()
    fit = gb.fit(problem, 6, search=search, **QUIET)
    included = gb.fit(problem, 6, **QUIET)
    objective = gb.objective(problem).scaled
    end = search.solve(objective, objective.to_scaled([2.0, 0.3, 0.3, 0.01])).estimate
    assert np.linalg.norm(objective.gradient(end)) < 1e-3 * abs(objective.value(end))
    assert objective.value(end) > included.cost + 10
    assert not any(run.converged and run.cost > included.cost + 1 for run in fit.runs)


@pytest.mark.parametrize(
    ("search", "error", "text"),
    [
        (Untyped(), TypeError, "greybox.Solution"),
        (Short(), ValueError, "1 values: give the 4"),
        ("newton", ValueError, "'batched', 'multistart'"),
        (Slsqp, ValueError, "an instance"),
    ],
    ids=["no solution", "too few values", "a word", "a class"],
)
def test_what_is_refused(search, error, text):
    with pytest.raises(error, match=text):
        gb.fit(lags(), 3, search=search, **QUIET)


def test_options_are_fields_of_the_solver():
    with pytest.raises(ValueError, match=r"max_iter are those of the included .* Slsqp"):
        gb.fit(lags(), 3, search=Slsqp(), solver_options={"max_iter": 5}, **QUIET)
    short = gb.fit(lags(), 3, search=Slsqp(most=1), **QUIET)
    assert not short.converged


def test_constraints():
    problem = lags(constraints=[lambda p: p.T2 - 0.15, lambda p: p.T1 - p.T2])
    included = gb.fit(problem, 8, **QUIET)
    fit = gb.fit(problem, 8, search=Slsqp(), **QUIET)
    assert fit.converged
    assert fit.estimate["T2"] == pytest.approx(0.15, abs=1e-6)
    # IPOPT's barrier holds it off the constraint by a relative 1e-8.
    assert fit.cost == pytest.approx(included.cost, rel=1e-5)
    with pytest.raises(ValueError, match=r"LeastSquares takes no constraints.*takes_constraints"):
        gb.fit(problem, 8, search=LeastSquares(), **QUIET)


def test_workers_and_studies_make_the_same_runs(tmp_path):
    problem = lag_problem(samples=20)
    alone = gb.fit(problem, 2, search=Slsqp(), **QUIET)
    with gb.solve.WorkerPool(1) as workers:
        together = gb.fit(problem, 2, search=Slsqp(), executor=workers, **QUIET)
    members = [
        gb.study.Member(problem, 2, search=Slsqp(), name="tight"),
        gb.study.Member(problem, 2, search=Slsqp(most=2), name="short"),
    ]
    study = gb.batch(members, tmp_path, progress=False)
    again = gb.batch(members, tmp_path, progress=False)
    for fit in (together, study["tight"].fit, again["tight"].fit):
        assert fit.cost == alone.cost
        assert_allclose(fit.runs.estimate, alone.runs.estimate, rtol=0)
    assert study["short"].fit is None or not study["short"].fit.converged
