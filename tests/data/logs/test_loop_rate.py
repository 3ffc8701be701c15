"""A thinned log, held against a loop that is run sample by sample with its gyro on a clock of its own."""

import math

import numpy as np
import pytest

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.logs.loop_rate import (
    low_pass,
    remaining_alternation,
    thinning,
    thinning_error,
)
from greybox.data.record import Record, Recording
from greybox.workflows.identification.systematic_errors import (
    systematic_errors,
    with_systematic_errors,
)

LOOP, GYRO = 400.0, 1000.0
SETTINGS = {
    "SCHED_LOOP_RATE": LOOP,
    "INS_GYRO_FILTER": 20.0,
    "ATC_RAT_PIT_D": 0.01,
    "ATC_RAT_PIT_FLTD": 20.0,
}


def log(rate, **more):
    time = np.arange(0, 20, 1 / rate)
    modes = ((0.0, "SYSTEMID"),) if more.pop("systemid", False) else ((0.0, "STABILIZE"),)
    return Recording(
        {"RATE": Record(time, {"POut": time})},
        metadata={"parameters": SETTINGS | more, "modes": modes},
    )


def test_a_complete_log_has_no_such_error():
    assert thinning(log(400), "RATE.POut", 0, 20) is None
    assert thinning(log(360), "RATE.POut", 0, 20) is None


@pytest.mark.parametrize(
    ("gyro", "stride", "share"), [(0, 2, 0.2), (0, 3, 0.0), (0, 4, 0.2), (1, 2, 0.0)]
)
def test_kept_passes_differ_where_the_gyro_does_not_fit_the_loop(gyro, stride, share):
    """1 kHz at 400 Hz are two and three samples in turn; 2 kHz are five in every pass."""
    found = thinning(log(400 / stride, INS_GYRO_RATE=gyro), "RATE.POut", 0, 20)
    assert found.stride == stride
    assert found.count == pytest.approx(share, abs=1e-12)


def test_the_error_is_that_of_a_simulated_loop():
    """The D term of a sine from a filtered gyro: amplitude in every second pass against that in all."""
    omega, seconds = 12.0, 60
    ticks = np.arange(seconds * int(GYRO))
    angle = np.sin(omega * ticks / GYRO)
    step = 1 / GYRO
    wc = 2 * math.pi * 20
    filtered, x, v = np.empty(ticks.size), 0.0, 0.0
    for k, rate in enumerate(np.gradient(angle, step)):  # the second-order filter, by small steps
        v += step * (wc**2 * (rate - x) - math.sqrt(2) * wc * v)
        x += step * v
        filtered[k] = x
    newest = np.floor(np.arange(1, seconds * int(LOOP)) * GYRO / LOOP + 0.3).astype(int)
    raw = np.diff(filtered[newest]) * LOOP
    alpha = 1 / (1 + LOOP / (2 * math.pi * 20))
    d, term = 0.0, np.empty(raw.size)
    for k, value in enumerate(raw):
        d += alpha * (value - d)
        term[k] = d
    t = np.arange(2, seconds * int(LOOP)) / LOOP
    stride = slice(2001, None, 2)
    amplitudes = [
        2 * np.mean(term[rows] * np.exp(-1j * omega * t[rows]))
        for rows in (slice(2000, None), stride)
    ]
    measured = abs(amplitudes[1] / amplitudes[0] - 1)

    # A plant whose control is all D term: P = 1 / (0.01 s² F), F both filters.
    s = 1j * omega
    low_pass = wc**2 / (s**2 + math.sqrt(2) * wc * s + wc**2)
    plant = 1 / (0.01 * s**2 * low_pass / (1 + s / (2 * math.pi * 20)))
    response = FrequencyResponse([omega], [plant], "u", "theta", units={"theta": "rad"})
    flown = log(200)
    found = thinning(flown, "RATE.POut", 0, 20)
    stated = float(np.linalg.norm(thinning_error(found, flown, "pitch", response)))
    assert measured == pytest.approx(
        math.sqrt(2) * stated, rel=0.05
    )  # without a drift of the clocks


