"""A root is infinitely steep at zero: a search that reaches this bound must be able to leave it."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import greybox as gb

POWERS = {"sqrt": 0.5, "guarded": 0.5, "power": 0.7}


def model(kind, states):
    root = {
        "sqrt": gb.sqrt,
        "guarded": lambda q: gb.sqrt(gb.maximum(q, 0)),
        "power": lambda q: q**0.7,
    }[kind]

    class Lag(gb.StateSpace):
        states = outputs = ("y",)
        inputs = ("u",)
        k = gb.Parameter(1.0, bounds=(0, 20))
        q = gb.Parameter(1.0, bounds=(0, 5))

        def derivative(self, x, u, p):
            return (p.k * u.u - x.y + root(p.q),)

        def output(self, x, u, p):
            return (x.y,)

    class Static(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        k = gb.Parameter(1.0, bounds=(0, 20))
        q = gb.Parameter(1.0, bounds=(0, 5))

        def output(self, x, u, p):
            return (p.k * u.u + root(p.q),)

    return Lag() if states else Static()


def fit_and_reference(kind, states, root):
    """A fit to data with k = 2 and this value of the root, and what SciPy finds for k and root."""
    time = np.arange(100) * 0.1
    u = (np.sin(time) > 0) * 1.0
    columns = np.column_stack([u, np.ones(100)])
    if states:  # a held input: exact
        for k in range(2):
            y = np.zeros(100)
            for n in range(99):
                y[n + 1] = np.exp(-0.1) * y[n] + (1 - np.exp(-0.1)) * columns[n, k]
            columns[:, k] = y
    y = columns @ [2.0, root] + 0.01 * np.random.default_rng(4).normal(size=100)
    record = gb.Record(time, {"u": u, "y": y}, hold={"u": np.inf})
    criterion = gb.OutputError(initial={"y": 0.0}) if states else gb.OutputError()
    problem = gb.Problem(model(kind, states), record, criterion)
    fit = gb.fit(problem, starts=4, seed=0, progress=False)
    found = least_squares(lambda b: columns @ b - y, [1.0, 1.0], bounds=([0, 0], [20, 5]))
    return fit, found.x


@pytest.mark.parametrize(
    ("kind", "states"), [("sqrt", True), ("sqrt", False), ("guarded", False), ("power", True)]
)
@pytest.mark.parametrize("q", [0.01, 0.1])
def test_a_search_leaves_the_bound_at_which_a_root_is_infinitely_steep(kind, states, q):
    fit, (k, root) = fit_and_reference(kind, states, q ** POWERS[kind])
    assert fit.agreeing == 4
    assert fit.estimate["k"] == pytest.approx(k, rel=1e-4)
    assert fit.estimate["q"] == pytest.approx(root ** (1 / POWERS[kind]), rel=1e-3)
    assert fit.at_bound == ()


def test_a_root_of_zero_is_at_its_bound():
    fit, (k, _) = fit_and_reference("sqrt", False, -0.1)
    assert fit.at_bound == ("q",)
    assert fit.estimate["q"] == pytest.approx(0, abs=1e-7)
    assert fit.estimate["k"] == pytest.approx(k, rel=1e-3)
