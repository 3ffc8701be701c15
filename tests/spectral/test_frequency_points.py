import math

import numpy as np
import pytest

from greybox.spectral.frequency_points import DRIFTING, FrequencyPoint, averaged, missing_samples, with_findings


def point(response=1 + 0j, error=0.01, dof=8.0, periods=10, u=1 + 0j, **values):
    common = {"start": 0.0, "end": 10.0, "u": u, "y": response * u, "r": complex(math.nan, math.nan)}
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
    errors = [s * (rng.standard_normal(40000) + 1j * rng.standard_normal(40000)) / math.sqrt(2) for s in (0.02, 0.05)]
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
        ({"drift": (-0.4, 0.0)}, "the trim of the control drifts by -0.4 where its amplitude is 1"),
        ({"saturation": 0.05}, "the control is at its limit for 5% of the time"),
        ({"periods": 1}, "one period only"),
        ({"error": 0.4}, "the standard error is 40% of the response"),
    ],
)
def test_what_is_worth_a_warning(values, words):
    (finding,) = with_findings(point(**values), []).findings
    assert words in finding


def test_what_is_not():
    clean = point(distortion=(0.05, 0.05), drift=(0.1, 0.1), saturation=math.nan, error=0.2)
    assert with_findings(clean, []).findings == ()
    assert missing_samples(0.04) == []
    assert missing_samples(0.2) == ["20% of the samples are missing"]


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_a_drift_is_held_against_the_amplitude(size):
    for share, warned in ((0.98, False), (1.02, True)):
        drifting = point(u=size * 1j, drift=(0.0, -share * DRIFTING * size))
        assert any("the trim of the output drifts" in said for said in with_findings(drifting, []).findings) == warned
