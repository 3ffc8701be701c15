"""What belongs to a record, its biases and trims, is estimated from it where the model was fitted to another one."""

from dataclasses import replace

import numpy as np
import pytest
from drag_flights import Drag, LinearDrag, fitted, flight
from numpy.testing import assert_allclose

import greybox as gb
from greybox.assessment.simulation.model_at_estimate import model_at

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"a5": 0.2, "C_x": 0.05}
BIASES = gb.OutputError(biases=("v", "theta"))


def biased(seed, v, theta, **options):
    """A flight whose sensors have constant errors."""
    made = flight(TRUTH, seed, **options)
    signals = {"theta": made["theta"] + theta, "v": made["v"] + v}
    return gb.Record(made.time, signals, made.units, name=f"biased {seed}")


@pytest.fixture(scope="module")
def fit():
    return fitted(Drag(), biased(1, 0.5, 0.01), criterion=BIASES)


def test_biases_are_those_of_the_new_record(fit):
    new = biased(2, -0.8, -0.02, duration=15.0)
    found = gb.predict(fit, record=new)
    for name, truth in (("v_bias", -0.8), ("theta_bias", -0.02)):
        value, error = found.own[name]
        assert abs(value - truth) < 4 * error
        assert error < 0.1 * abs(truth)
    (said,) = found.notes
    assert said.startswith("v_bias = -0.")
    assert " m/s and theta_bias = -0.0" in said
    assert "were estimated from biased 2 itself: 2 values from" in said
    assert "not held out" in str(found)
    right = gb.predict(Drag(), {**TRUTH, "v_bias": -0.8, "theta_bias": -0.02}, new)
    kept = gb.predict(fit, record=new, own=())
    assert kept.own == {}
    assert not kept.notes
    assert found.rms("v") < 1.02 * right.rms("v")
    assert kept.rms("v") > 1.5 * right.rms("v")
    assert np.all(found.error > 0)


def test_the_errors_of_own_values_are_those_that_repeated_records_show():
    standardized = []
    for seed in range(30, 33):
        new = biased(seed, 0.3, 0.015, duration=10.0)
        own = gb.predict(Drag(), TRUTH, new, own=["v_bias", "theta_bias"]).own
        standardized += [(own["v_bias"][0] - 0.3) / own["v_bias"][1]]
        standardized += [(own["theta_bias"][0] - 0.015) / own["theta_bias"][1]]
    assert (
        0.5 < np.sqrt(np.mean(np.square(standardized))) < 1.5
    )  # of 6 values, half of them independent


def test_the_record_of_the_fit_keeps_what_was_fitted(fit):
    assert gb.predict(fit).own == {}
    assert gb.predict(fit, record=fit.records[0].data.between(0, 12)).own == {}


class Aircraft(gb.StateSpace):
    """Pitch rate and normal acceleration of an aircraft, with trims that each flight has for itself."""

    states, inputs, outputs = ("alpha", "q"), ("delta",), ("q", "az")
    Z = gb.Parameter(-1.2, bounds=(-5, 0), unit="1/s")
    M_a = gb.Parameter(-4.0, bounds=(-20, 0), unit="1/s²")
    M_q = gb.Parameter(-2.0, bounds=(-10, 0), unit="1/s")
    M_d = gb.Parameter(-8.0, bounds=(-30, 0), unit="1/s²")
    M_0 = gb.Parameter(0.0, bounds=(-5, 5), unit="1/s²")
    az_0 = gb.Parameter(0.0, bounds=(-30, 30), unit="m/s²")

    def derivative(self, x, u, p):
        return (
            p.Z * x.alpha + x.q,
            p.M_a * x.alpha + p.M_q * x.q + p.M_d * u.delta + p.M_0,
        )

    def output(self, x, u, p):
        return (x.q, 60.0 * p.Z * x.alpha + p.az_0)


def flown(seed, M_0, az_0):
    time = np.arange(250) / 25
    random = np.random.default_rng(seed)
    delta = 0.05 * np.sign(np.sin(0.9 * time + random.uniform(0, 6))) + 0.02 * np.sin(3 * time)
    made = gb.simulate(Aircraft(), {"M_0": M_0, "az_0": az_0}, gb.Record(time, {"delta": delta}))
    signals = {"delta": delta, "q": made["q"] + 0.01 * random.normal(size=250)}
    return gb.Record(
        time, {**signals, "az": made["az"] + 0.3 * random.normal(size=250)}, name=f"flight {seed}"
    )


def test_stated_trims_are_estimated_from_the_new_record():
    fit = fitted(Aircraft(), flown(1, 0.1, -9.8))
    new = flown(2, -0.2, -9.0)
    as_it_is = gb.predict(fit, record=new)
    assert as_it_is.own == {}
    trimmed = gb.predict(fit, record=new, own=["M_0", "az_0"])
    for name, truth in (("M_0", -0.2), ("az_0", -9.0)):
        value, error = trimmed.own[name]
        assert abs(value - truth) < 4 * error
        assert error < 0.1
    assert trimmed.fit_percent("az") > as_it_is.fit_percent("az") + 3
    for bad, said in (("az", "no parameter 'az'"), ("x_bias", "no parameter 'x_bias'")):
        with pytest.raises(ValueError, match=said):
            gb.predict(fit, record=new, own=[bad])


