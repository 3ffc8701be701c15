"""Whether the harmonics of a sine test are enough: the step of the estimate, against least squares."""

import numpy as np
from duffing_oscillator import Spring
from evaluation import numeric_jacobian

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.estimate.covariance import assess
from greybox.estimate.diagnostics.harmonics import harmonic_warnings
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
    (text,) = harmonic_warnings(nlp, x, accuracy)
    many = response(x, more)
    change = 100 * np.abs(many / few - 1).max()
    assert f"with {more} the response changes by up to {change:.2g} %" in text

    def stacked(values):
        return np.concatenate([values.real, values.imag])

    slopes = numeric_jacobian(lambda y: stacked(response(y, harmonics) / np.abs(data)), x)
    step = np.linalg.lstsq(slopes, stacked((many - few) / np.abs(data)), rcond=None)[0]
    shift = np.abs(step) / np.sqrt(np.diag(accuracy.covariance))
    largest = int(np.argmax(shift))
    assert f"{nlp.free[largest]} by {shift[largest]:.2g} standard errors" in text
    assert shift[largest] > 0.1
