"""What the paper leaves open: which terms of the moment explain both tables, and which they cannot tell apart."""

import math

import numpy as np
import pytest

import greybox as gb
from greybox.models.moment import TiltMoment, TiltMomentAt
from greybox.problems import pitch_5deg, pitch_hover, pitch_moment

pytestmark = pytest.mark.usefixtures("unjudged_file")


def test_the_linearization_by_hand_is_that_of_the_nonlinear_model():
    values = {
        "a1": -11.0,
        "a2": 3.0,
        "a3": 8.0,
        "a4": 290.0,
        "b_vv": -0.3,
        "b_vtheta": -2.0,
        "b_vq": 0.1,
    }
    values |= {"b_thetatheta": 20.0, "b_thetaq": 1.0, "b_vtau": 5.0}
    omega = np.geomspace(1, 20, 6)
    for angle in (0.0, math.radians(5)):
        by_states = gb.frequency_response(
            TiltMoment(),
            {**values, "C_x": 0.0075},
            omega,
            input="u",
            output="theta",
            at={"theta": angle},
        )
        by_hand = gb.frequency_response(TiltMomentAt(angle, 0.0075), values, omega)
        np.testing.assert_allclose(by_hand.response, by_states.response, rtol=1e-9)
    with pytest.raises(ValueError, match="give an angle from 0 to below π/2"):
        TiltMomentAt(-0.1)


@pytest.fixture(scope="module")
def selection():
    return pitch_moment.selection(starts=1)


def test_three_terms_are_supported_and_the_fourth_is_not_beyond_chance(selection):
    assert selection.terms == pitch_moment.TERMS
    assert selection.without.cost == pytest.approx(6.0845, abs=1e-4)
    assert selection.fit.cost == pytest.approx(pitch_moment.minimum, rel=1e-5)
    # Four terms do what separate parameters for the two tables do: the sum of the two fits alone.
    separate = gb.fit(pitch_moment.separate(), starts=1, profiles=False, progress=False)
    last = {t.term: t for t in selection.trials if t.step == selection.trials[-1].step}
    assert last["b_vq"].cost == pytest.approx(separate.cost, rel=1e-4)
    assert last["b_vq"].p_value > last["b_vq"].limit
    assert separate.cost == pytest.approx(
        pitch_hover.minimum + pitch_5deg.minimum, rel=0.01
    )  # there a5 is 0.16 in hover, here zero


def test_what_two_tables_cannot_tell_apart_another_angle_tells(selection):
    assert selection.alike.keys() == {"b_vv", "b_vtheta"}
    assert all(others.keys() == {"b_thetatheta"} for others in selection.alike.values())
    table = pitch_moment.flights(angles=(10.0,), starts=2)
    assert [float(line.split()[-1]) > 10 for line in table.splitlines()[2:]] == [True, True]
