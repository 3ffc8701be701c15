"""Transfer functions in series and in feedback loops."""

import numpy as np
import pytest
from evaluation import compiled_response
from gain_and_lag import Gain, Lag
from numpy.testing import assert_allclose

import greybox as gb
from greybox.models.rotor import Rotor
from greybox.models.tilt import LinearTilt, Tilt
from greybox.models.yaw import YawRate

OMEGA = np.geomspace(0.3, 40, 12)


def response(model, values=None, **options):
    return gb.frequency_response(model, values, OMEGA, **options).response


def test_series_multiplies_responses_and_merges_parameters():
    chain = Rotor().series(FreeYaw(), shared=["T_rotor", "T_delay"])
    assert (chain.input_names, chain.output_names) == (("u",), ("r",))
    assert list(chain.parameters) == [
        "K_Omega",
        "T_rotor",
        "T_delay",
        "a1_tilde",
        "a2",
        "a3_tilde",
        "a4",
    ]
    assert chain.label == "Rotor * FreeYaw"
    values = chain.values(T_rotor=0.07, T_delay=0.02)
    rotor, yaw = ({n: values[n] for n in part.parameters} for part in (Rotor(), FreeYaw()))
    product = response(Rotor(), rotor) * response(FreeYaw(), yaw)
    assert_allclose(response(chain, values), product, rtol=1e-13)
    assert_allclose(compiled_response(chain, OMEGA)(values), product, rtol=1e-12)
    form = gb.modeling.rational(chain, values)
    assert_allclose(form(1j * OMEGA), product, rtol=1e-10)
    assert form.delay == 0.04


def test_a_delay_of_both_is_applied_twice_only_if_it_is_said_to_be_the_same():
    """Rotor and tilt have a delay each; silently shared, it would count twice."""
    with pytest.raises(
        ValueError, match=r"Rotor and Tilt both have 'T_rotor': rename .*shared=\['T_rotor'\]"
    ):
        Rotor() * Tilt()
    chain = Rotor() * Tilt().renamed(T_rotor="T_lag", T_delay="T_tilt")
    assert {"T_rotor", "T_delay", "T_lag", "T_tilt"} < chain.parameters.keys()
    values = {"T_rotor": 0.05, "T_delay": 0.01, "T_lag": 0.02, "T_tilt": 0.03}
    product = response(Rotor(), {"T_rotor": 0.05, "T_delay": 0.01}) * response(
        Tilt(), {"T_rotor": 0.02, "T_delay": 0.03}
    )
    assert_allclose(response(chain, values), product, rtol=1e-13)
    assert_allclose(compiled_response(chain, OMEGA)(chain.values(values)), product, rtol=1e-12)
    assert gb.modeling.rational(chain, values).delay == pytest.approx(0.04)
    assert chain.derived["a3_tilde"](chain.values(a3=2.0)) == Tilt().derived["a3_tilde"](
        Tilt().values(a3=2.0)
    )


def test_a_parameter_that_is_not_there_or_a_name_in_use_is_not_renamed():
    with pytest.raises(ValueError, match="Tilt has no parameter 'b'"):
        Tilt().renamed(b="c")
    with pytest.raises(ValueError, match="two equally named parameters"):
        Tilt().renamed(a1="a2")


class FreeYaw(YawRate):
    """The yaw rate with its rotor free, as that of `Rotor`."""

    T_rotor, T_delay = Rotor.T_rotor, Rotor.T_delay


def test_series_keeps_derived_quantities_of_both():
    assert list((Lag() * Tilt()).derived) == ["a3_tilde"]
    assert list((Tilt() * Lag()).derived) == ["a3_tilde"]


def test_series_of_three():
    chain = Lag() * Tilt() * Gain().renamed(k="k_2")
    expected = response(Lag()) * response(Tilt()) * 2.0
    assert_allclose(response(chain), expected, rtol=1e-13)


def test_only_transfer_functions_are_connected():
    with pytest.raises(TypeError):
        Tilt() * LinearTilt()
    with pytest.raises(TypeError, match=r"LinearTilt\(\) is not a TransferFunction"):
        gb.feedback(LinearTilt())
    with pytest.raises(TypeError, match=r"3 is not a TransferFunction"):
        gb.feedback(Tilt(), 3)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("back", [None, Lag()], ids=repr)
def test_a_loop_around_a_delay_is_exact_in_numbers_and_casadi(back, sign):
    loop = gb.feedback(Tilt(), back, sign)
    forward = response(Tilt())
    expected = forward / (1 - sign * forward * (1 if back is None else response(back)))
    assert_allclose(response(loop), expected, rtol=1e-12)
    assert_allclose(compiled_response(loop, OMEGA)(), expected, rtol=1e-11)


def test_a_loop_around_a_delay_is_rational_only_with_pade():
    loop = gb.feedback(Tilt(), Lag())
    with pytest.raises(ValueError, match="Padé approximation"):
        gb.modeling.rational(loop)
    form = gb.modeling.rational(loop, pade=3)
    assert form.delay == 0
    assert_allclose(form(1j * OMEGA), response(loop, delay="pade:3"), rtol=1e-9)
    assert_allclose(form(1j * OMEGA), response(loop), rtol=1e-6)


def test_a_loop_without_a_delay_is_rational():
    form = gb.modeling.rational(gb.feedback(Lag()))
    assert_allclose(form(1j * OMEGA), 2 / (0.5j * OMEGA + 3), rtol=1e-13)
    assert len(form.denominator) == 2


def test_a_loop_says_what_is_in_it():
    loop = gb.feedback(Tilt(), Lag())
    assert loop.label == "Feedback(Tilt, Lag)"
    assert gb.feedback(Tilt()).label == "Feedback(Tilt)"
    assert list(loop.parameters) == ["a1", "a2", "a3", "a4", "T_rotor", "T_delay", "a5", "k", "T"]
    assert list(loop.derived) == ["a3_tilde"]
    assert (loop.input, loop.output) == ("u", "theta")


def test_a_loop_has_one_of_two_signs():
    with pytest.raises(ValueError, match=r"sign 0 must be -1 \(negative feedback\) or 1"):
        gb.feedback(Tilt(), sign=0)