@pytest.mark.parametrize(
    ("settings", "cure"),
    [
        (
            {"LOG_BITMASK": 137117, "systemid": True},
            "set LOG_BITMASK 137119 (fast and medium attitude",
        ),
        ({"LOG_BITMASK": 2}, "set LOG_BITMASK 3 (fast attitude)"),
        ({"LOG_BITMASK": 3, "LOG_FILE_RATEMAX": 200.0}, "set LOG_FILE_RATEMAX 0 (it is 200 Hz)"),
        ({"LOG_BITMASK": 3}, "log to a faster card"),
    ],
)
def test_the_answer_says_how_to_log_instead(settings, cure):
    found = thinning(log(200, **settings), "RATE.POut", 0, 20)
    assert cure in found.cure
    assert str(found) == "every second pass of the control loop was logged (200 of 400 Hz)"


def test_a_response_has_it_as_an_error_that_all_frequencies_have_in_common():
    omega = np.array([4.0, 8.0, 16.0])
    response = 90 / (1j * omega * (1j * omega + 0.7) * (0.05j * omega + 1))
    own = (0.002 * np.abs(response)) ** 2
    measured = FrequencyResponse(
        omega, response, "u", "theta", variance=own, units={"theta": "rad"}
    )
    flown = log(200)
    errors = systematic_errors(flown, flown["RATE"], measured, "RATE.POut", ())
    wider = with_systematic_errors(measured, errors)
    common = (
        thinning_error(thinning(flown, "RATE.POut", 0, 20), flown, "pitch", measured) * response
    )
    assert wider.common_errors == pytest.approx(common)
    assert wider.variance * wider.independent_share == pytest.approx(own)
    assert "all frequencies" in errors[0].finding.text


@pytest.mark.parametrize(("stride", "said"), [(2, "second"), (3, "third"), (4, "4th")])
def test_which_passes_were_logged_is_said(stride, said):
    found = thinning(log(400 / stride), "RATE.POut", 0, 20)
    assert (
        str(found)
        == f"every {said} pass of the control loop was logged ({400 / stride:.4g} of 400 Hz)"
    )


@pytest.mark.parametrize(
    ("cutoff", "passed"), [(None, 1.0), (0.0, 1.0), (20.0, 0.136), (400.0, 0.758)]
)
def test_what_is_left_of_an_alternation_behind_the_filter(cutoff, passed):
    """A first-order filter at the loop's rate, run on 1, -1, 1, -1, ...; without a cutoff there is none."""
    flown = log(200)
    parameters = {
        name: v for name, v in flown.metadata["parameters"].items() if name != "ATC_RAT_PIT_FLTD"
    }
    stated = parameters if cutoff is None else parameters | {"ATC_RAT_PIT_FLTD": cutoff}
    alpha = 1 / (1 + LOOP / (2 * math.pi * cutoff)) if cutoff else 1.0
    value = 0.0
    for k in range(2000):
        value += alpha * ((-1) ** k - value)
    assert remaining_alternation(stated, "pitch", LOOP) == pytest.approx(abs(value), rel=1e-9)
    assert remaining_alternation(stated, "pitch", LOOP) == pytest.approx(passed, rel=0.01)
    assert remaining_alternation(stated, "nothing", LOOP) == 1.0


def test_the_mode_is_that_in_which_the_test_began():
    flown = log(200, LOG_BITMASK=2)
    moments = ((0.0, "STABILIZE"), (5.0, "SYSTEMID"), (15.0, "LOITER"))
    flown = Recording(dict(flown.records), metadata={**flown.metadata, "modes": moments})
    cures = [thinning(flown, "RATE.POut", start, 20).cure for start in (0.0, 4.9, 5.0, 14.0, 15.0)]
    assert ["both" in cure for cure in cures] == [False, False, True, True, False]


def test_what_is_not_known_is_not_judged():
    assert thinning(log(200, SCHED_LOOP_RATE=0.0), "RATE.POut", 0, 20) is None
    assert thinning(log(200), "RATE.POut", 0.0, 0.0051) is None  # two samples
    assert thinning(log(200), "RATE.POut", 0.0, 0.0101) is not None
    flown = log(200)
    del flown.metadata["parameters"]["INS_GYRO_FILTER"]
    assert thinning(flown, "RATE.POut", 0, 20) is None
    assert thinning(log(320.5), "RATE.POut", 0, 20) is None
    assert thinning(log(319.5), "RATE.POut", 0, 20).stride == 1


