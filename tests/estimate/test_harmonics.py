"""Whether the harmonics of a sine test are enough: the step of the estimate, against least squares."""

import numpy as np
import pytest
from duffing_oscillator import Spring
from evaluation import numeric_jacobian

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.estimate.covariance import assess
from greybox.estimate.diagnostics.harmonics import too_few_harmonics
from greybox.modeling import Sine, harmonic_response

OMEGA = np.array([0.45, 1.7])


def response(x, harmonics):
    values = {"b": x[0], "d": x[1]}
    return harmonic_response(
        Spring(), values, OMEGA, amplitude=Sine("u", 0.7, harmonics=harmonics)
    ).response


def test_more_harmonics_shift_the_estimate_as_least_squares_would():
    x, harmonics, more = np.array([1.1, 0.4]), 1, 5
    few = response(x, harmonics)
    random = np.random.default_rng(0)
    data = few * (1 + 0.01 * random.normal(size=2) + 0.01j * random.normal(size=2))
    measured = gb.FrequencyResponse(OMEGA, data, "u", "x", name="run")
    problem = gb.Problem(
        Spring(), measured, gb.SquaredRelativeError(), amplitude=Sine("u", 0.7, harmonics=harmonics)
    )
    nlp = compile_problem(problem)
    assert nlp.free == ("b", "d")
    accuracy = assess(nlp, x)
    (too_few,) = too_few_harmonics(nlp, x, accuracy)
    many = response(x, more)
    assert (too_few.problem, too_few.harmonics) == (nlp.parts[0].problem, more)
    assert too_few.change == pytest.approx(100 * np.abs(many / few - 1).max(), rel=1e-6)

    def stacked(values):
        return np.concatenate([values.real, values.imag])

    slopes = numeric_jacobian(lambda y: stacked(response(y, harmonics) / np.abs(data)), x)
    step = np.linalg.lstsq(slopes, stacked((many - few) / np.abs(data)), rcond=None)[0]
    shift = np.abs(step) / np.sqrt(np.diag(accuracy.covariance))
    largest = int(np.argmax(shift))
    assert too_few.parameter == nlp.free[largest]
    assert too_few.shift == pytest.approx(shift[largest], rel=1e-3)
    assert too_few.shift > 0.1
