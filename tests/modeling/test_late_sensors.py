"""Outputs that are measured late: exact shifts, the response of a delay, and delays that are found again."""

import numpy as np
import pytest
from lateral_aircraft import LATERAL, Lateral, disturbed, doublets
from numpy.testing import assert_allclose
from spring_lag_tilt import SPRING, Spring, assert_true, fit

import greybox as gb
from greybox.modeling.model import Names
from greybox.modeling.model_reference import reference, resolve

LATE = gb.modeling.late_sensors(Lateral(), delays={"beta": (0.01, 0.3)}, lags={"a_y": (0.01, 0.3)})
TIMES = {"beta_delay": 0.1, "a_y_lag": 0.06}


def test_in_the_frequency_domain_they_are_a_delay_and_a_lag():
    omega = np.geomspace(0.1, 10, 20)  # up to one radian of the delay
    for output, factor in (
        ("beta", np.exp(-0.1j * omega)),
        ("a_y", 1 / (0.06j * omega + 1)),
        ("r", 1.0),
    ):
        late, prompt = (
            gb.modeling.frequency_response(
                model, values, omega, input="rudder", output=output
            ).response
            for model, values in ((LATE, LATERAL | TIMES), (Lateral(), LATERAL))
        )
        assert_allclose(late, factor * prompt, rtol=0.01)


def test_the_delay_of_a_vane_is_found_again_with_the_aircraft():
    n, late = 200, 3
    inputs = doublets(2, n + late, 0.1, 3)
    sensors = {"beta": 0.003, "p": 0.01, "r": 0.005, "phi": 0.004, "a_y": 0.02}
    prompt = disturbed(Lateral(), LATERAL, inputs, 0.04, {}, sensors, 3)
    signals = {name: prompt[name][late:] for name in prompt.signals} | {
        "beta": prompt["beta"][:-late]
    }
    record = gb.Record(prompt.time[:-late], signals)
    model = gb.modeling.late_sensors(Lateral(), delays={"beta": (0.02, 0.3)})
    found = fit(gb.Problem(model, record, gb.OutputError(inputs="held")))
    assert_true(found, LATERAL | {"beta_delay": late * 0.04}, 4.0)
    assert found.standard_error["beta_delay"] < 0.01


def test_a_stored_model_is_the_same_and_sensors_at_rest_show_what_is():
    again = resolve(reference(LATE), [Lateral])
    assert (again.states, list(again.parameters)) == (LATE.states, list(LATE.parameters))
    model = gb.modeling.late_sensors(Spring(), delays={"x": (0.01, 0.2)}, lags={"v": (0.01, 0.2)})
    values = SPRING | {"x_delay": 0.1, "v_lag": 0.05}
    rest = gb.modeling.linearize(model, values, {"F": 2.0})
    assert_allclose(np.linalg.eigvals(rest.A).real.max(), -0.6)  # the spring's, of half its damping
    flown = gb.virtual_flight(model, values, excitation={"F": np.full(600, 2.0)}, rate=20.0)
    assert_allclose(flown["x"][-1], 2.0 * SPRING["b"] / SPRING["k"], rtol=1e-3)


class Pendulum(gb.StateSpace):
    """With a trim of its own."""

    states, inputs, outputs = ("angle", "rate"), ("torque",), ("angle",)
    k = gb.Parameter(2.0, bounds=(0, 10))

    def derivative(self, x, u, p):
        return (x.rate, u.torque - p.k * gb.sin(x.angle) - x.rate)

    def output(self, x, u, p):
        return x.angle

    def trim(self, at, p):
        return {"torque": p.k * gb.sin(at.angle)}


def test_at_a_trim_of_the_model_sensors_rest_too():
    for kind in ("delays", "lags"):
        model = gb.modeling.late_sensors(Pendulum(), **{kind: {"angle": (0.01, 0.2)}})
        values = {"k": 2.0, f"angle_{kind[:-1]}": 0.05}
        point = gb.modeling.linearize(model, values, {"angle": 0.5}).point
        shown = model.output(Names(point), Names(point), Names(values))
        assert float(shown[0]) == pytest.approx(0.5)


class Decay(gb.StateSpace):
    """With one derivative and one output."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    a = gb.Parameter(2.0, bounds=(0.1, 5))

    def derivative(self, x, u, p):
        return u.u - p.a * x.y

    def output(self, x, u, p):
        return x.y


def test_a_single_derivative_or_output_needs_no_tuple():
    model = gb.modeling.late_sensors(Decay(), lags={"y": (0.01, 0.2)})
    s = 1j * np.array([1.0, 5.0])
    assert_allclose(
        gb.frequency_response(model, {"y_lag": 0.1}, s.imag).response, 1 / ((s + 2) * (0.1 * s + 1))
    )


def test_what_is_no_late_sensor_is_refused():
    for options, reason in (
        ({"delays": {"alpha": (0.1, 0.2)}}, "no output 'alpha'"),
        ({"lags": {"beta": (0.0, 0.2)}}, "give 0 < low < high"),
        ({"lags": {"p": (0.1, 0.2)}, "delays": {"p": (0.1, 0.2)}}, "a delay and a lag"),
    ):
        with pytest.raises(ValueError, match=reason):
            gb.modeling.late_sensors(Lateral(), **options)


def test_late_sensors_have_states_and_a_parameter_between_their_bounds():
    assert LATE.label == f"{Lateral().label}, late beta, a_y"
    added = ("beta_delay_0", "beta_delay_1", "a_y_lag_0")
    assert LATE.states == (*Lateral().states, *added)
    assert (LATE.inputs, LATE.outputs) == (tuple(Lateral().inputs), tuple(Lateral().outputs))
    for name, kind, sensor in (("beta_delay", "delay", "beta"), ("a_y_lag", "lag", "a_y")):
        parameter = LATE.parameters[name]
        assert parameter.start == pytest.approx(np.sqrt(0.01 * 0.3))
        assert (parameter.bounds, parameter.unit) == ((0.01, 0.3), "s")
        assert parameter.about == f"{kind} of the sensor of {sensor}"
    for bounds in ((0.2, 0.2), (0.3, 0.2), (0.1, np.inf)):
        with pytest.raises(
            ValueError, match=r"the lag of 'p' has the bounds .*: give 0 < low < high, in s"
        ):
            gb.modeling.late_sensors(Lateral(), lags={"p": bounds})

    class Taken(Decay):
        y_lag_0 = gb.Parameter(1.0)

    with pytest.raises(ValueError, match="already has 'y_lag_0'"):
        gb.modeling.late_sensors(Taken(), lags={"y": (0.1, 0.2)})


def test_what_a_sensor_shows_follows_the_output_through_its_states():
    """A delay is the quotient of 1 ∓ sT/2 + (sT)²/12."""
    late = gb.modeling.late_sensors(Decay(), delays={"y": (0.01, 0.5)})
    s = 1j * np.array([0.7, 4.0, 20.0])
    found = gb.frequency_response(late, {"a": 3.0, "y_delay": 0.3}, s.imag).response
    assert_allclose(
        found, (1 - 0.15 * s + 0.09 * s**2 / 12) / (1 + 0.15 * s + 0.09 * s**2 / 12) / (s + 3)
    )
