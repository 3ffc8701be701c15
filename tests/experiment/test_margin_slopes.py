"""Derivatives of margins, held against closed forms and against differences of margins."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rate_control import RATE, RateDynamics, RateLoop

import greybox as gb
from greybox.models.ardupilot import AngleController, RateController
from greybox.models.tilt import NonlinearTilt

PILOT = [AngleController(), RateController(signals={"q": "theta_dot"})]


class Integrator(gb.TransferFunction):
    """K / s with a delay of T."""

    input, output = "u", "q"
    K = gb.Parameter(8.0, bounds=(1, 100))
    T = gb.Parameter(3 / RATE, bounds=(0, 0.1), unit="s")

    def response(self, s, p):
        return p.K / s * gb.exp(-p.T * s)


def test_an_integrator_in_a_sampled_loop_has_closed_forms():
    # Held over a sample h, K / s is K h / (z - 1): |P| = K h / (2 sin(w h / 2)) and a phase of
    # -90 degrees - w (h / 2 + T), of which a proportional controller changes nothing.
    h, gain = 1 / RATE, 8.0 * 0.15
    omega = 2 / h * np.arcsin(gain * h / 2)
    late = h / 2 + 3 * h
    slopes = gb.experiment.margin_slopes(Integrator(), RateLoop({"K_I": 0.0}))
    by_gain = 0.15 / np.cos(omega * h / 2)  # of the crossover
    assert_allclose(slopes["crossover"]["K"], by_gain, rtol=1e-7)
    assert_allclose(slopes["phase margin"]["K"], -np.degrees(late * by_gain), rtol=1e-7)
    lag = np.pi / 2 - omega * late
    delay_margin = -late * by_gain / omega - lag / omega**2 * by_gain
    assert_allclose(slopes["delay margin"]["K"], delay_margin, rtol=1e-7)
    assert_allclose(slopes["gain margin"]["K"], -20 / np.log(10) / 8.0, rtol=1e-7)
    # Behind three samples, a share d of a sample mixes two samples: L becomes L (1 - d + d / z).
    later = (np.cos(omega * h) - 1) / h * 2 / h * np.tan(omega * h / 2)  # of the crossover
    assert_allclose(slopes["crossover"]["T"], later, rtol=1e-7)
    by_delay = -np.degrees(np.sin(omega * h) / h + late * later)
    assert_allclose(slopes["phase margin"]["T"], by_delay, rtol=1e-7)


def test_a_fast_loop_has_the_slopes_of_the_continuous_one():
    # k / s e^(-s L) has a phase margin of pi / 2 - k L, a delay margin of pi / (2 k) - L, and a
    # gain margin of pi / (2 k L). A loop at 2 kHz holds its control for another half sample.
    P, k, T = 0.15, 1.2, 0.0753
    late = T + 0.5 / 2000
    loop = RateLoop({"K_I": 0.0, "K_P": P}, rate=2000)
    slopes = gb.experiment.margin_slopes(Integrator(), loop, {"K": k / P, "T": T})
    decibels = 20 / np.log(10)
    for margin, by_gain, by_delay, error in (
        ("phase margin", -np.degrees(late), -np.degrees(k), 1e-5),
        ("delay margin", -np.pi / 2 / k**2, -1.0, 2e-4),
        ("gain margin", -decibels / k, -decibels / late, 2e-3),
        ("crossover", 1.0, 0.0, 1e-4),
    ):
        assert_allclose(slopes[margin]["K"], P * by_gain, rtol=error)
        assert_allclose(slopes[margin]["T"], by_delay, rtol=error, atol=error)


@pytest.mark.parametrize(
    ("model", "controller", "values", "options"),
    [
        (RateDynamics(), RateLoop(), {"tau": 0.023}, {}),
        (RateDynamics(), RateLoop(), {"a": -3.0, "tau": 0.004}, {"broken_at": "q"}),
        (NonlinearTilt(), PILOT, {"a1": -14.0}, {"at": {"theta": 0.1}}),
        (NonlinearTilt(), PILOT, {"a1": -14.0}, {"at": {"theta": 0.1}, "broken_at": "theta"}),
    ],
    ids=["rate", "unstable rate", "tilt", "angle"],
)
def test_slopes_are_those_of_differences(model, controller, values, options):
    slopes = gb.experiment.margin_slopes(model, controller, values, **options)
    assert {"phase margin", "modulus margin", "crossover"} <= {*slopes}
    center = model.values(values)
    for name, value in center.items():
        step = 1e-3 * max(abs(value), 0.01)
        high, low = (
            gb.margins(model, controller, {**center, name: value + sign * step}, **options)
            for sign in (1, -1)
        )
        for margin, by_parameter in slopes.items():
            difference = (high[margin].value - low[margin].value) / (2 * step)
            scale = max(abs(high[margin].value), 1.0)
            assert_allclose(
                by_parameter[name], difference, rtol=2e-4, atol=1e-5 * scale, err_msg=margin + name
            )


def test_a_fit_has_the_slopes_of_its_model_by_its_own_names():
    omega = np.geomspace(1, 40, 20)
    exact = gb.frequency_response(RateDynamics(), {"tau": 0.023}, omega).response
    data = gb.FrequencyResponse(omega, exact * (1 + 0.01 * np.cos(omega)), "u", "q")
    problem = gb.Problem(RateDynamics(), data, rename={"K": "gain"})
    fit = gb.fit(problem, starts=1, progress=False, profiles=False)
    slopes = gb.experiment.margin_slopes(fit, RateLoop())
    # A measured delay contains the hold of the control, which the loop has anyway.
    values = {name: fit.estimate["gain" if name == "K" else name] for name in ("K", "a", "T")}
    values["tau"] = fit.estimate["tau"] - 0.5 / RATE
    alone = gb.experiment.margin_slopes(RateDynamics(), RateLoop(), values)
    for margin, by_parameter in slopes.items():
        assert_allclose([*by_parameter.values()], [*alone[margin].values()], rtol=1e-9)
        assert [*by_parameter] == ["gain", "a", "T", "tau"]


def test_an_unstable_loop_has_no_slopes():
    with pytest.raises(ValueError, match="unstable"):
        gb.experiment.margin_slopes(RateDynamics(), RateLoop({"K_P": 9.0}))
