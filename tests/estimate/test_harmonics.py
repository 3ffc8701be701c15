"""Whether the harmonics of a sine test are enough: the step of the estimate, against least squares."""

from types import SimpleNamespace

import numpy as np
import pytest
from duffing_oscillator import Spring
from evaluation import numeric_jacobian

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.estimate.checks import few_harmonics as module
from greybox.estimate.covariance import accuracy_at
from greybox.modeling import Sine, harmonic_response

OMEGA = np.array([0.45, 1.7])


def response(x, number):
    values = {"b": x[0], "d": x[1]}
    return harmonic_response(
        Spring(), values, OMEGA, amplitude=Sine("u", 0.7, harmonics=number)
    ).response


@pytest.mark.parametrize(("noise", "matters"), [(0.01, True), (5.0, False)])
def test_harmonics_that_would_shift_the_estimate_are_asked_for(noise, matters):
    x, few, more = np.array([1.1, 0.4]), response([1.1, 0.4], 1), response([1.1, 0.4], 5)
    random = np.random.default_rng(0)
    data = few * (1 + noise * (random.normal(size=2) + 1j * random.normal(size=2)))
    measured = gb.FrequencyResponse(OMEGA, data, "u", "x", name="run")
    problem = gb.Problem(
        Spring(), measured, gb.SquaredRelativeError(), amplitude=Sine("u", 0.7, harmonics=1)
    )
    nlp = compile_problem(problem)
    texts = [f.text for f in module.few_harmonics(SimpleNamespace(nlp=nlp, x=x))]
    assert bool(texts) == matters

    # The step of least squares, in standard errors.
    def stacked(values):
        return np.concatenate([values.real, values.imag])

    slopes = numeric_jacobian(lambda y: stacked(response(y, 1) / np.abs(data)), x)
    step = np.linalg.lstsq(slopes, stacked((more - few) / np.abs(data)), rcond=None)[0]
    shift = np.abs(step) / np.sqrt(np.diag(accuracy_at(nlp, x).covariance))
    assert (shift.max() > 0.1) == matters
    if matters:
        change = 100 * np.abs(more / few - 1).max()
        assert f"with 5 the response changes by up to {change:.2g} %" in texts[0]


def test_a_start_without_a_periodic_motion_is_explained():
    """A softening spring gives way."""

    class Softening(Spring):
        def derivative(self, x, u, p):
            return (x.v, u.u - p.d * x.v - x.x + p.b * x.x**3)

    data = gb.FrequencyResponse([0.3, 0.5, 0.8], [1.0 + 0.1j] * 3, "u", "x", name="run")
    problem = gb.Problem(Softening(), data, amplitude=Sine("u", 1.0, harmonics=3), fixed={"d": 0.3})
    fit = gb.fit(problem, starts=[{}], progress=False)
    assert not fit.converged
    assert "in 'run' no periodic motion is found" in fit.warnings[0]


def test_where_more_harmonics_find_no_motion_is_said(monkeypatch):
    """The finer balance is made to fail at one of two frequencies."""
    x = [1.1, 0.4]
    measured = gb.FrequencyResponse(OMEGA, response(x, 7), "u", "x", name="run")
    problem = gb.Problem(Spring(), measured, amplitude=Sine("u", 0.7, harmonics=7))
    found = np.array([response(x, 7)[0], np.nan])
    monkeypatch.setattr(module, "directly_found", lambda *_, **__: (found, 17))
    evidence = SimpleNamespace(nlp=compile_problem(problem), x=np.array(x))
    (text,) = [f.text for f in module.few_harmonics(evidence)]
    assert "no motion was found at 1 of 2" in text
