"""Programs whose operating points Newton's method finds: their explicit form and its
derivatives, by differences. Programs that problems with other data share.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled import response_programs
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.modeling.formulation.frequency_criteria import total
from greybox.modeling.formulation.included_criteria import CRITERIA
from greybox.modeling.one_thread import Stored

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Drag(gb.StateSpace):
    """A mass with quadratic drag in a steady wind: the force that holds its speed follows from
    both.
    """

    states, inputs, outputs = ("v",), ("F",), ("v",)
    c = gb.Parameter(0.4, bounds=(0.1, 5))
    m = gb.Parameter(2.0, bounds=(0.5, 9))
    w = gb.Parameter(0.3, bounds=(-3, 3))

    def derivative(self, x, u, p):
        v = x.v - p.w
        return ((u.F - p.c * v * gb.sqrt(v**2 + 1)) / p.m,)

    def output(self, x, u, p):
        return (x.v,)


def response(force, seed):
    omega, random = np.array([0.3, 1.0, 4.0]), np.random.default_rng(seed)
    values = (0.5 + 0.1 * random.normal(size=3)) / (1 + 1j * omega)
    return gb.Problem(
        Drag(),
        gb.FrequencyResponse(omega, values, "F", "v"),
        gb.SquaredRelativeError(),
        at={"F": force},
    )


def test_an_explicit_program_at_its_roots_is_the_program_and_has_its_derivatives():
    """Two operating points, one of them of a parameter of its own and of another weight; two
    constraints.
    """
    second = response(5.0, 2).with_(
        rename={"w": "w2"}, weight=0.4, constraints=[lambda p: p.c * p.m**2 - p.w]
    )
    problem = response(2.0, 1).with_(constraints=[lambda p: p.m - p.c**2]) + second
    nlp = compile_problem(problem)
    [program] = nlp.programs
    assert program.explicit is not None
    assert program.roots is not None
    z = nlp.scaling.to_solver(np.array([0.7, 1.6, 0.4, -0.2]))
    assert nlp.free == ("c", "m", "w", "w2")

    def whole(v):
        return np.concatenate(
            [value.full().ravel() for value in nlp.programs[-1].function(v, 0.0, nlp.data)]
        )

    assert_allclose(
        np.concatenate(
            [
                v.full().ravel()
                for v in program.explicit(z, 0.0, nlp.data, program.roots(z, nlp.data))
            ]
        ),
        whole(z),
    )
    x = nlp.scaling.to_parameters(z)
    assert_allclose(whole(z)[1:], [1.6 - 0.7**2, 0.7 * 1.6**2 + 0.2], rtol=1e-9)
    assert whole(z)[0] == sum(
        nlp.parts[k].weight * nlp.responses(x[:, None], nlp.data)[0][k, 0] for k in (0, 1)
    )

    slopes = numeric_jacobian(whole, z)
    multipliers = np.array([1.7, 0.6, -0.9])
    wanted = numeric_jacobian(lambda v: multipliers @ numeric_jacobian(whole, v, 1e-3), z, 1e-3)
    x = ca.MX.sym("x", z.size)
    stacked = ca.vertcat(*nlp.programs[-1].function(x, 0.0, nlp.data))
    hessian, _ = ca.hessian(ca.dot(multipliers, stacked), x)
    found, curvature = ca.Function("d", [x], [ca.jacobian(stacked, x), hessian])(z)
    assert_allclose(found.full(), slopes, rtol=1e-6, atol=1e-8)
    assert_allclose(curvature.full(), wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())


# --- problems of the same formulas share their programs


def answers(problem):
    fit = gb.fit(problem, starts=2, progress=False)
    values = [fit.cost, *fit.estimate.values(), *fit.standard_error.values()]
    return [value.hex() for value in values]


def lag_response(seed, **columns):
    values = {"K": 2.0 + seed, "T": 0.5}
    return measured(Lag(), TWO_LAGS_OMEGA, values, noise=0.05, seed=seed, columns=columns)


@pytest.fixture
def store(monkeypatch):
    stored = Stored(16)
    monkeypatch.setattr(response_programs, "_stored", stored)
    return stored


def held(store):
    """Count the results of all threads."""
    return sum(map(len, store._results.values()))


@pytest.mark.parametrize("criterion", CRITERIA, ids=repr)
def test_problems_with_other_data_share_a_program_and_have_the_answers_they_have_alone(
    criterion, store
):
    """Also the last one, whose search follows several others with the same solvers."""
    count = len(TWO_LAGS_OMEGA)
    members = [
        gb.Problem(
            Lag(),
            lag_response(
                seed,
                variance=np.linspace(0.1, 0.2 + 0.01 * seed, count),
                coherence=np.linspace(0.5, 0.9 + 0.01 * seed, count),
            ),
            criterion,
        )
        for seed in range(3)
    ]
    together = [answers(member) for member in members]
    assert (
        compile_problem(members[0]).programs[-1].function
        is compile_problem(members[2]).programs[-1].function
    )
    assert held(store) == 1
    for member, found in zip(members, together, strict=True):
        store._results.clear()
        assert found == answers(member)


class Changing(gb.TransferFunction):
    """A lag of an order that its user changes."""

    order = 1
    T = gb.Parameter(0.5, bounds=(0.01, 10))

    def response(self, s, p):
        return 1 / (p.T * s + 1) ** self.order


class ChangingPower(gb.SquaredRelativeError):
    """Errors to a power that its user changes."""

    exponents: ClassVar = [2]

    def cost(self, model, data, smoothing=0.0):
        return total(abs((model - data.response) / np.abs(data.response)) ** self.exponents[0])


def test_what_a_user_changes_is_compiled_again(store):
    model = Changing()
    problem = gb.Problem(model, lag_response(1), ChangingPower())

    def cost(problem):
        nlp = compile_problem(problem)
        value, _ = nlp.programs[-1].function(nlp.scaling.to_solver(np.array([0.7])), 0.0, nlp.data)
        return float(value)

    def errors(order):
        response = 1 / (0.7j * TWO_LAGS_OMEGA + 1) ** order
        return np.abs(response / problem.response.response - 1)

    assert cost(problem) == cost(problem) == pytest.approx(np.sum(errors(1) ** 2))
    assert cost(problem.with_(weight=2.0)) == pytest.approx(2 * np.sum(errors(1) ** 2))
    model.order = 3
    assert cost(problem) == pytest.approx(np.sum(errors(3) ** 2))
    problem.criterion.exponents[0] = 4
    assert cost(problem) == pytest.approx(np.sum(errors(3) ** 4))
    assert held(store) == 4


def test_few_programs_are_stored(store):
    for count in range(4, 24):
        compile_problem(gb.Problem(Lag(), measured(Lag(), TWO_LAGS_OMEGA[:count])))
    assert held(store) == 16


def test_threads_share_no_program(store):
    problem = gb.Problem(Lag(), lag_response(1))
    with ThreadPoolExecutor(1) as other:
        theirs = other.submit(compile_problem, problem).result()
    assert theirs.programs[-1].function is not compile_problem(problem).programs[-1].function
