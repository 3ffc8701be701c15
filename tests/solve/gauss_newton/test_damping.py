"""Levenberg-Marquardt damping after good, poor and shortened steps."""

import pytest

from greybox.solve import Strategies
from greybox.solve.gauss_newton.damping import after_failure, next_damping

SETTINGS = Strategies()


@pytest.mark.parametrize(
    ("damping", "length", "ratio", "after"),
    [
        (0.0, 1.0, 0.9, 0.0),  # a good full step needs none
        (0.1, 1.0, 0.9, 0.01),
        (1e-12, 1.0, 1.0, 0.0),  # what is negligible is dropped
        (0.0, 1.0, 0.1, 0.01),  # a poor full step asks for some
        (0.1, 1.0, 0.1, 1.0),
        (0.0, 0.1, 0.9, 1e-4),  # a step cut short for that of the last full one
        (1e-6, 0.1, 0.9, 1e-4),
        (0.1, 0.1, 0.9, 1.0),
        (0.1, 0.4, 0.9, 0.1),  # one that was halved keeps it
    ],
)
def test_it_follows_the_step(damping, length, ratio, after):
    assert next_damping(SETTINGS, damping, length, ratio, last_full=1e-4) == pytest.approx(after)


def test_a_failed_line_search_raises_it_by_two_steps():
    assert after_failure(SETTINGS, 0.0) == SETTINGS.first_damping
    assert after_failure(SETTINGS, 1.0) == SETTINGS.damping_factor**2


def test_how_poor_a_full_step_is_and_how_short_another_one_decide():
    poor = SETTINGS.poor_decrease
    assert next_damping(SETTINGS, 1.0, 1.0, 0.99 * poor, 0.0) == SETTINGS.damping_factor
    assert next_damping(SETTINGS, 1.0, 1.0, poor, 0.0) == pytest.approx(1 / SETTINGS.damping_factor)
    assert next_damping(SETTINGS, 1.0, 0.19, 0.0, 0.0) == SETTINGS.damping_factor
    assert next_damping(SETTINGS, 1.0, 0.2, 0.0, 0.0) == 1.0
    assert next_damping(SETTINGS, 1.1e-12, 1.0, 1.0, 0.0) > 0
    assert next_damping(SETTINGS, 0.9e-12, 1.0, 1.0, 0.0) == 0
    # At least the first damping, which a small one has not reached by a factor.
    assert next_damping(SETTINGS, 1e-9, 1.0, 0.0, 0.0) == SETTINGS.first_damping
    assert after_failure(SETTINGS, 1e-9) == SETTINGS.first_damping
