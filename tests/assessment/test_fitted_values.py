"""Curves for figures: how finely they are evaluated."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import greybox as gb
from greybox.assessment.fitted_values import refined_curve


@pytest.mark.parametrize("damping", [0.5, 0.02, 1e-9])
def test_a_curve_for_figures_is_refined_where_it_turns(damping):
    """Steps of a fiftieth of its largest magnitude and of five degrees; of a needle there are none such."""
    asked = []

    def response(omega):
        asked.append(omega.size)
        return gb.FrequencyResponse(omega, 1 / (1.0003 - omega**2 + 1j * damping * omega))

    curve = refined_curve(response, np.array([5.0, 0.2, 1.0]))
    assert asked[0] == 60
    assert (curve.omega[0], curve.omega[-1]) == pytest.approx((0.2, 5.0))
    assert np.all(np.diff(curve.omega) > 0)
    if damping == 0.5:
        assert len(curve) < 320
    steps = np.abs(np.diff(curve.response)).max() / np.abs(curve.response).max()
    turns = np.degrees(np.abs(np.angle(curve.response[1:] / curve.response[:-1])))
    if damping > 1e-3:
        assert steps <= 0.02
        assert turns.max() <= 5
        assert len(curve) < 600
    assert refined_curve(response, np.array([3.0])).omega.tolist() == [3.0]


def test_a_curve_that_hardly_turns_is_evaluated_once():
    asked = []

    def response(omega):
        asked.append(omega)
        return gb.FrequencyResponse(omega, 1 / (0.001j * omega + 1))

    assert_allclose(refined_curve(response, np.array([1.0, 4.0])).omega, np.geomspace(1, 4, 60))
    assert len(asked) == 1


def test_a_curve_of_a_jump_stops_at_two_thousand_points():
    """Every step is too coarse: 60, 119, 237, 473, 945, 1889, 3777 points, each evaluated once."""
    asked = []

    def response(omega):
        asked.extend(omega)
        return gb.FrequencyResponse(omega, np.exp(1e9j * omega))

    curve = refined_curve(response, np.array([1.0, 4.0]))
    assert_array_equal(curve.omega, np.sort(asked))
    assert 1600 < len(set(asked)) == len(asked) < 4000
