"""The steering mirror: modes against SciPy, and how they move with the level."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

import greybox as gb
from greybox.models.flexible_modes import FlexibleModes, Mode
from greybox.problems import fine_steering_mirror as mirror

NU = 24


@cache
def fit(level):
    return gb.fit(mirror.problem(level), starts=1, progress=False, profiles=False)


def residuals(values, responses):
    """Return errors whose squares add up to the likelihood of four modes, in numpy alone.

    Variances of NU degrees of freedom: the cost of a point is that of Student's t. The values are
    the delay, eight for each mode, and the gains.
    """
    modes, gains = values[1:33].reshape(4, 8), values[33:].reshape(3, 3)
    s = 1j * responses[0].omega
    i, j = ([int(getattr(r, side)[1]) - 1 for r in responses] for side in ("output", "input"))
    measured, variance = (
        np.array([getattr(r, name) for r in responses]) for name in ("response", "variance")
    )
    total = gains[i, j, None]
    for mode, guess in zip(modes, mirror.MODES, strict=True):
        omega, zeta, c = 1e4 * mode[0], mode[1], mode[2:5]
        b = np.where(np.array(guess.actuators) != 1, mode[5:], 1.0)
        shape = omega**2 / (s**2 + 2 * zeta * omega * s + omega**2)
        total = total + (c[i] * b[j])[:, None] * shape
    error = total * np.exp(-1e-4 * s * values[0]) - measured
    squared = np.abs(error) ** 2 / variance
    cost = (NU + 2) / 2 * np.log1p(2 * squared / NU)
    error *= np.sqrt(cost / squared / variance)
    return np.concatenate([error.real.ravel(), error.imag.ravel()])


def test_scipy_finds_the_same_modes():
    responses = mirror.data()
    start = [1.0]
    for mode in mirror.MODES:
        start += [1e-4 * mode.omega, 0.01, *mode.sensors, *mode.actuators]
    solution = least_squares(residuals, [*start, *np.ravel(mirror.GAINS)], args=(responses,))
    answer = fit(300)
    assert 2 * solution.cost == pytest.approx(answer.cost, rel=1e-6)
    for k, mode in enumerate(solution.x[1:33].reshape(4, 8), start=1):
        names = [f"omega_{k}", f"zeta_{k}", *(f"c_{i}_{k}" for i in (1, 2, 3))]
        for name, value in zip(names, mode * [1e4, 1, 1, 1, 1, 0, 0, 0], strict=False):
            error = answer.standard_error[name]
            assert answer.estimate[name] == pytest.approx(value, abs=0.01 * error)
    assert answer.estimate["T_delay"] == pytest.approx(1e-4 * solution.x[0], rel=1e-4)


@pytest.mark.usefixtures("unjudged")
def test_every_frequency_falls_with_the_level():
    less, more = fit(mirror.LEVELS[0]), fit(mirror.LEVELS[-1])
    for name in ("omega_1", "omega_2", "omega_3", "omega_4"):
        error = np.hypot(less.standard_error[name], more.standard_error[name])
        assert less.estimate[name] - more.estimate[name] > 2 * error


def test_the_fit_says_that_four_modes_are_not_all():
    assert any("does not explain the data" in warning for warning in fit(300).warnings)


def test_modes_of_another_size_are_refused():
    with pytest.raises(ValueError, match="size of 2 outputs and 2 inputs"):
        FlexibleModes((Mode(60.0, (1.0, 2.0), (1.0, 0.5, 0.2)),))
