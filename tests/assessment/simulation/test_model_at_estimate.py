"""Model and values brought together, by hand and by a fit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hardening_spring import Spring, driven
from numpy.testing import assert_allclose

import greybox as gb
from greybox.assessment.simulation.model_at_estimate import model_at


def test_values_fill_in_the_declared_starts():
    model = model_at(Spring(), {"stiffness": 9.0, "delay": 0.07})
    assert model.label == "Spring"
    assert dict(zip(model.names, model.q, strict=True)) == {
        **{name: p.start for name, p in Spring.parameters.items()},
        "stiffness": 9.0,
        "delay": 0.07,
    }
    assert_allclose(model.delays, [0.07])
    assert model.covariance is None
    assert model.uncertain.size == 0
    assert model.noise(("position",)) is None
    assert model.criterion == gb.OutputError()


def test_biases_and_gains_come_by_their_names():
    values = {"position_bias": 0.2, "K_velocity_position": 1.5}
    model = model_at(Spring(), values, inputs="held")
    assert model.names[-2:] == ("position_bias", "K_velocity_position")
    assert_allclose(model.q[-2:], [0.2, 1.5])
    assert_allclose(model.p, model.q[:-2])
    assert model.criterion == gb.PredictionError(inputs="held", biases=("position",))
    record = driven(8.0, noise=0.05)
    without_gain = gb.simulate(Spring(), {"position_bias": 0.2}, record, inputs="held")
    simulated = gb.simulate(Spring(), values, record, inputs="held")
    assert_allclose(simulated["position"], without_gain["position"])  # nothing is corrected


def test_a_fit_gives_its_covariance_and_noise():
    fit = gb.fit(gb.Problem(Spring(), driven(8.0, noise=0.05)), starts=[{}], progress=False)
    model = model_at(fit)
    free = [model.names[i] for i in model.uncertain]
    assert free == [name for name, p in Spring.parameters.items() if not p.fixed]
    assert_allclose(
        np.sqrt(np.diag(model.covariance))[model.uncertain], [fit.standard_error[n] for n in free]
    )
    assert_allclose(model.noise(model.part.outputs), model.part.noise)
    assert_allclose(model_at(Spring(), fit).q, model.q)
    omega = np.array([1.0, 2.0])
    for other in ({"stiffness": 1.0}, driven(8.0), gb.FrequencyResponse(omega, 1 / omega)):
        with pytest.raises(TypeError, match=r"is a Fit.*leave it out, or give a record by name"):
            model_at(fit, other)


def test_a_model_with_a_parameter_that_the_fit_does_not_have_is_refused():
    class Heavier(Spring):
        extra = gb.Parameter(0.0, bounds=(0, 1))

    fit = gb.fit(gb.Problem(Spring(), driven(4.0, noise=0.05)), starts=[{}], progress=False)
    with pytest.raises(
        ValueError,
        match=r"the fit has no 'extra', which Heavier needs; it has .*: give the model that",
    ):
        model_at(Heavier(), fit)


@pytest.mark.parametrize(
    ("model", "values", "error", "sentence"),
    [
        (Spring, {}, TypeError, r"model is <class .*>: give an instance"),
        (Spring(), 3, TypeError, r"values is 3: give \{name: value\} or a Fit"),
        (Spring(), {"stiff": 1.0}, ValueError, "Spring has no parameter 'stiff'"),
        (
            Spring(),
            {"stiffness": np.nan},
            ValueError,
            "values gives 'stiffness' the value nan: give a finite number",
        ),
        (
            Spring(),
            {"stiffness": [1.0]},
            ValueError,
            r"values gives 'stiffness' the value \[1\.0\]",
        ),
        (
            Spring(),
            {"stiffness": np.ones(1)},
            ValueError,
            r"values gives 'stiffness' the value array",
        ),
        (
            Spring(),
            {"stiffness": np.complex128(1)},
            ValueError,
            r"values gives 'stiffness' the value",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(model, values, error, sentence):
    with pytest.raises(error, match=sentence):
        model_at(model, values)


def test_the_noise_of_outputs_is_in_their_order():
    noise = np.array([[1.0, 0.2, 0.3], [0.2, 4.0, 0.6], [0.3, 0.6, 9.0]])
    part = SimpleNamespace(outputs=("a", "b", "c"), noise=noise)
    model = replace(model_at(Spring(), {}), part=part)
    assert_allclose(model.noise(("c", "a")), [[9.0, 0.3], [0.3, 1.0]])
    assert model.noise(("a", "d")) is None
    covariance = np.diag([0.0, 0.1, np.nan, 0.0])
    assert replace(model, covariance=covariance).uncertain.tolist() == [1, 2]


def test_inputs_that_act_later_than_they_are_logged_delay_the_model():
    """By half of the time for which each value lasted."""
    model = model_at(Spring(), {"delay": 0.05})
    for hold, held, late in ((0.0, False, 0.0), (0.008, False, 0.004), (np.inf, True, 0.0)):
        record = gb.Record(0.02 * np.arange(10), {"force": np.ones(10)}, hold={"force": hold})
        driven_by = model.driven_by(record)
        assert driven_by.held == (held,)
        assert_allclose(driven_by.delays, [0.05 + late])
