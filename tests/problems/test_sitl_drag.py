"""The drag of the simulated flights against the settings of the simulator, and its bias in two parts."""

import numpy as np
import pytest

import greybox as gb
from greybox.problems import sitl_drag

G = 9.80665


def settings(altitude=604.0):
    """Linear and quadratic drag of ArduPilot's default frame, from SIM_Frame.h and SIM_Motor.cpp.

    The drag at the reference speed is what balances the thrust at the reference angle; the linear
    part is the momentum drag of four rotors, the rest is quadratic.
    """
    mass, speed, angle, area, momentum = 3.0, 15.08, np.radians(45), 0.385, 0.2
    density = 1.225 * (1 - 2.25577e-5 * np.array([593.0, altitude])) ** 4.25588
    along = np.cos(angle) ** 2 * momentum * speed
    rest = mass * G * np.tan(angle) - along * np.sqrt(mass * G / np.cos(angle) * density[0] * area)
    a5 = 4 * momentum * np.sqrt(density[1] * area / 4 * mass * G / 4) / mass
    return {"a5": a5, "C_x": rest / speed**2 / mass * density[1] / density[0]}


def fit(records, **fixed):
    return gb.fit(sitl_drag.problem(records, **fixed), starts=1, profiles=False, progress=False)


@pytest.mark.usefixtures("unjudged")
def test_both_drags_are_those_of_the_simulator():
    found = fit(sitl_drag.data())
    for name, value in settings().items():
        assert abs(found.estimate[name] - value) < 2 * found.standard_error[name]
        assert found.standard_error[name] < 0.1 * value


@pytest.mark.usefixtures("unjudged")
def test_the_bias_does_not_move_within_a_flight_if_the_drag_is_that_of_the_simulator():
    """There was no wind; a bias that moves comes from the drag, which one speed cannot separate from it."""
    parts = zip(
        *(
            (record.between(record.time[0], border), record.between(border, record.time[-1]))
            for record in sitl_drag.data()
            for border in [record.time[0] + 0.6 * record.duration]
        ),
        strict=True,
    )
    first, rest = (fit(part, **settings()) for part in parts)
    for name in ("theta_bias_1", "theta_bias_2"):
        error = np.hypot(first.standard_error[name], rest.standard_error[name])
        assert abs(first.estimate[name] - rest.estimate[name]) < 2 * error
    assert first.estimate["theta_bias_2"] == pytest.approx(0.006, abs=0.001)
