"""A frequency response as a part of a problem: what tells two runs apart, and where it is not finite."""

import numpy as np
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
