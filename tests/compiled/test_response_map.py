"""Responses of many frequencies, mapped, against the same problems as one expression for all
frequencies.
"""

import pickle

import casadi as ca
import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled import response_programs
from greybox.compiled.compiled_problem import compile_problem
from greybox.models.tilt import LinearTilt

VARIANCE = np.geomspace(0.01, 0.1, TWO_LAGS_OMEGA.size)
CRITERIA = [
    gb.RelativeError(),
    gb.RelativeError("model"),
    gb.RelativeLikelihood(),  # the logarithm of a sum, which is no sum over the frequencies
    gb.MagnitudePhase(),
    gb.MaximumLikelihood(),
]


def two_parts(criterion=None):
    """Two responses that share a gain, with logarithmic scales, a tie and a constraint."""
    first, second = (
        measured(model, omega, values, noise=0.03, columns={"variance": VARIANCE[: omega.size]})
        for model, omega, values in (
            (LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS),
            (Lag(), TWO_LAGS_OMEGA[::2], {"K": 5.0, "T": 1.0}),
        )
    )
    tied = gb.Problem(
        LagLagDelay(),
        first,
        criterion,
        tied={"T2": lambda p: 2 * p.T1 * p.tau},
        constraints=[lambda p: p.T1 - p.tau**2],
        rename={"K": "gain"},
        weight=2.0,
    )
    return tied + gb.Problem(Lag(), second, criterion, rename={"T": "T_lag"})


def tilt():
    """A state space with a delay, at the hover; its constraint needs IPOPT."""
    values = {"a1": 2.0, "a2": 5.0, "a3": 1.0, "a4": 100.0}
    return gb.Problem(
        LinearTilt(),
        measured(LinearTilt(), np.geomspace(1, 40, 20), values, noise=0.02, output="theta"),
        constraints=[lambda p: p.a2 - p.a1**2],
    )


@pytest.fixture
def as_large(monkeypatch):
    """Take every response for a large one."""
    monkeypatch.setattr(response_programs, "LARGE", 0)


def hessian(nlp, z, smoothing, multipliers):
    """The Hessian of the Lagrangian of an expression, by CasADi."""
    x = ca.SX.sym("x", z.size)
    f, g = nlp.program(x, smoothing, nlp.data)
    whole = ca.hessian(1.7 * f + ca.dot(g, multipliers), x)[0]
    return np.triu(ca.Function("h", [x], [whole])(z).full())


@pytest.mark.parametrize(
    "problem", [*map(two_parts, CRITERIA), tilt()], ids=[*(c.name for c in CRITERIA), "ODE"]
)
def test_values_and_derivatives_are_those_of_the_expression(problem, as_large, monkeypatch):
    mapped = compile_problem(problem)
    monkeypatch.undo()
    plain = compile_problem(problem)
    assert plain.program.is_a("SXFunction")
    assert not mapped.program.is_a("SXFunction")
    assert plain.programs[-1].derivatives == {}
    random = np.random.default_rng(5)
    for _ in range(5):
        x = np.array(
            [p.in_box(random.uniform()) for p in (problem.parameters[name] for name in plain.free)]
        )
        z = plain.scaling.to_solver(x)
        found, expected = (nlp.program(z, 1e-8, nlp.data) for nlp in (mapped, plain))
        for one, other in zip(expected, found, strict=True):
            assert_allclose(other, one, rtol=1e-12)
        multipliers = random.normal(size=plain.constraint.numel_out())
        expected = hessian(plain, z, 1e-8, multipliers)
        p = np.append(1e-8, mapped.data)
        found = mapped.programs[-1].derivatives["hess_lag"](z, p, 1.7, multipliers).full()
        assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
        for one, other in zip(plain.parts, mapped.parts, strict=True):
            values = plain.all_values(x)
            assert_allclose(other.response(values), one.response(values), rtol=1e-12)
            assert_allclose(
                other.sensitivity(values), one.sensitivity(values), rtol=1e-9, atol=1e-12
            )
        assert_allclose(mapped.costs(np.array([x, x])), plain.costs(np.array([x, x])), rtol=1e-12)


def test_the_fit_is_the_same(as_large, monkeypatch):
    problem = two_parts()
    mapped = gb.fit(problem, starts=4, progress=False)
    monkeypatch.undo()
    plain = gb.fit(problem, starts=4, progress=False)
    assert mapped.cost == pytest.approx(plain.cost, rel=1e-9)
    for name, value in plain.estimate.items():
        assert mapped.estimate[name] == pytest.approx(value, rel=1e-5)
        assert mapped.standard_error[name] == pytest.approx(plain.standard_error[name], rel=1e-4)


def test_a_mapped_problem_travels(as_large):
    nlp = compile_problem(two_parts())
    z = nlp.scaling.to_solver(np.array([nlp.problem.parameters[name].start for name in nlp.free]))
    back = pickle.loads(pickle.dumps(nlp))
    costs = [float(each.program(z, 0.0, each.data)[0]) for each in (back, nlp)]
    assert costs[0] == costs[1]
    p = np.append(0.0, nlp.data)
    assert_allclose(
        *(each.programs[-1].derivatives["hess_lag"](z, p, 1, 0) for each in (back, nlp)),
        rtol=1e-14,
    )


def test_a_formula_with_numbers_for_each_frequency_is_not_mapped(as_large):
    class Corrected(gb.TransferFunction):
        """A gain with a known correction at every frequency."""

        K = gb.Parameter(1.0, bounds=(0.1, 10))

        def response(self, s, p):
            return p.K * np.linspace(1, 2, 5) / (s + 1)

    omega = np.geomspace(1, 10, 5)
    data = gb.FrequencyResponse(omega, 2 * np.linspace(1, 2, 5) / (1j * omega + 1))
    nlp = compile_problem(gb.Problem(Corrected(), data))
    assert nlp.program.is_a("SXFunction")
    assert nlp.costs(np.array([[2.0]])) == pytest.approx(0, abs=1e-12)


def test_two_hundred_parameters_need_no_large_expressions():
    """The work of one evaluation of the Hessian is in proportion to frequencies times
    parameters; it was 12 million.
    """
    count = 200
    poles = np.geomspace(0.1, 100, count)

    def response(self, s, p):
        return sum(p[name] * a / (s + a) for name, a in zip(self.parameters, poles, strict=True))

    parameters = {f"p{k}": gb.Parameter(1.0, bounds=(0.1, 10)) for k in range(count)}
    many = type(
        "Many",
        (gb.TransferFunction,),
        {"__doc__": "A sum of lags.", "response": response, **parameters},
    )
    omega = np.geomspace(0.1, 100, 300)
    data = gb.FrequencyResponse(
        omega, np.sum(poles[:, None] / (1j * omega + poles[:, None]), axis=0)
    )
    nlp = compile_problem(gb.Problem(many(), data))
    assert nlp.program.n_instructions() < 1000
    assert nlp.programs[-1].derivatives["hess_lag"].n_instructions() < 1000
    assert float(
        nlp.program(nlp.scaling.to_solver(np.ones(count)), 0.0, nlp.data)[0]
    ) == pytest.approx(0, abs=1e-9)


def test_the_memory_of_a_large_response_grows_with_its_points(as_large):
    sizes = []
    for count in (2000, 4000):
        data = measured(LagLagDelay(), np.geomspace(0.1, 100, count), TWO_LAGS)
        nlp = compile_problem(gb.Problem(LagLagDelay(), data))
        sizes.append(nlp.programs[-1].derivatives["hess_lag"].sz_w())
    assert sizes[1] < 2.2 * sizes[0]
