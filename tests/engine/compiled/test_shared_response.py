"""Responses that share one solve: held against the expressions of CasADi."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem

OMEGA = np.geomspace(0.5, 20, 60)


class Roll(gb.StateSpace):
    """Sideslip, roll rate and bank angle, with a delay, a nonlinear and a logarithmic entry."""

    states = ("v", "p", "phi")
    inputs = ("lat", "ped")
    outputs = ("v", "p", "ay")
    delays = {"lat": "tau"}
    Lp = gb.Parameter(-3.0, bounds=(-12, 0))
    Lv = gb.Parameter(-0.5, bounds=(-2, 2))
    Yv = gb.Parameter(-0.2, bounds=(-1, 1))
    Llat = gb.Parameter(12.0, bounds=(1, 50), scale="log")
    Lped = gb.Parameter(2.0, bounds=(-8, 8))
    tau = gb.Parameter(0.05, bounds=(0, 0.2))

    def derivative(self, x, u, p):
        return (
            p.Yv * x.v + gb.g * x.phi + u.ped,
            p.Lv * x.v + p.Lp * x.p + p.Llat * u.lat + p.Lped * u.ped,
            x.p,
        )

    def output(self, x, u, p):
        return x.v, x.p, p.Yv * x.v + p.Lp * p.Lv * x.p + u.ped


class RollAtOnce(Roll):
    """The same without the delay."""

    delays = {}


def problem(criterion, seed=0, kind=Roll, **about):
    random, model = np.random.default_rng(seed), kind()
    responses = []
    for y in Roll.outputs:
        for u in Roll.inputs:
            exact = gb.frequency_response(model, None, OMEGA, input=u, output=y).response
            noise = random.standard_normal((2, OMEGA.size)) * np.abs(exact) * 0.05
            # Pairs at frequencies of their own.
            own = slice(None, None, 1 + len(responses) % 2)
            response = (exact + noise[0] + 1j * noise[1])[own]
            responses.append(
                gb.FrequencyResponse(
                    OMEGA[own],
                    response,
                    input=u,
                    output=y,
                    coherence=np.full(response.size, 0.9),
                    **about,
                )
            )
    return gb.several(model, responses, criterion=criterion, weight={"p/lat": 2.0})


HOLD = {"kind": RollAtOnce, "about": {"hold of the input, s": "0.02"}}


@pytest.mark.parametrize(
    ("criterion", "options"),
    [
        (gb.RelativeError(), {}),
        (gb.MagnitudePhase(), {}),
        (gb.RelativeLikelihood(), {}),
        (gb.RelativeError(), HOLD),
    ],
    ids=str,
)
def test_cost_and_gradient_are_those_of_the_expressions(criterion, options):
    nlp = compile_problem(problem(criterion, **options))
    program = nlp.programs[-1]
    z = np.random.default_rng(1).uniform(0.1, 0.9, (6, 3))
    cost, gradient, hessian = program.shared(
        z, np.full((1, 3), 1e-4), np.tile(nlp.data[:, None], 3)
    )

    point = ca.MX.sym("z", 6)
    value = program.function(point, 1e-4, nlp.data)[0]
    slope = ca.Function("slope", [point], [value, ca.gradient(value, point)])
    for k in range(3):
        exact_cost, exact_gradient = (v.full().ravel() for v in slope(z[:, k]))
        assert_allclose(cost[k], exact_cost[0], rtol=1e-10)
        assert_allclose(
            gradient[:, k], exact_gradient, rtol=1e-8, atol=1e-8 * abs(exact_gradient).max()
        )
        curvature = hessian[:, k].reshape(6, 6)
        assert_allclose(curvature, curvature.T, rtol=1e-9, atol=1e-9 * abs(curvature).max())


def test_other_models_and_delays_are_not_shared():
    delayed = problem(gb.RelativeError()).with_(delay="pade:2")
    assert compile_problem(delayed).programs[-1].shared is None
