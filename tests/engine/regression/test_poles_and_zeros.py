"""Poles and zeros: pairs that nearly cancel."""

import pytest
from numpy.testing import assert_allclose

from greybox.engine.regression.poles_and_zeros import NearPair, near_pairs
from greybox.modeling.factored_form import upper_half


def test_an_exact_pair_is_reported():
    assert near_pairs([-2.0, -0.3], [-2.0, -5.0]) == (NearPair(-2, -2, 0.0),)
    assert near_pairs([0.0], [0.0]) == (NearPair(0, 0, 0.0),)
    assert near_pairs([], [-1.0]) == ()


def test_pairs_are_matched_once_closest_first():
    pairs = near_pairs([-1.0, -1.04, 2 + 3j, 2 - 3j], [-1.05, -8.0, 2.1 + 3j, 2.1 - 3j])
    assert [(p.zero, p.pole, p.stable) for p in pairs] == [
        (-1.04, -1.05, True),
        (2 + 3j, 2.1 + 3j, False),
    ]
    assert_allclose([p.distance for p in pairs], [0.01 / 1.05, 0.1 / abs(2.1 + 3j)])
    assert (
        near_pairs([-1e-3], [0.0]) == ()
    )  # an integrator is cancelled by a zero at the origin only
    assert near_pairs([0.01], [-0.01]) == ()


def test_a_pair_counts_below_the_tolerance_and_is_stable_off_the_axis():
    assert near_pairs([-9.0], [-10.0]) == ()  # a tenth apart
    (pair,) = near_pairs([-10.0], [-9.01])
    assert (pair.distance, pair.stable) == (pytest.approx(0.099), True)
    assert [NearPair(z, p, 0.0).stable for z, p in ((-1, 0), (0, -1), (-1, 2), (2, -1))] == [
        False
    ] * 4
    assert str(NearPair(-1 + 2j, 0.5, 0.123)) == "unstable zero -1 ± 2j and pole 0.5, 12 % apart"


def test_a_zero_is_matched_with_the_nearest_of_several_poles():
    """Each once: what is left over of three zeros and three poles finds no partner within the tolerance."""
    pairs = near_pairs([-2.0, -2.1, -9.0], [-2.11, -2.2, -30.0])
    assert [(pair.zero, pair.pole) for pair in pairs] == [(-2.1, -2.11), (-2.0, -2.2)]
    assert upper_half([-3.0, 1 - 2j, 1 + 2j, 0.5]) == [0.5, 1 + 2j, -3.0]
