"""Costs of responses with other data than those of the compiled problem; criteria of users."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem

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
    values = {"K": 4.0, "T1": 0.5, "T2": 0.2, "gain": 2.5, "T": 0.3}
    x = np.array([values[name] for name in nlp.free])
    measured = [points(3).response, two.response]
    numbers = nlp.data_of(np.array([0.07]), measured)
    cost = float(nlp.programs[-1].function(nlp.scaling.to_solver(x), 0.0, numbers)[0])
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
    z = nlp.scaling.to_solver(np.array([4.0, 0.5, 0.1, 0.05]))
    cost, limits = nlp.programs[-1].function(z, 0.0, nlp.data_of(np.zeros(0), [points(1).response]))
    assert_allclose(limits.full().ravel(), [0.3])
    assert float(cost) == pytest.approx(nlp.costs(np.array([[4.0, 0.5, 0.1, 0.05]])).item())


class Weighted(gb.SquaredRelativeError):
    """A criterion whose weights are functions of the coherence; `weights` chooses which."""

    def __init__(self, weights):
        super().__init__()
        object.__setattr__(self, "weights", weights)

    def cost(self, model, data, smoothing=0.0):
        error = abs(model - data.response) ** 2 / np.abs(data.response) ** 2
        return gb.formulation.frequency_criteria.total(error * self.weights(data.coherence))


@pytest.mark.parametrize(
    ("weights", "is_open"),
    [
        (lambda coherence: coherence**2, True),
        (lambda coherence: np.array([float(value) for value in coherence]), False),
        (lambda coherence: 1.0 if isinstance(coherence, np.ndarray) else 2.0, False),
    ],
    ids=["symbols", "numbers", "another cost of symbols"],
)
def test_a_criterion_that_needs_numbers_has_them(weights, is_open):
    """Also one that accepts symbols but makes another cost of them."""
    data = points(1)
    nlp = compile_problem(gb.Problem(LagLagDelay(), data, Weighted(weights)))
    assert nlp.parts[0].is_open == is_open
    assert nlp.data.size == (6 * len(data) if is_open else 0)
    x = np.array([4.0, 0.5, 0.1, 0.05])
    exact = gb.frequency_response(LagLagDelay(), dict(zip(nlp.free, x, strict=True)), OMEGA)
    errors = np.abs(exact.response / data.response - 1) ** 2 * weights(data.coherence)
    assert nlp.costs(x[None]).item() == pytest.approx(errors.sum(), rel=1e-12)
