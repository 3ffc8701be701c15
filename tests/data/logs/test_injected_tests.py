"""Tests that flight controllers inject themselves: found, measured and identified."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.logs.injected_tests import injected_tests
from greybox.models.polynomial import Polynomial
from greybox.workflows.identification.choices import choose
from greybox.workflows.identification.measurement import measure
from tests.support.rate_loops import GAIN, LAG, autotuning, blackbox


def measured(log):
    settings, _ = choose(log)
    return measure(log, settings)


def off_truth(response, gain):
    """Return the relative errors of a response, without its delay."""
    s = 1j * response.omega
    truth = gain / (s * (LAG * s + 1))
    return np.abs(np.abs(response.response / truth) - 1)


def test_a_chirp_of_betaflight_is_identified_without_options_of_its_test(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(blackbox())
    # To choose among all structures would take 3 s more.
    fit = gb.identify(path, structures=[Polynomial(2, 0, 1, delay=0.1)], starts=5).fit
    for name, truth in (("b0", np.deg2rad(GAIN / LAG)), ("a1", 1 / LAG)):
        assert abs(fit.estimate[name] - truth) < 3 * fit.standard_error[name], name


@pytest.mark.parametrize(("axis", "states_axis", "fine"), [(1, True, False), (0, False, True)])
def test_the_debug_fields_or_the_setpoint_have_the_axis(tmp_path, axis, states_axis, fine):
    path = tmp_path / "log.csv"
    path.write_text(blackbox(axis, states_axis=states_axis, fine=fine))
    log = gb.read(path)
    result = measured(log)
    (test,) = result.used
    assert (test.kind, test.axis) == ("sweep", ("roll", "pitch")[axis])
    assert (test.start, test.end) == pytest.approx((5, 17), abs=0.01)
    np.testing.assert_allclose(test.band, 2 * np.pi * np.array([0.5, 60]), rtol=0.1)
    assert result.signals["u"] == f"axisSum[{axis}]"
    assert np.median(off_truth(result.response, np.deg2rad(GAIN))) < 0.02
    assert any("0.1 deg/s" in text for text in log.findings) != fine


def test_other_debug_fields_are_no_chirp(tmp_path):
    path = tmp_path / "log.csv"
    head, *rows = blackbox(seconds=3.0).splitlines()
    numbers = np.random.default_rng(0).integers(0, 31_000, len(rows))
    place = head.split(",").index("debug[0]")
    cells = [row.split(",") for row in rows]
    other = [
        [*row[:place], str(n), *row[place + 1 :]] for row, n in zip(cells, numbers, strict=True)
    ]
    path.write_text("\n".join([head, *map(",".join, other)]) + "\n")
    log = gb.read(path)
    assert "chirp" not in log["log"].signals
    assert not [*injected_tests(log)]


def test_an_autotuning_of_px4_is_measured_without_options():
    log = autotuning()
    result = measured(log)
    (test,) = result.used
    assert (test.kind, test.axis) == ("noise", "pitch")
    steps = log["autotune_attitude_control_status"]
    band = (12 * np.pi / test.duration, np.pi / steps.step)
    np.testing.assert_allclose(test.band, band, rtol=0.05)
    assert result.signals["instrument"].endswith("rate_sp[1]")
    assert np.median(off_truth(result.response, GAIN)) < 0.02


@pytest.mark.parametrize("by_hand", [True, False])
def test_a_setpoint_that_follows_the_stick_is_no_test(tmp_path, by_hand):
    """Betaflight's setpoint is the stick's, so that a sine in both is flown by hand."""
    time = np.arange(0, 30, 0.01)
    sine = 100 * np.sin(4 * time)
    columns = {"loopIteration": 10 * np.arange(time.size), "time": 1e6 * time}
    columns |= {"rcCommand[1]": by_hand * sine, "setpoint[1]": sine, "axisP[1]": sine}
    path = tmp_path / "log.csv"
    np.savetxt(
        path,
        np.transpose([*columns.values()]),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    tests = gb.logs.find_segments(gb.read(path))
    assert tests
    assert all(test.usable != by_hand for test in tests)
