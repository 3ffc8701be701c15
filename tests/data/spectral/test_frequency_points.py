import math
from dataclasses import replace

import numpy as np
import pytest

from greybox.data.excited_segment import Segment
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.spectral.frequency_points import (
    DRIFTING,
    FiniteFrequency,
    FrequencyPoint,
    averaged,
    with_findings,
    with_unexplained,
)


def point(response=1 + 0j, error=0.01, dof=8.0, periods=10, u=1 + 0j, **values):
    common = {
        "start": 0.0,
        "end": 10.0,
        "u": u,
        "y": response * u,
    }
    common |= {"distortion": (0.0, 0.0), "drift": (0.0, 0.0), "saturation": 0.0}
    return FrequencyPoint(5.0, response, error, dof, periods, **common | values)


def test_equal_tests_average_to_half_the_variance_and_twice_the_degrees_of_freedom():
    both = averaged([point(1 + 0j), point(3 + 0j)])
    assert both.response == 2
    assert both.standard_error == pytest.approx(0.01 / math.sqrt(2))
    assert both.dof == pytest.approx(16)
    assert both.periods == 20
    assert both.notes == ("mean of 2 tests",)


def test_a_mean_counts_periods_and_control_power_and_its_variance_is_monte_carlos():
    """Weights 10·2² : 20·1² = 2 : 1, and the variance of a weighted mean of independent complex errors."""
    both = averaged([point(1 + 0j, 0.02, 4.0, 10, 2 + 0j), point(4 + 0j, 0.05, 8.0, 20)])
    assert both.response == pytest.approx(2)
    rng = np.random.default_rng(0)
    errors = [
        s * (rng.standard_normal(40000) + 1j * rng.standard_normal(40000)) / math.sqrt(2)
        for s in (0.02, 0.05)
    ]
    drawn = (2 * errors[0] + errors[1]) / 3
    assert both.standard_error == pytest.approx(np.sqrt(np.mean(np.abs(drawn) ** 2)), rel=0.02)
    assert 4 < both.dof < 12


def test_a_single_period_leaves_the_mean_without_a_variance():
    both = averaged([point(error=math.nan, dof=0.0, periods=1), point()])
    assert math.isnan(both.standard_error)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"distortion": (0.0, 0.12)}, "the output has harmonics of 12% of its sine"),
        ({"drift": (-0.4, 0.0)}, "the trim of the control drifts by -0.4, and its amplitude is 1"),
        ({"saturation": 0.05}, "the control is at its limit for 5% of the time"),
        ({"periods": 1}, "one period only"),
        ({"error": 0.4}, "the standard error is 40% of the response"),
    ],
)
def test_what_is_worth_a_warning(values, words):
    (finding,) = with_findings(point(**values), 0.0).findings
    assert words in finding


def test_what_is_not():
    clean = point(distortion=(0.05, 0.05), drift=(0.1, 0.1), saturation=math.nan, error=0.2)
    assert with_findings(clean, 0.0).findings == ()


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_a_drift_is_held_against_the_amplitude(size):
    for share, warned in ((0.98, False), (1.02, True)):
        drifting = point(u=size * 1j, drift=(0.0, -share * DRIFTING * size))
        assert (
            any(
                "the trim of the output drifts" in said
                for said in with_findings(drifting, 0.0).findings
            )
            == warned
        )


def test_the_freedom_of_a_mean_is_that_of_satterthwaite():
    """Of three tests with weights 1, 4 and 5 tenths: (Σ v)² / Σ (v² / ν) of their parts v = (w s)²."""
    tests = [
        point(1 + 1j, 0.3, 1.0, 2, 1j, findings=("a", "b"), notes=("n",), unexplained=0.02),
        point(2 - 1j, 0.2, 6.0, 2, -2 + 0j, findings=("b", "c"), unexplained=0.05),
        point(4 + 2j, 0.1, 12.0, 10, 1 + 0j, notes=("n", "m")),
    ]
    found = averaged(tests)
    parts = np.array([0.1 * 0.3, 0.4 * 0.2, 0.5 * 0.1]) ** 2
    assert found.response == pytest.approx(0.1 * (1 + 1j) + 0.4 * (2 - 1j) + 0.5 * (4 + 2j))
    assert found.standard_error == pytest.approx(math.sqrt(parts.sum()))
    assert found.dof == pytest.approx(parts.sum() ** 2 / np.sum(parts**2 / [1, 6, 12]))
    assert (found.periods, found.u) == (14, 1j)
    assert found.findings == ("a", "b", "c")
    assert found.notes == ("mean of 3 tests", "n", "m")
    assert found.unexplained == 0.05
    assert averaged(tests[:1]) is tests[0]
    # Without errors, or with one that is not known, their freedom is the sum.
    assert averaged([point(error=0.0), point(error=0.0, dof=3.0)]).dof == 11
    assert averaged([point(dof=0.0), point()]).dof == 8
    assert math.isnan(averaged([point(), point()]).unexplained)


