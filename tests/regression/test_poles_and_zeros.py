"""Poles and zeros: pairs that nearly cancel, and the factored form of (3.18)."""

import numpy as np
from numpy.testing import assert_allclose
from rational_functions import OMEGA, PITCH, ROLL, YAW, expand, numbers, polynomial, table

from greybox.regression.levy import levy
from greybox.regression.poles_and_zeros import NearPair, factored, near_pairs


def test_an_exact_pair_is_reported():
    assert near_pairs([-2.0, -0.3], [-2.0, -5.0]) == (NearPair(-2, -2, 0.0),)
    assert near_pairs([0.0], [0.0]) == (NearPair(0, 0, 0.0),)
    assert near_pairs([], [-1.0]) == ()


def test_pairs_are_matched_once_closest_first():
    pairs = near_pairs([-1.0, -1.04, 2 + 3j, 2 - 3j], [-1.05, -8.0, 2.1 + 3j, 2.1 - 3j])
    assert [(p.zero, p.pole, p.stable) for p in pairs] == [(-1.04, -1.05, True), (2 + 3j, 2.1 + 3j, False)]
    assert_allclose([p.distance for p in pairs], [0.01 / 1.05, 0.1 / abs(2.1 + 3j)])
    assert near_pairs([-1.0], [-1.05], tolerance=0.01) == ()
    assert near_pairs([-1e-3], [0.0]) == ()  # an integrator is cancelled by a zero at the origin only
    assert near_pairs([0.01], [-0.01]) == ()


def test_factored_inverts_expand():
    for form in (ROLL, PITCH, YAW):
        assert_allclose(numbers(factored(*expand(form))), numbers(form), rtol=1e-9)
    unstable = factored(*[2 * polynomial([0.2 + 10j]), polynomial([4, -0.5])])
    assert_allclose(unstable.zero_quadratics, [(-0.4, 100.04)])
    assert_allclose([unstable.gain, *unstable.time_constants, *unstable.unstable], [4, 2, -4])
    assert str(unstable) == "4 (s² - 0.4 s + 100) / [(2 s + 1) (s - 4)]"
    assert str(factored([2.0, 0.0], [4.0])) == "0.5 s"


def test_factored_form_is_the_same_function():
    fit = levy(table("roll"), 4, 1)
    numerator, denominator = expand(fit.factored)
    s = 1j * OMEGA
    assert_allclose(np.polyval(numerator, s) / np.polyval(denominator, s), fit.response(OMEGA).response, rtol=1e-9)