def test_filters_of_first_and_second_order_are_butterworths():
    cutoff = 20.0
    s = 2j * math.pi * cutoff * np.array([0.1, 1.0, 10.0])
    poles = 2 * math.pi * cutoff * np.exp(1j * math.pi * np.array([0.75, 1.25]))
    omega = s.imag
    assert low_pass(2, cutoff, omega) == pytest.approx(
        np.prod(poles) / ((s - poles[0]) * (s - poles[1]))
    )
    assert low_pass(1, cutoff, omega) == pytest.approx(1 / (1 + s / (2 * math.pi * cutoff)))
    assert np.all(low_pass(1, 0.0, omega) == 1)


@pytest.mark.parametrize("doubled", [0, 1, 2, 3])
def test_every_third_pass_of_a_gyro_that_does_not_fit_by_thirds(doubled):
    """INS_GYRO_RATE doubles 1 kHz. At 300 Hz, of three passes one has a sample more or less than the two others.

    Kept ones of a random phase: their number is off by 2/3 in a third of the cases, by 1/3 in the
    others; their age by a third of an interval more or less in two thirds of them.
    """
    found = thinning(log(100, SCHED_LOOP_RATE=300.0, INS_GYRO_RATE=doubled), "RATE.POut", 0, 20)
    gyro = 1000 * 2**doubled
    assert (found.stride, found.loop, found.logged) == (3, 300.0, pytest.approx(100))
    assert found.count == pytest.approx(math.sqrt((4 / 9 + 2 / 9) / 3) / (gyro / 300), rel=0.05)
    assert found.age == pytest.approx(math.sqrt(2 / 27) / gyro, rel=0.05)


def test_the_newest_sample_is_a_quarter_of_an_interval_older_or_younger_in_every_second_pass():
    """1 kHz at 400 Hz: passes come at the sample and half an interval after it, in turn."""
    assert thinning(log(200), "RATE.POut", 0, 20).age == pytest.approx(0.25e-3, rel=1e-6)
    assert thinning(log(200, INS_GYRO_RATE=1), "RATE.POut", 0, 20).age == pytest.approx(
        0, abs=1e-12
    )


def test_the_error_of_a_response_to_a_rate_is_its_own_d_term_and_a_delay():
    """A rate has passed the filters of the gyro already; half of the square of either error remains as clocks drift."""
    omega = np.array([3.0, 7.0, 19.0])
    s = 1j * omega
    plant = 40 / (s + 3.0) * np.exp(-0.02 * s)
    flown = log(200)
    found = thinning(flown, "RATE.POut", 0, 20)
    response = FrequencyResponse(omega, plant, "u", "q", units={"q": "rad/s"})
    count, age = thinning_error(found, flown, "pitch", response)
    corner = 2 * math.pi * 20.0
    passed = 1 / (1 + LOOP / corner)
    passed /= 2 - passed
    assert count == pytest.approx(0.01 * s * plant / (1 + s / corner) * 0.2 * passed / math.sqrt(2))
    assert age == pytest.approx(s * 0.25e-3 / math.sqrt(2), rel=1e-6)
    of_roll, _ = thinning_error(
        found, flown, "roll", response
    )  # whose controller has no D gain here
    assert np.all(of_roll == 0)


@pytest.mark.parametrize(("profile", "cure"), [(1, "set SDLOG_PROFILE 9 "), (9, "a faster card")])
def test_a_thinned_log_of_px4_is_warned_of(profile, cure):
    """The size of its error is unknown, so that no variance grows."""
    control = "vehicle_torque_setpoint.xyz[1]"
    omega = np.array([4.0, 8.0])
    response = FrequencyResponse(omega, 1 / (1j * omega), "u", "q", variance=0.01 / omega**2)

    def errors(rate):
        time = np.arange(0, 20, 1 / rate)
        parameters = {"IMU_GYRO_RATEMAX": 400.0, "SDLOG_PROFILE": float(profile)}
        record = Record(time, {"xyz[1]": time})
        flown = Recording({"vehicle_torque_setpoint": record}, metadata={"parameters": parameters})
        return systematic_errors(flown, record, response, control, ())

    (error,) = errors(100.0)
    assert error.finding.severity == "warning"
    assert "every 4th pass of the control loop was logged (100 of 400 Hz)" in error.finding.text
    assert cure in error.finding.text
    assert with_systematic_errors(response, [error]) is response
    assert errors(390.0) == []