@pytest.mark.parametrize(
    ("values", "below", "at", "said"),
    [
        (
            "distortion",
            (0.1, 0.0),
            (0.106, 0.0),
            "the control has harmonics of 11% of its sine: the response is not li",
        ),
        ("saturation", 0.02, 0.021, "the control is at its limit for 2% of the time"),
        (
            "error",
            0.3 * math.sqrt(5),
            0.31 * math.sqrt(5),
            "the standard error is 31% of the response",
        ),
        ("periods", 2, 1, "one period only: its error is not known"),
        (
            "drift",
            (0.599, 0.0),
            (0.601, 0.0),
            "the trim of the control drifts by 0.6, and its amplitude is 2",
        ),
    ],
)
def test_a_warning_begins_where_it_is_stated(values, below, at, said):
    def found(value):
        return with_findings(point(2 + 1j, u=2j, **{values: value}), 0.06).findings

    missing = "6% of the samples are missing"
    assert found(below) == (missing,)
    first, second = found(at)
    assert first == missing
    assert second.startswith(said)
    assert with_findings(point(2 + 1j), 0.05).findings == ()


def test_unexplained_harmonics_are_an_error_of_the_gain_and_told_from_three_percent():
    at = point(3 + 4j, 0.3, findings=("first",))
    small, large = with_unexplained(at, 0.03), with_unexplained(at, 0.08)
    assert small.standard_error == pytest.approx(math.hypot(0.3, 0.15))
    assert large.standard_error == pytest.approx(0.5)
    assert (small.unexplained, small.findings) == (0.03, ("first",))
    text = (
        "the plant does not explain harmonics of 8% of the control's sine: it is not linear there"
    )
    assert large.findings == ("first", text)
    for nothing in (0.0, math.nan):
        assert with_unexplained(at, nothing).standard_error == 0.3
    assert with_unexplained(at, 0.0).unexplained == 0


def test_points_are_written_and_take_other_variances():
    points = (
        point(
            -3 + 3j,
            0.095 * math.sqrt(18),
            periods=7,
            u=2j,
            distortion=(0.1234, 0.05),
            saturation=0.095,
            notes=("n",),
        ),
        point(0j, 0.1, y=0.5j, saturation=math.nan),
    )
    points = (points[0], replace(points[1], omega=8.0, findings=("f",)))
    response = FrequencyResponse([5.0, 8.0], [-3 + 3j, 0.0], "u", "theta")
    sweep = Segment(10.04, 20.0, "sweep", band=(1.0, 2.0))
    found = FiniteFrequency(response, points, ((sweep, "no sine"),))
    header, _, first, second = found.table.splitlines()[-4:]
    words = "rad/s periods |u| |y| gain phase ° error % harmonics u, y % saturated %"
    assert header.split() == words.split()
    assert first.split() == ["5", "7", "2", "8.49", "4.243", "135.00", "6.7", "12.3,", "5.0", "9.5"]
    assert second.split() == ["8", "10", "1", "0.5", "0", "0.00", "-", "0.0,", "0.0", "-"]
    assert found.notes == ("5 rad/s: n",)
    assert found.findings == ("8 rad/s: f", "sweep from 10.0 s left out: no sine")
    assert str(found) == "\n".join([found.table, *found.notes, *found.findings])
    other = found.with_variance(np.array([4.0, 9.0]))
    assert [p.standard_error for p in other.points] == [2.0, 3.0]
    assert other.response.variance.tolist() == [4.0, 9.0]
    assert found.with_variance(None) is found
