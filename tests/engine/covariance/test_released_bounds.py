"""A parameter that noise puts at a bound does not make the others seem known."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.stats import t as student

import greybox as gb


class Plane(gb.StateSpace):
    """A static relation: y = a u + b w."""

    states = ()
    inputs = ("u", "w")
    outputs = ("y",)
    a = gb.Parameter(1.0, bounds=(-50, 50))
    b = gb.Parameter(1.0, bounds=(0, 50))
    derived = {"sum": lambda p: p.a + p.b, "double": lambda p: 2 * p.a}

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return (p.a * u.u + p.b * u.w,)


def plane(correlation, pushed=1.0, count=60, sigma=0.3):
    """Regressors (n, 2) and y (n,), of which least squares give b = -`pushed` standard errors."""
    random = np.random.default_rng(7)
    x, _ = np.linalg.qr(random.normal(size=(count, 3)))
    x, noise = x[:, :2], x[:, 2] * sigma * math.sqrt(count - 2)
    x = x @ np.linalg.cholesky(np.array([[1, correlation], [correlation, 1]])).T
    b = -pushed * sigma / math.sqrt(1 - correlation**2)
    return x, x @ [2.0, b] + noise


def fitted(x, y):
    record = gb.Record(
        np.arange(len(y), dtype=float), {"u": x[:, 0], "w": x[:, 1], "y": y}, has_time=False
    )
    return gb.fit(gb.Problem(Plane(), record, gb.OutputError()), starts=3, seed=1, progress=False)


def least_squares(x, y):
    """The estimate, its standard errors, and the sum of squares."""
    estimate, squares, *_ = np.linalg.lstsq(x, y, rcond=None)
    variance = squares[0] / (len(y) - x.shape[1])
    return estimate, np.sqrt(variance * np.diag(np.linalg.inv(x.T @ x))), squares[0]


@pytest.mark.parametrize("correlation", [0.95, 0.999, -0.999])
def test_errors_are_those_without_a_bound_that_would_hide_a_collinear_parameter(correlation):
    x, y = plane(correlation)
    fit = fitted(x, y)
    _, errors, _ = least_squares(x, y)
    assert fit.at_bound == ("b",)
    assert_allclose([fit.standard_error["a"], fit.standard_error["b"]], errors, rtol=0.05)
    assert_allclose(fit.standard_error["double"], 2 * errors[0], rtol=0.05)
    assert any("b ended at its lower bound 0" in w and "without" in w for w in fit.warnings)


def test_a_bound_that_hides_nothing_holds_its_parameter():
    x, y = plane(0.8)
    fit = fitted(x, y)
    _, errors, _ = least_squares(x[:, :1], y)
    assert fit.at_bound == ("b",)
    assert math.isnan(fit.standard_error["b"])
    assert fit.standard_error["a"] == pytest.approx(errors[0], rel=0.05)
    assert any("treat it as known there" in w for w in fit.warnings)


def test_collinear_parameters_are_named_together_and_are_not_well_determined():
    fit = fitted(*plane(0.9999))
    assert fit.standard_error["a"] > 5
    assert any("a and b are poorly identifiable" in w for w in fit.warnings)
    assert "0 are well determined" in str(fit)
    assert fit.identifiability.beyond == ("a",)
    # Their sum is known nearly as well as if one of them were.
    assert fit.standard_error["sum"] < 0.5


def test_a_direction_without_information_leaves_no_error_at_a_bound():
    """Equal columns: the bound decides how the sum is split."""
    x, y = plane(0.0)
    fit = fitted(x[:, [0, 0]], y - 3 * x[:, 0])
    assert fit.at_bound in {(), ("b",)}
    assert math.isnan(fit.standard_error["a"])
    assert math.isfinite(fit.standard_error["sum"])


def likelihood_interval(x, y, at):
    """95 % limits of a, with b at or above its bound, from the smallest sum of squares for each a."""
    _, _, squares = least_squares(x[:, :1], y)
    dof = len(y) - 2
    limit = squares * (1 + student.ppf(0.975, dof) ** 2 / dof)

    def excess(a):
        rest = y - a * x[:, 0]
        rest = rest - max(rest @ x[:, 1] / (x[:, 1] @ x[:, 1]), 0) * x[:, 1]
        return rest @ rest - limit

    return brentq(excess, at - 50, at), brentq(excess, at, at + 50)


def test_the_printed_interval_is_that_of_the_likelihood():
    x, y = plane(0.995)
    fit = fitted(x, y)
    expected = likelihood_interval(x, y, fit.estimate["a"])
    assert_allclose(fit.profiles["a"].interval, expected, rtol=0.05)
    assert f"{fit.profiles['a']}" in str(fit)


class Integrator(gb.StateSpace):
    states = outputs = ("x",)
    inputs = ("u", "w")
    a = gb.Parameter(1.0, bounds=(-50, 50))
    b = gb.Parameter(1.0, bounds=(0, 50))

    def derivative(self, x, u, p):
        return (p.a * u.u + p.b * u.w,)

    def output(self, x, u, p):
        return (x.x,)


def test_a_record_with_states_is_profiled_where_a_bound_hides_a_collinear_parameter():
    time = np.arange(100) * 0.1
    u = np.sin(time)
    w = u + 0.02 * np.cos(2.3 * time)
    # Held inputs, from x = 0: linear in both parameters.
    sums = 0.1 * np.cumsum([u, w], axis=1).T
    x = np.vstack([np.zeros((1, 2)), sums[:-1]])
    y = x @ [2.0, 0.0] + 0.05 * np.random.default_rng(5).normal(size=100)
    # Least squares give b = -1 standard error.
    estimate, errors, _ = least_squares(x, y)
    y -= x[:, 1] * (estimate[1] + errors[1])
    record = gb.Record(time, {"u": u, "w": w, "x": y}, hold={"u": np.inf, "w": np.inf})
    problem = gb.Problem(Integrator(), record, gb.OutputError(initial={"x": 0.0}))
    fit = gb.fit(problem, starts=2, seed=1, progress=False)
    assert fit.at_bound == ("b",)
    expected = likelihood_interval(x, y, fit.estimate["a"])
    assert_allclose(fit.profiles["a"].interval, expected, rtol=0.1)
    assert fit.standard_error["a"] > 5 * least_squares(x[:, :1], y)[1][0]
