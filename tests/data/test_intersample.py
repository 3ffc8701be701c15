"""How samples are read, given for how long their values lasted."""

import math

import pytest

from greybox.data.intersample import CONTINUOUS, HELD, Intersample, intersample


@pytest.mark.parametrize("hold", [HELD, 0.05, 0.02, 0.0199, 0.016])
def test_a_value_that_lasts_for_a_step_or_more_is_held(hold):
    assert intersample(hold, 0.02) == Intersample(True)


@pytest.mark.parametrize("hold", [CONTINUOUS, 0.0025, 0.005, 0.01])
def test_one_that_lasts_for_less_is_interpolated_and_acts_half_of_that_later(hold):
    assert intersample(hold, 0.02) == Intersample(False, hold / 2)


def test_a_single_sample_has_no_step():
    assert intersample(CONTINUOUS, math.nan) == Intersample(False)


def test_it_is_said_in_words():
    assert str(intersample(HELD, 0.02)) == "held until the next sample"
    assert str(intersample(CONTINUOUS, 0.02)) == "interpolated"
    assert str(intersample(0.0025, 0.02)) == "interpolated, 1.25 ms late"
