"""Real flights: estimates against regressions by numpy alone, and predictions of a flight that no fit has seen."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.models.specific_force import BodyDrag, RotorThrust
from greybox.problems import nanobench_drag, nanobench_thrust

pytestmark = pytest.mark.usefixtures("unjudged_file")


@cache
def drag(**fixed):
    return gb.fit(nanobench_drag.problem(**fixed), starts=1, progress=False)


@cache
def thrust():
    return gb.fit(nanobench_thrust.problem(), starts=1, progress=False)


def rms(error):
    return np.sqrt(np.nanmean(error**2))


def test_the_thrust_is_that_of_a_regression_on_the_lagged_command():
    fit, flights = thrust(), nanobench_thrust.data()
    keep = np.exp(-0.01 / fit.estimate["T_rotor"])
    rows, measured = [], []
    for flight in flights:
        lagged = flight["u"][0] + lfilter([0, 1 - keep], [1, -keep], flight["u"] - flight["u"][0])
        rows.append(np.column_stack([np.ones(len(flight)), lagged, flight["V"]])[50:])
        measured.append(flight["a_z"][50:])
    values = np.linalg.lstsq(np.vstack(rows), np.concatenate(measured), rcond=None)[0]
    for name, value in zip(("c_0", "c_u", "c_V"), values, strict=True):
        assert fit.estimate[name] == pytest.approx(value, abs=fit.standard_error[name] / 4)


def test_the_thrust_predicts_another_flight_better_than_hover():
    flight, fit = nanobench_thrust.held_out(), thrust()
    begins = [piece["u"][0] for piece in flight.pieces]
    predicted = gb.simulate(RotorThrust(), fit.estimate, flight, initial={"w": begins})
    assert rms(predicted["a_z"] - flight["a_z"]) < 0.5 * rms(9.81 - flight["a_z"])


def test_the_real_drag_is_linear():
    """Real flights do not support the quadratic drag of (4.23); another flight decides likewise."""
    linear, quadratic, both = drag(C_x=0.0), drag(a5=0.0), drag()
    assert gb.validation.nested_test(linear, both).p_value > 0.1
    assert gb.validation.nested_test(quadratic, both).p_value < 1e-4

    flight = nanobench_thrust.held_out()
    errors = []
    for fit in (linear, quadratic):
        values = {name: fit.estimate[name] for name in BodyDrag().parameters}
        predicted = gb.simulate(BodyDrag(), values, flight)
        differences = (flight[axis] - predicted[axis] for axis in ("a_x", "a_y"))
        errors.append(rms(np.concatenate([d - np.nanmean(d) for d in differences])))
    assert errors[0] < 0.85 * errors[1]


def test_the_linear_drag_is_that_of_a_regression_on_the_delayed_velocity():
    fit = drag(C_x=0.0)
    shift = round(fit.estimate["T_delay"] / 0.01)
    slopes = []
    for flight in nanobench_drag.data():
        for v, a in (("v_x", "a_x"), ("v_y", "a_y")):
            velocity, force = flight[v][:-shift], flight[a][shift:]
            slopes.append(-np.polyfit(velocity, force, 1)[0])
    assert fit.estimate["a5"] == pytest.approx(np.mean(slopes), abs=2 * fit.standard_error["a5"])
