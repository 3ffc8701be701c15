"""Peaks of a spectrum of vibration, by what stands out of what is drawn."""

import numpy as np
import pytest

from greybox.spectral.vibration import peaks_of

HZ = np.arange(0, 500.0)


def spectrum(*peaks):
    """A level of 0 dB, with peaks of so many dB at so many Hz."""
    level = np.zeros(500)
    for hz, height in peaks:
        level = np.maximum(level, height - 0.5 * np.abs(HZ - hz))
    return 10 ** (level / 10)


@pytest.mark.parametrize(("height", "found"), [(9.6, ()), (10.4, (120.0,))])
def test_a_peak_stands_out_by_ten_decibels(height, found):
    assert peaks_of(HZ, spectrum((120, height))) == found


def test_the_three_highest_peaks_come_the_highest_first():
    assert peaks_of(HZ, spectrum((60, 15), (150, 30), (240, 20), (350, 25))) == (150.0, 350.0, 240.0)


def test_the_motion_of_the_vehicle_is_no_vibration():
    assert peaks_of(HZ, spectrum((6, 40), (120, 15))) == (120.0,)
