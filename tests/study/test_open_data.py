"""Costs of responses whose data are given: those of the compiled problem with the data inside."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.models.tilt import NonlinearTilt
from greybox.study.open_data import data_table, formulas_of_frequency, open_program, program_input

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
def test_the_cost_for_data_that_are_given_is_that_of_a_problem_with_them(criterion):
    """Of other values at other frequencies, a point less, a part twice, and a constant with another value."""
    one, two = (
        gb.Problem(LagLagDelay(), points(1), criterion, fixed={"tau": 0.1}),
        points(2, Lag(), {"K": 3.0, "T": 0.2}),
    )
    problem = one + gb.Problem(Lag(), two, criterion, rename={"K": "gain"}, weight=2.0)
    nlp = compile_problem(problem)
    formulas = formulas_of_frequency(nlp)
    other, fewer = points(3, omega=1.3 * OMEGA), two.where(np.arange(len(two)) != 2)
    program = open_program(nlp, formulas, [len(other), len(fewer)])
    values = {"K": 4.0, "T1": 0.5, "T2": 0.2, "gain": 2.5, "T": 0.3}
    x = np.array([values[name] for name in nlp.free])
    numbers = program_input(
        np.array([0.07]), np.array([1.0, 2.0]), [data_table(other), data_table(fewer)]
    )
    found = float(program(nlp.scaling.to_solver(x), 0.0, numbers)[0])
    wanted = sum(
        weight
        * gb.cost(
            gb.Problem(model, data, criterion), {k: values.get(v, 0.07) for k, v in names.items()}
        )
        for model, data, weight, names in (
            (LagLagDelay(), other, 1.0, {"K": "K", "T1": "T1", "T2": "T2", "tau": "tau"}),
            (Lag(), fewer, 4.0, {"K": "gain", "T": "T"}),
        )
    )
    assert found == pytest.approx(wanted, rel=1e-9)


def test_limits_come_along():
    nlp = compile_problem(
        gb.Problem(LagLagDelay(), points(1), constraints=[lambda p: p.T1 - 2 * p.T2])
    )
    program = open_program(nlp, formulas_of_frequency(nlp), [len(OMEGA)])
    z = nlp.scaling.to_solver(np.array([4.0, 0.5, 0.1, 0.05]))
    numbers = program_input(np.zeros(0), np.ones(1), [data_table(points(1))])
    cost, limits = program(z, 0.0, numbers)
    assert_allclose(limits.full().ravel(), [0.3])
    assert float(cost) == pytest.approx(nlp.cost(np.array([4.0, 0.5, 0.1, 0.05])))


def test_what_has_no_formula_of_one_frequency_stays_at_its_own():
    """A sine of finite amplitude: measured values are given, and the frequencies that come with them are not read."""
    omega = np.array([1.0, 3.0])
    data = gb.FrequencyResponse(omega, np.array([1.0 - 0.5j, 0.2 - 0.1j]), "u", "theta")
    problem = gb.Problem(NonlinearTilt(), data, amplitude=gb.modeling.Sine("u", 0.1, harmonics=1))
    nlp = compile_problem(problem)
    assert formulas_of_frequency(nlp) is None
    program = open_program(nlp, None, [2])
    x = np.array([nlp.problem.parameters[name].start for name in nlp.free])
    other = gb.FrequencyResponse(omega, 1.1 * data.response, "u", "theta")
    table = data_table(other)
    table[0] = 99.0
    found = float(
        program(
            nlp.scaling.to_solver(x), 0.0, program_input(nlp.constant_values, np.ones(1), [table])
        )[0]
    )
    values = dict(zip(nlp.names, nlp.all_values(x), strict=True))
    assert found == pytest.approx(gb.cost(problem.with_(data=other), values), rel=1e-9)


def test_a_table_has_nan_for_what_the_data_do_not_have():
    table = data_table(
        gb.FrequencyResponse([1.0, 2.0], [3 + 4j, 5j], "u", "y", coherence=[0.5, 0.9])
    )
    np.testing.assert_array_equal(
        table, [[1, 2], [3, 0], [4, 5], [0.5, 0.9], [np.nan] * 2, [np.nan] * 2]
    )
