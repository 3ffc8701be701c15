"""The part of a manoeuvre's spectrum against finite differences, the end term at its best at every point."""

import numpy as np
import pytest
from benchmark_module import benchmark
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.spectral import transient_spectrum

study = benchmark("transient_coverage")
MOVING = (8.0, (1.0, 2.0, 2.5, 3.0), [0.005, 0.01])
CASES = {
    "one output": (study.ShortPeriod(), study.SHORT_PERIOD, study.short_period_record(*MOVING), "u", "q"),
    "two of each": (study.Lateral(), study.LATERAL, study.lateral_record(), ["da", "dr"], ["roll", "yaw"]),
}


@pytest.fixture(scope="module", params=CASES)
def made(request):
    model, truth, clean, inputs, outputs = CASES[request.param]
    noise = dict.fromkeys([outputs] if isinstance(outputs, str) else outputs, 0.005)
    record = study.measured(clean, noise, np.random.default_rng(1))
    nlp = compile_problem(gb.Problem(model, transient_spectrum(record, inputs, outputs, study.BAND), gb.OutputError()))
    (part,) = nlp.parts
    z = nlp.scaling.to_solver(np.array([truth[name] for name in nlp.free]))
    return nlp, part, z, part.trajectory(z, None)


def weighted_errors(part, z, weight):
    return (weight @ part.trajectory(z, None).detail.errors).ravel()


def test_the_gradient_is_that_of_the_cost(made):
    _, part, z, trajectory = made
    gradient, _ = part.linearize(trajectory, None)
    slope = numeric_jacobian(lambda v: np.array([part.cost(part.trajectory(v, None), 0.0)]), z)[0]
    assert_allclose(gradient, slope, rtol=1e-4, atol=1e-4 * np.abs(slope).max())


def test_the_information_is_that_of_errors_whose_end_term_follows(made):
    _, part, z, trajectory = made
    _, information = part.linearize(trajectory, None)
    weight = trajectory.detail.covariance.weight(trajectory.products)
    J = numeric_jacobian(lambda v: weighted_errors(part, v, weight), z)
    assert_allclose(information, J.T @ J, rtol=0.01, atol=0.002 * np.abs(J.T @ J).max())
