"""Likelihoods of tiny errors, whose curvature is that of rounding.

Every start ends at the one minimum.
"""

import numpy as np

import greybox as gb
from greybox.models.tilt import Tilt

TRUTH = {
    "a1": -14.6,
    "a2": 3.0,
    "a3": 8.5,
    "a4": 295.0,
    "a5": 0.16,
    "T_rotor": 0.048,
    "T_delay": 0.01,
}


def test_no_start_stagnates_at_relative_errors_of_a_ten_thousandth():
    omega, random = np.geomspace(0.5, 30, 40), np.random.default_rng(1)
    error = 1e-4 * (random.normal(size=40) + 1j * random.normal(size=40)) / np.sqrt(2)
    exact = gb.modeling.frequency_response(Tilt(), TRUTH, omega).response
    measured = gb.FrequencyResponse(omega, exact * (1 + error), input="u", output="theta")
    problem = gb.Problem(
        Tilt(), measured, gb.RelativeLikelihood(), fixed={"a5": 0.16}, free=("T_rotor", "T_delay")
    )
    found = gb.fit(problem, starts=20, seed=0, search="multistart", progress=False, profiles=False)
    assert (found.agreeing, len(found.minima)) == (20, 1)
    for name in found.free:
        assert abs(found.estimate[name] - TRUTH[name]) < 4 * found.standard_error[name]
