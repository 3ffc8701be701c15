import math

import numpy as np
import pytest

from greybox.workflows.experiment.excitation import Excitation, Maneuver, checked_band, round_up

TIME = np.arange(200) / 100
SINE = Maneuver("u", "sine", 0.0, 0.0, 2.0, math.pi, math.pi, 1.0, 0.0)


def excitation(values):
    return Excitation(TIME, {"u": values}, {"u": "rad"}, schedule=(SINE,))


def test_peak_factors_of_known_signals():
    """1 for a sine about any mean; 1/√2 for a square wave, whose peak is its root mean square."""
    sine = excitation(0.3 + np.sin(math.pi * TIME))
    square = excitation(np.where(TIME < 1, 1.0, -1.0))
    assert sine.peak_factors["u"] == pytest.approx(1.0)
    assert square.peak_factors["u"] == pytest.approx(math.sqrt(0.5))


def test_an_excitation_is_a_record_with_a_schedule():
    made = excitation(np.sin(math.pi * TIME))
    with pytest.raises(ValueError, match="read-only"):
        made["u"][0] = 1.0
    assert made.rate == pytest.approx(100)
    assert made.between(0.5, 1.0).schedule == (SINE,)
    assert str(made) == "sine on u: 2.0 s at 100 Hz, 3.142 to 3.142 rad/s, peak factor 1.00"
    with pytest.raises(KeyError, match="no signal 'theta'; it has u"):
        made["theta"]


def test_a_band_ends_at_a_fifth_of_the_sampling_rate():
    limit = 2 * math.pi * 100 / 5
    np.testing.assert_array_equal(checked_band([1.0, limit], 100), [1.0, limit])
    for wrong in (0.0, -1.0, math.nan, limit * 1.001):
        with pytest.raises(ValueError, match="give frequencies above 0"):
            checked_band([1.0, wrong], 100)


@pytest.mark.parametrize(
    ("value", "whole"), [(2.0, 2), (2.0 + 1e-12, 2), (2.001, 3), (2 + 1e-7, 3), (0.1 * 30, 3)]
)
def test_rounding_up_forgives_rounding_errors(value, whole):
    assert round_up(value) == whole