def test_parameters_of_every_record_of_a_fit_are_estimated_from_another():
    records = [flown(1, 0.1, -9.8), flown(2, -0.2, -9.0)]
    fit = gb.fit(
        gb.several(Aircraft(), records, own=["M_0", "az_0"]),
        starts=1,
        progress=False,
        profiles=False,
    )
    found = gb.predict(fit, record=flown(3, 0.3, -10.5))
    assert found.own.keys() == {"M_0", "az_0"}
    assert found.own["az_0"][0] == pytest.approx(-10.5, abs=4 * found.own["az_0"][1])
    # Each record of the fit is predicted with its own.
    assert gb.predict(fit, record=records[1]).own == {}
    assert gb.predict(fit, record=records[1]).rms("az") == pytest.approx(
        gb.predict(fit, part=1).rms("az")
    )
    assert gb.predict(fit, record=records[1]).rms("az") < 0.5


class Integrated(gb.StateSpace):
    """A position from its rate.

    A constant error of the position cannot be told from where it began.
    """

    states, inputs, outputs = ("x",), ("rate",), ("x",)
    gain = gb.Parameter(1.0, bounds=(0, 5))

    def derivative(self, x, u, p):
        return (p.gain * u.rate,)

    def output(self, x, u, p):
        return (x.x,)


def test_what_the_record_does_not_determine_is_said_and_kept():
    time = np.arange(400) / 20
    random = np.random.default_rng(0)
    rate = np.sin(0.8 * time)
    x = gb.simulate(Integrated(), {"gain": 2.0}, gb.Record(time, {"rate": rate - 0.1}))["x"]
    record = gb.Record(time, {"rate": rate, "x": x + 0.05 * random.normal(size=400)}, name="ramp")
    found = gb.predict(Integrated(), {"gain": 2.0}, record, own=["x_bias", "rate_bias"])
    assert found.own.keys() == {"rate_bias"}
    assert found.own["rate_bias"][0] == pytest.approx(0.1, abs=0.01)
    assert "x_bias: not determined by ramp; the value of the fit is used." in found.notes
    alone = gb.predict(Integrated(), {"gain": 2.0}, record, own=["x_bias"])
    assert alone.own == {}
    assert "x_bias: not determined by ramp; the value of the fit is used." in alone.notes
    assert alone.rms("x") == pytest.approx(
        gb.predict(Integrated(), {"gain": 2.0}, record, own=()).rms("x")
    )


def test_models_with_their_own_biases_are_compared_and_counted(fit):
    linear = fitted(LinearDrag(), fit.records[0].data, criterion=BIASES)
    new = biased(2, -0.8, -0.02, duration=15.0)
    found = gb.compare(fit, linear, records=new)
    assert found.value("values estimated from the records", "Drag", "held-out") == 2
    assert [
        s.split(":")[0] for s in found.statements if "estimated from biased 2 itself" in s
    ] == list(found.labels)
    assert "Drag predicts held-out data better than LinearDrag" in str(found)


class Gain(gb.StateSpace):
    """An output that follows its input at once."""

    states, inputs, outputs = (), ("u",), ("y",)
    K = gb.Parameter(2.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return (p.K * u.u,)


@pytest.mark.parametrize("every", [1, 2])
def test_the_error_of_a_constant_offset_is_that_of_a_mean(every):
    """White errors of 0.1, and every so many samples measured.

    0.1 over the root of their number.
    """
    time = np.arange(400) / 20
    u = np.sin(time)
    y = 2 * u + 0.7 + 0.1 * np.random.default_rng(0).normal(size=400)
    y[np.arange(400) % every != 0] = np.nan
    found = gb.predict(Gain(), {"K": 2.0}, gb.Record(time, {"u": u, "y": y}), own=["y_bias"])
    value, error = found.own["y_bias"]
    assert value == pytest.approx(np.nanmean(y - 2 * u), abs=0.3 * error)
    assert error == pytest.approx(0.1 / np.sqrt(400 / every), rel=0.12)


def test_the_error_of_the_model_is_in_that_of_an_own_value_that_follows_it():
    """A mean of y - K u, with a gain that is known to 0.1 alone."""

    class Known:
        def at_estimate(self, model, **options):
            return replace(model_at(Gain(), {"K": 2.0}), covariance=np.array([[0.01]]))

    time = np.arange(400) / 20
    u = 1 + np.sin(time)
    y = 2 * u + 0.7 + 0.1 * np.random.default_rng(0).normal(size=400)
    record = gb.Record(time, {"u": u, "y": y})
    alone = gb.predict(Gain(), {"K": 2.0}, record, own=["y_bias"])
    found = gb.predict(Known(), record=record, own=["y_bias"])
    assert found.own["y_bias"][0] == pytest.approx(alone.own["y_bias"][0])
    error = np.sqrt(alone.own["y_bias"][1] ** 2 + 0.01 * u.mean() ** 2)
    assert found.own["y_bias"][1] == pytest.approx(error, rel=0.02)
    # The output is known where the input has its mean: there the errors of both cancel.
    size = np.sqrt(alone.own["y_bias"][1] ** 2 + 0.01 * (u - u.mean()) ** 2)
    assert_allclose(found.error[0, :, 0], size[found.rows[:, 0]], atol=2e-3)
