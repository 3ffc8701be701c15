"""What sampling adds to the response to a held input, against sums over the samples of one pulse."""

import numpy as np
import pytest

from greybox.modeling.held_inputs import folded_back


@pytest.mark.parametrize("late", [0.3, 1.5, 2.7])
@pytest.mark.parametrize("x", [0.3 + 0.8j, 0.1 + 2.5j])
def test_what_sampling_adds_is_what_the_samples_of_a_pulse_show(x, late):
    k = np.arange(400)
    # One held value is a pulse of one hold. The delay and the hold are divided out.
    to_response = np.exp(x * late - x * k) * x / (1 - np.exp(-x))
    pulse = (k >= late) & (k < late + 1)
    integral = np.clip(k - late, 0, 1)
    step, ramp, slope = folded_back(x, late)
    assert step == pytest.approx((pulse * to_response).sum() - 1, abs=1e-9)
    assert ramp == pytest.approx((integral * to_response).sum() - 1 / x, abs=1e-4)
    earlier, later = (folded_back(x, late + h)[1] for h in (-1e-5, 1e-5))
    assert slope == pytest.approx((later - earlier) / 2e-5, abs=1e-3)
