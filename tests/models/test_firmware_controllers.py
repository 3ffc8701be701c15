"""Control laws of firmware, against their published difference equations written down again."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, iirnotch, lfilter

import greybox as gb
from greybox.modeling.formula_arguments import Names
from greybox.models import betaflight, px4
from greybox.models.ardupilot import (
    AngleController,
    PlaneAngleController,
    PlaneRateController,
    RateController,
)
from greybox.models.digital_filters import SampledLag, SampledLowPass, SampledNotch
from greybox.workflows.experiment.sampled_loop import linear_controller


def run(controller, **signals):
    """The first output of a controller on sequences, from rest."""
    x = Names(dict(zip(controller.states, controller.initial, strict=True)))
    outputs = []
    names = (*controller.inputs, *controller.setpoints)
    for row in np.broadcast(*(signals.get(n, 0.0) for n in names)):
        u = Names(dict(zip(names, np.atleast_1d(row), strict=True)))
        following, output = controller.update(x, u, controller.values)
        x = Names(dict(zip(controller.states, map(float, following), strict=True)))
        outputs.append(float(output[0]))
    return np.array(outputs)


def walks(count, n=1500, size=0.05):
    return size * np.cumsum(np.random.default_rng(1).normal(size=(count, n)), axis=1)


def ac_pid(g, h, targets, measurements, mixer=None):
    """AC_PID::update_all and update_i; the limit flag is that of the last control."""

    def alpha(cutoff):
        return 1.0 if cutoff == 0 else h / (h + 1 / (2 * np.pi * cutoff))

    target = error = derivative = integrator = 0.0
    limit, controls = False, []
    for k, (wanted, measured) in enumerate(zip(targets, measurements, strict=True)):
        last_target, last = target, error
        target += alpha(g["FLTT"]) * (wanted - target)
        error += alpha(g["FLTE"]) * (target - measured - error)
        derivative += alpha(g["FLTD"]) * ((error - last) / h - derivative)
        if not limit or integrator * error < 0:
            integrator = np.clip(integrator + g["I"] * h * error, -g["IMAX"], g["IMAX"])
        total = g["P"] * error + integrator + g["D"] * derivative
        total += g["FF"] * target + g["D_FF"] * (target - last_target) / h
        total += 0 if mixer is None else mixer[k]
        limit = abs(total) >= 1
        controls.append(np.clip(total, -1, 1))
    return np.array(controls)


GAINS = {"P": 0.2, "I": 0.5, "D": 0.01, "FF": 0.05, "D_FF": 0.001, "IMAX": 0.1}
FILTERS = {"FLTT": 20.0, "FLTE": 2.5, "FLTD": 10.0}


@pytest.mark.parametrize("filters", [FILTERS, dict.fromkeys(FILTERS, 0.0)])
@pytest.mark.parametrize("size", [0.02, 0.3])  # never and often at a limit
def test_rate_controller_is_ac_pid(filters, size):
    targets, q, mixer = walks(3, size=size)
    gains = GAINS | filters
    expected = ac_pid(gains, 1 / 400, targets, q, 0.01 * mixer)
    controller = RateController(gains)
    given = run(controller, q=q, q_reference=targets, mixer=0.01 * mixer)
    assert_allclose(given, expected, atol=1e-12)
    assert (np.abs(expected) == 1).any() == (size == 0.3)


def test_the_notch_of_the_error_is_that_of_scipy():
    targets, q = walks(2)
    plain = dict.fromkeys(FILTERS, 0.0) | {"P": 1.0, "I": 0.0, "D": 0.0, "u_max": 10}
    notched = RateController({**plain, "notch": 60.0, "notch_Q": 3.0, "notch_depth": 100.0})
    b, a = iirnotch(60.0, 3.0, fs=400)  # of infinite depth, and of the width at -3 dB
    assert_allclose(
        run(notched, q=q, q_reference=targets), lfilter(b, a, targets - q), rtol=0.02, atol=0.02
    )


def test_plane_scales_by_airspeed():
    targets, q = walks(2, size=0.02)
    s, n = 1.3, 1.1
    pid = ac_pid(GAINS | FILTERS | {"FF": 0.0, "D_FF": 0.0}, 1 / 50, s**2 * targets, s**2 * q)
    filtered = lfilter(*_lag(20.0, 50), targets)
    forward = s / n * (0.05 * filtered + 0.001 * 50 * np.diff(filtered, prepend=0))
    controller = PlaneRateController(GAINS | FILTERS | {"scaler": s, "density": n})
    expected = np.degrees(pid + forward) / 45
    inside = np.cumprod(np.abs(expected) < 1).astype(bool)  # before the first limit
    assert inside.sum() > 300
    assert_allclose(run(controller, q=q, q_reference=targets)[inside], expected[inside], atol=1e-12)
    assert run(PlaneAngleController(), theta=0.2, reference=0.3) == pytest.approx([0.2])


def _lag(cutoff, rate):
    share = 1 / rate / (1 / rate + 1 / (2 * np.pi * cutoff))
    return [share], [1, share - 1]


def test_angle_controller_is_the_square_root_controller_and_late():
    errors = np.linspace(-2, 2, 41)
    P, a = 4.5, 9.6
    far = np.sign(errors) * np.sqrt(2 * a * (np.abs(errors) - a / P**2 / 2).clip(0))
    expected = np.where(np.abs(errors) > a / P**2, far, P * errors)
    controller = AngleController({"P": P, "acceleration": a, "delay": 2})
    given = run(controller, theta=-errors, reference=0.0)
    assert_allclose(given[2:], expected[:-2], rtol=1e-12, atol=1e-12)
    linear = AngleController({"acceleration": 0.0, "delay": 0})
    assert_allclose(run(linear, theta=-errors), 4.5 * errors)


def test_sensor_filters_are_those_of_scipy():
    (raw,) = walks(1)
    assert_allclose(
        run(SampledLowPass({"cutoff": 20.0}), raw=raw), lfilter(*butter(2, 20, fs=400), raw)
    )
    assert_allclose(run(SampledLag({"cutoff": 20.0}), raw=raw), lfilter(*_lag(20, 400), raw))
    # scipy's notch has its width between the points of -3 dB in the frequency of z.
    notch = SampledNotch({"center": 50.0, "quality": 4.0, "attenuation": 300.0})
    spectrum = np.fft.rfft(run(notch, raw=np.eye(1, 4000)[0]))
    assert np.abs(spectrum[500]) < 1e-9
    assert np.abs(spectrum[[0, -1]]) == pytest.approx([1, 1], abs=1e-6)


def test_filters_of_the_gyro_have_their_phase_in_a_slow_loop():
    # Filters at 1 kHz in a loop of 50 Hz; the notch is far above half of its rate.
    omega = 2 * np.pi * np.array([0.5, 1.0, 2.0])
    z, s = np.exp(1j * omega / 50), 1j * omega / 2 / np.pi
    for kind, values, exact in (
        (SampledLowPass, {"cutoff": 20.0}, 1 / (s**2 / 400 + 2**0.5 * s / 20 + 1)),
        (
            SampledNotch,
            {"center": 80.0, "attenuation": 300.0},
            (s**2 + 6400) / (s**2 + s * 80 / 2 + 6400),
        ),
    ):
        law = kind({**values, "gyro_rate": 1000.0}, rate=50)
        response = linear_controller([law], ("raw",), ("filtered",)).response(z)[:, 0, 0]
        # The notch of firmware is a little narrower in the frequency of z.
        assert_allclose(np.angle(response), np.angle(exact), rtol=0.05)


def test_px4_is_its_rate_control():
    targets, q = walks(2, size=0.05)
    g = {"K": 1.5, "P": 0.2, "I": 2.0, "D": 0.01, "FF": 0.1, "i_max": 0.2, "cutoff": 25.0}
    h, integral, acceleration, before, expected = 1 / 250, 0.0, 0.0, 0.0, []
    share = h / (h + 1 / (2 * np.pi * 25.0))
    limited = 0
    for wanted, rate in zip(targets, q, strict=True):
        acceleration = (1 - share) * acceleration + share * (rate - before) / h
        before, error = rate, wanted - rate
        expected.append(
            g["K"] * g["P"] * error + integral - g["K"] * g["D"] * acceleration + g["FF"] * wanted
        )
        factor = max(0.0, 1 - (np.degrees(error) / 400) ** 2)
        integral += factor * g["K"] * g["I"] * error * h
        limited += abs(integral) > 0.2
        integral = np.clip(integral, -0.2, 0.2)
    assert limited
    assert_allclose(
        run(px4.RateController(g, rate=250), q=q, q_reference=targets), expected, atol=1e-12
    )
    yaw = px4.RateController({**g, "torque_cutoff": 2.0}, rate=250)
    smooth = lfilter(*_lag(2.0, 250), expected)
    assert_allclose(run(yaw, q=q, q_reference=targets), smooth, atol=1e-12)
    turned = run(px4.AngleController({"P": 2.0}), theta=0.1, reference=0.4)
    assert turned == pytest.approx([4 * np.sin(0.15)])


@pytest.mark.parametrize("kinds", [(0, 1), (2, 3), (1, 0)])
def test_betaflight_is_its_pid_with_its_scales(kinds):
    targets, q = np.radians(walks(2, size=0.1))
    low_pass = {
        0: [_lag(90.0, 2000)],
        1: [butter(2, 90.0, fs=2000)],
        2: 2 * [_lag(90.0 * 1.553773974, 2000)],
        3: 3 * [_lag(90.0 * 1.961459177, 2000)],
    }
    filtered = np.degrees(q)
    omega, quality = 2 * np.pi * 200 / 2000, 200 * 160 / (200**2 - 160**2)
    cosine, alpha = 2 * np.cos(omega), np.sin(omega) / 2 / quality
    notch = [1, -cosine, 1], [1 + alpha, -cosine, 1 - alpha]
    for b, a in (notch, *low_pass[kinds[0]], *low_pass[kinds[1]]):
        filtered = lfilter(b, a, filtered)
    error = np.degrees(targets - q)
    delta = 2000 * np.diff(filtered, prepend=0)
    integral = 2.5 * 0.244381 * 80 / 2000 * np.cumsum(error)
    assert np.abs(integral).max() < 400
    total = 0.7 * 0.032029 * 45 * error - 0.8 * 0.000529 * 30 * delta + integral
    values = {"I_factor": 2.5, "TPA": 0.8, "TPA_P": 0.7, "lpf1": 90.0, "lpf2": 90.0, "u_max": 500.0}
    values |= dict(zip(("lpf1_type", "lpf2_type"), kinds, strict=True))
    values |= {"notch": 200.0, "notch_Q": quality}
    controller = betaflight.RateController(values, rate=2000)
    given = run(controller, q=q, q_reference=targets)
    assert_allclose(given, np.clip(total, -500, 500) / 1000, atol=1e-10)


def lag(cutoff, rate, z):
    b, a = _lag(cutoff, rate)
    return b[0] / (a[0] + a[1] / z)


def of_copter(z, rate):
    slope = lag(20.0, rate, z) * (1 - 1 / z) * rate
    return -lag(2.5, rate, z) * (0.2 + 0.5 / rate / (1 - 1 / z) + 0.01 * slope)


def of_px4(z, rate):
    # The integral acts one sample later.
    slope = lag(30.0, rate, z) * (1 - 1 / z) * rate
    return -1.5 * (0.2 + 0.5 / rate / (z - 1) + 0.01 * slope)


def of_betaflight(z, rate):
    slope = lag(75.0, rate, z) * lag(150.0, rate, z) * (1 - 1 / z) * rate
    integral = 80 * 0.244381 / rate / (1 - 1 / z)
    return -np.degrees(1) / 1000 * (45 * 0.032029 + integral + 30 * 0.000529 * slope)


GAINS_OF_LOOP = {"P": 0.2, "I": 0.5, "D": 0.01}
LAWS = {
    "copter": (RateController(GAINS_OF_LOOP | {"FLTE": 2.5}), of_copter),
    "plane": (
        PlaneRateController(GAINS_OF_LOOP | {"FLTE": 2.5, "scaler": 1.3}),
        lambda z, rate: np.degrees(1.3**2 / 45) * of_copter(z, rate),
    ),
    "px4": (px4.RateController(GAINS_OF_LOOP | {"K": 1.5}, rate=250), of_px4),
    "betaflight": (betaflight.RateController(rate=4000), of_betaflight),
}


@pytest.mark.parametrize("name", LAWS)
def test_the_loop_has_the_transfer_function_of_the_firmware(name):
    law, formula = LAWS[name]
    # Outside the unit circle, the sum over the response to an impulse converges.
    z = 1.05 * np.exp(1j * np.geomspace(0.01, 3, 7))
    expected = formula(z, law.rate)
    impulse = run(law, q=1e-6 * np.eye(1, 500)[0]) / 1e-6
    assert_allclose(impulse @ z ** -np.arange(500)[:, None], expected, rtol=1e-7)
    linear = linear_controller([law], ("q",), ("u",))
    response = linear.response(z)[:, linear.commands.index("u"), 0]
    assert_allclose(response, expected, rtol=1e-9)


def test_filters_of_order_two_and_three_have_the_cutoff_that_they_name():
    for kind, (count, correction) in betaflight.SERIES.items():
        gain = (1 + 1j / correction) ** -count
        assert abs(gain) == pytest.approx(0.5**0.5), kind


def test_a_filter_before_a_controller_is_in_the_loop():
    class Rate(gb.TransferFunction):
        input, output = "u", "p"
        K = gb.Parameter(30.0)

        def response(self, s, p):
            return p.K / s

    law = RateController({"D": 0.0, "I": 0.0}, signals={"q": "filtered"})
    chain = [SampledLowPass({"cutoff": 20.0}, signals={"raw": "p"}), law]
    loop = gb.margins(Rate(), chain)["phase margin"]
    z = np.exp(1j * loop.omega / 400)
    b, a = butter(2, 20, fs=400)
    low_pass = np.polyval(b, z) / np.polyval(a, z)
    gain = 0.135 * low_pass * 30 / 400 / (z - 1)
    assert abs(gain) == pytest.approx(1, rel=1e-8)
    assert loop.value == pytest.approx(180 - abs(np.degrees(np.angle(gain))), abs=1e-6)
    excitation = {"q_reference": 0.1 * np.ones(800)}
    flight = gb.virtual_flight(Rate(), None, excitation, controller=chain)
    assert flight["p"][-1] == pytest.approx(0.1, rel=1e-3)
    assert_allclose(flight["filtered"], lfilter(b, a, flight["p"]), atol=1e-12)
