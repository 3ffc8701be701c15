"""A frequency response as a part of a problem: what tells two runs apart, and where it is not finite."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem

OMEGA = np.array([0.5, 1.0, 3.0, 10.0])


class Lag(gb.TransferFunction):
    """A first-order lag whose gain is a root."""

    input, output = "u", "y"
    K = gb.Parameter(4.0, unit="1", bounds=(-10.0, 10.0))
    T = gb.Parameter(0.5, unit="s", bounds=(0.01, 10.0))

    def response(self, s, p):
        return gb.sqrt(p.K) / (1 + p.T * s)


def part_of_lag():
    measured = 2.5 / (1 + 0.4j * OMEGA)
    nlp = compile_problem(gb.Problem(Lag(), gb.FrequencyResponse(OMEGA, measured, input="u", output="y")))
    return nlp, nlp.parts[0], measured


def test_the_signature_is_the_response_over_the_measured_one():
    nlp, part, measured = part_of_lag()
    found = part.signature(part.initial_trajectory(nlp.scaling.to_solver(np.array([9.0, 0.7]))))
    expected = 3.0 / (1 + 0.7j * OMEGA) / np.abs(measured)
    assert_allclose(found, np.concatenate([expected.real, expected.imag]), rtol=1e-12)


def test_a_response_that_is_not_finite_is_told():
    nlp, part, _ = part_of_lag()
    assert part.initial_trajectory(nlp.scaling.to_solver(np.array([4.0, 0.5]))).finite
    assert not part.initial_trajectory(nlp.scaling.to_solver(np.array([-4.0, 0.5]))).finite


def test_costs_and_their_derivatives_are_those_of_the_criterion():
    """Σ |P/P̂ - 1|, with what rounds off its kink under the root, and without."""
    nlp, part, measured = part_of_lag()
    z = nlp.scaling.to_solver(np.array([5.0, 0.7]))
    trajectory = part.trajectory(z, None)
    errors = np.abs(np.sqrt(5.0) / (1 + 0.7j * OMEGA) / measured - 1)
    assert part.cost(trajectory, 0.0) == pytest.approx(errors.sum(), rel=1e-12)
    assert part.cost(trajectory, 1e-8) == pytest.approx(np.sqrt(errors**2 + 1e-8).sum(), rel=1e-12)
    assert part.cost(trajectory, 1e-2) == pytest.approx(np.sqrt(errors**2 + 1e-2).sum(), rel=1e-12)
    assert part.numbers == 8

    gradient, hessian = part.linearize(trajectory, None)

    def cost(v):
        return part.cost(part.trajectory(v, None), 1e-8)

    steps = 1e-5 * np.eye(2)
    assert_allclose(gradient, [(cost(z + h) - cost(z - h)) / 2e-5 for h in steps], rtol=1e-6)
    slopes = np.array([(part.linearize(part.trajectory(z + h, None), None)[0] - gradient) / 1e-5 for h in steps])
    values, vectors = np.linalg.eigh((slopes + slopes.T) / 2)
    assert_allclose(hessian, (vectors * np.abs(values)) @ vectors.T, rtol=1e-3)
    assert np.linalg.eigvalsh(hessian).min() > 0


def test_the_response_and_how_it_follows_the_values():
    _, part, _ = part_of_lag()
    values = np.array([9.0, 0.7])
    lag = 1 / (1 + 0.7j * OMEGA)
    assert_allclose(part.response(values), 3 * lag, rtol=1e-12)
    assert_allclose(part.sensitivity(values), np.transpose([lag / 6, -3j * OMEGA * lag**2]), rtol=1e-12)


def test_a_measured_zero_tells_no_runs_apart():
    measured = np.array([0.0, 2.0, 1.0, 0.5])
    data = gb.FrequencyResponse(OMEGA, measured, input="u", output="y", variance=np.full(4, 0.01))
    (part,) = compile_problem(gb.Problem(Lag(), data, gb.MaximumLikelihood())).parts
    assert_allclose(part.magnitude, [2e-12, 2.0, 1.0, 0.5])


def test_a_criterion_of_the_users_own_stays_behind():
    """Its class may be known in this process alone."""

    class Own(gb.RelativeError):
        pass

    for criterion, travels in ((gb.RelativeError(), True), (Own(), False)):
        data = gb.FrequencyResponse(OMEGA, 1 / (1 + 0.4j * OMEGA), input="u", output="y")
        (part,) = compile_problem(gb.Problem(Lag(), data, criterion)).parts
        assert part.travels_whole is travels
        assert ("criterion" in part.__getstate__()) is travels
