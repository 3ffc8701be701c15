"""Levenberg-Marquardt damping after good, poor and shortened steps."""

import pytest

from greybox.engine.solve.gauss_newton.iterate import after_failure, next_damping


@pytest.mark.parametrize(
    ("damping", "length", "ratio", "expected"),
    [
        (0.0, 1.0, 0.9, 0.0),  # a good full step needs none
        (0.1, 1.0, 0.9, 0.01),
        (1e-12, 1.0, 1.0, 0.0),  # negligible damping is dropped
        (1.1e-12, 1.0, 1.0, 1.1e-13),
        (0.0, 1.0, 0.24, 0.01),  # a poor full step needs some
        (1e-9, 1.0, 0.0, 0.01),
        (0.1, 1.0, 0.26, 0.1),  # one that overshoots keeps it
        (0.1, 1.0, 0.74, 0.1),
        (0.1, 1.0, 0.76, 0.01),
        (0.1, 1.0, 0.1, 1.0),
        (0.0, 0.19, 0.9, 1e-4),  # a step cut short needs that of the last full one
        (0.1, 0.19, 0.9, 1.0),
        (0.1, 0.2, 0.9, 0.1),  # one that was halved keeps it
    ],
)
def test_it_follows_the_step(damping, length, ratio, expected):
    assert next_damping(damping, length, ratio, last_full=1e-4) == pytest.approx(expected)


def test_a_failed_line_search_raises_it_twice_at_once():
    assert after_failure(0.0) == after_failure(1e-9) == 0.01
    assert after_failure(1.0) == 100.0
