"""Errors of a response that its scatter does not show, held against their definitions."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.excited_segment import Segment
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.logs.ardupilot.motors import pwm_of_control, rounding_error
from greybox.data.record import Record, Recording
from greybox.data.spectral.experiment_quality import Finding
from greybox.workflows.identification.systematic_errors import (
    SystematicError,
    _size,
    motor_saturation,
    systematic_errors,
    truncation_error,
    with_systematic_errors,
)

QUAD = {"MOT_THST_EXPO": 0.65, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000}
QUAD |= {f"SERVO{k}_FUNCTION": 32 + k for k in (1, 2)}
STEPS = pwm_of_control(QUAD)  # per control of 1
OMEGA = 0.2 * np.pi * np.array([3, 6, 13])  # whole periods in ten seconds
TIME = np.arange(0, 30, 0.01)


def measured(**more):
    return FrequencyResponse(OMEGA, 30 / (1j * OMEGA) ** 2, "u", "theta", **more)


def flown(control, outputs=None):
    """A log of one control, and of two motors where they are given."""
    records = {"RATE": Record(TIME, {"POut": control})}
    if outputs is not None:
        records["RCOU"] = Record(TIME, {"C1": outputs[0], "C2": outputs[1], "C9": 0 * TIME})
    return Recording(records, metadata={"parameters": QUAD}), Record(
        TIME, {"u": control, "theta": 0 * TIME}
    )


def sines(amplitudes):
    """Ten seconds of each frequency, and the tests as they were found."""
    tests = [
        Segment(10.0 * k, 10.0 * k + 9.99, omega=w, amplitude=a)
        for k, (w, a) in enumerate(zip(OMEGA, amplitudes, strict=True))
    ]
    control = np.concatenate(
        [a * np.sin(w * TIME[:1000]) for w, a in zip(OMEGA, amplitudes, strict=True)]
    )
    return tests, control


def test_rounded_outputs_of_sines_count_at_each_frequency():
    """What else moves the quietest motor carries the control across the steps; the fastest sine is below one step."""
    amplitudes = np.array([3.0, 1.6, 0.4]) / STEPS
    tests, control = sines(amplitudes)
    other = np.sin(2 * np.pi * TIME) * [[0.2], [1.0]]
    recording, record = flown(control, 1500 + STEPS * control + other)
    shuffled = [
        tests[k] for k in (2, 0, 1)
    ]  # tests are found by their frequency, not by their place
    (error,) = systematic_errors(recording, record, measured(), "RATE.POut", shuffled, amplitudes)
    assert error.relative == pytest.approx(
        rounding_error(STEPS * amplitudes, 0.2 / np.sqrt(2)), rel=1e-6
    )
    assert error.common is None
    finding = error.finding
    assert (error.about, finding.about, finding.severity) == (
        "rounded outputs",
        "resolution",
        "warning",
    )
    assert finding.value == pytest.approx(0.4)
    share = f"{100 * error.relative.max():.2g}"
    assert f"whole µs: up to {share} % " in finding.text
    assert "below one step at 8.17 rad/s" in finding.text


def test_rounded_outputs_of_a_sweep_count_by_the_largest_motion_and_the_quietest_motor():
    """Without outputs in the log, a motor moves no less than its control: here as a sine of √2 times its deviation."""
    control = np.sin(3 * TIME) * np.where(TIME < 15, 1.5, 2.0) / STEPS
    recording, record = flown(control)
    halves = [Segment(0.0, 14.995, kind="sweep"), Segment(15.0, 29.995, kind="sweep")]
    (error,) = systematic_errors(recording, record, measured(), "RATE.POut", halves)
    deviations = [STEPS * np.std(part) for part in np.split(control, 2)]
    a = np.sqrt(2) * max(deviations)
    assert error.relative == pytest.approx(np.full(3, rounding_error(a, 0.0)[0]), rel=1e-6)
    assert (error.finding.severity, error.finding.value) == ("note", pytest.approx(a))
    share = f"{100 * error.relative[0]:.2g} %"
    assert (
        error.finding.text
        == f"motor outputs are whole µs: {share} are added to the standard errors."
    )
    # Of the whole record where no test was found.
    (whole,) = systematic_errors(recording, record, measured(), "RATE.POut", ())
    a = np.sqrt(2) * STEPS * np.std(control)
    assert whole.relative == pytest.approx(np.full(3, rounding_error(a, 0.0)[0]), rel=1e-6)


def test_what_is_not_worth_a_word_or_not_known_is_no_error():
    strong, record = flown(np.sin(3 * TIME) * 400 / STEPS)
    assert systematic_errors(strong, record, measured(), "RATE.POut", ()) == []
    weak, record = flown(np.sin(3 * TIME) / STEPS)
    assert systematic_errors(weak, record, measured(), "NKF1.PN", ()) == []
    other = Recording(weak.records, metadata={})
    assert systematic_errors(other, record, measured(), "RATE.POut", ()) == []


def an_error(about, relative, common=None):
    return SystematicError(about, np.array(relative), Finding(about, "note", 0.0, ""), common)


def test_errors_add_to_the_variance_and_to_its_degrees_of_freedom():
    size = np.abs(measured().response)
    own = (np.array([0.01, 0.02, 0.03]) * size) ** 2
    common = np.array([[0.02, 0.02j, -0.01], [0.01, -0.02, 0.02]])
    errors = [
        an_error("first", [0.02, 0.02, 0.02]),
        an_error("second", [0.03, 0.032, 0.0329], common),
        an_error("third", [0.001, 0.005, 0.02]),
    ]
    response = measured(variance=own, dof=np.array([4.0, 6.0, 8.0]), about={"log": "a.bin"})
    found = with_systematic_errors(response, errors)
    total = [1 + 4 + 9 + 0.01, 4 + 4 + 10.24 + 0.25, 9 + 4 + 0.0329**2 * 1e4 + 4]
    assert found.variance == pytest.approx(1e-4 * np.array(total) * size**2)
    assert found.dof == pytest.approx(np.array([4, 6, 8]) * (found.variance / own) ** 2)
    assert found.common_errors == pytest.approx(common * response.response)
    assert found.about == {
        "log": "a.bin",
        "first": "2 % of the response, in its variance",
        "second": "3.3 % of the response, in its variance",
        "third": "up to 2 % of the response, in its variance",
    }
    apart = with_systematic_errors(measured(variance=own), [an_error("apart", [0.01, 0.02, 0.03])])
    assert apart.about == {"apart": "1 to 3 % of the response, in its variance"}
    assert (apart.dof, apart.common_errors) == (None, None)
    assert with_systematic_errors(response, []) is response
    without = measured()
    assert with_systematic_errors(without, errors) is without


@pytest.mark.parametrize(
    ("samples", "severity"), [(30, ""), (31, "warning"), (600, "warning"), (601, "refusal")]
)
def test_a_motor_at_its_limit_is_told_from_one_percent_and_refused_from_twenty(samples, severity):
    outputs = np.full((2, 3000), 1500.0)
    outputs[1, :samples] = 1150
    recording, _ = flown(np.sin(TIME), outputs)
    found = motor_saturation(recording, "RATE.POut", [(0.0, 30.0)])
    assert motor_saturation(recording, "NKF1.PN", [(0.0, 30.0)]) == []
    assert [f.severity for f in found] == ([severity] if severity else [])
    for finding in found:
        assert finding.value == samples / 3000
        assert f"at its limit for {samples / 30:.0f} % of the time" in finding.text


@pytest.mark.parametrize(
    ("relative", "said"),
    [((0.02, 0.0219), "2.2 %"), ((0.02, 0.0221), "2 to 2.2 %"), ((0.001, 0.02), "up to 2 %")],
)
def test_sizes_are_one_number_where_they_are_nearly_one(relative, said):
    assert _size(np.array(relative)) == said


@pytest.mark.parametrize("step", [0.0, 2e-3])
def test_truncated_outputs_leave_the_gain_within_the_error_that_they_have_in_common(step):
    """Sines of 0.02 to 0.1, truncated toward zero: their gains are low by more than any scatter shows."""
    tests, control = sines(np.array([0.01, 0.03, 0.1]))
    gains = np.array([5.0, 2.0, 1.0])
    theta = np.concatenate([g * part for g, part in zip(gains, np.split(control, 3), strict=True)])
    theta += 1e-4 * np.random.default_rng(0).normal(size=theta.size)
    logged = np.trunc(theta / step) * step if step else theta
    record = Record(TIME, {"u": control, "theta": logged})
    response = gb.spectral.finite_frequency(record, tests).response
    flown = Recording({"IMU": Record(TIME, {"tilt": np.rad2deg(logged)})})
    errors = truncation_error(
        flown,
        record,
        response,
        "IMU.tilt",
        lambda other: gb.spectral.finite_frequency(other, tests).response,
    )
    off = np.abs(response.response) / gains - 1
    assert len(errors) == (step > 0)
    for error in errors:
        # The common error is the deviation of what is uniform up to the whole of it.
        assert np.all(np.abs(off) > 3 * response.relative_error)
        assert off == pytest.approx(-np.sqrt(3) * error.common[0].real, rel=0.25)
        assert "theta is logged in steps of 0.002" in error.finding.text
        wider = with_systematic_errors(response, errors)
        # All of it is along the response, which has half of the variance.
        assert np.all(np.abs(off) < 2 * np.sqrt(2) * wider.relative_error)
