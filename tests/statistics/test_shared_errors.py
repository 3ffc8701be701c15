"""Errors that several responses share make the estimate vary more than those of each alone."""

import numpy as np
import pytest

import greybox as gb
from greybox.statistics.shared_errors import shared_covariance

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"b": 4.0, "a": 3.0}
GAINS = (1.0, 0.7, -2.0, 0.4, 1.5)


class Rates(gb.StateSpace):
    """One lag that five sensors show, each with a known gain."""

    states, inputs = ("x",), ("u",)
    outputs = tuple(f"y{k}" for k in range(len(GAINS)))
    b = gb.Parameter(2.0, bounds=(0.1, 40))
    a = gb.Parameter(1.0, bounds=(0.1, 40))

    def derivative(self, x, u, p):
        """Return the rate of the state."""
        return p.b * u.u - p.a * x.x

    def output(self, x, u, p):
        """Return what the sensors show."""
        return tuple(gain * x.x for gain in GAINS)


def deviations(share, seeds=12):
    """Return estimates less the truth over their standard errors, (seeds, 2).

    The errors have this share of their variance in common.
    """
    omega = np.geomspace(0.3, 30, 20)
    exact = TRUTH["b"] / (1j * omega + TRUTH["a"])
    rows = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        common, *own = (
            0.05 * random.normal(size=(1 + len(GAINS), omega.size, 2)) @ np.array([1, 1j])
        )
        responses = [
            gb.FrequencyResponse(
                omega,
                gain * exact * (1 + share**0.5 * common + (1 - share) ** 0.5 * error),
                input="u",
                output=f"y{k}",
            )
            for k, (gain, error) in enumerate(zip(GAINS, own, strict=True))
        ]
        problem = gb.several(Rates(), responses, criterion=gb.SquaredRelativeError())
        fit = gb.fit(problem, 1, profiles=False, progress=False)
        rows.append([(fit.estimate[n] - TRUTH[n]) / fit.standard_error[n] for n in TRUTH])
    return np.array(rows)


@pytest.mark.parametrize("share", [0.0, 0.8])
def test_standard_errors_hold_whether_responses_share_errors_or_not(share):
    """Taken as independent, shared errors would be 2 times their standard errors."""
    # Of 5 fits, 0.4 and 2.0 are left with a probability below 1e-4.
    size = np.sqrt(np.mean(deviations(share, 12 if share else 5) ** 2))
    assert (0.6 if share else 0.4) < size < 2.0


def test_independent_errors_seldom_add_up_to_more_than_by_chance():
    omega, size, shared = np.geomspace(0.3, 30, 20), 5, 0
    for seed in range(20):
        random = np.random.default_rng(seed)
        responses = [
            (omega, random.normal(size=40), random.normal(size=(40, size)), 1.0) for _ in range(6)
        ]
        shared += shared_covariance(responses, size)[0].any()
    assert shared <= 3  # in one of fifty
