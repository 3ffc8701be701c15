"""Costs of responses whose data are given: those of the compiled problem with the data inside."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.models.tilt import NonlinearTilt
from greybox.study.open_data import open_program, program_input

OMEGA = TWO_LAGS_OMEGA[::3]


def points(seed, model=None, values=TWO_LAGS, omega=OMEGA):
    random = np.random.default_rng(seed)
    columns = {
        "variance": random.uniform(0.01, 0.1, len(omega)),
        "dof": random.uniform(4, 20, len(omega)),
    }
    columns["coherence"] = random.uniform(0.5, 0.95, len(omega))
    return measured(model or LagLagDelay(), omega, values, noise=0.1, seed=seed, columns=columns)


@pytest.mark.parametrize(
    "criterion",
    [
        gb.RelativeError(),
        gb.RelativeError(normalized="model"),
        gb.SquaredRelativeError(),
        gb.RelativeLikelihood(),
        gb.MagnitudePhase(),
        gb.MaximumLikelihood(),
    ],
    ids=repr,
)
def test_the_cost_for_data_as_an_input_is_that_of_a_problem_with_them(criterion):
    """With other values, a part of double weight, and a constant with another value."""
    one = gb.Problem(LagLagDelay(), points(1), criterion, fixed={"tau": 0.1})
    two = points(2, Lag(), {"K": 3.0, "T": 0.2})
    problem = one + gb.Problem(Lag(), two, criterion, rename={"K": "gain"}, weight=2.0)
    nlp = compile_problem(problem)
    program = open_program(nlp)
    values = {"K": 4.0, "T1": 0.5, "T2": 0.2, "gain": 2.5, "T": 0.3}
    x = np.array([values[name] for name in nlp.free])
    measured = [points(3).response, two.response]
    numbers = program_input(np.array([0.07]), measured)
    cost = float(program(nlp.scaling.to_solver(x), 0.0, numbers)[0])
    wanted = sum(
        weight
        * gb.cost(
            gb.Problem(model, data, criterion), {k: values.get(v, 0.07) for k, v in names.items()}
        )
        for model, data, weight, names in (
            (
                LagLagDelay(),
                replace(points(1), response=measured[0]),
                1.0,
                {"K": "K", "T1": "T1", "T2": "T2", "tau": "tau"},
            ),
            (Lag(), two, 2.0, {"K": "gain", "T": "T"}),
        )
    )
    assert cost == pytest.approx(wanted, rel=1e-9)


def test_limits_come_along():
    nlp = compile_problem(
        gb.Problem(LagLagDelay(), points(1), constraints=[lambda p: p.T1 - 2 * p.T2])
    )
    program = open_program(nlp)
    z = nlp.scaling.to_solver(np.array([4.0, 0.5, 0.1, 0.05]))
    numbers = program_input(np.zeros(0), [points(1).response])
    cost, limits = program(z, 0.0, numbers)
    assert_allclose(limits.full().ravel(), [0.3])
    assert float(cost) == pytest.approx(nlp.cost(np.array([4.0, 0.5, 0.1, 0.05])))


def test_sines_of_finite_amplitude_have_open_data_too():
    omega = np.array([1.0, 3.0])
    data = gb.FrequencyResponse(omega, np.array([1.0 - 0.5j, 0.2 - 0.1j]), "u", "theta")
    problem = gb.Problem(NonlinearTilt(), data, amplitude=gb.modeling.Sine("u", 0.1, harmonics=1))
    nlp = compile_problem(problem)
    x = np.array([nlp.problem.parameters[name].start for name in nlp.free])
    other = gb.FrequencyResponse(omega, 1.1 * data.response, "u", "theta")
    numbers = program_input(nlp.constant_values, [other.response])
    cost = float(open_program(nlp)(nlp.scaling.to_solver(x), 0.0, numbers)[0])
    values = dict(zip(nlp.names, nlp.all_values(x), strict=True))
    assert cost == pytest.approx(gb.cost(problem.with_(data=other), values), rel=1e-9)
