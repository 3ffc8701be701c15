"""Problems of records with a quantity held: the equation that holds it, and minima against least squares."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.assessment.held_minima import (
    HeldMinima,
    NoProfileError,
    Point,
    slope_of,
    steep_equation,
)
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.runs import Outcome


def test_an_equation_is_as_steep_as_a_bound_is():
    z = ca.SX.sym("z", 2)
    quantity = ca.Function("q", [z], [3 * z[0] ** 2 + 4 * z[1]])
    at = np.array([1.0, 5.0])
    assert_allclose(slope_of(quantity, at), [6, 4])
    equation = steep_equation(quantity, at, 7.0)
    assert_allclose(slope_of(equation, at), np.array([6, 4]) / np.sqrt(52))
    assert float(equation([2.0, -0.5])) == pytest.approx((12 - 2 - 7) / np.sqrt(52))
    flat = ca.Function("q", [z], [0 * z[0] + 2])
    assert float(steep_equation(flat, at, 0.5)(at)) == pytest.approx(1.5)


class Filter(gb.StateSpace):
    """A lag with a known time constant: linear in its gain, offset and initial state."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    k = gb.Parameter(1.5, bounds=(-10, 10))
    c = gb.Parameter(0.3, bounds=(-10, 10))

    def derivative(self, x, u, p):
        return (2 * (p.k * u.u - x.x),)

    def output(self, x, u, p):
        return (x.x + p.c,)


@pytest.fixture(scope="module")
def held():
    time = 0.05 * np.arange(80)
    random = np.random.default_rng(0)
    u = np.repeat(random.normal(size=8), 10)
    exact = gb.simulate(Filter(), {}, gb.Record(time, {"u": u}), inputs="held", initial={"x": 0.7})[
        "y"
    ]
    record = gb.Record(time, {"u": u, "y": exact + 0.1 * random.normal(size=80)})
    nlp = compile_problem(
        gb.Problem(Filter(), record, gb.OutputError(noise={"y": 0.1}, inputs="held"))
    )
    decay = np.exp(-2 * time)
    through = gb.simulate(
        Filter(), {"k": 1.0, "c": 0.0}, gb.Record(time, {"u": u}), inputs="held", initial={"x": 0.0}
    )
    columns = np.column_stack([through["y"], np.ones(80), decay])
    best = np.linalg.lstsq(columns, record["y"], rcond=None)[0]
    return nlp, columns, record["y"], best, HeldMinima(nlp, best[:2])


def test_the_best_point_of_records_is_that_of_least_squares(held):
    _, columns, y, best, minima = held
    assert_allclose(minima.x, best[:2], rtol=1e-4)
    assert_allclose(minima.best.nodes[0][0, 0], best[2], rtol=1e-3)
    squares = np.sum((y - columns @ best) ** 2) / 0.01
    assert minima.best.cost == pytest.approx(
        0.5 * squares + 80 * np.log(0.1) + 40 * np.log(2 * np.pi), rel=1e-6
    )


def test_costs_with_a_parameter_or_a_quantity_held_rise_as_those_of_least_squares(held):
    nlp, columns, _, best, minima = held
    point, cost = minima.best, minima.best.cost

    def rise(constraint, value):
        """Of the cost, with a linear combination of gain and offset held."""
        row = np.array([*constraint, 0.0])
        inverse = np.linalg.inv(columns.T @ columns)
        return 0.5 * (value - row @ best) ** 2 / (row @ inverse @ row) / 0.01

    low, high = best[1] - 0.1, best[1] + 0.2
    for start, at in ((point, low), (Point(point.z), high)):
        end = minima.lowest(1, [start], at)
        assert end.cost - cost == pytest.approx(rise([0, 1], at), rel=1e-4)
        assert nlp.scaling.to_parameters(end.z)[1] == pytest.approx(at)
    z = ca.SX.sym("z", 2)
    k, c = nlp.scaling.expressions(z)
    total = best[0] + 3 * best[1] + 0.4
    end = minima.lowest(ca.Function("q", [z], [k + 3 * c]), [point], total)
    assert end.cost - cost == pytest.approx(rise([1, 3], total), rel=1e-4)
    assert nlp.scaling.to_parameters(end.z) @ [1, 3] == pytest.approx(total)


def test_where_no_minimum_is_found_again_there_is_an_error(held, monkeypatch):
    nlp = held[0]
    lost = Outcome(np.zeros(2), "iterations exceeded", 3, 0.1, converged=False)
    monkeypatch.setattr("greybox.assessment.held_minima.GaussNewton.near", lambda *_: lost)
    with pytest.raises(NoProfileError, match="from the estimate: iterations exceeded"):
        HeldMinima(nlp, held[3][:2])


def test_whole_numbers_as_bounds_hold_what_is_between_them(held):
    """The problem as its user wrote it, with bounds of -10 and 10."""
    problem = held[0].problem
    fit = gb.fit(problem, starts=[{}], progress=False)
    found = gb.profile(fit, "c", problem=problem)["c"].interval
    assert_allclose(found, fit.interval()["c"], rtol=0.01)
